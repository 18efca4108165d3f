//! The memory a run takes, counted before anything is built: what `varda check` prints, and `[limits] memory` is held against.
//!
//! Counted is what grows with a scene: B and Q with what building them takes, dense Hessians and Jacobians, states and linearizations of a
//! window, the members of an ensemble, trajectories and their tables. The program itself is some ten megabytes more.

use varda_implicit::{Footprint, ImplicitStep, Storage, Structure};
use varda_rod::RodStep;

use crate::Error;
use crate::run::cycles::whole;
use crate::scene::{Covariance, CycledCovariance, Integrator, Method, Minimizer, Model, Observations, Root};
use crate::scene::{Origin, Scene, SceneFile};
use crate::setup::problem::{observed_steps, sightings, window};
use crate::setup::rod_model::RodParts;

/// Bytes of a number.
const NUMBER: usize = size_of::<f64>();

/// Text of a number in a CSV file, about.
const TEXT: usize = 20;

/// Sizes of a scene, in numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sizes {
    /// Length of the state.
    pub state: usize,
    /// Length of the control.
    pub control: usize,
    /// Observed values, in all windows of a sequence.
    pub values: usize,
    /// Times at which something is observed.
    pub times: usize,
    /// What the model keeps of the linearization of a step.
    pub kept: usize,
    /// Steps of a window (of the model; more than the window has where steps are divided).
    pub steps: usize,
}

/// Bytes a run takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Memory {
    /// B and Q: their roots.
    pub covariance: usize,
    /// What building them takes beyond that, for a time.
    pub building: usize,
    /// Dense Hessians and Jacobians of the method and of the posterior.
    pub dense: usize,
    /// Ensemble, trajectories, tables.
    pub other: usize,
    /// States and linearizations of the window.
    pub window: usize,
    /// What they may take: the limit less everything else.
    pub for_window: usize,
    /// How they are kept.
    pub storage: Storage,
}

impl Memory {
    /// What the scene of a file takes, with the limit it sets; `sizes` are its own.
    ///
    /// # Errors
    /// [`Error::Scene`] at `limits.memory` where it is more than that, naming what takes most.
    pub fn within_limit(file: &SceneFile, sizes: &Sizes) -> Result<Memory, Error> {
        let scene = &file.scene;
        let limit = scene.limits.bytes().map_err(|message| file.invalid("limits.memory", message))?;
        let mut memory = Memory::of(scene, sizes);
        let footprint = footprint(scene, sizes);
        let fixed = Memory { window: 0, ..memory }.total();
        memory.for_window =
            limit.saturating_sub(memory.covariance.saturating_add(memory.dense).saturating_add(memory.other));
        // Only the strong constraint over one window knows how to keep less.
        if scene.algorithm.method.is_strong() && scene.algorithm.cycles.is_none() && fixed < limit {
            memory.storage = footprint.within(memory.for_window).map_err(|e| {
                file.invalid("limits.memory", format!("{e}; all else takes {}", shown(fixed)))
            })?;
            memory.window = footprint.bytes(memory.storage);
        }
        if memory.total() <= limit {
            return Ok(memory);
        }
        let mut parts = [
            ("the background covariance (dense blocks)", memory.covariance + memory.building),
            ("dense Hessians and Jacobians", memory.dense),
            ("ensemble, trajectories and tables", memory.other),
            ("states and linearizations", memory.window),
        ];
        parts.sort_by_key(|(_, bytes)| std::cmp::Reverse(*bytes));
        let parts: Vec<String> = parts
            .iter()
            .filter(|p| p.1 > 0)
            .map(|(what, bytes)| format!("{what} {}", shown(*bytes)))
            .collect();
        let remedy = match scene.report.posterior && memory.dense > limit / 2 {
            true => "; the posterior takes dense matrices, report.posterior = false does without",
            false => "",
        };
        let message = format!(
            "this run takes about {} ({}), more than the limit of {}: raise it with [limits] memory, or make the scene smaller{remedy}",
            shown(memory.total()),
            parts.join(", "),
            shown(limit)
        );
        Err(file.invalid("limits.memory", message))
    }

    /// The most that is held at a time.
    pub fn total(&self) -> usize {
        let run = self.dense.saturating_add(self.other).saturating_add(self.window);
        self.covariance.saturating_add(self.building.max(run))
    }

    /// Where everything of a window is kept.
    fn of(scene: &Scene, sizes: &Sizes) -> Memory {
        let (algorithm, n, m) = (&scene.algorithm, sizes.control, sizes.values / windows(scene));
        let [mut covariance, mut building] = covariance(scene, &scene.background.covariance, n);
        let mut errors = 0;
        if let Some(error) = &algorithm.model_error {
            let q = self::covariance(scene, &error.covariance, n);
            (covariance, building) = (covariance + q[0], building.max(q[1]));
            errors = error_numbers(scene, n);
        }
        let cycled = algorithm.cycles.as_ref().map(|c| c.covariance_of(algorithm.method));
        let posterior = match cycled {
            Some(kind) => kind == CycledCovariance::Propagated,
            None => scene.report.posterior,
        };
        let square = n.saturating_mul(n);
        let dense = if algorithm.method.is_ensemble() {
            0
        } else if algorithm.method.is_weak() {
            // G by parts, and I + G Gᵀ in the space of the observations.
            if posterior { 4 * square + m * (2 * n + errors + m) } else { 0 }
        } else if posterior || algorithm.minimizer == Minimizer::Newton || algorithm.method == Method::Blue {
            // Hessian, its eigenvectors with what finding them takes, the root of P_a; G, and the columns under way through the model.
            5 * square + m * n + m.min(n) * sizes.state
        } else {
            0
        };
        let mut other = 2 * (n + errors) * 8;
        if let Some(ensemble) = algorithm.members() {
            other += (ensemble.members + 1) * (sizes.steps + 1) * sizes.state;
            other += 2 * ensemble.members * (m + n);
        }
        // Background, analysis and truth, and the table of their states.
        let shown = whole_steps(scene) + window(scene).forecast + 1;
        let tables = shown.saturating_mul(sizes.state).saturating_mul(3 * (NUMBER + TEXT));
        let footprint = footprint(scene, sizes);
        Memory {
            covariance: NUMBER * covariance,
            building: NUMBER * building,
            dense: NUMBER.saturating_mul(dense),
            other: (NUMBER * other).saturating_add(tables),
            window: footprint.bytes(Storage::KeepAll),
            for_window: usize::MAX,
            storage: Storage::KeepAll,
        }
    }
}

impl Sizes {
    /// Of a scene, from its keys and files; steps that `time.tolerance` divides count as one part.
    ///
    /// # Errors
    /// Those of what it reads.
    pub fn of(file: &SceneFile) -> Result<Sizes, Error> {
        let steps = file.scene.time.window;
        let file = &whole(file);
        let scene = &file.scene;
        let window = window(scene);
        let synthetic_times = match &scene.observations {
            Observations::Synthetic(s) => observed_steps(s, &window).len(),
            Observations::File(_) => 0,
        };
        match &scene.model {
            Model::Rod(rod) => {
                let parts = RodParts::from_scene(file, rod)?;
                let dynamics = parts.dynamics()?;
                let sightings = sightings(file, parts.rod.length(), &window)?;
                let (values, times) = match &scene.observations {
                    Observations::Synthetic(s) => (3 * s.places.len() * synthetic_times, synthetic_times),
                    Observations::File(_) => {
                        let used = sightings.assimilated(&window);
                        let mut times: Vec<f64> = used.iter().map(|o| o.step as f64 + o.weight).collect();
                        times.sort_by(f64::total_cmp);
                        times.dedup();
                        (used.iter().map(|o| o.rows.len()).sum(), times.len())
                    }
                };
                let [state, control, kept] = [dynamics.dim(), dynamics.control_len(), kept_of_rod(&dynamics)];
                Ok(Sizes { state, control, values, times, kept, steps })
            }
            model => {
                let n = model.components().unwrap_or(0);
                let rows = match &scene.observations {
                    Observations::Synthetic(s) if s.components.is_empty() => n,
                    Observations::Synthetic(s) => s.components.len(),
                    Observations::File(_) => 0,
                };
                let kept = match scene.time.integrator {
                    Integrator::Rk4 => 4 * n,
                    // The states and a factor of about six numbers a row: bands, and circles with little fill.
                    _ => 8 * n,
                };
                let (values, times) = (rows * synthetic_times, synthetic_times);
                Ok(Sizes { state: n, control: n, values, times, kept, steps })
            }
        }
    }
}

/// Numbers that the linearization of a step of a rod keeps.
fn kept_of_rod(dynamics: &RodStep) -> usize {
    let band = match dynamics.structure() {
        Structure::SymmetricBand { half_bandwidth } => half_bandwidth + 1,
        Structure::Band { half_bandwidth } => 2 * half_bandwidth + 1,
        Structure::Dense | Structure::Sparse { .. } => dynamics.unknowns(),
    };
    dynamics.unknowns() * (band + 1) + dynamics.dim()
}

fn footprint(scene: &Scene, sizes: &Sizes) -> Footprint {
    let runs = if scene.algorithm.method.is_ensemble() { 1 } else { 2 };
    Footprint {
        steps: sizes.steps,
        runs,
        state: NUMBER * sizes.state,
        linearization: if scene.algorithm.method.is_ensemble() { 0 } else { NUMBER * sizes.kept },
    }
}

/// Numbers that a covariance of `n` components keeps, and those that building it takes beyond them.
fn covariance(scene: &Scene, covariance: &Covariance, n: usize) -> [usize; 2] {
    let (edge, blocks) = match covariance {
        Covariance::Diagonal(_) => return [2 * n, 0],
        // Positions and velocities, each shared by x, y and z.
        Covariance::Kernel(_) => (n / 6, 2),
        Covariance::Line(_) | Covariance::Climatology(_) => (n, 1),
    };
    let square = edge.saturating_mul(edge);
    let drawn = scene.model_is_rod() && scene.background.from == Origin::TruthPlusDraw;
    let building = match covariance.root() {
        // Matrix, its copy, eigenvectors and what finding them takes; a drawn background has a covariance without taper of its own.
        Root::Truncated => 5,
        Root::Cholesky if drawn => 5 + blocks,
        Root::Cholesky => 2,
    };
    [square.saturating_mul(blocks), square.saturating_mul(building)]
}

/// Numbers of model error in the control of weak-constraint methods, at most: each η is as long as the control (a truncated root of Q is shorter).
pub(crate) fn error_numbers(scene: &Scene, control: usize) -> usize {
    let steps = scene.time.window;
    scene.algorithm.model_error.as_ref().map_or(0, |error| {
        control * if error.held { steps.div_ceil(error.every) } else { steps / error.every }
    })
}

fn windows(scene: &Scene) -> usize {
    scene.algorithm.cycles.as_ref().map_or(1, |c| c.count)
}

/// Steps of a window, or of a sequence of them.
fn whole_steps(scene: &Scene) -> usize {
    let window = scene.time.window;
    scene.algorithm.cycles.as_ref().map_or(window, |c| c.steps(window))
}

/// Bytes in words.
fn shown(bytes: usize) -> String {
    let bytes = bytes as f64;
    match bytes {
        b if b < 1e6 => format!("{:.1} kB", b / 1e3),
        b if b < 1e9 => format!("{:.1} MB", b / 1e6),
        b if b < 1e12 => format!("{:.1} GB", b / 1e9),
        b => format!("{:.1} TB", b / 1e12),
    }
}
