//! Variational data assimilation: the state of a dynamical system from a background and noisy, sparse
//! observations.
//!
//! ```text
//!     J(v) = ½‖v‖² + ½ Σ_k ‖y_k − H_k(x_k)‖²_{R_k⁻¹},    x₀ = x_b + B^{1/2} v,
//!     x_{k+1} = M_k(x_k)
//! ```
//!
//! | question | answer |
//! |---|---|
//! | what is observed? | an [`ObservationSet`] of [`Observation`]s through [`ObservationOperator`]s |
//! | what is known before? | a [`ControlTransform`]: background x_b and any `varda_covariance::Covariance` |
//! | nothing known before? | the [`Climatology`] of the model |
//! | which cost? | [`StrongConstraint`]: 4D-Var, and 3D-Var where nothing is observed after step 0 |
//! | several windows with constants in common? | [`Joint`], and [`Posterior::marginal`] |
//! | and if the model errs? | [`WeakForcing`] or [`WeakState`], with [`Forcing`] |
//! | a cheaper inner problem? | [`outer_loop`], [`InnerSolver::Dual`] for PSAS; [`Blue`] |
//! | without tangent and adjoint? | [`EnVar`]: 4D-EnVar, hybrid, iterative ensemble smoother |
//! | gross errors? | [`StrongConstraint::set_huber`], [`StrongConstraint::background_check`] |
//! | several minima, a long window? | [`window_growth`] |
//! | window after window? | [`cycle`] |
//! | which minimizer? | [`Minimizer`]: [`trust_region`] (default), [`newton_cg`], [`newton`] |
//! | … with gradients alone? | [`lbfgs`], [`adam`] |
//! | … for several minima? | [`continuation`], [`auto`] |
//! | how large are errors of the model? | [`WeakPosterior`], [`ErrorScale`] |
//! | how sure? | [`Posterior`], [`LowRankPosterior`], [`Analysis`]; are B and R right? [`consistency`] |
//!
//! What it costs, in forward runs F, tangent sweeps T and adjoint sweeps A of the window for an iteration,
//! with n unknowns, m observed values, N members and i inner iterations; memory beside two trajectories and
//! what the model keeps of its linearizations:
//!
//! | method | when to use, when not | F | T | A | memory |
//! |---|---|---|---|---|---|
//! | … [`trust_region`] | the default | 1 | n, or i if n > 300 | 1, or 1 + i | 3n², or i n |
//! | … [`newton_cg`] | large n, small residuals | 1 | i | 1 + i | i n |
//! | … [`newton`] | linear problems; else it may diverge | 1 | n | 1 | 2n² + m n |
//! | … [`lbfgs`] | no tangent; not where products can be had | 1 | 0 | 1 | 60n |
//! | … [`adam`] | as a baseline | 1 | 0 | 1 | 6n |
//! | [`outer_loop`], primal | mildly nonlinear, runs dearer than sweeps | 1 | i | 1 + i | i n |
//! | [`outer_loop`], dual | the same with m well below n | 1 | i | 1 + i | 2 i m |
//! | [`Blue`] | linear and small, as a reference | 1 | n, or 0 | 1 + (0 or m) | 2nm + n² |
//! | [`EnVar`] | no tangent; not for small unlocalized N | N + 1 | 0 | 0 | N trajectories, 2mN |
//!
//! The system is any `varda_implicit::Model`. Everything is minimised in the control variable v. Not for
//! problems whose posterior has several modes that matter.
//!
//! Range, measured by the suite `stiff` (`docs/results/stability.md`): σ from 1e-6 to 1e6 of the
//! background's and ratios of 1e8 within a window, a thousand identical or contradicting observations,
//! redundant or zero rows of H: the analysis within a thousandth of its own σ by every second-order
//! minimizer, incremental method and closed form; a first-order minimizer that cannot get there says so in
//! its [`Status`]. A model that fails at a trial point is J = ∞, at the background an error that names the
//! step.
//!
//! ```
//! use std::ops::ControlFlow;
//! use varda_assimilation::*;
//! use varda_covariance::Diagonal;
//! use varda_implicit::{Rk4, lorenz::Lorenz63};
//!
//! let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
//! // x₀ and x₂ were seen at step 20, x₀ again between steps 30 and 31.
//! let all = Selection::new(vec![0, 1, 2], 3)?;
//! let seen = vec![
//!     Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1),
//!     Observation::new(30, vec![0], vec![15.4], 0.1).between(0.5),
//! ];
//! let mut observations = ObservationSet::new(40, vec![Box::new(all)], seen)?;
//! let b = Diagonal::uniform(3, 1.0)?;
//! let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
//!
//! let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut observations)?;
//! let mut v = vec![0.0; 3];
//! let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
//! assert_eq!(minimum.status, Status::Converged);
//! let posterior = Posterior::new(&mut cost)?;
//! let analysis = Analysis::new(&transform, &v, &minimum, &posterior, 3);
//! assert!(analysis.sigma_analysis[0] < analysis.sigma_background[0]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod analysis;
mod assimilation;
mod between;
mod blue;
mod carried;
mod climatology;
mod consistency;
mod control;
#[cfg(any(feature = "nalgebra", feature = "sprs"))]
mod convert;
mod correlated;
mod cost;
mod cycle;
mod cycle_errors;
mod cycle_members;
mod cycle_window;
mod departures;
mod error;
mod error_scale;
mod full_rank;
mod further;
mod growth;
mod inner;
mod interval;
mod lanczos_space;
mod minimize;
mod noise;
mod observation;
mod observation_errors;
mod observation_set;
mod operators;
mod outer_loop;
mod posterior;
mod posterior_lanczos;
mod propagate;
pub mod ranks;
mod sensitivity;
mod weak_posterior;

pub use analysis::Analysis;
pub use assimilation::{AnalysisResult, Assimilation};
pub use blue::{Blue, Gain};
pub use carried::{Carried, ErrorColumns, Squares, propagate_errors};
pub use climatology::Climatology;
pub use consistency::{Consistency, consistency, predicted_variance};
pub use control::ControlTransform;
pub use correlated::{Chain, Correlated};
pub use cost::{
    CostFunction, CostTerms, Counts, Dual, EnVar, EnVarOptions, EnsembleUpdate, Forcing, InnerCost, Joint,
    LeastSquares, Rejection, StrongConstraint, WeakForcing, WeakState, highest_j_of_a_fit, huber,
};
pub use cycle::{CycledCovariance, CycledEnsemble, CycledInflation, CycledUpdate, cycle};
pub use cycle_window::{
    Cycle, CycleErrors, CyclePosterior, CycleState, CycledErrors, CycledEstimate, CycledMinimizer, Cycling,
    Normals,
};
pub use departures::Departures;
pub use error::Error;
pub use error_scale::ErrorScale;
pub use further::variance_after;
pub use growth::{Assimilate, window_growth};
pub use inner::{InnerEnd, InnerLimits, conjugate_gradients, restricted_conjugate_gradients};
pub use minimize::{
    AdamOptions, Attempt, AttemptFrom, AutoOptions, Hessian, InverseHessian, Iteration, LbfgsOptions,
    Minimizer, Minimum, NewtonCgOptions, NewtonOptions, RawVariables, RitzPair, Status, Stopping,
    TrustRegionOptions, adam, auto, continuation, lbfgs, newton, newton_cg, trust_region,
};
#[cfg(feature = "argmin")]
pub use minimize::{ArgminLbfgsOptions, ArgminTrustRegionOptions, argmin_lbfgs, argmin_trust_region};
pub use noise::ObservationErrors;
pub use observation::Observation;
pub use observation_set::{ObservationSet, Prediction};
pub use operators::{LinearObservation, Selection};
pub use outer_loop::{InnerSolver, OuterLoopOptions, outer_loop};
pub use posterior::Posterior;
pub use posterior_lanczos::{LanczosOptions, LowRankPosterior};
pub use propagate::propagate_root;
pub use sensitivity::{ScalarSensitivity, sensitivity, with_held};
pub use varda_implicit::{At, ObservationOperator, Refusal};
pub use weak_posterior::WeakPosterior;

/// The example of README.md, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
