//! What the axes of a recording must satisfy.

use super::Frame;
use super::invalid::{Check, invalid};

/// A frame at a path.
pub(super) fn validate_frame(frame: &Frame, path: &str) -> Check {
    match (&frame.rotation, &frame.axis, &frame.angle) {
        (Some(_), Some(_), _) | (Some(_), _, Some(_)) => {
            invalid(format!("{path}.rotation"), "give `rotation`, or `axis` and `angle`")
        }
        (None, Some(_), None) | (None, None, Some(_)) => invalid(path, "`axis` and `angle` go together"),
        (None, Some(axis), Some(_)) if !(axis.iter().map(|x| x * x).sum::<f64>() > 0.0) => {
            invalid(format!("{path}.axis"), "an axis cannot be zero")
        }
        (None, Some(_), Some(angle)) if angle.abs() > std::f64::consts::TAU => invalid(
            format!("{path}.angle"),
            format!(
                "{angle} rad is more than a whole turn: degrees were meant, {:.6} rad?",
                angle.to_radians()
            ),
        ),
        (Some(r), None, None) => validate_rotation(r, &format!("{path}.rotation")),
        _ => Ok(()),
    }
}

/// The rows of a rotation at a path.
pub(super) fn validate_rotation(r: &[[f64; 3]; 3], path: &str) -> Check {
    for i in 0..3 {
        for j in 0..3 {
            let product: f64 = (0..3).map(|k| r[i][k] * r[j][k]).sum();
            // Rows written with four digits are meant as a rotation; a mirrored or scaled frame is not.
            if !((product - f64::from(i == j)).abs() < 1e-3) {
                return invalid(path, "its rows are not perpendicular unit vectors");
            }
        }
    }
    let det = r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1])
        - r[0][1] * (r[1][0] * r[2][2] - r[1][2] * r[2][0])
        + r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0]);
    if det > 0.0 { Ok(()) } else { invalid(path, "it mirrors: its determinant is −1") }
}
