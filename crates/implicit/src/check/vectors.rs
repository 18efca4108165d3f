//! Scaled norms.

/// ‖v / scale‖.
pub(super) fn norm_of(v: &[f64], scale: &[f64]) -> f64 {
    assert_eq!(v.len(), scale.len(), "a vector and its scale differ in length");
    v.iter().zip(scale).map(|(v, s)| (v / s).powi(2)).sum::<f64>().sqrt()
}
