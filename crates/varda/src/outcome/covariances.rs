//! Covariances of the control before and after the observations.

/// Covariances among some numbers of the control that mean the same thing: one component of a group.
#[derive(Debug, Clone, PartialEq)]
pub struct CovarianceBlock {
    /// The group of the state.
    pub group: &'static str,
    /// "x", "y" or "z"; empty for groups of one number a place.
    pub component: &'static str,
    /// Their SI unit; "1" for none.
    pub unit: &'static str,
    /// Arc lengths \[m\] of a rod, or indices of components.
    pub places: Vec<f64>,
    /// Of B, row by row.
    pub prior: Vec<f64>,
    /// Of P_a, row by row.
    pub posterior: Vec<f64>,
}
