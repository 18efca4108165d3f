//! Whether B and R are what they should be: statistics of departures.

use crate::{Error, LeastSquares, ObservationErrors};

/// Departures of one group of observations, summed, against what B and R promise (Desroziers, Berre, Chapnik
/// and Poli 2005):
///
/// ```text
///     E[d_oa · d_ob] = tr R,    E[d_ab · d_ob] = tr HBHᵀ,    E[d_ob · d_ob] = tr (HBHᵀ + R),
///     E[d_ab · d_oa] = tr HP_aHᵀ
/// ```
///
/// with d_ob = y − H(x_b), d_oa = y − H(x_a), d_ab = H(x_a) − H(x_b). Exact in the mean for a linear H
/// and right B and R; one window gives one sample, with relative scatter of about (2 / count)^{1/2}. When
/// not: where H M is strongly nonlinear over the increment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Consistency {
    /// Observed values in the group.
    pub count: usize,
    /// Σ d_oa d_ob / Σ σ_o²: about 1 where R is right, below where σ_o is too large.
    pub observation_ratio: f64,
    /// Σ d_ab d_ob / Σ (HBHᵀ)_ii: about 1 where B is right.
    pub background_ratio: f64,
    /// Σ d_ob² / Σ ((HBHᵀ)_ii + σ_o²): about 1 where their sum is.
    pub innovation_ratio: f64,
    /// Σ d_ab d_oa / count: an estimate of the mean of (HP_aHᵀ)_ii.
    pub analysis_variance: f64,
}

/// The ratios of every group, 0 to the largest index in `groups`; a group without values has count 0 and
/// ratios NaN.
///
/// All slices have one entry for each observed value: y, σ_o, H(x_b), H(x_a), (HBHᵀ)_ii (see
/// [`predicted_variance`]) and the group. Cost: O(m).
///
/// ```
/// use varda_assimilation::consistency;
///
/// // One group of two values with σ_o = 1, predicted with variance 1: the analysis goes half the way.
/// let ratios = consistency(&[1.0, -1.0], &[1.0; 2], &[0.0; 2], &[0.5, -0.5], &[1.0; 2], &[0, 0]);
/// assert_eq!((ratios[0].count, ratios[0].observation_ratio, ratios[0].background_ratio), (2, 0.5, 0.5));
/// ```
///
/// # Panics
/// If the slices differ in length.
pub fn consistency(
    values: &[f64],
    sigma: &[f64],
    at_background: &[f64],
    at_analysis: &[f64],
    predicted_variance: &[f64],
    groups: &[usize],
) -> Vec<Consistency> {
    let m = values.len();
    for slice in [sigma, at_background, at_analysis, predicted_variance] {
        assert_eq!(slice.len(), m, "one entry for each observed value");
    }
    assert_eq!(groups.len(), m, "one group for each observed value");
    (0..groups.iter().max().map_or(0, |g| g + 1))
        .map(|group| {
            let (mut count, mut r, mut hbh, mut oa_ob, mut ab_ob, mut ob_ob, mut ab_oa) =
                (0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
            for i in (0..m).filter(|&i| groups[i] == group) {
                let (ob, oa) = (values[i] - at_background[i], values[i] - at_analysis[i]);
                let ab = at_analysis[i] - at_background[i];
                count += 1;
                r += sigma[i] * sigma[i];
                hbh += predicted_variance[i];
                oa_ob += oa * ob;
                ab_ob += ab * ob;
                ob_ob += ob * ob;
                ab_oa += ab * oa;
            }
            Consistency {
                count,
                observation_ratio: oa_ob / r,
                background_ratio: ab_ob / hbh,
                innovation_ratio: ob_ob / (hbh + r),
                analysis_variance: ab_oa / count as f64,
            }
        })
        .collect()
}

/// (HMBMᵀHᵀ)_ii = ‖Gᵀ R^{1/2}ᵀ e_i‖² of every observed value, around the point of the last
/// gradient: the variance the prior gives to the prediction, in the unit of the value squared. `errors` are
/// those of the cost's observations, independent or correlated: G is whitened by them. Cost: m adjoint
/// sweeps.
///
/// # Errors
/// Products that fail.
///
/// # Panics
/// If no gradient has been evaluated, or `errors` is not of m values.
pub fn predicted_variance(
    cost: &mut dyn LeastSquares,
    errors: &ObservationErrors,
) -> Result<Vec<f64>, Error> {
    let m = cost.observation_dim();
    assert_eq!(errors.dim(), m, "number of observed values");
    let mut unit = vec![0.0; m];
    let mut row = vec![0.0; cost.dim()];
    let mut variance = vec![0.0; m];
    for (i, variance) in variance.iter_mut().enumerate() {
        unit.fill(0.0);
        unit[i] = 1.0;
        errors.root_transpose(&mut unit);
        cost.jacobian_transpose(&unit, &mut row)?;
        *variance = crate::cost::dot(&row, &row);
    }
    Ok(variance)
}
