//! Motions that were recorded: rows of time and place, followed or smoothed.

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;
use varda_linalg::band;

use crate::{Error, Motion};

/// A motion known from rows of time and place; before the first and after the last it stays where that is.
///
/// Between rows it is a cubic spline with g″ = γ_i at row i,
///
/// ```text
/// g(t) = a g_i + b g_{i+1} + (h²/6) ((a³ − a) γ_i + (b³ − b) γ_{i+1})
/// b = (t − t_i)/h,  a = 1 − b
/// ```
///
/// where γ = 0 gives straight lines. A table that was measured is noisy, and a line through every row turns
/// 0.1 mm of noise into accelerations that shake a rod: use [`smoothed`](Self::smoothed).
///
/// ```
/// use varda_rod::{Motion, RecordedMotion, Vector3};
///
/// let times: Vec<f64> = (0..200).map(|k| 0.005 * k as f64).collect();
/// let jitter = |k: usize| 1e-4 * if k % 2 == 0 { 1.0 } else { -1.0 };
/// let rows: Vec<_> = (0..200).map(|k| Vector3::new(times[k].sin() + jitter(k), 0.0, 0.0)).collect();
/// let smooth = RecordedMotion::smoothed(&times, &rows, None)?;
/// assert!((smooth.at(0.5).x - 0.5_f64.sin()).abs() < 2e-5);
/// assert!((smooth.smoothing().unwrap().sigma * 3.0_f64.sqrt() - 1e-4).abs() < 1e-5);
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedMotion {
    times: Vec<f64>,
    places: Vec<Vector3<f64>>,
    /// γ.
    bends: Vec<Vector3<f64>>,
    smoothing: Option<Smoothing>,
}

/// How a recorded motion was smoothed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothing {
    /// Standard deviation of a coordinate \[m\]: as given, or what the rows are off the smoothed motion.
    pub sigma: f64,
    /// The frequency f \[Hz\] from which on more than half of an amplitude is taken for noise:
    /// 2πf h = λ^{−1/6} with rows h apart.
    pub cut_off: f64,
}

impl RecordedMotion {
    /// Straight lines from row to row.
    ///
    /// # Errors
    /// [`Error::Value`] where the times do not ascend or there are not as many places; [`Error::NonFinite`].
    pub fn through(times: &[f64], places: &[Vector3<f64>]) -> Result<RecordedMotion, Error> {
        check(times, places)?;
        let bends = vec![Vector3::zeros(); times.len()];
        Ok(RecordedMotion { times: times.to_vec(), places: places.to_vec(), bends, smoothing: None })
    }

    /// Rows whose coordinates have independent errors, graduated by third differences (Whittaker 1923):
    ///
    /// ```text
    /// min Σ_i |y_i − g_i|² + λ Σ_i |h³ g‴_i|²
    /// h³ g‴_i = g_{i+3} − 3 g_{i+2} + 3 g_{i+1} − g_i
    /// ```
    ///
    /// (divided differences where the rows are not evenly spaced), and a natural cubic spline through the
    /// g_i. With σ \[m\] known, λ minimizes the risk Σ |y − g|² + 6σ² d (Mallows 1973), d the degrees
    /// of freedom that g uses; else Σ |y − g|² / (n − d)² (generalized cross-validation, Craven and
    /// Wahba 1979). Fewer than eight rows are followed.
    ///
    /// # Errors
    /// As [`through`](Self::through); [`Error::Value`] for a σ that is not positive.
    pub fn smoothed(
        times: &[f64],
        places: &[Vector3<f64>],
        sigma: Option<f64>,
    ) -> Result<RecordedMotion, Error> {
        check(times, places)?;
        if let Some(value) = sigma.filter(|s| !(*s > 0.0 && s.is_finite())) {
            return Err(Error::Value { field: "σ of a recorded motion", value, expected: "> 0" });
        }
        let n = times.len();
        if n < 8 {
            return RecordedMotion::through(times, places);
        }
        let graduation = Graduation::new(times, places);
        let risk = |decades: f64| {
            let lambda = 10.0_f64.powf(decades);
            let (off, used) = (graduation.residual(lambda)?, graduation.degrees_of_freedom(lambda));
            Ok::<f64, Error>(match sigma {
                Some(sigma) => off + 6.0 * sigma * sigma * used,
                None => off / (n as f64 - used).powi(2),
            })
        };
        let lambda = 10.0_f64.powf(least(MOST_SMOOTHING, risk)?);
        let smooth = graduation.solve(lambda)?;
        let off = graduation.residual(lambda)? / (3.0 * (n as f64 - graduation.degrees_of_freedom(lambda)));
        let smoothing = Smoothing {
            sigma: sigma.unwrap_or(off.sqrt()),
            cut_off: lambda.powf(-1.0 / 6.0) / (TAU * spacing(times)),
        };
        let bends = natural_spline(times, &smooth)?;
        Ok(RecordedMotion { times: times.to_vec(), places: smooth, bends, smoothing: Some(smoothing) })
    }

    /// How it was smoothed; `None` where every row is followed.
    pub fn smoothing(&self) -> Option<Smoothing> {
        self.smoothing
    }

    /// First and last time \[s\].
    pub fn covers(&self) -> [f64; 2] {
        [self.times[0], self.times[self.times.len() - 1]]
    }
}

impl Motion for RecordedMotion {
    fn at(&self, t: f64) -> Vector3<f64> {
        let last = self.times.len() - 1;
        let after = self.times.partition_point(|time| *time <= t);
        if after == 0 || after > last {
            return self.places[after.min(last)];
        }
        let i = after - 1;
        let h = self.times[after] - self.times[i];
        let b = (t - self.times[i]) / h;
        let a = 1.0 - b;
        let bent = self.bends[i] * (a * a * a - a) + self.bends[after] * (b * b * b - b);
        self.places[i] * a + self.places[after] * b + bent * (h * h / 6.0)
    }
}

/// σ of a coordinate, where rows look like a smooth motion with independent errors: differences of third and
/// fifth order that agree on it, as those of white noise do and those of a motion do not (after Gasser, Sroka
/// and Jennen-Steinmetz 1986, with medians). `None` for fewer than fifty rows, or rows that are not evenly
/// spaced.
pub fn noise_of_rows(times: &[f64], places: &[Vector3<f64>]) -> Option<f64> {
    let n = times.len();
    if n < 50 || places.len() != n {
        return None;
    }
    let spacing = spacing(times);
    if times.windows(2).any(|w| !(((w[1] - w[0]) / spacing - 1.0).abs() <= 0.1)) {
        return None;
    }
    let by_differences = |order: usize, squares: f64| {
        let mut rows: Vec<Vector3<f64>> = places.to_vec();
        for _ in 0..order {
            rows = rows.windows(2).map(|w| w[1] - w[0]).collect();
        }
        let mut sizes: Vec<f64> = rows.iter().flat_map(|r| <[f64; 3]>::from(r.abs())).collect();
        sizes.sort_by(f64::total_cmp);
        // The median of |z| is 0.6745.
        sizes[sizes.len() / 2] / (0.6745 * squares.sqrt())
    };
    // Σ_j C(k, j)² = C(2k, k).
    let (third, fifth) = (by_differences(3, 20.0), by_differences(5, 252.0));
    (fifth > 0.0 && fifth.is_finite() && (third / fifth - 1.0).abs() <= 0.3).then_some(fifth)
}

/// log₁₀ of the largest λ: beyond, λ DᵀD drowns the identity in double precision.
const MOST_SMOOTHING: f64 = 12.0;

/// (I + λ DᵀD) g = y, D the third differences.
struct Graduation<'a> {
    places: &'a [Vector3<f64>],
    /// The four entries of each row of D.
    differences: Vec<[f64; 4]>,
}

impl<'a> Graduation<'a> {
    fn new(times: &[f64], places: &'a [Vector3<f64>]) -> Self {
        let h = spacing(times);
        let row = |t: &[f64]| {
            std::array::from_fn(|j| {
                let others = (0..4).filter(|k| *k != j);
                6.0 * others.map(|k| h / (t[j] - t[k])).product::<f64>()
            })
        };
        Graduation { places, differences: times.windows(4).map(row).collect() }
    }

    fn solve(&self, lambda: f64) -> Result<Vec<Vector3<f64>>, Error> {
        const W: usize = 3;
        let n = self.places.len();
        let mut a = vec![0.0; n * (W + 1)];
        for i in 0..n {
            a[i * (W + 1) + W] = 1.0;
        }
        for (first, d) in self.differences.iter().enumerate() {
            for i in 0..4 {
                for j in 0..=i {
                    a[(first + i) * (W + 1) + W - (i - j)] += lambda * d[i] * d[j];
                }
            }
        }
        factor(W, &mut a)?;
        Ok(solve_each(W, &a, self.places))
    }

    /// Σ |y − g|².
    fn residual(&self, lambda: f64) -> Result<f64, Error> {
        let g = self.solve(lambda)?;
        Ok(self.places.iter().zip(&g).map(|(y, g)| (y - g).norm_squared()).sum())
    }

    /// tr (I + λ DᵀD)⁻¹ by the eigenvalues (2 sin ½ω)⁶ of evenly spaced rows.
    fn degrees_of_freedom(&self, lambda: f64) -> f64 {
        let n = self.places.len();
        let used = |k: usize| 1.0 / (1.0 + lambda * (2.0 * (0.5 * PI * k as f64 / n as f64).sin()).powi(6));
        3.0 + (3..n).map(used).sum::<f64>()
    }
}

/// Where a function on [0, most] is least: the best of a grid, refined by golden sections.
fn least(most: f64, f: impl Fn(f64) -> Result<f64, Error>) -> Result<f64, Error> {
    const GRID: usize = 24;
    let at = |i: usize| most * i as f64 / GRID as f64;
    let mut best = (0, f64::INFINITY);
    for i in 0..=GRID {
        let value = f(at(i))?;
        if value < best.1 {
            best = (i, value);
        }
    }
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut a, mut b) = (at(best.0.saturating_sub(1)), at((best.0 + 1).min(GRID)));
    for _ in 0..12 {
        let (c, d) = (b - golden * (b - a), a + golden * (b - a));
        if f(c)? < f(d)? { b = d } else { a = c }
    }
    Ok(0.5 * (a + b))
}

/// The second derivatives of the natural cubic spline through places.
fn natural_spline(times: &[f64], places: &[Vector3<f64>]) -> Result<Vec<Vector3<f64>>, Error> {
    let h: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    let inner = places.len() - 2;
    let mut a = vec![0.0; 2 * inner];
    for i in 0..inner {
        a[2 * i] = if i > 0 { h[i] / 6.0 } else { 0.0 };
        a[2 * i + 1] = (h[i] + h[i + 1]) / 3.0;
    }
    factor(1, &mut a)?;
    let slope = |i: usize| (places[i + 1] - places[i]) / h[i];
    let changes: Vec<_> = (0..inner).map(|i| slope(i + 1) - slope(i)).collect();
    let mut bends = vec![Vector3::zeros()];
    bends.extend(solve_each(1, &a, &changes));
    bends.push(Vector3::zeros());
    Ok(bends)
}

/// Positive definite, but where rows are so unevenly spaced that rounding decides.
fn factor(w: usize, a: &mut [f64]) -> Result<(), Error> {
    let uneven = |bad: band::BadPivot| Error::Value {
        field: "row of a recorded motion, too close in time to the next,",
        value: bad.row as f64,
        expected: "rows at comparable distances",
    };
    band::ldlt_factor(w, a).map(|_| ()).map_err(uneven)
}

fn solve_each(w: usize, factor: &[f64], right: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut solved = vec![Vector3::zeros(); right.len()];
    for c in 0..3 {
        let mut column: Vec<f64> = right.iter().map(|r| r[c]).collect();
        band::ldlt_solve(w, factor, &mut column);
        solved.iter_mut().zip(&column).for_each(|(s, v)| s[c] = *v);
    }
    solved
}

/// The mean distance of rows.
fn spacing(times: &[f64]) -> f64 {
    (times[times.len() - 1] - times[0]) / (times.len() - 1) as f64
}

fn check(times: &[f64], places: &[Vector3<f64>]) -> Result<(), Error> {
    if times.is_empty() || places.len() != times.len() {
        let (field, value) = ("places of a recorded motion", places.len() as f64);
        return Err(Error::Value { field, value, expected: "one for each time, at least one" });
    }
    if let Some(pair) = times.windows(2).find(|w| !(w[0] < w[1])) {
        let (field, value) = ("time of a recorded motion", pair[1]);
        return Err(Error::Value { field, value, expected: "later than the row before" });
    }
    let finite =
        |(time, place): (&f64, &Vector3<f64>)| time.is_finite() && place.iter().all(|v| v.is_finite());
    match times.iter().zip(places).position(|row| !finite(row)) {
        Some(index) => Err(Error::NonFinite { what: "rows of a recorded motion, row", index }),
        None => Ok(()),
    }
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
        for known in [None, Some(sigma)] {
            let smooth = RecordedMotion::smoothed(&times, &rows, known).unwrap();
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
        let kept = RecordedMotion::smoothed(&times, &rows, Some(1e-9)).unwrap();
        assert!((kept.at(1.505) - motion(1.505)).norm() < 1e-6);
    }

    #[test]
    fn impossible_rows_are_errors() {
        let place = Vector3::zeros();
        assert!(RecordedMotion::through(&[], &[]).is_err());
        assert!(RecordedMotion::through(&[0.0, 0.0], &[place; 2]).is_err());
        assert!(RecordedMotion::through(&[0.0], &[Vector3::new(f64::NAN, 0.0, 0.0)]).is_err());
        assert!(RecordedMotion::smoothed(&[0.0], &[place], Some(0.0)).is_err());
        let clustered: Vec<f64> = (0..9).map(|k| if k < 8 { 1e-14 * k as f64 } else { 1e14 }).collect();
        let ended = RecordedMotion::smoothed(&clustered, &errors(9, 1.0), None);
        assert!(ended.is_err() || ended.unwrap().at(1.0).iter().all(|v| v.is_finite()));
    }
}
