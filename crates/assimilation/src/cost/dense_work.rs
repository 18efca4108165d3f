//! Work space of the dense Hessian.

/// Work space of the dense Hessian.
#[derive(Default)]
pub(super) struct Dense {
    /// G, m × n by columns, or Gᵀ, n × m by columns.
    pub(super) jacobian: Vec<f64>,
    /// States under way, one after the other.
    pub(super) block: Vec<f64>,
    /// A vector of observations and one of control, zero but where it is being used.
    pub(super) dy: Vec<f64>,
    pub(super) dv: Vec<f64>,
}
