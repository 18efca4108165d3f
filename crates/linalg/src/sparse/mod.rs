//! Sparse matrices in compressed columns (faer's factorizations): Cholesky roots here, LU through
//! [`LinearSolver`](crate::LinearSolver).

mod cholesky;
mod lu;

pub use cholesky::{Cholesky, Ordering};
pub(crate) use lu::{NumericLu, SparseLu};
