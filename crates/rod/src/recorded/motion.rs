//! Places that were recorded: rows of time and place, followed or smoothed.

use nalgebra::Vector3;

use super::graduation::{SmoothBy, Smoothing, Spline, noise};
use crate::{Error, Motion};

/// A motion known from rows of time and place; before the first and after the last it stays where that is.
///
/// Between rows it is a straight line ([`through`](Self::through)) or a cubic spline. A table that was
/// measured is noisy, and a line through every row turns 0.1 mm of noise into accelerations that shake a rod:
/// use [`smoothed`](Self::smoothed).
///
/// ```
/// use varda_rod::{Motion, RecordedMotion, SmoothBy, Vector3};
///
/// let times: Vec<f64> = (0..200).map(|k| 0.005 * k as f64).collect();
/// let jitter = |k: usize| 1e-4 * if k % 2 == 0 { 1.0 } else { -1.0 };
/// let rows: Vec<_> = (0..200).map(|k| Vector3::new(times[k].sin() + jitter(k), 0.0, 0.0)).collect();
/// let smooth = RecordedMotion::smoothed(&times, &rows, SmoothBy::Found)?;
/// assert!((smooth.at(0.5).x - 0.5_f64.sin()).abs() < 2e-5);
/// assert!((smooth.smoothing().unwrap().sigma * 3.0_f64.sqrt() - 1e-4).abs() < 1e-5);
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedMotion {
    curve: Spline<3>,
    smoothing: Option<Smoothing>,
}

impl RecordedMotion {
    /// Straight lines from row to row.
    ///
    /// # Errors
    /// [`Error::Value`] where the times do not ascend or there are not as many places; [`Error::NonFinite`].
    pub fn through(times: &[f64], places: &[Vector3<f64>]) -> Result<RecordedMotion, Error> {
        Ok(RecordedMotion { curve: Spline::straight(times, places)?, smoothing: None })
    }

    /// A natural cubic spline through the rows.
    ///
    /// # Errors
    /// As [`through`](Self::through).
    pub fn curved(times: &[f64], places: &[Vector3<f64>]) -> Result<RecordedMotion, Error> {
        Ok(RecordedMotion { curve: Spline::natural(times, places)?, smoothing: None })
    }

    /// Rows whose coordinates have independent errors, graduated by third differences (Whittaker 1923):
    ///
    /// ```text
    /// min Σ_i |y_i − g_i|² + λ Σ_i |h³ g‴_i|²
    /// h³ g‴_i = g_{i+3} − 3 g_{i+2} + 3 g_{i+1} − g_i
    /// ```
    ///
    /// (divided differences where the rows are not evenly spaced), and a natural cubic spline through the
    /// g_i. Fewer than eight rows are followed.
    ///
    /// # Errors
    /// As [`through`](Self::through); [`Error::Value`] for a σ or a cut-off that is not positive.
    pub fn smoothed(times: &[f64], places: &[Vector3<f64>], by: SmoothBy) -> Result<RecordedMotion, Error> {
        let (curve, smoothing) = Spline::smoothed(times, places, by)?;
        Ok(RecordedMotion { curve, smoothing })
    }

    /// How it was smoothed; `None` where every row is followed.
    pub fn smoothing(&self) -> Option<Smoothing> {
        self.smoothing
    }

    /// First and last time \[s\].
    pub fn covers(&self) -> [f64; 2] {
        self.curve.covers()
    }
}

impl Motion for RecordedMotion {
    fn at(&self, t: f64) -> Vector3<f64> {
        self.curve.at(t)
    }
}

/// σ of a coordinate, where rows look like a smooth motion with independent errors: differences of third and
/// fifth order that agree on it, as those of white noise do and those of a motion do not (after Gasser, Sroka
/// and Jennen-Steinmetz 1986, with medians). `None` for fewer than fifty rows, or rows that are not evenly
/// spaced.
pub fn noise_of_rows(times: &[f64], places: &[Vector3<f64>]) -> Option<f64> {
    noise(times, places, |_, difference| difference.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers like normal ones, always the same: sums of twelve of a congruential sequence (Knuth).
    fn errors(n: usize, sigma: f64) -> Vec<Vector3<f64>> {
        let mut state = 20_u64;
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut normal = || sigma * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0);
        (0..n).map(|_| Vector3::new(normal(), normal(), normal())).collect()
    }

    fn motion(t: f64) -> Vector3<f64> {
        Vector3::new((6.0 * t).sin(), (6.0 * t).cos(), 0.2 * t * t)
    }

    #[test]
    fn straight_lines_go_through_the_rows_and_stay_at_the_ends() {
        let places = [1.0, 3.0, 2.0].map(|x| Vector3::new(x, 0.0, -x));
        let table = RecordedMotion::through(&[0.0, 1.0, 3.0], &places).unwrap();
        for (t, x) in [(-1.0, 1.0), (0.0, 1.0), (0.5, 2.0), (1.0, 3.0), (2.0, 2.5), (3.0, 2.0), (9.0, 2.0)] {
            assert_eq!(table.at(t), Vector3::new(x, 0.0, -x), "{t}");
        }
        assert_eq!((table.covers(), table.smoothing()), ([0.0, 3.0], None));
        let one = RecordedMotion::through(&[1.0], &places[..1]).unwrap();
        assert_eq!((one.at(0.0).x, one.at(1.0).x, one.at(2.0).x), (1.0, 1.0, 1.0));
    }

    #[test]
    fn noise_is_found_and_taken_off_with_its_sigma_or_without() {
        let n = 480;
        // Every seventh row is late by a third of the distance.
        let times: Vec<f64> =
            (0..n).map(|k| (k as f64 + if k % 7 == 3 { 0.33 } else { 0.0 }) / 240.0).collect();
        let sigma = 1e-3;
        let noise = errors(n, sigma);
        let rows: Vec<_> = times.iter().zip(&noise).map(|(t, e)| motion(*t) + e).collect();
        for by in [SmoothBy::Found, SmoothBy::Sigma(sigma)] {
            let smooth = RecordedMotion::smoothed(&times, &rows, by).unwrap();
            let found = smooth.smoothing().unwrap();
            assert!((found.sigma / sigma - 1.0).abs() < 0.1, "{found:?}");
            // The drive is at 0.95 Hz.
            assert!(found.cut_off > 2.0 && found.cut_off < 15.0, "{found:?}");
            let inside = (12..n - 12).map(|k| (smooth.at(times[k]) - motion(times[k])).norm_squared());
            let off = (inside.sum::<f64>() / (n - 24) as f64).sqrt();
            // A share 2 f_c / 240 Hz of the variance of three coordinates stays, and some bias.
            assert!(off < 1.5 * sigma * (3.0 * 2.0 * found.cut_off / 240.0).sqrt(), "{off} {found:?}");
        }
        let even: Vec<f64> = (0..n).map(|k| k as f64 / 240.0).collect();
        let rows: Vec<_> = even.iter().zip(&noise).map(|(t, e)| motion(*t) + e).collect();
        let estimate = noise_of_rows(&even, &rows).unwrap();
        assert!((estimate / sigma - 1.0).abs() < 0.15, "{estimate}");
    }

    #[test]
    fn a_motion_without_noise_is_not_taken_for_noise_and_is_kept() {
        let times: Vec<f64> = (0..300).map(|k| 0.01 * k as f64).collect();
        let rows: Vec<_> = times.iter().map(|t| motion(*t)).collect();
        // What rounding leaves of fifth differences is white, and small.
        assert!(noise_of_rows(&times, &rows).is_none_or(|sigma| sigma < 1e-12));
        let steps: Vec<_> = (0..300).map(|k| Vector3::new((k / 100) as f64, 0.0, 0.0)).collect();
        assert_eq!(noise_of_rows(&times, &steps), None);
        assert_eq!(noise_of_rows(&times[..20], &rows[..20]), None);
        let kept = RecordedMotion::smoothed(&times, &rows, SmoothBy::Sigma(1e-9)).unwrap();
        assert!((kept.at(1.505) - motion(1.505)).norm() < 1e-6);
    }

    #[test]
    fn impossible_rows_are_errors() {
        let place = Vector3::zeros();
        assert!(RecordedMotion::through(&[], &[]).is_err());
        assert!(RecordedMotion::through(&[0.0, 0.0], &[place; 2]).is_err());
        assert!(RecordedMotion::through(&[0.0], &[Vector3::new(f64::NAN, 0.0, 0.0)]).is_err());
        assert!(RecordedMotion::smoothed(&[0.0], &[place], SmoothBy::Sigma(0.0)).is_err());
        let clustered: Vec<f64> = (0..9).map(|k| if k < 8 { 1e-14 * k as f64 } else { 1e14 }).collect();
        let ended = RecordedMotion::smoothed(&clustered, &errors(9, 1.0), SmoothBy::Found);
        assert!(ended.is_err() || ended.unwrap().at(1.0).iter().all(|v| v.is_finite()));
    }
}
