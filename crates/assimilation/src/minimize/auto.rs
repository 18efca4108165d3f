//! The trust region, and where it is likely to end in a wrong minimum also continuation.

use super::{Iteration, Minimizer, Minimum, Start, Status, TrustRegionOptions, continuation};
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

/// [`trust_region`](crate::trust_region), and where J_o > 10 m at the first point (m observations) also
/// [`continuation`] through σ × (10, 3, 1) from the same point; of the two ends, the lower.
///
/// When to use: where the observations are much more precise than the background and the model is nonlinear, so that J may
/// have several minima. When not: where one is known to exist, or where time matters more than the last per cent of J. By
/// construction never worse than the trust region alone.
///
/// Evidence, case 4 of the hanging rod with the plain prior (m = 120, J at the background 2 500 to 49 000), seeds 0 to 9: the trust region alone ends 0.3 % and
/// 0.7 % too high on two and stalls at J = 10 297 for 66 on a third; the ladder alone stalls once; the lower of the two
/// is converged on all ten. On seeds 10 to 39 it is nowhere above what a ladder of 30, 10, 3, 1 reaches; 28 converge, two stall at a
/// gradient of 10⁻⁵ of the first. On Lorenz-63 over a long window the ladder gains nothing: there the window must grow.
///
/// The ladder's end is taken where it is lower by more than 10⁻⁶ of J, or as low and converged where the first run did not. Rows of both
/// runs are reported, the second counting on from the first.
///
/// Cost: that of the trust region where J_o ≤ 10 m, else two to four times as much.
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
    let mut plain = minimizer.run(cost, v, start, on_iteration)?;
    if !hard || plain.status == Status::Interrupted {
        return Ok(plain);
    }

    let mut other = first;
    let next = Start { index: plain.outer_iterations, inner: plain.inner_iterations, ..*start };
    let ladder = continuation::run(&minimizer, cost, &mut other, &options.scales, &next, on_iteration)?;
    let margin = 1e-6 * plain.value;
    let converged = |m: &Minimum| m.status == Status::Converged;
    if ladder.value < plain.value - margin
        || (ladder.value < plain.value + margin && converged(&ladder) && !converged(&plain))
    {
        v.copy_from_slice(&other);
        return Ok(ladder);
    }
    plain.outer_iterations = ladder.outer_iterations;
    plain.inner_iterations = ladder.inner_iterations;
    if ladder.status == Status::Interrupted {
        plain.status = Status::Interrupted;
    }
    let mut gradient = vec![0.0; v.len()];
    cost.evaluate(v, Some(&mut gradient))?;
    Ok(plain)
}
