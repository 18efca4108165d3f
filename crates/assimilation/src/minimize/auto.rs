//! The trust region, and where it is likely to end in a wrong minimum other starts too.

use super::continuation::{Stage, WAY, stages};
use super::method::{Method, method};
use super::minimum::{Attempt, AttemptFrom, Iteration, Minimum, Start};
use super::stopping::{Status, Stopping, at_least_one, setters};
use super::trust_region::TrustRegionOptions;
use crate::cost::highest_j_of_a_fit;
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
    /// Outer iterations of one run at most (a start down a ladder is several) that has not come within the
    /// band of a fit; all runs together take no more than those of `trust_region.stopping`.
    pub run_iterations: usize,
    /// Further starts end after this many in turn that brought J less than a tenth of the way to the band of
    /// a fit.
    pub patience: usize,
    /// Seed of the draws.
    pub seed: u64,
}

impl Default for AutoOptions {
    fn default() -> Self {
        Self {
            trust_region: TrustRegionOptions {
                stopping: Stopping::within(400),
                jump_retries: 60,
                ..TrustRegionOptions::default()
            },
            threshold: 10.0,
            continuation: vec![vec![10.0, 3.0, 1.0], vec![16.0, 8.0, 4.0, 2.0, 1.0]],
            prior_samples: 6,
            run_iterations: 100,
            patience: 3,
            seed: 0,
        }
    }
}

setters!(AutoOptions, trust_region.stopping, {
    with_trust_region: trust_region: TrustRegionOptions,
    with_threshold: threshold: f64,
    with_continuation: continuation: Vec<Vec<f64>>,
    with_prior_samples: prior_samples: usize,
    with_run_iterations: run_iterations: usize,
    with_patience: patience: usize,
    with_seed: seed: u64,
});

/// [`trust_region`](crate::trust_region) from the point given, and where that is not to be trusted further
/// starts, as long as they pay.
///
/// One run is trusted where it converged and J_o ≤ 10 m at the first point (m observations) or J is
/// quadratic ([`Minimum::quadratic`]: a linear problem has one minimum), and wherever it ended,
/// converged or not, within the band of a fit, 2J/m ≤ 1 + 3 √(2/m)
/// ([`highest_j_of_a_fit`](crate::highest_j_of_a_fit)). Else the same point is taken down two ladders
/// of inflated errors ([`continuation`](crate::continuation) through σ × 10, 3, 1 and σ × 16, 8, 4,
/// 2, 1), then draws of the prior, v ~ N(0, I) from a fixed seed, in turn down the first ladder and
/// straight, at most six. No further start is made once the lowest end is within the band (and not
/// stalled with ‖∇J‖ above 10⁻³ of the first), or two runs have come to the same lowest J (to
/// 10⁻⁵ of it, converged or stalled), or three in turn have brought a lowest end that settled so less
/// than a tenth of the way to the band, or the iterations are used up. A run is given up after its share
/// of iterations where J is above the band; where no start did better, iterations that are left go on
/// from the lowest end. [`Minimum::attempts`] lists what each start came to and what it gained. All look
/// beside steps that a jump of J refuses ([`TrustRegionOptions::jump_retries`]). The lowest end is
/// returned; an end where the minimizer stalled (the edge of a jump of J) only where it is lower than
/// every converged one by 10⁻³ of J.
/// The tolerance of every run refers to the gradient at the first point. Rows of all runs are reported,
/// each counting on from the one before.
///
/// When to use: where the observations are much more precise than the background and the model is nonlinear,
/// so that J may have several minima. When not: where one is known to exist, or where time matters more than
/// the last per cent of J.
///
/// Evidence, case 4 of the hanging rod, 100 seeds of either prior (docs/results/case4.md; "lowest known" is
/// the best of the trust region from the background, the ladder, and five draws). Prior "clamp": all 100
/// converge to the lowest known. Prior "plain": all end within the band of a fit, 95 converge and 88 are at
/// the lowest known (86 both); the others are at most 1.3 % above it. The five stall where J jumps (a step
/// from a wild state has several solutions, and which one Newton's method comes to changes without pattern
/// nearby). Runs that agree are no proof: one seed (32) converges 0.2 % too high. On Lorenz-63 over a long
/// window ladders gain nothing: there the window must grow.
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
    options.run(cost, v, &Start::default(), on_iteration)
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
    at_least_one("run_iterations", options.run_iterations)?;
    let last = &options.trust_region;
    let longest = last.stopping.max_iterations;
    let mut minimize = |cost: &mut dyn LeastSquares,
                        v: &mut [f64],
                        stage: Stage,
                        start: &Start,
                        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>| {
        let most = longest.min(start.index + options.run_iterations);
        let stopping = Stopping { max_iterations: most, ..last.stopping };
        let stopping = if stage == Stage::Early { stopping.loosened(WAY) } else { stopping };
        let end = last.clone().with_stopping(stopping).run(cost, v, start, on_iteration)?;
        let given_up = end.status == Status::MaxIterations && end.outer_iterations < longest;
        if !(given_up && stage == Stage::Last && end.value <= highest_j_of_a_fit(cost.observation_dim())) {
            return Ok(end);
        }
        // as low as a fit: it is not far
        last.run(cost, v, &start.after(&end), on_iteration)
    };
    let first = v.to_vec();
    cost.evaluate(v, None)?;
    let m = cost.observation_dim();
    let hard = cost.terms().observation > options.threshold * m as f64;
    let attempts = 1 + options.continuation.len() + options.prior_samples;
    let mut from = Start { attempt: [1, attempts], ..*start };
    let mut best = minimize(cost, v, Stage::Last, &from, on_iteration)?;
    let mut ends = vec![Attempt {
        from: AttemptFrom::Given,
        scales: vec![1.0],
        value: best.value,
        status: best.status,
        iterations: best.outer_iterations - from.index,
        gain: 0.0,
    }];
    from = from.after(&best);
    let mut interrupted = best.status == Status::Interrupted;
    let trusted = (!hard || best.quadratic) && best.status == Status::Converged;

    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut other = first.clone();
    let straight = vec![1.0];
    for attempt in 2..=attempts {
        let used_up = from.index >= longest;
        if trusted
            || interrupted
            || used_up
            || fits(&best, m)
            || !pays(&best, &ends, highest_j_of_a_fit(m), options.patience)
        {
            break;
        }
        let (place, scales) = match (attempt - 2).checked_sub(options.continuation.len()) {
            None => {
                other.copy_from_slice(&first);
                (AttemptFrom::Given, &options.continuation[attempt - 2])
            }
            Some(draw) => {
                other.fill_with(|| StandardNormal.sample(&mut rng));
                if cost.evaluate(&other, None).is_err() {
                    continue;
                }
                let ladder = options.continuation.first().filter(|_| draw % 2 == 0);
                (AttemptFrom::Draw(draw + 1), ladder.unwrap_or(&straight))
            }
        };
        from.attempt[0] = attempt;
        let end = stages(&mut minimize, cost, &mut other, scales, &from, on_iteration)?;
        interrupted = end.status == Status::Interrupted;
        let lowest = ends.iter().map(|e| e.value).fold(f64::INFINITY, f64::min);
        ends.push(Attempt {
            from: place,
            scales: scales.clone(),
            value: end.value,
            status: end.status,
            iterations: end.outer_iterations - from.index,
            gain: (lowest - end.value).max(0.0),
        });
        from = from.after(&end);
        if better(&end, &best) {
            v.copy_from_slice(&other);
            best = end;
        }
    }
    // the lowest end had its share of iterations, and some are left
    if !interrupted && best.status == Status::MaxIterations && from.index < longest {
        other.copy_from_slice(v);
        let end = last.run(cost, &mut other, &from, on_iteration)?;
        interrupted = end.status == Status::Interrupted;
        from = from.after(&end);
        if end.value <= best.value {
            v.copy_from_slice(&other);
            best = end;
        }
    }
    if interrupted {
        best.status = Status::Interrupted;
    }
    (best.outer_iterations, best.inner_iterations) = (from.index, from.inner);
    if ends.len() > 1 {
        cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
    }
    best.attempts = ends;
    Ok(best)
}

/// Whether an end describes what was seen, and is no steep edge of a jump of J.
fn fits(end: &Minimum, observations: usize) -> bool {
    let steep = end.status == Status::Stalled && !(end.gradient_norm <= STEEP * end.gradient_norm_first);
    end.value <= highest_j_of_a_fit(observations) && !steep
}

/// Whether one more start may pay: no two have come to the lowest J, and the last ones have not all been in
/// vain. Where the model cannot describe what was seen, starts still differ by some per cent of a J that is
/// thousands of times too high.
fn pays(best: &Minimum, ends: &[Attempt], fit: f64, patience: usize) -> bool {
    let settled = |status| matches!(status, Status::Converged | Status::Stalled);
    let same = |end: &&Attempt| settled(end.status) && end.value <= best.value * (1.0 + SAME);
    let found_twice = settled(best.status) && ends.iter().filter(same).count() >= 2;
    let in_vain = |end: &&Attempt| end.gain < 0.1 * (best.value - fit);
    let given_up = settled(best.status) && ends[1..].iter().rev().take_while(in_vain).count() >= patience;
    !found_twice && !given_up
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

/// ‖∇J‖ of a stalled end, as a part of the first, above which it is no answer.
const STEEP: f64 = 1e-3;
/// Two ends are one where they differ by no more than this share of J.
const SAME: f64 = 1e-5;
/// A stationary point is preferred to an end where the minimizer stalled (the edge of a jump of J) unless J
/// is higher by this share.
const SETTLED: f64 = 1e-3;
