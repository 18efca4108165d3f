//! Minimizers of a cost J(v), their settings and what they report.

mod adam;
#[cfg(feature = "argmin")]
mod argmin;
mod auto;
mod choice;
mod continuation;
mod hessian;
mod inverse_hessian;
mod lbfgs;
mod line_search;
mod method;
mod minimum;
mod newton;
mod newton_cg;
mod preconditioner;
mod raw;
mod secant;
mod spectral;
mod stationary;
mod stopping;
mod trust_region;

pub(crate) use spectral::eigen;

pub use adam::{AdamOptions, adam};
#[cfg(feature = "argmin")]
pub use argmin::{ArgminLbfgsOptions, ArgminTrustRegionOptions, argmin_lbfgs, argmin_trust_region};
pub use auto::{AutoOptions, auto};
pub use choice::{Minimizer, continuation};
pub use hessian::Hessian;
pub use inverse_hessian::InverseHessian;
pub use lbfgs::{LbfgsOptions, lbfgs};
pub(crate) use line_search::{Conditions, LineSearch, Ray};
pub use minimum::{Attempt, AttemptFrom, Iteration, Minimum};
pub(crate) use minimum::{Progress, Start};
pub use newton::{NewtonOptions, newton};
pub use newton_cg::{NewtonCgOptions, newton_cg};
pub use raw::RawVariables;
pub(crate) use stopping::{NOISE, at_least_one, check_tolerance, setters};
pub use stopping::{Status, Stopping};
pub use trust_region::{TrustRegionOptions, trust_region};
pub use varda_linalg::krylov::RitzPair;
