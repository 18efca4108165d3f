//! Observation-error continuation: for costs with several minima.

use super::minimum::{Iteration, Minimum, Start};
use super::stopping::Status;
use crate::cost::norm;
use crate::{Error, LeastSquares};
use std::ops::ControlFlow;

/// A minimization from a start: of an early stage, which only finds the way, or of the last one.
pub(super) type Minimize<'a> = dyn FnMut(
        &mut dyn LeastSquares,
        &mut [f64],
        Stage,
        &Start,
        &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Result<Minimum, Error>
    + 'a;

/// Which stage of a continuation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stage {
    /// With inflated errors: it ends when its gradient has fallen to [`WAY`].
    Early,
    /// With the true errors.
    Last,
}

/// Relative gradient at which an early stage has found the way.
pub(super) const WAY: f64 = 1e-3;

/// The stages of [`continuation`](crate::continuation), each by `minimize`.
pub(super) fn stages(
    minimize: &mut Minimize,
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    scales: &[f64],
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
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
        let ended = minimize(cost, v, Stage::Early, &stage, on_iteration);
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
    minimize(cost, v, Stage::Last, &start, on_iteration)
}
