//! Work space of products with the exact Hessian.

use crate::Prediction;

/// Work space of exact products.
#[derive(Default)]
pub(super) struct Exact {
    /// ∂J_o/∂H(x) at the base point, stacked.
    pub(super) slope: Vec<f64>,
    /// λ_k of the base point, k = 0 … N, where all are kept, and whether they are there.
    pub(super) lambdas: Vec<f64>,
    pub(super) known: bool,
    /// dx_k, k = 0 … N.
    pub(super) path: Vec<f64>,
    /// Derivatives of the states observed between steps.
    pub(super) moved: Option<Prediction>,
    pub(super) derivative: Vec<f64>,
    pub(super) dy: Vec<f64>,
    pub(super) dz: Vec<f64>,
}

impl Exact {
    /// Takes note of a new base point.
    pub(super) fn start(&mut self, slope: &[f64]) {
        self.slope.clear();
        self.slope.extend_from_slice(slope);
        self.known = false;
    }
}
