//! Linear algebra on slices: dense, band and sparse factorizations, eigenvalues, Krylov methods.

#![forbid(unsafe_code)]

pub mod band;
#[cfg(any(feature = "nalgebra", feature = "sprs"))]
mod convert;
#[cfg(feature = "faer")]
pub mod dense;
#[cfg(feature = "faer")]
mod eigen;
mod error;
#[cfg(feature = "faer")]
pub mod krylov;
#[cfg(feature = "faer")]
mod registers;
#[cfg(feature = "faer")]
mod solver;
#[cfg(feature = "faer")]
pub mod sparse;
mod structure;
mod vector;

pub use band::BadPivot;
#[cfg(feature = "faer")]
pub use eigen::{Eigen, eigenvalues};
pub use error::Error;
#[cfg(feature = "faer")]
pub use registers::clear_upper_registers;
#[cfg(feature = "faer")]
pub use solver::{Factor, LinearSolver};
pub use structure::Structure;
pub use vector::{axpy, dot, dot_in_lanes, norm};

/// The example of README.md, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
