//! `[background]`: x_b and its error covariance B.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::defaults::is_default;

/// The background x_b at the start of the window and its error covariance B.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Background {
    /// Where x_b comes from.
    pub from: Origin,
    /// The CSV file of `from = "file"`. A rod's has the header `vertex,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s` and
    /// one row for every free vertex; where both ends are clamped perhaps `end_angle_rad`, the angle of
    /// the end clamp with its whole turns, the same in every row; where angles and spins are unknowns
    /// `theta_rad,spin_rad_s`, of the edge after the vertex, and a held vertex has these alone. Another
    /// model's has the header
    /// `component,value`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// What the error of x_b in a twin experiment is drawn from.
    #[serde(default, skip_serializing_if = "is_default")]
    pub draw: Draw,
    /// The error covariance B.
    pub covariance: Covariance,
}

impl Background {
    /// That of a scene without `[background]`: a rod at rest, whose shape follows from its constants.
    pub(crate) fn of_shapes() -> Background {
        Background {
            from: Origin::StaticEquilibrium,
            file: None,
            draw: Draw::Covariance,
            covariance: Covariance::Known(KnownState {}),
        }
    }
}

/// What the error of x_b in a twin experiment is drawn from.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Draw {
    /// The covariance B that is assumed: σ_a then describes the errors of the analysis.
    #[default]
    Covariance,
    /// The kernel of B without its taper, as in the paper: B then overestimates the errors between places far
    /// from each other, and σ_a of velocities is too large.
    Kernel,
}

/// Where x_b comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Origin {
    /// A twin experiment: the truth at the start of the window plus an error drawn from B (see `draw`).
    TruthPlusDraw,
    /// A CSV file.
    File,
    /// The rod's static equilibrium at the start of the window, at rest.
    StaticEquilibrium,
}

/// An error covariance B.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Covariance {
    /// Independent errors of one σ in every component (Lorenz models, lines).
    Diagonal(DiagonalCovariance),
    /// A multiple of the covariance of the states the model passes through (Lorenz models).
    Climatology(ClimatologyCovariance),
    /// A kernel in arc length times a taper; x, y, z alike and independent, positions and velocities too
    /// (rods).
    Kernel(KernelCovariance),
    /// A kernel in the distance along a line times a taper (linear-advection, burgers).
    Line(LineCovariance),
    /// No error: the state at the start of the window is known, and only the constants of [estimate] are not.
    Known(KnownState),
}

impl Covariance {
    /// This covariance with every σ multiplied by `factor`.
    pub(crate) fn scaled(&self, factor: f64) -> Covariance {
        let by = |sigma: Option<f64>| sigma.map(|s| factor * s);
        match self.clone() {
            Covariance::Diagonal(d) => Covariance::Diagonal(DiagonalCovariance { sigma: factor * d.sigma }),
            Covariance::Climatology(c) => {
                Covariance::Climatology(ClimatologyCovariance { scale: factor * factor * c.scale, ..c })
            }
            Covariance::Line(k) => Covariance::Line(LineCovariance { sigma: factor * k.sigma, ..k }),
            Covariance::Known(known) => Covariance::Known(known),
            Covariance::Kernel(k) => Covariance::Kernel(KernelCovariance {
                sigma_x: by(k.sigma_x),
                sigma_x_over_length: by(k.sigma_x_over_length),
                sigma_v: by(k.sigma_v),
                sigma_v_over_mean_speed: by(k.sigma_v_over_mean_speed),
                sigma_theta: by(k.sigma_theta),
                sigma_spin: by(k.sigma_spin),
                ..k
            }),
        }
    }

    /// Whether there is no error: only the constants of [estimate] are unknown.
    pub(crate) fn is_of_known_state(&self) -> bool {
        matches!(self, Covariance::Known(_))
    }

    /// The kind of its square root.
    pub(crate) fn root(&self) -> Root {
        match self {
            Covariance::Diagonal(_) | Covariance::Climatology(_) => Root::Cholesky,
            Covariance::Kernel(k) => k.root(),
            Covariance::Line(k) => k.root(),
            Covariance::Known(_) => Root::Truncated,
        }
    }
}

/// A state without error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct KnownState {}

/// Independent errors of one σ.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DiagonalCovariance {
    /// Standard deviation of every component.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub sigma: f64,
}

/// Errors like the model's own variations: the covariance of the states of a long run, scaled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ClimatologyCovariance {
    /// Factor on the covariance (the square of one on standard deviations).
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub scale: f64,
    /// Steps of the run, which begins where the truth of a twin experiment does, after `time.spin_up`; the
    /// same for every seed.
    #[serde(default = "default_steps")]
    #[schemars(extend("minimum" = 1, "maximum" = 100000000))]
    pub steps: usize,
}

fn default_steps() -> usize {
    100_000
}

/// Errors correlated along the rod: σ² k(s_i, s_j) taper(|s_i − s_j|).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct KernelCovariance {
    /// Standard deviation σ_x of a position component [m]. Give this or `sigma_x_over_length`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub sigma_x: Option<f64>,
    /// σ_x over the length of the rod.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub sigma_x_over_length: Option<f64>,
    /// Standard deviation σ_v of a velocity component [m/s]. Give this or `sigma_v_over_mean_speed`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m/s"))]
    pub sigma_v: Option<f64>,
    /// σ_v over v̄, the mean speed of the free vertices at the start of the window (of the truth, or of x_b
    /// if there is no truth).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub sigma_v_over_mean_speed: Option<f64>,
    /// Standard deviation of the angle of a section [rad], with `model.twist_inertia`. With this and
    /// `sigma_spin` angles and spins at the start are unknowns, the control [X₀, V₀, θ₀, ω₀];
    /// without, angles are in equilibrium and nothing spins. Correlated over L_x.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "rad"))]
    pub sigma_theta: Option<f64>,
    /// Standard deviation of the spin of a section [rad/s]. Correlated over L_v.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "rad/s"))]
    pub sigma_spin: Option<f64>,
    /// Correlation length L_x of positions [m].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub correlation_length_x: f64,
    /// Correlation length L_v of velocities [m].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub correlation_length_v: f64,
    /// Shape of the kernel.
    #[serde(default)]
    pub kernel: Kernel,
    /// Shape of the taper (localization). Without it a `localization_length` means "triangle", and without
    /// both there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub taper: Option<Taper>,
    /// Length L_loc beyond which errors are uncorrelated [m]. Needed with a taper.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub localization_length: Option<f64>,
    /// Whether the kernel knows that prescribed vertices have no error.
    #[serde(default)]
    pub prior: Prior,
    /// The square root B^{1/2}. A Matérn kernel without a taper has its Cholesky root in O(n), by a
    /// recursion along the line (not on a circle), unless this says "truncated". Other kernels, where this is
    /// left out: "cholesky" where B is positive definite to working precision, else "truncated".
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub root: Option<Root>,
    /// Eigenvalues below this fraction of the largest are left out of a truncated root.
    #[serde(default = "default_truncation")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "maximum" = 1.0))]
    pub truncation: f64,
}

fn default_truncation() -> f64 {
    1e-12
}

/// Errors correlated along a line: σ² k(d_ij) taper(d_ij). On a line that closes to a circle d is the
/// chord, in which every kernel is a covariance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LineCovariance {
    /// Standard deviation of every component.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub sigma: f64,
    /// Correlation length [m].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub correlation_length: f64,
    /// Shape of the kernel.
    #[serde(default)]
    pub kernel: Kernel,
    /// Shape of the taper (localization). Without it a `localization_length` means "gaspari-cohn", and
    /// without both there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub taper: Option<Taper>,
    /// Length L_loc beyond which errors are uncorrelated [m]. Needed with a taper.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub localization_length: Option<f64>,
    /// The square root B^{1/2}. A Matérn kernel without a taper has its Cholesky root in O(n), by a
    /// recursion along the line (not on a circle), unless this says "truncated". Other kernels, where this is
    /// left out: "cholesky" where B is positive definite to working precision, else "truncated".
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub root: Option<Root>,
    /// Eigenvalues below this fraction of the largest are left out of a truncated root.
    #[serde(default = "default_truncation")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "maximum" = 1.0))]
    pub truncation: f64,
}

/// Shape of a kernel k(d) of the distance d, L its correlation length.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Kernel {
    /// exp(−d²/(2L²)): so smooth that errors shorter than L are taken to be impossible, and σ_a is too
    /// small where there are some.
    #[serde(rename = "gaussian")]
    Gaussian,
    /// Matérn with ν = 1/2: exp(−d/L).
    #[serde(rename = "matern-1/2")]
    Matern12,
    /// Matérn with ν = 3/2: (1 + √3 d/L) exp(−√3 d/L).
    #[serde(rename = "matern-3/2")]
    Matern32,
    /// Matérn with ν = 5/2: (1 + √5 d/L + 5d²/(3L²)) exp(−√5 d/L). Smooth enough for the curvature
    /// of a rod to be finite.
    #[default]
    #[serde(rename = "matern-5/2")]
    Matern52,
}

/// Shape of a taper, zero from the localization length on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Taper {
    /// max(0, 1 − d/L_loc), the paper's. It has a kink at d = 0, so that errors of neighbouring vertices
    /// are nearly independent.
    Triangle,
    /// Gaspari and Cohn's fifth-order function (1999, eq. 4.10).
    GaspariCohn,
    /// No localization.
    None,
}

/// Whether the kernel knows about the supports.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Prior {
    /// Conditioned on zero error at the prescribed vertices.
    #[default]
    Clamp,
    /// The kernel as it is.
    Plain,
}

/// The square root of B.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Root {
    /// Cholesky; B must be positive definite to working precision.
    Cholesky,
    /// Eigenvectors of the larger eigenvalues; for smooth kernels without a taper, which are singular.
    Truncated,
}
