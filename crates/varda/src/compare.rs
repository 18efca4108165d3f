//! Every method and minimizer that applies to a scene, side by side.

use std::time::Instant;

use serde::Serialize;

use crate::Error;
use crate::problem::Problem;
use crate::run::{ConvergenceRow, Listener, WorkCounts, assimilate};
use crate::scene::{Method, Minimizer, SceneFile};

/// How one method fared. What a method that failed did not reach is not there.
#[derive(Debug, Clone, Serialize)]
pub struct Compared {
    /// The method.
    pub method: &'static str,
    /// Its minimizer, or the loop of its own.
    pub solver: &'static str,
    /// How it ended; "failed" where it could not even begin.
    pub status: &'static str,
    /// J at the end.
    pub j: Option<f64>,
    /// (J − J*)/(J₀ − J*), J₀ at the background and J* the lowest J any row found.
    pub gap: Option<f64>,
    /// RMSE of positions \[m\] (of the state, for other models), where the truth is known.
    pub rmse: Option<f64>,
    /// Seconds of the minimization.
    pub seconds: Option<f64>,
    /// Work of the minimization.
    pub counts: WorkCounts,
    /// Why it failed, or nothing.
    pub reason: String,
    /// Its convergence.
    #[serde(skip)]
    pub convergence: Vec<ConvergenceRow>,
    #[serde(skip)]
    j_background: Option<f64>,
}

impl Compared {
    /// The gap of some J, given that of this row's background and the lowest.
    fn gap_of(&self, j: f64, lowest: f64) -> Option<f64> {
        let whole = self.j_background? - lowest;
        (whole > 0.0 && j.is_finite()).then(|| (j - lowest) / whole)
    }

    /// (seconds, gap) along the way.
    pub fn gaps(&self, lowest: f64) -> Vec<(f64, f64)> {
        self.convergence.iter().filter_map(|r| Some((r.seconds, self.gap_of(r.j, lowest)?))).collect()
    }
}

/// The lowest J of some rows; infinite where all failed.
pub fn lowest(rows: &[Compared]) -> f64 {
    rows.iter().filter_map(|r| r.j).filter(|j| j.is_finite()).fold(f64::INFINITY, f64::min)
}

/// Runs every method that applies to the scene, those that take a minimizer with every minimizer, from the scene's own background, without
/// posterior and without σ stages. Where nothing is observed after step 0 the 3D names stand for their 4D twins, which are then the same.
/// All minimise the same J (with `robust`, only methods that take it apply). `on_row` hears of every row as
/// it is done, its gap still open; `interrupted` ends the comparison with what is done.
///
/// # Errors
/// [`Error`] where the scene itself makes no problem. A method that fails is a row.
pub fn compare(
    file: &SceneFile,
    on_row: &mut dyn FnMut(&Compared),
    interrupted: &dyn Fn() -> bool,
) -> Result<Vec<Compared>, Error> {
    let last_observed = Problem::from_scene(file)?.observations.last_step();
    let mut rows = Vec::new();
    for method in Method::ALL {
        let one_instant = last_observed.unwrap_or(0) == 0;
        let robust = file.scene.algorithm.robust.is_some();
        let right_dimension = method == Method::Blue || method.is_of_one_instant() == one_instant;
        if !right_dimension || (robust && !method.takes_minimizer()) {
            continue;
        }
        let minimizers: &[Minimizer] =
            if method.takes_minimizer() { &Minimizer::ALL } else { &[Minimizer::Auto] };
        for &minimizer in minimizers {
            if interrupted() {
                break;
            }
            let mut file = file.clone();
            file.scene.algorithm.method = method;
            file.scene.algorithm.minimizer = minimizer;
            file.scene.algorithm.sigma_stages.clear();
            file.scene.report.posterior = false;
            let row = one(&file, interrupted);
            on_row(&row);
            rows.push(row);
        }
    }
    let lowest = lowest(&rows);
    for row in &mut rows {
        row.gap = row.j.and_then(|j| row.gap_of(j, lowest));
    }
    Ok(rows)
}

fn one(file: &SceneFile, interrupted: &dyn Fn() -> bool) -> Compared {
    let algorithm = &file.scene.algorithm;
    let mut row = Compared {
        method: algorithm.method.name(),
        solver: algorithm.solver_name(),
        status: "failed",
        j: None,
        gap: None,
        rmse: None,
        seconds: None,
        counts: WorkCounts::default(),
        reason: String::new(),
        convergence: Vec::new(),
        j_background: None,
    };
    let mut listener = Listener { on_iteration: &mut |_| {}, interrupted, started: Instant::now() };
    let outcome = Problem::from_scene(file).and_then(|mut p| assimilate(&mut p, &mut listener));
    match outcome {
        Ok(o) => {
            row.status = o.status.name();
            row.j = Some(o.analysis.value);
            row.rmse = o.rmse.position_analysis;
            row.seconds = Some(o.seconds.minimizer);
            row.counts = o.counts;
            row.reason = match o.status {
                crate::run::Status::Failed => o.warnings.into_iter().find(|w| w.contains("the model fails")),
                _ => None,
            }
            .unwrap_or_default();
            row.convergence = o.convergence;
            row.j_background = Some(o.j_background);
        }
        Err(error) => row.reason = error.to_string(),
    }
    row
}
