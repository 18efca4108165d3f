//! What `[algorithm.cycles]` must satisfy beyond the type of each key.

use super::invalid::{Check, invalid};
use super::{CycledCovariance, Cycles, Inflation, Method, Scene};

/// What `[algorithm.cycles]` must satisfy beyond the type of each key.
pub(super) fn validate_cycles(cycles: &Cycles, scene: &Scene) -> Check {
    let (algorithm, window) = (&scene.algorithm, scene.time.window);
    let method = algorithm.method;
    let refuse = |key: &str, message: String| invalid(format!("algorithm.cycles{key}"), message);
    if method == Method::Blue {
        let message = "method \"blue\" is not cycled: it is linearized once, about a background that gets no \
                       better where the window is not linear; where it is, \"4dvar-incremental\" gives the \
                       same in one outer iteration";
        return refuse("", message.into());
    }
    if method == Method::Static {
        let message =
            "method \"static\" is not cycled: its shapes have no times, and constants do not move on";
        return refuse("", message.into());
    }
    if method.is_of_one_instant() && window > 0 {
        let message = format!(
            "cycled, method {:?} analyses one step, time.window = 0, and runs on to the next: that is \
             cycles.shift",
            method.name()
        );
        return invalid("time.window", message);
    }
    if window > 0 && cycles.shift_of(window) > window + 1 {
        let message = format!(
            "windows of {window} steps can be at most {} apart, or steps would be left out",
            window + 1
        );
        return refuse(".shift", message);
    }
    let covariance = cycles.covariance_of(method);
    if method.is_ensemble() != (covariance == CycledCovariance::Ensemble) {
        let message = format!(
            "method {:?} does not go with covariance {:?}: an ensemble is carried by \"4denvar\" and \
             \"hybrid-4denvar\" and by no other",
            method.name(),
            covariance.name()
        );
        return refuse(".covariance", message);
    }
    if method == Method::WeakState
        && covariance == CycledCovariance::Propagated
        && cycles.dropped_variance != Some(0.0)
        && !cycles.static_weight.is_some_and(|w| w > 0.0)
    {
        let message = "method \"weak-state\" needs the inverse of B, which a propagated one has only where \
                       nothing is left out of it: dropped_variance = 0, or a static_weight";
        return refuse(".dropped_variance", message.into());
    }
    if let Some(error) = algorithm.model_error.as_ref().filter(|_| !method.is_weak()) {
        if covariance == CycledCovariance::Static {
            let message = "Q does not change a static B: take cycles.covariance = \"propagated\", or method \
                           \"weak-forcing\" or \"weak-state\", which estimate the errors";
            return invalid("algorithm.model_error", message);
        }
        if error.every > cycles.shift_of(window) {
            let message = format!(
                "no error enters between two windows, which are {} steps apart",
                cycles.shift_of(window)
            );
            return invalid("algorithm.model_error.every", message);
        }
    }
    let factor = cycles.inflation.and_then(Inflation::factor);
    let found = cycles.inflation.is_some() && factor.is_none();
    if let Some(factor) = factor.filter(|f| !(*f > 0.0 && f.is_finite())) {
        return refuse(".inflation", format!("{factor} is not a positive number"));
    }
    if let Some(spread) = cycles.spread.filter(|s| !(*s > 0.0 && *s <= 1.0)) {
        return refuse(".spread", format!("{spread} is not in (0, 1]"));
    }
    let ensemble = algorithm.members();
    if found && ensemble.as_ref().is_some_and(|e| e.inflation != 1.0) {
        let message = "\"adaptive\" takes the place of the ensemble's own inflation";
        return refuse(".inflation", message.into());
    }
    let propagated = covariance == CycledCovariance::Propagated;
    for (key, given, belongs, to) in [
        ("inflation", factor.is_some(), propagated, "covariance = \"propagated\""),
        ("inflation", found, method.is_ensemble(), "covariance = \"ensemble\""),
        ("spread", cycles.spread.is_some(), method.is_ensemble(), "covariance = \"ensemble\""),
        ("rotation", cycles.rotation.is_some(), method.is_ensemble(), "covariance = \"ensemble\""),
        ("static_weight", cycles.static_weight.is_some(), propagated, "covariance = \"propagated\""),
        ("dropped_variance", cycles.dropped_variance.is_some(), propagated, "covariance = \"propagated\""),
        ("update", cycles.update.is_some(), method.is_ensemble(), "covariance = \"ensemble\""),
    ] {
        if given && !belongs {
            let instead = match (method.is_ensemble(), key) {
                (true, "inflation" | "static_weight") => {
                    format!("; an ensemble's is algorithm.ensemble.{key}")
                }
                _ => String::new(),
            };
            return refuse(&format!(".{key}"), format!("`{key}` belongs to {to}{instead}"));
        }
    }
    if cycles.spin_up >= cycles.count {
        let message = format!("all {} cycles would be left out of the means", cycles.count);
        return refuse(".spin_up", message);
    }
    for (path, given) in [
        ("algorithm.sigma_stages", !algorithm.sigma_stages.is_empty()),
        ("algorithm.robust", algorithm.robust.is_some()),
        ("algorithm.background_check", algorithm.background_check.is_some()),
        ("algorithm.window_growth", !algorithm.window_growth.is_empty()),
        ("report.forecast", scene.report.forecast > 0.0),
    ] {
        if given {
            return invalid(path, "does not go with [algorithm.cycles]");
        }
    }
    Ok(())
}
