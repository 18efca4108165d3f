//! What `[algorithm]` must satisfy beyond the type of each key: keys that do not belong to the chosen method,
//! and numbers that do not belong together.

use super::invalid::{Check, invalid};
use super::validate_covariance::validate_covariance;
use super::{Algorithm, Ensemble, Hessian, Method, Minimizer, Model, ModelError, Observations, Root, Scene};

pub(super) fn validate_algorithm(scene: &Scene) -> Check {
    let algorithm = &scene.algorithm;
    validate_keys(algorithm)?;
    validate_one_instant(algorithm.method, &scene.observations)?;
    if let Some(last) = algorithm.sigma_stages.last() {
        if *last != 1.0 {
            return invalid("algorithm.sigma_stages", format!("the last factor is {last}, it must be 1"));
        }
        if let Some(i) = algorithm.sigma_stages.iter().position(|f| !(*f >= 1.0)) {
            return invalid(format!("algorithm.sigma_stages.{i}"), "factors of σ must be at least 1");
        }
    }
    validate_growth(&algorithm.window_growth, scene.time.window)?;
    match &algorithm.model_error {
        Some(error) => validate_model_error(error, scene)?,
        None if algorithm.method.is_weak() => {
            let name = algorithm.method.name();
            let message = format!("method {name:?} needs [algorithm.model_error] with the covariance Q");
            return invalid("algorithm.method", message);
        }
        None => {}
    }
    match &algorithm.ensemble {
        Some(ensemble) => validate_ensemble(ensemble, algorithm.method, &scene.model),
        None => Ok(()),
    }
}

/// Which methods take a key.
type Takes = fn(Method) -> bool;

/// Refuses keys that the method does not use.
fn validate_keys(algorithm: &Algorithm) -> Check {
    let method = algorithm.method;
    let of_one_window = algorithm.cycles.is_none();
    let keys: [(&str, bool, Takes); 9] = [
        ("minimizer", algorithm.minimizer != Minimizer::Auto, Method::takes_minimizer),
        ("hessian", algorithm.hessian != Hessian::GaussNewton, Method::takes_robust),
        ("sigma_stages", !algorithm.sigma_stages.is_empty(), Method::takes_minimizer),
        ("robust", algorithm.robust.is_some(), Method::takes_robust),
        ("window_growth", !algorithm.window_growth.is_empty(), Method::takes_window_growth),
        ("model_error", algorithm.model_error.is_some() && of_one_window, Method::is_weak),
        ("ensemble", algorithm.ensemble.is_some(), Method::is_ensemble),
        (
            "gradient_tolerance",
            algorithm.gradient_tolerance != Algorithm::default().gradient_tolerance,
            |method| !method.is_ensemble(),
        ),
        ("max_iterations", algorithm.max_iterations != Algorithm::default().max_iterations, |method| {
            !matches!(method, Method::Blue | Method::HybridFourDEnVar)
        }),
    ];
    let exact = algorithm.hessian == Hessian::Exact;
    if exact && !matches!(algorithm.minimizer, Minimizer::Auto | Minimizer::TrustRegion) {
        let message = format!(
            "minimizer {:?} has no exact Hessian; \"auto\" and \"trust-region\" have",
            algorithm.minimizer.name()
        );
        return invalid("algorithm.hessian", message);
    }
    let Some((key, _, takes)) = keys.iter().find(|(_, given, takes)| *given && !takes(method)) else {
        return Ok(());
    };
    let others: Vec<String> =
        Method::ALL.into_iter().filter(|m| takes(*m)).map(|m| format!("{:?}", m.name())).collect();
    let message = format!("method {:?} has no `{key}`; it belongs to {}", method.name(), others.join(", "));
    invalid(format!("algorithm.{key}"), message)
}

/// A recording's steps are known only when it is read.
fn validate_one_instant(method: Method, observations: &Observations) -> Check {
    let (true, Observations::Synthetic(s)) = (method.is_of_one_instant(), observations) else {
        return Ok(());
    };
    let only = |key: &str| {
        let message = format!(
            "method {:?} takes observations at step 0 only: `steps = [0]`, without `every`",
            method.name()
        );
        invalid(format!("observations.{key}"), message)
    };
    if s.every.is_some() {
        return only("every");
    }
    match s.steps.iter().flatten().position(|k| *k > 0) {
        Some(i) => only(&format!("steps.{i}")),
        None => Ok(()),
    }
}

fn validate_growth(ends: &[usize], window: usize) -> Check {
    let path = |i: usize| format!("algorithm.window_growth.{i}");
    if ends.first() == Some(&0) {
        return invalid(path(0), "a sub-window has at least 1 step");
    }
    if let Some(i) = ends.windows(2).position(|w| w[0] >= w[1]) {
        let message = format!("{} does not come after {}: sub-windows grow", ends[i + 1], ends[i]);
        return invalid(path(i + 1), message);
    }
    match ends.last() {
        Some(last) if *last != window => invalid(
            path(ends.len() - 1),
            format!("the last sub-window ends at step {last}, it must be the whole window of {window} steps"),
        ),
        _ => Ok(()),
    }
}

fn validate_model_error(error: &ModelError, scene: &Scene) -> Check {
    let path = "algorithm.model_error";
    validate_covariance(&error.covariance, &format!("{path}.covariance"), &scene.model)?;
    let window = scene.time.window;
    if error.every > window && scene.algorithm.method.is_weak() {
        return invalid(
            format!("{path}.every"),
            format!("no sub-window of {} steps ends in the window, which has {window}", error.every),
        );
    }
    if scene.algorithm.method != Method::WeakState {
        return Ok(());
    }
    if error.held {
        return invalid(
            format!("{path}.held"),
            "states do not determine a held forcing; it belongs to method \"weak-forcing\"",
        );
    }
    for (covariance, path) in [
        (&scene.background.covariance, "background.covariance"),
        (&error.covariance, "algorithm.model_error.covariance"),
    ] {
        if covariance.root() == Root::Truncated {
            let message = "method \"weak-state\" needs an inverse, which a truncated root has not: take \
                           root = \"cholesky\", or method \"weak-forcing\"";
            return invalid(format!("{path}.root"), message);
        }
    }
    Ok(())
}

fn validate_ensemble(ensemble: &Ensemble, method: Method, model: &Model) -> Check {
    let path = "algorithm.ensemble";
    for (key, weight) in
        [("static_weight", ensemble.static_weight), ("ensemble_weight", ensemble.ensemble_weight)]
    {
        if weight.is_some() && method != Method::HybridFourDEnVar {
            let message = format!(
                "method {:?} has no static part; `{key}` belongs to \"hybrid-4denvar\"",
                method.name()
            );
            return invalid(format!("{path}.{key}"), message);
        }
    }
    if ensemble.weights() == [0.0, 0.0] {
        return invalid(format!("{path}.static_weight"), "both weights are 0: nothing is left of B");
    }
    if ensemble.localization()?.is_some() && matches!(model, Model::Lorenz63(_)) {
        return invalid(
            format!("{path}.localization_length"),
            "the three variables of lorenz63 have no distances: leave it out",
        );
    }
    Ok(())
}
