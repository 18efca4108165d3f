//! What a run of a scene would take, without running anything.

use varda_implicit::{Footprint, ImplicitStep, Storage, Structure};

use crate::Error;
use crate::covariance;
use crate::cycles::whole;
use crate::problem::{no_derivatives, observed_steps, places, sightings, sigmas, window};
use crate::rod_model::RodParts;
use crate::rod_observation::Window;
use crate::scene::{Covariance, Integrator, Model, Observations, SceneFile};

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
        let settings = &file.scene.algorithm.cycles;
        let steps = file.scene.time.window;
        let file = &whole(file);
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
                    let path = "background.covariance";
                    covariance::localized(file, path, k, &places(&parts, &dynamics), (sigma_x, sigma_v))?;
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
                let n = model.components().unwrap_or(0);
                let (rows, times) = match &scene.observations {
                    Observations::Synthetic(s) => {
                        let rows = if s.components.is_empty() { n } else { s.components.len() };
                        (rows, observed_steps(s, &window).len())
                    }
                    Observations::File(_) => (0, 0),
                };
                let path = "background.covariance";
                let b = &scene.background.covariance;
                // A climatology needs a run.
                if !matches!(b, Covariance::Climatology(_)) {
                    covariance::of_components(file, path, b, n, model.line().as_ref())?;
                }
                let kept = match scene.time.integrator {
                    Integrator::Rk4 => {
                        left_out.push("factorizations: the steps are explicit".to_string());
                        4 * n
                    }
                    // The states and a factor of about six numbers a row: bands, and circles with little fill.
                    _ => 8 * n,
                };
                (n, n, rows * times, times, kept)
            }
        };
        let algorithm = &scene.algorithm;
        let cycles = settings.as_ref().map(|c| [c.count, c.shift_of(steps), window.steps]);
        let (count, all) = cycles.map_or((1, 0), |[count, _, all]| (count, all));
        // What one window sees.
        let seen = n_obs / count;
        let footprint = Footprint { steps, runs: 2, state: 8 * n_state, linearization: 8 * kept };
        let storage = match scene.limits.bytes() {
            Ok(Some(bytes)) => {
                footprint.within(bytes).map_err(|e| file.invalid("limits.memory", e.to_string()))?
            }
            _ => Storage::KeepAll,
        };
        left_out.extend(scene.limits.left_out(storage, steps));
        // States of two runs and what linearized steps keep; the Jacobian of the observations, B's root, the Hessian.
        let mut bytes = footprint.bytes(storage) + 8 * n_control * (seen + 3 * n_control);
        let mut n_errors = 0;
        if let Some(error) = &algorithm.model_error {
            // Each η is as long as the control at most (a truncated root of Q is shorter).
            let parts = steps / error.every;
            n_errors = n_control * if error.held { steps.div_ceil(error.every) } else { parts };
            bytes += 8 * (n_errors * (seen + 8) + steps * n_state + seen * seen);
        }
        let members = algorithm.members();
        if let Some(ensemble) = &members {
            left_out.extend(no_derivatives(scene));
            bytes = 8
                * ((ensemble.members + 1) * (steps + 1) * n_state
                    + 2 * ensemble.members * (seen + n_control)
                    + n_control * n_control);
        }
        // Truth and analysis of a sequence.
        bytes += 16 * all * n_state;
        Ok(Plan {
            name: file.name.clone(),
            title: scene.title.clone(),
            method: format!("{}, {}", algorithm.method.name(), algorithm.solver_name()),
            n_state,
            n_control,
            n_errors,
            members: members.map_or(0, |e| e.members),
            n_obs,
            times,
            window: Window { steps, ..window },
            cycles,
            spin_up: scene.time.spin_up,
            bytes,
            left_out,
        })
    }
}
