//! Standard deviations through time, and observations beside them.

/// What was observed, value by value, with background and analysis beside it.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservedValue {
    /// Model time \[s\].
    pub time: f64,
    /// The marker, place or component, or the marker in a camera.
    pub label: String,
    /// Axis of the recording ("x", "y", "z") or the image ("u", "v"); empty for a component.
    pub axis: &'static str,
    /// The unit of the value; empty where the scene does not say.
    pub unit: &'static str,
    /// The value y.
    pub value: f64,
    /// H of the background's run.
    pub background: f64,
    /// H of the analysis.
    pub analysis: f64,
    /// Assumed σ of the value.
    pub sigma: f64,
    /// σ of H of the analysis; `None` where it was not computed.
    pub sigma_analysis: Option<f64>,
    /// Whether it was assimilated.
    pub used: bool,
    /// Why not: "withheld", "background check", "after the window".
    pub reason: &'static str,
}
