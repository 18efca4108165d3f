//! Rotations that were recorded: rows of time and unit quaternion, followed or smoothed.

use nalgebra::{Quaternion, UnitQuaternion, Vector4};

use super::graduation::{SmoothBy, Smoothing, Spline, noise};
use crate::Error;

/// A rotation known from rows of time and unit quaternion; before the first and after the last it stays as
/// that is.
///
/// It is the direction of a curve g(t) in the space of quaternions, a natural cubic spline through the rows
/// or through what smoothing leaves of them:
///
/// ```text
/// q(t) = g(t)/|g(t)|
/// ```
///
/// q and −q are the same rotation: each row has the sign that is nearer to the row before. Angular velocity
/// and acceleration are continuous. Products with a unit quaternion from either side are isometries of that
/// space, so nothing depends on the axes. An error φ of rotation \[rad\] moves a unit quaternion by φ/2.
///
/// ```
/// use varda_rod::{RecordedRotation, SmoothBy, UnitQuaternion, Vector3};
///
/// let about = |angle: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
/// let times: Vec<f64> = (0..200).map(|k| 0.005 * k as f64).collect();
/// let jitter = |k: usize| 2e-3 * if k % 2 == 0 { 1.0 } else { -1.0 };
/// let rows: Vec<_> = (0..200).map(|k| about(times[k] * times[k] + jitter(k))).collect();
/// let smooth = RecordedRotation::smoothed(&times, &rows, SmoothBy::Found)?;
/// assert!(smooth.at(0.5).angle_to(&about(0.25)) < 4e-4);
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedRotation {
    curve: Spline<4>,
    smoothing: Option<Smoothing>,
}

/// Rows that turn by more than 2π/3 from one to the next: which way they turn is a guess.
const LARGEST_TURN: f64 = 2.0 * std::f64::consts::FRAC_PI_3;

impl RecordedRotation {
    /// Through every row.
    ///
    /// # Errors
    /// [`Error::Value`] where the times do not ascend, there are not as many rotations, or one is more than
    /// 2π/3 from the one before; [`Error::NonFinite`].
    pub fn through(times: &[f64], rotations: &[UnitQuaternion<f64>]) -> Result<RecordedRotation, Error> {
        let rows = with_signs(rotations)?;
        Ok(RecordedRotation { curve: Spline::natural(times, &rows)?, smoothing: None })
    }

    /// Rows with independent errors about each axis, smoothed as places are
    /// ([`RecordedMotion::smoothed`](crate::RecordedMotion::smoothed)).
    ///
    /// # Errors
    /// As [`through`](Self::through); [`Error::Value`] for a σ or a cut-off that is not positive.
    pub fn smoothed(
        times: &[f64],
        rotations: &[UnitQuaternion<f64>],
        by: SmoothBy,
    ) -> Result<RecordedRotation, Error> {
        let rows = with_signs(rotations)?;
        let by = if let SmoothBy::Sigma(angle) = by { SmoothBy::Sigma(0.5 * angle) } else { by };
        let (curve, smoothing) = Spline::smoothed(times, &rows, by)?;
        let smoothing = smoothing.map(|s| Smoothing { sigma: 2.0 * s.sigma, ..s });
        Ok(RecordedRotation { curve, smoothing })
    }

    /// The rotation at time t \[s\].
    pub fn at(&self, t: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::new_normalize(Quaternion::from_vector(self.curve.at(t)))
    }

    /// How it was smoothed, σ in radians about each axis; `None` where every row is followed.
    pub fn smoothing(&self) -> Option<Smoothing> {
        self.smoothing
    }

    /// First and last time \[s\].
    pub fn covers(&self) -> [f64; 2] {
        self.curve.covers()
    }
}

/// σ about each axis \[rad\], where rotations look like a smooth motion with independent errors:
/// [`noise_of_rows`](crate::noise_of_rows) of rotations.
pub fn noise_of_rotations(times: &[f64], rotations: &[UnitQuaternion<f64>]) -> Option<f64> {
    let rows = with_signs(rotations).ok()?;
    // In the axes of the body an error is a vector; along q there is none.
    let in_body = |row: &Vector4<f64>, difference: Vector4<f64>| {
        let turned = Quaternion::from_vector(*row).conjugate() * Quaternion::from_vector(difference);
        turned.imag().into()
    };
    noise(times, &rows, in_body).map(|sigma| 2.0 * sigma)
}

/// The quaternions as vectors, each with the sign that is nearer to the one before.
fn with_signs(rotations: &[UnitQuaternion<f64>]) -> Result<Vec<Vector4<f64>>, Error> {
    let mut rows: Vec<Vector4<f64>> = Vec::with_capacity(rotations.len());
    for (index, rotation) in rotations.iter().enumerate() {
        let mut row = rotation.coords;
        if !row.iter().all(|v| v.is_finite()) {
            return Err(Error::NonFinite { what: "rotations of a recorded motion, row", index });
        }
        if let Some(before) = rows.last() {
            let cos = before.dot(&row);
            let turn = 2.0 * cos.abs().min(1.0).acos();
            if !(turn <= LARGEST_TURN) {
                let field = "turn of a recorded motion from a row to the next [rad]";
                return Err(Error::Value { field, value: turn, expected: "at most 2π/3" });
            }
            row *= cos.signum();
        }
        rows.push(row);
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A body that tumbles: two turns about one axis while another one swings.
    fn motion(t: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 6.0 * t)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), (4.0 * t).sin())
    }

    fn rows(n: usize, sigma: f64) -> (Vec<f64>, Vec<UnitQuaternion<f64>>) {
        let mut state = 20_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        // Numbers like normal ones, always the same: sums of twelve of a congruential sequence (Knuth).
        let mut normal = || sigma * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0);
        let times: Vec<f64> = (0..n).map(|k| 0.01 * k as f64).collect();
        let rotations = times
            .iter()
            .map(|t| motion(*t) * UnitQuaternion::new(Vector3::new(normal(), normal(), normal())))
            .collect();
        (times, rotations)
    }

    #[test]
    fn signs_of_quaternions_mean_nothing() {
        let (times, rotations) = rows(100, 0.0);
        let flipped: Vec<_> = rotations
            .iter()
            .enumerate()
            .map(|(k, q)| if k % 3 == 1 { UnitQuaternion::new_unchecked(-q.into_inner()) } else { *q })
            .collect();
        let (plain, other) = (
            RecordedRotation::through(&times, &rotations).unwrap(),
            RecordedRotation::through(&times, &flipped).unwrap(),
        );
        for k in 0..990 {
            let t = 0.001 * f64::from(k);
            assert!(plain.at(t).angle_to(&other.at(t)) < 1e-12);
            // Errors of a cubic spline, natural at its ends: fourth order inside, second at the ends.
            let bound = if (0.1..0.89).contains(&t) { 2e-6 } else { 1e-3 };
            assert!(plain.at(t).angle_to(&motion(t)) < bound, "{t}");
        }
    }

    #[test]
    fn angular_velocity_and_acceleration_are_continuous() {
        let (times, rotations) = rows(60, 0.0);
        let curve = RecordedRotation::through(&times, &rotations).unwrap();
        let h = 1e-4;
        let velocity = |t: f64| (curve.at(t + h) * curve.at(t - h).inverse()).scaled_axis() / (2.0 * h);
        let acceleration = |t: f64| (velocity(t + h) - velocity(t - h)) / (2.0 * h);
        for k in 5..55 {
            let at = times[k];
            let jump = |f: &dyn Fn(f64) -> Vector3<f64>| (f(at + 3.0 * h) - f(at - 3.0 * h)).norm();
            // Over 6e-4 s, of some 40 rad/s² and 400 rad/s³; great arcs from row to row would jump by
            // 0.01 s × 40 rad/s².
            assert!(jump(&velocity) < 0.05, "{k}: {}", jump(&velocity));
            assert!(jump(&acceleration) < 1.0, "{k}: {}", jump(&acceleration));
        }
    }

    #[test]
    fn noise_is_found_and_taken_off() {
        let sigma = 2e-3;
        let (times, rotations) = rows(400, sigma);
        let found = noise_of_rotations(&times, &rotations).unwrap();
        assert!((found / sigma - 1.0).abs() < 0.15, "{found}");
        for by in [SmoothBy::Found, SmoothBy::Sigma(sigma), SmoothBy::CutOff(8.0)] {
            let smooth = RecordedRotation::smoothed(&times, &rotations, by).unwrap();
            let told = smooth.smoothing().unwrap();
            assert!((told.sigma / sigma - 1.0).abs() < 0.1, "{told:?}");
            let inside = (10..390).map(|k| smooth.at(times[k]).angle_to(&motion(times[k])).powi(2));
            let off = (inside.sum::<f64>() / 380.0).sqrt();
            // A share 2 f_c / 100 Hz of the variance about three axes stays, and some bias.
            assert!(off < 1.5 * sigma * (3.0 * 2.0 * told.cut_off / 100.0).sqrt(), "{by:?} {off} {told:?}");
        }
    }

    #[test]
    fn impossible_rows_are_errors() {
        let half = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let ambiguous = RecordedRotation::through(&[0.0, 1.0], &[UnitQuaternion::identity(), half]);
        assert!(ambiguous.unwrap_err().to_string().contains("2π/3"));
        let nan = UnitQuaternion::new_unchecked(Quaternion::new(f64::NAN, 0.0, 0.0, 0.0));
        assert!(RecordedRotation::through(&[0.0], &[nan]).is_err());
        let q = UnitQuaternion::identity();
        assert!(RecordedRotation::through(&[0.0, 0.0], &[q, q]).is_err());
        assert!(RecordedRotation::smoothed(&[0.0], &[q], SmoothBy::CutOff(0.0)).is_err());
    }
}
