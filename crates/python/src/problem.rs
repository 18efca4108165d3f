//! What an assimilation is asked for, as plain data from Python.

use pyo3::prelude::*;
use varda::scene::{Algorithm, Method, Minimizer};
use varda::setup::random::{Stream, stream};
use varda_assimilation::{
    Error, Forcing, LinearObservation, Observation, ObservationOperator, ObservationSet, Selection,
};
use varda_covariance::{Covariance, Dense, Diagonal, Ensemble, Localization, Precision, sample};

use crate::error::{AssimilationError, raised};

/// B or Q: standard deviations alone, or a matrix.
#[derive(Clone)]
pub(crate) enum Errors {
    Diagonal(Diagonal),
    Dense(Dense),
}

impl Errors {
    /// From n standard deviations, or n² numbers of a matrix.
    pub(crate) fn new(n: usize, numbers: &[f64]) -> PyResult<Self> {
        let errors = match numbers.len() == n {
            true => Diagonal::new(numbers.to_vec()).map(Errors::Diagonal),
            false => Dense::new(n, numbers).map(Errors::Dense),
        };
        errors.map_err(of_covariance)
    }

    pub(crate) fn covariance(&self) -> &dyn Covariance {
        match self {
            Errors::Diagonal(c) => c,
            Errors::Dense(c) => c,
        }
    }

    pub(crate) fn precision(&self) -> &dyn Precision {
        match self {
            Errors::Diagonal(c) => c,
            Errors::Dense(c) => c,
        }
    }
}

/// The exception of a covariance that cannot be.
pub(crate) fn of_covariance(error: varda_covariance::Error) -> PyErr {
    raised(varda::Error::Covariance(error))
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

/// The error of the model.
#[derive(FromPyObject)]
pub(crate) struct ModelError {
    /// σ of the components that err, or Q row by row.
    #[pyo3(item)]
    pub(crate) covariance: Vec<f64>,
    #[pyo3(item)]
    components: Vec<usize>,
    #[pyo3(item)]
    every: usize,
    #[pyo3(item)]
    held: bool,
}

impl ModelError {
    pub(crate) fn forcing(&self) -> Forcing {
        Forcing { components: self.components.clone(), steps: self.every, held: self.held }
    }

    pub(crate) fn errors(&self) -> PyResult<Errors> {
        Errors::new(self.components.len(), &self.covariance)
    }
}

/// The ensemble of methods that run one.
#[derive(FromPyObject)]
pub(crate) struct Members {
    /// States, one after the other; none: `count` of them are drawn.
    #[pyo3(item)]
    members: Vec<f64>,
    #[pyo3(item)]
    count: usize,
    /// A matrix of correlations, row by row; none: no localization.
    #[pyo3(item)]
    localization: Vec<f64>,
    /// β_s and β_e of a hybrid.
    #[pyo3(item)]
    pub(crate) weights: [f64; 2],
}

/// What an assimilation is asked for.
#[derive(FromPyObject)]
pub(crate) struct Problem {
    #[pyo3(item)]
    pub(crate) background: Vec<f64>,
    /// σ, or B row by row.
    #[pyo3(item)]
    pub(crate) covariance: Vec<f64>,
    #[pyo3(item)]
    observations: Vec<Seen>,
    /// Length of the window.
    #[pyo3(item)]
    pub(crate) steps: usize,
    #[pyo3(item)]
    method: String,
    #[pyo3(item)]
    minimizer: String,
    #[pyo3(item)]
    gradient_tolerance: f64,
    #[pyo3(item)]
    max_iterations: usize,
    /// δ of Huber's norm.
    #[pyo3(item)]
    pub(crate) robust: Option<f64>,
    #[pyo3(item)]
    pub(crate) posterior: bool,
    #[pyo3(item)]
    pub(crate) model_error: Option<ModelError>,
    #[pyo3(item)]
    pub(crate) ensemble: Members,
    #[pyo3(item)]
    pub(crate) seed: u64,
}

impl Problem {
    /// Method, minimizer and stopping rule by the names that scenes have.
    pub(crate) fn algorithm(&self) -> PyResult<Algorithm> {
        // shapes at rest are those of a rod
        let methods = Method::ALL.iter().copied().filter(|m| *m != Method::Static);
        let minimizers = Minimizer::ALL.iter().copied();
        let method = named("method", &self.method, methods, Method::name)?;
        if self.robust.is_some() && !method.takes_robust() {
            let text = format!("method {:?} takes no Huber norm (robust)", self.method);
            return Err(AssimilationError::new_err(text));
        }
        if method.is_weak() && self.model_error.is_none() {
            let text =
                format!("method {:?} estimates errors of the model: it takes model_error", self.method);
            return Err(AssimilationError::new_err(text));
        }
        Ok(Algorithm {
            method,
            minimizer: named("minimizer", &self.minimizer, minimizers, Minimizer::name)?,
            gradient_tolerance: self.gradient_tolerance,
            max_iterations: self.max_iterations,
            ..Algorithm::default()
        })
    }

    pub(crate) fn errors(&self) -> PyResult<Errors> {
        Errors::new(self.background.len(), &self.covariance)
    }

    pub(crate) fn observed(&self) -> Result<ObservationSet, Error> {
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

    /// For each value observed at a step that `used` names the component of the state at its place: the
    /// largest of its row of H.
    pub(crate) fn anchors(&self, used: impl Fn(usize) -> bool) -> Vec<usize> {
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
        self.observations.iter().filter(|seen| used(seen.step)).flat_map(of).collect()
    }

    /// Members as given, or drawn from N(x_b, B) with the random numbers of a scene of that seed.
    pub(crate) fn members(&self, b: &dyn Covariance) -> Vec<f64> {
        if !self.ensemble.members.is_empty() {
            return self.ensemble.members.clone();
        }
        let mut rng = stream(self.seed, Stream::Ensemble);
        let draw = |_| {
            let error = sample(b, &mut rng);
            self.background.iter().zip(error).map(|(x, e)| x + e).collect::<Vec<f64>>()
        };
        (0..self.ensemble.count).flat_map(draw).collect()
    }

    pub(crate) fn localization(&self) -> PyResult<Localization> {
        /// Eigenvalues below this part of the largest are left out, as in scenes.
        const TRUNCATION: f64 = 0.01;
        let n = self.background.len();
        match self.ensemble.localization.is_empty() {
            true => Ok(Localization::none(n)),
            false => Localization::new(n, &self.ensemble.localization, TRUNCATION).map_err(of_covariance),
        }
    }

    pub(crate) fn ensemble(&self, b: &dyn Covariance) -> PyResult<Ensemble> {
        Ensemble::new(&self.members(b), self.localization()?).map_err(of_covariance)
    }
}

/// The one of that name.
fn named<T: Copy>(
    what: &str,
    name: &str,
    all: impl Iterator<Item = T> + Clone,
    of: fn(T) -> &'static str,
) -> PyResult<T> {
    all.clone().find(|one| of(*one) == name).ok_or_else(|| {
        let names: Vec<&str> = all.map(of).collect();
        AssimilationError::new_err(format!("{what} {name:?} is none of {}", names.join(", ")))
    })
}
