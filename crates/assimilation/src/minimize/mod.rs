//! Minimizers of a cost J(v), their settings and what they report.

mod adam;
#[cfg(feature = "argmin")]
mod argmin;
mod auto;
mod choice;
mod continuation;
mod inverse_hessian;
mod lbfgs;
mod minimum;
mod newton;
mod newton_cg;
mod preconditioner;
mod raw;
mod secant;
mod spectral;
mod trust_region;

pub(crate) use spectral::eigen;

pub use adam::{AdamOptions, adam};
#[cfg(feature = "argmin")]
pub use argmin::{ArgminOptions, argmin_lbfgs, argmin_trust_region};
pub use auto::{AutoOptions, auto};
pub use choice::{Minimizer, continuation};
pub use inverse_hessian::InverseHessian;
pub use lbfgs::{LbfgsOptions, lbfgs};
pub use minimum::{Iteration, Minimum, Status};
pub(crate) use minimum::{at_least_one, check_tolerance};
pub use newton::{NewtonOptions, newton};
pub use newton_cg::{NewtonCgOptions, newton_cg};
pub use raw::RawVariables;
pub use trust_region::{TrustRegionOptions, trust_region};
pub use varda_linalg::krylov::RitzPair;
