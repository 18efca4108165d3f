//! Discrete models x_{k+1} = M_k(x_k) with tangent and adjoint, above all those whose steps are given
//! implicitly by G(x_k, x_{k+1}) = 0 (paper 2.23, 2.24, 2.25).
//!
//! Write f, its derivative and the transpose ([`Rhs`]), or the equations of a step of your own
//! ([`ImplicitStep`]). Newton's method with a line search, substeps where it fails, the exact tangent and
//! adjoint of every step from kept factors, checkpoints and checks of all derivatives are here.
//!
//! | item | what it is |
//! |---|---|
//! | [`Model`], [`ControlMap`] | a discrete step with its derivatives; the map of the control |
//! | [`Rhs`] | f(t, x) of ẋ = f(t, x) and its products; layouts by [`Structure`] |
//! | [`Rk4`] | explicit Runge–Kutta of order four, with its exact discrete adjoint |
//! | [`OneLeg`], [`Scheme`] | implicit Euler, implicit midpoint, BDF2 for any [`Rhs`] |
//! | [`ImplicitStep`], [`ImplicitModel`] | a step given by equations; the model made of it |
//! | [`Equations`], [`solve()`] | equations without a step of time, and Newton's method for them |
//! | [`accepted_times`], [`Substepped`] | a grid of time by an error estimate; several steps as one |
//! | [`Trajectory`], [`Storage`], [`Footprint`] | a window and its sweeps; what is kept, and its size |
//! | [`ObservationOperator`] | what is observed of a state |
//! | [`check`] | tests of all derivatives above, with a report |
//! | [`lorenz`], [`mod@line`] | models to try things on |
//!
//! # When to use it
//!
//! For gradients and tangents of a simulation that are those of the computed steps, to rounding: data
//! assimilation, optimal control, sensitivities. Stiff equations, equations with a potential to be minimized
//! (statics), windows too long for memory.
//!
//! # When not to use it
//!
//! Where the derivative of an adapting step length is wanted too: steps here lie on a grid of time that is
//! fixed as long as derivatives are taken. Where derivatives are not known in closed form: nothing here
//! differentiates numerically. Where only a solution is wanted: libraries of integrators know more methods.
//!
//! # Range
//!
//! Measured by the suite `stiff` (`docs/results/stability.md`): Robertson's kinetics to 4e6 s as an ODE and
//! with a singular mass, adjoints within 1e-12 of dual numbers; gradients through substeps within 1e-8;
//! decaying adjoints over 1e5 steps. A singular ∂G/∂u and a residual that is never finite are errors that
//! name the step. In a chaotic window gradients are right to some ε‖M‖: [`check::amplification`]
//! estimates it, and flags windows beyond 1e-4 (about 22 time units of Lorenz-63, 16 of Lorenz-96).
//!
//! # Features
//!
//! - `implicit` (on by default): Newton's method and its linear solvers. Without it no linear-algebra library
//!   is compiled; [`Model`], [`Trajectory`], [`Rk4`] and the checks remain.
//! - `sprs`: the pattern of a Jacobian from one of sprs's sparse matrices.
//!
//! # Example: a stiff model of your own
//!
//! The products of a fast reaction diffuse along a line: a step of [`Rk4`] could be 1.6e-5 s long at most,
//! here it is 0.05 s. The Jacobian is tridiagonal; it is found from three tangents, as none is given.
//!
//! ```
//! # #[cfg(feature = "implicit")] {
//! use varda_implicit::{ImplicitModel, Keep, OneLeg, Rhs, Structure, Trajectory, check};
//!
//! /// ẋ_i = 4e4 (x_{i−1} − 2 x_i + x_{i+1}) − 1e4 x_i (x_i − 1), x = 0 beyond both ends.
//! struct Reaction;
//!
//! /// 4e4 (v_{i−1} − 2 v_i + v_{i+1})
//! fn spread(v: &[f64], i: usize) -> f64 {
//!     let at = |j: Option<usize>| j.and_then(|j| v.get(j)).unwrap_or(&0.0);
//!     4e4 * (at(i.checked_sub(1)) - 2.0 * v[i] + at(Some(i + 1)))
//! }
//!
//! impl Rhs for Reaction {
//!     fn dim(&self) -> usize {
//!         50
//!     }
//!     fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
//!         for i in 0..50 {
//!             f[i] = spread(x, i) - 1e4 * x[i] * (x[i] - 1.0);
//!         }
//!     }
//!     fn tangent(&mut self, _t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
//!         for i in 0..50 {
//!             df[i] = spread(dx, i) - 1e4 * (2.0 * x[i] - 1.0) * dx[i];
//!         }
//!     }
//!     fn adjoint_add(&mut self, _t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
//!         // the Jacobian is symmetric
//!         for i in 0..50 {
//!             dx[i] += spread(lambda, i) - 1e4 * (2.0 * x[i] - 1.0) * lambda[i];
//!         }
//!     }
//!     fn structure(&self) -> Structure {
//!         Structure::tridiagonal()
//!     }
//! }
//!
//! let x0: Vec<f64> = (0..50).map(|i| 0.5 + 0.4 * (0.2 * i as f64).sin()).collect();
//! let report = check::rhs(&mut Reaction, 0.0, &x0, &[0.1; 50], 1)?;
//! assert!(report.passed(), "{report}");
//!
//! let mut model = ImplicitModel::new(OneLeg::implicit_euler(Reaction, 1e-10), 0, 0.05);
//! let mut trajectory = Trajectory::new();
//! trajectory.run(&mut model, &x0, 4, Keep::Linearizations)?;
//!
//! // ∂x₄/∂x₀ forwards, and transposed backwards: ⟨M dx, μ⟩ = ⟨dx, Mᵀ μ⟩
//! let (mut dx, mut lambda) = ([1.0; 50], [0.0; 50]);
//! trajectory.tangent(&mut model, &mut dx, &mut |_, _, _| {})?;
//! trajectory.adjoint(&mut model, &mut lambda, &mut |k, _, lambda| {
//!     if k == 4 {
//!         lambda[20] = 1.0;
//!     }
//! })?;
//! let sum: f64 = lambda.iter().sum();
//! assert!((dx[20] - sum).abs() <= 1e-10 * sum.abs());
//! assert_eq!(trajectory.log().counts.model_steps, 4);
//! # }
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
pub mod kuramoto;
pub mod line;
pub mod lorenz;
mod model;
#[cfg(feature = "implicit")]
mod newton;
mod observation;
#[cfg(feature = "implicit")]
mod one_leg;
#[cfg(feature = "implicit")]
mod parameters;
mod parametric_rhs;
mod rate;
mod remembered;
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
pub use model::{ControlMap, Counts, Log, Model, SecondOrder, Warning, Work};
#[cfg(feature = "implicit")]
pub use newton::{NewtonFailure, NewtonOptions, NewtonReport, NewtonWork, solve};
pub use observation::{At, ObservationOperator};
#[cfg(feature = "implicit")]
pub use one_leg::{OneLeg, OneLegEquations};
#[cfg(feature = "implicit")]
pub use parameters::{ParameterPlaces, ParametricStep, WithParameters};
pub use parametric_rhs::{ChosenParameters, Law, ParametricRhs, RhsWithParameters};
pub use rate::{Rate, VelocityRate};
pub use remembered::Remembered;
pub use rhs::Rhs;
#[cfg(feature = "implicit")]
pub use scheme::{Scheme, Stage};
#[cfg(feature = "implicit")]
pub use step::{ImplicitStep, Interval, Multipliers, SolvedStep, StepEquations};
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
