//! How well the analysis fits what was observed, kept back, and observed later.

use serde::Serialize;

use super::quantity::Quantity;

/// Innovations d = y − H(x) of one marker, place or component.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fit {
    /// The marker, place or component, or the marker in a camera.
    pub label: String,
    /// What its values are; numbers below are in their unit.
    pub quantity: Quantity,
    /// Number of observed values.
    pub count: usize,
    /// Assumed σ (root mean square over the values).
    pub sigma: f64,
    /// Root mean square of d at the background.
    pub rms_background: f64,
    /// Root mean square of d at the analysis.
    pub rms_analysis: f64,
    /// Mean of d at the analysis.
    pub mean_analysis: f64,
    /// Root mean square of d/σ at the analysis: about 1 where model and σ are right.
    pub ratio: f64,
    /// Degrees of freedom for signal that its values brought, Σ (σ of H(x_a) over σ)²; `null` without a
    /// posterior.
    pub information: Option<f64>,
}

impl Fit {
    /// Whether the innovations are clearly larger than their assumed σ.
    pub fn is_bad(&self) -> bool {
        self.count >= 10 && self.ratio > 1.5
    }
}

/// Distances between a marker that was kept back and its place in the model, or in the image, root mean
/// square over the window.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Withheld {
    /// The marker, perhaps in a camera.
    pub label: String,
    /// What its values are: places, with distances in metres, or pixels.
    pub quantity: Quantity,
    /// Number of times.
    pub count: usize,
    /// From x_b.
    pub rms_background: f64,
    /// From x_a.
    pub rms_analysis: f64,
    /// From x_a, less the mean error: what remains if the marker's place in the scene is a constant off.
    pub moving_analysis: f64,
}

/// Distances between a marker and its forecast, root mean square over the time after the window.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Forecast {
    /// The marker, perhaps in a camera.
    pub label: String,
    /// What its values are: places, with distances in metres, or pixels.
    pub quantity: Quantity,
    /// Whether it was assimilated in the window.
    pub assimilated: bool,
    /// Number of times.
    pub count: usize,
    /// The model from x_a.
    pub analysis: f64,
    /// The model from x_b.
    pub background: f64,
    /// Persistence: the marker stays where it was last seen in the window.
    pub persistence: f64,
    /// The model at rest in its static equilibrium.
    pub static_model: f64,
    /// The model from x_a, less its mean error.
    pub moving_analysis: f64,
    /// The best constant forecast: how far the marker moves about its mean place.
    pub moving_constant: f64,
}

/// An observed value that the background check refused.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rejected {
    /// The marker, place or component.
    pub label: String,
    /// Step of the window (the earlier one, where it was seen between two).
    pub step: usize,
    /// Model time of that step \[s\].
    pub time: f64,
    /// d = y − H(x_b), in the unit of the value.
    pub departure: f64,
    /// √(HBHᵀ + R), the size expected of d.
    pub expected: f64,
    /// √(dᵀ (HBHᵀ + R)⁻¹ d) of all values of its sighting, which are refused together.
    pub distance: f64,
}
