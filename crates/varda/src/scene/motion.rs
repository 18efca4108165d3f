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
    /// Place and directions from a CSV file.
    Pose(Box<RecordedPose>),
    /// From markers of the observation file.
    Markers(Box<RecordedMarkers>),
}

/// What a motion says of a support by itself, so that its own keys do not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Said {
    pub(crate) place: bool,
    pub(crate) tangent: bool,
    pub(crate) director: bool,
}

impl Motion {
    pub(crate) fn says(&self) -> Said {
        let (place, tangent, director) = match self {
            Motion::Ellipse { .. } => (false, false, false),
            Motion::Table(keys) => (keys.values == MotionValues::Absolute, false, false),
            Motion::Pose(keys) => [keys.values == PoseValues::Absolute; 3].into(),
            Motion::Markers(keys) => {
                let absolute = keys.values == PoseValues::Absolute;
                (absolute, absolute && keys.names.len() >= 2, absolute && keys.names.len() >= 3)
            }
        };
        Said { place, tangent, director }
    }
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
    /// The rows are smoothed so that an amplitude at this frequency is halved [Hz]; instead of `sigma`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "Hz"))]
    pub cutoff: Option<f64>,
}

/// Places and rotations of a body from a CSV file with the header `time_s,x_m,y_m,z_m,qx,qy,qz,qw`, which has
/// to cover the whole run. (qx, qy, qz, qw) is the unit quaternion that turns the body's axes into those of
/// the file, real part last; q and −q are the same. Between rows it turns smoothly, with continuous angular
/// velocity and acceleration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordedPose {
    /// The file.
    pub file: String,
    /// Time in the file at which the model's clock reads 0 [s].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "s"))]
    pub time_zero: f64,
    /// The file's axes in those of the model: places and rotations are turned, places displaced.
    #[serde(default, skip_serializing_if = "is_default")]
    pub frame: Frame,
    /// What the rows are.
    #[serde(default, skip_serializing_if = "is_default")]
    pub values: PoseValues,
    /// Standard deviation of a coordinate [m]: places are smoothed by as much. 0: a spline through every row.
    /// Absent: estimated, where the rows look like a smooth motion with errors of a camera; else 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub sigma: Option<f64>,
    /// Standard deviation of a rotation about each axis [rad], as `sigma` for places.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0, "x-unit" = "rad"))]
    pub sigma_angle: Option<f64>,
    /// Places and rotations are smoothed so that an amplitude at this frequency is halved [Hz]; instead of
    /// `sigma` and `sigma_angle`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "Hz"))]
    pub cutoff: Option<f64>,
    /// The rod's tangent towards growing arc length, in the body's axes.
    #[serde(default = "local_x", skip_serializing_if = "is_local_x")]
    pub tangent_axis: [f64; 3],
    /// The rod's director m₁, in the body's axes.
    #[serde(default = "local_z", skip_serializing_if = "is_local_z")]
    pub director_axis: [f64; 3],
    /// From the recorded point to the support's place, in the body's axes [m].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "m"))]
    pub offset: [f64; 3],
}

fn local_x() -> [f64; 3] {
    [1.0, 0.0, 0.0]
}

fn local_z() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

fn is_local_x(axis: &[f64; 3]) -> bool {
    *axis == local_x()
}

fn is_local_z(axis: &[f64; 3]) -> bool {
    *axis == local_z()
}

/// What the rows of a pose are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PoseValues {
    /// The support's place and directions.
    #[default]
    Absolute,
    /// A motion that carries the support: its own place and directions are those at model time 0.
    Displacement,
}

/// A support that follows markers of the observation file, with its clock and axes. Their rows are not
/// assimilated.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordedMarkers {
    /// Their names. One: it is at the support's place. Two: the first is there, the second ahead of it along
    /// the tangent; the section does not spin about the tangent. Three or more of a rigid body: the first is
    /// there, the second ahead along the tangent, the third towards m₁ from the first (as far as that is
    /// across the tangent); rows without one of them count while three are seen.
    pub names: Vec<String>,
    /// Whether the markers are at the support's place and along its directions, or somewhere on the body that
    /// holds it.
    #[serde(default, skip_serializing_if = "is_default")]
    pub values: PoseValues,
    /// Standard deviation of a coordinate [m]: the motion is smoothed by as much. 0: a spline through every
    /// row. Absent: that of the observations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub sigma: Option<f64>,
    /// The motion is smoothed so that an amplitude at this frequency is halved [Hz]; instead of `sigma`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "Hz"))]
    pub cutoff: Option<f64>,
    /// From the first marker to the support's place, along (m₁, m₂, t) [m]; with three markers or more.
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "m"))]
    pub offset: [f64; 3],
}

/// Turns of a clamp about its tangent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Turns {
    /// As many all the time.
    Constant(f64),
    /// From a CSV file.
    Recorded(RecordedTurns),
}

/// Turns from a CSV file with the header `time_s,turns`, which has to cover the whole run: straight lines
/// from row to row.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecordedTurns {
    /// The file.
    pub file: String,
    /// Time in the file at which the model's clock reads 0 [s].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "s"))]
    pub time_zero: f64,
}

/// What the rows of a motion are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MotionValues {
    /// Added to the support's position.
    #[default]
    Displacement,
    /// Places; the support's own position is not used.
    Absolute,
}
