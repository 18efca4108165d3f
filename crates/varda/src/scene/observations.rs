//! `[observations]`: what is observed, where, when, and with what error.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::background::Kernel;
use super::camera::Camera;
use super::defaults::is_default;
use super::marker::Marker;
use super::sensor::Sensor;

/// What is observed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum Observations {
    /// Drawn around the truth of a twin experiment.
    Synthetic(Synthetic),
    /// Read from a CSV file.
    File(Box<Recording>),
}

/// Observations drawn around the truth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Synthetic {
    /// Arc lengths of the observed points of a rod [m]; all three coordinates are observed, if σ of them is
    /// given, and the pixels of `cameras`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    #[schemars(extend("x-unit" = "m"))]
    pub places: Vec<f64>,
    /// Observed components of the state of another model, from 0. Empty: all.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub components: Vec<usize>,
    /// Observed every so many steps, the first time after that many. Give this or `steps`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 1))]
    pub every: Option<usize>,
    /// Observed after these numbers of steps of the window.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub steps: Option<Vec<usize>>,
    /// Standard deviation of an observed value [m]. Give this or `sigma_over_length`, or `cameras` or
    /// `sensors` alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub sigma: Option<f64>,
    /// Standard deviation of an observed coordinate over the length of the rod.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub sigma_over_length: Option<f64>,
    /// Cameras that see the places of a rod, each with its `sigma`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<Camera>,
    /// Sensors of forces, accelerations and angular rates on a rod, each with its `sigma`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<Sensor>,
    /// Correlation of the errors. Absent: all errors are independent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correlation: Option<ErrorCorrelation>,
}

/// Observations read from a CSV file. Rods: with the header `time_s,s_m,x_m,y_m,z_m` or
/// `time_s,marker,x_m,y_m,z_m` and, if wanted, columns `sigma_m` and, beside names, `s_m`: the place of a
/// marker that `markers` does not list. Other models: `time_s,component,value`
/// (a component's name, as `x3`, or its number from 0) or, of a field along a line, `time_s,s_m,value` (a
/// place between two points is on the cubic through four), and, if wanted, `sigma`. An empty cell or a
/// missing row was not observed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// The file. May be left to `--set observations.file=…`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// The file of what `cameras` saw of markers, `time_s,camera,marker,u_px,v_px` and, if wanted,
    /// `sigma_px`; beside `file`, or alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixels: Option<String>,
    /// The cameras of `pixels`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cameras: Vec<Camera>,
    /// The file of what `sensors` read, `time_s,sensor`, the columns of their kinds and, if wanted, `sigma`;
    /// beside `file`, or alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub readings: Option<String>,
    /// The sensors of `readings`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sensors: Vec<Sensor>,
    /// Time in the recording at which the model's clock reads 0 [s].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "s"))]
    pub time_zero: f64,
    /// Standard deviation of every coordinate where the file has no `sigma_m` [m]; of other models, of every
    /// value where it has no `sigma`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub sigma: Option<f64>,
    /// Correlation of the errors. Absent: all errors are independent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correlation: Option<ErrorCorrelation>,
    /// The recording's axes in those of the model.
    #[serde(default, skip_serializing_if = "is_default")]
    pub frame: Frame,
    /// What to do with rows outside the window.
    #[serde(default)]
    pub outside_window: OutsideWindow,
    /// What to do with rows that cannot be true: farther from where the rod is held than the rod between,
    /// with the strain of the taut rod and 4 σ (more of many rows: 5.8 of 6000); labels of two markers
    /// exchanged; jumps faster than `max_speed`; pixels outside the image.
    #[serde(default, skip_serializing_if = "is_default")]
    pub unreachable: UnreachableRows,
    /// The fastest that a marker moves [m/s]. Absent: five times the sum of the supports' greatest speed,
    /// √(2 g L), and ½ L (1.875/L)² √(EI/μ), a cantilever that swings by half its length.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m/s"))]
    pub max_speed: Option<f64>,
    /// The markers of the recording and their places on the rod.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub markers: Vec<Marker>,
    /// Markers of the recording that are not on the rod.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ignore: Vec<String>,
}

/// Correlation k(d/L) of the errors of two values at a distance d: along the rod or line at one time, or in
/// time at one place. Coordinates x, y, z are independent of each other. Give `length` or `time`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ErrorCorrelation {
    /// Correlation length L along the rod or the line [m]; values at different times are independent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub length: Option<f64>,
    /// Correlation time L [s]; values at different places are independent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "s"))]
    pub time: Option<f64>,
    /// Shape of the kernel: one of Matérn's. Left out: "matern-1/2", exp(−d/L).
    #[serde(default = "exponential")]
    pub kernel: Kernel,
}

fn exponential() -> Kernel {
    Kernel::Matern12
}

impl Observations {
    /// The correlation of the errors.
    pub fn correlation(&self) -> Option<&ErrorCorrelation> {
        match self {
            Observations::Synthetic(keys) => keys.correlation.as_ref(),
            Observations::File(keys) => keys.correlation.as_ref(),
        }
    }

    /// The cameras.
    pub fn cameras(&self) -> &[Camera] {
        match self {
            Observations::Synthetic(keys) => &keys.cameras,
            Observations::File(keys) => &keys.cameras,
        }
    }

    /// The sensors on a rod.
    pub fn sensors(&self) -> &[Sensor] {
        match self {
            Observations::Synthetic(keys) => &keys.sensors,
            Observations::File(keys) => &keys.sensors,
        }
    }
}

/// x_model = R x_recorded + t, with R given by its rows or as a rotation about an axis. σ does not change.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Frame {
    /// Rows of the rotation R: the model's axes written in the recording's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation: Option<[[f64; 3]; 3]>,
    /// Axis of the rotation, instead of its rows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<[f64; 3]>,
    /// Angle about `axis` [rad].
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "rad"))]
    pub angle: Option<f64>,
    /// Translation t [m], in the model's axes.
    #[schemars(extend("x-unit" = "m"))]
    pub translation: [f64; 3],
}

/// What to do with rows outside the window.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OutsideWindow {
    /// Refuse the file.
    #[default]
    Error,
    /// Leave them out (those after the window serve to judge the forecast).
    Skip,
}

/// What to do with rows that cannot be true.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum UnreachableRows {
    /// Refuse the file, and say what the cause may be.
    #[default]
    Error,
    /// Leave them out and list them.
    Skip,
}
