//! What assimilation sees of a dynamical system.

use crate::Error;
use std::ops::{Add, Sub};

/// A discrete model x_{k+1} = M_k(x_k) with its tangent linear and its adjoint (paper 2.16, 2.24, 2.25).
///
/// The linearization of step k is *defined* as that at the accepted pair (x_k, x_{k+1}): a function of the stored states
/// alone, so that keeping it, or forgetting and recomputing it, gives the same bits.
///
/// The control z (length `control_dim`) is what is estimated; the initial state follows from it. By default they are
/// the same vector.
pub trait Model {
    /// Length of the state x.
    fn dim(&self) -> usize;

    /// x_next = M_k(x). Pure: the result depends on k and x only.
    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<(), Error>;

    /// Linearizes step k at the accepted pair (x_k, x_{k+1}) and keeps the result until step k is linearized again.
    fn linearize(&mut self, k: usize, x: &[f64], x_next: &[f64]) -> Result<(), Error>;

    /// dx ← M_k dx, in place, with the kept linearization of step k.
    ///
    /// # Panics
    /// If step k has not been linearized.
    fn tangent(&mut self, k: usize, dx: &mut [f64]);

    /// λ ← M_kᵀ λ, in place, with the kept linearization of step k. No hidden minus.
    ///
    /// # Panics
    /// If step k has not been linearized.
    fn adjoint(&mut self, k: usize, lambda: &mut [f64]);

    /// dx ← M_k dx for every column of a block, one after the other (`dx` has the length of the state times their number).
    /// A column's bits do not depend on the others. By default one by one.
    ///
    /// # Panics
    /// If step k has not been linearized, or there is a part of a column.
    fn tangent_block(&mut self, k: usize, dx: &mut [f64]) {
        let n = self.dim();
        assert!(dx.len().is_multiple_of(n), "a column has {n} values");
        dx.chunks_exact_mut(n).for_each(|dx| self.tangent(k, dx));
    }

    /// λ ← M_kᵀ λ for every column of a block, as for `tangent_block`.
    ///
    /// # Panics
    /// As for `tangent_block`.
    fn adjoint_block(&mut self, k: usize, lambda: &mut [f64]) {
        let n = self.dim();
        assert!(lambda.len().is_multiple_of(n), "a column has {n} values");
        lambda.chunks_exact_mut(n).for_each(|lambda| self.adjoint(k, lambda));
    }

    /// Keeps the linearizations of no more than `steps` steps from now on (at first of all): those linearized last in a
    /// window that is swept in order, either way. Memory beyond that is given back. By default nothing happens: a model that
    /// keeps every linearization is right, only larger.
    fn keep_at_most(&mut self, steps: usize) {
        let _ = steps;
    }

    /// Bytes that keeping the linearization of one step takes; zero where a model does not say.
    fn bytes_per_step(&self) -> usize {
        0
    }

    /// Bytes of all linearizations held now; zero where a model does not say.
    fn bytes_kept(&self) -> usize {
        0
    }

    /// Length of the control z.
    fn control_dim(&self) -> usize {
        self.dim()
    }

    /// x₀ from the control z. Keeps what the two derivatives below need.
    fn initial_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        x.copy_from_slice(z);
        Ok(())
    }

    /// dx₀ = ∂x₀/∂z dz at the control of the last `initial_state`.
    fn initial_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        dx.copy_from_slice(dz);
    }

    /// dz = (∂x₀/∂z)ᵀ λ₀ at the control of the last `initial_state`.
    fn initial_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        dz.copy_from_slice(lambda);
    }

    /// Work done since the model was made.
    fn counts(&self) -> Counts;

    /// What happened that the user should know: substeps taken, a pivot near zero.
    fn warnings(&self) -> &[Warning] {
        &[]
    }
}

/// Work done by a model. Integers, exact, the same on every run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Steps taken (a step taken in parts counts once).
    pub model_steps: usize,
    /// Extra parts of steps that had to be split.
    pub substeps: usize,
    /// Products with M_k.
    pub tangent_steps: usize,
    /// Products with M_kᵀ.
    pub adjoint_steps: usize,
    /// Linearizations of a step.
    pub linearizations: usize,
    /// Those of them that took over the last factor of Newton's method (see [`Linearization`](crate::Linearization)).
    pub reused: usize,
    /// Numerical factorizations of ∂G/∂u, in steps and in linearizations.
    pub factorizations: usize,
    /// Newton iterations.
    pub newton_iterations: usize,
}

impl Counts {
    fn each(self, other: Self, f: fn(usize, usize) -> usize) -> Self {
        Counts {
            model_steps: f(self.model_steps, other.model_steps),
            substeps: f(self.substeps, other.substeps),
            tangent_steps: f(self.tangent_steps, other.tangent_steps),
            adjoint_steps: f(self.adjoint_steps, other.adjoint_steps),
            linearizations: f(self.linearizations, other.linearizations),
            reused: f(self.reused, other.reused),
            factorizations: f(self.factorizations, other.factorizations),
            newton_iterations: f(self.newton_iterations, other.newton_iterations),
        }
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

/// Something a step went through that did not stop it. One is kept for every step and text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Warning {
    /// Index k of the step.
    pub step: usize,
    /// What happened.
    pub text: String,
}
