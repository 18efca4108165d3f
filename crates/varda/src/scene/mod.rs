//! A scene: everything that defines an experiment, as plain data read from TOML.
//!
//! Lengths are metres, times seconds, masses kilograms, angles radians; every key says its unit in its
//! description (`varda schema`). Files named in a scene are relative to the scene's own folder; those given
//! by `--set` to the current one.

// Descriptions are the schema's text too, where a unit stands in plain brackets: rustdoc takes [m] for a
// link.
#![allow(rustdoc::broken_intra_doc_links)]

mod algorithm;
mod background;
mod camera;
mod cycles;
mod defaults;
mod ensemble;
mod estimate;
mod file;
mod grid;
mod invalid;
mod limits;
mod loads;
mod marker;
mod method;
mod model;
mod model_error;
mod motion;
mod observations;
mod output;
mod parsed;
mod place;
mod recordings;
mod schema_check;
mod sensor;
mod sequence;
mod shipped;
mod sizes;
mod tree;
mod validate;
mod validate_algorithm;
mod validate_consider;
mod validate_covariance;
mod validate_cycles;
mod validate_estimate;
mod validate_frame;
mod validate_loads;
mod validate_observations;
mod validate_recordings;
mod validate_rod;
mod validate_static;
mod validate_support;

pub use algorithm::Algorithm;
pub use background::{
    Background, ClimatologyCovariance, Covariance, DiagonalCovariance, Draw, Kernel, KernelCovariance,
    KnownState, LineCovariance, Origin, Prior, Root, Taper,
};
pub use camera::Camera;
pub use cycles::{Adaptive, CycledCovariance, Cycles, EnsembleUpdate, Inflation};
pub use ensemble::Ensemble;
pub use estimate::{ConstantPrior, Estimate, PriorSigma, Unknown};
pub(crate) use estimate::{OF_BASE, OF_OBSERVATIONS, OF_PLACES, PriorSpread};
pub(crate) use file::Adjusted;
pub use file::SceneFile;
pub use grid::TimeGrid;
pub(crate) use invalid::{Invalid, rounded};
pub use limits::{DEFAULT_MEMORY, Limits};
pub use loads::{Drag, Force, Moment};
pub use marker::{Marker, Use};
pub use method::{Hessian, Method, Minimizer};
pub use model::{
    Burgers, Clamp, ClampAt, DampingValues, KuramotoSivashinsky, LinearAdvection, Lorenz63, Lorenz96,
    Material, Model, PointMass, Prescribed, RestShape, RodModel, Section, ShapePoints,
};
pub use model_error::ModelError;
pub use motion::{
    Motion, MotionValues, PoseValues, RecordedMarkers, RecordedMotion, RecordedPose, RecordedTurns, Turns,
};
pub use observations::{
    ErrorCorrelation, Frame, Observations, OutsideWindow, Recording, Synthetic, UnreachableRows,
};
pub use output::{Format, Output};
pub(crate) use parsed::{Along, BackgroundSource, ComponentCovariance, LineStep, Shear};
pub use place::Place;
pub use recordings::{Keys, OneRecording};
pub use sensor::{Sensor, SensorKind};
pub use shipped::{SHIPPED, STARTER, Shipped, shipped_data, shipped_scene};
pub use sizes::{DATA_BYTES, NUMBERS, SCENE_BYTES, STEPS, VALUES};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use defaults::is_default;

/// A scene of Varda. SI units throughout. A number is 0 or its size is between 1e-50 and 1e50; a scene has at
/// most 1 MiB and a CSV file 256 MiB; the states of a run have at most 1e9 numbers, and at most 1e7 values
/// are observed. A run that would take more memory than `[limits] memory` (8 GB unless the scene says
/// otherwise) is refused before it begins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// What the scene shows, in a sentence.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub title: String,
    /// Seed of every random number; truth, background, observations and ensemble draw from independent
    /// streams of it.
    #[serde(default)]
    pub seed: u64,
    /// The dynamical system.
    pub model: Model,
    /// Integrator, step and window. Method "static" has none.
    #[serde(default = "Time::of_shapes")]
    pub time: Time,
    /// The state the truth of a twin experiment starts from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<Truth>,
    /// The background x_b and its error covariance B. Method "static" has none: the rod is at rest.
    #[serde(default = "Background::of_shapes")]
    pub background: Background,
    /// What is observed, where, when, and with what error.
    pub observations: Observations,
    /// Constants that are estimated beside the state.
    #[serde(default, skip_serializing_if = "is_default")]
    pub estimate: Estimate,
    /// Constants that are taken for known and are not quite (consider parameters), with keys and σ as in
    /// `[estimate]`: the run says what one σ of each does to its results, all else being as it is.
    #[serde(default, skip_serializing_if = "is_default")]
    pub consider: Estimate,
    /// Several recordings of one system in one estimate: each has a state of its own, the constants of
    /// `[estimate]` are the same. Absent: one, that of `[observations]`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub recordings: Vec<OneRecording>,
    /// How the cost is minimised.
    #[serde(default)]
    pub algorithm: Algorithm,
    /// How much of the machine a run may use.
    #[serde(default)]
    pub limits: Limits,
    /// What the report shows.
    #[serde(default)]
    pub report: Report,
    /// Which files a run leaves.
    #[serde(default)]
    pub output: Output,
}

impl Scene {
    /// The JSON Schema of a scene, as text.
    #[allow(clippy::missing_panics_doc)] // a schema is plain JSON
    pub fn schema() -> String {
        let schema = schemars::schema_for!(Scene);
        serde_json::to_string_pretty(&schema).expect("a schema is plain JSON")
    }
}

/// Integrator, step and window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// How a step is taken.
    pub integrator: Integrator,
    /// Length of a step Δt [s]. Give this or `steps_per_period`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "s"))]
    pub step: Option<f64>,
    /// Steps in one period 2π/ω of the start clamp's ellipse drive, at most 1e9. Give this or `step`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 1, "maximum" = 1000000000))]
    pub steps_per_period: Option<usize>,
    /// Rods: divide every step so that the estimated error of its parts is at most this share of the rod's
    /// length (root mean square over coordinates). The parts are those the background's run needs and stay
    /// the same during a run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub tolerance: Option<f64>,
    /// Length of the assimilation window, in steps; at most 1e7.
    #[schemars(extend("maximum" = 10000000))]
    pub window: usize,
    /// Steps from the model's time 0 to the start of the window. A twin's truth is run through them. At most
    /// 1e7.
    #[serde(default)]
    #[schemars(extend("maximum" = 10000000))]
    pub spin_up: usize,
}

impl Time {
    /// One instant at which a rod is at rest, of a scene without `[time]`.
    pub(crate) fn of_shapes() -> Time {
        let integrator = Integrator::QuasiStatic;
        Time { integrator, step: Some(1.0), steps_per_period: None, tolerance: None, window: 0, spin_up: 0 }
    }
}

/// How a step is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Integrator {
    /// Backward Euler, first order (the paper's choice for the rod).
    BackwardEuler,
    /// Implicit midpoint rule, second order (rods, lines).
    Midpoint,
    /// Second-order backward differences (rods).
    Bdf2,
    /// None: the rod is at rest under its loads at every step, the first included, without inertia and
    /// damping. For supports that move slowly, with `background.covariance.kind = "known"`.
    QuasiStatic,
    /// Explicit Runge–Kutta of fourth order (Lorenz models, lines).
    Rk4,
}

impl Integrator {
    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            Integrator::BackwardEuler => "backward-euler",
            Integrator::Midpoint => "midpoint",
            Integrator::Bdf2 => "bdf2",
            Integrator::QuasiStatic => "quasi-static",
            Integrator::Rk4 => "rk4",
        }
    }
}

/// The state the truth of a twin experiment starts from, before the spin-up.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Truth {
    /// The state at time 0. A rod starts from its static equilibrium instead and has no such key.
    pub state: Vec<f64>,
}

/// What the report shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Report {
    /// Number of instants of the window drawn as snapshots of a rod.
    #[schemars(extend("minimum" = 1, "maximum" = 24))]
    pub snapshots: usize,
    /// Forecast from the end of the window over this time [s], compared with what was recorded then. 0: none.
    /// At most 1e7 steps.
    #[schemars(extend("minimum" = 0.0, "x-unit" = "s"))]
    pub forecast: f64,
    /// Posterior standard deviations (one tangent run per control component).
    pub posterior: bool,
    /// Where constants are estimated from a recording: the same estimate with half the step and, of a rod,
    /// twice the segments, whose difference is added to their σ.
    pub mesh: bool,
}

impl Default for Report {
    fn default() -> Self {
        Report { snapshots: 6, forecast: 0.0, posterior: true, mesh: true }
    }
}
