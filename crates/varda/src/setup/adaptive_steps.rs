//! Steps of a rod divided by an estimate of their error: accepted along one trajectory, frozen over a minimization, and divided anew
//! where they no longer do.

use serde::Serialize;
use varda_implicit::{Adaptive, Error, Model, accepted_times, largest_error};

use varda_rod::RodStep;

use crate::setup::problem::MakeModel;
use crate::setup::rod_model::RodParts;
use crate::setup::rod_observations::Window;

/// Steps hold along another trajectory as long as no estimate there exceeds the tolerance by this factor, which is as well as the estimate is known.
const SLACK: f64 = 2.0;

/// A step of the window is divided into no more than so many.
const MOST_PARTS: f64 = 4096.0;

/// The grid of a window and its forecast, with the times in between that a tolerance asks for.
#[derive(Clone)]
pub(crate) struct DividedSteps {
    parts: RodParts,
    spin_up: usize,
    window: Window,
    tolerance: f64,
    times: Vec<f64>,
}

/// What became of them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct AcceptedSteps {
    /// How many there are, window and forecast together.
    pub accepted: usize,
    /// How often they were divided anew.
    pub refreshed: usize,
    /// Largest estimated error of one along the analysis, over the length of the rod; `null` where a step along it fails.
    pub largest_error: Option<f64>,
    /// What was asked for.
    pub tolerance: f64,
}

impl DividedSteps {
    /// Those accepted along the run from a control.
    ///
    /// # Errors
    /// [`Error::ToleranceNotMet`], or a step that fails.
    pub(crate) fn along(
        parts: &RodParts,
        spin_up: usize,
        window: Window,
        tolerance: f64,
        control: &[f64],
    ) -> Result<Self, Error> {
        let parts = parts.clone();
        let mut new = Self { parts, spin_up, window, tolerance, times: Vec::new() };
        new.divide(control)?;
        Ok(new)
    }

    /// Divides the window anew, along the run from another control. After an error the steps are as before.
    ///
    /// # Errors
    /// [`Error::ToleranceNotMet`], or a step that fails.
    pub(crate) fn divide(&mut self, control: &[f64]) -> Result<(), Error> {
        let step = self.window.step;
        let options =
            Adaptive { tolerance: self.tolerance, first: step, shortest: step / MOST_PARTS, longest: step };
        let (mut dynamics, x0, scale) = self.start(control)?;
        self.times =
            accepted_times(&mut dynamics, self.parts.scheme, &x0, &scale, &grid(&self.window), &options)?;
        Ok(())
    }

    /// The largest estimated error of a step along the run from a control, over the length of the rod.
    ///
    /// # Errors
    /// A step that fails.
    pub(crate) fn largest_error(&self, control: &[f64]) -> Result<f64, Error> {
        let (mut dynamics, x0, scale) = self.start(control)?;
        largest_error(&mut dynamics, self.parts.scheme, &x0, &scale, &self.times)
    }

    /// Whether an estimated error is within what was asked for, as well as it is known.
    pub(crate) fn hold(&self, largest_error: f64) -> bool {
        largest_error <= SLACK * self.tolerance
    }

    /// The account of them.
    pub(crate) fn report(&self, refreshed: usize, largest_error: Option<f64>) -> AcceptedSteps {
        let accepted = self.times.len() - 1;
        AcceptedSteps { accepted, refreshed, largest_error, tolerance: self.tolerance }
    }

    /// Makes models of these steps.
    pub(crate) fn factory(&self) -> MakeModel {
        rod_models(&self.parts, self.spin_up, self.window, Some(self.times.clone()))
    }

    /// The dynamics, the state of a control at the start of the window, and the scale of its components.
    fn start(&self, control: &[f64]) -> Result<(RodStep, Vec<f64>, Vec<f64>), Error> {
        let dynamics = || self.parts.dynamics().expect("the dynamics were made of these parts before");
        let mut model = dynamics().model(self.spin_up, self.window.step);
        let mut x0 = vec![0.0; model.dim()];
        model.initial_state(control, &mut x0)?;
        let mut scale = vec![f64::INFINITY; x0.len()];
        scale[..control.len() / 2].fill(self.parts.rod.length());
        Ok((dynamics(), x0, scale))
    }
}

/// Refreshes at most. Each starts where the last ended, so that one or two are the rule.
const REFRESHES: usize = 5;

/// The divided steps of a run under way.
pub(crate) struct Refreshing {
    pub(crate) steps: Option<DividedSteps>,
    pub(crate) refreshed: usize,
    pub(crate) warnings: Vec<String>,
    /// The largest estimated error along the control last asked about, where the steps are still those.
    error: Option<f64>,
}

impl Refreshing {
    pub(crate) fn new(steps: Option<DividedSteps>) -> Self {
        Refreshing { steps, refreshed: 0, warnings: Vec::new(), error: None }
    }

    /// The model on steps divided along the run from a control, where those in force do not hold there. After `None` the control is the
    /// analysis.
    pub(crate) fn refresh(&mut self, control: &[f64]) -> Option<Box<dyn Model + Send>> {
        let steps = self.steps.as_mut()?;
        self.error = steps.largest_error(control).ok();
        if self.error.is_some_and(|e| steps.hold(e)) || self.refreshed == REFRESHES {
            return None;
        }
        match steps.divide(control) {
            Ok(()) => {
                self.error = None;
                self.refreshed += 1;
                Some(steps.factory()(0))
            }
            Err(e) => {
                self.warnings.push(format!("the steps could not be divided anew along the analysis: {e}"));
                None
            }
        }
    }

    /// What became of the steps; a warning where they do not hold along the analysis.
    pub(crate) fn account(&mut self, analysis: &[f64]) -> Option<AcceptedSteps> {
        let steps = self.steps.as_ref()?;
        let error = self.error.or_else(|| steps.largest_error(analysis).ok());
        let account = steps.report(self.refreshed, error);
        if !error.is_some_and(|e| steps.hold(e)) {
            self.warnings.push(format!(
                "time.tolerance = {:e} is not met along the analysis: its largest estimated error of a step is {} of the rod's length",
                account.tolerance,
                error.map_or("not known".into(), |e| format!("{e:.1e}"))
            ));
        }
        Some(account)
    }
}

/// Makes models that start at a step of the window, whose step k is the window's from there: one step, or those between `times` that make it up.
pub(crate) fn rod_models(
    parts: &RodParts,
    spin_up: usize,
    window: Window,
    times: Option<Vec<f64>>,
) -> MakeModel {
    let parts = parts.clone();
    Box::new(move |first| {
        let step = parts.dynamics().expect("the dynamics were made of these parts before");
        match &times {
            None => step.model(spin_up + first, window.step),
            Some(times) => {
                let from = times.partition_point(|t| *t < window.time(first));
                step.model_on_times(&times[from..], &grid(&window)[first..])
            }
        }
    })
}

/// Times of all steps of the window and its forecast.
fn grid(window: &Window) -> Vec<f64> {
    (0..=window.steps + window.forecast).map(|k| window.time(k)).collect()
}
