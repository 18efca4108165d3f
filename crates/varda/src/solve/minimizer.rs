//! The minimizer that a scene names, applied to the cost of its method.

use std::ops::ControlFlow;

use varda_assimilation::{
    Blue, Error, Gain, Hessian, InnerSolver, Iteration, LeastSquares, Minimizer, Minimum, OuterLoopOptions,
    Status, Stopping, continuation, outer_loop,
};
use varda_linalg::norm;

use crate::scene::{Algorithm, Method};

/// The minimum of a cost from `v`, by the method and minimizer of a scene: an outer loop, the closed form, or
/// the minimizer itself. Of methods that run an ensemble the cost minimizes itself.
///
/// # Errors
/// A cost that cannot be evaluated at `v`; second derivatives that are asked for and not there.
pub fn minimum(
    algorithm: &Algorithm,
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    match outer_of(algorithm) {
        Some(options) => outer_loop(cost, v, &options, on_iteration),
        None if algorithm.method == Method::Blue => blue(algorithm, cost, v, on_iteration),
        None => minimize(algorithm, cost, v, on_iteration),
    }
}

/// The minimum by the scene's minimizer, through its σ stages if it has any.
pub(crate) fn minimize(
    algorithm: &Algorithm,
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    let minimizer = minimizer(algorithm);
    match algorithm.sigma_stages.as_slice() {
        [] => minimizer.minimize(cost, v, on_iteration),
        stages => continuation(&minimizer, cost, v, stages, on_iteration),
    }
}

/// The minimizer that a scene names, with the scene's stopping rule.
pub fn minimizer(algorithm: &Algorithm) -> Minimizer {
    let mut minimizer = algorithm.minimizer.settings().with_stopping(stopping(algorithm));
    if algorithm.hessian == crate::scene::Hessian::Exact {
        match &mut minimizer {
            Minimizer::Auto(options) => options.trust_region.hessian = Hessian::Exact,
            Minimizer::TrustRegion(options) => options.hessian = Hessian::Exact,
            // refused when the scene was read
            _ => {}
        }
    }
    minimizer
}

/// The scene's stopping rule.
fn stopping(algorithm: &Algorithm) -> Stopping {
    Stopping::new(algorithm.gradient_tolerance, algorithm.max_iterations)
}

/// Options of the outer loop of a method that has one.
pub fn outer_of(algorithm: &Algorithm) -> Option<OuterLoopOptions> {
    let inner = match algorithm.method {
        Method::FourDVarIncremental | Method::ThreeDVarIncremental | Method::WeakState => InnerSolver::Primal,
        Method::FourDPsas | Method::Psas => InnerSolver::Dual,
        _ => return None,
    };
    Some(OuterLoopOptions::default().with_inner(inner).with_stopping(stopping(algorithm)))
}

/// The closed form, linearized once at `v`. `Converged` only if the true gradient is below the tolerance;
/// `Failed`, with `v` unchanged, if the model cannot be run from the estimate.
fn blue(
    algorithm: &Algorithm,
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    let mut gradient = vec![0.0; v.len()];
    let value = cost.evaluate(v, Some(&mut gradient))?;
    let first = norm(&gradient);
    let mut now = Minimum {
        value,
        terms: cost.terms(),
        gradient_norm_first: first,
        gradient_norm: first,
        outer_iterations: 0,
        inner_iterations: 0,
        status: Status::Interrupted,
        failure: None,
        ritz: Vec::new(),
        inverse_hessian: None,
        started_beside: false,
        quadratic: false,
        attempts: Vec::new(),
    };
    if on_iteration(&now.iteration(0.0, cost.counts(), v)).is_break() {
        return Ok(now);
    }
    let gain = if cost.observation_dim() < v.len() { Gain::Observation } else { Gain::Information };
    let estimate = Blue::new(cost, v, gain)?.control_variable;
    match cost.evaluate(&estimate, Some(&mut gradient)) {
        Ok(value) => now.value = value,
        Err(failure) => return Ok(Minimum { status: Status::Failed, failure: Some(failure), ..now }),
    }
    let step: Vec<f64> = estimate.iter().zip(&*v).map(|(a, b)| a - b).collect();
    v.copy_from_slice(&estimate);
    now.terms = cost.terms();
    now.gradient_norm = norm(&gradient);
    now.outer_iterations = 1;
    now.status = match stopping(algorithm).is_converged(v, &gradient, first) {
        true => Status::Converged,
        false => Status::MaxIterations,
    };
    // The only iteration: it is too late to interrupt.
    let _ = on_iteration(&now.iteration(norm(&step), cost.counts(), v));
    Ok(now)
}
