//! Linear algebra on slices: dense, band and sparse factorizations, eigenvalues, Krylov methods.

#![forbid(unsafe_code)]

pub mod band;
mod registers;
mod solver;
mod structure;

pub use band::BadPivot;
pub use registers::clear_upper_registers;
pub use solver::{Factor, LinearSolver};
pub use structure::Structure;
