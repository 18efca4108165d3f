//! Where one more observation would help most.

use schemars::JsonSchema;
use serde::Serialize;

/// What σ would become with one more marker (of a rod) or component, seen whenever something was seen.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct NextObservation {
    /// Root mean square σ at the end of the window, of the places of a rod \[m\] or of all components.
    pub sigma_now: f64,
    /// σ of the values that it is supposed to have: the median of those that were seen.
    pub sigma_seen: f64,
    /// At how many times.
    pub times: usize,
    /// The places looked at, in their order along the state.
    pub candidates: Vec<Candidate>,
}

/// One place for it.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Candidate {
    /// Arc length \[m\], of a rod.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arc_length: Option<f64>,
    /// The component, of other models.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub component: Option<String>,
    /// `sigma_now` with it.
    pub sigma: f64,
}

impl NextObservation {
    /// The place that helps most.
    pub fn best(&self) -> Option<&Candidate> {
        self.candidates.iter().min_by(|a, b| a.sigma.total_cmp(&b.sigma))
    }
}
