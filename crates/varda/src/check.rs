//! What a run of a scene would take, without running anything.

use varda_implicit::{Footprint, ImplicitStep, Storage, Structure};

use crate::Error;
use crate::covariance;
use crate::problem::{observed_steps, places, sightings, sigmas, window};
use crate::rod_model::RodParts;
use crate::rod_observation::Window;
use crate::scene::{Covariance, Model, Observations, SceneFile};

/// Sizes of a scene, and what it leaves out.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Name of the scene.
    pub name: String,
    /// Its title.
    pub title: String,
    /// Length of the state.
    pub n_state: usize,
    /// Length of the control.
    pub n_control: usize,
    /// Number of observed values that would be assimilated.
    pub n_obs: usize,
    /// Number of times at which something is observed.
    pub times: usize,
    /// The window.
    pub window: Window,
    /// Steps before it.
    pub spin_up: usize,
    /// Estimate of the memory the assimilation needs \[bytes\].
    pub bytes: usize,
    /// What is left out.
    pub left_out: Vec<String>,
}

impl Plan {
    /// Reads everything a scene names, builds what can be built without a run, and counts.
    ///
    /// # Errors
    /// Those of [`Problem::from_scene`](crate::problem::Problem::from_scene) that do not need a run to be seen.
    pub fn new(file: &SceneFile) -> Result<Plan, Error> {
        let scene = &file.scene;
        let window = window(scene);
        let mut left_out = Vec::new();
        let (n_state, n_control, n_obs, times, kept) = match &scene.model {
            Model::Rod(rod) => {
                let parts = RodParts::from_scene(file, rod)?;
                let dynamics = parts.dynamics()?;
                let sightings = sightings(file, parts.rod.length(), &window)?;
                if let Covariance::Kernel(k) = &scene.background.covariance {
                    // v̄ needs a run; whether B has a root does not depend on it.
                    let (sigma_x, sigma_v) = sigmas(k, parts.rod.length(), 1.0);
                    covariance::localized(file, k, &places(&parts, &dynamics), sigma_x, sigma_v)?;
                }
                left_out = dynamics.left_out();
                left_out.extend(sightings.left_out.iter().cloned());
                let (n_obs, times) = match &scene.observations {
                    Observations::Synthetic(s) => {
                        let steps = observed_steps(s, &window).len();
                        (3 * s.places.len() * steps, steps)
                    }
                    Observations::File(_) => {
                        let used = sightings.assimilated(&window);
                        let mut times: Vec<f64> = used.iter().map(|o| o.step as f64 + o.weight).collect();
                        times.sort_by(f64::total_cmp);
                        times.dedup();
                        (used.iter().map(|o| o.rows.len()).sum(), times.len())
                    }
                };
                let band = match dynamics.structure() {
                    Structure::SymmetricBand { half_bandwidth } => half_bandwidth + 1,
                    Structure::Band { half_bandwidth } => 2 * half_bandwidth + 1,
                    Structure::Dense | Structure::Sparse { .. } => dynamics.unknowns(),
                };
                let kept = dynamics.unknowns() * (band + 1) + dynamics.dim();
                (dynamics.dim(), dynamics.control_len(), n_obs, times, kept)
            }
            model => {
                let n = match model {
                    Model::Lorenz96(m) => m.variables,
                    _ => 3,
                };
                let (rows, times) = match &scene.observations {
                    Observations::Synthetic(s) => {
                        let rows = if s.components.is_empty() { n } else { s.components.len() };
                        (rows, observed_steps(s, &window).len())
                    }
                    Observations::File(_) => (0, 0),
                };
                left_out.push("factorizations: the steps are explicit".to_string());
                (n, n, rows * times, times, 4 * n)
            }
        };
        let footprint =
            Footprint { steps: window.steps, runs: 2, state: 8 * n_state, linearization: 8 * kept };
        let storage = match scene.limits.bytes() {
            Ok(Some(bytes)) => {
                footprint.within(bytes).map_err(|e| file.invalid("limits.memory", e.to_string()))?
            }
            _ => Storage::KeepAll,
        };
        left_out.extend(scene.limits.left_out(storage, window.steps));
        // States of two runs and what linearized steps keep; the Jacobian of the observations, B's root, the Hessian.
        let bytes = footprint.bytes(storage) + 8 * n_control * (n_obs + 3 * n_control);
        Ok(Plan {
            name: file.name.clone(),
            title: scene.title.clone(),
            n_state,
            n_control,
            n_obs,
            times,
            window,
            spin_up: scene.time.spin_up,
            bytes,
            left_out,
        })
    }
}
