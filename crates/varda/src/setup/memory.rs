//! The memory a run takes, counted before anything is built: `varda check` prints it, and it must be below
//! `[limits] memory`.
//!
//! Counted are the program at rest and what grows with a scene: B and Q with what building them takes, dense
//! Hessians and Jacobians, states and linearizations of a window, the members of an ensemble, trajectories
//! and their tables.

use varda_covariance::Taper;
use varda_implicit::line::Ends;
use varda_implicit::{Footprint, Remembered, Storage};

use super::ensemble::steps_of_members;
use super::finer::{Finer, finer};
use super::inputs::Inputs;
use crate::Error;
use crate::scene::{
    Covariance, CycledCovariance, Draw, Format, Hessian, Kernel, Method, Minimizer, Model, Observations,
    Origin, Root, Scene, SceneFile,
};

/// What a process holds beside a scene's own numbers, in bytes: code, stacks, the allocator, an empty report.
/// Measured, as the peak of a run of three unknowns; it differs by 1.5 MB with how many pages of the
/// program's file the system maps.
const AT_REST: usize = 13_800_000;

/// Bytes of a number.
const NUMBER: usize = size_of::<f64>();

/// Most unknowns of a posterior from the dense Hessian (five matrices of this size take 360 MB, eigenvectors
/// a minute); beyond, it is the prior less the directions that Lanczos iterations find.
pub(crate) const LARGEST_DENSE_POSTERIOR: usize = 3000;

/// Products of a low-rank posterior, and vectors it keeps, at most.
pub(crate) const MOST_PRODUCTS: usize = 200;

/// Most columns of a root of the posterior of a weak form that is carried along the window; of more unknowns
/// it is the prior less what was learnt. Of an initial state of more it is not carried: bringing the
/// prior's columns down at every error would take longer than all else.
pub(crate) const MOST_ROOT_COLUMNS: usize = 1000;

/// Where one more observation would help: places looked at, times at which they are seen, and columns of a
/// root, at most (more of either and the answer takes longer than the rest of the diagnostics); and numbers
/// gathered at most, so that fewer times are looked at of a larger root.
pub(crate) const FURTHER_PLACES: usize = 25;
pub(crate) const FURTHER_TIMES: usize = 20;
pub(crate) const FURTHER_COLUMNS: usize = 1000;
pub(crate) const FURTHER_NUMBERS: usize = 2_000_000;

/// Numbers gathered at most for what the uncertainty of a result comes from: columns of the root times
/// values.
pub(crate) const SOURCE_NUMBERS: usize = 5_000_000;

/// Text of a number in a CSV file, about.
const TEXT: usize = 20;
/// So often the arrays of a result are in memory while the NetCDF library writes them: as they are, and three
/// times as planned.
const COPIES_OF_NETCDF: usize = 4;

/// The most that is kept of rows of H' of sensors, and of their columns of constants, in bytes.
const OF_SENSORS: usize = 2 * Remembered::BYTES;

/// What is kept of an observed value beside the linear algebra, in bytes: value, σ, place, label,
/// departures, both predictions and the row of its table.
const OF_A_VALUE: usize = 1000;

/// The same in a sequence of windows of a twin, for each value of all windows, and of the present one again.
const OF_A_CYCLED_VALUE: usize = 450;

/// A row of observations.csv of a sequence, with its text and its part in figures, in bytes.
const OF_A_ROW: usize = 400;

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
    /// Those of them between two steps.
    pub between: usize,
    /// What the model keeps of the linearization of a step.
    pub kept: usize,
    /// Steps of a window.
    pub steps: usize,
    /// Steps of all windows and of the forecast.
    pub shown: usize,
    /// Columns of the root of the localization of an ensemble, about; 0 without one.
    pub localization: usize,
    /// Constants that are estimated, the last numbers of the control.
    pub constants: usize,
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
    /// Ensemble, trajectories, observed values.
    pub other: usize,
    /// Tables as text, written when the dense matrices are gone.
    pub text: usize,
    /// The same estimate on a finer mesh, made while the results of this one are held.
    pub finer: usize,
    /// What it may take: the limit less the results of this one.
    pub for_finer: usize,
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
        let held = memory.covariance.saturating_add(memory.other);
        memory.for_finer = limit.saturating_sub(held);
        // One that is too large is left out of the run, which says so.
        if let Finer::Scene(finer) = file.checked(finer(file))?.within(memory.for_finer)
            && scene.background.from != Origin::TruthPlusDraw
            && let Ok(finer) = Memory::within_limit(&finer.file, &sizes.on_finer_mesh(&finer.file.scene))
        {
            memory.finer = finer.of_run().saturating_add(held);
        }
        let footprint = footprint(scene, sizes);
        let fixed = Memory { window: 0, ..memory }.total();
        let others = AT_REST.saturating_add(memory.covariance).saturating_add(memory.beside_window());
        memory.for_window = limit.saturating_sub(others);
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
            ("the program itself", AT_REST),
            ("the background covariance (dense blocks)", memory.covariance + memory.building),
            ("dense Hessians and Jacobians", memory.dense),
            ("ensemble, trajectories and tables", memory.other + memory.text),
            ("states and linearizations", memory.window),
            ("the estimate on a finer mesh", memory.finer.saturating_sub(memory.of_run())),
        ];
        parts.sort_by_key(|(_, bytes)| std::cmp::Reverse(*bytes));
        let parts: Vec<String> = parts
            .iter()
            .filter(|p| p.1 > 0)
            .map(|(what, bytes)| format!("{what} {}", shown(*bytes)))
            .collect();
        let is_newton = scene.algorithm.minimizer.settings().is_dense();
        let remedy = match scene.report.posterior && memory.dense > limit / 2 && !is_newton {
            true => "; the posterior takes dense matrices, report.posterior = false does without",
            false => "",
        };
        let message = format!(
            "this run takes about {} ({}), more than the limit of {}: raise it with [limits] memory, or make \
             the scene smaller{remedy}",
            shown(memory.total()),
            parts.join(", "),
            shown(limit)
        );
        Err(file.invalid("limits.memory", message))
    }

    /// The most that is held at a time.
    pub fn total(&self) -> usize {
        AT_REST.saturating_add(self.of_run().max(self.finer))
    }

    /// The same without the program, on this mesh.
    fn of_run(&self) -> usize {
        let run = self.beside_window().saturating_add(self.window);
        self.covariance.saturating_add(self.building.max(run))
    }

    /// What a run holds beside B and the window.
    fn beside_window(&self) -> usize {
        self.other.saturating_add(self.dense.max(self.text))
    }

    /// Where everything of a window is kept.
    fn of(scene: &Scene, sizes: &Sizes) -> Memory {
        let (algorithm, n, m) = (&scene.algorithm, sizes.control, sizes.values / windows(scene));
        let [mut covariance, mut building] = covariance(scene, &scene.background.covariance, n);
        let mut errors = 0;
        if let Some(error) = &algorithm.model_error {
            let q = self::covariance(scene, &error.covariance, n);
            (covariance, building) = (covariance + q[0], building.max(q[1]));
            errors = error_columns(scene, n, &error.covariance);
        }
        let cycled = algorithm.cycles.as_ref().map(|c| c.covariance_of(algorithm.method));
        let propagated = cycled == Some(CycledCovariance::Propagated);
        // σ along every window of a sequence, where it can be had
        let along = cycled.is_some() && scene.report.posterior && has_root(algorithm.method, n);
        let posterior = if cycled.is_some() { propagated || along } else { scene.report.posterior };
        let square = n.saturating_mul(n);
        if sizes.localization > 0 {
            // The matrix of distances, its eigenvectors and what finding them takes.
            building = building.max(eigenvectors(n));
            covariance += n.saturating_mul(sizes.localization);
        }
        let ensemble = algorithm.members().map(|e| EnsembleSize::of(scene, e.members, sizes, m));
        let dense = if let Some(ensemble) = &ensemble {
            let of_one = posterior && cycled.is_none();
            ensemble.dense(of_one).saturating_add(if cycled.is_some() { ensemble.carried() } else { 0 })
        } else if scene.background.covariance.is_of_known_state() && !algorithm.method.is_weak() {
            // G, and columns of the length of the control: roots of B and P_a, and what is carried along
            let columns = sizes.constants;
            columns.saturating_mul(4 * n + 3 * sizes.state + 3 * m).saturating_add(5 * columns * columns)
        } else if algorithm.method.is_weak() {
            let carried = match cycled.is_none() || along {
                true => weak_carried(n, n + errors, m, sizes.state),
                false => 0,
            };
            if posterior { weak_posterior(n, n + errors, m).max(carried) } else { 0 }
        } else if algorithm.minimizer.settings().is_dense()
            || algorithm.method == Method::Blue
            || (posterior && (cycled.is_some() || !is_low_rank(algorithm.method, n)))
        {
            // G, and its columns under way through the model.
            let forces =
                matches!(scene.model, Model::Rod(_)) && posterior && !is_low_rank(algorithm.method, n);
            decomposition(algorithm.method, n, m)
                .saturating_add(m.min(n).saturating_mul(sizes.state))
                // σ of a rod's forces: their tangents along the columns of the root at two steps, beside
                // what is left of the Hessian
                .saturating_add(if forces && m >= n { square.saturating_mul(3) } else { 0 })
                // an orthonormal basis of what the columns of the root are in the constants, and what each
                // constant does to forces
                .saturating_add(match posterior {
                    true => sizes.constants.saturating_mul(n.saturating_add(3 * sizes.state)),
                    false => 0,
                })
                // Newton's factor beside the Hessian
                .saturating_add(if algorithm.minimizer == Minimizer::Newton { square } else { 0 })
                // the root that is carried on, cut by its singular values
                .saturating_add(if propagated { square.saturating_mul(9) } else { 0 })
                // what is carried along a window: the columns of the root at two steps
                .saturating_add(if along { n.saturating_mul(2 * sizes.state) } else { 0 })
        } else if posterior {
            // Lanczos vectors, Ritz vectors and the probes.
            (2 * m.min(MOST_PRODUCTS) + 20) * n
        } else {
            0
        };
        let exact = algorithm.hessian == Hessian::Exact;
        let dense = match exact && posterior && !is_low_rank(algorithm.method, n) {
            // beside the root of the other posterior
            true => dense.max(square.saturating_add(eigenvectors(n))),
            false => dense,
        };
        // Vectors of a minimization; what L-BFGS has learnt is kept with the minimum.
        let vectors = 2 * (n + errors) * 8;
        let is_kept = algorithm.minimizer == Minimizer::Lbfgs;
        let (mut other, dense) = if is_kept { (vectors, dense) } else { (0, dense.saturating_add(vectors)) };
        if exact {
            // of every step λ, μ, the path of a perturbation, twice, matrices about as large as the
            // factor (of spins three of them), and two columns of every constant
            let spins = matches!(&scene.model, Model::Rod(rod) if rod.twist_inertia);
            let kept = sizes.kept.saturating_mul(if spins { 3 } else { 1 });
            let step = sizes.state.saturating_mul(6 + 2 * sizes.constants).saturating_add(kept);
            other = other.saturating_add((sizes.steps + 1).saturating_mul(step));
        }
        other = other.saturating_add(ensemble.map_or(0, |e| e.runs()));
        if posterior && cycled.is_none() && algorithm.method.is_strong() && n <= FURTHER_COLUMNS {
            let seen = (3 * FURTHER_PLACES).min(n) * sizes.times.min(FURTHER_TIMES) * n;
            other = other.saturating_add(seen.min(FURTHER_NUMBERS)).saturating_add(square / 2);
            let sources = m.saturating_mul(n);
            other = other.saturating_add(if sources <= SOURCE_NUMBERS { sources } else { 0 });
        }
        let considered = scene.consider.given().len();
        if considered > 0 {
            // the run with these constants, columns along it, and the vectors of conjugate gradients
            let unknowns = match scene.background.covariance.is_of_known_state() {
                true => sizes.constants,
                false => n,
            };
            let run = (sizes.steps + 1 + 12 * considered).saturating_mul(sizes.state);
            other = other.saturating_add(run).saturating_add((unknowns.min(m) + 8).saturating_mul(unknowns));
        }
        // Background, analysis and, of a twin, truth, and the table of their states.
        let (shown, runs) =
            (sizes.shown + 1, 2 + usize::from(scene.background.from == Origin::TruthPlusDraw));
        let states = shown.saturating_mul(sizes.state).saturating_mul(runs);
        // σ of the states of a sequence
        let states = states + if along { shown.saturating_mul(sizes.state) } else { 0 };
        let values = match (&algorithm.cycles, &scene.observations) {
            (None, _) => m.saturating_mul(OF_A_VALUE),
            (Some(_), Observations::Synthetic(_)) => {
                sizes.values.saturating_mul(OF_A_ROW).saturating_add((sizes.values + m) * OF_A_CYCLED_VALUE)
            }
            (Some(_), Observations::File(_)) => sizes.values.saturating_mul(OF_A_ROW),
        };
        // The same as named arrays, with σ and of a rod its forces.
        let beside = if matches!(scene.model, Model::Rod(_)) { 3 } else { 1 };
        // members of the analysis, of the last window of a sequence
        let members = match algorithm.members() {
            Some(e) if scene.report.posterior && scene.output.is_more_than_csv() => {
                let last = if cycled.is_some() { sizes.steps } else { sizes.shown };
                e.members * steps_of_members(e.members, last, sizes.state).len() * sizes.state
            }
            _ => 0,
        };
        let arrays = states
            .saturating_add(members)
            .saturating_add(shown.saturating_mul(sizes.state).saturating_mul(beside));
        let copies = match &scene.output {
            output if output.formats.contains(&Format::Netcdf) => COPIES_OF_NETCDF,
            output => usize::from(output.is_more_than_csv()),
        };
        let second = if exact { Remembered::BYTES } else { 0 };
        let sensors = if scene.observations.sensors().is_empty() { 0 } else { OF_SENSORS + second };
        let footprint = footprint(scene, sizes);
        Memory {
            covariance: NUMBER * covariance,
            building: NUMBER * building,
            dense: NUMBER.saturating_mul(dense),
            other: NUMBER
                .saturating_mul(other.saturating_add(states + members))
                .saturating_add(values + sensors),
            text: states.saturating_mul(TEXT).max(arrays.saturating_mul(copies * NUMBER)),
            finer: 0,
            for_finer: usize::MAX,
            window: footprint.bytes(Storage::KeepAll),
            for_window: usize::MAX,
            storage: Storage::KeepAll,
        }
    }
}

/// Numbers that eigenvectors of a matrix of size n take with the matrix and what finding them takes.
fn eigenvectors(n: usize) -> usize {
    n.saturating_mul(n).saturating_mul(11) / 2
}

/// Numbers that a dense posterior takes, or a method with dense matrices. Of m < n values: the root of P_a,
/// its product with that of B, and the singular vectors of G with what finding them takes. Else the Hessian,
/// its eigenvectors with what finding them takes, the root of P_a, and G; the closed form has G twice. Here
/// and below the counts are fitted to the memory that runs take (`cargo xtask bench memory`).
fn decomposition(method: Method, n: usize, m: usize) -> usize {
    let (square, of_g) = (n.saturating_mul(n), m.saturating_mul(n));
    match m < n {
        true => 3 * square + 3 * of_g + 7 * m * m,
        false if method == Method::Blue => square.saturating_mul(5).saturating_add(of_g.saturating_mul(2)),
        false => square.saturating_mul(5).saturating_add(of_g),
    }
}

/// Numbers that the posterior of a weak form takes, `n` of its `r` unknowns being the initial state: G, its
/// singular vectors with what finding them takes, a whole basis of the observations twice, and P_b; or, of a
/// large initial state and few values, the eigenvectors of P_b.
fn weak_posterior(n: usize, r: usize, m: usize) -> usize {
    let k = r.min(m);
    let of_g = m.saturating_mul(r).saturating_add(r.saturating_mul(k).saturating_mul(7));
    let of_values =
        k.saturating_mul(k).saturating_mul(8).saturating_add(m.saturating_mul(m).saturating_mul(2));
    let of_errors = of_g.saturating_add(of_values).saturating_add(n.saturating_mul(n));
    of_errors.max(eigenvectors(n).saturating_add(m.saturating_mul(r)))
}

/// Whether the posterior of a weak form is carried along the window, of `n` numbers of the initial state.
pub(crate) fn carries_errors(n: usize) -> bool {
    n <= MOST_ROOT_COLUMNS
}

/// Numbers that the posterior of a weak form takes while it is carried along the window, with what comes
/// before: `n` of its `r` unknowns are the initial state.
fn weak_carried(n: usize, r: usize, m: usize, state: usize) -> usize {
    let k = r.min(m);
    if !carries_errors(n) {
        return 0;
    }
    if r <= MOST_ROOT_COLUMNS || m >= r {
        // directions and root, whitened and not; then columns at two steps
        return r.saturating_mul(2 * k + 2 * r).max(r.saturating_mul(r + 2 * state));
    }
    // the columns before and after they are brought down to n
    let columns = k + 2 * n;
    k.saturating_mul(r).saturating_add(columns.saturating_mul(2 * state)).saturating_add(4 * n * n)
}

/// Whether the posterior of a control of `n` unknowns is of low rank.
pub(crate) fn is_low_rank(method: Method, n: usize) -> bool {
    method.is_strong() && n > LARGEST_DENSE_POSTERIOR
}

/// Whether the posterior of a control of `n` unknowns is one that can be carried along a window.
pub(crate) fn has_root(method: Method, n: usize) -> bool {
    !is_low_rank(method, n) && (!method.is_weak() || carries_errors(n))
}

/// What a posterior of low rank leaves out.
pub(crate) fn without_spread(scene: &Scene, n: usize) -> Option<String> {
    let why = if is_low_rank(scene.algorithm.method, n) && !scene.background.covariance.is_of_known_state() {
        format!("of more than {LARGEST_DENSE_POSTERIOR} unknowns the posterior is of low rank")
    } else if scene.algorithm.method.is_weak() && !carries_errors(n) {
        format!("under weak constraint it is computed for at most {MOST_ROOT_COLUMNS} numbers of a state")
    } else {
        return None;
    };
    let of = match scene.algorithm.cycles {
        Some(_) => "along the windows of the sequence",
        None => "of the analysis after the start of the window",
    };
    let line = format!("σ {of}: {why}");
    scene.report.posterior.then_some(line)
}

impl Sizes {
    /// Of the scene on its finer mesh, of a rod with twice the segments.
    fn on_finer_mesh(&self, finer: &Scene) -> Sizes {
        let times = if matches!(finer.model, Model::Rod(_)) { 2 } else { 1 };
        Sizes {
            state: times * self.state,
            control: times * self.control,
            kept: times * self.kept,
            steps: finer.time.window,
            shown: finer.time.window,
            ..*self
        }
    }

    /// The sizes of a scene that has been read; adaptive time steps count as if none were divided.
    pub fn of(inputs: &Inputs) -> Sizes {
        let [values, times] = inputs.observed.sizes(&inputs.grid);
        let [state, kept] = inputs.system.sizes();
        let control = inputs.system.layout().len();
        Sizes {
            state,
            control,
            values,
            times,
            between: inputs.observed.times_between(&inputs.grid),
            kept,
            steps: inputs.file.scene.time.window,
            shown: inputs.grid.last_step(),
            localization: localization(inputs),
            constants: inputs.system.layout().constants.len(),
        }
    }
}

/// Eigenvalues of the localization above a hundredth of the largest: those of waves longer than a third (a
/// fifth, of a triangle) of the localization length, as counted on rings of 40 to 1000.
fn localization(inputs: &Inputs) -> usize {
    let Some(ensemble) = inputs.file.scene.algorithm.members() else { return 0 };
    let waves = match ensemble.localization() {
        Ok(Some(Taper::Triangle { support })) => 4.6 / support,
        Ok(Some(Taper::GaspariCohn { support })) => 3.2 / support,
        _ => return 0,
    };
    let extent = inputs.system.positions().extent();
    ((waves * extent).ceil() as usize).saturating_add(1).min(inputs.system.layout().len())
}

/// What the memory of an ensemble grows with.
struct EnsembleSize<'s> {
    members: usize,
    /// Columns of the static part of a hybrid.
    fixed: usize,
    sizes: &'s Sizes,
    /// Values of a window.
    m: usize,
}

impl EnsembleSize<'_> {
    fn of<'s>(scene: &Scene, members: usize, sizes: &'s Sizes, m: usize) -> EnsembleSize<'s> {
        let fixed = if scene.algorithm.method == Method::HybridFourDEnVar { sizes.control } else { 0 };
        EnsembleSize { members, fixed, sizes, m }
    }

    /// Numbers of its linear algebra: the eigenvectors of G Gᵀ or Gᵀ G, whichever is smaller, with what
    /// finding them takes and, where it is linearized again, the matrix of the iteration before; of more
    /// values than unknowns G and its singular vectors.
    fn dense(&self, posterior: bool) -> usize {
        let n = self.members.saturating_mul(self.sizes.localization.max(1)).saturating_add(self.fixed);
        let (m, of_g) = (self.m, self.m.saturating_mul(n));
        if m <= n {
            let before = if self.fixed == 0 { m.saturating_mul(m) } else { 0 };
            return eigenvectors(m).saturating_add(before);
        }
        match posterior {
            true => of_g.saturating_mul(5).saturating_add(n.saturating_mul(n).saturating_mul(6)),
            false => of_g.saturating_add(eigenvectors(n)),
        }
    }

    /// Numbers of the members that one window hands to the next, and of Y for them.
    fn carried(&self) -> usize {
        self.members.saturating_mul(2 * self.m + 8 * self.sizes.control)
    }

    /// Numbers of the members, twice while they are drawn, of a model, a control and a trajectory each, and
    /// of Y and the static part of G at two points.
    fn runs(&self) -> usize {
        let Sizes { state, control, kept, steps, .. } = *self.sizes;
        let each = (steps + 4) * state + kept + control;
        let members = (self.members + 1).saturating_mul(each).saturating_add(2 * self.members * control);
        members.saturating_add(2 * self.m.saturating_mul(self.members + self.fixed))
    }
}

fn footprint(scene: &Scene, sizes: &Sizes) -> Footprint {
    let runs = if scene.algorithm.method.is_ensemble() { 1 } else { 2 };
    Footprint {
        steps: sizes.steps,
        runs,
        state: NUMBER * sizes.state,
        linearization: if scene.algorithm.method.is_ensemble() { 0 } else { NUMBER * sizes.kept },
        // the states observed between steps
        always: (runs * NUMBER * sizes.state).saturating_mul(sizes.between.div_ceil(windows(scene))),
    }
}

/// Numbers that a covariance of `n` components keeps, and those that building it takes beyond them.
fn covariance(scene: &Scene, covariance: &Covariance, n: usize) -> [usize; 2] {
    let drawn_around_truth =
        scene.background.from == Origin::TruthPlusDraw && scene.background.draw == Draw::Kernel;
    let is_line = || scene.model.line().is_some_and(|line| matches!(line.ends, Ends::Fixed { .. }));
    let (edge, blocks, drawn) = match covariance {
        Covariance::Diagonal(_) => return [2 * n, 0],
        Covariance::Known(_) => return [0, 0],
        // Twelve numbers a place and block; building it keeps two matrices and what is known ahead.
        Covariance::Kernel(k) if k.is_markov() => return [4 * n, 50 * n],
        Covariance::Line(k) if k.is_markov() && is_line() => return [12 * n, 60 * n],
        // Positions and velocities of a rod, each shared by x, y and z.
        Covariance::Kernel(_) => (n / 6, 2, drawn_around_truth),
        Covariance::Line(_) | Covariance::Climatology(_) => (n, 1, false),
    };
    let square = edge.saturating_mul(edge);
    let building = match covariance.root() {
        // Matrix, its copy, eigenvectors and what finding them takes; a drawn background has a covariance
        // without taper of its own.
        Root::Truncated => 5,
        Root::Cholesky if drawn => 5 + blocks,
        Root::Cholesky => 2,
    };
    [square.saturating_mul(blocks), square.saturating_mul(building)]
}

/// Numbers of model error in the control of weak-constraint methods, at most: each η is as long as the
/// control (a truncated root of Q is shorter).
pub(crate) fn error_numbers(scene: &Scene, control: usize) -> usize {
    let steps = scene.time.window;
    scene.algorithm.model_error.as_ref().map_or(0, |error| {
        control * if error.held { steps.div_ceil(error.every) } else { steps / error.every }
    })
}

/// The same with what a truncated root of Q is expected to keep.
fn error_columns(scene: &Scene, control: usize, q: &Covariance) -> usize {
    let (Covariance::Kernel(k), Model::Rod(rod)) = (q, &scene.model) else {
        return error_numbers(scene, control);
    };
    let length = rod.rest_lengths().map_or(f64::INFINITY, |l| l.iter().sum());
    let is_smooth = k.kernel == Kernel::Gaussian && k.localization_length.is_none();
    if !is_smooth || q.root() != Root::Truncated || k.sigma_theta.is_some() {
        return error_numbers(scene, control);
    }
    // The spectrum of the kernel falls as exp(−(π j L/l)²/2), and its ends take two waves more.
    let waves = |correlation: f64| {
        let waves = (2.0 * (1.0 / k.truncation).ln()).sqrt() * length / (std::f64::consts::PI * correlation);
        (waves.ceil() as usize).saturating_add(2).saturating_mul(3)
    };
    let columns = waves(k.correlation_length_x).saturating_add(waves(k.correlation_length_v));
    error_numbers(scene, columns.min(control))
}

fn windows(scene: &Scene) -> usize {
    scene.algorithm.cycles.as_ref().map_or(1, |c| c.count)
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
