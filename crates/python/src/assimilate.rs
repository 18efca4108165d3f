//! Assimilation of models written in Python.

use std::ops::ControlFlow;

use pyo3::prelude::*;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda_assimilation::LinearObservation;
use varda_assimilation::{
    ControlTransform, CostFunction, CostTerms, EnVar, EnVarOptions, Error, InnerSolver, Iteration, Minimizer,
    Minimum, Observation, ObservationOperator, ObservationSet, OuterLoopOptions, Posterior, Selection,
    Status, Stopping, StrongConstraint, outer_loop,
};
use varda_covariance::{Covariance, Dense, Diagonal, Ensemble, Localization, sample};
use varda_implicit::{Keep, Model, Trajectory, check};

use crate::error::{AssimilationError, raised};
use crate::model::{PythonModel, Raised};
use crate::outcome::array;
use crate::signals::{Leave, listening};

/// B: standard deviations alone, or a matrix.
#[derive(Clone)]
enum Background {
    Diagonal(Diagonal),
    Dense(Dense),
}

impl Background {
    /// From n standard deviations, or n² numbers of a matrix.
    fn new(n: usize, numbers: Vec<f64>) -> Result<Self, varda_covariance::Error> {
        match numbers.len() == n {
            true => Diagonal::new(numbers).map(Background::Diagonal),
            false => Dense::new(n, &numbers).map(Background::Dense),
        }
    }

    fn covariance(&self) -> &dyn Covariance {
        match self {
            Background::Diagonal(b) => b,
            Background::Dense(b) => b,
        }
    }
}

/// What is observed at one step.
#[derive(FromPyObject)]
pub(crate) struct Seen {
    #[pyo3(item)]
    step: usize,
    /// Components of the state, or none where `entries` are those of H.
    #[pyo3(item)]
    components: Vec<usize>,
    /// (row, column, value) of H.
    #[pyo3(item)]
    entries: Vec<(usize, usize, f64)>,
    #[pyo3(item)]
    values: Vec<f64>,
    #[pyo3(item)]
    sigma: Vec<f64>,
}

/// What an assimilation is asked for.
#[derive(FromPyObject)]
pub(crate) struct Problem {
    #[pyo3(item)]
    background: Vec<f64>,
    /// σ, or B row by row.
    #[pyo3(item)]
    covariance: Vec<f64>,
    #[pyo3(item)]
    observations: Vec<Seen>,
    /// Length of the window.
    #[pyo3(item)]
    steps: usize,
    #[pyo3(item)]
    method: String,
    #[pyo3(item)]
    minimizer: String,
    #[pyo3(item)]
    gradient_tolerance: f64,
    #[pyo3(item)]
    max_iterations: usize,
    #[pyo3(item)]
    posterior: bool,
    /// Members of an ensemble, one after the other; none: `count` of them are drawn.
    #[pyo3(item)]
    members: Vec<f64>,
    #[pyo3(item)]
    count: usize,
    /// A matrix of correlations, row by row; none: no localization.
    #[pyo3(item)]
    localization: Vec<f64>,
    #[pyo3(item)]
    seed: u64,
}

impl Problem {
    fn set(&self) -> Result<ObservationSet, Error> {
        let n = self.background.len();
        let whole = Selection::new((0..n).collect(), n)?;
        let mut operators: Vec<Box<dyn ObservationOperator>> = vec![Box::new(whole)];
        let mut all = Vec::new();
        for seen in &self.observations {
            let rows = seen.values.len();
            let of = |rows, operator| {
                let observation = Observation::new(seen.step, rows, seen.values.clone(), 1.0);
                observation.sigmas(seen.sigma.clone()).operator(operator)
            };
            if seen.entries.is_empty() {
                all.push(of(seen.components.clone(), 0));
            } else {
                operators.push(Box::new(LinearObservation::new(rows, n, &seen.entries)?));
                all.push(of((0..rows).collect(), operators.len() - 1));
            }
        }
        ObservationSet::new(self.steps, operators, all)
    }

    /// For each observed value the component of the state at its place: the largest of its row of H.
    fn anchors(&self) -> Vec<usize> {
        let of = |seen: &Seen| -> Vec<usize> {
            if seen.entries.is_empty() {
                return seen.components.clone();
            }
            let largest = |row| {
                let entries = seen.entries.iter().filter(|(i, _, _)| *i == row);
                entries.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs())).map_or(0, |entry| entry.1)
            };
            (0..seen.values.len()).map(largest).collect()
        };
        self.observations.iter().flat_map(of).collect()
    }

    fn ensemble(&self, b: &dyn Covariance) -> Result<Ensemble, varda_covariance::Error> {
        let n = self.background.len();
        let localization = match self.localization.is_empty() {
            true => Localization::none(n),
            false => Localization::new(n, &self.localization, 0.01)?,
        };
        if !self.members.is_empty() {
            return Ensemble::new(&self.members, localization);
        }
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let drawn = (0..self.count).flat_map(|_| {
            let error = sample(b, &mut rng);
            self.background.iter().zip(error).map(|(x, e)| x + e).collect::<Vec<f64>>()
        });
        Ensemble::new(&drawn.collect::<Vec<f64>>(), localization)
    }
}

/// The minimum, and what is known there.
struct Found {
    v: Vec<f64>,
    analysis: Vec<f64>,
    sigma_background: Vec<f64>,
    sigma: Option<Vec<f64>>,
    posterior: Option<Posterior>,
    degrees_of_freedom: Option<f64>,
    minimum: Minimum,
    observations: usize,
    trajectory: Vec<f64>,
    history: Vec<[f64; 2]>,
}

/// What an assimilation gives.
#[pyclass(frozen, name = "Analysis")]
pub(crate) struct AnalysisOf {
    background: Vec<f64>,
    covariance: Background,
    found: Found,
}

fn refused(error: Error) -> PyErr {
    raised(varda::Error::Assimilation(error))
}

/// The analysis of a model written in Python.
#[pyfunction]
pub(crate) fn analyse(py: Python<'_>, model: Py<PyAny>, problem: Problem) -> PyResult<AnalysisOf> {
    let of_b = |e: varda_covariance::Error| raised(varda::Error::Covariance(e));
    let n = problem.background.len();
    let covariance = Background::new(n, problem.covariance.clone()).map_err(of_b)?;
    if Minimizer::named(&problem.minimizer).is_none() {
        let names: Vec<&str> = varda::scene::Minimizer::ALL.iter().map(|m| m.name()).collect();
        let text = format!("minimizer {:?} is none of {}", problem.minimizer, names.join(", "));
        return Err(AssimilationError::new_err(text));
    }
    let failed = Raised::default();
    let result = match problem.method.as_str() {
        "4denvar" => {
            let ensemble = problem.ensemble(covariance.covariance()).map_err(of_b)?;
            let (background, of_models) = (problem.background.clone(), failed.clone());
            // members are run on threads of their own
            let found = listening(py, Leave::No, move |ends| {
                let make = || -> Box<dyn Model + Send> {
                    let object = Python::attach(|py| model.clone_ref(py));
                    Box::new(PythonModel::new(object, n, of_models.clone()).ending(ends.clone()))
                };
                of_ensemble(&problem, &make, &ensemble, &of_models).map_err(varda::Error::Assimilation)
            });
            let interrupted = |e: &PyErr| !e.is_instance_of::<AssimilationError>(py);
            return match (failed.take(), found) {
                (_, Err(error)) if interrupted(&error) => Err(error),
                (Some(exception), _) => Err(exception),
                (None, Err(error)) => Err(error),
                (None, Ok(found)) => Ok(AnalysisOf { background, covariance, found }),
            };
        }
        "4dvar" | "4dvar-incremental" | "4d-psas" | "3dvar" => {
            let mut model = PythonModel::new(model, n, failed.clone());
            of_derivatives(&problem, &mut model, covariance.covariance(), &failed)
        }
        other => {
            let text =
                format!("method {other:?} is none of 4dvar, 4dvar-incremental, 4d-psas, 3dvar, 4denvar");
            return Err(AssimilationError::new_err(text));
        }
    };
    match failed.take() {
        Some(exception) => Err(exception),
        None => {
            let found = result.map_err(refused)?;
            Ok(AnalysisOf { background: problem.background, covariance, found })
        }
    }
}

/// By tangent and adjoint.
fn of_derivatives(
    problem: &Problem,
    model: &mut PythonModel,
    b: &dyn Covariance,
    failed: &Raised,
) -> Result<Found, Error> {
    let mut observations = problem.set()?;
    let transform = ControlTransform::new(problem.background.clone(), b)?;
    let stopping = Stopping::new(problem.gradient_tolerance, problem.max_iterations);
    let mut history = Vec::new();
    let mut cost = StrongConstraint::new(&mut *model, transform.clone(), &mut observations)?;
    let mut v = vec![0.0; cost.dim()];
    let mut on_iteration = |i: &Iteration| follow(i, &mut history, failed);
    let inner = match problem.method.as_str() {
        "4dvar-incremental" => Some(InnerSolver::Primal),
        "4d-psas" => Some(InnerSolver::Dual),
        _ => None,
    };
    let minimum = match inner {
        Some(inner) => {
            let options = OuterLoopOptions::default().with_inner(inner).with_stopping(stopping);
            outer_loop(&mut cost, &mut v, &options, &mut on_iteration)?
        }
        None => {
            let minimizer = Minimizer::named(&problem.minimizer).unwrap_or_default();
            minimizer.with_stopping(stopping).minimize(&mut cost, &mut v, &mut on_iteration)?
        }
    };
    let wanted = problem.posterior && minimum.status != Status::Failed && !failed.is_there();
    let posterior = match wanted {
        true => {
            cost.evaluate(&v, Some(&mut vec![0.0; v.len()]))?;
            Some(Posterior::new(&mut cost)?)
        }
        false => None,
    };
    let mut analysis = vec![0.0; transform.control_dim()];
    transform.control(&v, &mut analysis);
    Ok(Found {
        sigma: posterior.as_ref().map(|p| roots(p.variance(&transform))),
        degrees_of_freedom: posterior.as_ref().map(Posterior::degrees_of_freedom),
        sigma_background: deviations(b),
        trajectory: run(model, &analysis, problem.steps)?,
        observations: observations.dim(),
        v,
        analysis,
        posterior,
        minimum,
        history,
    })
}

/// By differences of the members of an ensemble.
fn of_ensemble(
    problem: &Problem,
    make: &dyn Fn() -> Box<dyn Model + Send>,
    ensemble: &Ensemble,
    failed: &Raised,
) -> Result<Found, Error> {
    /// Later linearizations use differences of this fraction of the spread, as those of scenes do.
    const SPREAD: f64 = 1e-3;
    let mut observations = problem.set()?;
    let (mut history, values) = (Vec::new(), observations.dim());
    let background = problem.background.clone();
    let mut cost = EnVar::new(make, background, ensemble, &mut observations, &problem.anchors())?;
    cost.set_spread(SPREAD);
    let mut v = vec![0.0; cost.dim()];
    let transform = cost.transform().clone();
    let options = EnVarOptions::default().with_max_outer(problem.max_iterations.max(1));
    let minimum = cost.minimize(&mut v, &options, &mut |i| follow(i, &mut history, failed))?;
    let (sigma, degrees_of_freedom) = match problem.posterior && !failed.is_there() {
        true => {
            let (variance, freedom) = cost.posterior_variance()?;
            (Some(roots(variance)), Some(freedom))
        }
        false => (None, None),
    };
    let mut analysis = vec![0.0; transform.control_dim()];
    transform.control(&v, &mut analysis);
    Ok(Found {
        sigma,
        degrees_of_freedom,
        sigma_background: deviations(transform.covariance()),
        trajectory: run(make().as_mut(), &analysis, problem.steps)?,
        observations: values,
        v,
        analysis,
        posterior: None,
        minimum,
        history,
    })
}

/// Notes an iteration, and ends the minimization after an exception of the model.
fn follow(i: &Iteration, history: &mut Vec<[f64; 2]>, failed: &Raised) -> ControlFlow<()> {
    history.push([i.value, i.gradient_norm]);
    if failed.is_there() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

fn run(model: &mut dyn Model, x0: &[f64], steps: usize) -> Result<Vec<f64>, Error> {
    let mut trajectory = Trajectory::new();
    trajectory.run(model, x0, steps, Keep::States)?;
    Ok(trajectory.states().to_vec())
}

fn roots(mut variance: Vec<f64>) -> Vec<f64> {
    variance.iter_mut().for_each(|v| *v = v.max(0.0).sqrt());
    variance
}

fn deviations(b: &dyn Covariance) -> Vec<f64> {
    let mut variance = vec![0.0; b.dim()];
    b.variance(&mut variance);
    roots(variance)
}

#[pymethods]
impl AnalysisOf {
    /// Vectors by name: state, background, their σ, and the trajectory.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, pyo3::types::PyDict>> {
        let (out, found, n) = (pyo3::types::PyDict::new(py), &self.found, self.background.len());
        out.set_item("state", array(py, found.analysis.clone(), &[n])?)?;
        out.set_item("background", array(py, self.background.clone(), &[n])?)?;
        out.set_item("sigma_background", array(py, found.sigma_background.clone(), &[n])?)?;
        if let Some(sigma) = &found.sigma {
            out.set_item("sigma", array(py, sigma.clone(), &[n])?)?;
        }
        let steps = found.trajectory.len() / n.max(1);
        out.set_item("trajectory", array(py, found.trajectory.clone(), &[steps, n])?)?;
        let history: Vec<f64> = found.history.iter().flatten().copied().collect();
        out.set_item("history", array(py, history, &[found.history.len(), 2])?)?;
        Ok(out)
    }

    /// How the minimization ended.
    #[getter]
    fn status(&self) -> &'static str {
        varda::outcome::Status::from(self.found.minimum.status).name()
    }

    /// J_b and J_o.
    #[getter]
    fn terms(&self) -> (f64, f64) {
        let CostTerms { background, observation, .. } = self.found.minimum.terms;
        (background, observation)
    }

    /// J.
    #[getter]
    fn value(&self) -> f64 {
        self.found.minimum.value
    }

    /// m.
    #[getter]
    fn observations(&self) -> usize {
        self.found.observations
    }

    /// tr(I − A⁻¹).
    #[getter]
    fn degrees_of_freedom(&self) -> Option<f64> {
        self.found.degrees_of_freedom
    }

    /// P_a, n × n.
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (transform, posterior) = (self.transform()?, self.posterior()?);
        let n = transform.control_dim();
        array(py, posterior.covariance(&transform), &[n, n])
    }

    /// So many draws of N(x_a, P_a), one a row.
    fn draws<'py>(&self, py: Python<'py>, count: usize, seed: u64) -> PyResult<Bound<'py, PyAny>> {
        let (transform, posterior) = (self.transform()?, self.posterior()?);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let draw = |_| posterior.draw(&transform, &self.found.v, &mut rng);
        let draws: Vec<f64> = (0..count).flat_map(draw).collect();
        array(py, draws, &[count, transform.control_dim()])
    }
}

impl AnalysisOf {
    fn transform(&self) -> PyResult<ControlTransform<'_>> {
        ControlTransform::new(self.background.clone(), self.covariance.covariance()).map_err(refused)
    }

    fn posterior(&self) -> PyResult<&Posterior> {
        let none = "there is no posterior covariance: it was not asked for, or the method is 4denvar";
        self.found.posterior.as_ref().ok_or_else(|| AssimilationError::new_err(none))
    }
}

/// Checks of a model: what, number found, bound, whether it passed.
#[pyfunction]
pub(crate) fn check_model(
    model: Py<PyAny>,
    x: Vec<f64>,
    scale: Vec<f64>,
    steps: usize,
    seed: u64,
) -> PyResult<Vec<(String, f64, f64, bool)>> {
    let failed = Raised::default();
    let mut model = PythonModel::new(model, x.len(), failed.clone());
    let report = check::model(&mut model, &x, steps, &scale, seed);
    if let Some(exception) = failed.take() {
        return Err(exception);
    }
    let report = report.map_err(|e| raised(varda::Error::Model(e)))?;
    Ok(report.findings.into_iter().map(|f| (f.what, f.value, f.bound, f.pass)).collect())
}
