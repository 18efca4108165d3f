//! How much a window amplifies perturbations of its start, and the error of a gradient taken over it.

use rand_distr::{Distribution, StandardNormal};
use varda_implicit::Model;
use varda_implicit::check::Amplification;

use crate::setup::random::{Stream, stream};

/// Number of directions followed through the window.
const DIRECTIONS: usize = 4;

/// ‖M‖ of the steps between `states` (x₀, x₁, … one after the other), from `control` and relative
/// to `sigma`, the standard deviations of the background: with S = diag σ and P the components of the
/// control, which lead the state,
///
/// ```text
/// ‖M‖² ≈ mean over random ξ of |S⁻¹ P M_{N−1} ⋯ M₀ (∂x₀/∂z) S ξ|²,   ξ ~ N(0, I)
/// ```
///
/// the estimate of the Frobenius norm by Hutchinson (1989), from [`DIRECTIONS`] directions: above the largest
/// singular value by at most the root of the number of growing directions. Each step takes one linearization
/// and as many tangent products; no linearization is kept. The norm is infinite where a product overflows.
///
/// # Errors
/// A step that cannot be linearized.
pub(crate) fn estimate(
    model: &mut dyn Model,
    control: &[f64],
    sigma: &[f64],
    states: &[f64],
    seed: u64,
) -> Result<Amplification, varda_implicit::Error> {
    let (n, m) = (model.dim(), control.len());
    let mut rng = stream(seed, Stream::Directions);
    let mut x = vec![0.0; n];
    model.release(1);
    model.initial_state(control, &mut x)?;
    let mut columns = vec![0.0; DIRECTIONS * n];
    let mut dz = vec![0.0; m];
    for column in columns.chunks_exact_mut(n) {
        for (dz, sigma) in dz.iter_mut().zip(sigma) {
            let xi: f64 = StandardNormal.sample(&mut rng);
            *dz = sigma * xi;
        }
        model.initial_tangent(&dz, column);
    }
    for (k, pair) in states.windows(2 * n).step_by(n).enumerate() {
        model.linearize(0, k, &pair[..n], &pair[n..])?;
        model.tangent(0, &mut columns);
    }
    let mut sum = 0.0;
    for column in columns.chunks_exact(n) {
        // A component without error does not count.
        let scaled = column.iter().zip(sigma).filter(|(_, s)| **s > 0.0).map(|(dx, s)| dx / s);
        sum += scaled.map(|dx| dx * dx).sum::<f64>();
    }
    let norm = (sum / DIRECTIONS as f64).sqrt();
    Ok(Amplification::of(if norm.is_nan() { f64::INFINITY } else { norm }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use varda_implicit::{Rk4, check, lorenz::Lorenz63};

    /// Against the power iteration with M and Mᵀ, which estimates the largest singular value.
    #[test]
    fn it_is_the_norm_of_the_window_to_a_factor() {
        let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
        let mut states = vec![-4.3, -5.0, 20.0];
        for k in 0..2400 {
            let mut next = vec![0.0; 3];
            model.step(k, &states[3 * k..], &mut next).unwrap();
            states.extend(next);
        }
        let sigma = [1.0, 1.0, 1.0];
        for steps in [10, 400, 1200, 2400] {
            let seen = &states[..3 * (steps + 1)];
            for (k, pair) in seen.windows(6).step_by(3).enumerate() {
                model.linearize(k, k, &pair[..3], &pair[3..]).unwrap();
            }
            let norm = check::amplification(&mut model, 0..steps, &sigma, 1).unwrap().norm;
            let mut fresh = Rk4::new(Lorenz63::default(), 0, 0.01);
            let found = estimate(&mut fresh, &states[..3], &sigma, seen, 0).unwrap();
            // Four draws of one Gaussian; at most √3 directions.
            assert!((0.3..3.0).contains(&(found.norm / norm)), "{} and {norm}", found.norm);
        }
    }

    #[test]
    fn units_do_not_matter_and_an_overflow_is_flagged() {
        let states = [1.0, 2.0, 3.0, 1.0, 2.0, 3.0];
        let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
        let mut of = |sigma: [f64; 3]| estimate(&mut model, &states[..3], &sigma, &states, 0).unwrap();
        let [one, thousand] = [of([1.0; 3]), of([1e3; 3])];
        assert!((one.norm - thousand.norm).abs() < 1e-12 * one.norm && one.reliable);
        let overflown = of([1e300, 1e-300, 1.0]);
        assert!(!overflown.reliable && overflown.warning().is_some(), "{overflown:?}");
    }
}
