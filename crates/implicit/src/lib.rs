//! Steps given implicitly by G(x_k, x_{k+1}) = 0, with tangent and adjoint.

pub mod band;
pub mod check;
mod error;
mod explicit;
mod factor;
mod implicit;
pub mod lorenz;
mod model;
mod newton;
mod rhs;
mod step;
mod trajectory;

pub use error::{Error, Refusal};
pub use explicit::Rk4;
pub use factor::{Factor, LinearSolver};
pub use implicit::{ImplicitModel, MAX_HALVINGS};
pub use model::{Counts, Model, Warning};
pub use newton::{NewtonOptions, NewtonReport, NewtonWork, solve};
pub use rhs::{OneLeg, Rhs};
pub use step::{ImplicitStep, Interval, Structure};
pub use trajectory::{Keep, Trajectory};
