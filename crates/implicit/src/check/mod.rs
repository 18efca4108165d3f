//! Checks of tangents, adjoints and gradients, for any [`Model`](crate::Model) and any scalar function.
//!
//! [`model`], [`rhs`] and [`operator`] check everything that a user of this crate writes, and return a
//! [`Report`]. The single checks return numbers, the bound they were held against and whether they pass, and
//! refuse ([`Error::EmptyTest`](crate::Error::EmptyTest)) what they could not judge. Components of a state
//! may have different units: `scale` holds a typical perturbation of each, all norms are those of x/scale
//! (and of λ · scale), and random vectors are drawn to match.
//!
//! A dot-product test proves that the adjoint is the transpose of the tangent; only a Taylor test proves that
//! the tangent is the derivative of the step.

mod amplification;
mod conformance;
mod operator;
mod products;
mod rhs;
mod second_order;
mod taylor;
mod vectors;

pub use amplification::{Amplification, amplification};
pub use conformance::{conformance, model};
pub use operator::operator;
pub use products::{DotProduct, compare, dot_product, window};
pub use rhs::rhs;
pub use second_order::second_order;
pub use taylor::{Taylor, taylor, taylor_step};
pub use varda_linalg::check::{Finding, Random, Report, differing};
