//! Reports of results: summary.json, CSV files, figures and report.html.

pub mod chart;
pub mod checkpoint;
mod comparison;
mod cycles;
mod dataset;
mod described;
mod estimates;
mod figures;
pub mod folder;
mod forces;
mod formats;
mod markup;
mod modes;
mod netcdf;
mod npz;
mod page;
pub mod plot;
mod recordings;
mod run_page;
mod sources;
mod summary;
mod svg;
mod sweep;
mod tables;
mod vtk;

pub use cycles::{summary_of_cycles, write_cycles};
pub use dataset::{Array, Dataset, Values};
pub use recordings::{JointSummary, write_recordings};
pub use summary::{ModelErrorSize, Summary, Terms, WindowAmplification};
pub use sweep::{summary_of_sweep, write_sweep};

use std::path::{Path, PathBuf};

use self::forces::Forces;
use self::formats::write_formats;
use crate::Error;
use crate::outcome::{Experiment, Outcome, RodModes, Shapes, Simulation};
use crate::report::folder::ResultFolder;
use crate::run::compare::Compared;
use crate::scene::SceneFile;

/// Writes the result of a run to `folder`, whole or not at all.
///
/// # Errors
/// [`Error::Occupied`], [`Error::Write`], [`Error::Plot`].
pub fn write(outcome: &Outcome, folder: &Path) -> Result<PathBuf, Error> {
    let out = ResultFolder::begin(folder)?;
    write_one(&out, "", outcome)?;
    out.publish()
}

/// Writes the files of a run, with this in front of their names.
fn write_one(out: &ResultFolder, at: &str, outcome: &Outcome) -> Result<(), Error> {
    let write = |name: &str, text: &str| out.write(&format!("{at}{name}"), text);
    let summary = Summary::new(outcome);
    let figures = figures::all(outcome);
    let mut rod = String::new();
    let covariances = figures::covariances(outcome);
    for figure in figures.iter().chain(covariances.iter().map(|(_, figure)| figure)) {
        let svg = figure.svg()?;
        write(&format!("figures/{}.svg", figure.name), &svg)?;
        if figure.name == "snapshots" {
            rod = svg;
        }
    }
    let experiment = &outcome.experiment;
    plot::write_page(out, at, &run_page::page(outcome, &summary, figures, covariances, &rod))?;
    write("analysis.csv", &tables::analysis(outcome))?;
    if !outcome.convergence.is_empty() {
        write("convergence.csv", &tables::convergence(&outcome.convergence))?;
    }
    let trajectory =
        tables::trajectory(experiment, &outcome.trajectories, &outcome.sigma_states, outcome.shapes.as_ref());
    write("trajectory.csv", &trajectory)?;
    write("observations.csv", &tables::observed_values(&outcome.observed))?;
    if !outcome.estimates.is_empty() {
        write("estimates.csv", &estimates::csv(&outcome.estimates))?;
    }
    if !outcome.sources.is_empty() {
        let text = sources::csv(&outcome.sources, &outcome.sensitivities);
        write("sensitivities.csv", &text)?;
    }
    if let Some(errors) = &outcome.model_errors {
        write("model_error.csv", &tables::model_errors(experiment, errors))?;
    }
    write_forces(&write, experiment, outcome.shapes.as_ref())?;
    write_formats(out, at, &experiment.scene.output, || Dataset::of(outcome))?;
    // Last: a folder without it is not a result.
    write("summary.json", &summary.to_json())
}

/// Writes a comparison to `folder`, whole or not at all: compare.csv, compare.svg, report.html, summary.json.
///
/// # Errors
/// As [`write()`].
pub fn write_comparison(
    file: &SceneFile,
    rows: &[Compared],
    interrupted: bool,
    folder: &Path,
) -> Result<PathBuf, Error> {
    let out = ResultFolder::begin(folder)?;
    let summary = summary_of_comparison(file, rows, interrupted);
    out.write("summary.json", &format!("{summary:#}\n"))?;
    out.write("compare.csv", &tables::comparison(rows))?;
    let figure = figures::comparison(rows);
    out.write("compare.svg", &figure.svg()?)?;
    plot::write_page(&out, "", &comparison::page(file, rows, interrupted, figure))?;
    out.publish()
}

/// summary.json of a comparison.
pub fn summary_of_comparison(file: &SceneFile, rows: &[Compared], interrupted: bool) -> serde_json::Value {
    serde_json::json!({
        "scene": file.name,
        "seed": file.scene.seed,
        "version": env!("CARGO_PKG_VERSION"),
        "method": "compare",
        "status": if interrupted { "interrupted" } else { "converged" },
        "rows": rows,
    })
}

/// Writes the natural modes of a rod to `folder`, whole or not at all: modes.csv with their frequencies,
/// mode_shapes.csv, report.html with a figure of every mode, summary.json.
///
/// # Errors
/// As [`write()`].
pub fn write_modes(modes: &RodModes, folder: &Path) -> Result<PathBuf, Error> {
    let out = ResultFolder::begin(folder)?;
    let summary = summary_of_modes(modes);
    out.write("summary.json", &format!("{summary:#}\n"))?;
    out.write("modes.csv", &modes::frequencies(modes))?;
    out.write("mode_shapes.csv", &modes::shapes(modes))?;
    let figures = modes::figures(modes);
    for (_, figure) in &figures {
        out.write(&format!("figures/{}.svg", figure.name), &figure.svg()?)?;
    }
    plot::write_page(&out, "", &modes::page(modes, figures))?;
    out.publish()
}

/// summary.json of natural modes.
pub fn summary_of_modes(modes: &RodModes) -> serde_json::Value {
    let frequencies: Vec<_> = modes.found.modes.iter().map(varda_rod::Mode::frequency).collect();
    serde_json::json!({
        "scene": modes.name,
        "version": env!("CARGO_PKG_VERSION"),
        "method": "modes",
        "status": "converged",
        "time_s": modes.time,
        "frequencies_hz": frequencies,
        "unstable": modes.found.unstable,
    })
}

/// forces.csv, moments.csv and reactions.csv of a rod.
fn write_forces(
    write: &dyn Fn(&str, &str) -> Result<(), Error>,
    experiment: &Experiment,
    shapes: Option<&Shapes>,
) -> Result<(), Error> {
    let (Some(shapes), Some(geometry)) = (shapes, &experiment.state.geometry) else { return Ok(()) };
    let s = &geometry.arc_lengths;
    let forces = Forces { grid: &experiment.grid, steps: &shapes.forces, sigma: &shapes.sigma_forces };
    write("forces.csv", &forces.edges(s))?;
    if shapes.forces.iter().any(|f| !f.twisting.is_empty()) {
        write("moments.csv", &forces.vertices(s))?;
    }
    if shapes.forces.iter().any(|f| !f.reactions.is_empty()) {
        write("reactions.csv", &forces.supports())?;
    }
    Ok(())
}

/// Writes a forward run to `folder`, whole or not at all: summary.json and the tables of this run alone. For
/// a twin experiment with a rod also background.csv and observations.csv, in the form that a scene reads.
///
/// # Errors
/// As [`write()`].
pub fn write_simulation(simulation: &Simulation, seconds: f64, folder: &Path) -> Result<PathBuf, Error> {
    let out = ResultFolder::begin(folder)?;
    let experiment = &simulation.experiment;
    let summary = summary_of_simulation(simulation, seconds);
    out.write("summary.json", &format!("{summary:#}\n"))?;
    let shapes = simulation.shapes.as_ref();
    out.write("trajectory.csv", &tables::trajectory(experiment, &simulation.trajectories, &[], shapes))?;
    write_forces(&|name, text| out.write(name, text), experiment, shapes)?;
    if let (Some(twin), Some(shapes), Some(geometry)) = (&simulation.twin, shapes, &experiment.state.geometry)
    {
        out.write("background.csv", &tables::background(geometry, twin))?;
        if twin.pixels.is_empty() && twin.readings.is_empty() || !shapes.seen.is_empty() {
            out.write("observations.csv", &tables::observations(shapes, &experiment.grid))?;
        }
        if !twin.pixels.is_empty() {
            out.write("pixels.csv", &tables::pixels(&twin.pixels))?;
        }
        if !twin.readings.is_empty() {
            out.write("readings.csv", &tables::readings(&twin.readings))?;
        }
    }
    write_formats(&out, "", &experiment.scene.output, || Dataset::of_simulation(simulation))?;
    out.publish()
}

/// summary.json of a forward run.
pub fn summary_of_simulation(simulation: &Simulation, seconds: f64) -> serde_json::Value {
    let experiment = &simulation.experiment;
    serde_json::json!({
        "scene": experiment.name,
        "seed": experiment.scene.seed,
        "version": env!("CARGO_PKG_VERSION"),
        "method": "simulate",
        "status": "converged",
        "of": simulation.of,
        "n_state": experiment.n_state,
        "n_control": experiment.n_control(),
        "steps": simulation.steps,
        "counts": simulation.counts,
        "tip_m": simulation.tip(),
        "rms_distance": simulation.rms_distance(),
        "distances": simulation.distances,
        "seconds": { "total": seconds },
        "left_out": experiment.left_out,
        "warnings": simulation.warnings,
    })
}
