//! What an observation of a state is: values predicted from it, with a tangent and a transpose.

use crate::Refusal;

/// A step of a window and its time: where a state belongs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct At {
    /// Index k of the step; 0 is the initial state.
    pub step: usize,
    /// Time t_k of the step, or one before t_{k+1}, in the unit of the grid of time (s, as a rule;
    /// steps, where no grid was given).
    pub time: f64,
}

/// An observation operator y = H(t_k, x_k) with its tangent H' and its transpose.
///
/// Step and time are arguments because the prediction may depend on them (a frame carried by a driven clamp).
/// All three maps are functions of (k, t_k, x) alone. Between two steps an operator is given the index of the
/// first, the time between and the state on the cubic through both ([`Rate`](crate::Rate)); for
/// models without a rate an observation there is a weighted mean of the predictions at both steps.
///
/// ```
/// use varda_implicit::{At, ObservationOperator, Refusal};
///
/// /// y = x₀ / x₁.
/// struct Ratio;
///
/// impl ObservationOperator for Ratio {
///     fn dim(&self) -> usize {
///         1
///     }
///     fn state_dim(&self) -> usize {
///         2
///     }
///     fn observe(&mut self, _: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
///         if x[1] == 0.0 {
///             return Err(Refusal::new("x₁ is zero"));
///         }
///         y[0] = x[0] / x[1];
///         Ok(())
///     }
///     fn tangent(&mut self, _: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
///         dy[0] = (dx[0] - x[0] / x[1] * dx[1]) / x[1];
///     }
///     fn adjoint_add(&mut self, _: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
///         dx[0] += dy[0] / x[1];
///         dx[1] -= x[0] / x[1] * dy[0] / x[1];
///     }
///     // for exact Hessians; may be left out
///     fn has_second_derivatives(&self) -> bool {
///         true
///     }
///     fn second_adjoint_add(&mut self, _: At, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
///         let mixed = -dy[0] / (x[1] * x[1]);
///         out[0] += mixed * dx[1];
///         out[1] += mixed * dx[0] - 2.0 * mixed * x[0] / x[1] * dx[1];
///     }
/// }
///
/// let mut y = [0.0];
/// Ratio.observe(At { step: 0, time: 0.0 }, &[3.0, 2.0], &mut y)?;
/// assert_eq!(y, [1.5]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait ObservationOperator {
    /// Number of rows: the length of y.
    fn dim(&self) -> usize;

    /// Length of the state x. A cost refuses an operator whose state has another length than the model's.
    fn state_dim(&self) -> usize;

    /// y = H(t_k, x).
    ///
    /// # Errors
    /// If the state cannot be observed; the operator's own typed error.
    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal>;

    /// dy = H'(t_k, x) dx. Called only at states that `observe` accepted.
    fn tangent(&mut self, at: At, x: &[f64], dx: &[f64], dy: &mut [f64]);

    /// dx += H'(t_k, x)ᵀ dy. Called only at states that `observe` accepted.
    fn adjoint_add(&mut self, at: At, x: &[f64], dy: &[f64], dx: &mut [f64]);

    /// Whether `second_adjoint_add` is given, for exact Hessians. False by default: say true for an operator
    /// that is linear in the state, too.
    fn has_second_derivatives(&self) -> bool {
        false
    }

    /// out += Σ_i dy_i ∂²H_i/∂x²(t_k, x) dx: nothing for a linear operator. Called only where
    /// `has_second_derivatives` says so, at states that `observe` accepted.
    fn second_adjoint_add(&mut self, _: At, _x: &[f64], _dx: &[f64], _dy: &[f64], _out: &mut [f64]) {}
}
