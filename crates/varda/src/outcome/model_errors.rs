//! Errors of the model that a weak-constraint method estimated.

use varda_assimilation::ErrorScale;

/// The errors η_j of the model, on the components of the control.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ModelErrors {
    /// For each η_j the first and the last step at whose end it was added.
    pub steps: Vec<[usize; 2]>,
    /// η_j, one after the other.
    pub values: Vec<f64>,
    /// Their σ before anything was observed, that of Q: one value for each component.
    pub sigma_prior: Vec<f64>,
    /// Their σ; empty without a posterior.
    pub sigma: Vec<f64>,
    /// The J_q to expect where B, Q and R are right; `None` without a posterior.
    pub expected_j_q: Option<f64>,
    /// How many times σ of the model error should be what Q says, by the innovations.
    pub scale: Option<ErrorScale>,
}
