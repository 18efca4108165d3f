//! One window: a problem assimilated, or run forward. A problem does not change; results are plain data.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use varda_assimilation::{Analysis, ObservationSet, Rejection, huber};
use varda_implicit::check::Amplification;
use varda_implicit::{Log, Model};
use varda_linalg::interrupt::{self, Ends};

use super::interrupted::{Asked, Lowest};
use super::second_minimum::Second;
use super::verdict::{self, Judged};
use super::{
    amplification, between_steps, considered, covariances, departures, estimates, fit, members, model_errors,
    second_minimum, shapes, shares, spread,
};
use crate::Error;
use crate::outcome::{
    AcceptedSteps, Attempt, ConvergenceRow, ExactHessian, Experiment, Failure, GroupRmse, Outcome, Rejected,
    Rmse, Seconds, SeenComponent, Status, Trajectories, WorkCounts,
};
use crate::scene::{Integrator, rounded};
use crate::setup::Problem;
use crate::setup::adaptive_steps::Refreshing;
use crate::setup::runs::{MakeModel, run_on};
use crate::solve::timed::{Clock, Timed};
use crate::solve::{self, Iterate, PosteriorSpread, Solution, Task};

/// Progress and cancellation callbacks of a run.
pub struct Listener<'a> {
    /// Called with every row of the convergence table.
    pub on_iteration: Box<dyn FnMut(&ConvergenceRow) + 'a>,
    /// Called after every iteration: true ends the run with the result so far.
    pub interrupted: Box<dyn Fn() -> bool + 'a>,
    /// Asked during long calculations, from any thread: true ends the run at once with the lowest point so
    /// far. `None`: only the seconds of `[limits]` end one.
    pub ends: Option<Ends>,
    /// When the run began; `seconds.total` counts from here.
    pub started: Instant,
}

impl Listener<'_> {
    /// A listener that does nothing; the run begins now.
    pub fn silent() -> Self {
        Listener {
            on_iteration: Box::new(|_| {}),
            interrupted: Box::new(|| false),
            ends: None,
            started: Instant::now(),
        }
    }

    /// A listener that says nothing and ends when this one does.
    pub(super) fn quiet(&self) -> Listener<'_> {
        Listener {
            on_iteration: Box::new(|_| {}),
            interrupted: Box::new(|| (self.interrupted)()),
            ends: self.ends.clone(),
            started: self.started,
        }
    }
}

/// One pass of [`assimilate`](super::assimilate): observations as the problem has them, σ of constants
/// without an allowance for the mesh and without remarks.
pub(super) fn assimilate(problem: &Problem, listener: &mut Listener) -> Result<Outcome, Error> {
    let experiment = &problem.experiment;
    let (scene, layout) = (&experiment.scene, &experiment.state);
    let truth = problem.truth.as_ref().map(|x| x[..problem.background.len()].to_vec());
    let errors = |control: &[f64]| truth.as_ref().map(|truth| layout.rms_difference(control, truth));

    let began = Instant::now();
    let mut convergence: Vec<ConvergenceRow> = Vec::new();
    let mut late = false;
    let asked = Asked::of(listener.ends.clone(), &scene.limits, listener.started);
    let lowest = Lowest::default();
    let observations = problem.observations()?;
    let reserve = second_minimum::Reserve::of(problem, &observations);
    let mut on_iterate = |r: &Iterate| {
        if asked.requested() {
            // what was computed since it was asked to end is not to be believed
            return ControlFlow::Break(());
        }
        lowest.add(r);
        asked.begin();
        let row = row(r, began, errors(r.control).unwrap_or_default(), layout.constants.len());
        (listener.on_iteration)(&row);
        convergence.push(row);
        late = late || scene.limits.over(listener.started.elapsed());
        if reserve.ends(r.before.0 + r.iteration.index, r.iteration.value, r.control) {
            return ControlFlow::Break(());
        }
        if late || (listener.interrupted)() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let clock = Clock::default();
    let mut refreshing = problem.adaptive_steps.as_ref().map(Refreshing::new);
    let mut model = problem.model();
    let mut timed = Timed::new(model.as_mut(), &clock);
    let make_timed = || -> Box<dyn Model + Send> { Box::new(Timed::new(problem.model(), &clock)) };
    let mut task = Task {
        algorithm: scene.algorithm.clone(),
        model: &mut timed,
        make_model: &make_timed,
        background: &problem.background,
        covariance: &problem.covariance,
        model_error: problem.model_error.as_ref(),
        ensemble: problem.ensemble.as_ref(),
        anchors: &problem.anchors,
        constants: problem.single_constants(),
        posterior: scene.report.posterior,
        members: scene.output.is_more_than_csv(),
        memory: problem.memory,
        refresh: &mut |control| {
            let model = refreshing.as_mut()?.refresh(control)?;
            Some(Box::new(Timed::new(model, &clock)))
        },
    };
    let solved = interrupt::within(asked.ends(), || {
        let (solution, observations) = solve::solve(&mut task, observations, &mut on_iterate)?;
        second_minimum::look(problem, &mut task, solution, observations, &reserve, &mut on_iterate)
    });
    let ended_early = asked.was_told();
    late = late || (ended_early && scene.limits.over(listener.started.elapsed()));
    let left = if ended_early { lowest.solution(problem) } else { None };
    let (solution, observations, second) = match left {
        Some(solution) => (solution, problem.observations()?, None),
        None => solved?,
    };
    let log = timed.log().clone();
    let seconds = seconds_so_far([listener.started, began], &convergence, &clock);
    let refreshed_models = refreshing.as_ref().and_then(Refreshing::refreshed_models);
    if let Some(make_model) = &refreshed_models {
        model = make_model(0);
    }
    let (accepted_steps, remarks_on_steps) = match refreshing {
        Some(refreshing) => {
            let (steps, remarks) = refreshing.finish(&solution.control);
            (Some(steps), remarks)
        }
        None => (None, Vec::new()),
    };
    let ended = Ended {
        solution,
        observations,
        second,
        convergence,
        seconds,
        log,
        late,
        early: ended_early,
        model,
        models: refreshed_models,
        accepted_steps,
        remarks_on_steps,
        is_one_of_several: false,
    };
    described(problem, ended, listener)
}

/// How the minimization of one window ended.
pub(super) struct Ended {
    pub(super) solution: Solution,
    pub(super) observations: ObservationSet,
    pub(super) second: Option<Second>,
    pub(super) convergence: Vec<ConvergenceRow>,
    /// Up to the posterior.
    pub(super) seconds: Seconds,
    pub(super) log: Log,
    pub(super) late: bool,
    /// Told to end in the middle of a calculation.
    pub(super) early: bool,
    pub(super) model: Box<dyn Model + Send>,
    /// What makes models, where that is not the problem's any more.
    pub(super) models: Option<MakeModel>,
    pub(super) accepted_steps: Option<AcceptedSteps>,
    pub(super) remarks_on_steps: Vec<String>,
    /// J and its prior of constants are shared with other recordings.
    pub(super) is_one_of_several: bool,
}

/// An iterate as a row of the convergence table of a run that began then; so many numbers at the end of the
/// control are constants.
pub(super) fn row(r: &Iterate, began: Instant, rmse: Vec<f64>, constants: usize) -> ConvergenceRow {
    let i = r.iteration;
    ConvergenceRow {
        iteration: r.before.0 + i.index,
        seconds: began.elapsed().as_secs_f64(),
        j: i.value,
        j_b: i.terms.background,
        j_o: i.terms.observation,
        j_q: i.terms.model_error,
        gradient_norm: i.gradient_norm,
        gradient_goal: i.gradient_goal,
        attempt: i.attempt,
        attempts: i.attempts,
        rmse,
        constants: r.control[r.control.len() - constants..].to_vec(),
        sigma_factor: i.observation_scale,
        hessian: i.hessian.map(|h| h.name()),
        window: r.window,
        counts: r.before.1 + WorkCounts::from(&i.counts),
    }
}

/// All that a report needs of a window whose minimization has ended.
///
/// # Errors
/// As for [`assimilate`](super::assimilate).
pub(super) fn described(problem: &Problem, ended: Ended, listener: &Listener) -> Result<Outcome, Error> {
    let began = Instant::now();
    let experiment = &problem.experiment;
    let (scene, layout, grid) = (&experiment.scene, &experiment.state, &experiment.grid);
    let truth = problem.truth.as_ref().map(|x| x[..problem.background.len()].to_vec());
    let errors = |control: &[f64]| truth.as_ref().map(|truth| layout.rms_difference(control, truth));
    let Ended { solution, mut observations, second, convergence, seconds, mut log, late, .. } = ended;
    let (ended_early, mut model) = (ended.early, ended.model);
    let make_model = ended.models.as_ref().unwrap_or(&problem.make_model);
    let mut left_out = experiment.left_out.clone();
    left_out.extend(scene.limits.left_out(solution.storage, grid.steps));

    let status = Status::from(solution.minimum.status);
    let failure = failure(&solution, status);
    let late = late && status == Status::Interrupted;
    let mut warnings = remarks(experiment, &log, &solution, status, observations.dim(), failure.as_ref());
    warnings.extend(late.then(|| scene.limits.remark()).flatten());
    warnings.extend(ended.remarks_on_steps);
    let analysis = analysis(problem, &solution, observations.dim());
    let errors_of_model = solution.model_errors;
    warnings.extend(model_errors::remark(scene, errors_of_model.as_ref(), analysis.terms.model_error));
    let trajectories =
        trajectories(problem, model.as_mut(), &analysis.analysis, solution.states, &mut warnings, &mut log);
    let amplification = match ended_early {
        true => None,
        false => amplification(problem, make_model, &analysis, &observations, &trajectories),
    };
    warnings.extend(amplification.and_then(|a| a.warning()));
    observations.follow(model.rate());
    let mut fit = fit::fit(&problem.observed, &mut observations, &trajectories)?;
    let (withheld, forecast) = fit::beyond(problem, &trajectories, model.as_mut())?;
    let departures = fit::departures(problem, &mut observations, &trajectories)?;
    let evidence =
        departures::evidence(&departures.values, &departures.labels, departures.surroundings.as_ref());
    let judgement = verdict::judge(&Judged {
        status,
        late,
        is_ensemble: scene.algorithm.method.is_ensemble(),
        at_rest: scene.time.integrator == Integrator::QuasiStatic,
        may_grow: scene.algorithm.method.takes_window_growth() && scene.algorithm.window_growth.is_empty(),
        iterations: solution.minimum.outer_iterations,
        max_iterations: scene.algorithm.max_iterations,
        gradient_norms: [solution.minimum.gradient_norm_first, solution.minimum.gradient_norm],
        j: analysis.value,
        observed: analysis.observations,
        robust: scene.algorithm.robust,
        departures: &departures.values,
        labels: &departures.labels,
        cameras: &departures.cameras,
        evidence: evidence.as_ref(),
        second_minimum: second.as_ref(),
    });
    warnings.extend(between_steps::remark(problem, &observations, &trajectories)?);
    let j_background = cost_of_run(scene.algorithm.robust, &mut observations, &trajectories)?;
    let rmse = rmse(experiment, errors(&analysis.background), errors(&analysis.analysis));
    let mut shapes = shapes::with_observations(problem, &trajectories)?;
    let rejected = rejected(experiment, &solution.rejected);
    let root = solution.spread.as_ref().map_or(&[][..], |spread| &spread.root);
    let estimates = estimates::estimated(problem, &analysis, solution.spread.as_ref());
    let shares = match ended.is_one_of_several {
        true => shares::of_one_of_several(
            &analysis,
            solution.spread.is_some() && scene.algorithm.robust.is_none(),
        ),
        false => {
            shares::shares(problem, &analysis, errors_of_model.as_ref(), solution.spread.is_some(), root)?
        }
    };
    let posterior = solution.spread.as_ref();
    // Ctrl-C leaves out what goes beyond the analysis; the seconds of `[limits]` do not.
    let leave: Ends = listener.ends.clone().unwrap_or_else(|| Arc::new(|| false));
    let (spread, left) = interrupt::within(leave, || {
        let spread = spread::along(
            problem,
            make_model(0).as_mut(),
            (&analysis.analysis, posterior),
            &trajectories,
            &rejected,
            ended.is_one_of_several,
        );
        (spread, interrupt::was_told())
    });
    let remark = "interrupted after the analysis: σ after the start of the window is left out";
    warnings.extend((left && !ended_early).then(|| remark.to_string()));
    let mut spread = spread?;
    if let (Some(shapes), Some(spread)) = (&mut shapes, &mut spread) {
        shapes.sigma_forces = std::mem::take(&mut spread.forces);
    }
    let known = considered::Known {
        control: &analysis.analysis,
        rejected: &solution.rejected.iter().map(|r| r.row).collect::<Vec<_>>(),
        sigma_states: spread.as_ref().map_or(&[], |s| &s.states),
        sigma_forces: shapes.as_ref().map_or(&[], |s| &s.sigma_forces),
        estimates: &estimates,
    };
    let considered = match status.is_settled() && !ended_early {
        true => considered::considered(problem, &known),
        false => Ok(Vec::new()),
    };
    let considered = considered.unwrap_or_else(|reason| {
        warnings.push(format!("what [consider] does is left out: {reason}"));
        Vec::new()
    });
    let observed =
        spread::observed_values(problem, model.as_ref(), &trajectories, spread.as_ref(), &rejected)?;
    if scene.observations.correlation().is_none() {
        fit::add_information(&mut fit, &observed);
    }
    Ok(Outcome {
        experiment: Experiment { left_out, ..experiment.clone() },
        status,
        judgement,
        late,
        attempts: solution.attempts.iter().map(Attempt::from).collect(),
        failure,
        has_posterior: solution.spread.is_some(),
        considered,
        exact_hessian: solution.exact_hessian,
        covariances: covariances::covariances(layout, problem.covariance.as_ref(), posterior),
        members: members::of_window(problem, make_model, posterior),
        truth,
        j_background,
        gradient_norms: [solution.minimum.gradient_norm_first, solution.minimum.gradient_norm],
        iterations: [solution.minimum.outer_iterations, solution.minimum.inner_iterations],
        convergence,
        counts: solution.counts,
        model_counts: log.counts,
        rejected,
        with_constants_known: spread.as_mut().map_or_else(Vec::new, |s| std::mem::take(&mut s.known)),
        shares,
        next_observation: spread.as_mut().and_then(|spread| spread.next.take()),
        sensitivities: spread.as_mut().map_or_else(Vec::new, |s| std::mem::take(&mut s.sources.1)),
        sources: spread.as_mut().map_or_else(Vec::new, |s| std::mem::take(&mut s.sources.0)),
        sigma_states: spread.map_or_else(Vec::new, |spread| spread.states),
        observed,
        rmse,
        estimates,
        seconds: Seconds {
            total: listener.started.elapsed().as_secs_f64(),
            diagnostics: began.elapsed().as_secs_f64(),
            ..seconds
        },
        fit,
        evidence,
        withheld,
        forecast,
        amplification,
        model_errors: errors_of_model,
        accepted_steps: ended.accepted_steps,
        seen: if shapes.is_none() { seen(problem, &observations) } else { Vec::new() },
        trajectories,
        shapes,
        warnings,
        analysis,
    })
}

/// What the model refused during the minimization, as data.
fn failure(solution: &Solution, status: Status) -> Option<Failure> {
    let reason = solution.minimum.failure.as_ref()?.to_string();
    Some(match status {
        Status::Failed => Failure::Ended { reason },
        _ => Failure::TrialRefused { reason },
    })
}

/// Remarks on how the minimization went.
fn remarks(
    experiment: &Experiment,
    log: &Log,
    solution: &Solution,
    status: Status,
    used: usize,
    failure: Option<&Failure>,
) -> Vec<String> {
    let mut warnings: Vec<String> = merged(log).into_iter().collect();
    if !solution.rejected.is_empty() {
        let all = used + solution.rejected.len();
        warnings.push(format!(
            "the background check refused {} of {all} observed values: {} (all are listed under `rejected` \
             in summary.json)",
            solution.rejected.len(),
            first_sightings(experiment, &solution.rejected)
        ));
    }
    for (steps, ended) in &solution.stages {
        if *ended != varda_assimilation::Status::Converged {
            warnings.push(format!("the sub-window of {steps} steps did not converge ({ended:?})"));
        }
    }
    if solution.minimum.started_beside {
        warnings.push(
            "zero gradient at the background, which is no minimum: J falls beside it, and the minimization \
             started there; which of several minima it came to is chance"
                .into(),
        );
    }
    if let Some(reason) = &solution.no_spread {
        warnings.push(format!("there is no posterior: {reason}"));
    }
    warnings.extend(solution.exact_hessian.iter().flat_map(ExactHessian::remarks));
    warnings.extend(solution.spread.as_ref().and_then(PosteriorSpread::remark));
    warnings.extend(failure.map(Failure::to_string));
    match status {
        Status::LinearizedOnce => warnings.push(
            "linearized once, and J of the run from the analysis is not that of the quadratic: it is lower \
             than the background's, and no minimum"
                .into(),
        ),
        Status::Interrupted => {
            warnings.push("interrupted: the result is the lowest point so far, without posterior".into());
        }
        Status::Converged | Status::MaxIterations | Status::Stalled | Status::Failed => {}
    }
    warnings
}

/// Seconds of a run that started, and began to minimize, at these times and has its posterior now, whose time
/// does not belong to the minimization.
pub(super) fn seconds_so_far(
    [started, began]: [Instant; 2],
    convergence: &[ConvergenceRow],
    clock: &Clock,
) -> Seconds {
    let minimizer = convergence.last().map_or(0.0, |row| row.seconds);
    Seconds {
        set_up: began.duration_since(started).as_secs_f64(),
        minimizer,
        posterior: began.elapsed().as_secs_f64() - minimizer,
        forward: clock.forward(),
        adjoint: clock.adjoint(),
        tangent: clock.tangent(),
        ..Seconds::default()
    }
}

/// The remarks of the model's solver in one line.
pub(super) fn merged(log: &Log) -> Option<String> {
    let first = log.warnings.first()?;
    let first_text = format!("step {}: {}", first.step, first.text);
    let others = log.warnings.iter().filter(|w| (w.step, &w.text) != (first.step, &first.text)).count();
    if others == 0 {
        return Some(first_text);
    }
    let steps = log.warnings.iter().map(|w| w.step);
    let (low, high) = (steps.clone().min().unwrap_or(0), steps.max().unwrap_or(0));
    Some(format!("{} remarks of the solver on steps {low} to {high}, the first: {first_text}", others + 1))
}

/// The first refused sightings by name and time.
fn first_sightings(experiment: &Experiment, rejected: &[Rejection]) -> String {
    const SHOWN: usize = 5;
    let mut sightings: Vec<&Rejection> = rejected.iter().collect();
    sightings.dedup_by_key(|r| r.observation);
    let named: Vec<String> = sightings
        .iter()
        .take(SHOWN)
        .map(|r| format!("{} at {} s ({:.1} σ)", r.label, rounded(experiment.grid.time(r.step)), r.distance))
        .collect();
    let more = sightings.len().saturating_sub(SHOWN);
    if more > 0 { format!("{} and {more} others", named.join(", ")) } else { named.join(", ") }
}

/// A solution as an analysis of `m` observed values; without a posterior σ_a is that of the background and
/// nothing was gained.
fn analysis(problem: &Problem, solution: &Solution, m: usize) -> Analysis {
    let minimum = &solution.minimum;
    let sigma = solution.spread.as_ref().map(|s| &s.sigma);
    Analysis {
        background: problem.background.clone(),
        analysis: solution.control.clone(),
        sigma_background: solution.sigma_background.clone(),
        sigma_analysis: sigma.unwrap_or(&solution.sigma_background).clone(),
        value: minimum.value,
        terms: minimum.terms,
        observations: m,
        chi2: if m == 0 { 0.0 } else { 2.0 * minimum.value / m as f64 },
        degrees_of_freedom: solution.spread.as_ref().map_or(0.0, |s| s.degrees_of_freedom),
    }
}

/// ‖M‖ along the analysis up to the last observation, for methods whose gradient is an adjoint run along
/// a trajectory of the model.
fn amplification(
    problem: &Problem,
    make_model: &MakeModel,
    analysis: &Analysis,
    observations: &ObservationSet,
    runs: &Trajectories,
) -> Option<Amplification> {
    let scene = &problem.experiment.scene;
    if !scene.algorithm.method.is_strong() {
        return None;
    }
    let steps = observations.last_step().filter(|k| *k > 0)?;
    let states = runs.analysis.get(..(steps + 1) * runs.dim)?;
    let mut model = make_model(0);
    let sigma = &analysis.sigma_background;
    amplification::estimate(model.as_mut(), &analysis.analysis, sigma, states, scene.seed)
}

/// The refused values, with their times.
fn rejected(experiment: &Experiment, all: &[Rejection]) -> Vec<Rejected> {
    let of = |r: &Rejection| Rejected {
        label: r.label.clone(),
        step: r.step,
        time: experiment.grid.time(r.step),
        departure: r.departure,
        expected: r.expected,
        distance: r.distance,
    };
    all.iter().map(of).collect()
}

fn rmse(experiment: &Experiment, background: Option<Vec<f64>>, analysis: Option<Vec<f64>>) -> Rmse {
    let of = |errors: &Option<Vec<f64>>, i: usize| errors.as_ref().map(|e| e[i]);
    let groups = experiment.state.groups.iter().enumerate();
    Rmse(
        groups
            .map(|(i, g)| GroupRmse {
                group: g.name,
                background: of(&background, i),
                analysis: of(&analysis, i),
            })
            .collect(),
    )
}

/// J at the background, from its run: J_b and J_q are zero there. NaN where that run ended early.
fn cost_of_run(
    robust: Option<f64>,
    observations: &mut ObservationSet,
    runs: &Trajectories,
) -> Result<f64, Error> {
    let delta = robust.unwrap_or(f64::INFINITY);
    let mut d = fit::innovations(observations, runs, &runs.background)?;
    observations.whiten(&mut d);
    Ok(d.iter().map(|d| huber(delta, *d).0).sum())
}

/// The components that were observed, value by value.
fn seen(problem: &Problem, observations: &ObservationSet) -> Vec<SeenComponent> {
    let time = |step| problem.experiment.grid.time(step);
    let values = |o: &varda_assimilation::Observation| {
        let pairs: Vec<_> = o.rows.iter().zip(&o.values).map(|(row, value)| (*row, *value)).collect();
        let (anchors, time) = (&problem.anchors, time(o.step));
        pairs.into_iter().map(move |(row, value)| SeenComponent { component: anchors[row], time, value })
    };
    observations.observations().iter().flat_map(values).collect()
}

/// Runs of the window and its forecast; that of the analysis continues from `states` where there are some. A
/// run that fails ends early, with a warning.
fn trajectories(
    problem: &Problem,
    model: &mut dyn Model,
    analysis: &[f64],
    mut states: Vec<f64>,
    warnings: &mut Vec<String>,
    log: &mut Log,
) -> Trajectories {
    let steps = problem.experiment.grid.last_step();
    let dim = model.dim();
    let mut x0 = vec![0.0; dim];
    let mut warn = |what: &str, result: Result<Log, varda_implicit::Error>| match result {
        Ok(run) => log.add(&run),
        Err(e) => warnings.push(format!("the run of the {what} ends early: {e}")),
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
