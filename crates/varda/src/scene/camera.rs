//! `[[observations.cameras]]`: calibrated cameras that see markers of a rod.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::defaults::is_default;
use super::marker::Use;

/// A calibrated camera. A point p is at (X, Y, Z) = R (p − c) in its axes, x right, y down, z forward, and
/// at the pixel u = c_x + f_x x″, v = c_y + f_y y″ in the image, with (x″, y″) the distorted (X/Z,
/// Y/Z), as in OpenCV. Places are in the axes of `frame`: the model's without one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Its name in the column `camera`.
    pub name: String,
    /// Focal lengths f_x, f_y [px].
    #[schemars(extend("x-unit" = "px"))]
    pub focal_length: [f64; 2],
    /// Principal point c_x, c_y [px].
    #[schemars(extend("x-unit" = "px"))]
    pub principal_point: [f64; 2],
    /// Lens distortion k₁, k₂, p₁, p₂, k₃ (Brown and Conrady, in OpenCV's order).
    #[serde(default, skip_serializing_if = "is_default")]
    pub distortion: [f64; 5],
    /// Its centre c [m]; of OpenCV's `rvec`, `tvec` −Rᵀ tvec.
    #[schemars(extend("x-unit" = "m"))]
    pub position: [f64; 3],
    /// Rows of R, its axes right, down and forward; of OpenCV's `rvec` Rodrigues(rvec).
    pub rotation: [[f64; 3]; 3],
    /// Width and height of its image [px]. Rows outside are refused (`unreachable`), and a twin sees nothing
    /// there. Absent: without bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "px"))]
    pub image: Option<[f64; 2]>,
    /// Standard deviation of u and v where the file has no `sigma_px` [px].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "px"))]
    pub sigma: Option<f64>,
    /// What its rows are used for.
    #[serde(default, rename = "use", skip_serializing_if = "is_default")]
    pub used: Use,
}
