//! How a number of an analysis depends on what the analysis was made of.

/// ∂s/∂y of a number s = E x of an analysis, y a value that was observed as H x with error σ:
///
/// ```text
///     ∂s/∂y = E P Hᵀ/σ²,    P = W Wᵀ the posterior
/// ```
///
/// The derivative of the minimum of a linear problem, of a nonlinear one by Gauss and Newton (implicit
/// function theorem). `scalar` is E W, `row` is H W, a number for
/// each column of the root. With the row of a component of the control in place of H, and its σ_b, it is the
/// derivative by the background, where that component's error is independent of all others.
///
/// ```
/// use varda_assimilation::sensitivity;
///
/// // one number with σ_b = 2, seen with σ = 2: σ_a² = 2, the analysis is the mean of both
/// let w = [2.0_f64.sqrt()];
/// assert!((sensitivity(&w, &w, 2.0) - 0.5).abs() < 1e-15);
/// ```
///
/// # Panics
/// If the two rows are not of one length.
pub fn sensitivity(scalar: &[f64], row: &[f64], sigma: f64) -> f64 {
    assert_eq!(scalar.len(), row.len(), "rows of one root");
    scalar.iter().zip(row).map(|(e, h)| e * h).sum::<f64>() / (sigma * sigma)
}
