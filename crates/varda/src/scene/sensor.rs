//! `[[observations.sensors]]`: cells of forces and moments, accelerometers and gyroscopes on a rod.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::defaults::is_default;
use super::marker::Use;

/// A sensor on a rod. Its readings are forces, moments, accelerations, angular rates or rotations of the
/// state at their time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Its name in the column `sensor`.
    pub name: String,
    /// What it measures.
    pub kind: SensorKind,
    /// Arc length of its place [m]; of a support's force or moment that of the clamp's face or held vertex.
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub arc_length: f64,
    /// Standard deviation of every value where the file has no `sigma`, in the unit of the kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub sigma: Option<f64>,
    /// Axes of an accelerometer or of a body along (m₁, m₂, t) of its section, a row for each; of kinds
    /// "specific-force" and "orientation". Absent: those of the section.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axes: Option<[[f64; 3]; 3]>,
    /// What it is used for.
    #[serde(default, rename = "use", skip_serializing_if = "is_default")]
    pub used: Use,
}

/// What a sensor measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SensorKind {
    /// Tension of the rod, positive where it is pulled: column `tension_n` [N].
    Tension,
    /// Force of a support on the rod, in the model's axes: `fx_n`, `fy_n`, `fz_n` [N].
    SupportForce,
    /// Force of a clamp on the rod along its tangent, which points towards greater arc lengths:
    /// `force_n` [N].
    AxialSupportForce,
    /// Moment of a clamp on the rod about the clamp's place, in the model's axes: `mx_n_m`, `my_n_m`,
    /// `mz_n_m` [N m].
    SupportMoment,
    /// Moments within the rod, as strain gauges read them: `m1_n_m` and `m2_n_m`, which bend it as κ₁
    /// and κ₂, and `t_n_m`, which twists it [N m].
    Moment,
    /// Acceleration of a point of the centreline, in the model's axes: `ax_m_s2`, `ay_m_s2`, `az_m_s2`
    /// [m/s²].
    Acceleration,
    /// What an accelerometer fixed to a section reads, acceleration less gravity along its axes:
    /// `fx_m_s2`, `fy_m_s2`, `fz_m_s2` [m/s²]; at rest 9.81 upwards.
    SpecificForce,
    /// Direction of the rod, its unit tangent towards greater arc lengths, in the model's axes: `tx`, `ty`,
    /// `tz`, with σ in rad. Observed are the two angles by which the rod is turned from it.
    Direction,
    /// Orientation of a body that is fixed to a section: `qx`, `qy`, `qz`, `qw`, the unit quaternion that
    /// turns the body's axes into the model's, with σ in rad. Observed is the rotation vector from it.
    Orientation,
    /// Angular rate of a section across its tangent, along m₁ and m₂: `w1_rad_s`, `w2_rad_s` [rad/s].
    AngularRate,
    /// Angular rate of a section about its tangent, of a rod with `twist_inertia`: `spin_rad_s` [rad/s].
    Spin,
}

impl SensorKind {
    /// All of them.
    pub const ALL: [SensorKind; 11] = [
        SensorKind::Tension,
        SensorKind::SupportForce,
        SensorKind::AxialSupportForce,
        SensorKind::SupportMoment,
        SensorKind::Moment,
        SensorKind::Acceleration,
        SensorKind::SpecificForce,
        SensorKind::Direction,
        SensorKind::Orientation,
        SensorKind::AngularRate,
        SensorKind::Spin,
    ];

    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            SensorKind::Tension => "tension",
            SensorKind::SupportForce => "support-force",
            SensorKind::AxialSupportForce => "axial-support-force",
            SensorKind::SupportMoment => "support-moment",
            SensorKind::Moment => "moment",
            SensorKind::Acceleration => "acceleration",
            SensorKind::SpecificForce => "specific-force",
            SensorKind::Direction => "direction",
            SensorKind::Orientation => "orientation",
            SensorKind::AngularRate => "angular-rate",
            SensorKind::Spin => "spin",
        }
    }

    /// The columns of what it reads.
    pub fn columns(self) -> &'static [&'static str] {
        match self {
            SensorKind::Tension => &["tension_n"],
            SensorKind::SupportForce => &["fx_n", "fy_n", "fz_n"],
            SensorKind::AxialSupportForce => &["force_n"],
            SensorKind::SupportMoment => &["mx_n_m", "my_n_m", "mz_n_m"],
            SensorKind::Moment => &["m1_n_m", "m2_n_m", "t_n_m"],
            SensorKind::Acceleration => &["ax_m_s2", "ay_m_s2", "az_m_s2"],
            SensorKind::SpecificForce => &["fx_m_s2", "fy_m_s2", "fz_m_s2"],
            SensorKind::Direction => &["tx", "ty", "tz"],
            SensorKind::Orientation => &["qx", "qy", "qz", "qw"],
            SensorKind::AngularRate => &["w1_rad_s", "w2_rad_s"],
            SensorKind::Spin => &["spin_rad_s"],
        }
    }

    /// Number of its values that are observed: a direction has two degrees of freedom, an orientation three.
    pub fn values(self) -> usize {
        match self {
            SensorKind::Direction => 2,
            SensorKind::Orientation => 3,
            other => other.columns().len(),
        }
    }

    /// Whether it has axes of its own.
    pub(crate) fn has_axes(self) -> bool {
        matches!(self, SensorKind::SpecificForce | SensorKind::Orientation)
    }
}
