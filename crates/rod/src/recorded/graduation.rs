//! Rows of numbers made a curve: natural cubic splines, and graduation by third differences.

use std::f64::consts::{PI, TAU};

use nalgebra::SVector;
use varda_linalg::band;

use crate::Error;

/// How rows that carry noise are smoothed.
///
/// ```
/// use varda_rod::{RecordedMotion, SmoothBy, Vector3};
///
/// let times: Vec<f64> = (0..100).map(|k| 0.01 * k as f64).collect();
/// let places: Vec<_> = times.iter().map(|t| Vector3::new(t.sin(), 0.0, 0.0)).collect();
/// let smooth = RecordedMotion::smoothed(&times, &places, SmoothBy::CutOff(8.0))?;
/// assert!((smooth.smoothing().unwrap().cut_off - 8.0).abs() < 1e-12);
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SmoothBy {
    /// λ minimizes Σ |y − g|² / (n − d)², d the degrees of freedom that g uses: generalized
    /// cross-validation (Craven and Wahba 1979).
    Found,
    /// The standard deviation σ of a component is known: λ minimizes the risk Σ |y − g|² + 6σ² d
    /// (Mallows 1973). \[m\], or \[rad\] about each axis for rotations.
    Sigma(f64),
    /// Amplitudes at this frequency \[Hz\] are halved, faster ones more: 2πf h = λ^{−1/6} with rows h
    /// apart.
    CutOff(f64),
}

/// How rows were smoothed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothing {
    /// Standard deviation of a component (\[m\], or \[rad\] about each axis): as given, or what the rows are
    /// off the smoothed curve.
    pub sigma: f64,
    /// The frequency f \[Hz\] from which on more than half of an amplitude is taken for noise:
    /// 2πf h = λ^{−1/6} with rows h apart.
    pub cut_off: f64,
}

/// A cubic spline with g″ = γ_i at row i, constant before the first and after the last row:
///
/// ```text
/// g(t) = a g_i + b g_{i+1} + (h²/6) ((a³ − a) γ_i + (b³ − b) γ_{i+1})
/// b = (t − t_i)/h,  a = 1 − b
/// ```
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spline<const N: usize> {
    times: Vec<f64>,
    rows: Vec<SVector<f64, N>>,
    /// γ.
    bends: Vec<SVector<f64, N>>,
}

impl<const N: usize> Spline<N> {
    /// Straight lines from row to row.
    pub(super) fn straight(times: &[f64], rows: &[SVector<f64, N>]) -> Result<Self, Error> {
        check(times, rows)?;
        let bends = vec![SVector::zeros(); times.len()];
        Ok(Spline { times: times.to_vec(), rows: rows.to_vec(), bends })
    }

    /// The natural spline through the rows.
    pub(super) fn natural(times: &[f64], rows: &[SVector<f64, N>]) -> Result<Self, Error> {
        let straight = Spline::straight(times, rows)?;
        if rows.len() < 3 {
            return Ok(straight);
        }
        Ok(Spline { bends: natural_bends(times, rows)?, ..straight })
    }

    /// The natural spline through graduated rows, whose errors have three independent components of one σ;
    /// through the rows themselves where there are fewer than eight.
    pub(super) fn smoothed(
        times: &[f64],
        rows: &[SVector<f64, N>],
        by: SmoothBy,
    ) -> Result<(Self, Option<Smoothing>), Error> {
        check(times, rows)?;
        let (SmoothBy::Sigma(value) | SmoothBy::CutOff(value)) = by else {
            return Spline::graduated(times, rows, by);
        };
        if value > 0.0 && value.is_finite() {
            return Spline::graduated(times, rows, by);
        }
        let field = match by {
            SmoothBy::CutOff(_) => "cut-off of a recorded motion",
            SmoothBy::Sigma(_) | SmoothBy::Found => "σ of a recorded motion",
        };
        Err(Error::Value { field, value, expected: "> 0" })
    }

    fn graduated(
        times: &[f64],
        rows: &[SVector<f64, N>],
        by: SmoothBy,
    ) -> Result<(Self, Option<Smoothing>), Error> {
        let n = times.len();
        if n < 8 {
            return Ok((Spline::natural(times, rows)?, None));
        }
        let graduation = Graduation::new(times, rows);
        let risk = |decades: f64| {
            let lambda = 10.0_f64.powf(decades);
            let (off, used) = (graduation.residual(lambda)?, graduation.degrees_of_freedom(lambda));
            Ok::<f64, Error>(match by {
                SmoothBy::Sigma(sigma) => off + 6.0 * sigma * sigma * used,
                SmoothBy::Found | SmoothBy::CutOff(_) => off / (n as f64 - used).powi(2),
            })
        };
        let lambda = match by {
            SmoothBy::CutOff(f) => (TAU * f * spacing(times)).powi(-6).min(10.0_f64.powf(MOST_SMOOTHING)),
            SmoothBy::Found | SmoothBy::Sigma(_) => 10.0_f64.powf(least(MOST_SMOOTHING, risk)?),
        };
        let smooth = graduation.solve(lambda)?;
        let off = graduation.residual(lambda)? / (3.0 * (n as f64 - graduation.degrees_of_freedom(lambda)));
        let smoothing = Smoothing {
            sigma: if let SmoothBy::Sigma(sigma) = by { sigma } else { off.sqrt() },
            cut_off: lambda.powf(-1.0 / 6.0) / (TAU * spacing(times)),
        };
        Ok((Spline::natural(times, &smooth)?, Some(smoothing)))
    }

    pub(super) fn covers(&self) -> [f64; 2] {
        [self.times[0], self.times[self.times.len() - 1]]
    }

    pub(super) fn at(&self, t: f64) -> SVector<f64, N> {
        let last = self.times.len() - 1;
        let after = self.times.partition_point(|time| *time <= t);
        if after == 0 || after > last {
            return self.rows[after.min(last)];
        }
        let i = after - 1;
        let h = self.times[after] - self.times[i];
        let b = (t - self.times[i]) / h;
        let a = 1.0 - b;
        let bent = self.bends[i] * (a * a * a - a) + self.bends[after] * (b * b * b - b);
        self.rows[i] * a + self.rows[after] * b + bent * (h * h / 6.0)
    }
}

/// σ of a component, where rows look like a smooth curve with independent errors: differences of third and
/// fifth order that agree on it, as those of white noise do and those of a motion do not (after Gasser, Sroka
/// and Jennen-Steinmetz 1986, with medians). `errors` takes a difference about a row to the three independent
/// components of its error. `None` for fewer than fifty rows, or rows that are not evenly spaced.
pub(super) fn noise<const N: usize>(
    times: &[f64],
    rows: &[SVector<f64, N>],
    errors: impl Fn(&SVector<f64, N>, SVector<f64, N>) -> [f64; 3],
) -> Option<f64> {
    let n = times.len();
    if n < 50 || rows.len() != n {
        return None;
    }
    let spacing = spacing(times);
    if times.windows(2).any(|w| !(((w[1] - w[0]) / spacing - 1.0).abs() <= 0.1)) {
        return None;
    }
    let by_differences = |order: usize, squares: f64| {
        let mut differences = rows.to_vec();
        for _ in 0..order {
            differences = differences.windows(2).map(|w| w[1] - w[0]).collect();
        }
        let about = rows[order / 2..].iter().zip(differences);
        let mut sizes: Vec<f64> = about.flat_map(|(row, d)| errors(row, d).map(f64::abs)).collect();
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
struct Graduation<'a, const N: usize> {
    rows: &'a [SVector<f64, N>],
    /// The four entries of each row of D.
    differences: Vec<[f64; 4]>,
}

impl<'a, const N: usize> Graduation<'a, N> {
    fn new(times: &[f64], rows: &'a [SVector<f64, N>]) -> Self {
        let h = spacing(times);
        let row = |t: &[f64]| {
            std::array::from_fn(|j| {
                let others = (0..4).filter(|k| *k != j);
                6.0 * others.map(|k| h / (t[j] - t[k])).product::<f64>()
            })
        };
        Graduation { rows, differences: times.windows(4).map(row).collect() }
    }

    fn solve(&self, lambda: f64) -> Result<Vec<SVector<f64, N>>, Error> {
        const W: usize = 3;
        let n = self.rows.len();
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
        Ok(solve_each(W, &a, self.rows))
    }

    /// Σ |y − g|².
    fn residual(&self, lambda: f64) -> Result<f64, Error> {
        let g = self.solve(lambda)?;
        Ok(self.rows.iter().zip(&g).map(|(y, g)| (y - g).norm_squared()).sum())
    }

    /// tr (I + λ DᵀD)⁻¹ by the eigenvalues (2 sin ½ω)⁶ of evenly spaced rows.
    fn degrees_of_freedom(&self, lambda: f64) -> f64 {
        let n = self.rows.len();
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

/// The second derivatives of the natural cubic spline through rows.
fn natural_bends<const N: usize>(
    times: &[f64],
    rows: &[SVector<f64, N>],
) -> Result<Vec<SVector<f64, N>>, Error> {
    let h: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    let inner = rows.len() - 2;
    let mut a = vec![0.0; 2 * inner];
    for i in 0..inner {
        a[2 * i] = if i > 0 { h[i] / 6.0 } else { 0.0 };
        a[2 * i + 1] = (h[i] + h[i + 1]) / 3.0;
    }
    factor(1, &mut a)?;
    let slope = |i: usize| (rows[i + 1] - rows[i]) / h[i];
    let changes: Vec<_> = (0..inner).map(|i| slope(i + 1) - slope(i)).collect();
    let mut bends = vec![SVector::zeros()];
    bends.extend(solve_each(1, &a, &changes));
    bends.push(SVector::zeros());
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

fn solve_each<const N: usize>(w: usize, factor: &[f64], right: &[SVector<f64, N>]) -> Vec<SVector<f64, N>> {
    let mut solved = vec![SVector::zeros(); right.len()];
    for c in 0..N {
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

fn check<const N: usize>(times: &[f64], rows: &[SVector<f64, N>]) -> Result<(), Error> {
    if times.is_empty() || rows.len() != times.len() {
        let (field, value) = ("rows of a recorded motion", rows.len() as f64);
        return Err(Error::Value { field, value, expected: "one for each time, at least one" });
    }
    if let Some(pair) = times.windows(2).find(|w| !(w[0] < w[1])) {
        let (field, value) = ("time of a recorded motion", pair[1]);
        return Err(Error::Value { field, value, expected: "later than the row before" });
    }
    let finite =
        |(time, row): (&f64, &SVector<f64, N>)| time.is_finite() && row.iter().all(|v| v.is_finite());
    match times.iter().zip(rows).position(|row| !finite(row)) {
        Some(index) => Err(Error::NonFinite { what: "rows of a recorded motion, row", index }),
        None => Ok(()),
    }
}
