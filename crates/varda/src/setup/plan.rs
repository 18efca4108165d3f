//! What a run of a scene would take, without running anything.

use crate::Error;
use crate::run::cycles::whole;
use crate::scene::{Covariance, Integrator, Model, SceneFile};
use crate::setup::covariance;
use crate::setup::memory::{Memory, Sizes, error_numbers};
use crate::setup::problem::{no_derivatives, places, sightings, sigmas, window};
use crate::setup::rod_model::RodParts;
use crate::setup::rod_observations::Window;

/// Sizes of a scene, and what it leaves out.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Name of the scene.
    pub name: String,
    /// Its title.
    pub title: String,
    /// Its method and what solves it.
    pub method: String,
    /// Length of the state.
    pub n_state: usize,
    /// Length of the control.
    pub n_control: usize,
    /// Numbers of model error in the control beyond it, at most (weak-constraint methods).
    pub n_errors: usize,
    /// Members of the ensemble; 0 where there is none.
    pub members: usize,
    /// Number of observed values that would be assimilated, in all windows of a sequence.
    pub n_obs: usize,
    /// Number of times at which something is observed.
    pub times: usize,
    /// The window; the first of a sequence.
    pub window: Window,
    /// Of a sequence: how many windows, steps from one to the next, steps in all.
    pub cycles: Option<[usize; 3]>,
    /// Steps before it.
    pub spin_up: usize,
    /// Estimate of the memory the run needs \[bytes\].
    pub bytes: usize,
    /// Where `time.tolerance` divides steps: what every part of a step beyond the first adds to that \[bytes\]. Into how many parts a run shows.
    pub bytes_per_part: Option<usize>,
    /// What is left out.
    pub left_out: Vec<String>,
}

impl Plan {
    /// Reads everything a scene names, builds what can be built without a run, and counts.
    ///
    /// # Errors
    /// Those of [`Problem::from_scene`](crate::setup::problem::Problem::from_scene) that do not need a run to be seen.
    pub fn new(file: &SceneFile) -> Result<Plan, Error> {
        let sizes = Sizes::of(file)?;
        let memory = Memory::within_limit(file, &sizes)?;
        let settings = &file.scene.algorithm.cycles;
        let steps = file.scene.time.window;
        let file = &whole(file);
        let scene = &file.scene;
        let window = window(scene);
        let mut left_out = Vec::new();
        let (path, b) = ("background.covariance", &scene.background.covariance);
        match &scene.model {
            Model::Rod(rod) => {
                let parts = RodParts::from_scene(file, rod)?;
                let dynamics = parts.dynamics()?;
                let sightings = sightings(file, parts.rod.length(), &window)?;
                if let Covariance::Kernel(k) = b {
                    // v̄ needs a run; whether B has a root does not depend on it.
                    let sigmas = sigmas(k, parts.rod.length(), 1.0);
                    covariance::localized(file, path, k, &places(&parts, &dynamics), sigmas)?;
                }
                left_out = dynamics.left_out();
                left_out.extend(sightings.left_out);
            }
            model => {
                // A climatology needs a run.
                if !matches!(b, Covariance::Climatology(_)) {
                    covariance::of_components(file, path, b, sizes.state, model.line().as_ref())?;
                }
                if scene.time.integrator == Integrator::Rk4 {
                    left_out.push("factorizations: the steps are explicit".to_string());
                }
            }
        }
        let algorithm = &scene.algorithm;
        left_out.extend(scene.limits.left_out(memory.storage, steps));
        left_out.extend(no_derivatives(scene));
        Ok(Plan {
            name: file.name.clone(),
            title: scene.title.clone(),
            method: format!("{}, {}", algorithm.method.name(), algorithm.solver_name()),
            n_state: sizes.state,
            n_control: sizes.control,
            n_errors: error_numbers(scene, sizes.control),
            members: algorithm.members().map_or(0, |e| e.members),
            n_obs: sizes.values,
            times: sizes.times,
            window: Window { steps, ..window },
            cycles: settings.as_ref().map(|c| [c.count, c.shift_of(steps), window.steps]),
            spin_up: scene.time.spin_up,
            bytes: memory.total(),
            bytes_per_part: scene.time.tolerance.map(|_| 8 * sizes.kept),
            left_out,
        })
    }
}
