//! Departures of windows, summed: whether the errors assumed are those found.

use crate::{Error, LeastSquares};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::ops::Add;

/// Sums over the observed values of a window, in units of σ_o: d_ob = y − H(x_b), d_oa = y −
/// H(x_a), d_ab = d_ob − d_oa, all whitened by R^{-1/2}. Sums of several windows add up.
///
/// Their ratios are about 1 where B and R are right (Desroziers et al. 2005; linear problems): see
/// [`consistency`](crate::consistency()) for groups of values.
///
/// ```
/// use varda_assimilation::Departures;
///
/// // one value, B = 3 σ_o²: d_ob = 2 σ_o, of which the analysis leaves a quarter
/// let one = Departures { count: 1, background: 4.0, analysis: 1.0, increment: 3.0, predicted: 3.0 };
/// assert_eq!(one.innovation_ratio(), Some(1.0));
/// assert_eq!((one.observation_ratio(), one.background_ratio()), (Some(1.0), Some(1.0)));
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Departures {
    /// Observed values m.
    pub count: usize,
    /// Σ d_ob².
    pub background: f64,
    /// Σ d_oa d_ob.
    pub analysis: f64,
    /// Σ d_ab d_ob.
    pub increment: f64,
    /// tr G Gᵀ = Σ (HBHᵀ)_ii / σ_o², what B says of Σ d_ab d_ob.
    pub predicted: f64,
}

impl Departures {
    /// Of whitened departures from background and analysis.
    pub(crate) fn of(background: &[f64], analysis: &[f64], predicted: f64) -> Self {
        let sum =
            |of: &dyn Fn(f64, f64) -> f64| background.iter().zip(analysis).map(|(b, a)| of(*b, *a)).sum();
        Self {
            count: background.len(),
            background: sum(&|b, _| b * b),
            analysis: sum(&|b, a| a * b),
            increment: sum(&|b, a| (b - a) * b),
            predicted,
        }
    }

    /// Σ d_ob² / Σ (HBHᵀ + R): above 1 where background or observations are worse than said;
    /// `None` where nothing was observed.
    pub fn innovation_ratio(&self) -> Option<f64> {
        (self.count > 0).then(|| self.background / (self.count as f64 + self.predicted))
    }

    /// Σ d_oa d_ob / Σ R: above 1 where σ_o is too small.
    pub fn observation_ratio(&self) -> Option<f64> {
        (self.count > 0).then(|| self.analysis / self.count as f64)
    }

    /// Σ d_ab d_ob / Σ HBHᵀ: above 1 where B is too small.
    pub fn background_ratio(&self) -> Option<f64> {
        (self.predicted > 0.0).then(|| self.increment / self.predicted)
    }
}

impl Add for Departures {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            background: self.background + other.background,
            analysis: self.analysis + other.analysis,
            increment: self.increment + other.increment,
            predicted: self.predicted + other.predicted,
        }
    }
}

/// Adjoint sweeps that a sequence spends on what B says of its innovations, at least one a window.
const SWEEPS: usize = 32;

/// Whitened departures of the background, which is the control `start`, and tr GGᵀ = E ‖Gᵀw‖² over
/// vectors w of signs, one a window of a long sequence; over all unit vectors, where those are fewer. A
/// gradient that the minimization asks for again, and an adjoint sweep each.
pub(crate) fn expected_departures(
    cost: &mut dyn LeastSquares,
    start: &[f64],
    window: usize,
    windows: usize,
) -> Result<(Vec<f64>, f64), Error> {
    let (n, m) = (cost.dim(), cost.observation_dim());
    let (mut b, mut d, mut back) = (vec![0.0; n], vec![0.0; m], vec![0.0; n]);
    if m == 0 {
        return Ok((d, 0.0));
    }
    cost.evaluate(start, Some(&mut back))?;
    cost.departures(&mut b, &mut d);
    let sweeps = (SWEEPS / windows.max(1)).max(1);
    let mut rng = ChaCha8Rng::seed_from_u64(window as u64);
    let mut sum = 0.0;
    for i in 0..sweeps.min(m) {
        let mut w = vec![0.0; m];
        match m <= sweeps {
            true => w[i] = 1.0,
            false => w.fill_with(|| 1.0_f64.copysign(StandardNormal.sample(&mut rng))),
        }
        cost.jacobian_transpose(&w, &mut back)?;
        sum += back.iter().map(|g| g * g).sum::<f64>();
    }
    Ok((d, if m <= sweeps { sum } else { sum / sweeps as f64 }))
}

/// Departures of a window at its analysis v; `None` where it has none.
pub(crate) fn departures_at(
    cost: &mut dyn LeastSquares,
    v: &[f64],
    background: &[f64],
    predicted: f64,
) -> Option<Departures> {
    let (mut b, mut d) = (vec![0.0; v.len()], vec![0.0; background.len()]);
    if d.is_empty() || cost.evaluate(v, Some(&mut b)).is_err() {
        return None;
    }
    cost.departures(&mut b, &mut d);
    Some(Departures::of(background, &d, predicted))
}
