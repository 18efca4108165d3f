//! Window after window of a model written in Python.

use std::ops::ControlFlow;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rand_distr::{Distribution, StandardNormal};
use varda::scene::{Algorithm, Method};
use varda::setup::random::{Stream, stream_of_window};
use varda::solve::minimizer;
use varda_assimilation::{
    Cycle, CycleState, CycledCovariance, CycledEnsemble, CycledErrors, CycledEstimate, CycledInflation,
    CycledMinimizer, CycledUpdate, Cycling, EnVarOptions, Error, Forcing, Normals, ObservationSet, cycle,
};
use varda_covariance::Localization;
use varda_implicit::Model;

use crate::assimilate::{refused, run};
use crate::error::AssimilationError;
use crate::model::{PythonModel, Raised};
use crate::outcome::array;
use crate::problem::{Errors, Problem};
use crate::signals::{Leave, listening};

/// Where a window is, and what it hands on.
#[derive(FromPyObject)]
pub(crate) struct Windows {
    /// Steps from one window to the next.
    #[pyo3(item)]
    shift: usize,
    /// How many windows there are in all.
    #[pyo3(item)]
    count: usize,
    /// "static", "propagated" or "ensemble".
    #[pyo3(item)]
    carry: String,
    /// A factor on standard deviations; `None`: what the innovations ask for.
    #[pyo3(item)]
    inflation: Option<f64>,
    /// β of the static part that is added to a propagated posterior.
    #[pyo3(item)]
    static_weight: f64,
    #[pyo3(item)]
    dropped_variance: f64,
    #[pyo3(item)]
    spread: f64,
    #[pyo3(item)]
    rotation: bool,
    /// Whether members assimilate observations with errors of their own.
    #[pyo3(item)]
    perturbed_observations: bool,
}

/// What one window hands to the next.
#[pyclass(frozen)]
pub(crate) struct Between(CycleState);

#[pymethods]
impl Between {
    /// Index of the next window.
    #[getter]
    fn next(&self) -> usize {
        self.0.next
    }

    /// x_b at its start.
    #[getter]
    fn background<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        array(py, self.0.background.clone(), &[self.0.background.len()])
    }

    /// Members, or columns of a root of B, one a row.
    #[getter]
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.0.background.len();
        array(py, self.0.columns.clone(), &[self.0.columns.len() / n.max(1), n])
    }
}

/// Everything that a window is made of, to be sent to a thread.
struct Setting {
    problem: Problem,
    algorithm: Algorithm,
    windows: Windows,
    b: Errors,
    q: Option<(Errors, Forcing)>,
    localization: Localization,
}

/// The next window of a sequence, from its start or from what the window before left: numbers by name, and
/// what it leaves.
#[pyfunction]
pub(crate) fn cycle_window<'py>(
    py: Python<'py>,
    model: Py<PyAny>,
    problem: Problem,
    windows: Windows,
    state: Option<&Between>,
) -> PyResult<(Bound<'py, PyDict>, Between)> {
    let algorithm = problem.algorithm()?;
    let carries = [("static", false), ("propagated", false), ("ensemble", true)];
    if !carries.contains(&(windows.carry.as_str(), algorithm.method.is_ensemble())) {
        let text = format!(
            "carry {:?} does not go with method {:?}: an ensemble is carried by 4denvar and hybrid-4denvar \
             and by them alone, others take \"static\" or \"propagated\"",
            windows.carry,
            algorithm.method.name()
        );
        return Err(AssimilationError::new_err(text));
    }
    let (n, failed) = (problem.background.len(), Raised::default());
    let of_models = failed.clone();
    let setting = Setting {
        b: problem.errors()?,
        q: problem.model_error.as_ref().map(|e| Ok::<_, PyErr>((e.errors()?, e.forcing()))).transpose()?,
        localization: problem.localization()?,
        algorithm,
        windows,
        problem,
    };
    let mut state = state.map_or_else(|| setting.start(), |between| between.0.clone());
    let ended = match setting.algorithm.method.is_ensemble() {
        false => {
            let make = |first: usize| -> Box<dyn Model + Send> {
                Box::new(PythonModel::new(model.clone_ref(py), n, of_models.clone()).from(first))
            };
            let ended = setting.window(&make, &mut state);
            failed.or(ended.map_err(refused).map(|done| (done, state)))?
        }
        true => {
            let ended = listening(py, Leave::No, move |ends| {
                let make = |first: usize| -> Box<dyn Model + Send> {
                    let object = Python::attach(|py| model.clone_ref(py));
                    let model = PythonModel::new(object, n, of_models.clone()).from(first);
                    Box::new(model.ending(ends.clone()))
                };
                let done = setting.window(&make, &mut state).map_err(varda::Error::Assimilation)?;
                Ok((done, state))
            });
            failed.or_interrupted(py, ended)?
        }
    };
    let ((window, trajectory, erring), state) = ended;
    Ok((as_dict(py, &window, trajectory, erring)?, Between(state)))
}

impl Setting {
    /// Before the first window: the background, and members about it.
    fn start(&self) -> CycleState {
        let background = self.problem.background.clone();
        if !self.algorithm.method.is_ensemble() {
            return CycleState::new(background);
        }
        let mut members = self.problem.members(self.b.covariance());
        let n = background.len();
        let count = (members.len() / n.max(1)) as f64;
        let mean = |i: usize| members.iter().skip(i).step_by(n).sum::<f64>() / count;
        let away: Vec<f64> = background.iter().enumerate().map(|(i, x)| x - mean(i)).collect();
        members.chunks_exact_mut(n).for_each(|x| x.iter_mut().zip(&away).for_each(|(x, a)| *x += a));
        CycleState { next: 0, background, columns: members }
    }

    /// The next window, the run of its analysis, and the number of components that err.
    fn window(
        &self,
        make: &dyn Fn(usize) -> Box<dyn Model + Send>,
        state: &mut CycleState,
    ) -> Result<(Cycle, Vec<f64>, usize), Error> {
        let Setting { problem, algorithm, windows, b, q, .. } = self;
        let normals = |kind: Stream| {
            move |window: usize| -> Normals {
                let mut rng = stream_of_window(problem.seed, kind, window);
                Box::new(move || StandardNormal.sample(&mut rng))
            }
        };
        let [of_members, turns, of_errors] =
            [Stream::Ensemble, Stream::Rotations, Stream::ModelErrors].map(normals);
        let shift = windows.shift;
        let overlap = problem.steps.saturating_sub(shift);
        let observations = |_first: usize| problem.observed();
        let later = state.next > 0 && shift <= problem.steps;
        let anchors = |_: &ObservationSet| problem.anchors(|step| !later || step > overlap);
        let static_part = (windows.static_weight > 0.0).then_some((b.covariance(), windows.static_weight));
        let hybrid = algorithm.method == Method::HybridFourDEnVar;
        let [of_static, of_ensemble] = problem.ensemble.weights;
        let covariance = match windows.carry.as_str() {
            "propagated" => CycledCovariance::Propagated {
                first: b.covariance(),
                inflation: windows.inflation.unwrap_or(1.0),
                static_part,
                dropped: windows.dropped_variance,
            },
            "ensemble" => CycledCovariance::Ensemble(CycledEnsemble {
                inflation: windows.inflation.map_or(CycledInflation::FiniteSize, CycledInflation::Fixed),
                spread: windows.spread,
                rotation: if windows.rotation { Some(&turns) } else { None },
                localization: self.localization.clone(),
                anchors: &anchors,
                static_part: hybrid.then_some((b.covariance(), of_static, of_ensemble)),
                update: match windows.perturbed_observations {
                    true => CycledUpdate::PerturbedObservations(&of_members),
                    false => CycledUpdate::SquareRoot,
                },
                // as in scenes: a hybrid is linearized once, a step of 0.05 σ is below what members resolve
                options: EnVarOptions::default()
                    .with_max_outer(if hybrid { 1 } else { algorithm.max_iterations })
                    .with_step_tolerance(0.05),
            }),
            _ => CycledCovariance::Static(b.covariance()),
        };
        let model_error = q.as_ref().map(|(q, forcing)| CycledErrors {
            q: q.covariance(),
            forcing,
            estimated: match algorithm.method {
                Method::WeakState => CycledEstimate::States { b: b.precision(), q: q.precision() },
                Method::WeakForcing => CycledEstimate::Forcing,
                _ => CycledEstimate::No,
            },
            normals: &of_errors,
        });
        let cycling = Cycling {
            first: 0,
            window: problem.steps,
            shift,
            cycles: windows.count,
            make_model: make,
            observations: &observations,
            truth: None,
            model_error,
            posterior: false,
        };
        let (minimizer, outer) = (minimizer::minimizer(algorithm), minimizer::outer_of(algorithm));
        let minimizer = outer.as_ref().map_or(CycledMinimizer::from(&minimizer), CycledMinimizer::from);
        let done = cycle(&cycling, state, &covariance, minimizer, &mut |_, _| ControlFlow::Break(()))?;
        let none =
            Error::Setting { what: "a sequence of windows that has ended", value: windows.count as f64 };
        let window = done.into_iter().next().ok_or(none)?;
        let forcing = q.as_ref().map(|(_, forcing)| forcing);
        let mut model = make(window.first_step);
        let steps = problem.steps.max(shift);
        let states = run(&mut *model, &window.analysis, steps, forcing, &window.model_errors)?;
        Ok((window, states, forcing.map_or(0, |f| f.components.len())))
    }
}

fn as_dict<'py>(
    py: Python<'py>,
    c: &Cycle,
    trajectory: Vec<f64>,
    erring: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let (out, n) = (PyDict::new(py), c.analysis.len());
    out.set_item("index", c.index)?;
    out.set_item("first_step", c.first_step)?;
    out.set_item("background", array(py, c.background.clone(), &[n])?)?;
    out.set_item("analysis", array(py, c.analysis.clone(), &[n])?)?;
    out.set_item("end", array(py, c.end.clone(), &[n])?)?;
    let sigma = c.sigma.as_ref().map(|sigma| array(py, sigma.clone(), &[n])).transpose()?;
    out.set_item("sigma", sigma)?;
    out.set_item("J", c.value)?;
    out.set_item("terms", (c.terms.background, c.terms.observation, c.terms.model_error))?;
    out.set_item("observations", c.observations)?;
    out.set_item("chi2", c.chi2)?;
    out.set_item("status", varda::outcome::Status::from(c.status).name())?;
    out.set_item("failure", c.failure.as_deref())?;
    out.set_item("inflation", c.inflation)?;
    out.set_item("drawn_again", c.drawn_again)?;
    let rows = |len: usize, n: usize| [len / n.max(1), n];
    out.set_item(
        "model_errors",
        match c.model_errors.is_empty() {
            true => None,
            false => Some(array(py, c.model_errors.clone(), &rows(c.model_errors.len(), erring))?),
        },
    )?;
    let shape = rows(trajectory.len(), n);
    out.set_item("trajectory", array(py, trajectory, &shape)?)?;
    Ok(out)
}
