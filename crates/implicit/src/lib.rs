//! Steps given implicitly by G(x_k, x_{k+1}) = 0, with tangent and adjoint.

mod error;
mod model;
mod step;

pub use error::{Error, Refusal};
pub use model::{Counts, Model, Warning};
pub use step::{ImplicitStep, Interval, Structure};
