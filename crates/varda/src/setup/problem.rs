//! Everything an assimilation needs: models, B, x_b, observations, and the truth where there is one.

use varda_assimilation::ObservationSet;
use varda_covariance::{Ensemble, sample};
use varda_implicit::Model;

use super::adaptive_steps::AdaptiveSteps;
use super::considered::Considered;
use super::covariance::Factored;
use super::ensemble;
use super::finer::{Finer, finer};
use super::inputs::{Inputs, KnownBackground};
use super::memory::{Memory, Sizes, without_spread};
use super::observations::Observed;
use super::random::{Stream, stream};
use super::runs::MakeModel;
use super::system::System;
use crate::Error;
use crate::outcome::{AcceptedSteps, Experiment};
use crate::scene::{Hessian, Scene, SceneFile};

/// Everything an assimilation needs. It does not change: a second run of the same problem gives the same
/// bits.
pub struct Problem {
    /// The scene, the grid of time, the meaning of the numbers of a state.
    pub experiment: Experiment,
    /// Makes models; their step k is that of the window.
    pub make_model: MakeModel,
    /// Makes the model that runs the truth, if that is another one: its time steps are adapted to its own
    /// run.
    pub make_truth: Option<MakeModel>,
    /// What is modelled.
    pub system: System,
    /// B.
    pub covariance: Factored,
    /// Q, for the weak-constraint methods.
    pub model_error: Option<Factored>,
    /// The members, for the ensemble methods.
    pub ensemble: Option<Ensemble>,
    /// For each row of the observation operator the component of the control at the same place.
    pub anchors: Vec<usize>,
    /// x_b, in the control.
    pub background: Vec<f64>,
    /// The state of the truth at the start of the window, in a twin experiment.
    pub truth: Option<Vec<f64>>,
    /// What is observed.
    pub observed: Observed,
    /// Most bytes for the states and linearizations of a window: what `[limits] memory` leaves.
    pub memory: usize,
    /// The scene on a finer mesh, where σ of its constants needs an allowance for the mesh.
    pub(crate) finer: Finer,
    /// The scene, where passes of an estimate adjust how its observations are read.
    pub(crate) adjustable: Option<Box<SceneFile>>,
    /// The same with the constants of `[consider]` among the unknowns.
    pub(crate) considered: Option<Considered>,
    /// The time steps of the models, if they are adaptive.
    pub(crate) adaptive_steps: Option<AdaptiveSteps>,
}

impl Problem {
    /// Components of the control that are constants of their own, where they are few.
    pub(crate) fn single_constants(&self) -> Vec<usize> {
        let estimates = self.system.estimates();
        let first = self.background.len() - estimates.len();
        estimates.single().iter().map(|i| first + i).collect()
    }

    /// The problem that a scene describes; of its first window, where it has `[algorithm.cycles]`. Runs the
    /// truth up to the last observation where there is one.
    ///
    /// # Errors
    /// [`Error`] naming the key, the file's line, or the step.
    pub fn from_scene(file: &SceneFile) -> Result<Problem, Error> {
        let mut file = file.clone();
        file.scene.algorithm.cycles = None;
        Problem::new(Inputs::read(&file)?)
    }

    /// The problem of a scene that has been read; its window is the whole sequence of `[algorithm.cycles]`.
    ///
    /// # Errors
    /// [`Error`] naming the key or the step.
    pub fn new(inputs: Inputs) -> Result<Problem, Error> {
        let memory = Memory::within_limit(&inputs.file, &Sizes::of(&inputs))?;
        let Inputs { file, one_window, grid, mut system, mut observed, background, .. } = inputs;
        let scene = &one_window.scene;
        let layout = system.layout();
        let n = layout.len();

        let known = match background {
            KnownBackground::Drawn => None,
            KnownBackground::Read(control) => Some(control),
            KnownBackground::AtRest => system.come_to_rest()?,
        };
        let truth = if known.is_none() { Some(system.truth()?) } else { None };
        if let Some(truth) = &truth {
            system.start_turned_as(truth)?;
        }
        let reference = known.as_ref().or(truth.as_ref()).map_or(&[][..], |z| &z[..n]);
        let (path, keys) = ("background.covariance", &scene.background.covariance);
        let estimates = system.estimates();
        let covariance = estimates.behind(system.covariance(&one_window, path, keys, reference)?)?;
        let model_error = match &scene.algorithm.model_error {
            Some(error) => {
                let path = "algorithm.model_error.covariance";
                let q = system.covariance(&one_window, path, &error.covariance, reference)?;
                Some(estimates.without_error(q))
            }
            None => None,
        };
        let background = match known {
            Some(control) => control,
            None => {
                let other = system.drawn_from(&one_window, path, keys, reference)?;
                let drawn_from = other.as_deref().unwrap_or(covariance.as_ref());
                let error = sample(drawn_from, &mut stream(scene.seed, Stream::Background));
                reference.iter().zip(&error).map(|(x, e)| x + e).collect()
            }
        };
        let members = scene.algorithm.members();
        let ensemble = members
            .map(|e| ensemble::draw(&one_window, &e, &background, covariance.as_ref(), &system.positions()))
            .transpose()?;

        // The truth has time steps of its own: it does not depend on the background.
        let steps_of_truth = match &truth {
            Some(truth) => system.adaptive_steps(&one_window, &truth[..n])?,
            None => None,
        };
        let make_truth = steps_of_truth.map(|steps| steps.factory());
        let adaptive_steps = system.adaptive_steps(&one_window, &background)?;
        let make_model = adaptive_steps.as_ref().map_or_else(|| system.models(), |steps| steps.factory());
        if let Some(truth) = &truth {
            let mut model = make_truth.as_ref().unwrap_or(&make_model)(0);
            observed.draw(model.as_mut(), &grid, truth, scene.seed)?;
        }
        observed.seen.iter_mut().for_each(|seen| seen.sigma *= one_window.adjusted.sigma);
        let mut left_out = system.left_out();
        left_out.extend(observed.left_out.iter().cloned());
        left_out.extend(without_derivatives(scene));
        left_out.extend(without_spread(scene, n));
        let [n_state, _] = system.sizes();
        let problem = Problem {
            experiment: Experiment {
                name: file.name.clone(),
                scene: file.scene.clone(),
                grid,
                state: layout,
                n_state,
                left_out,
            },
            make_model,
            make_truth,
            considered: Considered::read(&one_window, &system)?,
            system,
            covariance,
            model_error,
            ensemble,
            anchors: observed.anchors(),
            background,
            truth,
            observed,
            memory: memory.for_window,
            adjustable: adjustable(&one_window),
            finer: one_window.checked(finer(&one_window))?.within(memory.for_finer),
            adaptive_steps,
        };
        problem.check_hessian(&file)?;
        let method = scene.algorithm.method;
        if let (true, Some(last @ 1..)) = (method.is_of_one_instant(), problem.observations()?.last_step()) {
            let message = format!(
                "method {:?} takes observations at step 0 only; these go on to step {last}",
                method.name()
            );
            return Err(file.invalid("algorithm.method", message));
        }
        Ok(problem)
    }

    /// Refuses the exact Hessian of a model without second derivatives.
    fn check_hessian(&self, file: &SceneFile) -> Result<(), Error> {
        let scene = &self.experiment.scene;
        if scene.algorithm.hessian == Hessian::GaussNewton {
            return Ok(());
        }
        let message = if self.model().second_order().is_none() {
            let why = "this model has no second derivatives";
            format!("{why}: leave this key out, and the Hessian is that of Gauss and Newton")
        } else if !self.observations()?.has_second_derivatives() {
            let why = "these observations have no second derivatives";
            format!("{why}: leave this key out, and the Hessian is that of Gauss and Newton")
        } else {
            return Ok(());
        };
        Err(file.invalid("algorithm.hessian", message))
    }

    /// Length of the control.
    pub fn control_dim(&self) -> usize {
        self.background.len()
    }

    /// The observations that are assimilated, as a set of their own.
    ///
    /// # Errors
    /// [`Error::Assimilation`].
    pub fn observations(&self) -> Result<ObservationSet, Error> {
        self.observed.set(&self.experiment.grid)
    }

    /// A model of the window.
    pub fn model(&self) -> Box<dyn Model + Send> {
        (self.make_model)(0)
    }

    /// A model of the window with the adaptive time steps that a run ended with.
    pub fn model_with(&self, steps: &AcceptedSteps) -> Box<dyn Model + Send> {
        match &self.adaptive_steps {
            Some(mine) => mine.with_times(&steps.times).factory()(0),
            None => self.model(),
        }
    }
}

/// What an ensemble does without.
pub(crate) fn without_derivatives(scene: &Scene) -> Option<String> {
    let line = "tangent and adjoint: an ensemble of forward runs takes their place";
    scene.algorithm.method.is_ensemble().then(|| line.to_string())
}

/// The scene, where its clock or σ is estimated.
fn adjustable(file: &SceneFile) -> Option<Box<SceneFile>> {
    let estimate = &file.scene.estimate;
    (estimate.clock.is_some() || estimate.observation_sigma.is_some()).then(|| Box::new(file.clone()))
}
