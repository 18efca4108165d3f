//! Input and result of a solve, of the whole window or of one sub-window.

use std::ops::ControlFlow;

use varda_assimilation::{
    ControlTransform, Error, Forcing, Iteration, Minimum, ObservationSet, Posterior, Rejection, Status,
};
use varda_covariance::{Covariance, Ensemble};
use varda_implicit::{Model, Storage};

use crate::outcome::WorkCounts;
use crate::scene::Algorithm;
use crate::setup::covariance::Factored;

/// What every method is given.
pub(crate) struct Task<'a> {
    pub(crate) algorithm: &'a Algorithm,
    /// The model of methods that run one.
    pub(crate) model: &'a mut dyn Model,
    /// Makes the models of methods that run several.
    pub(crate) make_model: &'a dyn Fn() -> Box<dyn Model + Send>,
    pub(crate) background: &'a [f64],
    pub(crate) covariance: &'a Factored,
    pub(crate) model_error: Option<&'a Factored>,
    pub(crate) ensemble: Option<&'a Ensemble>,
    /// The component of the control at whose place a row of the observation operator measures.
    pub(crate) anchors: &'a [usize],
    /// Whether σ of the analysis is wanted.
    pub(crate) posterior: bool,
    /// Most bytes for the states and linearizations of a window (strong constraint).
    pub(crate) memory: usize,
    /// Another model of the same control, where that in force is not good enough about this analysis; the minimization then goes on with it
    /// (strong constraint).
    pub(crate) refresh: &'a mut Refresh<'a>,
}

/// See [`Task::refresh`].
pub(crate) type Refresh<'a> = dyn FnMut(&[f64]) -> Option<Box<dyn Model + Send + 'a>> + 'a;

/// What every method gives.
pub(crate) struct Solution {
    /// Of the whole window; iterations are those of all sub-windows.
    pub(crate) minimum: Minimum,
    /// z_a.
    pub(crate) control: Vec<f64>,
    /// σ of the control before: that of B, or of the ensemble.
    pub(crate) sigma_background: Vec<f64>,
    /// Of the analysis; none where the run did not get there.
    pub(crate) spread: Option<PosteriorSpread>,
    /// Why there is none, where rounding has left nothing of it.
    pub(crate) no_spread: Option<Error>,
    /// States x_0 … of the analysis where the model errs; elsewhere they are those of its run from z_a.
    pub(crate) states: Vec<f64>,
    /// Work of the model, the posterior's not included.
    pub(crate) counts: WorkCounts,
    /// Values that the background check refused.
    pub(crate) rejected: Vec<Rejection>,
    /// How the sub-windows before the last ended: steps and status.
    pub(crate) stages: Vec<(usize, Status)>,
    /// What was kept of the whole window.
    pub(crate) storage: Storage,
}

/// The posterior of the control.
pub(crate) struct PosteriorSpread {
    pub(crate) sigma: Vec<f64>,
    /// Degrees of freedom for signal (of the initial state, where the model errs).
    pub(crate) degrees_of_freedom: f64,
}

/// One line of a convergence table.
pub(crate) struct Iterate<'a> {
    pub(crate) iteration: &'a Iteration<'a>,
    /// z at that point.
    pub(crate) control: &'a [f64],
    /// Steps of the sub-window.
    pub(crate) window: usize,
    /// Outer iterations and work of the sub-windows before.
    pub(crate) before: (usize, WorkCounts),
}

/// Told of every iteration; says whether to go on.
pub(crate) type OnIterate<'a> = dyn FnMut(&Iterate) -> ControlFlow<()> + 'a;

/// A stage: one sub-window, from the point the last one ended at.
pub(super) struct Stage<'s, 'r> {
    pub(super) observations: &'s mut ObservationSet,
    /// The control variable.
    pub(super) v: &'s mut Vec<f64>,
    /// What is known of the trajectory (weak-constraint forms).
    pub(super) states: &'s mut Vec<f64>,
    /// Whether it is the last, of the whole window.
    pub(super) whole: bool,
    /// Whether σ is wanted of it.
    pub(super) posterior: bool,
    pub(super) before: (usize, WorkCounts),
    pub(super) on_iterate: &'s mut OnIterate<'r>,
}

/// A stage's end.
pub(super) struct StageEnd {
    pub(super) minimum: Minimum,
    pub(super) control: Vec<f64>,
    pub(super) sigma_background: Vec<f64>,
    pub(super) spread: Option<PosteriorSpread>,
    pub(super) no_spread: Option<Error>,
    pub(super) counts: WorkCounts,
    pub(super) storage: Storage,
}

impl Task<'_> {
    /// Where and how often the model errs: in the components of the control, which lead the state.
    pub(super) fn forcing(&self) -> Forcing {
        let error = self.algorithm.model_error.as_ref();
        Forcing {
            components: (0..self.background.len()).collect(),
            steps: error.map_or(1, |e| e.every),
            held: error.is_some_and(|e| e.held),
        }
    }
}

impl PosteriorSpread {
    /// Of a posterior; where its Hessian is indefinite by rounding, as over a window that amplifies beyond it, the reason alone.
    pub(super) fn of(
        posterior: Result<Posterior, Error>,
        transform: &ControlTransform,
    ) -> Result<(Option<PosteriorSpread>, Option<Error>), Error> {
        match posterior {
            Ok(posterior) => {
                let sigma = roots(posterior.variance(transform));
                let degrees_of_freedom = posterior.degrees_of_freedom();
                Ok((Some(PosteriorSpread { sigma, degrees_of_freedom }), None))
            }
            Err(reason @ Error::NotPositiveDefinite { .. }) => Ok((None, Some(reason))),
            Err(error) => Err(error),
        }
    }
}

/// The square roots of the diagonal of a covariance.
pub(super) fn deviations(covariance: &dyn Covariance) -> Vec<f64> {
    let mut variance = vec![0.0; covariance.dim()];
    covariance.variance(&mut variance);
    roots(variance)
}

pub(super) fn roots(variance: Vec<f64>) -> Vec<f64> {
    variance.into_iter().map(|v| v.max(0.0).sqrt()).collect()
}

/// A run that came to its own end has a posterior.
pub(super) fn is_whole(status: Status) -> bool {
    !matches!(status, Status::Interrupted | Status::Failed)
}
