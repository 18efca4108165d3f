//! What the uncertainty of a result comes from, and how the result depends on what was observed.

use serde::Serialize;

/// One number of the result, and what its variance is made of.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sources {
    /// What it is, as "x at s = 1 m, t = 2 s".
    pub of: String,
    /// SI unit.
    pub unit: &'static str,
    /// Its σ.
    pub sigma: f64,
    /// Shares of its variance: errors of each marker or component, priors of constants, background of the
    /// state. They sum to one.
    pub shares: Vec<SourceShare>,
}

/// A part of a variance.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SourceShare {
    /// Where it comes from.
    pub source: String,
    /// Its share.
    pub share: f64,
    /// ∂s/∂ln σ, in the unit of the number s: a tenth of it is how far s moves if σ of this source is a
    /// tenth larger. They sum to zero, as an analysis does not change with the unit of all errors.
    pub by_relative_sigma: f64,
}

/// How the numbers of [`Sources`] depend on one observed value.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensitivity {
    /// Model time \[s\].
    pub time: f64,
    /// The marker, place or component.
    pub label: String,
    /// Axis of the recording; empty for models that are not in space.
    pub axis: &'static str,
    /// ∂s/∂y for each of them, in the unit of s to that of y.
    pub by_value: Vec<f64>,
}
