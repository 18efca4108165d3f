//! The states of a window, and sweeps along them.

use crate::storage::next_checkpoint;
use crate::{Counts, Error, Log, Model, Storage};

/// Whether a forward run linearizes its steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Keep {
    /// No linearizations. A sweep, or [`Trajectory::linearize`], makes them later.
    States,
    /// In the model the linearization of every step, made as the run goes, where the storage keeps them all.
    Linearizations,
}

/// The states x₀ … x_N of a window, or those of them that its [`Storage`] keeps, and tangent and adjoint
/// sweeps along them.
///
/// The linearizations live in slots of the model that the trajectory names: slot k for step k where all are
/// kept, else slot 0. It knows whether they are those of its states as long as nothing else linearizes the
/// same model. What the model did in all runs and sweeps is in the [`log`](Self::log). Buffers are reused
/// from run to run.
///
/// ```
/// use varda_implicit::{Keep, Rk4, Storage, Trajectory, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let mut gradients = Vec::new();
/// for storage in [Storage::KeepAll, Storage::Checkpoints { states: 4 }] {
///     let mut trajectory = Trajectory::with_storage(storage);
///     trajectory.run(&mut model, &[1.0, 1.0, 20.0], 100, Keep::Linearizations)?;
///     // the gradient of ½‖x_N‖² with respect to x₀
///     let mut lambda = [0.0; 3];
///     trajectory.adjoint(&mut model, &mut lambda, &mut |k, x, lambda| {
///         if k == 100 {
///             lambda.iter_mut().zip(x).for_each(|(l, x)| *l += x);
///         }
///     })?;
///     gradients.push(lambda);
/// }
/// assert_eq!(gradients[0], gradients[1]);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct Trajectory {
    storage: Storage,
    dim: usize,
    steps: usize,
    /// All states, or those of `placed`.
    states: Vec<f64>,
    linearized: bool,
    /// Checkpoints: the indices of the states kept, ascending from 0.
    placed: Vec<usize>,
    /// Checkpoints: x_k and x_{k+1} of the step last run, and k.
    x: Vec<f64>,
    x_next: Vec<f64>,
    front: Option<usize>,
    log: Log,
}

/// A step of a window in a sweep, linearized: products with M_k and M_kᵀ.
pub struct LinearizedStep<'a> {
    model: &'a mut dyn Model,
    slot: usize,
    log: &'a mut Log,
    /// k.
    pub k: usize,
    /// x_k.
    pub x: &'a [f64],
    /// x_{k+1}.
    pub x_next: &'a [f64],
}

impl LinearizedStep<'_> {
    /// dx ← M_k dx, for one column or several.
    pub fn tangent(&mut self, dx: &mut [f64]) {
        self.tangent_of_share(dx.len() / self.x.len().max(1), dx);
    }

    /// λ ← M_kᵀ λ, for one column or several.
    pub fn adjoint(&mut self, lambda: &mut [f64]) {
        self.adjoint_of_share(lambda.len() / self.x.len().max(1), lambda);
    }

    /// dx ← M_k dx for some of `all` columns, whose others another process does: each has the bits that it
    /// has among all, and all are counted.
    pub fn tangent_of_share(&mut self, all: usize, dx: &mut [f64]) {
        self.log.counts.tangent_steps += all;
        let done = product_of_share(self.x.len(), all, dx, |dx| self.model.tangent(self.slot, dx));
        if done < all {
            self.model.count_elsewhere(Counts { tangent_steps: all - done, ..Counts::default() });
        }
    }

    /// λ ← M_kᵀ λ for some of `all` columns, as `tangent_of_share`.
    pub fn adjoint_of_share(&mut self, all: usize, lambda: &mut [f64]) {
        self.log.counts.adjoint_steps += all;
        let done =
            product_of_share(self.x.len(), all, lambda, |lambda| self.model.adjoint(self.slot, lambda));
        if done < all {
            self.model.count_elsewhere(Counts { adjoint_steps: all - done, ..Counts::default() });
        }
    }

    /// dx ← M_k dx, what [`adjoint_derivative`](Self::adjoint_derivative) needs of it kept where the
    /// storage keeps linearizations.
    ///
    /// # Panics
    /// If the model has no second derivatives.
    pub fn tangent_kept(&mut self, dx: &mut [f64]) {
        self.log.counts.tangent_steps += 1;
        let second = self.model.second_order().expect("a model with second derivatives");
        second.tangent_kept(self.slot, dx);
    }

    /// λ̇ ← M_kᵀ λ̇ + Σ_i λ_i ∂²M_{k,i}/∂x² dx, see [`SecondOrder`](crate::SecondOrder).
    ///
    /// # Errors
    /// As [`SecondOrder::adjoint_derivative`](crate::SecondOrder::adjoint_derivative).
    ///
    /// # Panics
    /// If the model has no second derivatives.
    pub fn adjoint_derivative(
        &mut self,
        dx: &[f64],
        lambda: &[f64],
        derivative: &mut [f64],
    ) -> Result<(), Error> {
        self.log.counts.adjoint_derivatives += 1;
        let second = self.model.second_order().expect("a model with second derivatives");
        second.adjoint_derivative(self.slot, dx, lambda, derivative)
    }
}

/// The product of some of `all` columns of length n; returns how many columns the model is given. One of
/// several has a column of zeros beside it, since a model may round one alone otherwise.
fn product_of_share(n: usize, all: usize, columns: &mut [f64], product: impl FnOnce(&mut [f64])) -> usize {
    let own = columns.len() / n.max(1);
    if own == 1 && all > 1 {
        let mut pair = [&*columns, &vec![0.0; n]].concat();
        product(&mut pair);
        columns.copy_from_slice(&pair[..n]);
        return 2;
    }
    if own > 0 {
        product(columns);
    }
    own
}

impl Trajectory {
    /// An empty trajectory that keeps everything.
    pub fn new() -> Self {
        Self::default()
    }

    /// An empty trajectory.
    ///
    /// # Panics
    /// If not even one state is to be kept.
    pub fn with_storage(storage: Storage) -> Self {
        assert!(storage != Storage::Checkpoints { states: 0 }, "at least one state must be kept");
        Self { storage, ..Self::default() }
    }

    /// What is kept.
    pub fn storage(&self) -> Storage {
        self.storage
    }

    /// Heap memory held, in bytes: the states, not the linearizations (see [`Model::bytes`]).
    pub fn bytes(&self) -> usize {
        let words = self.states.capacity() + self.x.capacity() + self.x_next.capacity();
        words * size_of::<f64>() + self.placed.capacity() * size_of::<usize>()
    }

    /// Runs the model over `steps` steps from x₀.
    ///
    /// # Errors
    /// The first error of a step; the trajectory is then empty.
    ///
    /// # Panics
    /// If x₀ has not the model's length.
    pub fn run(&mut self, model: &mut dyn Model, x0: &[f64], steps: usize, keep: Keep) -> Result<(), Error> {
        assert_eq!(x0.len(), model.dim(), "the initial state has the wrong length");
        self.start(x0.len(), steps).copy_from_slice(x0);
        self.forward(model, keep, &mut |_, _| Ok::<(), Error>(()))
    }

    /// The work of the model in all runs and sweeps of this trajectory, and what its steps went through.
    pub fn log(&self) -> &Log {
        &self.log
    }

    /// Makes room for a window of `steps` steps of states of length `dim`; the place of x₀, to be filled
    /// before [`forward`](Self::forward).
    pub fn start(&mut self, dim: usize, steps: usize) -> &mut [f64] {
        (self.dim, self.steps) = (dim, steps);
        self.linearized = false;
        self.front = None;
        self.placed.clear();
        let kept = match self.storage {
            Storage::KeepAll | Storage::States => steps + 1,
            Storage::Checkpoints { states } => {
                let kept = states.min(steps.max(1));
                self.placed.reserve_exact(kept);
                self.placed.push(0);
                self.x.resize(dim, 0.0);
                self.x_next.resize(dim, 0.0);
                kept
            }
        };
        self.states.resize(kept * dim, 0.0);
        &mut self.states[..dim]
    }

    /// Runs all steps from the x₀ put in place. `see(k, x_k)` is called for k = 0 … N and may change the
    /// state: what it leaves is x_k. (A change has to be made again in every run of the step: only where all
    /// states are kept.)
    ///
    /// # Errors
    /// The first error of a step or of `see`; the trajectory is then empty.
    pub fn forward<E: From<Error>>(
        &mut self,
        model: &mut dyn Model,
        keep: Keep,
        see: &mut dyn FnMut(usize, &mut [f64]) -> Result<(), E>,
    ) -> Result<(), E> {
        self.release(model);
        let linearize = keep == Keep::Linearizations && self.storage == Storage::KeepAll;
        let n = self.dim;
        let mut result = see(0, &mut self.states[..n]);
        if result.is_ok() && self.steps > 0 {
            result = match self.storage {
                Storage::KeepAll | Storage::States => (0..self.steps).try_for_each(|k| {
                    let (x, x_next) = self.states[k * n..(k + 2) * n].split_at_mut(n);
                    self.log.step(k, model.step(k, x, x_next)?);
                    if linearize {
                        self.log.linearization(k, model.linearize(k, k, x, x_next)?);
                    }
                    see(k + 1, x_next)
                }),
                Storage::Checkpoints { .. } => self.run_to(model, self.steps, see),
            };
        }
        self.linearized = linearize && result.is_ok();
        if result.is_err() {
            self.steps = 0;
            self.states.clear();
        }
        result
    }

    /// Linearizes every step, where all linearizations are kept and that has not been done.
    ///
    /// # Errors
    /// The first error of a step.
    pub fn linearize(&mut self, model: &mut dyn Model) -> Result<(), Error> {
        self.linearize_landing(model, &|_| None)
    }

    /// The same where x_{k+1} was changed after step k: `landing(k)` is then what the step itself had led to,
    /// M_k(x_k).
    ///
    /// # Errors
    /// The first error of a step.
    pub fn linearize_landing<'l>(
        &mut self,
        model: &mut dyn Model,
        landing: &dyn Fn(usize) -> Option<&'l [f64]>,
    ) -> Result<(), Error> {
        self.release(model);
        if self.storage == Storage::KeepAll && !self.linearized {
            for k in 0..self.steps {
                let x_next = landing(k).unwrap_or_else(|| self.state(k + 1));
                let work = model.linearize(k, k, self.state(k), x_next)?;
                self.log.linearization(k, work);
            }
            self.linearized = true;
        }
        Ok(())
    }

    /// To be called when something else has linearized the model.
    pub fn forget_linearizations(&mut self) {
        self.linearized = false;
    }

    /// N, the number of steps.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// x_k, k = 0 … N.
    ///
    /// # Panics
    /// If k > N, or the storage does not keep all states and this is not x₀.
    pub fn state(&self, k: usize) -> &[f64] {
        let all = k == 0 || !matches!(self.storage, Storage::Checkpoints { .. });
        assert!(all, "state {k} is not kept: the storage keeps checkpoints");
        &self.states[k * self.dim..(k + 1) * self.dim]
    }

    /// x₀ … x_N, one after the other, where all states are kept; else x₀ and those kept at the moment.
    pub fn states(&self) -> &[f64] {
        &self.states
    }

    /// dx_{k+1} = M_k dx_k from the dx₀ given to dx_N, in place; `see(k, x_k, dx_k)` is called for k = 0
    /// … N.
    ///
    /// # Errors
    /// Of a step that is linearized or run again, as the storage asks.
    ///
    /// # Panics
    /// If `dx` has the wrong length.
    pub fn tangent(
        &mut self,
        model: &mut dyn Model,
        dx: &mut [f64],
        see: &mut dyn FnMut(usize, &[f64], &mut [f64]),
    ) -> Result<(), Error> {
        self.check(dx);
        see(0, &self.states[..self.dim], dx);
        self.for_each_step(model, &mut |step| {
            step.tangent(dx);
            see(step.k + 1, step.x_next, dx);
        })
    }

    /// Σ_k (M_{k−1} … M_0)ᵀ f_k by Horner's rule, λ_k = M_kᵀ λ_{k+1} + f_k, in place: `add(k, x_k,
    /// λ)` adds the forcing f_k to λ, for k = N … 0. λ is overwritten with zeros first, and ends as
    /// λ₀.
    ///
    /// # Errors
    /// Of a step that is linearized or run again, as the storage asks.
    ///
    /// # Panics
    /// If `lambda` has the wrong length.
    pub fn adjoint(
        &mut self,
        model: &mut dyn Model,
        lambda: &mut [f64],
        add: &mut dyn FnMut(usize, &[f64], &mut [f64]),
    ) -> Result<(), Error> {
        self.check(lambda);
        lambda.fill(0.0);
        let steps = self.steps;
        if steps == 0 {
            add(0, &self.states[..self.dim], lambda);
        }
        self.for_each_step_reversed(model, &mut |step| {
            if step.k + 1 == steps {
                add(steps, step.x_next, lambda);
            }
            step.adjoint(lambda);
            add(step.k, step.x, lambda);
        })
    }

    /// `act` on every step, linearized, for k = 0 … N−1.
    ///
    /// # Errors
    /// Of a step that is linearized or run again, as the storage asks.
    pub fn for_each_step(
        &mut self,
        model: &mut dyn Model,
        act: &mut dyn FnMut(&mut LinearizedStep<'_>),
    ) -> Result<(), Error> {
        self.release(model);
        if let Storage::Checkpoints { .. } = self.storage {
            self.rewind();
            return self.advance(model, self.steps, &mut |model, log, k, x, x_next| {
                log.linearization(k, model.linearize(0, k, x, x_next)?);
                act(&mut LinearizedStep { model, slot: 0, log, k, x, x_next });
                Ok(())
            });
        }
        self.linearize(model)?;
        (0..self.steps).try_for_each(|k| self.act_on(model, k, act))
    }

    /// The same for k = N−1 … 0.
    ///
    /// # Errors
    /// Of a step that is linearized or run again, as the storage asks.
    pub fn for_each_step_reversed(
        &mut self,
        model: &mut dyn Model,
        act: &mut dyn FnMut(&mut LinearizedStep<'_>),
    ) -> Result<(), Error> {
        self.release(model);
        if let Storage::Checkpoints { .. } = self.storage {
            // After a forward run, or a sweep in its order, the last step is at hand and the checkpoints are
            // in place.
            if self.front.map(|k| k + 1) != Some(self.steps) {
                self.rewind();
            }
            for k in (0..self.steps).rev() {
                if self.front != Some(k) {
                    self.run_to(model, k + 1, &mut |_, _| Ok::<(), Error>(()))?;
                }
                let Self { x, x_next, log, .. } = self;
                log.linearization(k, model.linearize(0, k, x, x_next)?);
                act(&mut LinearizedStep { model, slot: 0, log, k, x, x_next });
                if k > 0 && self.placed.last() == Some(&k) {
                    self.placed.pop();
                }
            }
            return Ok(());
        }
        self.linearize(model)?;
        (0..self.steps).rev().try_for_each(|k| self.act_on(model, k, act))
    }

    /// dx ← M_k dx for one step, whose linearization is kept.
    ///
    /// # Panics
    /// If the window has not been linearized, or the storage does not keep all linearizations.
    pub fn tangent_of_step(&mut self, model: &mut dyn Model, k: usize, dx: &mut [f64]) {
        self.kept_step(model, k).tangent(dx);
    }

    /// λ ← M_kᵀ λ for one step, whose linearization is kept.
    ///
    /// # Panics
    /// If the window has not been linearized, or the storage does not keep all linearizations.
    pub fn adjoint_of_step(&mut self, model: &mut dyn Model, k: usize, lambda: &mut [f64]) {
        self.kept_step(model, k).adjoint(lambda);
    }

    fn kept_step<'a>(&'a mut self, model: &'a mut dyn Model, k: usize) -> LinearizedStep<'a> {
        assert!(self.linearized && k < self.steps, "step {k} has not been linearized");
        let n = self.dim;
        let (x, x_next) = self.states[k * n..(k + 2) * n].split_at(n);
        LinearizedStep { model, slot: k, log: &mut self.log, k, x, x_next }
    }

    /// Gives back the memory of linearizations that the storage does not keep.
    fn release(&self, model: &mut dyn Model) {
        if self.storage != Storage::KeepAll {
            model.release(1);
        }
    }

    /// One step of a sweep where all states are kept.
    fn act_on(
        &mut self,
        model: &mut dyn Model,
        k: usize,
        act: &mut dyn FnMut(&mut LinearizedStep<'_>),
    ) -> Result<(), Error> {
        let (n, linearized) = (self.dim, self.linearized);
        let Self { states, log, .. } = self;
        let (x, x_next) = states[k * n..(k + 2) * n].split_at(n);
        let slot = if linearized { k } else { 0 };
        if !linearized {
            log.linearization(k, model.linearize(slot, k, x, x_next)?);
        }
        act(&mut LinearizedStep { model, slot, log, k, x, x_next });
        Ok(())
    }

    /// Forgets all checkpoints but x₀.
    fn rewind(&mut self) {
        self.placed.truncate(1);
        self.front = None;
    }

    /// Runs from the last checkpoint to the end of step `to` − 1, letting `see` look at every new state.
    fn run_to<E: From<Error>>(
        &mut self,
        model: &mut dyn Model,
        to: usize,
        see: &mut dyn FnMut(usize, &mut [f64]) -> Result<(), E>,
    ) -> Result<(), E> {
        self.advance(model, to, &mut |_, _, k, _, x_next| see(k + 1, x_next))
    }

    /// Runs from the last checkpoint to the end of step `to` − 1 and keeps states on the way as the
    /// schedule has it; `after(model, log, k, x_k, x_{k+1})` is called after every step.
    fn advance<E: From<Error>>(
        &mut self,
        model: &mut dyn Model,
        to: usize,
        after: &mut dyn FnMut(&mut dyn Model, &mut Log, usize, &[f64], &mut [f64]) -> Result<(), E>,
    ) -> Result<(), E> {
        self.front = None;
        let n = self.dim;
        let room = self.states.len() / n.max(1);
        let (mut slot, from) = (self.placed.len() - 1, self.placed[self.placed.len() - 1]);
        self.x.copy_from_slice(&self.states[slot * n..(slot + 1) * n]);
        let mut next = next_checkpoint(from, to, room - slot);
        for k in from..to {
            if next == Some(k) {
                slot += 1;
                self.states[slot * n..(slot + 1) * n].copy_from_slice(&self.x);
                self.placed.push(k);
                next = next_checkpoint(k, to, room - slot);
            }
            self.log.step(k, model.step(k, &self.x, &mut self.x_next)?);
            after(model, &mut self.log, k, &self.x, &mut self.x_next)?;
            if k + 1 < to {
                std::mem::swap(&mut self.x, &mut self.x_next);
            }
        }
        self.front = to.checked_sub(1);
        Ok(())
    }

    fn check(&self, vector: &[f64]) {
        assert_eq!(vector.len(), self.dim, "a state has {} values", self.dim);
    }
}
