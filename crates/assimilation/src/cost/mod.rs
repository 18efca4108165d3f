//! Cost functions of a control vector v, as minimizers see them.

mod dense;
mod dual;
mod ensemble;
mod incremental;
mod least_squares;
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
pub use incremental::InnerCost;
pub use least_squares::LeastSquares;
pub(crate) use least_squares::{columns, solve_identity_plus};
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
    /// then still available to the products of [`LeastSquares`], unless it was the gradient itself that
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
