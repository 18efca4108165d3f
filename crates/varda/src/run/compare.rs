//! Every method and minimizer that applies to a scene, side by side.

use serde::Serialize;

use super::window::{Listener, assimilate};
use crate::Error;
use crate::outcome::{ConvergenceRow, Failure, WorkCounts};
use crate::scene::{Method, Minimizer, ModelError, SceneFile};
use crate::setup::Problem;

/// The result of one method. A method that failed has no numbers.
#[derive(Debug, Clone, Serialize)]
pub struct Compared {
    /// The method.
    pub method: &'static str,
    /// Its minimizer, or the name of its own loop.
    pub solver: String,
    /// How it ended; "failed" if it could not begin, "left_out" if it was not tried.
    pub status: &'static str,
    /// J at the end.
    pub j: Option<f64>,
    /// (J − J*)/(J₀ − J*), J₀ at the background and J* the lowest J of any row. Not for the
    /// weak-constraint and ensemble methods, whose J is another function.
    pub gap: Option<f64>,
    /// RMSE of the first group of the state (positions of a rod), where the truth is known.
    pub rmse: Option<f64>,
    /// Seconds of the minimization.
    pub seconds: Option<f64>,
    /// Work of the minimization.
    pub counts: WorkCounts,
    /// Why it failed, or what was assumed for it.
    pub reason: String,
    /// Its convergence.
    #[serde(skip)]
    pub convergence: Vec<ConvergenceRow>,
    #[serde(skip)]
    j_background: Option<f64>,
    /// Whether it minimises the J of strong-constraint 4D-Var.
    #[serde(skip)]
    strong: bool,
}

impl Compared {
    /// A row that has not begun.
    fn blank(method: Method, solver: String) -> Compared {
        Compared {
            method: method.name(),
            solver,
            status: "failed",
            j: None,
            gap: None,
            rmse: None,
            seconds: None,
            counts: WorkCounts::default(),
            reason: String::new(),
            convergence: Vec::new(),
            j_background: None,
            strong: !method.is_weak() && !method.is_ensemble(),
        }
    }

    /// The gap of some J, given that of this row's background and the lowest.
    fn gap_of(&self, j: f64, lowest: f64) -> Option<f64> {
        let whole = self.j_background? - lowest;
        (self.strong && whole > 0.0 && j.is_finite()).then(|| (j - lowest) / whole)
    }

    /// (seconds, gap) along the way.
    pub fn gaps(&self, lowest: f64) -> Vec<(f64, f64)> {
        let whole = self.convergence.last().map(|r| r.window);
        self.convergence
            .iter()
            .filter(|r| Some(r.window) == whole && r.sigma_factor == 1.0)
            .filter_map(|r| Some((r.seconds, self.gap_of(r.j, lowest)?)))
            .collect()
    }
}

/// The lowest J of strong-constraint 4D-Var of some rows; infinite where all failed.
pub fn lowest(rows: &[Compared]) -> f64 {
    rows.iter()
        .filter(|r| r.strong)
        .filter_map(|r| r.j)
        .filter(|j| j.is_finite())
        .fold(f64::INFINITY, f64::min)
}

/// If the scene has no Q, the weak-constraint methods take σ_q = 0.1 σ_b, so Q = 0.01 B, with one η every
/// tenth of the window.
const ASSUMED_ERROR: f64 = 0.1;

/// Dense Newton is skipped above this many unknowns: it would dominate the run time.
const MOST_DENSE: usize = 1000;

/// Runs every method that applies to the scene, those that take a minimizer with every minimizer, from the
/// scene's own background, without posterior, σ stages and growing windows. If the scene has σ stages or a
/// growing window, its own algorithm also runs as it is. If nothing is observed after step 0, the 3D names
/// stand for the equivalent 4D methods.
///
/// All minimise the same J (with `robust`, only methods that take it apply), except the weak-constraint and
/// the ensemble methods: those have no gap and are compared by RMSE. Weak-constraint methods take the scene's
/// Q, or Q = 0.01 B; ensembles the scene's or the default one. `on_row` is called with every row as it is
/// done, its gap not yet known; `interrupted` ends the comparison with the rows so far.
///
/// # Errors
/// [`Error`] where the scene itself makes no problem. A method that fails is a row.
pub fn compare(
    file: &SceneFile,
    on_row: &mut dyn FnMut(&Compared),
    interrupted: &dyn Fn() -> bool,
) -> Result<Vec<Compared>, Error> {
    let problem = Problem::from_scene(file)?;
    let last_observed = problem.observations()?.last_step();
    let mut rows = Vec::new();
    let mut add = |row: Compared| {
        on_row(&row);
        rows.push(row);
    };
    let mut file = file.clone();
    file.scene.report.posterior = false;
    let algorithm = file.scene.algorithm.clone();
    if !algorithm.sigma_stages.is_empty() || !algorithm.window_growth.is_empty() {
        let solver = format!("{} as in the scene", algorithm.solver_name());
        add(one(&file, Compared::blank(algorithm.method, solver), interrupted));
    }
    file.scene.algorithm.sigma_stages.clear();
    file.scene.algorithm.window_growth.clear();
    for method in Method::ALL {
        let one_instant = last_observed.unwrap_or(0) == 0;
        let right_dimension = method == Method::Blue || method.is_of_one_instant() == one_instant;
        // the same as 3D-Var, but for what its scenes leave out
        let other = if algorithm.method == Method::Static { Method::ThreeDVar } else { Method::Static };
        let said_twice = method == other;
        if !right_dimension || said_twice || (algorithm.robust.is_some() && !method.takes_robust()) {
            continue;
        }
        let mut note = String::new();
        file.scene.algorithm.method = method;
        file.scene.algorithm.model_error = None;
        if method.is_weak() {
            file.scene.algorithm.model_error = algorithm.model_error.clone();
            if algorithm.model_error.is_none() {
                let every = (file.scene.time.window / 10).max(1);
                let covariance = file.scene.background.covariance.scaled(ASSUMED_ERROR);
                note = format!("Q = 0.01 B assumed, every {every} steps");
                file.scene.algorithm.model_error = Some(ModelError { covariance, every, held: false });
            }
        }
        let minimizers: &[Minimizer] =
            if method.takes_minimizer() { Minimizer::ALL } else { &[Minimizer::Auto] };
        for &minimizer in minimizers {
            if interrupted() {
                break;
            }
            let every = file.scene.algorithm.model_error.as_ref().map(|e| e.every);
            let unknowns = problem.control_dim() * (1 + every.map_or(0, |e| file.scene.time.window / e));
            file.scene.algorithm.minimizer = minimizer;
            let blank = Compared::blank(method, file.scene.algorithm.solver_name().to_string());
            if method.is_weak() && minimizer.settings().is_dense() && unknowns > MOST_DENSE {
                let reason = format!("a dense Hessian of {unknowns} unknowns would take too long");
                add(Compared { status: "left_out", reason, ..blank });
            } else {
                add(one(&file, Compared { reason: note.clone(), ..blank }, interrupted));
            }
        }
    }
    let lowest = lowest(&rows);
    for row in &mut rows {
        row.gap = row.j.and_then(|j| row.gap_of(j, lowest));
    }
    Ok(rows)
}

/// Fills in a row that is blank but for its names and its note.
fn one(file: &SceneFile, mut row: Compared, interrupted: &dyn Fn() -> bool) -> Compared {
    let mut listener = Listener { interrupted: Box::new(interrupted), ..Listener::silent() };
    let outcome = Problem::from_scene(file).and_then(|p| assimilate(&p, &mut listener));
    match outcome {
        Ok(o) => {
            row.status = o.status.name();
            row.j = Some(o.analysis.value);
            row.rmse = o.rmse.first().and_then(|g| g.analysis);
            row.seconds = Some(o.seconds.minimizer);
            row.counts = o.counts;
            if let Some(failure @ Failure::Ended { .. }) = &o.failure {
                row.reason = failure.to_string();
            }
            row.convergence = o.convergence;
            row.j_background = Some(o.j_background);
        }
        Err(error) => row.reason = error.to_string(),
    }
    row
}
