//! Steps given implicitly by G(x_k, x_{k+1}) = 0, with tangent and adjoint.

pub mod band;
mod error;
mod factor;
mod implicit;
mod model;
mod newton;
mod step;

pub use error::{Error, Refusal};
pub use factor::{Factor, LinearSolver};
pub use implicit::{ImplicitModel, MAX_HALVINGS};
pub use model::{Counts, Model, Warning};
pub use newton::{NewtonOptions, NewtonReport, NewtonWork, solve};
pub use step::{ImplicitStep, Interval, Structure};
