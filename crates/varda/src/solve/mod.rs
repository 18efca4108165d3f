//! The member of the variational family a scene names: from its cost to a minimum, the analysed control, its spread and, where the
//! analysis is not a run of the model, the analysed trajectory.

pub(crate) mod minimizer;
pub mod timed;

use std::ops::ControlFlow;

use varda_assimilation::{
    ControlTransform, CostFunction, EnVar, EnVarOptions, Error, Forcing, InnerSolver, Iteration, Minimum,
    ObservationSet, Posterior, Rejection, Status, StrongConstraint, WeakForcing, WeakState, outer_loop,
    window_growth,
};
use varda_covariance::{Covariance, Ensemble, Hybrid};
use varda_implicit::{Model, Storage};

use crate::run::window::{WorkCounts, run_on};
use crate::scene::{Algorithm, Method};
use crate::setup::covariance::Factored;
use crate::setup::ensemble::anchors;

/// The first linearization of an ensemble takes the members themselves (4D-EnVar proper), later ones differences about the iterate of this
/// part of their spread (the iterative ensemble smoother): a large spread would end where its own secants vanish, not the gradient.
const SPREAD: f64 = 1e-3;

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
pub(crate) struct Solved {
    /// Of the whole window; iterations are those of all sub-windows.
    pub(crate) minimum: Minimum,
    /// z_a.
    pub(crate) control: Vec<f64>,
    /// σ of the control before: that of B, or of the ensemble.
    pub(crate) sigma_background: Vec<f64>,
    /// Of the analysis; none where the run did not get there.
    pub(crate) spread: Option<Spread>,
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
pub(crate) struct Spread {
    pub(crate) sigma: Vec<f64>,
    /// Degrees of freedom for signal (of the initial state, where the model errs).
    pub(crate) degrees_of_freedom: f64,
}

/// One line of a convergence table.
pub(crate) struct Row<'a> {
    pub(crate) iteration: &'a Iteration<'a>,
    /// z at that point.
    pub(crate) control: &'a [f64],
    /// Steps of the sub-window.
    pub(crate) window: usize,
    /// Outer iterations and work of the sub-windows before.
    pub(crate) before: (usize, WorkCounts),
}

/// Told of every iteration; says whether to go on.
pub(crate) type OnRow<'a> = dyn FnMut(&Row) -> ControlFlow<()> + 'a;

/// A stage: one sub-window, from the point the last one ended at.
struct Stage<'s, 'r> {
    observations: &'s mut ObservationSet,
    /// The control variable.
    v: &'s mut Vec<f64>,
    /// What is known of the trajectory (weak-constraint forms).
    states: &'s mut Vec<f64>,
    /// Whether it is the last, of the whole window.
    whole: bool,
    /// Whether σ is wanted of it.
    posterior: bool,
    before: (usize, WorkCounts),
    on_row: &'s mut OnRow<'r>,
}

/// A stage's end.
struct Ended {
    minimum: Minimum,
    control: Vec<f64>,
    sigma_background: Vec<f64>,
    spread: Option<Spread>,
    no_spread: Option<Error>,
    counts: WorkCounts,
    storage: Storage,
}

/// The ensemble, alone or beside B.
enum Members<'a> {
    Pure(&'a Ensemble),
    Hybrid(Box<Hybrid<'a>>),
}

/// Checks the observations against the background where that is asked for, and minimises: the window at once or growing.
///
/// # Errors
/// A cost that cannot be evaluated at the background, or cannot be made. How a minimization ended is a [`Status`].
pub(crate) fn solve(
    task: &mut Task,
    mut observations: ObservationSet,
    on_row: &mut OnRow,
) -> Result<(Solved, ObservationSet), crate::Error> {
    let mut spent = WorkCounts::default();
    let mut rejected = Vec::new();
    if let Some(limit) = task.algorithm.background_check {
        let (refused, counts) = task.background_check(&mut observations, limit)?;
        observations = observations.without(&refused.iter().map(|r| r.row).collect::<Vec<_>>())?;
        (rejected, spent) = (refused, counts);
    }
    let whole = observations.steps();
    let growth = task.algorithm.window_growth.as_slice();
    let windows = if growth.is_empty() { &[whole][..] } else { growth };
    let (mut states, mut done, mut ended, mut stages) = (Vec::new(), [0, 0], None, Vec::new());
    let (observations, mut minima) =
        window_growth(observations, windows, &mut Vec::new(), &mut |seen, v| {
            let window = seen.steps();
            let stage = Stage {
                observations: seen,
                v,
                states: &mut states,
                whole: window == whole,
                posterior: task.posterior && window == whole,
                before: (done[0], spent),
                on_row,
            };
            let Ended { minimum, control, sigma_background, spread, no_spread, counts, storage } =
                task.stage(stage)?;
            done[0] += minimum.outer_iterations;
            done[1] += minimum.inner_iterations;
            spent = spent + counts;
            stages.push((window, minimum.status));
            ended = Some((control, sigma_background, spread, no_spread, storage));
            Ok(minimum)
        })?;
    stages.pop();
    let (Some(last), Some((control, sigma_background, spread, no_spread, storage))) = (minima.pop(), ended)
    else {
        unreachable!("there is one window at least");
    };
    let minimum = Minimum { outer_iterations: done[0], inner_iterations: done[1], ..last };
    let solved = Solved {
        minimum,
        control,
        sigma_background,
        spread,
        no_spread,
        states,
        counts: spent,
        rejected,
        stages,
        storage,
    };
    Ok((solved, observations))
}

impl Task<'_> {
    fn stage(&mut self, stage: Stage) -> Result<Ended, Error> {
        match self.algorithm.method {
            Method::WeakForcing => self.weak_forcing(stage),
            Method::WeakState => self.weak_state(stage),
            Method::FourDEnVar | Method::HybridFourDEnVar => self.ensemble(stage),
            _ => self.strong(stage),
        }
    }

    /// Where and how often the model errs: in the components of the control, which lead the state.
    fn forcing(&self) -> Forcing {
        let error = self.algorithm.model_error.as_ref();
        Forcing {
            components: (0..self.background.len()).collect(),
            steps: error.map_or(1, |e| e.every),
            held: error.is_some_and(|e| e.held),
        }
    }

    /// The strong constraint. 3D-Var is 4D-Var where nothing is observed after step 0. Where the model is refreshed at the end of the
    /// window, the minimization goes on from there, to the gradient norm that was first asked for.
    fn strong(&mut self, stage: Stage) -> Result<Ended, Error> {
        let (background, covariance) = (self.background, self.covariance);
        let transform = ControlTransform::new(background.to_vec(), covariance.as_ref())?;
        let Stage { observations, v, whole, posterior, before, on_row, .. } = stage;
        let window = observations.steps();
        let mut algorithm = self.algorithm.clone();
        let mut control = background.to_vec();
        let mut fresh: Option<Box<dyn Model + Send + '_>> = None;
        let mut first: Option<Minimum> = None;
        let (mut iterations, mut counts) = ([0, 0], WorkCounts::default());
        loop {
            let model: &mut dyn Model = match &mut fresh {
                Some(model) => model.as_mut(),
                None => &mut *self.model,
            };
            let mut cost = StrongConstraint::new(model, transform.clone(), &mut *observations)?;
            if let Some(delta) = algorithm.robust {
                cost.set_huber(delta)?;
            }
            cost.set_memory(self.memory)?;
            let storage = cost.storage();
            v.resize(cost.dim(), 0.0);
            if let Some(first) = &first {
                let mut gradient = vec![0.0; v.len()];
                cost.evaluate(v, Some(&mut gradient))?;
                let wanted = self.algorithm.gradient_tolerance * first.gradient_norm_first;
                // At least half: what a start too good would ask for is nothing.
                algorithm.gradient_tolerance = (wanted / minimizer::norm(&gradient)).clamp(f64::EPSILON, 0.5);
                algorithm.sigma_stages.clear();
            }
            let start = v.clone();
            let so_far = (before.0 + iterations[0], before.1 + counts);
            let mut on_iteration = |iteration: &Iteration| {
                transform.control(iteration.v, &mut control);
                on_row(&Row { iteration, control: &control, window, before: so_far })
            };
            let mut minimum = minimizer::strong(&algorithm, &mut cost, v, &mut on_iteration)?;
            transform.control(v, &mut control);
            counts = counts + WorkCounts::from(&cost.counts());
            iterations[0] += minimum.outer_iterations;
            iterations[1] += minimum.inner_iterations;
            let settled = matches!(minimum.status, Status::Converged | Status::Stalled);
            let another = if whole && settled { (self.refresh)(&control) } else { None };
            if let Some(model) = another {
                drop(cost);
                fresh = Some(model);
                first.get_or_insert(minimum);
                continue;
            }
            let (spread, no_spread) = if posterior && is_whole(minimum.status) {
                // BLUE's covariance is that of the background's linearization, (I + GᵀG)⁻¹ there.
                let linearized = if algorithm.method == Method::Blue { &start } else { &*v };
                cost.evaluate(linearized, Some(&mut vec![0.0; v.len()]))?;
                Spread::of(Posterior::new(&mut cost), &transform)?
            } else {
                (None, None)
            };
            if let Some(first) = first {
                minimum.gradient_norm_first = first.gradient_norm_first;
            }
            [minimum.outer_iterations, minimum.inner_iterations] = iterations;
            let sigma_background = deviations(covariance.as_ref());
            return Ok(Ended { minimum, control, sigma_background, spread, no_spread, counts, storage });
        }
    }

    fn weak_forcing(&mut self, stage: Stage) -> Result<Ended, Error> {
        let (algorithm, background, covariance) = (self.algorithm, self.background, self.covariance);
        let missing =
            Error::Setting { what: "the covariance of a model error that is not there", value: 0.0 };
        let q: &dyn Covariance = self.model_error.ok_or(missing)?.as_ref();
        let forcing = self.forcing();
        let transform = ControlTransform::new(background.to_vec(), covariance.as_ref())?;
        let Stage { observations, v, states, posterior, before, on_row, .. } = stage;
        let (window, last) = (observations.steps(), observations.last_step().unwrap_or(0));
        let mut cost = WeakForcing::new(&mut *self.model, transform.clone(), q, forcing, observations)?;
        // What is added to the window begins without forcing.
        v.resize(cost.dim(), 0.0);
        let head = transform.dim();
        let mut control = background.to_vec();
        let minimum = minimizer::minimize(algorithm, &mut cost, v, &mut |iteration| {
            transform.control(&iteration.v[..head], &mut control);
            on_row(&Row { iteration, control: &control, window, before })
        })?;
        let counts = WorkCounts::from(&cost.counts());
        states.clear();
        let (mut spread, mut no_spread) = (None, None);
        if minimum.status != Status::Failed {
            cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
            (0..=last).for_each(|k| states.extend_from_slice(cost.state(k)));
            if posterior && is_whole(minimum.status) {
                (spread, no_spread) = Spread::of(Posterior::of_initial_state(&mut cost), &transform)?;
            }
        }
        transform.control(&v[..head], &mut control);
        Ok(Ended {
            minimum,
            control,
            sigma_background: deviations(covariance.as_ref()),
            spread,
            no_spread,
            counts,
            storage: Storage::KeepAll,
        })
    }

    /// Started from the run of the background; where the window has grown, from the analysed states and the model's run from the last.
    fn weak_state(&mut self, stage: Stage) -> Result<Ended, Error> {
        let (algorithm, background, covariance) = (self.algorithm, self.background, self.covariance);
        let forcing = self.forcing();
        let transform = ControlTransform::new(background.to_vec(), covariance.as_ref())?;
        let singular = |what| Error::Setting { what, value: 0.0 };
        let b = covariance.precision().ok_or(singular("the inverse of a truncated B"))?;
        let q = self.model_error.and_then(Factored::precision);
        let q = q.ok_or(singular("the inverse of a truncated Q"))?;
        let Stage { observations, v, states, posterior, before, on_row, .. } = stage;
        let (window, last) = (observations.steps(), observations.last_step().unwrap_or(0));
        let run_before = self.model.counts();
        if states.is_empty() {
            states.resize(self.model.dim(), 0.0);
            self.model.initial_state(background, states)?;
        }
        run_on(&mut *self.model, states, last)?;
        let run = WorkCounts::of(self.model.counts() - run_before);
        let mut cost = WeakState::new(&mut *self.model, background.to_vec(), b, q, forcing, observations)?;
        let (n_z, n) = (background.len(), states.len() / (last + 1));
        let mut control = if v.is_empty() { background.to_vec() } else { v[..n_z].to_vec() };
        *v = cost.control(&control, &mut |k, x| x.copy_from_slice(&states[k * n..(k + 1) * n]));
        let options = minimizer::outer(algorithm, InnerSolver::Primal);
        let before_this = (before.0, before.1 + run);
        let minimum = outer_loop(&mut cost, v, &options, &mut |iteration| {
            on_row(&Row { iteration, control: &iteration.v[..n_z], window, before: before_this })
        })?;
        let counts = WorkCounts::from(&cost.counts()) + run;
        states.clear();
        let (mut spread, mut no_spread) = (None, None);
        if minimum.status != Status::Failed {
            cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
            (0..=last).for_each(|k| states.extend_from_slice(cost.state(k)));
            if posterior && is_whole(minimum.status) {
                (spread, no_spread) = Spread::of(Posterior::of_initial_state(&mut cost), &transform)?;
            }
        }
        control.copy_from_slice(&v[..n_z]);
        Ok(Ended {
            minimum,
            control,
            sigma_background: deviations(covariance.as_ref()),
            spread,
            no_spread,
            counts,
            storage: Storage::KeepAll,
        })
    }

    /// The members of the scene's ensemble, alone or beside B.
    fn members(&self) -> Result<Members<'_>, Error> {
        let what = "an ensemble of no members";
        let ensemble = self.ensemble.ok_or(Error::Setting { what, value: 0.0 })?;
        if self.algorithm.method == Method::FourDEnVar {
            return Ok(Members::Pure(ensemble));
        }
        let [of_static, of_ensemble] = self.algorithm.members().unwrap_or_default().weights();
        let b: &dyn Covariance = self.covariance.as_ref();
        Ok(Members::Hybrid(Box::new(Hybrid::new(b, of_static, ensemble.clone(), of_ensemble)?)))
    }

    fn ensemble(&mut self, stage: Stage) -> Result<Ended, Error> {
        let members = self.members()?;
        let Stage { observations, v, posterior, before, on_row, .. } = stage;
        let window = observations.steps();
        let anchors = anchors(observations, self.anchors);
        let mut cost = members.cost(self.make_model, self.background, observations, &anchors)?;
        cost.set_spread(SPREAD);
        v.resize(cost.dim(), 0.0);
        let transform = cost.transform().clone();
        let mut control = self.background.to_vec();
        let mut on_iteration = |iteration: &Iteration| {
            transform.control(iteration.v, &mut control);
            on_row(&Row { iteration, control: &control, window, before })
        };
        // The static part of a hybrid stays where it is through the window: relinearized, it has no minimum to end at.
        let max_outer = match self.algorithm.method {
            Method::HybridFourDEnVar => 1,
            _ => self.algorithm.max_iterations,
        };
        let options = EnVarOptions { max_outer, ..EnVarOptions::default() };
        let minimum = cost.minimize(v, &options, &mut on_iteration)?;
        let counts = WorkCounts::from(&cost.counts());
        // The last step is not followed by a run of the ensemble, nor reported: nothing is left to interrupt.
        if matches!(minimum.status, Status::Converged | Status::MaxIterations) {
            let _ = on_iteration(&minimum.iteration(0.0, cost.counts(), v));
        }
        let spread = if posterior && is_whole(minimum.status) {
            let (variance, degrees_of_freedom) = cost.posterior_variance()?;
            Some(Spread { sigma: roots(variance), degrees_of_freedom })
        } else {
            None
        };
        transform.control(v, &mut control);
        let sigma_background = deviations(transform.covariance());
        Ok(Ended {
            minimum,
            control,
            sigma_background,
            spread,
            no_spread: None,
            counts,
            storage: Storage::KeepAll,
        })
    }

    /// The observed values that are too far from the background, by the covariances the method believes in.
    fn background_check(
        &mut self,
        observations: &mut ObservationSet,
        limit: f64,
    ) -> Result<(Vec<Rejection>, WorkCounts), Error> {
        if self.algorithm.method.is_ensemble() {
            let members = self.members()?;
            let anchors = anchors(observations, self.anchors);
            let mut cost = members.cost(self.make_model, self.background, observations, &anchors)?;
            return Ok((cost.background_check(limit)?, WorkCounts::from(&cost.counts())));
        }
        let forcing = self.forcing();
        let transform = ControlTransform::new(self.background.to_vec(), self.covariance.as_ref())?;
        match self.model_error {
            Some(q) => {
                let q = q.as_ref();
                let mut cost = WeakForcing::new(&mut *self.model, transform, q, forcing, observations)?;
                Ok((cost.background_check(limit)?, WorkCounts::from(&cost.counts())))
            }
            None => {
                let mut cost = StrongConstraint::new(&mut *self.model, transform, observations)?;
                Ok((cost.background_check(limit)?, WorkCounts::from(&cost.counts())))
            }
        }
    }
}

impl Members<'_> {
    /// The cost of some observations.
    fn cost<'c>(
        &'c self,
        make: &dyn Fn() -> Box<dyn Model + Send>,
        background: &[f64],
        observations: &'c mut ObservationSet,
        anchors: &[usize],
    ) -> Result<EnVar<'c>, Error> {
        let background = background.to_vec();
        match self {
            Members::Pure(ensemble) => EnVar::new(make, background, ensemble, observations, anchors),
            Members::Hybrid(hybrid) => EnVar::hybrid(make, background, hybrid, observations, anchors),
        }
    }
}

impl Spread {
    /// Of a posterior; where its Hessian is indefinite by rounding, as over a window that amplifies beyond it, the reason alone.
    fn of(
        posterior: Result<Posterior, Error>,
        transform: &ControlTransform,
    ) -> Result<(Option<Spread>, Option<Error>), Error> {
        match posterior {
            Ok(posterior) => {
                let sigma = roots(posterior.variance(transform));
                let degrees_of_freedom = posterior.degrees_of_freedom();
                Ok((Some(Spread { sigma, degrees_of_freedom }), None))
            }
            Err(reason @ Error::NotPositiveDefinite { .. }) => Ok((None, Some(reason))),
            Err(error) => Err(error),
        }
    }
}

/// The square roots of the diagonal of a covariance.
fn deviations(covariance: &dyn Covariance) -> Vec<f64> {
    let mut variance = vec![0.0; covariance.dim()];
    covariance.variance(&mut variance);
    roots(variance)
}

fn roots(variance: Vec<f64>) -> Vec<f64> {
    variance.into_iter().map(|v| v.max(0.0).sqrt()).collect()
}

/// A run that came to its own end has a posterior.
fn is_whole(status: Status) -> bool {
    !matches!(status, Status::Interrupted | Status::Failed)
}
