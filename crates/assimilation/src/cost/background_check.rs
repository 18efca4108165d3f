//! The background check: values that the background makes implausible.

use super::{CostFunction, EnVar, LeastSquares, StrongConstraint, WeakForcing};
use crate::{Error, ObservationSet};

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
}

impl StrongConstraint<'_> {
    /// The background check (Ingleby and Lorenc 1993): the values with |y − H(x_b)| > `limit` √(H B Hᵀ
    /// + R), to be left out with [`ObservationSet::without`]. Costs a gradient at v = 0 and min(n, m) sweeps.
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
        let checked =
            self.evaluate(&vec![0.0; n], Some(&mut vec![0.0; n])).and_then(|_| spread_of_departures(self));
        self.set_huber(delta)?;
        let mut d = vec![0.0; self.observation_dim()];
        let spread = checked?;
        self.observations().innovations(self.predicted(), &mut d);
        self.observations().whiten(&mut d);
        refused(&d, &spread, limit, self.observations())
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
        let spread = spread_of_departures(self)?;
        refused(self.whitened_innovations(), &spread, limit, self.observations())
    }
}

/// √(diag(G Gᵀ) + 1): what d/σ should be like.
fn spread_of_departures(cost: &mut dyn LeastSquares) -> Result<Vec<f64>, Error> {
    let (n, m) = (cost.dim(), cost.observation_dim());
    let (mut unit_v, mut unit_y) = (vec![0.0; n], vec![0.0; m]);
    let mut variance = vec![1.0; m];
    if n <= m {
        let mut dy = vec![0.0; m];
        for j in 0..n {
            unit_v[j] = 1.0;
            cost.jacobian(&unit_v, &mut dy)?;
            unit_v[j] = 0.0;
            variance.iter_mut().zip(&dy).for_each(|(s, g)| *s += g * g);
        }
    } else {
        let mut dv = vec![0.0; n];
        for a in 0..m {
            unit_y[a] = 1.0;
            cost.jacobian_transpose(&unit_y, &mut dv)?;
            unit_y[a] = 0.0;
            variance[a] += super::dot(&dv, &dv);
        }
    }
    variance.iter_mut().for_each(|s| *s = s.sqrt());
    Ok(variance)
}

/// The rows whose whitened departure exceeds `limit` times its spread.
fn refused(
    d: &[f64],
    spread: &[f64],
    limit: f64,
    observations: &ObservationSet,
) -> Result<Vec<Rejection>, Error> {
    if !(limit > 0.0) {
        return Err(Error::Setting { what: "the limit of the background check", value: limit });
    }
    if observations.is_correlated() {
        return Err(Error::CorrelatedErrors { what: "the background check" });
    }
    let mut refused = Vec::new();
    for (i, observation) in observations.observations().iter().enumerate() {
        for (entry, row) in observations.rows(i).enumerate() {
            if !(d[row].abs() <= limit * spread[row]) {
                refused.push(Rejection {
                    row,
                    observation: i,
                    entry,
                    step: observation.step,
                    label: observation.label.clone(),
                    departure: d[row] * observation.sigma[entry],
                    expected: spread[row] * observation.sigma[entry],
                });
            }
        }
    }
    Ok(refused)
}
