//! How much a window amplifies perturbations of its start, and the error of a gradient taken over it.

use crate::{Error, Model};

/// Relative error of a gradient that a minimizer can live with.
const WORST_GRADIENT: f64 = 1e-4;

/// Number of directions followed through the window.
const DIRECTIONS: usize = 4;

/// How much a window amplifies a perturbation, and what that leaves of a gradient taken over it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Amplification {
    /// An estimate of ‖M‖ of the window in scaled variables.
    pub norm: f64,
    /// ε ‖M‖: rounding at the start of the window as it arrives at its end, the relative error of a
    /// gradient to a factor of some ten (states are larger than `scale`, and every step rounds).
    pub gradient_error: f64,
    /// Whether `gradient_error` ≤ 1e-4: a minimizer can converge on such a gradient.
    pub reliable: bool,
}

impl Amplification {
    /// Of a window whose ‖M‖ is known, or estimated.
    pub fn of(norm: f64) -> Self {
        let gradient_error = f64::EPSILON * norm;
        Self { norm, gradient_error, reliable: gradient_error <= WORST_GRADIENT }
    }

    /// What to tell a user whose window is too long; `None` where the gradient can be relied on.
    pub fn warning(&self) -> Option<String> {
        (!self.reliable).then(|| {
            format!(
                "the window amplifies perturbations {:.0e} times: its gradient is right to {:.0e} at best; \
                 shorten the window, or observe more often and let errors of the model in (weak constraint)",
                self.norm, self.gradient_error
            )
        })
    }
}

/// Estimates ‖M‖ of the steps between `states` (x₀, x₁, … one after the other) from the control z,
/// and with it the accuracy of gradients over them. In a chaotic system ‖M‖ grows like exp(λ₁ T) with
/// the window's length T. With S = diag(`sigma`) the size of a perturbation of each component of the control
/// (a background's σ) and P the components of the control, which lead the state,
///
/// ```text
/// ‖M‖² ≈ mean over four random ξ of |S⁻¹ P M_{N−1} ⋯ M₀ (∂x₀/∂z) S ξ|²
/// ```
///
/// the estimate of the Frobenius norm by Hutchinson (1989): above the largest singular value by at most the
/// root of the number of growing directions. The components of ξ come from `draw`: independent, of mean 0
/// and variance 1 (normal, or ±1). Each step takes one linearization, into slot 0, and four tangent
/// products. A component with a σ of zero does not count. The norm is infinite where a product overflows.
///
/// ```
/// use varda_implicit::{Keep, Rk4, Trajectory, check, lorenz::Lorenz63};
///
/// let (mut model, mut run) = (Rk4::new(Lorenz63::default(), 0, 0.01), Trajectory::new());
/// run.run(&mut model, &[-4.3, -5.0, 20.0], 4000, Keep::States)?;
/// let states: Vec<f64> = (0..=4000).flat_map(|k| run.state(k).to_vec()).collect();
///
/// let mut random = check::Random(1);
/// let mut sign = || random.draw().signum();
/// let short = check::amplification(&mut model, &states[..3], &[1.0; 3], &states[..300], &mut sign)?;
/// let long = check::amplification(&mut model, &states[..3], &[1.0; 3], &states, &mut sign)?;
/// assert!(short.reliable && !long.reliable);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
///
/// # Errors
/// That of a step that cannot be linearized.
///
/// # Panics
/// If the control or `sigma` does not have `control_dim` values, or `states` is not a row of whole states.
pub fn amplification(
    model: &mut dyn Model,
    control: &[f64],
    sigma: &[f64],
    states: &[f64],
    draw: &mut dyn FnMut() -> f64,
) -> Result<Amplification, Error> {
    let (n, m) = (model.dim(), model.control_dim());
    assert!(control.len() == m && sigma.len() == m, "the control has {m} values");
    assert!(states.len().is_multiple_of(n), "a state has {n} values");
    let mut x = vec![0.0; n];
    model.release(1);
    model.initial_state(control, &mut x)?;
    let mut columns = vec![0.0; DIRECTIONS * n];
    let mut dz = vec![0.0; m];
    for column in columns.chunks_exact_mut(n) {
        for (dz, sigma) in dz.iter_mut().zip(sigma) {
            *dz = sigma * draw();
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
