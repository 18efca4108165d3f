//! Discrete elastic rods: cables, tethers, soft robots.
//!
//! A rod is a polyline of vertices x_i \[m\] whose segments stretch, bend and twist (Bergou et al. 2008,
//! 2010):
//!
//! ```text
//! E = ½ Σ EA (l − l̄)²/l̄ + ½ Σ (κ − κ̄)ᵀ EI (κ − κ̄)/l̄_i
//!     + ½ Σ GJ (τ − τ̄)²/l̄_i
//! κb_i = 2 t^{i−1} × t^i / (1 + t^{i−1}·t^i)
//! κ₁ = ½(m₂^{i−1} + m₂^i)·κb_i,   κ₂ = −½(m₁^{i−1} + m₁^i)·κb_i
//! ```
//!
//! | to | there is |
//! |---|---|
//! | describe a rod | [`Rod`]; [`Material`] and [`Section`] for a uniform one |
//! | hold it | [`Supports`] with [`Clamp`] and [`Motion`] |
//! | move its supports as they were recorded | [`RecordedMotion`], [`RecordedRotation`] with [`SmoothBy`] |
//! | pull at it, turn it, slow it down | [`Loads`], [`FollowerForce`], [`Moment`], [`Drag`], [`Damping`] |
//! | load it in another way | the trait [`Load`], tested by [`check::load`] |
//! | let twist travel in waves | [`Rod::with_rotary_inertia`] |
//! | move it in time | [`RodStep`], a step for [`varda_implicit::ImplicitModel`] |
//! | find its shape at rest | [`equilibrium`] from [`straight_guess`] |
//! | find its natural modes | [`modes()`]: [`Modes`], each a [`Mode`] |
//! | find tension, moments, reactions | [`internal_forces()`]: [`InternalForces`] with every [`Reaction`] |
//! | find curvature and rate of twist | [`RodStep::curvature`] |
//! | observe points on it | [`Markers`], a [`varda_implicit::ObservationOperator`] |
//! | observe forces, accelerations, angular rates | [`Sensors`], each a [`Sensor`] |
//! | use its energy elsewhere | [`derivatives`]: gradient and Hessian; [`energy`] of any [`Real`] number |
//!
//! A step is by backward Euler, the midpoint rule or BDF2: a pure function of (k, x_k), O(n), with exact
//! tangent and adjoint.
//!
//! # When to use
//!
//! For thin bodies that bend far: small strains (Hooke's law) and large rotations. Units are SI throughout:
//! m, kg, s, N, rad.
//!
//! # Limitations
//!
//! Sections stay plane and rigid: no shear. They have no inertia, and θ is massless, but for that against a
//! spin about the tangent where it is asked for ([`Rod::with_rotary_inertia`]); a section that spins has no
//! gyroscopic moment. There is no contact.
//! For stubby beams (length under about ten heights) shear matters at the per cent level and this is the
//! wrong model; for a rod that never bends far, a linear beam is cheaper.
//!
//! # Errors
//!
//! Impossible descriptions and configurations are values of [`Error`] that name the field, edge or vertex.
//! Slices of a wrong length panic, as each item says.
//!
//! # Range
//!
//! Measured by the suite `stiff` (`docs/results/stability.md`): a step of backward Euler ends within 1e-11 L
//! of its root, mostly at rounding, for E from 1e5 to 1e12 Pa, L/r from 10 to 1e5, EA l²/EI from 1 to 1e10,
//! 25 to 20 000 segments, clamps that move 0.1 to 10 segments in a step, steps of 1e-6 to 10 periods of a
//! pendulum, and starts with 15 % of random strain; its tangent and adjoint are those of that root. A turn
//! within 1e-6 rad of π, an edge without length, a vertex without mass and a value that is not finite are
//! errors that name it; from turns within 1e-5 rad of π a step may end as an error that names the step. At
//! steps of 1e-6 s velocities, differences of places over Δt, carry 1e-10 m/s of rounding.
//!
//! What a rod does not need is left out: twist angles where they are provably zero (isotropic, naturally
//! straight, one held director), bending for a chain, prescribed degrees of freedom; [`RodStep::left_out`]
//! lists it.
//!
//! # References
//!
//! - Bergou, Wardetzky, Robinson, Audoly, Grinspun (2008): Discrete elastic rods.
//! - Bergou, Audoly, Vouga, Wardetzky, Grinspun (2010): Discrete viscous threads. Time-parallel frames,
//!   Hessians.
//!
//! # Example
//!
//! A rod of silicone hangs from a clamp that moves sideways; where is its tip after one second?
//!
//! ```
//! use varda_implicit::{ImplicitModel, Model};
//! use varda_rod::{Clamp, ClampAt, Damping, Loads, Material, Rod, RodStep, Section, Supports, Vector3};
//!
//! let material = Material::new(1e6, 0.5, 1100.0);
//! let rod = Rod::uniform_between(1.0, 20, &Section::circle(&material, 0.01), [true, false])?;
//! let s = rod.arc_lengths(); // from the clamp's face
//! let clamp = Clamp::new(ClampAt::Face, |t: f64| [0.1 * t * t, 0.0, 0.0], -Vector3::z(), Vector3::x());
//! let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
//! let step = RodStep::new(rod, Supports::clamped_start(clamp), loads, Damping::default())?;
//!
//! // Hanging straight down, at rest: control z = [X₀, V₀] of the free vertices.
//! let mut z = vec![0.0; step.control_len()];
//! for (i, &v) in step.free_vertices().iter().enumerate() {
//!     z[3 * i + 2] = -s[v];
//! }
//! let mut model = ImplicitModel::new(step, 0, 0.01);
//! let mut x = vec![0.0; model.dim()];
//! model.initial_state(&z, &mut x)?;
//! for k in 0..100 {
//!     let mut next = vec![0.0; model.dim()];
//!     model.step(k, &x, &mut next)?;
//!     x = next;
//! }
//! let tip = &x[model.step_ref().control_len() / 2 - 3..][..3];
//! assert!(tip[0] > 0.0 && tip[0] < 0.1, "it lags behind its clamp");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod along;
mod at_rest;
mod camera;
mod change;
pub mod check;
mod clamp_frame;
mod curvature;
mod damping;
mod dynamics;
mod element;
mod energy;
mod equations;
mod equilibrium;
mod error;
mod forces_of_motion;
mod forces_tangent;
mod geometry;
mod implicit_step;
mod internal_forces;
mod layout;
mod load;
mod loaded;
mod marker;
mod material;
mod modes;
mod moved;
mod moved_increment;
mod moved_second;
mod moved_together;
mod parameters;
mod predict;
mod quasi_static;
mod read_rotations;
mod recorded;
mod rod;
pub mod rotation;
mod scalar;
mod second_order;
mod second_parameters;
mod second_step;
mod sensor;
mod sensor_rows;
mod sensors;
mod shape;
mod spin;
mod spin_advance;
mod stage;
mod statics;
mod support;
mod system;
mod twist_equilibrium;
mod views;

pub use camera::{Camera, OutOfSight};
pub use change::{Change, Parameter};
pub use curvature::Curvature;
pub use dynamics::{RodStep, TwistUnknowns};
pub use energy::{Derivatives, Energy, Framed, derivatives, energy};
pub use equations::RodEquations;
pub use equilibrium::{Rest, equilibrium, straight_guess};
pub use error::Error;
pub use internal_forces::{InternalForces, internal_forces};
pub use load::drag::Drag;
pub use load::follower::FollowerForce;
pub use load::moment::Moment;
pub use load::{EdgeLoad, EdgeMotion, Load};
pub use marker::{Marker, Markers};
pub use material::{Material, Section};
pub use modes::{Mode, Modes, modes};
pub use moved::{Displacement, HeldAt, Moved, MovedBy};
pub use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
pub use num_dual::Dual64;
pub use read_rotations::{ReadRotations, tilt};
pub use recorded::{
    RecordedMotion, RecordedRotation, SmoothBy, Smoothing, noise_of_rotations, noise_of_rows,
};
pub use rod::{Place, Rod};
pub use scalar::Real;
pub use sensor::Sensor;
pub use sensors::Sensors;
pub use statics::continuation::{Found, Search, rest};
pub use statics::reactions::Reaction;
pub use support::{Clamp, ClampAt, Damping, EllipseDrive, Loads, Motion, Supports};
pub use varda_implicit::Law;
pub use views::{NotSeen, View, Views};

/// The example of README.md, compiled and run with the tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
