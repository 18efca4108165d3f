//! `[algorithm.cycles]`: window after window along a long run.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Method;

/// Cycling (every method but blue and static): every window starts from the analysis of the one before, run
/// to its start. Windows are `time.window` steps long; an observation belongs to the first window that holds
/// it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Cycles {
    /// Number of windows; at most 1e7 steps in all.
    #[schemars(extend("minimum" = 1, "maximum" = 10000000))]
    pub count: usize,
    /// Steps from the start of one window to that of the next. The default, the window's length (1 for a
    /// window of 0), puts windows end to end: they share the step at which one ends and the next begins.
    /// Fewer steps let windows overlap; one more tiles the time; a window of 0 may leave any number between.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 1, "maximum" = 10000000))]
    pub shift: Option<usize>,
    /// Where B of the next window comes from. Left out: the ensemble where the method runs one, else static.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<CycledCovariance>,
    /// Factor on the standard deviations of the propagated posterior (that of an ensemble is in
    /// [algorithm.ensemble]); or "adaptive", for an ensemble: what the innovations of a window and the finite
    /// number of members ask for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub inflation: Option<Inflation>,
    /// Part of the members' deviations over which the ensemble is linearized by differences; 1, the default,
    /// uses the members themselves. A small part (1e-3) is right where members are far apart.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "maximum" = 1.0))]
    pub spread: Option<f64>,
    /// Whether the members are turned about their mean at random after every window: the same mean and
    /// covariance, without outliers that a square root would carry for ever.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation: Option<bool>,
    /// Weight β of the scene's own B that is added to the propagated posterior, P + β² B: a factor on
    /// standard deviations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0))]
    pub static_weight: Option<f64>,
    /// Share of the variance of every component that a propagated posterior may leave out, so that its root
    /// has fewer columns; 1e-8 unless given, 0 leaves out nothing (weak-state, which needs the inverse of B,
    /// takes 0 or a static weight).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 0.0, "exclusiveMaximum" = 1.0))]
    pub dropped_variance: Option<f64>,
    /// How the perturbations of an ensemble become those of the posterior. Left out: by its square root.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub update: Option<EnsembleUpdate>,
    /// Windows at the beginning that do not count in the means.
    #[serde(default)]
    pub spin_up: usize,
}

/// Inflation between windows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Inflation {
    /// A factor on standard deviations.
    Factor(#[schemars(extend("exclusiveMinimum" = 0.0))] f64),
    /// Found window by window.
    Found(Adaptive),
}

/// The word "adaptive".
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Adaptive {
    /// By the finite number of members and the innovations.
    Adaptive,
}

impl Inflation {
    /// The factor, where one is given.
    pub fn factor(self) -> Option<f64> {
        match self {
            Inflation::Factor(factor) => Some(factor),
            Inflation::Found(Adaptive::Adaptive) => None,
        }
    }
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
