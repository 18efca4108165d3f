//! A sequence of windows: what it is made of, and its models, observations and runs window by window.

use std::cell::RefCell;
use std::rc::Rc;

use varda_assimilation::{
    Error as AssimilationError, Forcing, Observation, ObservationOperator, ObservationSet,
};
use varda_implicit::{At, Model, Refusal};

use crate::Error;
use crate::outcome::CycleRow;
use crate::scene::{Cycles, SceneFile};
use crate::setup::runs::run_states;
use crate::setup::{Inputs, Problem};
use crate::solve::forcing;

/// A sequence of windows, ready to run. It does not change.
pub struct Sequence {
    /// Its settings.
    pub cycles: Cycles,
    /// K, the length of a window in steps.
    pub window: usize,
    /// S, steps from one window to the next.
    pub shift: usize,
    /// The whole sequence as one window: its truth and background are at the first step.
    pub problem: Problem,
    /// The states of the truth, step by step; empty where there is none.
    pub truth: Vec<f64>,
    /// What was observed, in the order of time, steps counted from the start of the sequence.
    pub(super) observations: Vec<Observation>,
}

/// An observation operator that the windows of a sequence share.
pub(super) type SharedOperator = Rc<RefCell<Box<dyn ObservationOperator>>>;

impl Sequence {
    /// The sequence that a scene describes; `None` for a scene without `[algorithm.cycles]`. Runs the truth
    /// from end to end where there is one.
    ///
    /// # Errors
    /// Those of [`Problem::from_scene`].
    pub fn from_scene(file: &SceneFile) -> Result<Option<Sequence>, Error> {
        match &file.scene.algorithm.cycles {
            Some(cycles) => Sequence::new(cycles.clone(), Inputs::read(file)?).map(Some),
            None => Ok(None),
        }
    }

    /// The sequence of a scene that has been read.
    ///
    /// # Errors
    /// Those of [`Problem::new`].
    pub fn new(cycles: Cycles, inputs: Inputs) -> Result<Sequence, Error> {
        let mut problem = Problem::new(inputs)?;
        let window = problem.experiment.scene.time.window;
        let truth = match &problem.truth {
            Some(truth) => run_states(problem.model().as_mut(), truth, problem.experiment.grid.steps)?,
            None => Vec::new(),
        };
        let mut observations = problem.observed.assimilated(&problem.experiment.grid);
        observations.sort_by(|a, b| at(a).total_cmp(&at(b)));
        let shift = cycles.shift_of(window);
        let unused = unused(&observations, &cycles, window);
        if unused > 0 {
            problem.experiment.left_out.push(format!("{unused} observed values between two windows"));
        }
        Ok(Sequence { cycles, window, shift, problem, truth, observations })
    }

    /// The true state at a step, where it is known.
    pub fn true_state(&self, k: usize) -> Option<&[f64]> {
        let n = self.problem.truth.as_ref()?.len();
        self.truth.get(k * n..(k + 1) * n)
    }

    /// Observed values that fall into windows, and those that fall between two.
    pub fn values(&self) -> [usize; 2] {
        let all: usize = self.observations.iter().map(|o| o.rows.len()).sum();
        let unused = unused(&self.observations, &self.cycles, self.window);
        [all - unused, unused]
    }

    /// What was observed in the window that starts at a step, including what an earlier window has used.
    pub(super) fn of_window(
        &self,
        operators: &[SharedOperator],
        first: usize,
    ) -> Result<ObservationSet, AssimilationError> {
        let last = (first + self.window) as f64;
        let from = self.observations.partition_point(|o| o.step < first);
        let inside = self.observations[from..].iter().take_while(|o| at(o) <= last);
        self.set_from(operators, first, self.window, inside)
    }

    /// Observations of some steps from `first` on, with steps counted from there.
    pub(super) fn set_from<'o>(
        &self,
        operators: &[SharedOperator],
        first: usize,
        steps: usize,
        observations: impl Iterator<Item = &'o Observation>,
    ) -> Result<ObservationSet, AssimilationError> {
        let seen = observations.map(|o| o.clone().at_step(o.step - first)).collect();
        let operator = |operator: &SharedOperator| -> Box<dyn ObservationOperator> {
            Box::new(FromStep { operator: Rc::clone(operator), first })
        };
        let grid = &self.problem.experiment.grid;
        let times = (first..=first + steps).map(|k| grid.time(k)).collect();
        ObservationSet::on_times(times, operators.iter().map(operator).collect(), seen)
    }

    /// The model of the window that starts at a step, where the window before left the end clamp at an angle.
    pub(super) fn model_of(&self, first: usize, end_angle: Option<f64>) -> Box<dyn Model + Send> {
        match (self.problem.system.rod(), end_angle) {
            (Some(rod), Some(angle)) => rod.model_turned(first, angle),
            _ => (self.problem.make_model)(first),
        }
    }

    /// When errors of the model enter.
    pub(super) fn forcing(&self) -> Forcing {
        let n = self.problem.background.len();
        forcing(self.problem.experiment.scene.algorithm.model_error.as_ref(), n)
    }

    /// The states of a window from its analysis on, with the errors of the model that it found.
    pub(super) fn states_of(
        &self,
        row: &CycleRow,
        before: Option<f64>,
        steps: usize,
    ) -> Result<Vec<f64>, Error> {
        let mut model = self.model_of(row.first_step, before);
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&row.analysis, &mut x)?;
        if row.model_errors.is_empty() {
            return run_states(&mut *model, &x, steps);
        }
        let (forcing, size) = (self.forcing(), row.analysis.len());
        let (mut states, mut next) = (x.clone(), x.clone());
        for k in 0..steps {
            model.step(k, &x, &mut next)?;
            let error = forcing.index(k).and_then(|j| row.model_errors.get(j * size..(j + 1) * size));
            error.unwrap_or(&[]).iter().zip(&mut next).for_each(|(eta, x)| *x += eta);
            std::mem::swap(&mut x, &mut next);
            states.extend_from_slice(&x);
        }
        Ok(states)
    }
}

/// Time of an observation in steps.
pub(super) fn at(o: &Observation) -> f64 {
    o.step as f64 + o.weight
}

/// Observed values that fall between two windows.
fn unused(observations: &[Observation], cycles: &Cycles, window: usize) -> usize {
    let shift = cycles.shift_of(window);
    let is_used = |o: &&Observation| {
        // The last window that starts no later than the observation.
        let c = (o.step / shift).min(cycles.count - 1);
        at(o) <= (c * shift + window) as f64
    };
    observations.iter().filter(|o| !is_used(o)).map(|o| o.rows.len()).sum()
}

/// An operator of the sequence, in a window that starts at its step `first`.
struct FromStep {
    operator: SharedOperator,
    first: usize,
}

impl FromStep {
    fn moved(&self, at: At) -> At {
        At { step: self.first + at.step, ..at }
    }
}

impl ObservationOperator for FromStep {
    fn dim(&self) -> usize {
        self.operator.borrow().dim()
    }

    fn state_dim(&self) -> usize {
        self.operator.borrow().state_dim()
    }

    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.operator.borrow_mut().observe(self.moved(at), x, y)
    }

    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        self.operator.borrow_mut().tangent(self.moved(at), x, dx, dy);
    }

    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        self.operator.borrow_mut().adjoint_add(self.moved(at), x, dy, dx);
    }

    fn has_second_derivatives(&self) -> bool {
        self.operator.borrow().has_second_derivatives()
    }

    fn second_adjoint_add(&mut self, at: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        self.operator.borrow_mut().second_adjoint_add(self.moved(at), x, dx, dy, out);
    }
}
