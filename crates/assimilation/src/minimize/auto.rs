//! The trust region, and where it is likely to end in a wrong minimum other starts too.

use super::continuation::{Stage, WAY, stages};
use super::method::method;
use super::minimum::{Iteration, Minimum, Start};
use super::stopping::{Status, setters};
use super::trust_region::{self, TrustRegionOptions};
use crate::{Error, LeastSquares};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::ops::ControlFlow;

/// Settings of [`auto`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AutoOptions {
    /// Those of every run.
    pub trust_region: TrustRegionOptions,
    /// Where J_o at the first point exceeds this many times m, one run is not trusted.
    pub threshold: f64,
    /// What σ is multiplied by in turn in the runs that follow; each ends with 1.
    pub continuation: Vec<Vec<f64>>,
    /// Runs from draws of the prior at most, after them: every other one down the first ladder.
    pub prior_samples: usize,
    /// Where the first run took more outer iterations than this, all runs are made, whether or not two agree.
    pub restart_threshold: usize,
    /// Seed of the draws.
    pub seed: u64,
}

impl Default for AutoOptions {
    fn default() -> Self {
        Self {
            trust_region: TrustRegionOptions { jump_retries: 60, ..TrustRegionOptions::default() },
            threshold: 10.0,
            continuation: vec![vec![10.0, 3.0, 1.0], vec![16.0, 8.0, 4.0, 2.0, 1.0]],
            prior_samples: 6,
            restart_threshold: 40,
            seed: 0,
        }
    }
}

setters!(AutoOptions, trust_region.stopping, {
    with_trust_region: trust_region: TrustRegionOptions,
    with_threshold: threshold: f64,
    with_continuation: continuation: Vec<Vec<f64>>,
    with_prior_samples: prior_samples: usize,
    with_restart_threshold: restart_threshold: usize,
    with_seed: seed: u64,
});

/// [`trust_region`](crate::trust_region) from the point given, and where that is not to be trusted further
/// runs until two have come to the same lowest end.
///
/// One run is trusted where it converged and J_o ≤ 10 m at the first point (m observations). Else the same
/// point is taken down two ladders of inflated errors ([`continuation`](crate::continuation) through σ ×
/// 10, 3, 1 and σ × 16, 8, 4, 2, 1), then draws of the prior, v ~ N(0, I) from a fixed seed, in turn down
/// the first ladder and straight, at most six. It stops as soon as two runs have converged to the lowest J
/// seen (to 10⁻⁶ of it), unless the first took more than 40 outer iterations: then all are made. All look
/// beside steps that a jump of J refuses ([`TrustRegionOptions::jump_retries`]). The lowest end is returned;
/// an end where the minimizer stalled (the edge of a jump of J) only where it is lower than every converged
/// one by 10⁻³ of J. The tolerance of every run refers to the gradient at the first point. Rows of all
/// runs are reported, each counting on from the one before.
///
/// When to use: where the observations are much more precise than the background and the model is nonlinear,
/// so that J may have several minima. When not: where one is known to exist, or where time matters more than
/// the last per cent of J.
///
/// Evidence, case 4 of the hanging rod, 100 seeds of either prior (docs/results/case4.md; "lowest known" is
/// the best of the trust region from the background, the ladder, and five draws). Prior "clamp": all 100
/// converge to the lowest known. Prior "plain": 94 converge and 97 are at the lowest known (93 both). The six
/// others stall or run out of iterations where J jumps (a step from a wild state has several solutions, and
/// which one Newton's method comes to changes without pattern nearby); of four of them no run of any kind was
/// stationary near the lowest J. Runs that agree are no proof: one seed (32) converges 0.2 % too high. On
/// Lorenz-63 over a long window ladders gain nothing: there the window must grow.
///
/// Cost: that of the trust region where J_o ≤ 10 m, else two to nine times as much, and several times that
/// where J jumps. Memory: that of the trust region.
///
/// ```
/// # use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// # use varda_covariance::Diagonal;
/// # use varda_implicit::{Rk4, lorenz::Lorenz63};
/// # let (mut model, b) = (Rk4::new(Lorenz63::default(), 0, 0.01), Diagonal::uniform(3, 1.0)?);
/// # let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// # let all = Box::new(Selection::new(vec![0, 1, 2], 3)?);
/// # let mut observations = ObservationSet::new(20, vec![all], seen)?;
/// # let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// # let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut observations)?;
/// // x₀ and x₂ of Lorenz-63 seen at step 20: `cost` is its strong constraint.
/// let mut v = vec![0.0; 3];
/// let minimum = auto(&mut cost, &mut v, &AutoOptions::default(), &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize) and [`continuation`](crate::continuation).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn auto(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &AutoOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    run(cost, v, options, &Start::default(), on_iteration)
}

method!(AutoOptions, trust_region.stopping, Products, run);

fn run(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &AutoOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    if !(options.threshold >= 0.0) {
        return Err(Error::Setting { what: "threshold", value: options.threshold });
    }
    let last = &options.trust_region;
    let early = last.clone().with_stopping(last.stopping.loosened(WAY));
    let mut minimize = |cost: &mut dyn LeastSquares,
                        v: &mut [f64],
                        stage: Stage,
                        start: &Start,
                        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>| {
        let options = if stage == Stage::Early { &early } else { last };
        trust_region::run(cost, v, options, start, on_iteration)
    };
    let first = v.to_vec();
    cost.evaluate(v, None)?;
    let hard = cost.terms().observation > options.threshold * cost.observation_dim() as f64;
    let mut best = minimize(cost, v, Stage::Last, start, on_iteration)?;
    let mut ends = vec![(best.value, best.status)];
    let mut from = Start {
        gradient_norm: Some(best.gradient_norm_first),
        index: best.outer_iterations,
        inner: best.inner_iterations,
        ..*start
    };
    let rough = best.outer_iterations - start.index > options.restart_threshold;
    let mut interrupted = best.status == Status::Interrupted;
    if !hard && best.status == Status::Converged {
        return Ok(best);
    }

    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut other = first.clone();
    let straight = vec![1.0];
    for attempt in 0..options.continuation.len() + options.prior_samples {
        if interrupted || (!rough && found_twice(&best, &ends)) {
            break;
        }
        let scales = match attempt.checked_sub(options.continuation.len()) {
            None => {
                other.copy_from_slice(&first);
                &options.continuation[attempt]
            }
            Some(draw) => {
                other.fill_with(|| StandardNormal.sample(&mut rng));
                if cost.evaluate(&other, None).is_err() {
                    continue;
                }
                options.continuation.first().filter(|_| draw % 2 == 0).unwrap_or(&straight)
            }
        };
        let end = stages(&mut minimize, cost, &mut other, scales, &from, on_iteration)?;
        (from.index, from.inner) = (end.outer_iterations, end.inner_iterations);
        interrupted = end.status == Status::Interrupted;
        ends.push((end.value, end.status));
        if better(&end, &best) {
            v.copy_from_slice(&other);
            best = end;
        }
    }
    if interrupted {
        best.status = Status::Interrupted;
    }
    (best.outer_iterations, best.inner_iterations) = (from.index, from.inner);
    cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
    Ok(best)
}

/// Whether an end is to be preferred: lower, or the stationary one of two that are about as low.
fn better(end: &Minimum, best: &Minimum) -> bool {
    let margin = match (end.status == Status::Converged, best.status == Status::Converged) {
        (true, false) => SETTLED,
        (false, true) => -SETTLED,
        _ => 0.0,
    };
    end.value < best.value * (1.0 + margin)
}

/// Whether the best end is stationary and two runs have come to it.
fn found_twice(best: &Minimum, ends: &[(f64, Status)]) -> bool {
    let same = |(value, status): &&(f64, Status)| {
        *status == Status::Converged && *value <= best.value * (1.0 + SAME)
    };
    best.status == Status::Converged && ends.iter().filter(same).count() >= 2
}

/// Two ends are one where they differ by no more than this share of J.
const SAME: f64 = 1e-6;
/// A stationary point is preferred to an end where the minimizer stalled (the edge of a jump of J) unless J
/// is higher by this share.
const SETTLED: f64 = 1e-3;
