//! Covariance operators for data assimilation: background errors B and observation errors R.
//!
//! A covariance is known by what it does to a vector: the product B x, the square root B^{1/2} v with its transpose, and
//! where the rank is full the inverse B⁻¹ x and B^{-1/2} x ([`Covariance`], [`Precision`]). Built from
//!
//! - a [`Kernel`] (Gaussian, Matérn) times a [`Taper`] (triangle, Gaspari–Cohn) over points, on request conditioned exactly
//!   on points without error ([`CovarianceFunction`]);
//! - a band, for points along a line and a taper of compact support ([`Banded`]): linear in their number;
//! - a dense matrix, through its Cholesky root ([`Dense`]) or, where it is singular, a root of truncated rank ([`Truncated`]);
//! - a standard deviation per component ([`Diagonal`]);
//! - an [`Ensemble`], localized ([`Localization`]), and its [`Hybrid`] with a static covariance;
//! - other covariances: one shared by the components of a vector field ([`Interleaved`]), several side by side ([`BlockDiagonal`]).
//!
//! [`sample()`] draws from N(0, B); [`Spectrum`] says how well conditioned it is.
//!
//! # Range
//!
//! Measured by the suite `stiff` (`docs/results/stability.md`): Cholesky roots up to condition numbers of some 1e12, far beyond that a typed
//! error; truncated roots at any (a Gaussian kernel as long as half the line), to n ε of the largest eigenvalue.
//! [`Spectrum::reliable_condition_number`] tells only condition numbers that double precision knows. [`Banded`] takes 10⁵ points in
//! 9 MB and some hundredths of a second.
//!
//! # When not to use it
//!
//! Roots are dense but for [`Banded`]: n² numbers, n³/3 operations to build. Up to a few thousand points per block that is quick;
//! beyond, and in more than one dimension, B wants a sparse or spectral root, which this crate does not have. Implement [`Covariance`] for your own type: everything
//! above this crate asks for the trait alone.
//!
//! # Example
//!
//! Errors in position and velocity of 21 points along one metre, correlated along the line, x y z independent:
//!
//! ```
//! use varda_covariance::{BlockDiagonal, Covariance, CovarianceFunction, Dense, Interleaved, Kernel, Precision, Taper, sample};
//!
//! let places: Vec<f64> = (0..21).map(|i| 0.05 * i as f64).collect();
//! let position = CovarianceFunction {
//!     sigma: 0.01, // m
//!     kernel: Kernel::Gaussian { length: 0.5 },
//!     taper: Taper::Triangle { support: 1.0 },
//! };
//! let velocity = CovarianceFunction { sigma: 0.3, ..position }; // m/s
//! let b = BlockDiagonal::new(vec![
//!     Interleaved::new(Dense::new(21, &position.matrix(&places)?)?, 3),
//!     Interleaved::new(Dense::new(21, &velocity.matrix(&places)?)?, 3),
//! ]);
//!
//! let mut rng = rand::rngs::ChaCha8Rng::from_seed([7; 32]);
//! # use rand::SeedableRng;
//! let error = sample(&b, &mut rng);
//! assert_eq!(error.len(), 2 * 21 * 3);
//!
//! // |error|² in the norm of B⁻¹ is about the number of components.
//! let mut v = vec![0.0; b.root_dim()];
//! b.whiten(&error, &mut v);
//! let norm2: f64 = v.iter().map(|v| v * v).sum();
//! assert!((norm2 - 126.0).abs() < 4.0 * (2.0_f64 * 126.0).sqrt());
//! # Ok::<(), varda_covariance::Error>(())
//! ```

#![forbid(unsafe_code)]
// `!(value > tolerance)` is how a NaN is made to fail.
#![allow(clippy::neg_cmp_op_on_partial_ord)]

mod banded;
mod block;
mod check;
mod combine;
#[cfg(any(feature = "nalgebra", feature = "sprs"))]
mod convert;
mod dense;
mod diagonal;
mod diffusion;
mod ensemble;
mod error;
mod grid;
mod kernel;
mod operator;
mod sample;
mod scratch;
mod sparse_precision;
mod spectrum;
mod truncated;

pub use banded::Banded;
pub use block::{BlockDiagonal, Interleaved};
pub use combine::{Kronecker, Scaled, Sum};
#[cfg(feature = "nalgebra")]
pub use convert::to_dmatrix;
pub use dense::Dense;
pub use diagonal::Diagonal;
pub use diffusion::Diffusion;
pub use ensemble::{Ensemble, Hybrid, Localization};
pub use error::Error;
pub use grid::Grid;
pub use kernel::{CovarianceFunction, Kernel, Taper, correlation};
pub use operator::{Covariance, Precision};
pub use sample::sample;
pub use sparse_precision::SparsePrecision;
pub use spectrum::Spectrum;
pub use truncated::Truncated;
pub use varda_linalg::sparse::Ordering;

/// The example of README.md, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
