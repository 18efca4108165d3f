//! Scenes: opened, checked, run.

use std::path::Path;
use std::time::Instant;

use pyo3::prelude::*;
use varda::Error;
use varda::preview::Preview;
use varda::run::cycles::{CycleListener, Sequence};
use varda::run::{Listener, assimilate, assimilate_recordings};
use varda::scene::{SHIPPED, SceneFile, shipped_scene};
use varda::setup::{Inputs, Problem, Recordings};
use varda_linalg::interrupt::{self, Ends};

use crate::error::{SceneError, raised};
use crate::outcome::{Kind, Outcome, Simulation};
use crate::signals::{Leave, listening};

/// Where a scene comes from.
#[derive(FromPyObject)]
pub(crate) struct Source {
    /// "name": a shipped scene or a path; "text": TOML; "json": the same tables as JSON.
    #[pyo3(item)]
    kind: String,
    #[pyo3(item)]
    text: String,
}

impl Source {
    pub(crate) fn open(&self, overrides: &[String]) -> PyResult<SceneFile> {
        let parse = |text: &str| SceneFile::parse("scene", "scene", text, Some(Path::new("")), overrides);
        let opened = match self.kind.as_str() {
            "name" => SceneFile::open(&self.text, overrides),
            "text" => parse(&self.text),
            _ => {
                let wrong = |e: &dyn std::fmt::Display| SceneError::new_err(format!("scene: {e}"));
                let tables: toml::Table = serde_json::from_str(&self.text).map_err(|e| wrong(&e))?;
                parse(&toml::to_string(&tables).map_err(|e| wrong(&e))?)
            }
        };
        opened.map_err(raised)
    }
}

/// The scene assimilated; written to `out` where that is given.
#[pyfunction]
pub(crate) fn run(
    py: Python<'_>,
    source: Source,
    overrides: Vec<String>,
    out: Option<String>,
) -> PyResult<Outcome> {
    let started = Instant::now();
    let file = source.open(&overrides)?;
    let outcome = listening(py, Leave::Yes, move |ends| {
        let outcome = Outcome(assimilated(&file, ends.clone(), started)?);
        if let Some(folder) = out.filter(|_| !ends()) {
            outcome.store(Path::new(&folder))?;
        }
        Ok(outcome)
    })?;
    outcome.ended()
}

fn assimilated(file: &SceneFile, ends: Ends, started: Instant) -> Result<Kind, Error> {
    let mut listener = Listener {
        on_iteration: Box::new(|_| {}),
        interrupted: Box::new(|| ends()),
        ends: Some(ends.clone()),
        started,
    };
    if file.has_recordings() {
        let all = interrupt::within(ends.clone(), || Recordings::from_scene(file))?;
        return assimilate_recordings(&all, &mut listener).map(|o| Kind::Recordings(Box::new(o)));
    }
    if file.scene.algorithm.cycles.is_some() {
        let done = interrupt::within(ends.clone(), || {
            let Some(sequence) = Sequence::from_scene(file)? else { return Ok(None) };
            let mut listener = CycleListener {
                on_cycle: Box::new(|_, _| Ok(())),
                interrupted: Box::new(|| ends()),
                started,
            };
            sequence.run(sequence.start(), Vec::new(), &mut listener).map(Some)
        })?;
        if let Some(outcome) = done {
            return Ok(Kind::Cycles(Box::new(outcome)));
        }
    }
    let problem = interrupt::within(ends.clone(), || Problem::from_scene(file))?;
    assimilate(&problem, &mut listener).map(|o| Kind::Window(Box::new(o)))
}

/// The scene run forward.
#[pyfunction]
pub(crate) fn simulate(
    py: Python<'_>,
    source: Source,
    overrides: Vec<String>,
    out: Option<String>,
) -> PyResult<Simulation> {
    let started = Instant::now();
    let file = source.open(&overrides)?;
    listening(py, Leave::Yes, move |ends| {
        let simulation = interrupt::within(ends.clone(), || {
            let problem = Problem::new(Inputs::for_simulation(&file.as_one_window())?)?;
            varda::run::simulate(&problem)
        })?;
        let simulation = Simulation { simulation, seconds: started.elapsed().as_secs_f64() };
        if let Some(folder) = out.filter(|_| !ends()) {
            simulation.store(Path::new(&folder))?;
        }
        Ok(simulation)
    })
}

/// What looks wrong: severity, place and text of each finding, errors first.
#[pyfunction]
pub(crate) fn check(
    py: Python<'_>,
    source: Source,
    overrides: Vec<String>,
) -> PyResult<Vec<(&'static str, String, String)>> {
    let file = source.open(&overrides)?;
    let found = listening(py, Leave::Yes, move |ends| {
        interrupt::within(ends, || {
            if !file.has_recordings() {
                return Ok(Preview::new(&file)?.findings);
            }
            let mut found = Vec::new();
            for inputs in Recordings::inputs(&file)? {
                found.extend(Preview::of(inputs)?.findings);
            }
            // what they share must be the same
            Recordings::from_scene(&file)?;
            Ok(found)
        })
    })?;
    let severity = |s| if s == varda::preview::Severity::Error { "error" } else { "warning" };
    Ok(found.into_iter().map(|f| (severity(f.severity), f.place, f.text)).collect())
}

/// The lowest natural modes of the rod of a scene.
#[pyfunction]
pub(crate) fn modes<'py>(
    py: Python<'py>,
    source: Source,
    overrides: Vec<String>,
    count: usize,
) -> PyResult<Bound<'py, pyo3::types::PyDict>> {
    let file = source.open(&overrides)?;
    let modes =
        listening(py, Leave::Yes, move |ends| interrupt::within(ends, || varda::run::modes(&file, count)))?;
    crate::outcome::modes(py, &modes)
}

/// Name and title of the scenes that come with the package.
#[pyfunction]
pub(crate) fn scenes() -> Vec<(&'static str, String)> {
    let title = |text: &str| {
        let line = text.lines().find_map(|l| l.strip_prefix("title = ")).unwrap_or("");
        line.trim_matches('"').to_string()
    };
    SHIPPED.iter().map(|s| (s.name, title(s.text))).collect()
}

/// The TOML text of a scene that comes with the package.
#[pyfunction]
pub(crate) fn show(name: &str) -> PyResult<&'static str> {
    shipped_scene(name).map(|s| s.text).map_err(raised)
}
