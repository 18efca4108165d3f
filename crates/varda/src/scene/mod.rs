//! A scene: everything that defines an experiment, as plain data read from TOML.
//!
//! Lengths are metres, times seconds, masses kilograms, angles radians; every key says its unit in its description
//! (`varda schema`). Files named in a scene are relative to the scene's own folder; those given by `--set` to the
//! current one.

// Descriptions are the schema's text too, where a unit stands in plain brackets: rustdoc takes [m] for a link.
#![allow(rustdoc::broken_intra_doc_links)]

mod background;
mod check;
mod file;
mod limits;
mod model;
mod observations;
mod shipped;
mod tree;
mod validate;

pub use background::{
    Background, Covariance, DiagonalCovariance, Kernel, KernelCovariance, Origin, Prior, Root, Taper,
};
pub use file::{Place, SceneFile};
pub use limits::Limits;
pub use model::{
    Clamp, DampingValues, Lorenz63, Lorenz96, Material, Model, Motion, PointForce, PointMass, Prescribed,
    RodModel, Section,
};
pub use observations::{Frame, Marker, Observations, OutsideWindow, Recording, Synthetic, Use};
pub use shipped::{SHIPPED, STARTER, Shipped};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A scene of Varda. SI units throughout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// What the scene shows, in a sentence.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub title: String,
    /// Seed of every random number; truth, background, observations and ensemble draw from independent streams of it.
    #[serde(default)]
    pub seed: u64,
    /// The dynamical system.
    pub model: Model,
    /// Integrator, step and window.
    pub time: Time,
    /// The state the truth of a twin experiment starts from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<Truth>,
    /// The background x_b and its error covariance B.
    pub background: Background,
    /// What is observed, where, when, and with what error.
    pub observations: Observations,
    /// How the cost is minimised.
    #[serde(default)]
    pub algorithm: Algorithm,
    /// What a run may take of the machine.
    #[serde(default)]
    pub limits: Limits,
    /// What the report shows.
    #[serde(default)]
    pub report: Report,
}

impl Scene {
    /// The JSON Schema of a scene, as text.
    pub fn schema() -> String {
        let schema = schemars::schema_for!(Scene);
        serde_json::to_string_pretty(&schema).expect("a schema is plain JSON")
    }

    /// The model is a rod: its control is in metres and metres per second.
    pub fn model_is_rod(&self) -> bool {
        matches!(self.model, Model::Rod(_))
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
    /// Steps in one period 2π/ω of the start clamp's ellipse drive. Give this or `step`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 1))]
    pub steps_per_period: Option<usize>,
    /// Length of the assimilation window, in steps.
    pub window: usize,
    /// Steps from the model's time 0 to the start of the window. A twin's truth is run through them.
    #[serde(default)]
    pub spin_up: usize,
}

/// How a step is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Integrator {
    /// Backward Euler, first order (the paper's choice for the rod).
    BackwardEuler,
    /// Implicit midpoint rule, second order (rods).
    Midpoint,
    /// Second-order backward differences (rods).
    Bdf2,
    /// Explicit Runge–Kutta of fourth order (Lorenz models).
    Rk4,
}

impl Integrator {
    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            Integrator::BackwardEuler => "backward-euler",
            Integrator::Midpoint => "midpoint",
            Integrator::Bdf2 => "bdf2",
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

/// How the cost is minimised.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Algorithm {
    /// The member of the variational family.
    pub method: Method,
    /// The minimizer of methods 4dvar and 3dvar. The others have a loop of their own.
    pub minimizer: Minimizer,
    /// Most outer iterations.
    #[schemars(extend("minimum" = 1))]
    pub max_iterations: usize,
    /// Converged when the gradient in the control variable is this much smaller than at the background.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub gradient_tolerance: f64,
    /// Observation-error continuation: σ of the observations is multiplied by these factors in turn, each stage starting
    /// where the last one ended. The last factor must be 1. Empty: none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sigma_stages: Vec<f64>,
    /// Robust observations (methods 4dvar and 3dvar): departures beyond this many σ count linearly, not squared (Huber norm).
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub robust: Option<f64>,
}

impl Default for Algorithm {
    fn default() -> Self {
        Algorithm {
            method: Method::FourDVar,
            minimizer: Minimizer::Auto,
            max_iterations: 200,
            gradient_tolerance: 1e-8,
            sigma_stages: Vec::new(),
            robust: None,
        }
    }
}

impl Algorithm {
    /// What solves the method's problem, for tables: its minimizer, or the loop of its own.
    pub fn solver_name(&self) -> &'static str {
        match self.method {
            Method::FourDVar | Method::ThreeDVar => self.minimizer.name(),
            Method::FourDVarIncremental | Method::ThreeDVarIncremental => "outer-loop",
            Method::FourDPsas | Method::Psas => "outer-loop-dual",
            Method::Blue => "closed-form",
        }
    }
}

/// A member of the variational family.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Method {
    /// Strong-constraint 4D-Var.
    #[serde(rename = "4dvar")]
    FourDVar,
    /// Incremental 4D-Var: quadratic inner problems in the control space, re-linearized in an outer loop.
    #[serde(rename = "4dvar-incremental")]
    FourDVarIncremental,
    /// 4D-PSAS: the same inner problems solved in observation space (dual).
    #[serde(rename = "4d-psas")]
    FourDPsas,
    /// BLUE, the closed form, linearized once at the background: exact where model and observations are linear; elsewhere one full
    /// Gauss-Newton step, which says "max_iterations" where its gradient is not below the tolerance. Dense.
    #[serde(rename = "blue")]
    Blue,
    /// 3D-Var: everything is observed at step 0.
    #[serde(rename = "3dvar")]
    ThreeDVar,
    /// Incremental 3D-Var: everything is observed at step 0.
    #[serde(rename = "3dvar-incremental")]
    ThreeDVarIncremental,
    /// PSAS, the dual of incremental 3D-Var: everything is observed at step 0.
    #[serde(rename = "psas")]
    Psas,
}

impl Method {
    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            Method::FourDVar => "4dvar",
            Method::FourDVarIncremental => "4dvar-incremental",
            Method::FourDPsas => "4d-psas",
            Method::Blue => "blue",
            Method::ThreeDVar => "3dvar",
            Method::ThreeDVarIncremental => "3dvar-incremental",
            Method::Psas => "psas",
        }
    }

    /// All of them.
    pub const ALL: [Method; 7] = [
        Method::FourDVar,
        Method::FourDVarIncremental,
        Method::FourDPsas,
        Method::Blue,
        Method::ThreeDVar,
        Method::ThreeDVarIncremental,
        Method::Psas,
    ];

    /// Takes a minimizer, and with it σ stages and the Huber norm.
    pub fn takes_minimizer(self) -> bool {
        matches!(self, Method::FourDVar | Method::ThreeDVar)
    }

    /// Analyses one instant: nothing may be observed after step 0.
    pub fn is_of_one_instant(self) -> bool {
        matches!(self, Method::ThreeDVar | Method::ThreeDVarIncremental | Method::Psas)
    }
}

/// A minimizer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Minimizer {
    /// The default: the trust region; where the observations are far from the background (J_o > 10 m) also through
    /// enlarged σ × 10, 3, 1, of the two ends the lower.
    Auto,
    /// Gauss–Newton made safe by a trust region (Levenberg–Marquardt in the B⁻¹ norm).
    TrustRegion,
    /// The paper's Newton: dense Gauss–Newton Hessian (2.18), full steps. May diverge.
    Newton,
    /// Gauss–Newton with truncated conjugate gradients.
    GaussNewtonCg,
    /// Limited-memory BFGS: gradients only.
    Lbfgs,
    /// Adam, the paper's other minimizer: gradients only, slow.
    Adam,
}

impl Minimizer {
    /// All of them.
    pub const ALL: [Minimizer; 6] = [
        Minimizer::Auto,
        Minimizer::TrustRegion,
        Minimizer::Newton,
        Minimizer::GaussNewtonCg,
        Minimizer::Lbfgs,
        Minimizer::Adam,
    ];

    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            Minimizer::Auto => "auto",
            Minimizer::TrustRegion => "trust-region",
            Minimizer::Newton => "newton",
            Minimizer::GaussNewtonCg => "gauss-newton-cg",
            Minimizer::Lbfgs => "lbfgs",
            Minimizer::Adam => "adam",
        }
    }
}

/// What the report shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Report {
    /// Number of instants of the window drawn as snapshots of a rod.
    #[schemars(extend("minimum" = 1, "maximum" = 24))]
    pub snapshots: usize,
    /// Forecast from the end of the window over this time [s], compared with what was recorded then. 0: none.
    #[schemars(extend("minimum" = 0.0, "x-unit" = "s"))]
    pub forecast: f64,
    /// Posterior standard deviations (one tangent run per control component).
    pub posterior: bool,
}

impl Default for Report {
    fn default() -> Self {
        Report { snapshots: 6, forecast: 0.0, posterior: true }
    }
}
