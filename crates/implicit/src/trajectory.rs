//! The states of a window, and sweeps along them.

use crate::{Error, Model};

/// What a forward run keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Keep {
    /// The states alone. [`Trajectory::linearize`] can add the rest later.
    States,
    /// The states, and in the model the linearization of every step: what sweeps need.
    Linearizations,
}

/// The states x₀ … x_N of a window, and tangent and adjoint sweeps along them.
///
/// The linearizations live in the model; a trajectory knows whether they are those of its states as long as nothing
/// else linearizes the same model. Buffers are reused from run to run.
///
/// ```
/// use varda_implicit::{Keep, Rk4, Trajectory, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let mut trajectory = Trajectory::new();
/// trajectory.run(&mut model, &[1.0, 1.0, 20.0], 100, Keep::Linearizations)?;
/// // the gradient of ½‖x_N‖² with respect to x₀
/// let last = trajectory.state(100).to_vec();
/// let mut lambda = [0.0; 3];
/// trajectory.adjoint(&mut model, &mut lambda, &mut |k, lambda| {
///     if k == 100 {
///         lambda.iter_mut().zip(&last).for_each(|(l, x)| *l += x);
///     }
/// });
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Trajectory {
    dim: usize,
    states: Vec<f64>,
    linearized: bool,
}

impl Trajectory {
    /// An empty trajectory.
    pub fn new() -> Self {
        Self::default()
    }

    /// Runs the model over `steps` steps from x₀ and keeps every state.
    ///
    /// # Errors
    /// The first error of a step; the trajectory is then empty.
    ///
    /// # Panics
    /// If x₀ has not the model's length.
    pub fn run(&mut self, model: &mut dyn Model, x0: &[f64], steps: usize, keep: Keep) -> Result<(), Error> {
        let n = model.dim();
        assert_eq!(x0.len(), n, "the initial state has the wrong length");
        self.dim = n;
        self.states.resize((steps + 1) * n, 0.0);
        self.states[..n].copy_from_slice(x0);
        let result = (0..steps).try_for_each(|k| {
            let (x, x_next) = self.states[k * n..(k + 2) * n].split_at_mut(n);
            model.step(k, x, x_next)?;
            if keep == Keep::Linearizations { model.linearize(k, x, x_next) } else { Ok(()) }
        });
        if result.is_err() {
            self.states.clear();
        }
        self.linearized = keep == Keep::Linearizations && result.is_ok();
        result
    }

    /// Linearizes every step, where that has not been done.
    ///
    /// # Errors
    /// The first error of a step.
    pub fn linearize(&mut self, model: &mut dyn Model) -> Result<(), Error> {
        if !self.linearized {
            for k in 0..self.steps() {
                model.linearize(k, self.state(k), self.state(k + 1))?;
            }
            self.linearized = true;
        }
        Ok(())
    }

    /// N, the number of steps.
    pub fn steps(&self) -> usize {
        (self.states.len() / self.dim.max(1)).saturating_sub(1)
    }

    /// x_k, k = 0 … N.
    ///
    /// # Panics
    /// If k > N.
    pub fn state(&self, k: usize) -> &[f64] {
        &self.states[k * self.dim..(k + 1) * self.dim]
    }

    /// x₀ … x_N, one after the other.
    pub fn states(&self) -> &[f64] {
        &self.states
    }

    /// dx_{k+1} = M_k dx_k from the dx₀ given to dx_N, in place; `see(k, dx_k)` is called for k = 0 … N.
    ///
    /// # Panics
    /// If the trajectory has not been linearized, or `dx` has the wrong length.
    pub fn tangent(&self, model: &mut dyn Model, dx: &mut [f64], see: &mut dyn FnMut(usize, &[f64])) {
        self.ready(dx);
        see(0, dx);
        for k in 0..self.steps() {
            model.tangent(k, dx);
            see(k + 1, dx);
        }
    }

    /// Σ_k (M_{k−1} … M_0)ᵀ f_k by Horner's rule, λ_k = M_kᵀ λ_{k+1} + f_k, in place: `add(k, λ)` adds the forcing f_k to λ, for
    /// k = N … 0. λ is overwritten with zeros first, and ends as λ₀.
    ///
    /// # Panics
    /// If the trajectory has not been linearized, or `lambda` has the wrong length.
    pub fn adjoint(&self, model: &mut dyn Model, lambda: &mut [f64], add: &mut dyn FnMut(usize, &mut [f64])) {
        self.ready(lambda);
        lambda.fill(0.0);
        add(self.steps(), lambda);
        for k in (0..self.steps()).rev() {
            model.adjoint(k, lambda);
            add(k, lambda);
        }
    }

    fn ready(&self, vector: &[f64]) {
        assert_eq!(vector.len(), self.dim, "a state has {} values", self.dim);
        assert!(self.linearized || self.steps() == 0, "the trajectory has not been linearized");
    }
}
