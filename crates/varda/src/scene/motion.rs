//! How the supports of a rod move.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::defaults::is_default;
use super::observations::Frame;

/// How a support moves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Motion {
    /// The paper's drive, added to the support's position: a(t) (r_x cos ωt, r_y sin ωt, 0), faded in by a
    /// quintic ramp a(t).
    Ellipse {
        /// Semi-axes r_x, r_y [m].
        #[schemars(extend("x-unit" = "m"))]
        radii: [f64; 2],
        /// Angular frequency ω [rad/s].
        #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "rad/s"))]
        omega: f64,
        /// Duration of the ramp in periods 2π/ω; 0 for none.
        #[schemars(extend("minimum" = 0.0))]
        ramp_periods: f64,
    },
    /// From a CSV file.
    Table(Box<RecordedMotion>),
}

/// A motion from a CSV file with the header `time_s,x_m,y_m,z_m`, which has to cover the whole run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordedMotion {
    /// The file.
    pub file: String,
    /// Time in the file at which the model's clock reads 0 [s].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "s"))]
    pub time_zero: f64,
    /// The file's axes in those of the model.
    #[serde(default, skip_serializing_if = "is_default")]
    pub frame: Frame,
    /// What the rows are.
    #[serde(default, skip_serializing_if = "is_default")]
    pub values: MotionValues,
    /// Standard deviation of a coordinate [m]: the rows are smoothed by as much. 0: straight lines from row
    /// to row. Absent: estimated, where the rows look like a smooth motion with errors of a camera; else 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub sigma: Option<f64>,
}

/// What the rows of a motion are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MotionValues {
    /// Added to the support's position.
    #[default]
    Displacement,
    /// Places; the support's position is not used.
    Absolute,
}
