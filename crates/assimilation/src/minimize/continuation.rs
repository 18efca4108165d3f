//! Observation-error continuation: for costs with several minima.

use super::{Iteration, Minimizer, Minimum, Start, Status};
use crate::cost::norm;
use crate::{Error, LeastSquares};
use std::ops::ControlFlow;

/// Minimizes J with every σ multiplied by each of `scales` in turn (say 10, 3, 1), each stage from where the
/// one before ended.
///
/// Inflated errors flatten J towards its prior part, ½‖v‖², which has one minimum: the path then
/// follows that minimum down instead of falling into the nearest one. The early stages only need to find the
/// way, and stop when their gradient has fallen to 10⁻³ of its first value; a stage that ends otherwise
/// than converged still hands its point on. The tolerance of the last stage, and the first gradient norm
/// reported, refer to the true cost at the first point. Leaves the true cost in force.
///
/// When to use: precise observations and a background far from them. When not: chaotic models, whose minima
/// come from the length of the window ([`window_growth`](crate::window_growth)). Cost: a minimization a
/// stage, the early ones short. Memory: that of the minimizer.
///
/// # Errors
/// Scales that are empty, not positive and finite, or do not end with 1; else as for
/// [`Minimizer::minimize`].
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn continuation(
    minimizer: &Minimizer,
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    scales: &[f64],
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    run(minimizer, cost, v, scales, &Start::default(), on_iteration)
}

pub(super) fn run(
    minimizer: &Minimizer,
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    scales: &[f64],
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    // Its own ladder would be one too many.
    let minimizer = match minimizer {
        Minimizer::Auto(options) => &Minimizer::TrustRegion(options.trust_region.clone()),
        other => other,
    };
    if let Some(&scale) = scales.iter().find(|s| !(**s > 0.0 && s.is_finite())) {
        return Err(Error::Setting { what: "sigma_scales", value: scale });
    }
    let Some((&1.0, early)) = scales.split_last() else {
        return Err(Error::Setting {
            what: "the last of sigma_scales",
            value: scales.last().copied().unwrap_or(f64::NAN),
        });
    };
    let mut g = vec![0.0; cost.dim()];
    cost.set_observation_scale(1.0);
    cost.evaluate(v, Some(&mut g))?;
    let mut start =
        Start { gradient_norm: start.gradient_norm.or_else(|| Some(norm(&g))), scale: 1.0, ..*start };
    for &scale in early {
        cost.set_observation_scale(scale);
        let stage = Start { scale, gradient_norm: None, ..start };
        let ended = loose(minimizer).run(cost, v, &stage, on_iteration);
        cost.set_observation_scale(1.0);
        let ended = ended?;
        start.index = ended.outer_iterations;
        start.inner = ended.inner_iterations;
        if ended.status == Status::Interrupted {
            let value = cost.evaluate(v, Some(&mut g))?;
            return Ok(Minimum {
                value,
                terms: cost.terms(),
                gradient_norm: norm(&g),
                gradient_norm_first: start.gradient_norm.unwrap_or(f64::NAN),
                ..ended
            });
        }
    }
    minimizer.run(cost, v, &start, on_iteration)
}

/// The same minimizer, content with finding the way.
fn loose(minimizer: &Minimizer) -> Minimizer {
    let mut loose = minimizer.clone();
    let tolerance = loose.gradient_tolerance_mut();
    *tolerance = tolerance.max(1e-3);
    loose
}
