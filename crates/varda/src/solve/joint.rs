//! Several recordings at once: one cost of all, a solution for each.

use std::ops::ControlFlow;

use varda_assimilation::{
    ControlTransform, CostFunction, Error, Iteration, Joint, LeastSquares, Minimum, ObservationSet,
    Posterior, StrongConstraint,
};
use varda_covariance::Diagonal;
use varda_implicit::Model;

use super::intervals::Found;
use super::minimizer;
use super::task::{PosteriorSpread, Solution, deviations, is_at_minimum, is_whole};
use crate::outcome::WorkCounts;
use crate::scene::{Algorithm, Method};
use crate::setup::covariance::Factored;

/// One of the recordings.
pub(crate) struct JointPart<'a> {
    pub(crate) model: &'a mut dyn Model,
    pub(crate) observations: &'a mut ObservationSet,
    pub(crate) background: &'a [f64],
    pub(crate) covariance: &'a Factored,
    /// Which numbers of its control are those of all, counted from the last backwards: 0 is the last.
    pub(crate) shared: Vec<usize>,
    /// Components of its control whose 95 % intervals are wanted.
    pub(crate) constants: Vec<usize>,
    /// Most bytes for its states and linearizations.
    pub(crate) memory: usize,
}

/// The minimum of all, and the solution of each.
pub(crate) struct JointSolution {
    pub(crate) minimum: Minimum,
    pub(crate) parts: Vec<Solution>,
    /// J of the prior of what is shared.
    pub(crate) shared: f64,
    pub(crate) spread: Option<JointSpread>,
    /// Why there is no posterior, if its Hessian was indefinite by rounding.
    pub(crate) no_spread: Option<Error>,
    pub(crate) counts: WorkCounts,
}

/// What the posterior of all says beside those of each.
pub(crate) struct JointSpread {
    /// Degrees of freedom for signal.
    pub(crate) degrees_of_freedom: f64,
    /// Those of what is shared, n − tr P of its whitened numbers.
    pub(crate) of_shared: f64,
}

/// The minimum of the sum of all, by the scene's method.
///
/// # Errors
/// A cost that cannot be built, or cannot be evaluated at the background.
pub(crate) fn joint(
    algorithm: &Algorithm,
    posterior: bool,
    parts: Vec<JointPart>,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<JointSolution, Error> {
    let (mut costs, mut transforms, mut shared, mut sigmas) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut constants = Vec::new();
    for part in parts {
        let transform = ControlTransform::new(part.background.to_vec(), part.covariance.as_ref())?;
        let mut cost = StrongConstraint::new(part.model, transform.clone(), part.observations)?;
        if let Some(delta) = algorithm.robust {
            cost.set_huber(delta)?;
        }
        cost.set_memory(part.memory)?;
        // constants are the last of the control and, whitened one by one or field by field, of v
        let last = cost.dim();
        shared.push(part.shared.iter().map(|back| last - 1 - back).collect::<Vec<usize>>());
        sigmas.push(deviations(part.covariance.as_ref()));
        transforms.push(transform);
        constants.push(part.constants);
        costs.push(cost);
    }
    let mut all = Joint::new(costs.iter_mut().map(|cost| cost as &mut dyn LeastSquares).collect(), &shared)?;
    let count = transforms.len();
    let places: Vec<Vec<usize>> = (0..count).map(|r| all.places(r).to_vec()).collect();
    let mut v = vec![0.0; all.dim()];
    let start = v.clone();
    let minimum = minimizer::minimum(algorithm, &mut all, &mut v, on_iteration)?;
    let counts = WorkCounts::from(&all.counts());
    let (mut whole, mut no_spread) = (None, None);
    if posterior && is_whole(minimum.status) {
        // BLUE's covariance is (I + GᵀG)⁻¹ with the linearization at the background.
        let linearized = if algorithm.method == Method::Blue { &start } else { &v };
        all.evaluate(linearized, Some(&mut vec![0.0; v.len()]))?;
        match Posterior::new(&mut all) {
            Ok(found) => whole = Some(found),
            Err(reason @ Error::NotPositiveDefinite { .. }) => no_spread = Some(reason),
            Err(error) => return Err(error),
        }
    }
    let mut intervals = vec![Vec::new(); count];
    let followed = algorithm.method != Method::Blue && is_at_minimum(&minimum);
    if let Some(whole) = whole.as_ref().filter(|_| followed) {
        let mut found = Found::default();
        for (r, intervals) in intervals.iter_mut().enumerate() {
            let of = (&transforms[r], &places[r][..]);
            *intervals = found.of(whole, &mut all, &v, of, &constants[r])?;
        }
    }
    let at_linearized: Vec<_> = (0..count).map(|r| all.terms_of(r)).collect();
    let terms: Vec<_> = match all.evaluate(&v, None) {
        Ok(_) => (0..count).map(|r| all.terms_of(r)).collect(),
        Err(_) => at_linearized,
    };
    drop(all);
    let width = shared.first().map_or(0, Vec::len);
    let of_all = v.len() - width..v.len();
    let mut solutions = Vec::new();
    for (r, mut cost) in costs.into_iter().enumerate() {
        let (transform, places) = (&transforms[r], &places[r]);
        let own: Vec<f64> = places.iter().map(|at| v[*at]).collect();
        let mut control = vec![0.0; transform.control_dim()];
        transform.control(&own, &mut control);
        let spread = match &whole {
            Some(whole) => {
                let marginal = whole.marginal(places)?;
                let mut spread = PosteriorSpread::around(&marginal, transform, true);
                spread.degrees_of_freedom = signal(&mut cost, &marginal)?;
                spread.intervals = std::mem::take(&mut intervals[r]);
                Some(spread)
            }
            None => None,
        };
        solutions.push(Solution {
            minimum: Minimum {
                value: terms[r].total(),
                terms: terms[r],
                gradient_norm_first: minimum.gradient_norm_first,
                gradient_norm: minimum.gradient_norm,
                outer_iterations: minimum.outer_iterations,
                inner_iterations: minimum.inner_iterations,
                status: minimum.status,
                failure: None,
                ritz: Vec::new(),
                inverse_hessian: None,
                started_beside: false,
                quadratic: false,
                attempts: Vec::new(),
            },
            control,
            sigma_background: std::mem::take(&mut sigmas[r]),
            spread,
            no_spread: None,
            exact_hessian: None,
            model_errors: None,
            states: Vec::new(),
            counts: WorkCounts::from(&cost.counts()),
            rejected: Vec::new(),
            stages: Vec::new(),
            attempts: Vec::new(),
            storage: cost.storage(),
        });
    }
    let spread = match &whole {
        Some(whole) => Some(JointSpread {
            degrees_of_freedom: whole.degrees_of_freedom(),
            of_shared: whole.marginal(&of_all.clone().collect::<Vec<_>>())?.degrees_of_freedom(),
        }),
        None => None,
    };
    let shared = v[of_all].iter().map(|p| 0.5 * p * p).sum();
    Ok(JointSolution { minimum, parts: solutions, shared, spread, no_spread, counts })
}

/// What the observations of one recording determine under the posterior of all, tr (A_r − I) P_r: of one
/// recording alone the degrees of freedom for signal.
fn signal(cost: &mut StrongConstraint, marginal: &Posterior) -> Result<f64, Error> {
    let n = cost.dim();
    let unit = Diagonal::uniform(n, 1.0)?;
    let covariance = marginal.covariance(&ControlTransform::new(vec![0.0; n], &unit)?);
    let mut hessian = vec![0.0; n * n];
    cost.hessian(&mut hessian)?;
    (0..n).for_each(|i| hessian[i + i * n] -= 1.0);
    Ok(varda_linalg::dot(&hessian, &covariance))
}
