//! The minimum of a cost that may have several.

use std::ops::ControlFlow;
use varda_assimilation::{
    Error, Iteration, LeastSquares, Minimizer, Minimum, Status, TrustRegionOptions, continuation,
};

/// A cost may have several minima. Minimizes it twice, straight from `v` and through larger observation
/// errors (σ × 10, 3, 1), and keeps the lower end in `v`; says which that was.
pub(super) fn minimize(cost: &mut dyn LeastSquares, v: &mut [f64]) -> Result<(Minimum, String), Error> {
    // Tighter than the default: reference minima are compared to eight digits.
    let tight = TrustRegionOptions::default().with_gradient_tolerance(1e-9);
    let minimizer = Minimizer::TrustRegion(tight);
    let go_on = &mut |_: &Iteration| ControlFlow::Continue(());
    let mut staged = v.to_vec();
    let mut best = minimizer.minimize(cost, v, go_on)?;
    let mut how = "from the background";
    let found = continuation(&minimizer, cost, &mut staged, &[10.0, 3.0, 1.0], go_on)?;
    // Two ends of one minimum differ by rounding; an end that is not a minimum is worth less than one that
    // is.
    let lower = found.value < best.value * (1.0 - 1e-9);
    if lower || (best.status != Status::Converged && found.status == Status::Converged) {
        (best, how) = (found, "through larger observation errors");
        v.copy_from_slice(&staged);
    }
    let how = describe(&best, how);
    Ok((best, how))
}

pub(super) fn describe(minimum: &Minimum, how: &str) -> String {
    let reduction = minimum.gradient_norm / minimum.gradient_norm_first;
    let Minimum { status, outer_iterations, .. } = minimum;
    format!("{status:?}, {outer_iterations} iterations, |g|/|g₀| {reduction:.1e}, {how}")
}
