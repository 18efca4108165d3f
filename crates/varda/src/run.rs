//! The assimilation of a problem, as plain data: problem → outcome.

use std::ops::ControlFlow;
use std::time::Instant;

use serde::Serialize;
use varda_assimilation::{
    Analysis, ControlTransform, CostFunction, Counts, Minimum, Posterior, StrongConstraint,
};
use varda_implicit::Model;

use crate::Error;
use crate::fit::{self, Fit, Forecast, Withheld};
use crate::method;
use crate::problem::{Problem, View, run_states};
use crate::scene;
use crate::timed::Timed;

/// What the caller of a run wants to hear and may say.
pub struct Listener<'a> {
    /// Called with every row of the convergence table.
    pub on_iteration: &'a mut dyn FnMut(&ConvergenceRow),
    /// Asked after every iteration: true ends the run with what is done.
    pub interrupted: &'a dyn Fn() -> bool,
    /// When the run began; `seconds.total` counts from here.
    pub started: Instant,
}

/// One row of the convergence table.
#[derive(Debug, Clone, Serialize)]
pub struct ConvergenceRow {
    /// Outer iterations done.
    pub iteration: usize,
    /// Seconds since the minimization began.
    pub seconds: f64,
    /// J.
    pub j: f64,
    /// J_b.
    pub j_b: f64,
    /// J_o.
    pub j_o: f64,
    /// J_q.
    pub j_q: f64,
    /// ‖∇J‖ in the control variable.
    pub gradient_norm: f64,
    /// RMSE of the initial positions (of the state, for other models), where the truth is known.
    pub rmse_position: Option<f64>,
    /// RMSE of the initial velocities.
    pub rmse_velocity: Option<f64>,
    /// What σ of the observations is multiplied by at this stage.
    pub sigma_factor: f64,
    /// Work of the model so far.
    pub counts: WorkCounts,
}

/// Work of the model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct WorkCounts {
    /// Steps taken.
    pub model_steps: usize,
    /// Products with M_k.
    pub tangent_steps: usize,
    /// Products with M_kᵀ.
    pub adjoint_steps: usize,
    /// Numerical factorizations.
    pub factorizations: usize,
    /// Newton iterations of the steps.
    pub newton_iterations: usize,
}

impl From<&Counts> for WorkCounts {
    fn from(counts: &Counts) -> Self {
        WorkCounts {
            model_steps: counts.model.model_steps,
            tangent_steps: counts.model.tangent_steps,
            adjoint_steps: counts.model.adjoint_steps,
            factorizations: counts.model.factorizations,
            newton_iterations: counts.model.newton_iterations,
        }
    }
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// At a stationary point of J.
    Converged,
    /// Out of iterations.
    MaxIterations,
    /// No step decreases J any more.
    Stalled,
    /// The caller asked to stop.
    Interrupted,
    /// The model failed where no safeguard was asked for.
    Failed,
}

impl Status {
    /// Its name in summary.json.
    pub fn name(self) -> &'static str {
        match self {
            Status::Converged => "converged",
            Status::MaxIterations => "max_iterations",
            Status::Stalled => "stalled",
            Status::Interrupted => "interrupted",
            Status::Failed => "failed",
        }
    }
}

/// RMSE against the truth: the root of the mean squared distance of a vertex (of a component, for other models).
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Rmse {
    /// Of positions \[m\], background.
    pub position_background: Option<f64>,
    /// Of positions \[m\], analysis.
    pub position_analysis: Option<f64>,
    /// Of velocities [m/s], background.
    pub velocity_background: Option<f64>,
    /// Of velocities [m/s], analysis.
    pub velocity_analysis: Option<f64>,
}

/// Where the time went \[s\].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Seconds {
    /// From the start of the run to the end of the analysis.
    pub total: f64,
    /// In steps of the model.
    pub forward: f64,
    /// In linearizations and adjoint products.
    pub adjoint: f64,
    /// In tangent products.
    pub tangent: f64,
    /// In the minimization, the model's share included.
    pub minimizer: f64,
}

/// Runs of the whole window and its forecast, states one after the other.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trajectories {
    /// Length of a state.
    pub dim: usize,
    /// From x_b.
    pub background: Vec<f64>,
    /// From x_a.
    pub analysis: Vec<f64>,
    /// The truth, or nothing.
    pub truth: Vec<f64>,
}

impl Trajectories {
    /// State k of a run; `None` where the run did not get there.
    pub fn state<'a>(&self, states: &'a [f64], k: usize) -> Option<&'a [f64]> {
        states.get(k * self.dim..(k + 1) * self.dim)
    }
}

/// What a run gives.
#[derive(Debug)]
pub struct Outcome {
    /// How it ended.
    pub status: Status,
    /// x_b and x_a, their σ, J and what follows from it.
    pub analysis: Analysis,
    /// Whether σ_a was computed.
    pub has_posterior: bool,
    /// The truth, in the control.
    pub truth: Option<Vec<f64>>,
    /// J at the background.
    pub j_background: f64,
    /// ‖∇J‖ at the first point and at the last.
    pub gradient_norms: [f64; 2],
    /// Outer and inner iterations.
    pub iterations: [usize; 2],
    /// The convergence table.
    pub convergence: Vec<ConvergenceRow>,
    /// Work of the minimization.
    pub counts: WorkCounts,
    /// RMSE against the truth.
    pub rmse: Rmse,
    /// Where the time went.
    pub seconds: Seconds,
    /// Innovations against their assumed σ, per marker or place.
    pub fit: Vec<Fit>,
    /// Errors at the markers that were kept back.
    pub withheld: Vec<Withheld>,
    /// Errors of the forecast.
    pub forecast: Vec<Forecast>,
    /// Runs of the window.
    pub trajectories: Trajectories,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Minimises the cost of a problem and takes stock.
///
/// # Errors
/// [`Error::Assimilation`] where the cost cannot be evaluated at the background; [`Error::Model`], [`Error::Rod`]. How a
/// minimization ended is a [`Status`].
pub fn assimilate(problem: &mut Problem, listener: &mut Listener) -> Result<Outcome, Error> {
    let mut timed = Timed::new(problem.model.as_mut());
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
    let mut cost = StrongConstraint::new(&mut timed, transform.clone(), &mut problem.observations)?;
    let mut v = vec![0.0; cost.dim()];
    let truth = problem.truth.as_ref().map(|x| x[..problem.background.len()].to_vec());
    let is_rod = matches!(problem.view, View::Rod(_));

    let began = Instant::now();
    let mut convergence: Vec<ConvergenceRow> = Vec::new();
    let mut z = problem.background.clone();
    let mut on_iteration = |i: &varda_assimilation::Iteration| {
        transform.control(i.v, &mut z);
        let [rmse_position, rmse_velocity] = errors(&z, truth.as_deref(), is_rod);
        let row = ConvergenceRow {
            iteration: i.index,
            seconds: began.elapsed().as_secs_f64(),
            j: i.value,
            j_b: i.terms.background,
            j_o: i.terms.observation,
            j_q: i.terms.model_error,
            gradient_norm: i.gradient_norm,
            rmse_position,
            rmse_velocity,
            sigma_factor: i.observation_scale,
            counts: WorkCounts::from(&i.counts),
        };
        (listener.on_iteration)(&row);
        convergence.push(row);
        if (listener.interrupted)() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    if let Some(delta) = problem.scene.algorithm.robust {
        cost.set_huber(delta)?;
    }
    let limits = &problem.scene.limits;
    if let Some(bytes) = limits.bytes().unwrap_or_default() {
        let storage = cost.set_memory(bytes)?;
        problem.left_out.extend(limits.left_out(storage, problem.window.steps));
    }
    let j_background = cost.evaluate(&v, None)?;
    let minimum = method::minimize(&problem.scene.algorithm, &mut cost, &mut v, &mut on_iteration)?;
    let minimizer_seconds = began.elapsed().as_secs_f64();
    let counts = WorkCounts::from(&cost.counts());
    let status = status(&minimum);

    let has_posterior =
        problem.scene.report.posterior && !matches!(status, Status::Interrupted | Status::Failed);
    let n = cost.dim();
    let posterior = if has_posterior {
        let mut gradient = vec![0.0; n];
        // BLUE's covariance is that of the background's linearization, (I + GᵀG)⁻¹ there.
        let linearized = match problem.scene.algorithm.method {
            scene::Method::Blue => &vec![0.0; n],
            _ => &v,
        };
        cost.evaluate(linearized, Some(&mut gradient))?;
        Posterior::new(&mut cost)?
    } else {
        let identity: Vec<f64> = (0..n * n).map(|i| f64::from(i % (n + 1) == 0)).collect();
        Posterior::from_hessian(n, &identity)?
    };
    drop(cost);
    let m = problem.observations.dim();
    let analysis = Analysis::new(&transform, &v, &minimum, &posterior, m);
    let seconds = [timed.forward, timed.adjoint, timed.tangent].map(|d| d.as_secs_f64());

    let mut warnings: Vec<String> =
        problem.model.warnings().iter().map(|w| format!("step {}: {}", w.step, w.text)).collect();
    warnings.dedup();
    if let Some(failure) = &minimum.failure {
        warnings.push(match status {
            Status::Failed => format!("the minimizer was driven where the model fails: {failure}"),
            _ => format!("the last trial point refused: {failure}"),
        });
    }
    match status {
        Status::MaxIterations => {
            warnings.push(format!("not converged after {} iterations", minimum.outer_iterations))
        }
        Status::Stalled => warnings.push("the minimizer stalled before its tolerance was met".into()),
        Status::Interrupted => {
            warnings.push("interrupted: the last accepted point, without posterior".into())
        }
        Status::Converged | Status::Failed => {}
    }
    let trajectories = trajectories(problem, &analysis.analysis, &mut warnings);
    let fit = fit::fit(&mut problem.observations, &trajectories)?;
    let (withheld, forecast) = match &mut problem.view {
        View::Rod(rod) => fit::beyond(rod, &problem.window, &trajectories, problem.model.as_mut())?,
        View::Components(_) => (Vec::new(), Vec::new()),
    };
    warnings.extend(fit::remarks(&fit, &analysis));
    let [position_background, velocity_background] = errors(&analysis.background, truth.as_deref(), is_rod);
    let [position_analysis, velocity_analysis] = errors(&analysis.analysis, truth.as_deref(), is_rod);
    Ok(Outcome {
        status,
        has_posterior,
        truth,
        j_background,
        gradient_norms: [minimum.gradient_norm_first, minimum.gradient_norm],
        iterations: [minimum.outer_iterations, minimum.inner_iterations],
        convergence,
        counts,
        rmse: Rmse { position_background, position_analysis, velocity_background, velocity_analysis },
        seconds: Seconds {
            total: listener.started.elapsed().as_secs_f64(),
            forward: seconds[0],
            adjoint: seconds[1],
            tangent: seconds[2],
            minimizer: minimizer_seconds,
        },
        fit,
        withheld,
        forecast,
        trajectories,
        warnings,
        analysis,
    })
}

fn status(minimum: &Minimum) -> Status {
    use varda_assimilation::Status as S;
    match minimum.status {
        S::Converged => Status::Converged,
        S::MaxIterations => Status::MaxIterations,
        S::Stalled => Status::Stalled,
        S::Interrupted => Status::Interrupted,
        S::Failed => Status::Failed,
    }
}

/// RMSE of positions and velocities (of a rod's [X, V], a vertex at a time), or of all components.
fn errors(control: &[f64], truth: Option<&[f64]>, is_rod: bool) -> [Option<f64>; 2] {
    let Some(truth) = truth else { return [None, None] };
    let rms = |a: &[f64], b: &[f64], components: usize| {
        let sum: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
        Some((sum * components as f64 / a.len().max(1) as f64).sqrt())
    };
    if is_rod {
        let half = control.len() / 2;
        [rms(&control[..half], &truth[..half], 3), rms(&control[half..], &truth[half..], 3)]
    } else {
        [rms(control, truth, 1), None]
    }
}

/// Runs of the window and its forecast. One that fails ends early, with a warning.
fn trajectories(problem: &mut Problem, analysis: &[f64], warnings: &mut Vec<String>) -> Trajectories {
    let steps = problem.window.steps + problem.window.forecast;
    let model = problem.model.as_mut();
    let dim = model.dim();
    let [mut from_background, mut from_analysis] = [vec![0.0; dim], vec![0.0; dim]];
    let background = model.initial_state(&problem.background, &mut from_background);
    let background = run_as_far("background", model, background, &from_background, steps, warnings);
    let analysis = model.initial_state(analysis, &mut from_analysis);
    let analysis = run_as_far("analysis", model, analysis, &from_analysis, steps, warnings);
    let truth = match &problem.truth {
        Some(truth) => run_as_far("truth", model, Ok(()), truth, steps, warnings),
        None => Vec::new(),
    };
    Trajectories { dim, background, analysis, truth }
}

/// States from `x0` on, up to the step that fails. `start` is how the making of `x0` went.
fn run_as_far(
    what: &str,
    model: &mut dyn Model,
    start: Result<(), varda_implicit::Error>,
    x0: &[f64],
    steps: usize,
    warnings: &mut Vec<String>,
) -> Vec<f64> {
    let dim = x0.len();
    let mut states = x0.to_vec();
    let mut next = vec![0.0; dim];
    let mut result = start;
    for k in 0..steps {
        result = result.and_then(|()| model.step(k, &states[k * dim..], &mut next));
        if result.is_err() {
            break;
        }
        states.extend_from_slice(&next);
    }
    if let Err(e) = result {
        warnings.push(format!("the run of the {what} ends early: {e}"));
    }
    states
}

/// A forward run.
#[derive(Debug)]
pub struct Simulation {
    /// What was run: "truth" or "background".
    pub of: &'static str,
    /// Its states, one after the other.
    pub states: Vec<f64>,
    /// Steps taken.
    pub steps: usize,
    /// Work of the model.
    pub counts: WorkCounts,
    /// Where the free end of a rod is at the end \[m\].
    pub tip: Option<[f64; 3]>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Runs the model forward over the window and its forecast: from the truth where there is one, else from the background.
///
/// # Errors
/// [`Error::Model`] naming the step that failed.
pub fn simulate(problem: &mut Problem) -> Result<Simulation, Error> {
    let steps = problem.window.steps + problem.window.forecast;
    let model = problem.model.as_mut();
    let mut x0 = vec![0.0; model.dim()];
    let of = match &problem.truth {
        Some(truth) => {
            x0.copy_from_slice(truth);
            "truth"
        }
        None => {
            model.initial_state(&problem.background, &mut x0)?;
            "background"
        }
    };
    let states = run_states(model, &x0, steps)?;
    let counts = Counts { model: model.counts(), ..Counts::default() };
    let warnings = model.warnings().iter().map(|w| format!("step {}: {}", w.step, w.text)).collect();
    let last = &states[steps * x0.len()..];
    let tip = match &mut problem.view {
        View::Rod(rod) => rod.vertices(&problem.window, steps, last)?.last().copied(),
        View::Components(_) => None,
    };
    Ok(Simulation { of, states, steps, counts: WorkCounts::from(&counts), tip, warnings })
}
