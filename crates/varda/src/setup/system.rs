//! What is modelled: a rod or a model of another kind.

use varda_covariance::Covariance;
use varda_implicit::kuramoto::KuramotoSivashinsky;
use varda_implicit::line::Transport;
use varda_implicit::lorenz::Lorenz63;

use super::adaptive_steps::AdaptiveSteps;
use super::component_model::{Equation, Field};
use super::components::ComponentSystem;
use super::covariance::Factored;
use super::ensemble::ComponentPositions;
use super::estimate::Estimates;
use super::files::Files;
use super::rod::RodSystem;
use super::runs::MakeModel;
use crate::Error;
use crate::scene::{self, Draw, Model, SceneFile, TimeGrid};
use crate::state::StateLayout;

/// What is modelled.
pub enum System {
    /// A rod.
    Rod(Box<RodSystem>),
    /// Another model.
    Components(ComponentSystem),
}

impl System {
    /// Reads `[model]` and the files it names.
    pub(crate) fn read(files: &Files, grid: TimeGrid) -> Result<System, Error> {
        let scene = &files.scene.scene;
        let line_step = || files.scene.checked(scene.time.integrator.of_line());
        let equation = match &scene.model {
            Model::Rod(rod) => return Ok(System::Rod(Box::new(RodSystem::read(files, rod, grid)?))),
            Model::Lorenz63(m) => Equation::Lorenz63(Lorenz63 { sigma: m.sigma, rho: m.rho, beta: m.beta }),
            Model::Lorenz96(m) => Equation::Lorenz96 { variables: m.variables, forcing: m.forcing },
            Model::LinearAdvection(m) => {
                let transport = Transport::advection_diffusion(m.line(), m.speed, m.diffusivity);
                Equation::AlongLine { line: m.line(), field: Field::Transport(transport), step: line_step()? }
            }
            Model::Burgers(m) => {
                let transport = Transport::burgers(m.line(), m.viscosity);
                Equation::AlongLine { line: m.line(), field: Field::Transport(transport), step: line_step()? }
            }
            Model::KuramotoSivashinsky(m) => {
                let fronts = KuramotoSivashinsky::new(m.points, m.length);
                Equation::AlongLine { line: m.line(), field: Field::Fronts(fronts), step: line_step()? }
            }
        };
        Ok(System::Components(ComponentSystem::new(files.scene, equation, grid)?))
    }

    /// The rod, for models in space.
    pub fn rod(&self) -> Option<&RodSystem> {
        match self {
            System::Rod(rod) => Some(rod),
            System::Components(_) => None,
        }
    }

    /// What is unknown beside the state.
    pub(crate) fn estimates(&self) -> &Estimates {
        match self {
            System::Rod(rod) => rod.estimates(),
            System::Components(model) => &model.estimates,
        }
    }

    /// The meaning of the numbers of the control.
    pub(crate) fn layout(&self) -> StateLayout {
        match self {
            System::Rod(rod) => rod.layout(),
            System::Components(model) => model.layout(),
        }
    }

    /// Where the components of the control are.
    pub(crate) fn positions(&self) -> ComponentPositions {
        match self {
            System::Rod(rod) => rod.positions(),
            System::Components(model) => model.positions(),
        }
    }

    /// Length of a state, and the numbers that the linearization of a step keeps.
    pub(crate) fn sizes(&self) -> [usize; 2] {
        match self {
            System::Rod(rod) => [rod.state, rod.kept],
            System::Components(model) => [model.names.len() + model.estimates.len(), model.kept],
        }
    }

    /// What the model does without.
    pub(crate) fn left_out(&self) -> Vec<String> {
        match self {
            System::Rod(rod) => rod.left_out().to_vec(),
            System::Components(model) => model.left_out().into_iter().collect(),
        }
    }

    /// The control of a rod at rest at the start of the window, from whose angles its runs start; `None` for
    /// other models.
    pub(crate) fn come_to_rest(&mut self) -> Result<Option<Vec<f64>>, Error> {
        match self {
            System::Rod(rod) => rod.come_to_rest().map(Some),
            System::Components(_) => Ok(None),
        }
    }

    /// The state of the truth of a twin experiment at the start of the window.
    pub(crate) fn truth(&mut self) -> Result<Vec<f64>, Error> {
        match self {
            System::Rod(rod) => rod.truth(),
            System::Components(model) => model.truth(),
        }
    }

    /// Runs from the start of the window have the whole turns of this state.
    pub(crate) fn start_turned_as(&mut self, state: &[f64]) -> Result<(), Error> {
        match self {
            System::Rod(rod) => rod.start_turned_as(state),
            System::Components(_) => Ok(()),
        }
    }

    /// The covariance that the key `path` describes; `reference` is a control of usual speeds.
    pub(crate) fn covariance(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
        reference: &[f64],
    ) -> Result<Factored, Error> {
        match self {
            System::Rod(rod) => rod.covariance(file, path, keys, reference),
            System::Components(model) => model.covariance(file, path, keys),
        }
    }

    /// Fails where the covariance that the key `path` describes has no root, as far as that shows without a
    /// run.
    pub(crate) fn check_covariance(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
    ) -> Result<(), Error> {
        match self {
            System::Rod(rod) => rod.check_covariance(file, path, keys),
            System::Components(model) => model.check_covariance(file, path, keys),
        }
    }

    /// The covariance from which the error of the background is drawn, if that is not B.
    pub(crate) fn drawn_from(
        &self,
        file: &SceneFile,
        path: &str,
        keys: &scene::Covariance,
        reference: &[f64],
    ) -> Result<Option<Box<dyn Covariance>>, Error> {
        match (self, file.scene.background.draw) {
            (System::Rod(rod), Draw::Kernel) => {
                let of_state = Factored::Singular(rod.without_taper(file, path, keys, reference)?);
                match rod.estimates().behind(of_state)? {
                    Factored::Full(c) => Ok(Some(Box::new(c))),
                    Factored::Singular(c) => Ok(Some(c)),
                }
            }
            _ => Ok(None),
        }
    }

    /// Adaptive time steps along the run from a control, if the scene asks for them.
    pub(crate) fn adaptive_steps(
        &self,
        file: &SceneFile,
        control: &[f64],
    ) -> Result<Option<AdaptiveSteps>, Error> {
        match (self, file.scene.time.tolerance) {
            (System::Rod(rod), Some(tolerance)) => rod.adaptive_steps(tolerance, control).map(Some),
            _ => Ok(None),
        }
    }

    /// Makes models with steps of the scene's length.
    pub(crate) fn models(&self) -> MakeModel {
        match self {
            System::Rod(rod) => rod.models(),
            System::Components(model) => model.models(),
        }
    }
}
