//! Adaptive time steps of a rod: chosen from an error estimate along one trajectory, fixed during a
//! minimization, chosen again if the estimate along the analysis exceeds the tolerance.

use varda_implicit::{Adaptive, Error, ImplicitModel, Model, WithParameters, accepted_times, largest_error};
use varda_rod::RodStep;

use super::rod_model::RodParts;
use super::runs::MakeModel;
use crate::outcome::AcceptedSteps;
use crate::scene::TimeGrid;

/// The steps are kept along another trajectory if no estimate there exceeds the tolerance by this factor: an
/// error estimate is known no better than that.
const SLACK: f64 = 2.0;

/// Most steps into which a step of the window may be divided.
const MOST_SUBSTEPS: f64 = 4096.0;

/// How often the steps are chosen again in a run, at most. Each minimization starts where the last one ended,
/// so that once or twice is the rule.
const REFRESHES: usize = 5;

/// The times of a window and its forecast, with those in between that a tolerance requires.
#[derive(Clone)]
pub(crate) struct AdaptiveSteps {
    parts: RodParts,
    spin_up: usize,
    grid: TimeGrid,
    tolerance: f64,
    times: Vec<f64>,
}

impl AdaptiveSteps {
    /// Steps chosen along the run from a control.
    ///
    /// # Errors
    /// [`Error::ToleranceNotMet`], or a step that fails.
    pub(crate) fn along(
        parts: &RodParts,
        spin_up: usize,
        grid: TimeGrid,
        tolerance: f64,
        control: &[f64],
    ) -> Result<Self, crate::Error> {
        let mut steps = Self { parts: parts.clone(), spin_up, grid, tolerance, times: Vec::new() };
        steps.choose(control)?;
        Ok(steps)
    }

    /// Chooses the steps again, along the run from another control. After an error they are as before.
    ///
    /// # Errors
    /// [`Error::ToleranceNotMet`], or a step that fails.
    fn choose(&mut self, control: &[f64]) -> Result<(), Error> {
        let step = self.grid.step;
        let (tolerance, shortest) = (self.tolerance, step / MOST_SUBSTEPS);
        let options = Adaptive { tolerance, first: step, shortest, longest: step };
        let (mut dynamics, x0, scale) = self.start(control)?;
        let through = self.grid.times();
        self.times = accepted_times(&mut dynamics, self.parts.scheme, &x0, &scale, &through, &options)?;
        Ok(())
    }

    /// The largest estimated error of a step along the run from a control, over the length of the rod.
    ///
    /// # Errors
    /// A step that fails.
    fn largest_error(&self, control: &[f64]) -> Result<f64, Error> {
        let (mut dynamics, x0, scale) = self.start(control)?;
        largest_error(&mut dynamics, self.parts.scheme, &x0, &scale, &self.times)
    }

    /// Whether an estimated error is within the tolerance, as far as it is known.
    fn is_met(&self, largest_error: f64) -> bool {
        largest_error <= SLACK * self.tolerance
    }

    /// Makes models with these steps.
    pub(crate) fn factory(&self) -> MakeModel {
        rod_models(&self.parts, self.spin_up, self.grid, Some(self.times.clone()))
    }

    /// The same problem with steps that end at other times.
    pub(crate) fn with_times(&self, times: &[f64]) -> Self {
        AdaptiveSteps { times: times.to_vec(), ..self.clone() }
    }

    /// The dynamics, the state of a control at the start of the window, and the scale of its components.
    fn start(&self, control: &[f64]) -> Result<(RodStep, Vec<f64>, Vec<f64>), Error> {
        let mut model = dynamics(&self.parts).model(self.spin_up, self.grid.step);
        let mut x0 = vec![0.0; model.dim()];
        model.initial_state(control, &mut x0)?;
        let rod = dynamics(&self.parts);
        let mut scale = vec![f64::INFINITY; x0.len()];
        let places = 3 * rod.free_vertices().len();
        scale[..places].fill(self.parts.rod.length());
        Ok((rod, x0, scale))
    }
}

/// The adaptive steps of a run in progress.
pub(crate) struct Refreshing {
    steps: AdaptiveSteps,
    refreshed: usize,
    warnings: Vec<String>,
    /// The largest estimated error along the control that was last asked about, if the steps were kept there.
    error: Option<f64>,
}

impl Refreshing {
    pub(crate) fn new(steps: &AdaptiveSteps) -> Self {
        Refreshing { steps: steps.clone(), refreshed: 0, warnings: Vec::new(), error: None }
    }

    /// The model with steps chosen again along the run from a control, if the present ones are too long
    /// there. After `None` the control is the analysis.
    pub(crate) fn refresh(&mut self, control: &[f64]) -> Option<Box<dyn Model + Send>> {
        self.error = self.steps.largest_error(control).ok();
        if self.error.is_some_and(|e| self.steps.is_met(e)) || self.refreshed == REFRESHES {
            return None;
        }
        match self.steps.choose(control) {
            Ok(()) => {
                self.error = None;
                self.refreshed += 1;
                Some(self.steps.factory()(0))
            }
            Err(e) => {
                let text = "the time steps could not be adapted to the analysis";
                self.warnings.push(format!("{text}: {e}"));
                None
            }
        }
    }

    /// The models with the steps now in force, if they were chosen again.
    pub(crate) fn refreshed_models(&self) -> Option<MakeModel> {
        (self.refreshed > 0).then(|| self.steps.factory())
    }

    /// The steps at the end of the run, and remarks: one if they are too long along the analysis.
    pub(crate) fn finish(self, analysis: &[f64]) -> (AcceptedSteps, Vec<String>) {
        let Refreshing { steps, refreshed, mut warnings, error } = self;
        let largest_error = error.or_else(|| steps.largest_error(analysis).ok());
        if !largest_error.is_some_and(|e| steps.is_met(e)) {
            warnings.push(format!(
                "time.tolerance = {:e} is not met along the analysis: its largest estimated error of a step \
                 is {} \
                 of the rod's length",
                steps.tolerance,
                largest_error.map_or("not known".into(), |e| format!("{e:.1e}"))
            ));
        }
        let (accepted, tolerance, times) = (steps.times.len() - 1, steps.tolerance, steps.times);
        (AcceptedSteps { accepted, refreshed, largest_error, tolerance, times }, warnings)
    }
}

/// Makes models that start at a step of the window, and whose step k is the window's from there on: one step,
/// or those between `times` that make it up.
pub(crate) fn rod_models(
    parts: &RodParts,
    spin_up: usize,
    grid: TimeGrid,
    times: Option<Vec<f64>>,
) -> MakeModel {
    let parts = parts.clone();
    Box::new(move |first| {
        let step = dynamics(&parts);
        let carried = parts.estimates.carried();
        match &times {
            None if !parts.estimates.is_empty() => {
                let step = WithParameters::new(step, carried);
                Box::new(ImplicitModel::new(step, spin_up + first, grid.step))
            }
            None => step.model(spin_up + first, grid.step),
            Some(times) => {
                let from = times.partition_point(|t| *t < grid.time(first));
                step.model_on_times(&times[from..], &grid.times()[first..])
            }
        }
    })
}

fn dynamics(parts: &RodParts) -> RodStep {
    parts.dynamics().expect("the dynamics were made of these parts before")
}
