//! Linear algebra on slices: dense, band and sparse factorizations, eigenvalues, Krylov methods.

#![forbid(unsafe_code)]

pub mod band;
#[cfg(any(feature = "nalgebra", feature = "sprs"))]
mod convert;
pub mod dense;
mod eigen;
mod error;
pub mod krylov;
mod registers;
mod solver;
pub mod sparse;
mod structure;
mod vector;

pub use band::BadPivot;
pub use eigen::{Eigen, eigenvalues};
pub use error::Error;
pub use registers::clear_upper_registers;
pub use solver::{Factor, LinearSolver};
pub use structure::Structure;
pub use vector::{axpy, dot, dot_in_lanes, norm};

/// The example of README.md, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
