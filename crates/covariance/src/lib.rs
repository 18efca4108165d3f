//! Covariance operators.

mod operator;

pub use operator::{Covariance, Precision};
