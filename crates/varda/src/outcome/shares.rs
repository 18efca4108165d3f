//! What J is made of, and what unknown constants do to σ of the state.

use serde::Serialize;

/// A part of J at the analysis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Share {
    /// Which.
    pub part: &'static str,
    /// Its J.
    pub j: f64,
    /// Its mean where B, Q and R are right and the model is about linear within them: half of its degrees
    /// of freedom for signal, and for the observations what these leave of ½m; `null` without a posterior,
    /// or with a robust norm.
    pub expected: Option<f64>,
}

/// σ of a place or component, and what it would be if the estimated constants were known.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KnownConstants {
    /// What it is of.
    pub of: String,
    /// Its unit; "1" for none.
    pub unit: &'static str,
    /// Model time \[s\].
    pub time: f64,
    /// σ of the analysis; of a place √(σ_x² + σ_y² + σ_z²).
    pub sigma: f64,
    /// The same of the posterior given the constants: the inverse of the Hessian without their rows and
    /// columns.
    pub sigma_known: f64,
}
