//! A model that is not a rod as the system of a problem: its truth, background, covariance and models.

use std::rc::Rc;

use varda_assimilation::Climatology;
use varda_implicit::Model;
use varda_implicit::line::Line;

use super::component_model::Equation;
use super::covariance::{self, Factored};
use super::csv;
use super::ensemble::ComponentPositions;
use super::estimate::{Constant, Estimates};
use super::files::Files;
use super::runs::{MakeModel, run_states};
use crate::Error;
use crate::scene::{self, ComponentCovariance, Invalid, SceneFile, TimeGrid};
use crate::state::StateLayout;

type MakeHere = Rc<dyn Fn(usize) -> Box<dyn Model + Send>>;

/// A model whose state is a list of components of one kind.
pub struct ComponentSystem {
    /// Names of the components.
    pub names: Vec<String>,
    /// Numbers that the linearization of a step keeps.
    pub(crate) kept: usize,
    /// Whether its steps are explicit.
    pub(crate) is_explicit: bool,
    /// The line of a field along one.
    pub(super) line: Option<Line>,
    positions: ComponentPositions,
    start: Vec<f64>,
    /// What is unknown beside the state.
    pub(crate) estimates: Estimates,
    /// Makes the model, its step 0 being the given step of the model's time.
    make: MakeHere,
    /// The same without unknown constants.
    without: MakeHere,
    spin_up: usize,
}

impl ComponentSystem {
    /// The model of a scene with this equation.
    ///
    /// # Errors
    /// [`Error::Scene`] pointing at a constant that cannot be estimated.
    pub(crate) fn new(file: &SceneFile, equation: Equation, grid: TimeGrid) -> Result<Self, Error> {
        let scene = &file.scene;
        let n = equation.dim();
        let numbered = |letter: &str| (0..n).map(|i| format!("{letter}{i}")).collect();
        let (names, positions) = match &equation {
            Equation::Lorenz63(_) => {
                (["x", "y", "z"].map(String::from).to_vec(), ComponentPositions::Nowhere)
            }
            Equation::Lorenz96 { .. } => (numbered("x"), ComponentPositions::Ring(n)),
            Equation::AlongLine { line, .. } => (numbered("u"), ComponentPositions::Line(*line)),
        };
        let line = equation.line();
        let is_explicit = equation.is_explicit();
        let start = scene.truth.as_ref().map_or_else(|| equation.start(), |truth| truth.state.clone());
        let (estimates, chosen) = Estimates::of_components(file, &equation.constants())?;
        let without: MakeHere = Rc::new(equation.factory(&start, grid.step));
        let make = if estimates.is_empty() {
            Rc::clone(&without)
        } else {
            Rc::new(equation.factory_with(chosen, estimates.carried(), &start, grid.step))
        };
        Ok(ComponentSystem {
            names,
            // Explicit: four stages. Implicit: the states and a factor of about six numbers a row.
            kept: if is_explicit { 4 * n } else { 8 * n },
            is_explicit,
            line,
            positions,
            start,
            estimates,
            make,
            without,
            spin_up: scene.time.spin_up,
        })
    }

    /// The layout of its state.
    pub(crate) fn layout(&self) -> StateLayout {
        StateLayout::of_components(self.names.clone())
            .with_constants(self.estimates.constants.iter().map(Constant::of_control))
    }

    /// Where its components are.
    pub(crate) fn positions(&self) -> ComponentPositions {
        self.positions.clone()
    }

    /// A state with the constants of the scene behind it.
    fn with_known_constants(&self, mut state: Vec<f64>) -> Vec<f64> {
        state.resize(self.names.len() + self.estimates.len(), 0.0);
        state
    }

    /// What explicit steps do without.
    pub(crate) fn left_out(&self) -> Option<String> {
        self.is_explicit.then(|| "factorizations: the steps are explicit".to_string())
    }

    /// The truth of a twin experiment: the state after the spin-up from the start.
    pub(crate) fn truth(&self) -> Result<Vec<f64>, Error> {
        let mut model = (self.make)(0);
        let start = self.with_known_constants(self.start.clone());
        let states = run_states(model.as_mut(), &start, self.spin_up)?;
        Ok(states[self.spin_up * start.len()..].to_vec())
    }

    /// The state in a CSV file with one row for each component.
    pub(crate) fn read_background(&self, files: &Files, name: &str) -> Result<Vec<f64>, Error> {
        let n = self.names.len();
        let (label, text) = files.text("background.file", name)?;
        let rows = csv::numbers(&label, &text, ["component", "value"])?;
        let in_order = rows.iter().enumerate().all(|(i, r)| r[0] == i as f64);
        if rows.len() != n || !in_order {
            return Err(Error::Data {
                place: label,
                message: format!("expected one row for each component 0 to {}, in order", n - 1),
            });
        }
        Ok(self.with_known_constants(rows.iter().map(|r| r[1]).collect()))
    }

    /// The covariance that the key `path` describes. A climatology runs the model.
    pub(crate) fn covariance(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
    ) -> Result<Factored, Error> {
        let n = self.names.len();
        match file.checked(self.covariance_keys(path, keys))? {
            ComponentCovariance::Line(k, line) => covariance::along_line(file, path, k, &line),
            ComponentCovariance::Diagonal(d) => covariance::diagonal(file, path, n, d.sigma),
            ComponentCovariance::Known => Ok(covariance::none(n)),
            ComponentCovariance::Climatology(c) => {
                let mut model = (self.without)(0);
                let climate = Climatology::of_run(model.as_mut(), &self.start, self.spin_up, c.steps)
                    .map_err(|reason| Error::Preparation { stage: "climatology", reason })?;
                covariance::scaled(file, path, n, c.scale, &climate.covariance)
            }
        }
    }

    /// Fails where the covariance that the key `path` describes has no root. A climatology needs a run and is
    /// not checked.
    pub(crate) fn check_covariance(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
    ) -> Result<(), Error> {
        match file.checked(self.covariance_keys(path, keys))? {
            ComponentCovariance::Climatology(_) => Ok(()),
            _ => self.covariance(file, path, keys).map(|_| ()),
        }
    }

    fn covariance_keys<'k>(
        &self,
        path: &str,
        keys: &'k scene::Covariance,
    ) -> Result<ComponentCovariance<'k>, Invalid> {
        match self.line {
            Some(line) => keys.of_line(path, line),
            None => keys.of_lorenz(path),
        }
    }

    /// Makes models.
    pub(crate) fn models(&self) -> MakeModel {
        let (make, first) = (Rc::clone(&self.make), self.spin_up);
        Box::new(move |k| make(first + k))
    }
}
