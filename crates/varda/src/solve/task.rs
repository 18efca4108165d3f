//! Input and result of a solve, of the whole window or of one sub-window.

use std::ops::ControlFlow;

use varda_assimilation::{
    Attempt, ControlTransform, Error, ErrorColumns, Forcing, Iteration, LanczosOptions, LeastSquares,
    LowRankPosterior, Minimum, ObservationSet, Posterior, Rejection, Status,
};
use varda_covariance::{Covariance, Ensemble};
use varda_implicit::{Model, Storage};

use crate::outcome::{ExactHessian, ModelErrors, WorkCounts};
use crate::scene::{Algorithm, ModelError};
use crate::setup::covariance::Factored;
use crate::setup::memory::MOST_PRODUCTS;
use crate::setup::random::{Stream, stream};

/// Input of a solve.
pub(crate) struct Task<'a> {
    /// Of a sub-window: what is left of `max_iterations`.
    pub(crate) algorithm: Algorithm,
    /// The model, for methods that run one.
    pub(crate) model: &'a mut dyn Model,
    /// Makes models, for methods that run several.
    pub(crate) make_model: &'a dyn Fn() -> Box<dyn Model + Send>,
    pub(crate) background: &'a [f64],
    pub(crate) covariance: &'a Factored,
    pub(crate) model_error: Option<&'a Factored>,
    pub(crate) ensemble: Option<&'a Ensemble>,
    /// For each row of the observation operator the component of the control at the same place.
    pub(crate) anchors: &'a [usize],
    /// Whether to compute σ of the analysis.
    pub(crate) posterior: bool,
    /// Components of the control whose 95 % intervals are wanted beside σ (strong constraint, dense
    /// posterior).
    pub(crate) constants: Vec<usize>,
    /// Whether to compute the members of the analysis beside it (ensembles).
    pub(crate) members: bool,
    /// Most bytes for the states and linearizations of a window (strong constraint).
    pub(crate) memory: usize,
    /// Gives another model of the same control if the present one is not accurate enough along this analysis
    /// (adaptive time steps); the minimization then continues with that model (strong constraint).
    pub(crate) refresh: &'a mut Refresh<'a>,
}

/// See [`Task::refresh`].
pub(crate) type Refresh<'a> = dyn FnMut(&[f64]) -> Option<Box<dyn Model + Send + 'a>> + 'a;

/// Result of a solve.
pub(crate) struct Solution {
    /// The minimum over the whole window; its iterations are those of all sub-windows.
    pub(crate) minimum: Minimum,
    /// z_a.
    pub(crate) control: Vec<f64>,
    /// σ of the background: that of B, or of the ensemble.
    pub(crate) sigma_background: Vec<f64>,
    /// The posterior; `None` if it was not computed.
    pub(crate) spread: Option<PosteriorSpread>,
    /// Why there is no posterior, if its Hessian was indefinite by rounding.
    pub(crate) no_spread: Option<Error>,
    /// What second derivatives do to it, where the scene asks for them.
    pub(crate) exact_hessian: Option<ExactHessian>,
    /// The errors of the model, under weak constraint.
    pub(crate) model_errors: Option<ModelErrors>,
    /// States x_0 … of the analysis under weak constraint; empty under strong constraint, where they are
    /// those of the run from z_a.
    pub(crate) states: Vec<f64>,
    /// Work of the model, without that of the posterior.
    pub(crate) counts: WorkCounts,
    /// Values that the background check refused.
    pub(crate) rejected: Vec<Rejection>,
    /// How the sub-windows before the last ended: steps and status.
    pub(crate) stages: Vec<(usize, Status)>,
    /// The starts of `auto`, of all sub-windows.
    pub(crate) attempts: Vec<Attempt>,
    /// How the trajectory of the whole window was stored.
    pub(crate) storage: Storage,
}

/// The posterior of the control.
pub(crate) struct PosteriorSpread {
    pub(crate) sigma: Vec<f64>,
    /// A square root of P_a, by columns of the length of the control; empty where the analysis is not a run
    /// of the model (weak constraint, ensembles).
    pub(crate) root: Vec<f64>,
    /// Under weak constraint the covariance of the initial state and of the errors of the model.
    pub(crate) with_errors: Option<ErrorColumns>,
    /// Degrees of freedom for signal (of the initial state, under weak constraint).
    pub(crate) degrees_of_freedom: f64,
    /// Of an ensemble: the members of the analysis, one control after the other, where they were asked for.
    pub(crate) members: Vec<f64>,
    /// Of one of low rank: what its variances may be off by, as a fraction of the background's.
    pub(crate) error_bound: Option<f64>,
    /// Ends of 95 % intervals of the constants that the task names, less the analysis; empty where they are
    /// the Gaussian's.
    pub(crate) intervals: Vec<[f64; 2]>,
}

/// An iterate, for a row of the convergence table.
pub(crate) struct Iterate<'a> {
    pub(crate) iteration: &'a Iteration<'a>,
    /// z at that point.
    pub(crate) control: &'a [f64],
    /// Steps of the sub-window.
    pub(crate) window: usize,
    /// Outer iterations and work of the sub-windows before.
    pub(crate) before: (usize, WorkCounts),
}

/// Called at every iterate; says whether to continue.
pub(crate) type OnIterate<'a> = dyn FnMut(&Iterate) -> ControlFlow<()> + 'a;

/// Input of a stage: one sub-window, from the point at which the last one ended.
pub(super) struct SubWindow<'s, 'r> {
    pub(super) observations: &'s mut ObservationSet,
    /// The control variable.
    pub(super) v: &'s mut Vec<f64>,
    /// The trajectory so far (weak-constraint forms).
    pub(super) states: &'s mut Vec<f64>,
    /// Whether it is the last stage, the whole window.
    pub(super) whole: bool,
    /// Whether to compute its posterior.
    pub(super) posterior: bool,
    pub(super) before: (usize, WorkCounts),
    pub(super) on_iterate: &'s mut OnIterate<'r>,
}

/// Result of a stage, beside its minimum.
pub(super) struct SubWindowEnd {
    pub(super) control: Vec<f64>,
    pub(super) sigma_background: Vec<f64>,
    pub(super) spread: Option<PosteriorSpread>,
    pub(super) no_spread: Option<Error>,
    /// Where the scene asks for the exact Hessian.
    pub(super) exact_hessian: Option<ExactHessian>,
    pub(super) model_errors: Option<ModelErrors>,
    pub(super) counts: WorkCounts,
    pub(super) storage: Storage,
}

impl Task<'_> {
    /// Where and how often the model errs: in the components of the control, which lead the state.
    pub(super) fn forcing(&self) -> Forcing {
        forcing(self.algorithm.model_error.as_ref(), self.background.len())
    }
}

/// Where and how often the model errs: in the n components of the control, which lead the state.
pub(crate) fn forcing(error: Option<&ModelError>, n: usize) -> Forcing {
    Forcing {
        components: (0..n).collect(),
        steps: error.map_or(1, |e| e.every),
        held: error.is_some_and(|e| e.held),
    }
}

impl PosteriorSpread {
    pub(super) fn around(
        posterior: &Posterior,
        transform: &ControlTransform,
        keep_root: bool,
    ) -> PosteriorSpread {
        PosteriorSpread {
            root: if keep_root { posterior.control_root(transform) } else { Vec::new() },
            sigma: roots(posterior.variance(transform)),
            with_errors: None,
            members: Vec::new(),
            degrees_of_freedom: posterior.degrees_of_freedom(),
            error_bound: None,
            intervals: Vec::new(),
        }
    }
}

impl PosteriorSpread {
    /// The spread of a posterior of low rank around the point of the last gradient, by products with the
    /// Gauss–Newton Hessian; its random vectors are always the same.
    pub(super) fn of_low_rank(
        cost: &mut dyn LeastSquares,
        transform: &ControlTransform,
    ) -> Result<PosteriorSpread, Error> {
        let posterior =
            LowRankPosterior::lanczos(cost, &low_rank_options(), &mut stream(0, Stream::Directions))?;
        Ok(PosteriorSpread::around_low_rank(&posterior, transform))
    }

    pub(super) fn around_low_rank(
        posterior: &LowRankPosterior,
        transform: &ControlTransform,
    ) -> PosteriorSpread {
        PosteriorSpread {
            sigma: roots(posterior.variance(transform)),
            root: Vec::new(),
            with_errors: None,
            members: Vec::new(),
            degrees_of_freedom: posterior.degrees_of_freedom(),
            error_bound: posterior.error_bound(),
            intervals: Vec::new(),
        }
    }

    /// What to say of a posterior of low rank that left something out.
    pub(crate) fn remark(&self) -> Option<String> {
        let bound = self.error_bound.filter(|bound| !(*bound <= 1e-2))?;
        Some(format!(
            "σ of the analysis leaves out directions that are observed: its squares may be off by \
             {bound:.2} of the background's (a posterior of low rank, at most {MOST_PRODUCTS} directions)"
        ))
    }
}

/// Variances to a part in ten thousand of the background's.
pub(super) fn low_rank_options() -> LanczosOptions {
    LanczosOptions::default().with_tolerance(1e-4).with_max_products(MOST_PRODUCTS)
}

/// The square roots of the diagonal of a covariance.
pub(crate) fn deviations(covariance: &dyn Covariance) -> Vec<f64> {
    let mut variance = vec![0.0; covariance.dim()];
    covariance.variance(&mut variance);
    roots(variance)
}

pub(super) fn roots(variance: Vec<f64>) -> Vec<f64> {
    variance.into_iter().map(|v| v.max(0.0).sqrt()).collect()
}

/// A stalled minimization whose gradient fell below this share of the first has come to the minimum as nearly
/// as rounding, or the noise of J, allows.
pub(crate) const AT_THE_MINIMUM: f64 = 1e-3;

/// Whether a minimization came to its minimum, so that J can be followed from there.
pub(super) fn is_at_minimum(minimum: &Minimum) -> bool {
    minimum.status == Status::Converged
        || minimum.gradient_norm <= AT_THE_MINIMUM * minimum.gradient_norm_first
}

/// Whether a minimization ended by itself, so that its end has a posterior.
pub(super) fn is_whole(status: Status) -> bool {
    !matches!(status, Status::Interrupted | Status::Failed)
}
