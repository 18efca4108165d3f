//! The background check: values that the background makes implausible.

use super::chi_squared;
use super::{CostFunction, EnVar, LeastSquares, StrongConstraint, WeakForcing};
use crate::{Error, ObservationSet};
use std::ops::Range;
use varda_linalg::dense::Cholesky;

/// An observed value that the background check refuses.
#[derive(Debug, Clone, PartialEq)]
pub struct Rejection {
    /// Its row in the stacked vector.
    pub row: usize,
    /// Index of its observation in the set (in order of time).
    pub observation: usize,
    /// Its position within that observation.
    pub entry: usize,
    /// The step of that observation.
    pub step: usize,
    /// Whose measurement it is.
    pub label: String,
    /// d_b = y − H(x_b), in the unit of the value.
    pub departure: f64,
    /// √(H B Hᵀ + R), the standard deviation expected of it, in the unit of the value.
    pub expected: f64,
    /// √(dᵀ (H B Hᵀ + R)⁻¹ d) of all values judged with it (Mahalanobis 1936); |d|/expected of one
    /// alone.
    pub distance: f64,
}

impl StrongConstraint<'_> {
    /// The background check (Ingleby and Lorenc 1993): the values with |y − H(x_b)| > `limit` √(H B Hᵀ
    /// + R), to be left out with [`ObservationSet::without`]. Costs a gradient at v = 0 and min(n, m) sweeps.
    ///
    /// The r values of an observation marked [`together`](crate::Observation::together) are judged by dᵀ (H
    /// B Hᵀ + R)⁻¹ d, which is χ² with r degrees of freedom, and refused whole: as rarely by chance as
    /// one value beyond `limit`.
    ///
    /// Linear: where the background is so far off that H B Hᵀ says nothing about it, good observations are
    /// refused; count what it refuses.
    ///
    /// # Errors
    /// A limit that is not positive; correlated observation errors, of which a single value cannot be judged
    /// alone; a background at which the cost cannot be evaluated.
    pub fn background_check(&mut self, limit: f64) -> Result<Vec<Rejection>, Error> {
        let n = self.dim();
        let delta = self.huber_threshold();
        self.set_huber(f64::INFINITY)?;
        let groups = judged_together(self.observations());
        let checked = self
            .evaluate(&vec![0.0; n], Some(&mut vec![0.0; n]))
            .and_then(|_| covariances_of_departures(self, &groups));
        self.set_huber(delta)?;
        let mut d = vec![0.0; self.observation_dim()];
        let covariances = checked?;
        self.observations().innovations(self.predicted(), &mut d);
        self.observations().whiten(&mut d);
        refused(&d, &covariances, limit, self.observations())
    }
}

impl WeakForcing<'_> {
    /// The background check, H B Hᵀ with what the errors of the model add to it, H (M B Mᵀ + Q …) Hᵀ.
    /// Otherwise that of [`StrongConstraint::background_check`].
    ///
    /// # Errors
    /// A limit that is not positive; correlated observation errors, of which a single value cannot be judged
    /// alone; a background at which the cost cannot be evaluated.
    pub fn background_check(&mut self, limit: f64) -> Result<Vec<Rejection>, Error> {
        self.window.background_check(limit)
    }
}

impl EnVar<'_> {
    /// The background check, H B Hᵀ being that of the ensemble. Asked for before the first outer iteration:
    /// it is made about the point of the last linearization, which is the background at first.
    ///
    /// # Errors
    /// A limit that is not positive.
    pub fn background_check(&mut self, limit: f64) -> Result<Vec<Rejection>, Error> {
        let groups = judged_together(self.observations());
        let covariances = covariances_of_departures(self, &groups)?;
        refused(self.whitened_innovations(), &covariances, limit, self.observations())
    }
}

/// The rows of values that are judged together, in the order of the rows.
fn judged_together(observations: &ObservationSet) -> Vec<Range<usize>> {
    let mut groups = Vec::new();
    for (i, observation) in observations.observations().iter().enumerate() {
        let rows = observations.rows(i);
        if observation.together {
            groups.push(rows);
        } else {
            groups.extend(rows.map(|row| row..row + 1));
        }
    }
    groups
}

/// A group of rows and the covariance of its departures over σ, I + G Gᵀ, by columns.
struct Departures {
    rows: Range<usize>,
    covariance: Vec<f64>,
}

impl Departures {
    /// Adds w wᵀ, where w is a column of G.
    fn add(&mut self, column: &[f64]) {
        let w = &column[self.rows.clone()];
        for (j, w_j) in w.iter().enumerate() {
            let target = &mut self.covariance[j * w.len()..(j + 1) * w.len()];
            target.iter_mut().zip(w).for_each(|(c, w_i)| *c += w_i * w_j);
        }
    }

    /// √(dᵀ (I + G Gᵀ)⁻¹ d).
    fn distance(&self, d: &[f64]) -> Result<f64, Error> {
        let mut half = d[self.rows.clone()].to_vec();
        if let [only] = half[..] {
            return Ok(only.abs() / self.covariance[0].sqrt());
        }
        Cholesky::new(half.len(), &self.covariance)?.forward(&mut half);
        Ok(super::dot(&half, &half).sqrt())
    }
}

fn covariances_of_departures(
    cost: &mut dyn LeastSquares,
    groups: &[Range<usize>],
) -> Result<Vec<Departures>, Error> {
    let (n, m) = (cost.dim(), cost.observation_dim());
    let identity = |r: usize| (0..r * r).map(|i| if i % (r + 1) == 0 { 1.0 } else { 0.0 }).collect();
    let mut all: Vec<Departures> =
        groups.iter().map(|g| Departures { rows: g.clone(), covariance: identity(g.len()) }).collect();
    let (mut unit_v, mut unit_y) = (vec![0.0; n], vec![0.0; m]);
    if n <= m {
        let mut dy = vec![0.0; m];
        for j in 0..n {
            unit_v[j] = 1.0;
            cost.jacobian(&unit_v, &mut dy)?;
            unit_v[j] = 0.0;
            all.iter_mut().for_each(|group| group.add(&dy));
        }
        return Ok(all);
    }
    for Departures { rows, covariance } in &mut all {
        let r = rows.len();
        let mut g = vec![0.0; n * r];
        for (row, g) in rows.clone().zip(g.chunks_exact_mut(n)) {
            unit_y[row] = 1.0;
            cost.jacobian_transpose(&unit_y, g)?;
            unit_y[row] = 0.0;
        }
        for i in 0..r {
            for j in 0..r {
                covariance[i + j * r] += super::dot(&g[i * n..(i + 1) * n], &g[j * n..(j + 1) * n]);
            }
        }
    }
    Ok(all)
}

/// The rows of the groups whose whitened departures are farther out than `limit` standard deviations of a
/// single value are likely.
fn refused(
    d: &[f64],
    groups: &[Departures],
    limit: f64,
    observations: &ObservationSet,
) -> Result<Vec<Rejection>, Error> {
    if !(limit > 0.0) {
        return Err(Error::Setting { what: "the limit of the background check", value: limit });
    }
    if observations.is_correlated() {
        return Err(Error::CorrelatedErrors { what: "the background check" });
    }
    let mut limits = Vec::new();
    let mut refused = Vec::new();
    for group in groups {
        let r = group.rows.len();
        limits.extend((limits.len()..=r).map(|r| chi_squared::distance(limit, r)));
        let distance = group.distance(d)?;
        if distance <= limits[r] {
            continue;
        }
        for (i, row) in group.rows.clone().enumerate() {
            let observation = observations.observation_of(row);
            let entry = row - observations.rows(observation).start;
            let seen = &observations.observations()[observation];
            refused.push(Rejection {
                row,
                observation,
                entry,
                step: seen.step,
                label: seen.label.clone(),
                departure: d[row] * seen.sigma[entry],
                expected: group.covariance[i * (r + 1)].sqrt() * seen.sigma[entry],
                distance,
            });
        }
    }
    Ok(refused)
}
