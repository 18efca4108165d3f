//! What a run of a scene would take, without running anything.

use serde::Serialize;
use varda_assimilation::Minimizer;

use super::inputs::Inputs;
use super::memory::{Memory, Sizes, error_numbers, is_low_rank, without_spread};
use super::problem::without_derivatives;
use crate::Error;
use crate::scene::{Hessian, Method, Scene, SceneFile, TimeGrid};

/// Sizes of a scene, and what it leaves out.
#[derive(Debug, Clone, PartialEq, Serialize)]
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
    /// How many of them are known: those of a state without error.
    pub n_known: usize,
    /// Whether one shape without times is observed.
    pub is_one_shape: bool,
    /// Numbers of model error in the control beyond it, at most (weak-constraint methods).
    pub n_errors: usize,
    /// Members of the ensemble; 0 where there is none.
    pub members: usize,
    /// Number of observed values that would be assimilated, in all windows of a sequence.
    pub n_obs: usize,
    /// Number of times at which something is observed.
    pub times: usize,
    /// The window; the first of a sequence.
    pub window: TimeGrid,
    /// Of a sequence: how many windows, steps from one to the next, steps in all.
    pub cycles: Option<[usize; 3]>,
    /// Steps before it.
    pub spin_up: usize,
    /// Estimate of the memory the run needs \[bytes\].
    pub bytes: usize,
    /// With adaptive time steps: what each step beyond one in a step of the window adds to `bytes`. Their
    /// number is known only after a run.
    pub bytes_per_part: Option<usize>,
    /// What is left out.
    pub left_out: Vec<String>,
}

impl Plan {
    /// Reads everything a scene names, builds what can be built without a run, and counts.
    ///
    /// # Errors
    /// Those of [`Problem::from_scene`](crate::setup::problem::Problem::from_scene) that do not need a run to
    /// be seen.
    pub fn new(file: &SceneFile) -> Result<Plan, Error> {
        Plan::of(&Inputs::read(file)?)
    }

    /// The same of a scene that has been read.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of(inputs: &Inputs) -> Result<Plan, Error> {
        let file = &inputs.file;
        let sizes = Sizes::of(inputs);
        let memory = Memory::within_limit(file, &sizes)?;
        let settings = &file.scene.algorithm.cycles;
        let steps = file.scene.time.window;
        let scene = &inputs.one_window.scene;
        let (path, b) = ("background.covariance", &scene.background.covariance);
        inputs.system.check_covariance(&inputs.one_window, path, b)?;
        let mut left_out = inputs.system.left_out();
        left_out.extend(inputs.observed.left_out.iter().cloned());
        let algorithm = &scene.algorithm;
        left_out.extend(scene.limits.left_out(memory.storage, steps));
        left_out.extend(without_derivatives(scene));
        left_out.extend(without_spread(scene, sizes.control));
        Ok(Plan {
            name: file.name.clone(),
            title: scene.title.clone(),
            method: format!("{}, {}", algorithm.method.name(), algorithm.solver_name()),
            n_state: sizes.state,
            n_control: sizes.control,
            n_known: match b.is_of_known_state() {
                true => sizes.control - inputs.system.estimates().len(),
                false => 0,
            },
            is_one_shape: algorithm.method == Method::Static,
            n_errors: error_numbers(scene, sizes.control),
            members: algorithm.members().map_or(0, |e| e.members),
            n_obs: sizes.values,
            times: sizes.times,
            window: TimeGrid { steps, ..inputs.grid },
            cycles: settings.as_ref().map(|c| [c.count, c.shift_of(steps), inputs.grid.steps]),
            spin_up: scene.time.spin_up,
            bytes: memory.total(),
            bytes_per_part: scene.time.tolerance.map(|_| 8 * sizes.kept),
            left_out,
        })
    }

    /// The most numbers that go through steps of the window, counted at each, for a dense Hessian of the
    /// scene: a state for each unknown, or for each observed value. `None` where there is no dense Hessian of
    /// sweeps: neither the minimizer nor the posterior has one.
    pub fn dense_numbers(&self, scene: &Scene) -> Option<usize> {
        let (algorithm, n) = (&scene.algorithm, self.n_control + self.n_errors);
        let is_minimized =
            !matches!(algorithm.solver_name(), "outer-loop" | "outer-loop-dual" | "closed-form");
        let settings = algorithm.minimizer.settings();
        let small = match &settings {
            Minimizer::Auto(options) => options.trust_region.dense_limit,
            Minimizer::TrustRegion(options) => options.dense_limit,
            _ => 0,
        };
        let of_minimizer = is_minimized && (settings.is_dense() || n <= small);
        let method = algorithm.method;
        let of_posterior = scene.report.posterior && method.is_strong() && !is_low_rank(method, n);
        let most = if algorithm.hessian == Hessian::Exact { n } else { n.min(self.n_obs) };
        (of_minimizer || of_posterior)
            .then(|| most.saturating_mul(self.window.steps).saturating_mul(self.n_state))
    }
}
