//! Covariance operators for data assimilation: background errors B and observation errors R.
//!
//! A covariance is known by what it does to a vector: the product B x, the square root B^{1/2} v with its
//! transpose, and where the rank is full the inverse B⁻¹ x and the whitening B^{-1/2} x with its transpose
//! ([`Covariance`], [`Precision`]). A reference, `Box`, `Rc` or `Arc` of a covariance is one.
//!
//! | type | B | use it for | cost of a root | inverse |
//! |---|---|---|---|---|
//! | [`Diagonal`] | diag(σ²) | independent errors | n | yes |
//! | [`Dense`] | a matrix, by Cholesky | up to a few thousand points | n² | yes |
//! | [`Truncated`] | a matrix, to a rank r | smooth kernels, singular matrices | n r | no |
//! | [`Banded`] | a kernel of compact support along a line | 10⁵ points of a line | n w | yes |
//! | [`Markov`] | a Matérn kernel along a line, conditioned or not | 10⁶ points of a line | n | yes |
//! | [`SparsePrecision`] | a sparse P⁻¹; Matérn fields | grids and meshes, 10⁵ points | a solve | yes |
//! | [`Diffusion`] | implicit diffusion, σ exact | smooth fields, 10⁵ points | M/2 sparse solves | yes |
//! | [`Ensemble`], [`Hybrid`] | localized, and with a static part | errors of the flow | n N r | no |
//! | [`Interleaved`] | C ⊗ I | x, y, z of a vector field | as its part | as its part |
//! | [`BlockDiagonal`] | diag(B₁, B₂, …) | positions and velocities | as its parts | as its parts |
//! | [`Kronecker`] | A ⊗ C | space and time, correlated variables | as its parts | as its parts |
//! | [`Scaled`] | D C D | standard deviations apart from correlations | as its part | as its part |
//! | [`Sum`] | B₁ + B₂ + … | errors of several origins | as its parts | no |
//!
//! Matrices come from a [`CovarianceFunction`]: a [`Kernel`] (Gaussian, Matérn) times a [`Taper`] (triangle,
//! Gaspari–Cohn), on request conditioned on points without error. [`sample()`] draws from N(0, B);
//! [`Spectrum`] says how well conditioned it is. [`check`] tests a covariance of your own: symmetry,
//! positivity, and that its root, its transpose and its inverse belong to it.
//!
//! # Features
//!
//! `nalgebra`: [`Dense`] from a `DMatrix`, any covariance to one. `sprs`: [`SparsePrecision`] from a `CsMat`.
//! Off by default: slices are what every method takes.
//!
//! # Range
//!
//! Measured by the suite `stiff` (`docs/results/stability.md`): Cholesky roots up to condition numbers of
//! some 1e12, far beyond that a typed error; truncated roots at any (a Gaussian kernel as long as half the
//! line), to n ε of the largest eigenvalue. [`Markov`] has a root at any correlation length; known places
//! amid free ones cost it about as many digits as they cost the dense matrix.
//! [`Spectrum::reliable_condition_number`] tells only condition
//! numbers that double precision knows.
//!
//! # When not to use it
//!
//! On the sphere, on spectral grids, or in three dimensions beyond some 10⁵ points, where a sparse factor
//! fills up. Implement [`Covariance`] for your own type: everything above this crate asks for the trait
//! alone.
//!
//! # Example
//!
//! Errors in position and velocity of 21 points along one metre, correlated along the line, x y z
//! independent:
//!
//! ```
//! use varda_covariance::{BlockDiagonal, Covariance, CovarianceFunction, Dense, Interleaved};
//! use varda_covariance::{Kernel, Precision, Taper, sample};
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
pub mod check;
mod combine;
#[cfg(any(feature = "nalgebra", feature = "sprs"))]
mod convert;
mod dense;
mod diagonal;
mod diffusion;
mod ensemble;
mod error;
mod grid;
mod input;
mod kernel;
mod markov;
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
pub use markov::Markov;
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
