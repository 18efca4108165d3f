//! Weak-constraint 4D-Var over the forcing of the model.

use super::model_error::{ModelErrorTerm, WeakControl};
use super::{CostFunction, CostTerms, Counts, Forcing, LeastSquares, StrongConstraint};
use crate::{ControlTransform, Error, ObservationSet};
use varda_covariance::Covariance;
use varda_implicit::Model;

/// Weak-constraint 4D-Var over initial state and model-error forcing (paper 4.1 with squares and x_{k+1} =
/// M_k(x_k) + η; Trémolet 2006):
///
/// ```text
///     J(v, p) = ½‖v‖² + ½ Σ_j ‖p_j‖² + ½ Σ_k ‖y_k − H_k(x_k)‖²_{R_k⁻¹}
///     x₀ = x₀(z_b + B^{1/2} v),    x_{k+1} = M_k(x_k) + E Q^{1/2} p_j,
///     ‖p_j‖² = ‖η_j‖²_{Q⁻¹}
/// ```
///
/// The control is (v, p_1 … p_N); its gradient is one adjoint sweep, λ being read off as it passes:
/// ∂J/∂p_j = p_j + Q^{1/2}ᵀ Eᵀ Σ λ_{k+1}. The Hessian is I + GᵀG, so that every minimizer works;
/// neither B nor Q needs an inverse, and Q → 0 is the strong constraint, smoothly. N counts the sub-windows
/// that end (or, with a held forcing, begin) before the last observation; later forcing could not be
/// estimated.
///
/// When to use: a model in error, above all with few forcings (long sub-windows, a Q of low rank). When not:
/// long chaotic windows, where J as a function of x₀ has several minima that
/// [`WeakState`](super::WeakState) avoids.
///
/// Cost: sweeps and runs as for [`StrongConstraint`], but more inner iterations: the control has N times the
/// rank of Q more entries. Memory: N more states.
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// let mut observations = ObservationSet::new(20, vec![Box::new(Selection::new(vec![0, 1, 2], 3)?)], seen)?;
/// // B, and an error of 0.2 in every component after each ten steps
/// let (b, q) = (Diagonal::uniform(3, 1.0)?, Diagonal::uniform(3, 0.2)?);
/// let forcing = Forcing { steps: 10, ..Forcing::every_step(3) };
/// let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// let mut cost = WeakForcing::new(&mut model, transform, &q, forcing, &mut observations)?;
/// let mut v = vec![0.0; cost.dim()];
/// assert_eq!(v.len(), 3 + 2 * 3);
/// let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct WeakForcing<'a> {
    pub(super) window: StrongConstraint<'a>,
}

impl<'a> WeakForcing<'a> {
    /// The cost of the window of `observations` with model errors of covariance `q`, entering as `forcing`
    /// says.
    ///
    /// # Errors
    /// As for [`StrongConstraint::new`]; a Q of another size than the forced components, a component twice or
    /// one the state does not have, a sub-window of no steps.
    pub fn new(
        model: &'a mut (dyn Model + 'a),
        transform: ControlTransform<'a>,
        q: &'a dyn Covariance,
        forcing: Forcing,
        observations: &'a mut ObservationSet,
    ) -> Result<Self, Error> {
        let last = observations.last_step().unwrap_or(0);
        let errors = ModelErrorTerm::new(forcing, WeakControl::Forcing { q }, model.dim(), last)?;
        Ok(Self { window: StrongConstraint::weak(model, transform, observations, errors)? })
    }

    /// The control variable transform of the initial state: the first entries of the control.
    pub fn transform(&self) -> &ControlTransform<'a> {
        self.window.transform()
    }

    /// N, the number of forcings.
    pub fn forcings(&self) -> usize {
        self.window.errors.as_ref().map_or(0, ModelErrorTerm::count)
    }

    /// η_j = Q^{1/2} p_j of a control, on the forced components.
    ///
    /// # Panics
    /// If there is no such forcing, or a slice has the wrong length.
    pub fn forcing(&self, v: &[f64], j: usize, eta: &mut [f64]) {
        assert!(v.len() == self.dim() && j < self.forcings(), "forcing {j}");
        let Some(ModelErrorTerm { over: WeakControl::Forcing { q }, .. }) = &self.window.errors else {
            unreachable!()
        };
        q.root(&v[self.window.transform().dim() + j * q.root_dim()..][..q.root_dim()], eta);
    }

    /// State x_k of the point of the last gradient, k = 0 … the last observed step.
    ///
    /// # Panics
    /// If no gradient has been evaluated, or that step was not run.
    pub fn state(&self, k: usize) -> &[f64] {
        self.window.state(k)
    }

    /// Predictions H(x) at the point of the last gradient, stacked.
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn predicted(&self) -> &[f64] {
        self.window.predicted()
    }

    /// What the model did for this cost, and what its steps went through.
    pub fn log(&self) -> varda_implicit::Log {
        self.window.log()
    }
}

impl CostFunction for WeakForcing<'_> {
    fn dim(&self) -> usize {
        self.window.dim()
    }

    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        self.window.evaluate(v, gradient)
    }

    fn terms(&self) -> CostTerms {
        self.window.terms()
    }

    fn set_observation_scale(&mut self, scale: f64) {
        self.window.set_observation_scale(scale);
    }

    fn counts(&self) -> Counts {
        self.window.counts()
    }
}

impl LeastSquares for WeakForcing<'_> {
    fn observation_dim(&self) -> usize {
        self.window.observation_dim()
    }

    fn linearize(&mut self, v: &[f64], gradient: &mut [f64]) -> Result<f64, Error> {
        self.window.linearize(v, gradient)
    }

    fn background_dim(&self) -> usize {
        self.window.background_dim()
    }

    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        self.window.departures(b, d);
    }

    fn jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.window.jacobian(dv, dy)
    }

    fn jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        self.window.jacobian_transpose(dy, dv)
    }

    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.window.hessian_apply(dv, out)
    }

    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.window.hessian(out)
    }

    fn has_exact_hessian(&mut self) -> bool {
        self.window.has_exact_hessian()
    }

    fn exact_hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.window.exact_hessian_apply(dv, out)
    }

    fn exact_hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.window.exact_hessian(out)
    }
}
