//! The parts of J, and σ of a state given the constants that were estimated.

use varda_assimilation::Analysis;
use varda_covariance::Precision;

use crate::Error;
use crate::outcome::{KnownConstants, ModelErrors, Share};
use crate::setup::Problem;
use crate::setup::estimate::Estimates;

/// J_b of the state and of the constants, J_q and J_o, with their means where the posterior of a method with
/// a Hessian says them. Of d degrees of freedom for signal of state and constants, of E\[J_q\] and of the
/// constants' own part of d,
///
/// ```text
/// E[J_b + J_p] = ½d,   E[J_p] = ½ (n_p − tr B_p⁻¹ P_p),   E[J_o] = ½m − ½d − E[J_q]
/// ```
///
/// # Errors
/// [`Error::Covariance`] where the prior of the constants cannot be formed.
pub(super) fn shares(
    problem: &Problem,
    analysis: &Analysis,
    errors: Option<&ModelErrors>,
    has_posterior: bool,
    root: &[f64],
) -> Result<Vec<Share>, Error> {
    let algorithm = &problem.experiment.scene.algorithm;
    let (terms, estimates) = (&analysis.terms, problem.system.estimates());
    let mut all = Vec::new();
    let mut add = |part, j, expected| all.push(Share { part, j, expected });
    let known = has_posterior && algorithm.robust.is_none() && !algorithm.method.is_ensemble();
    let signal = known.then_some(0.5 * analysis.degrees_of_freedom);
    let of_errors = errors.map_or(Some(0.0), |errors| errors.expected_j_q).filter(|_| known);
    // increments of an ensemble are not weighed by the two priors apart
    if estimates.is_empty() || algorithm.method.is_ensemble() {
        add("background of the state", terms.background, signal);
    } else {
        let prior = Prior::of(estimates)?;
        let n = analysis.analysis.len();
        let p = n - estimates.len()..n;
        let increment: Vec<f64> = p.clone().map(|i| analysis.analysis[i] - analysis.background[i]).collect();
        let j = 0.5 * prior.square(&increment);
        let left = match root.is_empty() {
            false => Some(root.chunks_exact(n).map(|w| prior.square(&w[p.clone()])).sum::<f64>()),
            true => estimates.are_independent().then(|| {
                let of = |(i, c): (usize, &crate::setup::estimate::Constant)| {
                    (analysis.sigma_analysis[p.start + i] / c.sigma).powi(2)
                };
                estimates.constants.iter().enumerate().map(of).sum()
            }),
        };
        let expected = left.filter(|_| known).map(|left| 0.5 * (estimates.len() as f64 - left));
        let of_state = signal.zip(expected).map(|(signal, expected)| signal - expected);
        add("background of the state", terms.background - j, of_state);
        add("prior of the constants", j, expected);
    }
    if errors.is_some() {
        add("model error", terms.model_error, of_errors);
    }
    let half = 0.5 * analysis.observations as f64;
    add("observations", terms.observation, signal.zip(of_errors).map(|(signal, q)| half - signal - q));
    Ok(all)
}

/// The same of one of several recordings: its own unknowns and its observations. The degrees of freedom of
/// the analysis are those that its observations determine.
pub(super) fn of_one_of_several(analysis: &Analysis, has_mean: bool) -> Vec<Share> {
    let left = 0.5 * (analysis.observations as f64 - analysis.degrees_of_freedom);
    let expected = has_mean.then_some(left);
    vec![
        Share { part: "background of its own unknowns", j: analysis.terms.background, expected: None },
        Share { part: "observations", j: analysis.terms.observation, expected },
    ]
}

/// B_p⁻¹.
struct Prior(Box<dyn Precision>);

impl Prior {
    fn of(estimates: &Estimates) -> Result<Prior, Error> {
        Ok(Prior(estimates.covariance()?))
    }

    /// δpᵀ B_p⁻¹ δp.
    fn square(&self, dp: &[f64]) -> f64 {
        let mut product = vec![0.0; dp.len()];
        self.0.whiten(dp, &mut product);
        dot(&product, &product)
    }
}

/// The posterior given the constants. With the rows W_x, W_p of a root of P_a,
///
/// ```text
/// P_{x|p} = P_x − P_xp P_p⁻¹ P_px = W_x (I − Q Qᵀ) W_xᵀ
/// ```
///
/// with Q an orthonormal basis of the rows of W_p.
pub(super) struct Given {
    /// The vectors of Q, one after the other.
    basis: Vec<f64>,
    columns: usize,
}

/// Rows that are so much of others are those.
const SAME: f64 = 1e-8;

impl Given {
    /// Given the last `constants` numbers of a control of n, `root` by columns of n.
    pub(super) fn of(root: &[f64], n: usize, constants: usize) -> Option<Given> {
        let columns = root.len() / n.max(1);
        if constants == 0 || columns == 0 {
            return None;
        }
        let mut basis: Vec<f64> = Vec::new();
        for i in n - constants..n {
            let mut row: Vec<f64> = root.chunks_exact(n).map(|column| column[i]).collect();
            let size = norm(&row);
            // once more takes out what rounding left of the others
            for _ in 0..2 {
                for q in basis.chunks_exact(columns) {
                    let along = dot(&row, q);
                    row.iter_mut().zip(q).for_each(|(r, q)| *r -= along * q);
                }
            }
            let rest = norm(&row);
            if rest > SAME * size {
                basis.extend(row.iter().map(|r| r / rest));
            }
        }
        Some(Given { basis, columns })
    }

    /// σ of component i of states with n numbers whose root is W, and σ given the constants.
    fn sigmas(&self, w: &[f64], n: usize, i: usize) -> [f64; 2] {
        let row: Vec<f64> = w.chunks_exact(n).map(|column| column[i]).collect();
        let all = dot(&row, &row);
        let seen: f64 = self.basis.chunks_exact(self.columns).map(|q| dot(&row, q).powi(2)).sum();
        [all.sqrt(), (all - seen).max(0.0).sqrt()]
    }

    /// Of the tip of a rod, or where σ is largest of what is free; of other models the component with the
    /// largest σ. W is the root of the states at step k.
    pub(super) fn shown(&self, problem: &Problem, k: usize, n: usize, w: &[f64]) -> Option<KnownConstants> {
        let time = problem.experiment.grid.time(k);
        let state = &problem.experiment.state;
        let largest = |all: &[[f64; 2]]| (0..all.len()).max_by(|a, b| all[*a][0].total_cmp(&all[*b][0]));
        let Some(geometry) = &state.geometry else {
            let own = state.len() - problem.system.estimates().len();
            let all: Vec<[f64; 2]> = (0..own).map(|i| self.sigmas(w, n, i)).collect();
            let i = largest(&all)?;
            let [sigma, sigma_known] = all[i];
            let unit = state.groups.iter().find(|g| g.range.contains(&i)).map_or("1", |g| g.unit);
            let of = state.names[i].clone();
            return Some(KnownConstants { of, unit, time, sigma, sigma_known });
        };
        let place = |f: usize| {
            let of = [0, 1, 2].map(|c| self.sigmas(w, n, 3 * f + c));
            [0, 1].map(|s| of.iter().map(|sigma| sigma[s].powi(2)).sum::<f64>().sqrt())
        };
        let all: Vec<[f64; 2]> = (0..geometry.free.len()).map(place).collect();
        let tip = geometry.free.last().is_some_and(|v| v + 1 == geometry.arc_lengths.len());
        let f = if tip { all.len() - 1 } else { largest(&all)? };
        let of = match tip {
            true => "place of the tip".to_string(),
            false => format!("place at {:.4} m", geometry.arc_lengths[geometry.free[f]]),
        };
        let [sigma, sigma_known] = all[f];
        Some(KnownConstants { of, unit: "m", time, sigma, sigma_known })
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// P = [[2, 1, 0.5], [1, 2, 0], [0.5, 0, 1]] of (x, p, q) by its Cholesky factor.
    #[test]
    fn given_constants_are_conditioned_on() {
        let l21 = 1.0 / 2.0_f64.sqrt();
        let l22 = 1.5_f64.sqrt();
        let (l31, l32) = (0.5 / 2.0_f64.sqrt(), -0.25 / 1.5_f64.sqrt());
        let l33 = (1.0 - l31 * l31 - l32 * l32).sqrt();
        let root = [2.0_f64.sqrt(), l21, l31, 0.0, l22, l32, 0.0, 0.0, l33];
        let one = Given::of(&root, 3, 1).unwrap().sigmas(&root, 3, 0);
        // given q: 2 − 0.5²/1
        assert!((one[0].powi(2) - 2.0).abs() < 1e-14 && (one[1].powi(2) - 1.75).abs() < 1e-14, "{one:?}");
        // given p and q: 2 − 1/2 − 0.25
        let both = Given::of(&root, 3, 2).unwrap().sigmas(&root, 3, 0);
        assert!((both[1].powi(2) - 1.25).abs() < 1e-14, "{both:?}");
        assert!(Given::of(&root, 3, 0).is_none());
    }

    /// Two constants that are the same one.
    #[test]
    fn constants_that_depend_on_each_other_count_once() {
        let root = [1.0, 1.0, 2.0, 1.0, 0.0, 0.0];
        let [sigma, given] = Given::of(&root, 3, 2).unwrap().sigmas(&root, 3, 0);
        assert!((sigma - 2.0_f64.sqrt()).abs() < 1e-14 && (given - 1.0).abs() < 1e-14);
    }
}
