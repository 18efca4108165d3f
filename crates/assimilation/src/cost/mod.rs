//! Cost functions of a control vector v, as minimizers see them.

mod dense;
mod dual;
mod ensemble;
mod incremental;
mod model_error;
mod robust;
mod strong;
mod tridiagonal;
mod weak_forcing;
mod weak_state;
mod whitening;

pub use dual::Dual;
pub(crate) use ensemble::run_all;
pub use ensemble::{EnVar, EnVarOptions, EnsembleUpdate};
pub use incremental::{Incremental, InnerCost};
pub(crate) use incremental::{columns, solve_identity_plus};
pub use model_error::Forcing;
pub use robust::{Rejection, huber};
pub use strong::StrongConstraint;
pub use weak_forcing::WeakForcing;
pub use weak_state::WeakState;

use crate::Error;
pub(crate) use varda_linalg::{dot, norm};

/// A cost J(v) with its gradient: minus the logarithm of a probability density up to a constant
/// (paper 2.8, with the minus that its exponents lack).
///
/// Deterministic: the same v (and observation scale) gives the same bits, whatever was evaluated before.
pub trait CostFunction {
    /// n, the length of v.
    fn dim(&self) -> usize;

    /// J(v) and, where asked for, ∇J(v), from one forward run and one adjoint sweep.
    ///
    /// What is known about a point is kept for the last two points, so that asking for the gradient at a
    /// trial point that was just evaluated costs no second forward run.
    ///
    /// # Errors
    /// A model or an operator that fails, or a value that is not finite. The point of the last gradient is
    /// then still available to the products of [`GaussNewton`], unless it was the gradient itself that
    /// failed.
    ///
    /// # Panics
    /// If a slice is not of length `dim`.
    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error>;

    /// The parts of J at the last evaluation.
    fn terms(&self) -> CostTerms;

    /// Multiplies every observation error σ by `scale` from now on (1 = the true cost; larger values flatten
    /// J).
    ///
    /// # Panics
    /// If `scale` is not positive and finite.
    fn set_observation_scale(&mut self, scale: f64);

    /// Work done since the cost was made.
    fn counts(&self) -> Counts;
}

/// A cost ½‖r(v)‖² whose Hessian without second derivatives is A = r'ᵀ r' (paper 2.18; the paper
/// calls it "the Hessian").
///
/// In the control variable A = I + GᵀG, with G = R^{-1/2} H M B^{1/2} the m × n Jacobian of the whitened
/// predictions. All products are around the last point evaluated *with* its gradient.
pub trait GaussNewton: CostFunction {
    /// m, the number of observations.
    fn observation_dim(&self) -> usize;

    /// dy = G dv: one tangent sweep.
    ///
    /// # Errors
    /// A model that cannot return to the linearized point.
    ///
    /// # Panics
    /// If no gradient has been evaluated, or a slice has the wrong length.
    fn observation_jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error>;

    /// dv = Gᵀ dy: one adjoint sweep.
    ///
    /// # Errors
    /// As for `observation_jacobian`.
    ///
    /// # Panics
    /// As for `observation_jacobian`.
    fn observation_jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error>;

    /// out = A dv: one tangent and one adjoint sweep.
    ///
    /// # Errors
    /// As for `observation_jacobian`.
    ///
    /// # Panics
    /// As for `observation_jacobian`.
    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error>;

    /// A, dense, column by column (`out` has length n²): by n products, or as the costs with a model have it
    /// by n tangent or m adjoint sweeps, whichever takes fewer steps.
    ///
    /// # Errors
    /// As for `observation_jacobian`.
    ///
    /// # Panics
    /// As for `observation_jacobian`.
    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let n = self.dim();
        assert_eq!(out.len(), n * n, "length of the Hessian");
        columns(n, out, &mut |unit, column| self.hessian_apply(unit, column))
    }
}

/// The parts of J = J_b + J_o + J_q.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CostTerms {
    /// J_b = ½‖x₀ − x_b‖²_{B⁻¹}.
    pub background: f64,
    /// J_o = ½ Σ ‖y_k − H_k(x_k)‖²_{R_k⁻¹}, with the observation scale in force.
    pub observation: f64,
    /// J_q = ½ Σ ‖x_{k+1} − M_k(x_k)‖²_{Q_k⁻¹}; zero for a strong constraint.
    pub model_error: f64,
}

impl CostTerms {
    /// J.
    pub fn total(&self) -> f64 {
        self.background + self.observation + self.model_error
    }
}

/// Work done by a cost function. Integers, exact, the same on every run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Forward runs of the window.
    pub forward_runs: usize,
    /// Gradients.
    pub gradients: usize,
    /// Products with G.
    pub tangent_sweeps: usize,
    /// Products with Gᵀ, gradients included.
    pub adjoint_sweeps: usize,
    /// Work of the model since the cost was made; zero where there is none.
    pub model: varda_implicit::Counts,
}
