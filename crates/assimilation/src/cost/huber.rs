//! The Huber norm: robust observations.

/// The Huber norm ρ_δ(r) of a departure r = d/σ with its first two derivatives (Huber 1964; Tavolato and
/// Isaksen 2015 in 4D-Var):
///
/// ```text
///     ρ = ½ r²,          ρ' = r,          ρ'' = 1        |r| ≤ δ
///     ρ = δ|r| − ½ δ²,   ρ' = δ sign r,   ρ'' = 0        |r| > δ
/// ```
///
/// Convex, so that it makes no new minima; a gross error pulls with a bounded force instead of one that
/// grows. The Gauss–Newton Hessian is that of the norm: I + Σ ρ'' gᵀg, in which a row beyond δ has no
/// weight, and the posterior does not count it as information. Returns (ρ, ρ', ρ'').
pub fn huber(delta: f64, r: f64) -> (f64, f64, f64) {
    if r.abs() <= delta {
        (0.5 * r * r, r, 1.0)
    } else {
        // NaN ends here and stays NaN.
        (delta * (r.abs() - 0.5 * delta), delta.copysign(r) + 0.0 * r, 0.0)
    }
}
