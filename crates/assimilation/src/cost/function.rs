//! A cost J(v) with its gradient, its parts and its work.

use std::ops::{Add, Sub};

use crate::Error;

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
    /// then still available to the products of [`LeastSquares`](crate::LeastSquares), unless it was the
    /// gradient itself that failed.
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

    /// Whether v is in units of the prior, so that the Hessian of J is at least I (its second derivatives of
    /// the model aside): what minimizers with a Hessian ask for, and the floor of a gradient
    /// ([`Stopping`](crate::Stopping)).
    fn is_whitened(&self) -> bool {
        true
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
    /// Sweeps of the second-order adjoint: products with the exact Hessian.
    pub exact_sweeps: usize,
    /// Work of the model since the cost was made; zero where there is none.
    pub model: varda_implicit::Counts,
}

impl Counts {
    /// How many numbers these are.
    pub(crate) const LENGTH: usize = 5 + varda_implicit::Counts::LENGTH;

    /// The numbers: those of the cost, then those of the model.
    pub(crate) fn numbers(self) -> impl Iterator<Item = usize> {
        let Counts { forward_runs, gradients, tangent_sweeps, adjoint_sweeps, exact_sweeps, model } = self;
        let own = [forward_runs, gradients, tangent_sweeps, adjoint_sweeps, exact_sweeps];
        own.into_iter().chain(model.to_array())
    }

    /// The counts of these numbers.
    pub(crate) fn of(mut next: impl FnMut() -> usize) -> Self {
        Counts {
            forward_runs: next(),
            gradients: next(),
            tangent_sweeps: next(),
            adjoint_sweeps: next(),
            exact_sweeps: next(),
            model: varda_implicit::Counts::from_array(std::array::from_fn(|_| next())),
        }
    }

    fn each(self, other: Self, f: fn(usize, usize) -> usize) -> Self {
        let mut pairs = self.numbers().zip(other.numbers());
        Counts::of(|| pairs.next().map_or(0, |(a, b)| f(a, b)))
    }
}

impl Add for Counts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        self.each(other, usize::add)
    }
}

impl Sub for Counts {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self.each(other, usize::sub)
    }
}
