//! Linear algebra on slices: factorizations of dense, band and sparse matrices, eigenvalues, Krylov methods.
//!
//! The crates of Varda reach linear algebra through this one. Dense and sparse factorizations are those of
//! [faer](https://docs.rs/faer), called on one thread, so that the same input gives the same bits; band
//! matrices have code of their own, faster than a general library's for half-bandwidths of some ten.
//! Singular, indefinite and broken matrices end in a typed error, never in a silent NaN.
//!
//! | item | what it does | cost |
//! |---|---|---|
//! | [`Structure`] | where a matrix has entries and how they are laid out; colourings of its columns | – |
//! | [`LinearSolver`], [`Factor`] | factors any structure, solves with A and Aᵀ | that of the structure |
//! | [`band`] | LDLᵀ, LU and Cholesky of bands of half-bandwidth w | n w² to factor, n w to solve |
//! | [`dense::Cholesky`] | A = L Lᵀ, in blocks | n³/3, n² |
//! | [`dense::product`], [`dense::gram`] | A B and A Aᵀ | 2 n³, n³ |
//! | [`sparse::Cholesky`] | Π A Πᵀ = L Lᵀ, the diagonal of A⁻¹ | n^{3/2} on a grid in 2-D |
//! | [`Eigen`], [`eigenvalues()`] | of symmetric matrices | some 9 n³ |
//! | [`krylov::conjugate_gradients`], [`krylov::Lanczos`] | operators known by products | products |
//! | [`dot`], [`norm`], [`axpy`] | sums over vectors | n |
//! | [`check`] | the report of a check of a user's own type | – |
//!
//! # Features
//!
//! `faer` (default): all but [`band`], [`Structure`], [`check`] and sums over vectors, which are this crate's
//! own code. `nalgebra`: [`dense::Matrix`] from and to `DMatrix`. `sprs`: [`Structure`] and its values from a
//! `CsMat`. Both off by default.
//!
//! # When not to use it
//!
//! For complex numbers, single precision, singular values, least squares or several threads: use faer or
//! nalgebra themselves.
//!
//! # Example
//!
//! A ring of five unknowns, each coupled to its neighbours:
//!
//! ```
//! use varda_linalg::{LinearSolver, Structure};
//!
//! let ring = Structure::periodic_band(5, 1);
//! let values = ring.values(5, |i, j| if i == j { 3.0 } else { -1.0 });
//! let mut solver = LinearSolver::new(5, &ring);
//! let mut factor = solver.empty_factor();
//! solver.factor(&values, &mut factor)?;
//! let mut x = [1.0; 5];
//! solver.solve(&factor, &mut x);
//! assert!(x.iter().all(|x| (x - 1.0).abs() < 1e-15));
//! # Ok::<(), varda_linalg::BadPivot>(())
//! ```

#![forbid(unsafe_code)]

pub mod band;
pub mod check;
#[cfg(any(feature = "nalgebra", feature = "sprs"))]
mod convert;
#[cfg(feature = "faer")]
pub mod dense;
#[cfg(feature = "faer")]
mod eigen;
mod error;
#[cfg(feature = "faer")]
pub mod interrupt;
#[cfg(feature = "faer")]
pub mod krylov;
#[cfg(feature = "faer")]
mod qr;
#[cfg(feature = "faer")]
mod registers;
#[cfg(feature = "faer")]
mod solver;
#[cfg(feature = "faer")]
pub mod sparse;
mod structure;
#[cfg(feature = "faer")]
mod svd;
mod vector;

pub use band::BadPivot;
#[cfg(feature = "faer")]
pub use eigen::{Eigen, eigenvalues};
pub use error::Error;
#[cfg(feature = "faer")]
pub use qr::shorter_root;
#[cfg(feature = "faer")]
use registers::clear_upper_registers;
#[cfg(feature = "faer")]
pub use solver::{Factor, LinearSolver};
pub use structure::Structure;
#[cfg(feature = "faer")]
pub use svd::Svd;
pub use vector::{axpy, dot, dot_in_lanes, norm};

/// The example of README.md, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
