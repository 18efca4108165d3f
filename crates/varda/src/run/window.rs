//! The assimilation of a problem, as plain data: problem → outcome.

use std::ops::{Add, ControlFlow};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use varda_assimilation::{Analysis, Counts, ObservationSet, huber};
use varda_implicit::Model;
use varda_implicit::check::Amplification;

use crate::Error;
use crate::run::amplification;
use crate::run::fit::{self, Fit, Forecast, Withheld};
pub use crate::setup::adaptive_steps::AcceptedSteps;
use crate::setup::adaptive_steps::Refreshing;
use crate::setup::problem::{Problem, View, run_states};
use crate::solve::timed::{Clock, Timed};
use crate::solve::{self, Solved, Task};

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
    /// Steps of the sub-window; J is that of its observations.
    pub window: usize,
    /// Work of the model so far.
    pub counts: WorkCounts,
}

/// Work of the model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
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
        WorkCounts::of(counts.model)
    }
}

impl WorkCounts {
    /// Those of a model.
    pub fn of(model: varda_implicit::Counts) -> Self {
        WorkCounts {
            model_steps: model.model_steps,
            tangent_steps: model.tangent_steps,
            adjoint_steps: model.adjoint_steps,
            factorizations: model.factorizations,
            newton_iterations: model.newton_iterations,
        }
    }
}

impl Add for WorkCounts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        WorkCounts {
            model_steps: self.model_steps + other.model_steps,
            tangent_steps: self.tangent_steps + other.tangent_steps,
            adjoint_steps: self.adjoint_steps + other.adjoint_steps,
            factorizations: self.factorizations + other.factorizations,
            newton_iterations: self.newton_iterations + other.newton_iterations,
        }
    }
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
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

/// An observed value that the background check refused.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rejected {
    /// Whose.
    pub label: String,
    /// Step of the window (the one before, where it was seen between two).
    pub step: usize,
    /// Model time of that step \[s\].
    pub time: f64,
    /// d = y − H(x_b), in the unit of the value.
    pub departure: f64,
    /// √(HBHᵀ + R), what is expected of it.
    pub expected: f64,
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
    /// What the background check refused.
    pub rejected: Vec<Rejected>,
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
    /// How much the window amplifies about the analysis, up to the last observation; none for methods without a gradient along a run.
    pub amplification: Option<Amplification>,
    /// Steps divided by their error; `None` where they are the scene's.
    pub accepted_steps: Option<AcceptedSteps>,
    /// Runs of the window.
    pub trajectories: Trajectories,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Minimises the cost of a problem by the method of its scene and takes stock. What the background check refuses is no longer among
/// the problem's observations.
///
/// # Errors
/// [`Error::Assimilation`] where the cost cannot be evaluated at the background; [`Error::Model`], [`Error::Rod`]. How a
/// minimization ended is a [`Status`]. After an error the problem has no observations.
pub fn assimilate(problem: &mut Problem, listener: &mut Listener) -> Result<Outcome, Error> {
    let truth = problem.truth.as_ref().map(|x| x[..problem.background.len()].to_vec());
    let is_rod = matches!(problem.view, View::Rod(_));
    let algorithm = &problem.scene.algorithm;

    let began = Instant::now();
    let mut convergence: Vec<ConvergenceRow> = Vec::new();
    let mut on_row = |r: &solve::Row| {
        let [rmse_position, rmse_velocity] = errors(r.control, truth.as_deref(), is_rod);
        let i = r.iteration;
        let row = ConvergenceRow {
            iteration: r.before.0 + i.index,
            seconds: began.elapsed().as_secs_f64(),
            j: i.value,
            j_b: i.terms.background,
            j_o: i.terms.observation,
            j_q: i.terms.model_error,
            gradient_norm: i.gradient_norm,
            rmse_position,
            rmse_velocity,
            sigma_factor: i.observation_scale,
            window: r.window,
            counts: r.before.1 + WorkCounts::from(&i.counts),
        };
        (listener.on_iteration)(&row);
        convergence.push(row);
        if (listener.interrupted)() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let clock = Clock::default();
    let mut divided = Refreshing::new(problem.divided.take());
    let mut timed = Timed::new(problem.model.as_mut(), &clock);
    let make = &problem.make_model;
    let make_timed = || -> Box<dyn Model + Send> { Box::new(Timed::new(make(0), &clock)) };
    let mut task = Task {
        algorithm,
        model: &mut timed,
        make_model: &make_timed,
        background: &problem.background,
        covariance: &problem.covariance,
        model_error: problem.model_error.as_ref(),
        ensemble: problem.ensemble.as_ref(),
        anchors: &problem.anchors,
        posterior: problem.scene.report.posterior,
        memory: problem.memory,
        refresh: &mut |control| {
            let model = divided.refresh(control)?;
            Some(Box::new(Timed::new(model, &clock)))
        },
    };
    let none = ObservationSet::new(problem.window.steps, Vec::new(), Vec::new())?;
    let observations = std::mem::replace(&mut problem.observations, none);
    let (solved, observations) = solve::solve(&mut task, observations, &mut on_row)?;
    // The posterior is not the minimization's.
    let minimizer = convergence.last().map_or(0.0, |row| row.seconds);
    let seconds = Seconds {
        total: 0.0,
        forward: clock.forward(),
        adjoint: clock.adjoint(),
        tangent: clock.tangent(),
        minimizer,
    };
    problem.observations = observations;
    if divided.refreshed > 0
        && let Some(steps) = &divided.steps
    {
        problem.make_model = steps.factory();
        problem.model = (problem.make_model)(0);
    }
    let accepted_steps = divided.account(&solved.control);
    problem.divided = divided.steps;
    problem.left_out.extend(problem.scene.limits.left_out(solved.storage, problem.window.steps));

    let status = Status::from(solved.minimum.status);
    let mut warnings = remarks(problem, &solved, status);
    warnings.extend(divided.warnings);
    let analysis = analysis(problem, &solved);
    let trajectories = trajectories(problem, &analysis.analysis, solved.states, &mut warnings);
    let amplification = amplification(problem, &analysis, &trajectories);
    warnings.extend(amplification.and_then(|a| a.warning()));
    let fit = fit::fit(&mut problem.observations, &trajectories)?;
    let (withheld, forecast) = match &mut problem.view {
        View::Rod(rod) => fit::beyond(rod, &problem.window, &trajectories, problem.model.as_mut())?,
        View::Components(_) => (Vec::new(), Vec::new()),
    };
    warnings.extend(fit::remarks(&fit, &analysis));
    let j_background = cost_of_run(problem, &trajectories)?;
    let [position_background, velocity_background] = errors(&analysis.background, truth.as_deref(), is_rod);
    let [position_analysis, velocity_analysis] = errors(&analysis.analysis, truth.as_deref(), is_rod);
    Ok(Outcome {
        status,
        has_posterior: solved.spread.is_some(),
        truth,
        j_background,
        gradient_norms: [solved.minimum.gradient_norm_first, solved.minimum.gradient_norm],
        iterations: [solved.minimum.outer_iterations, solved.minimum.inner_iterations],
        convergence,
        counts: solved.counts,
        rejected: rejected(problem, &solved.rejected),
        rmse: Rmse { position_background, position_analysis, velocity_background, velocity_analysis },
        seconds: Seconds { total: listener.started.elapsed().as_secs_f64(), ..seconds },
        fit,
        withheld,
        forecast,
        amplification,
        accepted_steps,
        trajectories,
        warnings,
        analysis,
    })
}

/// What the user should know of how a method went.
fn remarks(problem: &Problem, solved: &Solved, status: Status) -> Vec<String> {
    let minimum = &solved.minimum;
    let mut warnings: Vec<String> =
        problem.model.warnings().iter().map(|w| format!("step {}: {}", w.step, w.text)).collect();
    warnings.dedup();
    if !solved.rejected.is_empty() {
        let all = problem.observations.dim() + solved.rejected.len();
        warnings.push(format!(
            "the background check refused {} of {all} observed values (listed under `rejected` in summary.json)",
            solved.rejected.len()
        ));
    }
    for (steps, ended) in &solved.stages {
        if *ended != varda_assimilation::Status::Converged {
            warnings.push(format!("the sub-window of {steps} steps did not converge ({ended:?})"));
        }
    }
    if let Some(reason) = &solved.no_spread {
        warnings.push(format!("there is no posterior: {reason}"));
    }
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
    warnings
}

/// A solution as an analysis; where there is no posterior σ_a is that of the background and nothing was gained.
fn analysis(problem: &Problem, solved: &Solved) -> Analysis {
    let (minimum, m) = (&solved.minimum, problem.observations.dim());
    let sigma = solved.spread.as_ref().map(|s| &s.sigma);
    Analysis {
        background: problem.background.clone(),
        analysis: solved.control.clone(),
        sigma_background: solved.sigma_background.clone(),
        sigma_analysis: sigma.unwrap_or(&solved.sigma_background).clone(),
        value: minimum.value,
        terms: minimum.terms,
        observations: m,
        chi2: if m == 0 { 0.0 } else { 2.0 * minimum.value / m as f64 },
        degrees_of_freedom: solved.spread.as_ref().map_or(0.0, |s| s.degrees_of_freedom),
    }
}

/// ‖M‖ along the analysis up to the last observation, for methods whose gradient is an adjoint run along a trajectory of the model.
fn amplification(problem: &Problem, analysis: &Analysis, runs: &Trajectories) -> Option<Amplification> {
    if !problem.scene.algorithm.method.is_strong() {
        return None;
    }
    let steps = problem.observations.last_step().filter(|k| *k > 0)?;
    let states = runs.analysis.get(..(steps + 1) * runs.dim)?;
    let (sigma, seed) = (&analysis.sigma_background, problem.scene.seed);
    let mut model = (problem.make_model)(0);
    // What was run can be linearized; where it cannot there is nothing to say.
    amplification::amplification(model.as_mut(), &analysis.analysis, sigma, states, seed).ok()
}

/// The refused values, with their times.
fn rejected(problem: &Problem, all: &[varda_assimilation::Rejection]) -> Vec<Rejected> {
    let of = |r: &varda_assimilation::Rejection| Rejected {
        label: r.label.clone(),
        step: r.step,
        time: problem.window.time(r.step),
        departure: r.departure,
        expected: r.expected,
    };
    all.iter().map(of).collect()
}

/// J at the background, from its run: J_b and J_q are zero there. NaN where that run ended early.
fn cost_of_run(problem: &mut Problem, runs: &Trajectories) -> Result<f64, Error> {
    let delta = problem.scene.algorithm.robust.unwrap_or(f64::INFINITY);
    let d = fit::innovations(&mut problem.observations, runs, &runs.background)?;
    Ok(d.iter().zip(problem.observations.sigma()).map(|(d, sigma)| huber(delta, d / sigma).0).sum())
}

impl From<varda_assimilation::Status> for Status {
    fn from(status: varda_assimilation::Status) -> Self {
        use varda_assimilation::Status as S;
        match status {
            S::Converged => Status::Converged,
            S::MaxIterations => Status::MaxIterations,
            S::Stalled => Status::Stalled,
            S::Interrupted => Status::Interrupted,
            S::Failed => Status::Failed,
        }
    }
}

/// RMSE of positions and velocities (of a rod's [X, V], a vertex at a time), or of all components.
pub(crate) fn errors(control: &[f64], truth: Option<&[f64]>, is_rod: bool) -> [Option<f64>; 2] {
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

/// Runs of the window and its forecast; that of the analysis goes on from `states` where there are some. One that fails ends early,
/// with a warning.
fn trajectories(
    problem: &mut Problem,
    analysis: &[f64],
    mut states: Vec<f64>,
    warnings: &mut Vec<String>,
) -> Trajectories {
    let steps = problem.window.steps + problem.window.forecast;
    let model = problem.model.as_mut();
    let dim = model.dim();
    let mut x0 = vec![0.0; dim];
    let mut warn = |what: &str, result: Result<(), varda_implicit::Error>| {
        if let Err(e) = result {
            warnings.push(format!("the run of the {what} ends early: {e}"));
        }
    };
    let mut from = |control: &[f64], states: &mut Vec<f64>| {
        let start = model.initial_state(control, &mut x0);
        states.extend_from_slice(&x0);
        start.and_then(|()| run_on(model, states, steps))
    };
    let mut background = Vec::new();
    warn("background", from(&problem.background, &mut background));
    if states.is_empty() {
        warn("analysis", from(analysis, &mut states));
    } else {
        warn("analysis", run_on(model, &mut states, steps));
    }
    let mut truth = problem.truth.clone().unwrap_or_default();
    if !truth.is_empty() {
        let run = match &problem.make_truth {
            Some(make) => run_on(make(0).as_mut(), &mut truth, steps),
            None => run_on(model, &mut truth, steps),
        };
        warn("truth", run);
    }
    Trajectories { dim, background, analysis: states, truth }
}

/// Goes on from the last of `states` to step `steps`, or up to the step that fails.
pub(crate) fn run_on(
    model: &mut dyn Model,
    states: &mut Vec<f64>,
    steps: usize,
) -> Result<(), varda_implicit::Error> {
    let dim = model.dim();
    let mut next = vec![0.0; dim];
    for k in states.len() / dim - 1..steps {
        model.step(k, &states[k * dim..], &mut next)?;
        states.extend_from_slice(&next);
    }
    Ok(())
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
    if let (Some(_), Some(make)) = (&problem.truth, &problem.make_truth) {
        problem.model = make(0);
    }
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
    let counts = WorkCounts::of(model.counts());
    let warnings = model.warnings().iter().map(|w| format!("step {}: {}", w.step, w.text)).collect();
    let last = &states[steps * x0.len()..];
    let tip = match &mut problem.view {
        View::Rod(rod) => rod.vertices(&problem.window, steps, last)?.last().copied(),
        View::Components(_) => None,
    };
    Ok(Simulation { of, states, steps, counts, tip, warnings })
}
