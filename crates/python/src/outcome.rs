//! What a run gives: plain data, handed over as arrays.

use std::path::Path;

use numpy::{PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use varda::Error;
use varda::outcome::{
    CyclesOutcome, Estimated, Experiment, JointOutcome, ObservedValue, RodModes, Shapes, Status, Trajectories,
};
use varda::report::{self, JointSummary, Summary};

use crate::error::{ModelError, raised};

/// The result of one window, of window after window, or of several recordings.
pub(crate) enum Kind {
    Window(Box<varda::outcome::Outcome>),
    Cycles(Box<CyclesOutcome>),
    Recordings(Box<JointOutcome>),
}

/// The result of a run.
#[pyclass(frozen)]
pub(crate) struct Outcome(pub(crate) Kind);

impl Outcome {
    /// Writes the folder of the result.
    pub(crate) fn store(&self, folder: &Path) -> Result<(), Error> {
        match &self.0 {
            Kind::Window(o) => report::write(o, folder),
            Kind::Cycles(o) => report::write_cycles(o, folder),
            Kind::Recordings(o) => report::write_recordings(o, folder),
        }
        .map(|_| ())
    }

    /// The result itself, unless the minimization failed.
    pub(crate) fn ended(self) -> PyResult<Outcome> {
        let (status, reason) = match &self.0 {
            Kind::Window(o) => (o.status, o.failure.as_ref().map(ToString::to_string)),
            Kind::Cycles(o) => (o.status, o.failure.clone()),
            Kind::Recordings(o) => (o.status, o.warnings.first().cloned()),
        };
        match status {
            Status::Failed => Err(ModelError::new_err(reason.unwrap_or("the minimizer failed".into()))),
            _ => Ok(self),
        }
    }
}

#[pymethods]
impl Outcome {
    /// "window", "cycles" or "recordings".
    #[getter]
    fn kind(&self) -> &'static str {
        match self.0 {
            Kind::Window(_) => "window",
            Kind::Cycles(_) => "cycles",
            Kind::Recordings(_) => "recordings",
        }
    }

    /// The text of summary.json.
    fn summary(&self) -> String {
        match &self.0 {
            Kind::Window(o) => Summary::new(o).to_json(),
            Kind::Cycles(o) => report::summary_of_cycles(o).to_string(),
            Kind::Recordings(o) => JointSummary::new(o).to_json(),
        }
    }

    /// The windows of a sequence, one after the other, as JSON.
    fn cycles(&self) -> PyResult<String> {
        let rows = match &self.0 {
            Kind::Cycles(o) => o.cycles.as_slice(),
            _ => &[],
        };
        let wrong = |e: serde_json::Error| pyo3::exceptions::PyValueError::new_err(e.to_string());
        serde_json::to_string(rows).map_err(wrong)
    }

    /// Constants that were estimated, as JSON.
    fn estimates(&self) -> PyResult<String> {
        let all: &[Estimated] = match &self.0 {
            Kind::Window(o) => &o.estimates,
            Kind::Cycles(_) => &[],
            Kind::Recordings(o) => &o.estimates,
        };
        let wrong = |e: serde_json::Error| pyo3::exceptions::PyValueError::new_err(e.to_string());
        serde_json::to_string(all).map_err(wrong)
    }

    /// The results of several recordings, by name.
    fn recordings(&self) -> Vec<(String, usize)> {
        match &self.0 {
            Kind::Recordings(o) => {
                let names = o.recordings.iter().map(|one| one.experiment.name.clone());
                names.zip(0..).collect()
            }
            _ => Vec::new(),
        }
    }

    /// Arrays of a window, of the whole sequence, or of one of several recordings.
    #[pyo3(signature = (recording=None))]
    fn arrays<'py>(&self, py: Python<'py>, recording: Option<usize>) -> PyResult<Bound<'py, PyDict>> {
        match (&self.0, recording) {
            (Kind::Window(o), None) => window(py, o),
            (Kind::Recordings(o), Some(r)) if r < o.recordings.len() => window(py, &o.recordings[r]),
            (Kind::Cycles(o), None) => {
                let out = PyDict::new(py);
                control(&out, &o.experiment)?;
                runs(&out, &o.experiment, &o.trajectories, o.shapes.as_ref(), &[])?;
                Ok(out)
            }
            _ => Ok(PyDict::new(py)),
        }
    }

    /// Writes the folder that `varda run` writes.
    fn write(&self, py: Python<'_>, folder: &str) -> PyResult<()> {
        py.detach(|| self.store(Path::new(folder))).map_err(raised)
    }
}

/// A forward run.
#[pyclass(frozen)]
pub(crate) struct Simulation {
    pub(crate) simulation: varda::outcome::Simulation,
    pub(crate) seconds: f64,
}

impl Simulation {
    pub(crate) fn store(&self, folder: &Path) -> Result<(), Error> {
        report::write_simulation(&self.simulation, self.seconds, folder).map(|_| ())
    }
}

#[pymethods]
impl Simulation {
    /// Where the run started: "truth" or "background".
    #[getter]
    fn of(&self) -> &'static str {
        self.simulation.of
    }

    /// Remarks for the user.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.simulation.warnings.clone()
    }

    /// Arrays of the run.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (out, s) = (PyDict::new(py), &self.simulation);
        control(&out, &s.experiment)?;
        runs(&out, &s.experiment, &s.trajectories, s.shapes.as_ref(), &[])?;
        Ok(out)
    }

    /// Writes the folder that `varda simulate` writes.
    fn write(&self, py: Python<'_>, folder: &str) -> PyResult<()> {
        py.detach(|| self.store(Path::new(folder))).map_err(raised)
    }
}

/// Arrays of a rod at rest and of its modes.
pub(crate) fn modes<'py>(py: Python<'py>, modes: &RodModes) -> PyResult<Bound<'py, PyDict>> {
    let (out, found) = (PyDict::new(py), &modes.found);
    let frequencies = found.modes.iter().map(|m| m.frequency().unwrap_or(f64::NAN)).collect();
    out.set_item("frequency", array(py, frequencies, &[found.modes.len()])?)?;
    out.set_item("arc_length", array(py, modes.arc_lengths.clone(), &[modes.arc_lengths.len()])?)?;
    let rest = modes.vertices.iter().flatten().copied().collect();
    out.set_item("rest", array(py, rest, &[modes.vertices.len(), 3])?)?;
    let shapes = found.modes.iter().flat_map(|m| m.displacements.iter().flat_map(|v| [v.x, v.y, v.z]));
    let shapes: Vec<f64> = shapes.collect();
    out.set_item("shape", array(py, shapes, &[found.modes.len(), modes.vertices.len(), 3])?)?;
    out.set_item("unstable", found.unstable)?;
    Ok(out)
}

/// Numbers as an array of some shape.
pub(crate) fn array<'py>(py: Python<'py>, values: Vec<f64>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.into_any())
}

fn window<'py>(py: Python<'py>, o: &varda::outcome::Outcome) -> PyResult<Bound<'py, PyDict>> {
    let (out, a) = (PyDict::new(py), &o.analysis);
    control(&out, &o.experiment)?;
    let vectors = [
        ("analysis", Some(&a.analysis)),
        ("background", Some(&a.background)),
        ("sigma_background", Some(&a.sigma_background)),
        ("sigma_analysis", Some(&a.sigma_analysis).filter(|_| o.has_posterior)),
        ("truth", o.truth.as_ref()),
    ];
    for (name, values) in vectors {
        if let Some(values) = values {
            out.set_item(name, array(py, values.clone(), &[values.len()])?)?;
        }
    }
    runs(&out, &o.experiment, &o.trajectories, o.shapes.as_ref(), &o.sigma_states)?;
    out.set_item("observations", observed(py, &o.observed)?)?;
    Ok(out)
}

/// Names and units of the numbers of the control.
fn control(out: &Bound<'_, PyDict>, experiment: &Experiment) -> PyResult<()> {
    let (names, units): (Vec<&str>, Vec<&str>) = experiment.state.components().unzip();
    out.set_item("names", names)?;
    out.set_item("units", units)?;
    out.set_item("constants", experiment.state.constants.len())
}

/// The runs of a window: the states, and for a rod its vertices. Steps that a run did not come to are NaN.
fn runs(
    out: &Bound<'_, PyDict>,
    experiment: &Experiment,
    runs: &Trajectories,
    shapes: Option<&Shapes>,
    sigma: &[f64],
) -> PyResult<()> {
    let py = out.py();
    let times = experiment.grid.times();
    let (steps, dim) = (times.len(), runs.dim);
    out.set_item("time", array(py, times, &[steps])?)?;
    let all = [("", &runs.analysis), ("_background", &runs.background), ("_truth", &runs.truth)];
    for (name, states) in all.iter().filter(|(_, states)| !states.is_empty()) {
        out.set_item(format!("state{name}"), array(py, whole(states, steps * dim), &[steps, dim])?)?;
    }
    if !sigma.is_empty() {
        out.set_item("sigma_state", array(py, whole(sigma, steps * dim), &[steps, dim])?)?;
    }
    let (Some(shapes), Some(geometry)) = (shapes, &experiment.state.geometry) else { return Ok(()) };
    let s = &geometry.arc_lengths;
    out.set_item("arc_length", array(py, s.clone(), &[s.len()])?)?;
    let shape = [steps, s.len(), 3];
    let places = [&shapes.analysis, &shapes.background, &shapes.truth];
    for ((name, states), places) in all.iter().zip(places).filter(|((_, states), _)| !states.is_empty()) {
        let places: Vec<f64> = places.iter().flatten().flatten().copied().collect();
        let positions = array(py, whole(&places, steps * 3 * s.len()), &shape)?;
        out.set_item(format!("positions{name}"), positions)?;
        let velocities = of_vertices(states, dim, 3 * geometry.free.len(), &geometry.free, s.len(), steps);
        out.set_item(format!("velocities{name}"), array(py, velocities, &shape)?)?;
    }
    if !sigma.is_empty() {
        for (name, first) in [("sigma_positions", 0), ("sigma_velocities", 3 * geometry.free.len())] {
            let values = of_vertices(sigma, dim, first, &geometry.free, s.len(), steps);
            out.set_item(name, array(py, values, &shape)?)?;
        }
    }
    Ok(())
}

/// The numbers, followed by NaN up to a length.
fn whole(values: &[f64], length: usize) -> Vec<f64> {
    let mut out = values[..values.len().min(length)].to_vec();
    out.resize(length, f64::NAN);
    out
}

/// Vectors of the free vertices, which begin there in each state, for all vertices; NaN where one is held.
fn of_vertices(
    states: &[f64],
    dim: usize,
    first: usize,
    free: &[usize],
    vertices: usize,
    steps: usize,
) -> Vec<f64> {
    let mut out = vec![f64::NAN; steps * vertices * 3];
    for (state, out) in states.chunks_exact(dim).zip(out.chunks_exact_mut(3 * vertices)) {
        for (i, v) in free.iter().enumerate() {
            let from = first + 3 * i;
            out[3 * v..3 * v + 3].copy_from_slice(&state[from..from + 3]);
        }
    }
    out
}

/// Everything that was seen, column by column.
fn observed<'py>(py: Python<'py>, values: &[ObservedValue]) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let columns: [(&str, fn(&ObservedValue) -> f64); 6] = [
        ("time", |v| v.time),
        ("value", |v| v.value),
        ("background", |v| v.background),
        ("analysis", |v| v.analysis),
        ("sigma", |v| v.sigma),
        ("sigma_analysis", |v| v.sigma_analysis.unwrap_or(f64::NAN)),
    ];
    for (name, of) in columns {
        out.set_item(name, array(py, values.iter().map(of).collect(), &[values.len()])?)?;
    }
    out.set_item("label", PyList::new(py, values.iter().map(|v| v.label.as_str()))?)?;
    out.set_item("axis", PyList::new(py, values.iter().map(|v| v.axis))?)?;
    out.set_item("used", PyList::new(py, values.iter().map(|v| v.used))?)?;
    out.set_item("reason", PyList::new(py, values.iter().map(|v| v.reason))?)?;
    Ok(out)
}
