//! The trust region, and where it is likely to end in a wrong minimum also continuation.

use super::{
    Iteration, Minimizer, Minimum, NewtonCgOptions, Start, Status, TrustRegionOptions, continuation,
};
use crate::{Error, GaussNewton};
use std::ops::ControlFlow;

/// Settings of [`auto`].
#[derive(Debug, Clone, PartialEq)]
pub struct AutoOptions {
    /// Those of every run.
    pub trust_region: TrustRegionOptions,
    /// Where J_o at the first point exceeds this many times m, the ladder is climbed down too.
    pub threshold: f64,
    /// What σ is multiplied by in turn; ends with 1.
    pub scales: Vec<f64>,
}

impl Default for AutoOptions {
    fn default() -> Self {
        Self { trust_region: TrustRegionOptions::default(), threshold: 10.0, scales: vec![10.0, 3.0, 1.0] }
    }
}

/// [`trust_region`](crate::trust_region), and where J_o > 10 m at the first point (m observations), or it did not converge, also
/// [`continuation`] through σ × (10, 3, 1) from the same point; of the two ends, the lower.
///
/// When to use: where the observations are much more precise than the background and the model is nonlinear, so that J may
/// have several minima. When not: where one is known to exist, or where time matters more than the last per cent of J. By
/// construction never worse than the trust region alone.
///
/// Evidence, case 4 of the hanging rod with the plain prior (m = 120, J at the background 2 500 to 49 000), seeds 0 to 9: the trust region alone ends 0.3 % and
/// 0.7 % too high on two and stalls at J = 10 297 for 66 on a third; the ladder alone stalls once; the lower of the two
/// is converged on all ten. With the last resort 39 of seeds 0 to 39 converge, and 38 of 40 in case 1; the others stall at the edge of a
/// jump of J (seed 14 of case 4 at a gradient of 6·10⁻⁶ of the first, seeds 11 and 29 of case 1 at 0.3 and 2·10⁻³). On Lorenz-63 over a long window the ladder gains nothing: there the window must grow.
///
/// The ladder's end is taken where it is lower by more than 10⁻⁶ of J, or where it converged, the first run did not, and J is at most
/// 10⁻³ higher. Where neither converged, Gauss–Newton–CG is run from the same point as a last resort: its line search steps over an edge
/// of J that holds a trust region. Rows of all runs are reported, each counting on from the one before.
///
/// Cost: that of the trust region where J_o ≤ 10 m, else two to four times as much. Memory: that of the trust region.
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize) and [`continuation`].
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn auto(
    cost: &mut dyn GaussNewton,
    v: &mut [f64],
    options: &AutoOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    run(cost, v, options, &Start::default(), on_iteration)
}

pub(super) fn run(
    cost: &mut dyn GaussNewton,
    v: &mut [f64],
    options: &AutoOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    if !(options.threshold >= 0.0) {
        return Err(Error::Setting { what: "threshold", value: options.threshold });
    }
    let minimizer = Minimizer::TrustRegion(options.trust_region.clone());
    let first = v.to_vec();
    cost.evaluate(v, None)?;
    let hard = cost.terms().observation > options.threshold * cost.observation_dim() as f64;
    let mut best = minimizer.run(cost, v, start, on_iteration)?;
    if !hard && best.status == Status::Converged {
        return Ok(best);
    }

    let line_search = Minimizer::NewtonCg(NewtonCgOptions {
        gradient_tolerance: options.trust_region.gradient_tolerance,
        max_iterations: options.trust_region.max_iterations,
        ..NewtonCgOptions::default()
    });
    let (mut outer, mut inner) = (best.outer_iterations, best.inner_iterations);
    let stages = [(&minimizer, options.scales.as_slice(), false), (&line_search, &[1.0], true)];
    for (next, scales, last_resort) in stages {
        if best.status == Status::Interrupted || (last_resort && best.status == Status::Converged) {
            break;
        }
        let mut other = first.clone();
        let from = Start { index: outer, inner, ..*start };
        let ladder = continuation::run(next, cost, &mut other, scales, &from, on_iteration)?;
        (outer, inner) = (ladder.outer_iterations, ladder.inner_iterations);
        let interrupted = ladder.status == Status::Interrupted;
        let margin = if ladder.status == Status::Converged && best.status != Status::Converged {
            SETTLED
        } else {
            -LOWER
        };
        if ladder.value < best.value * (1.0 + margin) {
            v.copy_from_slice(&other);
            best = ladder;
        }
        if interrupted {
            best.status = Status::Interrupted;
        }
    }
    (best.outer_iterations, best.inner_iterations) = (outer, inner);
    let mut gradient = vec![0.0; v.len()];
    cost.evaluate(v, Some(&mut gradient))?;
    Ok(best)
}

/// An end is taken for lower by this share of J.
const LOWER: f64 = 1e-6;
/// A stationary point is preferred to one where the minimizer stalled (the edge of a jump of J) unless J is higher by this share.
const SETTLED: f64 = 1e-3;
