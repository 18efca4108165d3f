//! `[[observations.sensors]]`: force cells and accelerometers on a rod.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::defaults::is_default;
use super::marker::Use;

/// A sensor on a rod. Its readings are forces or accelerations of the state at their time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Sensor {
    /// Its name in the column `sensor`.
    pub name: String,
    /// What it measures.
    pub kind: SensorKind,
    /// Arc length of its place [m]; of a support's force that of the clamp's face or held vertex.
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub arc_length: f64,
    /// Standard deviation of every value where the file has no `sigma`, in the unit of the kind.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub sigma: Option<f64>,
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
    /// Force of a clamp on the rod along its tangent, which points towards greater arc lengths: `force_n` [N].
    AxialSupportForce,
    /// Acceleration of a point of the centreline, in the model's axes: `ax_m_s2`, `ay_m_s2`, `az_m_s2` [m/s²].
    Acceleration,
}

impl SensorKind {
    /// All of them.
    pub const ALL: [SensorKind; 4] = [
        SensorKind::Tension,
        SensorKind::SupportForce,
        SensorKind::AxialSupportForce,
        SensorKind::Acceleration,
    ];

    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            SensorKind::Tension => "tension",
            SensorKind::SupportForce => "support-force",
            SensorKind::AxialSupportForce => "axial-support-force",
            SensorKind::Acceleration => "acceleration",
        }
    }

    /// The columns of its values.
    pub fn columns(self) -> &'static [&'static str] {
        match self {
            SensorKind::Tension => &["tension_n"],
            SensorKind::SupportForce => &["fx_n", "fy_n", "fz_n"],
            SensorKind::AxialSupportForce => &["force_n"],
            SensorKind::Acceleration => &["ax_m_s2", "ay_m_s2", "az_m_s2"],
        }
    }
}
