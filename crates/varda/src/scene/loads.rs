//! What pulls at a rod, turns it and slows it down.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::defaults::is_default;
use super::observations::Frame;

/// A force on a point of the rod: `force`, or rows of a `file`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Force {
    /// Arc length of the point [m].
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub arc_length: f64,
    /// The force [N]; of one that follows, along (m₁, m₂, t).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "N"))]
    pub force: Option<[f64; 3]>,
    /// A CSV file with the header `time_s,fx_n,fy_n,fz_n` (of one that follows: `time_s,f1_n,f2_n,ft_n`),
    /// which has to cover the whole run; straight lines between its rows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Time in the file at which the model's clock reads 0 [s].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "s"))]
    pub time_zero: f64,
    /// The file's axes in those of the model, of which only the rotation counts.
    #[serde(default, skip_serializing_if = "is_default")]
    pub frame: Frame,
    /// It turns with the edge it acts on.
    #[serde(default, skip_serializing_if = "is_default")]
    pub follower: bool,
}

/// A moment on a point of the rod: `moment`, `twist`, or rows of a `file`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Moment {
    /// Arc length of the point [m].
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub arc_length: f64,
    /// The moment [N m], which keeps its direction in space.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "N m"))]
    pub moment: Option<[f64; 3]>,
    /// A moment about the rod's tangent, whichever way that points [N m].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "N m"))]
    pub twist: Option<f64>,
    /// A CSV file with the header `time_s,mx_nm,my_nm,mz_nm` (about the tangent: `time_s,twist_nm`), which
    /// has to cover the whole run; straight lines between its rows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Time in the file at which the model's clock reads 0 [s].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "s"))]
    pub time_zero: f64,
    /// The file's axes in those of the model, of which only the rotation counts.
    #[serde(default, skip_serializing_if = "is_default")]
    pub frame: Frame,
}

/// Drag of the fluid around the rod: a force per length ½ ρ d C |u| u across and along it, u the velocity
/// of the fluid past the rod. Buoyancy and added mass are not in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Drag {
    /// Density ρ of the fluid [kg/m³].
    #[schemars(extend("minimum" = 0.0, "x-unit" = "kg/m³"))]
    pub fluid_density: f64,
    /// Diameter d across the flow [m].
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub diameter: f64,
    /// Coefficient C across the rod.
    #[serde(default = "normal")]
    #[schemars(extend("minimum" = 0.0))]
    pub normal: f64,
    /// Coefficient C along it.
    #[serde(default = "tangential")]
    #[schemars(extend("minimum" = 0.0))]
    pub tangential: f64,
    /// Velocity of the fluid [m/s].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "m/s"))]
    pub flow: [f64; 3],
}

fn normal() -> f64 {
    1.2
}

fn tangential() -> f64 {
    0.01
}
