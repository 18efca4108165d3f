//! Cycling: a scene with `[algorithm.cycles]`, window after window, as plain data.
//!
//! The windows are cut out of one long [`Problem`], whose only window is the whole sequence: one run of the truth, one draw of observations in
//! the order of time, one recording read. So more cycles do not change the first ones.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::rc::Rc;
use std::time::Instant;

use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};
use varda_assimilation::{
    Cycle, CycleState, CycledCovariance, CycledEnsemble, CycledUpdate, Cycling, EnVarOptions, Normals,
    Observation, ObservationOperator, ObservationSet, cycle,
};
use varda_implicit::Refusal;
use varda_implicit::check::Amplification;

use crate::Error;
use crate::run::amplification;
use crate::run::window::{Status, Trajectories, WorkCounts, errors};
use crate::scene::{self, Cycles, Observations, SceneFile};
use crate::setup::ensemble;
use crate::setup::memory::{Memory, Sizes};
use crate::setup::problem::{Problem, View, run_states};
use crate::setup::random::{Stream, stream_of_window};
use crate::solve::minimizer;

/// A sequence of windows, ready to run.
pub struct Sequence {
    /// Its settings.
    pub cycles: Cycles,
    /// K, the length of a window in steps.
    pub window: usize,
    /// S, steps from one window to the next.
    pub shift: usize,
    /// Everything about the whole sequence: its window is all the steps, its truth and background are at the first.
    pub problem: Problem,
    /// The states of the truth, step by step; empty where there is none.
    pub truth: Vec<f64>,
    /// What was observed, in the order of time, steps counted from the start of the sequence.
    observations: Vec<Observation>,
    operators: Vec<Shared>,
}

/// An observation operator that the windows of a sequence share.
type Shared = Rc<RefCell<Box<dyn ObservationOperator>>>;

/// What one window gave: a row of cycles.csv, and where it began. RMSE and spread are pairs: of positions \[m\] and velocities [m/s] of
/// a rod; of the state of another model, with nothing second.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Index from 0.
    pub cycle: usize,
    /// First step of the window, counted from the start of the sequence.
    pub first_step: usize,
    /// Model time there \[s\].
    pub time: f64,
    /// J at the analysis.
    pub j: f64,
    /// J_b.
    pub j_b: f64,
    /// J_o.
    pub j_o: f64,
    /// m, the number of observed values.
    pub observations: usize,
    /// 2J/m; 0 where nothing was observed.
    pub chi2: f64,
    /// How the minimization ended.
    pub status: Status,
    /// Why, where a failing model ended it.
    pub failure: Option<String>,
    /// Outer iterations.
    pub outer_iterations: usize,
    /// Work of the minimization.
    pub counts: WorkCounts,
    /// Standard deviation expected of the analysis at the window's end (of the next background, for a propagated posterior).
    pub spread: [Option<f64>; 2],
    /// RMSE of the background at the window's start.
    pub rmse_background: [Option<f64>; 2],
    /// RMSE of the analysis at the window's start.
    pub rmse_start: [Option<f64>; 2],
    /// RMSE of the analysis at the window's end.
    pub rmse_end: [Option<f64>; 2],
    /// Seconds the window took.
    pub seconds: f64,
    /// x_b at the window's start.
    pub background: Vec<f64>,
    /// x_a at the window's start.
    pub analysis: Vec<f64>,
}

/// What the caller of a sequence wants to hear and may say.
pub struct Listener<'a> {
    /// Called after every window, with what the next one starts from.
    pub on_cycle: &'a mut dyn FnMut(&Row, &CycleState) -> Result<(), Error>,
    /// Asked after every window: true ends the run with what is done.
    pub interrupted: &'a dyn Fn() -> bool,
    /// When the run began.
    pub started: Instant,
}

/// What a sequence gives.
#[derive(Debug)]
pub struct Outcome {
    /// How it ended: failed or interrupted before its last window; else the worst end of a minimization.
    pub status: Status,
    /// The windows that were done.
    pub cycles: Vec<Row>,
    /// Analysis and truth over all steps of these windows; every window's analysis from its start to that of the next.
    pub trajectories: Trajectories,
    /// Means over the windows after `spin_up`.
    pub means: Means,
    /// Seconds since the run began.
    pub seconds: f64,
    /// How much the last window amplifies about its analysis; none for methods without a gradient along a run.
    pub amplification: Option<Amplification>,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Means over the windows that count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Means {
    /// How many these are.
    pub count: usize,
    /// RMSE of the background at the start of a window.
    pub rmse_background: [Option<f64>; 2],
    /// RMSE of the analysis there.
    pub rmse_start: [Option<f64>; 2],
    /// RMSE of the analysis at the end of a window.
    pub rmse_end: [Option<f64>; 2],
    /// Spread.
    pub spread: [Option<f64>; 2],
    /// 2J/m, over the windows in which something was observed.
    pub chi2: Option<f64>,
    /// Seconds.
    pub seconds: Option<f64>,
}

/// The scene whose only window is the whole sequence; a scene without cycles as it is.
pub fn whole(file: &SceneFile) -> SceneFile {
    let mut file = file.clone();
    let Some(cycles) = file.scene.algorithm.cycles.take() else { return file };
    let window = file.scene.time.window;
    let shift = cycles.shift_of(window);
    file.scene.time.window = cycles.steps(window);
    if let Observations::Synthetic(synthetic) = &mut file.scene.observations
        && let Some(steps) = &mut synthetic.steps
    {
        let in_all = |c: usize| steps.iter().map(move |k| c * shift + k);
        let mut all: Vec<usize> = (0..cycles.count).flat_map(in_all).collect();
        all.sort_unstable();
        all.dedup();
        *steps = all;
    }
    if let Some(ensemble) = &mut file.scene.algorithm.ensemble {
        // Every window inflates, the first too.
        ensemble.inflation = 1.0;
    }
    if file.scene.algorithm.method.is_of_one_instant() {
        // One instant a window are many in the sequence; what is built is the same.
        file.scene.algorithm.method = scene::Method::FourDVar;
    }
    file
}

impl Sequence {
    /// The sequence a scene describes; `None` for a scene without `[algorithm.cycles]`. Runs the truth from end to end where there is one.
    ///
    /// # Errors
    /// Those of [`Problem::from_scene`].
    pub fn from_scene(file: &SceneFile) -> Result<Option<Sequence>, Error> {
        let Some(cycles) = &file.scene.algorithm.cycles else { return Ok(None) };
        let window = file.scene.time.window;
        let memory = Memory::within_limit(file, &Sizes::of(file)?)?;
        let mut problem = Problem::build(&whole(file), memory.for_window)?;
        let steps = problem.window.steps;
        let truth = match &problem.truth {
            Some(truth) => run_states(problem.model.as_mut(), truth, steps)?,
            None => Vec::new(),
        };
        let taken =
            std::mem::replace(&mut problem.observations, ObservationSet::new(0, Vec::new(), Vec::new())?);
        let (operators, mut observations) = taken.into_parts();
        observations.sort_by(|a, b| at(a).total_cmp(&at(b)));
        problem.scene = file.scene.clone();
        let mut sequence = Sequence {
            cycles: cycles.clone(),
            window,
            shift: cycles.shift_of(window),
            problem,
            truth,
            observations,
            operators: operators.into_iter().map(|o| Rc::new(RefCell::new(o))).collect(),
        };
        let unused = sequence.unused();
        if unused > 0 {
            sequence.problem.left_out.push(format!("{unused} observed values between two windows"));
        }
        Ok(Some(sequence))
    }

    /// Before the first window: the background, and the members of an ensemble about it, their mean.
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

    /// Assimilates window after window, from `state` on: that of [`start`](Self::start), with no `done` rows, or one that a sequence left behind
    /// after the rows `done`.
    ///
    /// # Errors
    /// [`Error::Assimilation`] where the first window cannot be assimilated; an error of `on_cycle`. A later window that fails ends the
    /// sequence as [`Status::Failed`] with what was done before it.
    pub fn run(
        &mut self,
        mut state: CycleState,
        done: Vec<Row>,
        listener: &mut Listener,
    ) -> Result<Outcome, Error> {
        let mut rows = done;
        let (mut refused, mut interrupted) = (None, false);
        let mut began = Instant::now();
        let make_model = &self.problem.make_model;
        let observations = |first: usize| self.of_window(first);
        let anchors = |set: &ObservationSet| ensemble::anchors(set, &self.problem.anchors);
        let algorithm = &self.problem.scene.algorithm;
        let seed = self.problem.scene.seed;
        let normals = |c: usize| -> Normals {
            let mut rng = stream_of_window(seed, Stream::Ensemble, c);
            Box::new(move || StandardNormal.sample(&mut rng))
        };
        let b = self.problem.covariance.as_ref();
        let covariance = match (self.cycles.covariance_of(algorithm.method), &self.problem.ensemble) {
            (scene::CycledCovariance::Propagated, _) => {
                let static_part = self.cycles.static_weight.filter(|w| *w > 0.0).map(|weight| (b, weight));
                let inflation = self.cycles.inflation.unwrap_or(1.0);
                CycledCovariance::Propagated { first: b, inflation, static_part }
            }
            (scene::CycledCovariance::Ensemble, Some(members)) => {
                let ensemble = algorithm.members().unwrap_or_default();
                let hybrid = algorithm.method == scene::Method::HybridFourDEnVar;
                let [beta_s, beta_e] = ensemble.weights();
                // As without cycles, a hybrid is linearized once.
                let max_outer = if hybrid { 1 } else { algorithm.max_iterations };
                CycledCovariance::Ensemble(CycledEnsemble {
                    inflation: ensemble.inflation,
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
                    options: EnVarOptions { max_outer, step_tolerance: 0.05 },
                })
            }
            _ => CycledCovariance::Static(b),
        };
        let cycling = Cycling {
            first: 0,
            window: self.window,
            shift: self.shift,
            cycles: self.cycles.count,
            make_model,
            observations: &observations,
            truth: None,
        };
        let mut on_cycle = |cycle: &Cycle, after: &CycleState| {
            let row = self.row(cycle, began.elapsed().as_secs_f64());
            let told = (listener.on_cycle)(&row, after);
            rows.push(row);
            interrupted = (listener.interrupted)() && after.next < self.cycles.count;
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
        let minimizer = minimizer::minimizer(algorithm);
        let ended = cycle(&cycling, &mut state, &covariance, &minimizer, &mut on_cycle);
        if let Some(error) = refused {
            return Err(error);
        }
        let mut warnings = Vec::new();
        let mut status =
            rows.iter().map(|r| r.status).max_by_key(|s| severity(*s)).unwrap_or(Status::Converged);
        if let Err(error) = ended {
            if rows.is_empty() {
                return Err(error.into());
            }
            warnings.push(format!("cycle {} could not be done: {error}", state.next));
            status = Status::Failed;
        } else if interrupted {
            warnings.push(format!("interrupted after {} of {} cycles", rows.len(), self.cycles.count));
            status = Status::Interrupted;
        }
        let of = |s: Status| rows.iter().filter(|r| r.status == s).count();
        for (s, what) in [
            (Status::MaxIterations, "ended out of iterations"),
            (Status::Stalled, "stalled before the tolerance was met"),
            (Status::Failed, "failed"),
        ] {
            if of(s) > 0 {
                warnings.push(format!("{} of {} minimizations {what}", of(s), rows.len()));
            }
        }
        let means = means(&rows, self.cycles.spin_up);
        if means.count == 0 {
            warnings.push("all cycles done are spin-up: there are no means".into());
        }
        let trajectories = self.trajectories(&rows, &mut warnings);
        let amplification = self.amplification(&rows, &trajectories);
        warnings.extend(amplification.and_then(|a| a.warning()));
        let seconds = listener.started.elapsed().as_secs_f64();
        Ok(Outcome { status, cycles: rows, amplification, trajectories, means, seconds, warnings })
    }

    /// The true state at a step, where it is known.
    pub fn true_state(&self, k: usize) -> Option<&[f64]> {
        let n = self.problem.truth.as_ref()?.len();
        self.truth.get(k * n..(k + 1) * n)
    }

    /// Observed values that fall into windows, and those that fall between two.
    pub fn values(&self) -> [usize; 2] {
        let all: usize = self.observations.iter().map(|o| o.rows.len()).sum();
        let unused = self.unused();
        [all - unused, unused]
    }

    fn unused(&self) -> usize {
        let held = |o: &&Observation| {
            // The last window that starts no later than the observation.
            let c = (o.step / self.shift).min(self.cycles.count - 1);
            at(o) <= (c * self.shift + self.window) as f64
        };
        self.observations.iter().filter(|o| !held(o)).map(|o| o.rows.len()).sum()
    }

    /// What was observed in the window that starts at a step, those that an earlier window has used included.
    fn of_window(&self, first: usize) -> Result<ObservationSet, varda_assimilation::Error> {
        let last = (first + self.window) as f64;
        let from = self.observations.partition_point(|o| o.step < first);
        let inside = self.observations[from..].iter().take_while(|o| at(o) <= last);
        let seen = inside.map(|o| Observation { step: o.step - first, ..o.clone() }).collect();
        let operator = |operator: &Shared| -> Box<dyn ObservationOperator> {
            Box::new(FromStep { operator: Rc::clone(operator), first })
        };
        ObservationSet::new(self.window, self.operators.iter().map(operator).collect(), seen)
    }

    fn row(&self, c: &Cycle, seconds: f64) -> Row {
        let is_rod = matches!(self.problem.view, View::Rod(_));
        let rmse = |x: &[f64], k: usize| {
            let n = self.problem.background.len();
            errors(&x[..n], self.true_state(k).map(|t| &t[..n]), is_rod)
        };
        let spread = |sigma: &Vec<f64>| errors(sigma, Some(&vec![0.0; sigma.len()]), is_rod);
        Row {
            cycle: c.index,
            first_step: c.first_step,
            time: self.problem.window.time(c.first_step),
            j: c.value,
            j_b: c.terms.background,
            j_o: c.terms.observation,
            observations: c.observations,
            chi2: c.chi2,
            status: c.status.into(),
            failure: c.failure.clone(),
            outer_iterations: c.outer_iterations,
            counts: WorkCounts::from(&c.counts),
            spread: c.sigma.as_ref().map_or([None; 2], spread),
            rmse_background: rmse(&c.background, c.first_step),
            rmse_start: rmse(&c.analysis, c.first_step),
            rmse_end: rmse(&c.end, c.first_step + self.window),
            seconds,
            background: c.background.clone(),
            analysis: c.analysis.clone(),
        }
    }

    /// ‖M‖ of the last window about its analysis, for the methods that have a gradient along a run.
    fn amplification(&self, rows: &[Row], runs: &Trajectories) -> Option<Amplification> {
        let last =
            rows.last().filter(|_| self.problem.scene.algorithm.method.is_strong() && self.window > 0)?;
        let [from, to] = [last.first_step, last.first_step + self.window + 1].map(|k| k * runs.dim);
        let states = runs.analysis.get(from..to)?;
        let mut model = (self.problem.make_model)(last.first_step);
        let b = self.problem.covariance.as_ref();
        let mut sigma = vec![0.0; b.dim()];
        b.variance(&mut sigma);
        sigma.iter_mut().for_each(|s| *s = s.sqrt());
        amplification::amplification(model.as_mut(), &last.analysis, &sigma, states, self.problem.scene.seed)
            .ok()
    }

    /// Runs from every window's analysis to the next one's start, the last to its end; and the truth over the same steps.
    fn trajectories(&mut self, rows: &[Row], warnings: &mut Vec<String>) -> Trajectories {
        let dim = self.problem.model.dim();
        let mut analysis = Vec::new();
        for (i, row) in rows.iter().enumerate() {
            let last = i + 1 == rows.len();
            let mut model = (self.problem.make_model)(row.first_step);
            let mut x = vec![0.0; dim];
            let run = model
                .initial_state(&row.analysis, &mut x)
                .map_err(Error::from)
                .and_then(|()| run_states(&mut *model, &x, if last { self.window } else { self.shift - 1 }));
            match run {
                Ok(states) => analysis.extend(states),
                Err(e) => {
                    warnings.push(format!("the run of the analysis ends early, in cycle {}: {e}", row.cycle));
                    break;
                }
            }
        }
        let steps = rows.last().map_or(0, |r| r.first_step + self.window);
        let truth = self.truth.get(..(steps + 1) * dim).unwrap_or(&[]).to_vec();
        Trajectories { dim, background: Vec::new(), analysis, truth }
    }
}

/// Time of an observation in steps.
fn at(o: &Observation) -> f64 {
    o.step as f64 + o.weight
}

/// The worse, the higher.
fn severity(status: Status) -> usize {
    match status {
        Status::Converged => 0,
        Status::MaxIterations => 1,
        Status::Stalled => 2,
        Status::Interrupted => 3,
        Status::Failed => 4,
    }
}

fn means(rows: &[Row], spin_up: usize) -> Means {
    let counted: Vec<&Row> = rows.iter().filter(|r| r.cycle >= spin_up).collect();
    let mean =
        |values: Vec<f64>| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
    let pair = |of: &dyn Fn(&Row) -> [Option<f64>; 2]| {
        [0, 1].map(|i| mean(counted.iter().filter_map(|r| of(r)[i]).collect()))
    };
    Means {
        count: counted.len(),
        rmse_background: pair(&|r| r.rmse_background),
        rmse_start: pair(&|r| r.rmse_start),
        rmse_end: pair(&|r| r.rmse_end),
        spread: pair(&|r| r.spread),
        chi2: mean(counted.iter().filter(|r| r.observations > 0).map(|r| r.chi2).collect()),
        seconds: mean(counted.iter().map(|r| r.seconds).collect()),
    }
}

/// An operator of the sequence, in a window that starts at its step `first`.
struct FromStep {
    operator: Shared,
    first: usize,
}

impl ObservationOperator for FromStep {
    fn dim(&self) -> usize {
        self.operator.borrow().dim()
    }

    fn observe(&mut self, k: usize, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.operator.borrow_mut().observe(self.first + k, x, y)
    }

    fn tangent(&mut self, k: usize, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        self.operator.borrow_mut().tangent(self.first + k, x, dx, dy);
    }

    fn adjoint_add(&mut self, k: usize, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        self.operator.borrow_mut().adjoint_add(self.first + k, x, dy, dx);
    }
}
