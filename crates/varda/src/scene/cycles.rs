//! `[algorithm.cycles]`: window after window along a long run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::validate::{Check, invalid};
use super::{Method, Scene};

/// Cycling (methods 4dvar, 3dvar, 4denvar, hybrid-4denvar): every window starts from the analysis of the one before, run to its start.
/// Windows are `time.window` steps long; an observation belongs to the first window that holds it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cycles {
    /// Number of windows; 1e7 steps in all at most.
    #[schemars(extend("minimum" = 1, "maximum" = 10000000))]
    pub count: usize,
    /// Steps from the start of one window to that of the next. The default, the window's length (1 for a window of 0), puts windows end
    /// to end: they share the step at which one ends and the next begins. Fewer steps let windows overlap; one more tiles the
    /// time; a window of 0 may leave any number between.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 1, "maximum" = 10000000))]
    pub shift: Option<usize>,
    /// Where B of the next window comes from. Left out: the ensemble where the method runs one, else static.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<CycledCovariance>,
    /// Factor on the standard deviations of the propagated posterior; an ensemble's is in [algorithm.ensemble].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub inflation: Option<f64>,
    /// Weight β of the scene's own B beside the propagated posterior, P + β² B: a factor on standard deviations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0))]
    pub static_weight: Option<f64>,
    /// How the perturbations of an ensemble become those of the posterior. Left out: by its square root.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub update: Option<EnsembleUpdate>,
    /// Windows at the beginning that do not count in the means.
    #[serde(default)]
    pub spin_up: usize,
}

/// Where the background covariance of the next window comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CycledCovariance {
    /// The scene's B for every window.
    Static,
    /// The posterior covariance, carried to the start of the next window by the tangent.
    Propagated,
    /// The members of [algorithm.ensemble], each run to the start of the next window.
    Ensemble,
}

/// How the perturbations of an ensemble become those of the posterior.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum EnsembleUpdate {
    /// By the square root of the posterior in the ensemble's space: deterministic.
    #[default]
    SquareRoot,
    /// An assimilation for every member, each with its own perturbed observations.
    PerturbedObservations,
}

impl CycledCovariance {
    /// Its name in a scene.
    pub fn name(self) -> &'static str {
        match self {
            CycledCovariance::Static => "static",
            CycledCovariance::Propagated => "propagated",
            CycledCovariance::Ensemble => "ensemble",
        }
    }
}

impl Cycles {
    /// Steps from one window to the next, for windows of so many steps.
    pub fn shift_of(&self, window: usize) -> usize {
        self.shift.unwrap_or(window.max(1))
    }

    /// Steps from the start of the first window to the end of the last.
    pub fn steps(&self, window: usize) -> usize {
        (self.count - 1) * self.shift_of(window) + window
    }

    /// Where B of the next window comes from.
    pub fn covariance_of(&self, method: Method) -> CycledCovariance {
        let by_method = match method.is_ensemble() {
            true => CycledCovariance::Ensemble,
            false => CycledCovariance::Static,
        };
        self.covariance.unwrap_or(by_method)
    }
}

/// What `[algorithm.cycles]` must satisfy beyond the type of each key.
pub(super) fn validate_cycles(cycles: &Cycles, scene: &Scene) -> Check {
    let (algorithm, window) = (&scene.algorithm, scene.time.window);
    let method = algorithm.method;
    let refuse = |key: &str, message: String| invalid(format!("algorithm.cycles{key}"), message);
    if !matches!(method, Method::FourDVar | Method::ThreeDVar) && !method.is_ensemble() {
        let message = format!(
            "method {:?} is not cycled; \"4dvar\", \"3dvar\", \"4denvar\" and \"hybrid-4denvar\" are",
            method.name()
        );
        return refuse("", message);
    }
    if method.is_of_one_instant() && window > 0 {
        let message = format!(
            "cycled, method {:?} analyses one step, time.window = 0, and runs on to the next: that is cycles.shift",
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
            "method {:?} does not go with covariance {:?}: an ensemble is carried by \"4denvar\" and \"hybrid-4denvar\" and by no other",
            method.name(),
            covariance.name()
        );
        return refuse(".covariance", message);
    }
    let propagated = covariance == CycledCovariance::Propagated;
    for (key, given, belongs, to) in [
        ("inflation", cycles.inflation.is_some(), propagated, "covariance = \"propagated\""),
        ("static_weight", cycles.static_weight.is_some(), propagated, "covariance = \"propagated\""),
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
