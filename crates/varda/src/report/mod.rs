//! What a run leaves behind: summary.json, CSV files, figures and report.html.

pub mod checkpoint;
mod cycles;
mod figures;
pub mod folder;
mod html;
pub mod plot;
mod summary;
mod tables;

pub use cycles::write_cycles;
pub use summary::{Horizon, Summary, Terms};

use std::path::{Path, PathBuf};

use crate::Error;
use crate::report::folder::Output;
use crate::run::compare::Compared;
use crate::run::window::{Outcome, Simulation, Trajectories};
use crate::scene::{Origin, SceneFile};
use crate::setup::problem::{Problem, View};

/// Writes the result of a run to `folder`, whole or not at all.
///
/// # Errors
/// [`Error::Occupied`], [`Error::Write`], [`Error::Plot`].
pub fn write(problem: &mut Problem, outcome: &Outcome, folder: &Path) -> Result<PathBuf, Error> {
    let out = Output::begin(folder)?;
    let summary = Summary::new(problem, outcome);
    let mut drawn = Vec::new();
    for figure in figures::all(problem, outcome)? {
        let svg = figure.svg()?;
        out.write(&format!("figures/{}.svg", figure.name), &svg)?;
        drawn.push((figure.name, figure.title, svg));
    }
    out.write("report.html", &html::page(problem, outcome, &summary, &drawn))?;
    out.write("analysis.csv", &tables::analysis(problem, outcome))?;
    out.write("convergence.csv", &tables::convergence(&outcome.convergence))?;
    out.write("trajectory.csv", &tables::trajectory(problem, &outcome.trajectories)?)?;
    // Last: a folder without it is no result.
    out.write("summary.json", &summary.to_json())?;
    out.publish()
}

/// Writes a comparison to `folder`, whole or not at all: compare.csv, compare.svg, summary.json.
///
/// # Errors
/// As [`write()`].
pub fn write_comparison(
    file: &SceneFile,
    rows: &[Compared],
    interrupted: bool,
    folder: &Path,
) -> Result<PathBuf, Error> {
    let out = Output::begin(folder)?;
    let summary = serde_json::json!({
        "scene": file.name,
        "seed": file.scene.seed,
        "version": env!("CARGO_PKG_VERSION"),
        "method": "compare",
        "status": if interrupted { "interrupted" } else { "converged" },
        "rows": rows,
    });
    out.write("summary.json", &format!("{summary:#}\n"))?;
    out.write("compare.csv", &tables::comparison(rows))?;
    out.write("compare.svg", &figures::comparison(rows).svg()?)?;
    out.publish()
}

/// Writes a forward run to `folder`, whole or not at all: summary.json and trajectory.csv, in which the run stands alone. A rod's twin
/// experiment also leaves its background.csv and observations.csv, as a scene that reads files takes them.
///
/// # Errors
/// As [`write()`].
pub fn write_simulation(
    problem: &mut Problem,
    simulation: &Simulation,
    seconds: f64,
    folder: &Path,
) -> Result<PathBuf, Error> {
    let out = Output::begin(folder)?;
    let summary = serde_json::json!({
        "scene": problem.name,
        "seed": problem.scene.seed,
        "version": env!("CARGO_PKG_VERSION"),
        "method": "simulate",
        "status": "converged",
        "of": simulation.of,
        "n_state": problem.model.dim(),
        "n_control": problem.control_dim(),
        "steps": simulation.steps,
        "counts": simulation.counts,
        "tip_m": simulation.tip,
        "seconds": { "total": seconds },
        "left_out": problem.left_out,
        "warnings": simulation.warnings,
    });
    out.write("summary.json", &format!("{summary:#}\n"))?;
    let runs = Trajectories {
        dim: problem.model.dim(),
        analysis: simulation.states.clone(),
        ..Trajectories::default()
    };
    out.write("trajectory.csv", &tables::trajectory(problem, &runs)?)?;
    if let (View::Rod(rod), Origin::TruthPlusDraw) = (&problem.view, problem.scene.background.from) {
        out.write("background.csv", &tables::background(rod, &problem.background))?;
        out.write("observations.csv", &tables::observations(rod, &problem.window))?;
    }
    out.publish()
}
