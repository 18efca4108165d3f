//! What a window hands on: members turned about their mean, drawn again where one fails, inflated as their
//! finite number asks for; the root of a posterior.

use crate::cost::{CostFunction, StrongConstraint, dot, norm, run_each};
use crate::minimize::eigen;
use crate::{ControlTransform, Error, Posterior};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use varda_implicit::{Log, Model};
use varda_linalg::Svd;
use varda_linalg::dense::{View, product};

/// What a finite number of members can ask for at most.
const LARGEST_INFLATION: f64 = 5.0;
/// Draws of a member that fails, each half as far from the mean as the one before.
const DRAWS: usize = 20;

/// Turns the members, vectors of length n one after the other, about their mean by a random rotation: the
/// same mean and the same sample covariance (Sakov and Oke 2008). Without it a square root carries the same
/// combinations of members for ever, and some members become outliers.
pub(crate) fn rotate(members: &mut [f64], n: usize, normal: &mut dyn FnMut() -> f64) {
    let count = members.len() / n;
    if count < 2 {
        return;
    }
    let mean = mean(members, n);
    let omega = rotation(count, normal);
    let old = members.to_vec();
    for (i, member) in members.chunks_exact_mut(n).enumerate() {
        member.copy_from_slice(&mean);
        for (j, x) in old.chunks_exact(n).enumerate() {
            let w = omega[j + i * count];
            member.iter_mut().zip(x.iter().zip(&mean)).for_each(|(m, (x, mean))| *m += w * (x - mean));
        }
    }
}

/// A random orthogonal matrix with Ω 1 = 1, by columns: rotations of the complement of (1, …, 1).
fn rotation(count: usize, normal: &mut dyn FnMut() -> f64) -> Vec<f64> {
    // Two orthonormal bases that begin with (1, …, 1)/√N; Ω takes one to the other.
    let bases = [0, 1].map(|_| {
        let mut basis = vec![1.0 / (count as f64).sqrt(); count];
        while basis.len() < count * count {
            let mut q: Vec<f64> = (0..count).map(|_| normal()).collect();
            // Twice is enough.
            for p in basis.chunks_exact(count).chain(basis.chunks_exact(count)) {
                let c = dot(p, &q);
                q.iter_mut().zip(p).for_each(|(q, p)| *q -= c * p);
            }
            let length = norm(&q);
            if length > 1e-6 {
                basis.extend(q.iter().map(|q| q / length));
            }
        }
        basis
    });
    let mut omega = vec![0.0; count * count];
    for (p, q) in bases[0].chunks_exact(count).zip(bases[1].chunks_exact(count)) {
        for (column, q) in omega.chunks_exact_mut(count).zip(q) {
            column.iter_mut().zip(p).for_each(|(o, p)| *o += p * q);
        }
    }
    omega
}

/// Runs every member over `steps` steps. One that fails is drawn again, about the mean of the others with
/// their covariance, closer with every attempt; how many were.
///
/// # Errors
/// The failure of a member, where all fail or one fails however often it is drawn.
pub(crate) fn run_all_drawing_again<'m>(
    models: &mut [Box<dyn Model + Send + 'm>],
    members: &mut [f64],
    states: &mut [f64],
    steps: usize,
    seed: u64,
) -> Result<usize, Error> {
    let n = members.len() / models.len();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut log = Log::default();
    let mut drawn = vec![false; models.len()];
    let mut scale = 1.0;
    for _ in 0..=DRAWS {
        let ended = run_each(models, members, states, steps, &mut log);
        let failed: Vec<bool> = ended.iter().map(Result::is_err).collect();
        let Some(failure) = ended.into_iter().find_map(Result::err) else {
            return Ok(drawn.iter().filter(|d| **d).count());
        };
        let healthy: Vec<f64> = members
            .chunks_exact(n)
            .zip(&failed)
            .filter(|(_, failed)| !**failed)
            .flat_map(|(x, _)| x)
            .copied()
            .collect();
        let others = healthy.len() / n;
        if others < 2 || scale < 1e-6 {
            return Err(failure.into());
        }
        let mean = mean(&healthy, n);
        let size = scale / ((others - 1) as f64).sqrt();
        for (i, member) in members.chunks_exact_mut(n).enumerate().filter(|(i, _)| failed[*i]) {
            drawn[i] = true;
            member.copy_from_slice(&mean);
            for x in healthy.chunks_exact(n) {
                let w: f64 = StandardNormal.sample(&mut rng);
                let w = size * w;
                member.iter_mut().zip(x.iter().zip(&mean)).for_each(|(m, (x, mean))| *m += w * (x - mean));
            }
        }
        scale *= 0.5;
    }
    Err(Error::NonFinite { what: "a member drawn again and again", step: steps })
}

/// By what the deviations of N members are to be multiplied so that their covariance is the one that the
/// observations and the finite number of members together make most likely (EnKF-N; Bocquet 2011, Bocquet and
/// Sakov 2012, dual form): α = √((N − 1)/ζ), ζ the minimum over 0 < ζ ≤ γ/ε of
///
/// ```text
///     ½ Σ c_i² / (1 + (N − 1) λ_i / ζ) + ½ ε ζ − ½ γ ln ζ,
///     ε = (1 + 1/N)/μ,    γ = (N + 1) μ,    μ = (1 − 1/N)^{κ/2}
/// ```
///
/// λ the eigenvalues of G Gᵀ and c the whitened innovations along its eigenvectors. κ is the mean of
/// 1/(1 + λ) over the members, 1 where the observations say nothing: μ makes α = 1 of that (Bocquet,
/// Raanes and Hannart 2015). Without it α is √(1 − 1/N) there, and an ensemble in a weakly nonlinear
/// system shrinks window by window until it is lost. Nothing to be chosen, nothing carried from window to
/// window. Never above `LARGEST_INFLATION`: where an ensemble has lost the truth the linearization says
/// nothing farther away.
pub(crate) fn finite_size_inflation(members: usize, pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let pairs: Vec<(f64, f64)> = pairs.collect();
    let n = members as f64;
    let said: f64 = pairs.iter().map(|(l, _)| l / (1.0 + l)).sum();
    let mode = (1.0 - 1.0 / n).powf(0.5 * (1.0 - said / n));
    let (epsilon, gamma) = ((1.0 + 1.0 / n) / mode, (n + 1.0) * mode);
    let cost = |log_zeta: f64| {
        let zeta = log_zeta.exp();
        let misfit: f64 = pairs.iter().map(|(l, c)| c * c / (1.0 + (n - 1.0) * l / zeta)).sum();
        0.5 * (misfit + epsilon * zeta - gamma * log_zeta)
    };
    let (top, bottom) = ((gamma / epsilon).ln(), ((n - 1.0) / LARGEST_INFLATION.powi(2)).ln());
    ((n - 1.0) / lowest(&cost, bottom, top).exp()).sqrt()
}

/// The same for an ensemble with localization, whose covariance has more directions than members: α² where
/// the innovations and the number of members together make it most likely, the minimum of
///
/// ```text
///     Σ ln(1 + α² λ_i) + c_i² / (1 + α² λ_i)  +  (N − 1) (ln α² + (1 + 1/N)/α²)
/// ```
///
/// that is −2 ln of the likelihood of the innovations (Dee 1995) and of an inverse χ² of N − 1
/// degrees of freedom about α² = 1 + 1/N, by which the truth is farther from the mean of N draws than
/// they are (as in Raanes, Bocquet and Carrassi 2019). λ and c are those of the localized G.
pub(crate) fn localized_inflation(members: usize, pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let pairs: Vec<(f64, f64)> = pairs.collect();
    let n = members as f64;
    let cost = |log: f64| {
        let a2 = log.exp();
        let misfit: f64 = pairs.iter().map(|(l, c)| (a2 * l).ln_1p() + c * c / (1.0 + a2 * l)).sum();
        misfit + (n - 1.0) * (log + (1.0 + 1.0 / n) / a2)
    };
    let most = 2.0 * LARGEST_INFLATION.ln();
    (0.5 * lowest(&cost, -most, most)).exp()
}

/// Where a function of one number is lowest between two: on a grid, then by golden sections between its
/// neighbours, for it may have two minima.
fn lowest(cost: &dyn Fn(f64) -> f64, bottom: f64, top: f64) -> f64 {
    let points = 200;
    let at = |i: usize| bottom + (top - bottom) * i as f64 / points as f64;
    let best = (0..=points).min_by(|a, b| cost(at(*a)).total_cmp(&cost(at(*b)))).unwrap_or(points);
    let (mut a, mut b) = (at(best.saturating_sub(1)), at((best + 1).min(points)));
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..60 {
        let (left, right) = (b - golden * (b - a), a + golden * (b - a));
        if cost(left) < cost(right) {
            b = right;
        } else {
            a = left;
        }
    }
    0.5 * (a + b)
}

/// A square root of P_a at v, by columns, no more of them than the control is long.
pub(crate) fn posterior_root(
    cost: &mut StrongConstraint,
    transform: &ControlTransform,
    v: &[f64],
) -> Result<Vec<f64>, Error> {
    cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
    let columns = Posterior::new(cost)?.control_root(transform);
    let n = transform.control_dim();
    if v.len() <= n { Ok(columns) } else { square_root(n, &columns) }
}

/// A root of W Wᵀ with no more columns than rows: a hybrid B has more, and they would add up from window to
/// window.
fn square_root(n: usize, columns: &[f64]) -> Result<Vec<f64>, Error> {
    let mut covariance = vec![0.0; n * n];
    let w = View::new(columns, n, columns.len() / n);
    product(w, w.transpose(), &mut covariance);
    let (values, mut vectors) = eigen(n, &covariance)?;
    for (z, lambda) in vectors.chunks_exact_mut(n).zip(values) {
        z.iter_mut().for_each(|z| *z *= lambda.max(0.0).sqrt());
    }
    Ok(vectors)
}

/// A root of W Wᵀ, by columns of length n, with as few columns as keep the variance of every component
/// but for a share, and the largest share that was dropped. A share of 0 is W as it is.
pub(crate) fn truncate(n: usize, columns: Vec<f64>, share: f64) -> Result<(Vec<f64>, f64), Error> {
    if share == 0.0 || columns.is_empty() {
        return Ok((columns, 0.0));
    }
    let mut size = vec![0.0; n];
    for w in columns.chunks_exact(n) {
        size.iter_mut().zip(w).for_each(|(s, w)| *s += w * w);
    }
    // what never varies stays as it is
    size.iter_mut().for_each(|s| *s = if *s > 0.0 { s.sqrt() } else { 1.0 });
    let scaled: Vec<f64> = columns.iter().enumerate().map(|(i, w)| w / size[i % n]).collect();
    let Svd { values, mut left, .. } = Svd::thin(n, columns.len() / n, &scaled)?;
    for (z, s) in left.chunks_exact_mut(n).zip(&values) {
        z.iter_mut().for_each(|z| *z *= s);
    }
    let (mut lost, mut kept) = (vec![0.0; n], values.len());
    while kept > 1 {
        let last = &left[(kept - 1) * n..kept * n];
        let more: Vec<f64> = lost.iter().zip(last).map(|(l, z)| l + z * z).collect();
        if !more.iter().all(|l| *l <= share) {
            break;
        }
        (lost, kept) = (more, kept - 1);
    }
    left.truncate(kept * n);
    left.iter_mut().enumerate().for_each(|(i, z)| *z *= size[i % n]);
    Ok((left, lost.into_iter().fold(0.0, f64::max)))
}

/// The mean of vectors of length n, one after the other.
pub(crate) fn mean(vectors: &[f64], n: usize) -> Vec<f64> {
    let count = (vectors.len() / n) as f64;
    let mut mean = vec![0.0; n];
    for x in vectors.chunks_exact(n) {
        mean.iter_mut().zip(x).for_each(|(m, x)| *m += x / count);
    }
    mean
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and sample covariance stay to rounding, the members do not.
    #[test]
    fn a_rotation_keeps_mean_and_covariance() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        for (count, n) in [(2, 3), (10, 3), (7, 20)] {
            let members: Vec<f64> = (0..count * n).map(|_| normal()).collect();
            let mut turned = members.clone();
            rotate(&mut turned, n, &mut normal);
            let moments = |x: &[f64]| {
                let m = mean(x, n);
                let mut c = vec![0.0; n * n];
                for x in x.chunks_exact(n) {
                    for i in 0..n * n {
                        c[i] += (x[i / n] - m[i / n]) * (x[i % n] - m[i % n]);
                    }
                }
                [m, c].concat()
            };
            let [before, after] = [moments(&members), moments(&turned)];
            let gap = before.iter().zip(&after).map(|(a, b)| (a - b).abs());
            assert!(gap.fold(0.0, f64::max) <= 1e-12, "{count} {n}");
            let moved = members.iter().zip(&turned).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(moved > 0.1 || count == 2, "{count} {n}");
        }
    }

    /// Innovations of the size expected leave next to the prior's N − 1; larger ones inflate, and more so.
    #[test]
    fn larger_innovations_inflate_more() {
        let factor = |size: f64| finite_size_inflation(20, (0..10).map(|_| (4.0, size * 5.0_f64.sqrt())));
        let (as_expected, twice, thrice) = (factor(1.0), factor(2.0), factor(3.0));
        assert!((0.9..1.2).contains(&as_expected), "{as_expected}");
        assert!(as_expected < twice && twice < thrice, "{as_expected} {twice} {thrice}");
        // Nothing seen, nothing changed; next to nothing seen as expected, as little.
        let nothing = finite_size_inflation(20, std::iter::empty());
        assert!((nothing - 1.0).abs() <= 1e-6, "{nothing}");
        let little = finite_size_inflation(20, (0..19).map(|_| (0.01, 1.01_f64.sqrt())));
        assert!((1.0..1.01).contains(&little), "{little}");
    }

    /// With localization the innovations of many directions are weighed against the members: as expected they
    /// leave the mode √(1 + 1/N) of the prior nearly as it is; many that are twice as large are believed.
    #[test]
    fn innovations_of_a_localized_ensemble_are_weighed_against_its_members() {
        let factor = |count: usize, size: f64| {
            localized_inflation(20, (0..count).map(|_| (4.0, size * 5.0_f64.sqrt())))
        };
        let nothing = localized_inflation(20, std::iter::empty());
        assert!((nothing - 1.05_f64.sqrt()).abs() <= 1e-6, "{nothing}");
        assert!((0.99..nothing).contains(&factor(400, 1.0)), "{}", factor(400, 1.0));
        // 1 + 4 α² = 20 makes them as expected: α = 2.18.
        assert!((factor(4000, 2.0) - 2.18).abs() <= 0.02, "{}", factor(4000, 2.0));
        assert!(factor(40, 2.0) > 1.5 && factor(40, 2.0) < factor(400, 2.0));
    }
}
