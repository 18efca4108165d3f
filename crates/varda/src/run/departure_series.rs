//! Departures as series in time, their correlations, and what a few columns explain of them.

use std::collections::BTreeMap;

use varda_linalg::dense::Cholesky;

use crate::outcome::Quantity;

/// One observed value after the analysis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Departure {
    /// Index of its marker, place or component; in space in the order of arc length.
    pub site: usize,
    /// What the value is of.
    pub quantity: Quantity,
    /// Axis of the value, 0 to 2 in space, 0 and 1 in an image; 0 elsewhere.
    pub axis: usize,
    /// When it was seen \[s\].
    pub time: f64,
    /// d = y − H(x_a); of correlated errors what it is beyond what the values before it say.
    pub value: f64,
    /// Its assumed σ.
    pub sigma: f64,
    /// H(x_a).
    pub predicted: f64,
    /// Rate of change of H(x_a) at that time.
    pub rate: f64,
}

/// Departures are white where no correlation is larger than this, or than four of its standard errors.
const WHITE: f64 = 0.3;

/// The values of each site and axis in the order of time.
pub(super) struct Series {
    /// Site, axis, and the indices with their d/σ.
    pub(super) each: Vec<(usize, usize, Vec<(usize, f64, f64)>)>,
    /// Which of them is that of an axis and a site.
    places: BTreeMap<(usize, usize), usize>,
}

impl Series {
    pub(super) fn of(departures: &[Departure], r: &[f64]) -> Series {
        let mut each: Vec<(usize, usize, Vec<(usize, f64, f64)>)> = Vec::new();
        let mut places = BTreeMap::new();
        for (i, d) in departures.iter().enumerate() {
            let place = *places.entry((d.axis, d.site)).or_insert_with(|| {
                each.push((d.site, d.axis, Vec::new()));
                each.len() - 1
            });
            each[place].2.push((i, d.time, r[i]));
        }
        each.iter_mut().for_each(|s| s.2.sort_by(|a, b| a.1.total_cmp(&b.1)));
        Series { each, places }
    }

    pub(super) fn pairs_in_time(&self) -> Vec<[f64; 2]> {
        self.each.iter().flat_map(|s| s.2.windows(2).map(|w| [w[0].2, w[1].2])).collect()
    }

    /// About their mean.
    pub(super) fn pairs_in_time_of(&self, site: usize) -> Vec<[f64; 2]> {
        let own = self.each.iter().filter(|s| s.0 == site);
        own.flat_map(|s| {
            let mean = s.2.iter().map(|v| v.2).sum::<f64>() / s.2.len() as f64;
            s.2.windows(2).map(move |w| [w[0].2 - mean, w[1].2 - mean])
        })
        .collect()
    }

    pub(super) fn pairs_of_neighbours(&self) -> Vec<[f64; 2]> {
        let mut pairs = Vec::new();
        for (site, axis, values) in &self.each {
            let next = self.places.range((*axis, site + 1)..(axis + 1, 0)).next();
            for (_, time, value) in values {
                let beside = next.and_then(|(_, s)| at_time(&self.each[*s].2, *time));
                pairs.extend(beside.map(|v| [*value, v.2]));
            }
        }
        pairs
    }

    /// Share of Σ (d/σ)² that the time means of sites and axes are.
    pub(super) fn share_of_means(&self) -> f64 {
        let (mut means, mut all) = (0.0, 0.0);
        for (_, _, values) in &self.each {
            let sum: f64 = values.iter().map(|v| v.2).sum();
            means += sum * sum / values.len() as f64;
            all += values.iter().map(|v| v.2 * v.2).sum::<f64>();
        }
        means / all
    }

    /// H − H̄ of every value.
    pub(super) fn about_means(&self, departures: &[Departure]) -> Vec<f64> {
        let mut out = vec![0.0; departures.len()];
        for (_, _, values) in &self.each {
            let mean = values.iter().map(|v| departures[v.0].predicted).sum::<f64>() / values.len() as f64;
            values.iter().for_each(|v| out[v.0] = departures[v.0].predicted - mean);
        }
        out
    }

    /// For every value the predicted place of its site at its time; `None` where an axis was not seen.
    pub(super) fn places(&self, departures: &[Departure]) -> Vec<Option<[f64; 3]>> {
        let at = |d: &Departure, axis: usize| {
            let series = &self.each[*self.places.get(&(axis, d.site))?];
            Some(departures[at_time(&series.2, d.time)?.0].predicted)
        };
        departures.iter().map(|d| Some([at(d, 0)?, at(d, 1)?, at(d, 2)?])).collect()
    }
}

/// The first value of a series at a time.
fn at_time(series: &[(usize, f64, f64)], time: f64) -> Option<&(usize, f64, f64)> {
    series.get(series.partition_point(|v| v.1 < time)).filter(|v| v.1 == time)
}

/// A correlation of neighbouring values.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Correlation {
    pub(super) value: f64,
    pub(super) pairs: usize,
}

impl Correlation {
    pub(super) fn of(pairs: &[[f64; 2]]) -> Correlation {
        let sum = |f: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(f).sum::<f64>();
        let size = (sum(&|p| p[0] * p[0]) * sum(&|p| p[1] * p[1])).sqrt();
        let value = if size > 0.0 { sum(&|p| p[0] * p[1]) / size } else { 0.0 };
        Correlation { value, pairs: pairs.len() }
    }

    pub(super) fn is_white(&self) -> bool {
        self.value.abs() <= WHITE.max(4.0 / (self.pairs.max(1) as f64).sqrt())
    }
}

/// Least squares of r by some columns: the share of Σ r² explained, and the coefficients; `None` where they
/// do not tell, being dependent.
pub(super) fn explained(r: &[f64], columns: &[Vec<f64>]) -> Option<(f64, Vec<f64>)> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let n = columns.len();
    let scale: Vec<f64> = columns.iter().map(|c| dot(c, c).sqrt()).collect();
    if scale.iter().any(|s| !(*s > 0.0)) {
        return None;
    }
    let entry = |i: usize, j: usize| {
        dot(&columns[i], &columns[j]) / (scale[i] * scale[j]) + if i == j { 1e-10 } else { 0.0 }
    };
    let matrix: Vec<f64> = (0..n * n).map(|ij| entry(ij / n, ij % n)).collect();
    let right: Vec<f64> = (0..n).map(|i| dot(&columns[i], r) / scale[i]).collect();
    let mut x = right.clone();
    Cholesky::new(n, &matrix).ok()?.solve_columns(&mut x);
    let share = dot(&right, &x) / dot(r, r);
    Some((share, x.iter().zip(&scale).map(|(x, s)| x / s).collect()))
}
