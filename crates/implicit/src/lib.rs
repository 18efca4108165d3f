//! Discrete models with tangent and adjoint, above all those whose steps are given implicitly by G(x_k, x_{k+1}) = 0.
//!
//! Write the equations of one step and their derivatives as an [`ImplicitStep`]; [`ImplicitModel`] makes of it a
//! [`Model`]: Newton's method with a line search, halved steps where that fails, and the tangent linear and adjoint of the
//! step from a kept factorization (paper 2.23, 2.24, 2.25). [`OneLeg`] (implicit Euler, midpoint, BDF2) and [`Rk4`] are ready-made steps for any ẋ = f(t, x),
//! [`Trajectory`] runs a window and sweeps along it, [`check`] tests the derivatives of any [`Model`]. [`lorenz`] and [`mod@line`]
//! hold models to try things on; one of your own is an [`Rhs`] of three functions.
//!
//! Steps lie on a grid of time, uniform or given; [`accepted_times`] makes one by an error estimate, to be kept fixed as long
//! as derivatives are taken. When not to use it: where the derivative of an adapting step length is wanted too, or where
//! derivatives are not known in closed form (nothing here differentiates numerically).
//!
//! # Range
//!
//! Measured by the suite `stiff` (`docs/results/stability.md`): Robertson's kinetics to 4e6 s as an ODE and with a singular mass, adjoints
//! within 1e-12 of dual numbers; gradients through steps taken in parts within 1e-8; decaying adjoints over 1e5 steps. A singular
//! ∂G/∂u and a residual that is never finite are errors that name the step. In a chaotic window gradients are right to some
//! ε‖M‖: [`check::amplification`] estimates it, and flags windows beyond 1e-4 (about 22 time units of Lorenz-63, 16 of Lorenz-96).
//!
//! The derivative of the end of a window with respect to its start, and its transpose:
//!
//! ```
//! use varda_implicit::lorenz::Lorenz63;
//! use varda_implicit::{ImplicitModel, Keep, OneLeg, Trajectory, check};
//!
//! let step = OneLeg::implicit_midpoint(Lorenz63::default(), 1e-11);
//! let mut model = ImplicitModel::new(step, 0, 0.01);
//! let mut trajectory = Trajectory::new();
//! trajectory.run(&mut model, &[1.0, 3.0, 20.0], 50, Keep::Linearizations)?;
//!
//! let mut dx = [1.0, 0.0, 0.0];
//! trajectory.tangent(&mut model, &mut dx, &mut |_, _, _| {})?;
//! let mut lambda = [0.0; 3];
//! trajectory.adjoint(&mut model, &mut lambda, &mut |k, _, lambda| {
//!     if k == 50 {
//!         lambda[2] += 1.0;
//!     }
//! })?;
//! // ∂z₅₀/∂x₀ both ways
//! assert!((dx[2] - lambda[0]).abs() < 1e-12 * dx[2].abs());
//!
//! let test = check::dot_product(&mut model, 0..50, &[1.0; 3], 1)?;
//! assert!(test.pass);
//! # Ok::<(), varda_implicit::Error>(())
//! ```

#![forbid(unsafe_code)]

#[cfg(feature = "implicit")]
mod adaptive;
pub mod check;
#[cfg(feature = "implicit")]
mod equations;
mod error;
mod explicit;
#[cfg(feature = "implicit")]
mod implicit;
pub mod line;
pub mod lorenz;
mod model;
#[cfg(feature = "implicit")]
mod newton;
mod observation;
#[cfg(feature = "implicit")]
mod one_leg;
mod rhs;
#[cfg(feature = "implicit")]
mod scheme;
#[cfg(feature = "implicit")]
mod step;
mod storage;
mod substepped;
#[cfg(feature = "implicit")]
mod substeps;
mod trajectory;

#[cfg(feature = "implicit")]
pub use adaptive::{Adaptive, accepted_times, largest_error};
#[cfg(feature = "implicit")]
pub use equations::Equations;
pub use error::{Error, Refusal};
pub use explicit::Rk4;
#[cfg(feature = "implicit")]
pub use implicit::{ImplicitModel, Linearization, MAX_HALVINGS};
pub use model::{ControlMap, Counts, Log, Model, Warning, Work};
#[cfg(feature = "implicit")]
pub use newton::{NewtonFailure, NewtonOptions, NewtonReport, NewtonWork, solve};
pub use observation::{At, ObservationOperator};
#[cfg(feature = "implicit")]
pub use one_leg::{OneLeg, OneLegEquations};
pub use rhs::Rhs;
#[cfg(feature = "implicit")]
pub use scheme::{Scheme, Stage};
#[cfg(feature = "implicit")]
pub use step::{ImplicitStep, Interval, StepEquations};
pub use storage::{Footprint, Storage};
pub use substepped::Substepped;
pub use trajectory::{Keep, LinearizedStep, Trajectory};
#[cfg(feature = "implicit")]
pub use varda_linalg::{BadPivot, Factor, LinearSolver};
pub use varda_linalg::{Structure, band};

/// The example of README.md, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
