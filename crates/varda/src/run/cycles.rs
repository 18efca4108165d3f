//! Cycling: a scene with `[algorithm.cycles]`, window after window.
//!
//! The windows are cut out of one long [`Problem`](crate::setup::Problem), whose only window is the whole
//! sequence: one run of the truth, one draw of observations in the order of time, one recording read. So
//! more cycles do not change the first ones.

use std::cell::{Cell, RefCell};
use std::ops::ControlFlow;
use std::rc::Rc;
use std::time::Instant;

use rand_distr::{Distribution, StandardNormal};
use varda_assimilation::{
    Cycle, CyclePosterior, CycleState, CycledCovariance, CycledEnsemble, CycledErrors, CycledEstimate,
    CycledInflation, CycledMinimizer, CycledUpdate, Cycling, Departures, EnVarOptions, Normals,
    ObservationSet, cycle,
};
use varda_implicit::check::Amplification;
use varda_linalg::interrupt;

use super::cycle_runs::{Everything, Runs};
pub use super::sequence::Sequence;
use super::{amplification, cycle_checks, members, shapes, verdict};
use crate::Error;
use crate::outcome::{
    CycleDepartures, CycleRow, CycleSigma, CyclesOutcome, Experiment, Means, Status, Trajectories, WorkCounts,
};
use crate::scene::{self, TimeGrid};
use crate::setup::ensemble;
use crate::setup::random::{Stream, stream_of_window};
use crate::solve::minimizer;

/// Progress and cancellation callbacks of a sequence.
pub struct CycleListener<'a> {
    /// Called after every window, with the start of the next one.
    pub on_cycle: Box<dyn FnMut(&CycleRow, &CycleState) -> Result<(), Error> + 'a>,
    /// Called after every window: true ends the run with the result so far.
    pub interrupted: Box<dyn Fn() -> bool + 'a>,
    /// When the run began.
    pub started: Instant,
}

impl CycleListener<'_> {
    /// A listener that does nothing; the run begins now.
    pub fn silent() -> Self {
        CycleListener {
            on_cycle: Box::new(|_, _| Ok(())),
            interrupted: Box::new(|| false),
            started: Instant::now(),
        }
    }
}

impl Sequence {
    /// The state before the first window: the background, and the members of an ensemble about it, their
    /// mean.
    pub fn start(&self) -> CycleState {
        let background = self.problem.background.clone();
        let Some(ensemble) = &self.problem.ensemble else { return CycleState::new(background) };
        let size = ((ensemble.members() - 1) as f64).sqrt();
        let mut x = vec![0.0; background.len()];
        let mut columns = Vec::with_capacity(ensemble.members() * x.len());
        for i in 0..ensemble.members() {
            ensemble.perturbation(i, &mut x);
            columns.extend(background.iter().zip(&x).map(|(b, x)| b + size * x));
        }
        CycleState { next: 0, background, columns }
    }

    /// Assimilates window after window: from the state [`start`](Self::start), with no `done` rows, or from
    /// the state that a sequence left behind after the rows `done`.
    ///
    /// # Errors
    /// [`Error::Assimilation`] where the first window cannot be assimilated; an error of `on_cycle`. A later
    /// window that fails ends the sequence as [`Status::Failed`] with the windows before it.
    pub fn run(
        &self,
        mut state: CycleState,
        done: Vec<CycleRow>,
        listener: &mut CycleListener,
    ) -> Result<CyclesOutcome, Error> {
        let mut rows = done;
        let (mut refused, mut interrupted, mut late) = (None, false, false);
        let mut members = None;
        let limits = &self.problem.experiment.scene.limits;
        let mut began = Instant::now();
        let end_angle = Cell::new(rows.last().and_then(|row| row.next_end_angle));
        let make_model = |first: usize| self.model_of(first, end_angle.get());
        let operators = [Rc::new(RefCell::new((self.problem.observed.make_operator)()?))];
        let observations = |first: usize| self.of_window(&operators, first);
        let anchors = |set: &ObservationSet| ensemble::anchors(set, &self.problem.anchors);
        let algorithm = &self.problem.experiment.scene.algorithm;
        let seed = self.problem.experiment.scene.seed;
        let normals = |c: usize| -> Normals {
            let mut rng = stream_of_window(seed, Stream::Ensemble, c);
            Box::new(move || StandardNormal.sample(&mut rng))
        };
        let turns = |c: usize| -> Normals {
            let mut rng = stream_of_window(seed, Stream::Rotations, c);
            Box::new(move || StandardNormal.sample(&mut rng))
        };
        let b = self.problem.covariance.as_ref();
        let covariance = match (self.cycles.covariance_of(algorithm.method), &self.problem.ensemble) {
            (scene::CycledCovariance::Propagated, _) => {
                let static_part = self.cycles.static_weight.filter(|w| *w > 0.0).map(|weight| (b, weight));
                let inflation = self.cycles.inflation.and_then(scene::Inflation::factor).unwrap_or(1.0);
                let dropped = self.cycles.dropped_variance.unwrap_or(1e-8);
                CycledCovariance::Propagated { first: b, inflation, static_part, dropped }
            }
            (scene::CycledCovariance::Ensemble, Some(members)) => {
                let ensemble = algorithm.members().unwrap_or_default();
                let hybrid = algorithm.method == scene::Method::HybridFourDEnVar;
                let [beta_s, beta_e] = ensemble.weights();
                // As without cycles, a hybrid is linearized once.
                let max_outer = if hybrid { 1 } else { algorithm.max_iterations };
                CycledCovariance::Ensemble(CycledEnsemble {
                    inflation: match self.cycles.inflation {
                        Some(scene::Inflation::Found(_)) => CycledInflation::FiniteSize,
                        _ => CycledInflation::Fixed(ensemble.inflation),
                    },
                    spread: self.cycles.spread.unwrap_or(1.0),
                    rotation: self.cycles.rotation.unwrap_or(false).then_some(&turns),
                    localization: members.localization().clone(),
                    anchors: &anchors,
                    static_part: hybrid.then_some((b, beta_s, beta_e)),
                    update: match self.cycles.update.unwrap_or_default() {
                        scene::EnsembleUpdate::SquareRoot => CycledUpdate::SquareRoot,
                        scene::EnsembleUpdate::PerturbedObservations => {
                            CycledUpdate::PerturbedObservations(&normals)
                        }
                    },
                    // A step of 0.05 standard deviations is below what members resolve.
                    options: EnVarOptions::default().with_max_outer(max_outer).with_step_tolerance(0.05),
                })
            }
            _ => CycledCovariance::Static(b),
        };
        let drawn_errors = |c: usize| -> Normals {
            let mut rng = stream_of_window(seed, Stream::ModelErrors, c);
            Box::new(move || StandardNormal.sample(&mut rng))
        };
        let forcing = self.forcing();
        let model_error = self.problem.model_error.as_ref().map(|q| CycledErrors {
            q: q.as_ref(),
            forcing: &forcing,
            estimated: match (algorithm.method, self.problem.covariance.precision(), q.precision()) {
                (scene::Method::WeakState, Some(b), Some(q)) => CycledEstimate::States { b, q },
                (scene::Method::WeakForcing, ..) => CycledEstimate::Forcing,
                _ => CycledEstimate::No,
            },
            normals: &drawn_errors,
        });
        let cycling = Cycling {
            first: 0,
            window: self.window,
            shift: self.shift,
            cycles: self.cycles.count,
            make_model: &make_model,
            observations: &observations,
            truth: None,
            model_error,
            posterior: self.has_sigma(),
        };
        let everything = Everything::of(&self.problem)?;
        let mut on_cycle = |cycle: &Cycle, after: &CycleState| {
            let mut row = self.row(cycle);
            if self.has_sigma() && !interrupt::was_told() {
                if let Some(CyclePosterior::Members(runs)) = &cycle.posterior
                    && self.problem.experiment.scene.output.is_more_than_csv()
                {
                    let (n, steps) = (self.problem.experiment.n_state, [self.steps(), self.window]);
                    members = Some(members::of_cycle(runs, n, row.first_step, steps));
                }
                row.sigma = self.sigma_along(&row, cycle.posterior.as_ref(), end_angle.get(), &everything);
            }
            if interrupt::was_told() {
                // what it was told in is left half done
                interrupted = true;
                if rows.is_empty() {
                    refused = Some(varda_assimilation::Error::from(varda_linalg::Error::Interrupted).into());
                }
                return ControlFlow::Break(());
            }
            row.seconds = began.elapsed().as_secs_f64();
            row.next_end_angle = self.next_end_angle(&row, end_angle.get());
            end_angle.set(row.next_end_angle);
            let told = (listener.on_cycle)(&row, after);
            if let Some(before) = rows.last_mut() {
                // from here on the sequence shows the later window
                before.sigma.states.truncate(self.shift * self.problem.experiment.n_state);
            }
            rows.push(row);
            let more = after.next < self.cycles.count;
            late = more && limits.over(listener.started.elapsed());
            interrupted = late || (more && (listener.interrupted)());
            began = Instant::now();
            match told {
                Ok(()) if !interrupted => ControlFlow::Continue(()),
                Ok(()) => ControlFlow::Break(()),
                Err(error) => {
                    refused = Some(error);
                    ControlFlow::Break(())
                }
            }
        };
        let (minimizer, outer) = (minimizer::minimizer(algorithm), minimizer::outer_of(algorithm));
        let minimizer = outer.as_ref().map_or(CycledMinimizer::from(&minimizer), CycledMinimizer::from);
        let ended = cycle(&cycling, &mut state, &covariance, minimizer, &mut on_cycle);
        if let Some(error) = refused {
            return Err(error);
        }
        let (mut warnings, mut failure) = (Vec::new(), None);
        let mut status =
            rows.iter().map(|r| r.status).max_by_key(|s| severity(*s)).unwrap_or(Status::Converged);
        // in a long calculation of a window
        let left = ended.is_err() && !rows.is_empty() && interrupt::requested();
        interrupted = interrupted || left;
        if let (Err(error), false) = (ended, left) {
            if rows.is_empty() {
                return Err(error.into());
            }
            let reason = format!("cycle {} could not be done: {error}", state.next);
            failure = Some(reason.clone());
            warnings.push(reason);
            status = Status::Failed;
        } else if interrupted {
            warnings.push(format!("interrupted after {} of {} cycles", rows.len(), self.cycles.count));
            warnings.extend(late.then(|| limits.remark()).flatten());
            status = Status::Interrupted;
        }
        let of = |s: Status| rows.iter().filter(|r| r.status == s).count();
        for (s, what) in [
            (Status::LinearizedOnce, "linearized J once where it is not quadratic"),
            (Status::MaxIterations, "ended out of iterations"),
            (Status::Stalled, "stalled before the tolerance was met"),
            (Status::Failed, "failed"),
        ] {
            if of(s) > 0 {
                let remark = format!("{} of {} minimizations {what}", of(s), rows.len());
                if s == Status::Failed {
                    failure.get_or_insert_with(|| remark.clone());
                }
                warnings.push(remark);
            }
        }
        let [inside, between] = self.values();
        if between > 0 {
            warnings.push(format!(
                "{between} of {} observed values lie between two windows and are not used (cycles.shift, \
                 time.window, or times off the steps)",
                inside + between
            ));
        }
        let groups = self.problem.experiment.state.groups.len();
        let means = means(&rows, self.cycles.spin_up, groups);
        let inflation = means.inflation.unwrap_or(1.0);
        let carried = self.cycles.covariance_of(algorithm.method);
        warnings.extend(cycle_checks::remarks(&rows, &means, carried, inflation));
        if means.count == 0 {
            warnings.push("all cycles done are spin-up: there are no means".into());
        }
        let counted: Vec<&CycleRow> =
            rows.iter().skip(if means.count == 0 { 0 } else { self.cycles.spin_up }).collect();
        let unfinished = (status == Status::Interrupted).then_some(self.cycles.count);
        let judgement = verdict::judge_windows(&counted, unfinished, algorithm.method.is_ensemble(), late);
        let Runs { trajectories, sigma_states, observed } = self.runs(&rows, &everything, &mut warnings)?;
        let amplification = self.amplification(&rows, &trajectories);
        warnings.extend(amplification.and_then(|a| a.warning()));
        let experiment = &self.problem.experiment;
        // The grid of the windows that were done, which may be fewer than were asked for.
        let steps = rows.last().map_or(0, |r| r.first_step + self.window);
        Ok(CyclesOutcome {
            experiment: Experiment { grid: TimeGrid { steps, ..experiment.grid }, ..experiment.clone() },
            status,
            judgement,
            late,
            failure: failure.filter(|_| status == Status::Failed),
            asked_for: self.cycles.count,
            window: self.window,
            shift: self.shift,
            covariance: self.cycles.covariance_of(algorithm.method).name(),
            spin_up: self.cycles.spin_up,
            shapes: shapes::vertices(&self.problem, &trajectories)?,
            cycles: rows,
            trajectories,
            sigma_states,
            members,
            observed,
            means,
            seconds: listener.started.elapsed().as_secs_f64(),
            amplification,
            warnings,
        })
    }

    fn row(&self, c: &Cycle) -> CycleRow {
        let layout = &self.problem.experiment.state;
        let rmse = |x: &[f64], k: usize| {
            self.true_state(k).map_or(Vec::new(), |truth| layout.rms_difference(x, truth))
        };
        let spread = |sigma: &Vec<f64>| layout.rms_difference(sigma, &vec![0.0; sigma.len()]);
        CycleRow {
            cycle: c.index,
            first_step: c.first_step,
            time: self.problem.experiment.grid.time(c.first_step),
            j: c.value,
            j_b: c.terms.background,
            j_o: c.terms.observation,
            j_q: c.terms.model_error,
            observations: c.observations,
            chi2: c.chi2,
            status: c.status.into(),
            failure: c.failure.clone(),
            outer_iterations: c.outer_iterations,
            counts: WorkCounts::from(&c.counts),
            spread: c.sigma.as_ref().map_or(Vec::new(), spread),
            increment: layout.rms_difference(&c.analysis, &c.background),
            rmse_background: rmse(&c.background, c.first_step),
            rmse_start: rmse(&c.analysis, c.first_step),
            rmse_end: rmse(&c.end, c.first_step + self.window),
            departures: c.departures.map(CycleDepartures::from),
            inflation: c.inflation,
            drawn_again: c.drawn_again,
            columns: c.columns,
            dropped: c.dropped,
            seconds: 0.0,
            sigma: CycleSigma::default(),
            background: c.background.clone(),
            analysis: c.analysis.clone(),
            model_errors: c.model_errors.clone(),
            next_end_angle: None,
        }
    }

    /// Where a window leaves the end clamp at the start of the next one: its places do not say whole turns.
    fn next_end_angle(&self, row: &CycleRow, before: Option<f64>) -> Option<f64> {
        let rod = self.problem.system.rod().filter(|rod| rod.has_end_angle())?;
        let states = self.states_of(row, before, self.shift).ok()?;
        rod.end_angle(&states[states.len() / (self.shift + 1) * self.shift..]).ok()?
    }

    /// ‖M‖ of the last window about its analysis, for methods that have a gradient along a run.
    fn amplification(&self, rows: &[CycleRow], runs: &Trajectories) -> Option<Amplification> {
        let scene = &self.problem.experiment.scene;
        let last = rows.last().filter(|_| scene.algorithm.method.is_strong() && self.window > 0)?;
        let [from, to] = [last.first_step, last.first_step + self.window + 1].map(|k| k * runs.dim);
        let states = runs.analysis.get(from..to)?;
        let before = rows.len().checked_sub(2).and_then(|i| rows[i].next_end_angle);
        let mut model = self.model_of(last.first_step, before);
        let b = self.problem.covariance.as_ref();
        let mut sigma = vec![0.0; b.dim()];
        b.variance(&mut sigma);
        sigma.iter_mut().for_each(|s| *s = s.sqrt());
        amplification::estimate(model.as_mut(), &last.analysis, &sigma, states, scene.seed)
    }
}

/// Higher for worse ends.
fn severity(status: Status) -> usize {
    match status {
        Status::Converged => 0,
        Status::LinearizedOnce => 1,
        Status::MaxIterations => 2,
        Status::Stalled => 3,
        Status::Interrupted => 4,
        Status::Failed => 5,
    }
}

fn means(rows: &[CycleRow], spin_up: usize, groups: usize) -> Means {
    let counted: Vec<&CycleRow> = rows.iter().filter(|r| r.cycle >= spin_up).collect();
    let mean =
        |values: Vec<f64>| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
    let of_groups = |of: &dyn Fn(&CycleRow) -> &[f64]| {
        let of_group = |i: usize| mean(counted.iter().filter_map(|r| of(r).get(i).copied()).collect());
        (0..groups).map(of_group).collect()
    };
    Means {
        count: counted.len(),
        rmse_background: of_groups(&|r| &r.rmse_background),
        rmse_start: of_groups(&|r| &r.rmse_start),
        rmse_end: of_groups(&|r| &r.rmse_end),
        spread: of_groups(&|r| &r.spread),
        chi2_of_all: {
            let m: usize = counted.iter().map(|r| r.observations).sum();
            (m > 0).then(|| counted.iter().map(|r| 2.0 * r.j).sum::<f64>() / m as f64)
        },
        departures: counted
            .iter()
            .filter_map(|r| r.departures)
            .fold(Departures::default(), |sum, of| sum + of.into())
            .into(),
        inflation: mean(counted.iter().map(|r| r.inflation).collect()),
        chi2: mean(counted.iter().filter(|r| r.observations > 0).map(|r| r.chi2).collect()),
        seconds: mean(counted.iter().map(|r| r.seconds).collect()),
    }
}
