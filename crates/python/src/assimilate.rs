//! One window of a model written in Python.

use std::ops::ControlFlow;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda::scene::{Algorithm, Method};
use varda::solve::minimizer;
use varda_assimilation::{
    ControlTransform, CostFunction, CostTerms, EnVar, EnVarOptions, EnsembleUpdate, Error, Forcing,
    Iteration, LeastSquares, Minimum, Posterior, Status, StrongConstraint, WeakForcing, WeakPosterior,
    WeakState,
};
use varda_covariance::{Covariance, Ensemble, Hybrid};
use varda_implicit::{Model, check};

use crate::error::{AssimilationError, raised};
use crate::model::{PythonModel, Raised};
use crate::outcome::array;
use crate::problem::{Errors, Problem, of_covariance};
use crate::signals::{Leave, listening};

/// The covariance of the background's errors that a minimum was found with.
enum Prior {
    Static(Errors),
    Ensemble(Ensemble),
    Hybrid(Errors, Ensemble, [f64; 2]),
}

/// P_a: of the initial state, or of that and the errors of the model.
enum Spread {
    Initial(Posterior),
    Weak(WeakPosterior),
}

/// The minimum, and what is known there.
struct Found {
    analysis: Vec<f64>,
    sigma_background: Vec<f64>,
    sigma: Option<Vec<f64>>,
    spread: Option<Spread>,
    degrees_of_freedom: Option<f64>,
    minimum: Minimum,
    observations: usize,
    trajectory: Vec<f64>,
    /// J and ‖∇J‖.
    history: Vec<[f64; 2]>,
    /// η_j one after the other, and their σ.
    model_errors: [Vec<f64>; 2],
    /// Members about the analysis, one after the other.
    members: Vec<f64>,
}

/// What an assimilation gives.
#[pyclass(frozen, name = "Analysis")]
pub(crate) struct AnalysisOf {
    background: Vec<f64>,
    prior: Prior,
    /// The components that the model errs in.
    erring: usize,
    found: Found,
}

pub(crate) fn refused(error: Error) -> PyErr {
    raised(varda::Error::Assimilation(error))
}

/// The analysis of a model written in Python.
#[pyfunction]
pub(crate) fn analyse(py: Python<'_>, model: Py<PyAny>, problem: Problem) -> PyResult<AnalysisOf> {
    let algorithm = problem.algorithm()?;
    let (b, background) = (problem.errors()?, problem.background.clone());
    let q = problem.model_error.as_ref().map(|e| Ok::<_, PyErr>((e.errors()?, e.forcing()))).transpose()?;
    let (n, failed) = (background.len(), Raised::default());
    let of_models = failed.clone();
    if !algorithm.method.is_ensemble() {
        let mut model = PythonModel::new(model, n, failed.clone());
        let found = of_derivatives(&problem, &algorithm, &mut model, &b, q.as_ref(), &failed);
        let found = failed.or(found.map_err(refused))?;
        let erring = q.map_or(0, |(q, _)| q.covariance().dim());
        return Ok(AnalysisOf { background, prior: Prior::Static(b), erring, found });
    }
    let ensemble = problem.ensemble(b.covariance())?;
    let prior = match algorithm.method {
        Method::HybridFourDEnVar => Prior::Hybrid(b, ensemble, problem.ensemble.weights),
        _ => Prior::Ensemble(ensemble),
    };
    // refused here, not on the thread below
    prior.hybrid().transpose().map_err(of_covariance)?;
    // members are run on threads of their own
    let found = listening(py, Leave::No, move |ends| {
        let make = || -> Box<dyn Model + Send> {
            let object = Python::attach(|py| model.clone_ref(py));
            Box::new(PythonModel::new(object, n, of_models.clone()).ending(ends.clone()))
        };
        let found = of_ensemble(&problem, &algorithm, &make, &prior, &of_models);
        found.map(|found| (found, prior)).map_err(varda::Error::Assimilation)
    });
    let (found, prior) = failed.or_interrupted(py, found)?;
    Ok(AnalysisOf { background, prior, erring: 0, found })
}

/// By tangent and adjoint.
fn of_derivatives(
    problem: &Problem,
    algorithm: &Algorithm,
    model: &mut PythonModel,
    b: &Errors,
    q: Option<&(Errors, Forcing)>,
    failed: &Raised,
) -> Result<Found, Error> {
    let missing = Error::Setting { what: "the covariance of a model error that is not there", value: 0.0 };
    let weak = if algorithm.method.is_weak() { Some(q.ok_or(missing)?) } else { None };
    let mut observations = problem.observed()?;
    let values = observations.dim();
    let transform = ControlTransform::new(problem.background.clone(), b.covariance())?;
    let (mut strong, mut over_forcing, mut over_states);
    let mut v = Vec::new();
    let cost: &mut dyn LeastSquares = match (algorithm.method, weak) {
        (Method::WeakState, Some((q, forcing))) => {
            let (background, forcing) = (problem.background.clone(), forcing.clone());
            let [b, q] = [b, q].map(Errors::precision);
            over_states = WeakState::new(&mut *model, background, b, q, forcing, &mut observations)?;
            v = over_states.background()?;
            &mut over_states
        }
        (_, Some((q, forcing))) => {
            let (transform, q) = (transform.clone(), q.covariance());
            over_forcing = WeakForcing::new(&mut *model, transform, q, forcing.clone(), &mut observations)?;
            &mut over_forcing
        }
        (_, None) => {
            strong = StrongConstraint::new(&mut *model, transform.clone(), &mut observations)?;
            if let Some(delta) = problem.robust {
                strong.set_huber(delta)?;
            }
            &mut strong
        }
    };
    v.resize(cost.dim(), 0.0);
    let (start, mut history) = (v.clone(), Vec::new());
    let minimum = minimizer::minimum(algorithm, cost, &mut v, &mut |i| follow(i, &mut history, failed))?;
    let (mut spread, mut model_errors) = (None, [Vec::new(), Vec::new()]);
    let whole = minimum.status != Status::Failed && !failed.is_there();
    if whole && (problem.posterior || weak.is_some()) {
        // the closed form's P_a is that of its linearization, at the background
        let at = if algorithm.method == Method::Blue { &start } else { &v };
        let mut gradient = vec![0.0; v.len()];
        match weak {
            Some(_) => cost.linearize(at, &mut gradient)?,
            // Huber's norm has no linearization, but a posterior
            None => cost.evaluate(at, Some(&mut gradient))?,
        };
    }
    if let (true, Some((q, _))) = (whole, weak) {
        model_errors[0] = errors_at(cost, q.covariance());
    }
    if whole && problem.posterior {
        spread = Some(match weak {
            None => Spread::Initial(Posterior::new(cost)?),
            Some((q, _)) => {
                let (posterior, q) = (WeakPosterior::new(cost)?, q.covariance());
                let count = model_errors[0].len() / q.dim().max(1);
                model_errors[1] = (0..count).flat_map(|j| roots(posterior.error_variance(q, j))).collect();
                Spread::Weak(posterior)
            }
        });
    }
    let mut analysis = vec![0.0; transform.control_dim()];
    match algorithm.method {
        Method::WeakState => analysis.copy_from_slice(&v[..problem.background.len()]),
        _ => transform.control(&v[..transform.dim()], &mut analysis),
    }
    let posterior = spread.as_ref().map(Spread::of_initial_state);
    Ok(Found {
        sigma: posterior.map(|p| roots(p.variance(&transform))),
        degrees_of_freedom: posterior.map(Posterior::degrees_of_freedom),
        sigma_background: deviations(b.covariance()),
        trajectory: run(model, &analysis, problem.steps, weak.map(|(_, f)| f), &model_errors[0])?,
        observations: values,
        analysis,
        spread,
        minimum,
        history,
        model_errors,
        members: Vec::new(),
    })
}

/// By differences of the members of an ensemble.
fn of_ensemble(
    problem: &Problem,
    algorithm: &Algorithm,
    make: &dyn Fn() -> Box<dyn Model + Send>,
    prior: &Prior,
    failed: &Raised,
) -> Result<Found, Error> {
    /// Later linearizations use differences of this fraction of the spread, as those of scenes do.
    const SPREAD: f64 = 1e-3;
    /// Directions of a control whose posterior is kept for draws: a square matrix of 32 MB.
    const MOST: usize = 2000;
    let mut observations = problem.observed()?;
    let (mut history, values) = (Vec::new(), observations.dim());
    let (background, anchors) = (problem.background.clone(), problem.anchors(|_| true));
    let hybrid = prior.hybrid().transpose()?;
    let mut cost = match (prior, &hybrid) {
        (_, Some(hybrid)) => EnVar::hybrid(make, background, hybrid, &mut observations, &anchors)?,
        (Prior::Ensemble(ensemble), _) => {
            EnVar::new(make, background, ensemble, &mut observations, &anchors)?
        }
        _ => return Err(Error::Setting { what: "an ensemble of no members", value: 0.0 }),
    };
    cost.set_spread(SPREAD);
    let mut v = vec![0.0; cost.dim()];
    let transform = cost.transform().clone();
    // The static part's increment is constant through the window: a second linearization has no minimum.
    let outer = if hybrid.is_some() { 1 } else { algorithm.max_iterations.max(1) };
    let options = EnVarOptions::default().with_max_outer(outer);
    let minimum = cost.minimize(&mut v, &options, &mut |i| follow(i, &mut history, failed))?;
    let mut analysis = vec![0.0; transform.control_dim()];
    transform.control(&v, &mut analysis);
    let (mut sigma, mut degrees_of_freedom, mut spread, mut members) = (None, None, None, Vec::new());
    if problem.posterior && !failed.is_there() {
        let (variance, freedom) = cost.posterior_variance()?;
        (sigma, degrees_of_freedom) = (Some(roots(variance)), Some(freedom));
        if v.len() <= MOST {
            spread = Some(Spread::Initial(Posterior::new(&mut cost)?));
        }
        members = cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot)?;
        let size = ((members.len() / analysis.len().max(1)).saturating_sub(1) as f64).sqrt();
        for member in members.chunks_exact_mut(analysis.len().max(1)) {
            member.iter_mut().zip(&analysis).for_each(|(x, mean)| *x = mean + size * *x);
        }
    }
    Ok(Found {
        sigma,
        degrees_of_freedom,
        sigma_background: deviations(transform.covariance()),
        trajectory: run(make().as_mut(), &analysis, problem.steps, None, &[])?,
        observations: values,
        analysis,
        spread,
        minimum,
        history,
        model_errors: [Vec::new(), Vec::new()],
        members,
    })
}

/// Notes an iteration, and ends the minimization after an exception of the model.
fn follow(i: &Iteration, history: &mut Vec<[f64; 2]>, failed: &Raised) -> ControlFlow<()> {
    history.push([i.value, i.gradient_norm]);
    if failed.is_there() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

/// η_j = Q^{1/2} p_j of the point that `cost` is linearized about.
fn errors_at(cost: &dyn LeastSquares, q: &dyn Covariance) -> Vec<f64> {
    let (mut p, mut d) = (vec![0.0; cost.dim()], vec![0.0; cost.observation_dim()]);
    cost.departures(&mut p, &mut d);
    let p = p[cost.background_dim()..].chunks_exact(q.root_dim().max(1));
    let mut eta = vec![0.0; p.len() * q.dim()];
    p.zip(eta.chunks_exact_mut(q.dim().max(1))).for_each(|(p, eta)| q.root(p, eta));
    eta
}

/// The states from x₀ on, with the errors of the model that were found.
pub(crate) fn run(
    model: &mut dyn Model,
    x0: &[f64],
    steps: usize,
    forcing: Option<&Forcing>,
    eta: &[f64],
) -> Result<Vec<f64>, Error> {
    let (mut x, mut next) = (x0.to_vec(), x0.to_vec());
    let mut states = x.clone();
    for k in 0..steps {
        model.step(k, &x, &mut next)?;
        if let Some(forcing) = forcing {
            let size = forcing.components.len();
            let error = forcing.index(k).and_then(|j| eta.get(j * size..(j + 1) * size));
            forcing.components.iter().zip(error.unwrap_or(&[])).for_each(|(&c, eta)| next[c] += eta);
        }
        std::mem::swap(&mut x, &mut next);
        states.extend_from_slice(&x);
    }
    Ok(states)
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

impl Spread {
    fn of_initial_state(&self) -> &Posterior {
        match self {
            Spread::Initial(posterior) => posterior,
            Spread::Weak(posterior) => posterior.initial(),
        }
    }
}

impl Prior {
    /// The hybrid covariance, of a prior that is one.
    fn hybrid(&self) -> Option<Result<Hybrid<'_>, varda_covariance::Error>> {
        match self {
            Prior::Hybrid(b, ensemble, [of_static, of_ensemble]) => {
                Some(Hybrid::new(b.covariance(), *of_static, ensemble.clone(), *of_ensemble))
            }
            _ => None,
        }
    }
}

#[pymethods]
impl AnalysisOf {
    /// Vectors by name: state, background, their σ, the trajectory; members and errors of the model.
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (out, found, n) = (PyDict::new(py), &self.found, self.background.len());
        let add = |name: &str, values: &[f64], shape: &[usize]| {
            out.set_item(name, array(py, values.to_vec(), shape)?)
        };
        add("state", &found.analysis, &[n])?;
        add("background", &self.background, &[n])?;
        add("sigma_background", &found.sigma_background, &[n])?;
        if let Some(sigma) = &found.sigma {
            add("sigma", sigma, &[n])?;
        }
        let rows = |values: &[f64], n: usize| [values.len() / n.max(1), n];
        add("trajectory", &found.trajectory, &rows(&found.trajectory, n))?;
        add("history", &found.history.concat(), &[found.history.len(), 2])?;
        let named = ["model_errors", "sigma_model_errors"].into_iter().zip(&found.model_errors);
        for (name, values) in named.filter(|(_, values)| !values.is_empty()) {
            add(name, values, &rows(values, self.erring))?;
        }
        if !found.members.is_empty() {
            add("members", &found.members, &rows(&found.members, n))?;
        }
        Ok(out)
    }

    /// How the minimization ended.
    #[getter]
    fn status(&self) -> &'static str {
        varda::outcome::Status::from(self.found.minimum.status).name()
    }

    /// J_b, J_o and J_q.
    #[getter]
    fn terms(&self) -> (f64, f64, f64) {
        let CostTerms { background, observation, model_error } = self.found.minimum.terms;
        (background, observation, model_error)
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
        let n = self.background.len();
        let covariance = self.by_posterior(|posterior, transform| posterior.covariance(transform))?;
        array(py, covariance, &[n, n])
    }

    /// So many draws of N(x_a, P_a), one a row.
    fn draws<'py>(&self, py: Python<'py>, count: usize, seed: u64) -> PyResult<Bound<'py, PyAny>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let draws: Vec<f64> = self.by_posterior(|posterior, transform| {
            let none = vec![0.0; transform.dim()];
            let draw = |_| {
                // about the background, moved to the analysis
                let mut x = posterior.draw(transform, &none, &mut rng);
                let to = self.found.analysis.iter().zip(&self.background);
                x.iter_mut().zip(to).for_each(|(x, (a, b))| *x += a - b);
                x
            };
            (0..count).flat_map(draw).collect()
        })?;
        array(py, draws, &[count, self.background.len()])
    }
}

impl AnalysisOf {
    /// Something of P_a, which is in the control variable of the prior.
    fn by_posterior<T>(&self, of: impl FnOnce(&Posterior, &ControlTransform) -> T) -> PyResult<T> {
        let none = "there is no posterior covariance: it was not asked for, or the ensemble has too many \
                    directions";
        let spread = self.found.spread.as_ref().ok_or_else(|| AssimilationError::new_err(none))?;
        let hybrid = self.prior.hybrid().transpose().map_err(of_covariance)?;
        let b: &dyn Covariance = match (&self.prior, &hybrid) {
            (_, Some(hybrid)) => hybrid,
            (Prior::Static(b) | Prior::Hybrid(b, ..), _) => b.covariance(),
            (Prior::Ensemble(ensemble), _) => ensemble,
        };
        let transform = ControlTransform::new(self.background.clone(), b).map_err(refused)?;
        Ok(of(spread.of_initial_state(), &transform))
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
    let report = failed.or(report.map_err(|e| raised(varda::Error::Model(e))))?;
    Ok(report.findings.into_iter().map(|f| (f.what, f.value, f.bound, f.pass)).collect())
}
