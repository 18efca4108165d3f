//! Second derivatives of the steps of a model.

use crate::{Error, Model};

/// What the second-order adjoint needs of a [`Model`](crate::Model) beside its products: the derivative of
/// the adjoint step along a perturbation of the state it is taken at.
///
/// With λ_k = M_k'ᵀ λ_{k+1} + f_k, the derivative of λ_k along dx₀ is
///
/// ```text
/// λ̇_k = M_k'ᵀ λ̇_{k+1} + Σ_i λ_{k+1,i} ∂²M_{k,i}/∂x² dx_k + ḟ_k,     dx_{k+1} = M_k' dx_k
/// ```
///
/// (Wang, Navon, Le Dimet and Zou 1992), which gives the product of the exact Hessian of a cost with a vector
/// from one sweep each way. A model without second derivatives gives `None` from
/// [`Model::second_order`](crate::Model::second_order), and Hessians are then those of Gauss and Newton.
///
/// ```
/// use varda_implicit::{Model, Rk4, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let (x, dx, lambda) = ([1.0, 3.0, 20.0], [0.1, -0.2, 0.3], [0.0, 0.0, 1.0]);
/// let mut adjoint_at = |x: &[f64]| {
///     let (mut next, mut l) = ([0.0; 3], lambda);
///     model.step(0, x, &mut next).unwrap();
///     model.linearize(0, 0, x, &next).unwrap();
///     model.adjoint(0, &mut l);
///     l
/// };
/// let moved = |s: f64| [0, 1, 2].map(|i| x[i] + s * dx[i]);
/// let (plus, minus) = (adjoint_at(&moved(1e-4)), adjoint_at(&moved(-1e-4)));
/// adjoint_at(&x);
///
/// let mut derivative = [0.0; 3];
/// model.second_order().unwrap().adjoint_derivative(0, &dx, &lambda, &mut derivative)?;
/// for i in 0..3 {
///     assert!((derivative[i] - (plus[i] - minus[i]) / 2e-4).abs() < 1e-9);
/// }
/// # Ok::<(), varda_implicit::Error>(())
/// ```
pub trait SecondOrder: Model {
    /// dx ← M dx as [`Model::tangent`], for one column; what `adjoint_derivative` needs along the way may
    /// be kept in the slot.
    ///
    /// # Panics
    /// As [`Model::tangent`].
    fn tangent_kept(&mut self, slot: usize, dx: &mut [f64]) {
        self.tangent(slot, dx);
    }

    /// λ̇ ← M'ᵀ λ̇ + Σ_i λ_i ∂²M_i/∂x² dx in place, with the linearization in the slot:
    /// `lambda` is λ_{k+1}, at the end of the step, `dx` the perturbation at its start.
    ///
    /// What does not depend on dx may be kept in the slot, for the next call with the same λ; what
    /// `tangent_kept` left there is taken over where its dx was the same.
    ///
    /// # Errors
    /// Second derivatives that are not finite.
    ///
    /// # Panics
    /// If the slot is empty, or a slice has the wrong length.
    fn adjoint_derivative(
        &mut self,
        slot: usize,
        dx: &[f64],
        lambda: &[f64],
        derivative: &mut [f64],
    ) -> Result<(), Error>;

    /// dz += Σ_i λ_i ∂²x_{0,i}/∂z² δz, λ that of the initial state, at the control of the last
    /// `initial_state`. Nothing where control and state are the same vector, or the map between them is
    /// linear.
    fn initial_adjoint_derivative(&mut self, _delta: &[f64], _lambda: &[f64], _dz: &mut [f64]) {}
}
