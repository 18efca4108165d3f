//! Several steps of a model as one.

use crate::{Counts, Error, Model, Warning};

/// A model whose step k is the steps `first[k]` … `first[k + 1]` − 1 of another, in order: M_k = M′_{b−1} … M′_a.
///
/// Observations and outputs then stay on an even grid of time while the steps in between have the lengths that
/// [`accepted_times`](crate::accepted_times) found. Counts are those of the steps really taken.
///
/// Linearizing needs the states in between: those of the last step taken are at hand, else it is run again.
#[derive(Debug)]
pub struct Grouped<M> {
    model: M,
    first: Vec<usize>,
    /// The last step taken, and all its states.
    last: Option<usize>,
    states: Vec<f64>,
    warnings: Vec<Warning>,
    /// Warnings of the model that are in `warnings`.
    seen: usize,
}

impl<M: Model> Grouped<M> {
    /// Groups the steps of `model` at the given boundaries.
    ///
    /// # Panics
    /// If there are fewer than two boundaries or they do not ascend.
    pub fn new(model: M, first: Vec<usize>) -> Self {
        let ascending = first.windows(2).all(|f| f[0] < f[1]);
        assert!(first.len() > 1 && ascending, "groups of steps need two or more ascending boundaries");
        Self { model, first, last: None, states: Vec::new(), warnings: Vec::new(), seen: 0 }
    }

    /// Groups the steps between `times` so that they end at the times of `through`, which must be among them.
    ///
    /// # Panics
    /// If they are not, or are fewer than two.
    pub fn through(model: M, times: &[f64], through: &[f64]) -> Self {
        let place =
            |t: &f64| times.iter().position(|time| time == t).expect("a time that is not on the grid");
        Self::new(model, through.iter().map(place).collect())
    }

    /// Steps in the longest group.
    fn longest(&self) -> usize {
        self.first.windows(2).map(|f| f[1] - f[0]).max().unwrap_or(1)
    }

    fn run(&mut self, k: usize, x: &[f64]) -> Result<(), Error> {
        assert!(k + 1 < self.first.len(), "step {k} of {}", self.first.len() - 1);
        let (n, steps) = (x.len(), self.first[k]..self.first[k + 1]);
        self.last = None;
        self.states.resize((steps.len() + 1) * n, 0.0);
        self.states[..n].copy_from_slice(x);
        for (i, step) in steps.enumerate() {
            let (x, x_next) = self.states[i * n..(i + 2) * n].split_at_mut(n);
            self.model.step(step, x, x_next).map_err(|e| e.at_step(k))?;
        }
        self.last = Some(k);
        for warning in &self.model.warnings()[self.seen..] {
            self.warnings.push(Warning { step: k, text: warning.text.clone() });
        }
        self.seen = self.model.warnings().len();
        Ok(())
    }
}

impl<M: Model> Model for Grouped<M> {
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<(), Error> {
        self.run(k, x)?;
        x_next.copy_from_slice(&self.states[self.states.len() - x.len()..]);
        Ok(())
    }

    fn linearize(&mut self, k: usize, x: &[f64], x_next: &[f64]) -> Result<(), Error> {
        if !(self.last == Some(k) && self.states.starts_with(x)) {
            self.run(k, x)?;
        }
        if !self.states.ends_with(x_next) {
            return Err(Error::NotAStep { step: k });
        }
        let n = x.len();
        for (i, step) in (self.first[k]..self.first[k + 1]).enumerate() {
            let (x, x_next) = self.states[i * n..(i + 2) * n].split_at(n);
            self.model.linearize(step, x, x_next).map_err(|e| e.at_step(k))?;
        }
        Ok(())
    }

    fn tangent(&mut self, k: usize, dx: &mut [f64]) {
        for step in self.first[k]..self.first[k + 1] {
            self.model.tangent(step, dx);
        }
    }

    fn adjoint(&mut self, k: usize, lambda: &mut [f64]) {
        for step in (self.first[k]..self.first[k + 1]).rev() {
            self.model.adjoint(step, lambda);
        }
    }

    fn tangent_block(&mut self, k: usize, dx: &mut [f64]) {
        for step in self.first[k]..self.first[k + 1] {
            self.model.tangent_block(step, dx);
        }
    }

    fn adjoint_block(&mut self, k: usize, lambda: &mut [f64]) {
        for step in (self.first[k]..self.first[k + 1]).rev() {
            self.model.adjoint_block(step, lambda);
        }
    }

    fn keep_at_most(&mut self, steps: usize) {
        self.model.keep_at_most(steps.saturating_mul(self.longest()));
    }

    fn bytes_per_step(&self) -> usize {
        self.longest() * self.model.bytes_per_step()
    }

    fn bytes_kept(&self) -> usize {
        self.model.bytes_kept()
    }

    fn control_dim(&self) -> usize {
        self.model.control_dim()
    }

    fn initial_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        self.model.initial_state(z, x)
    }

    fn initial_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        self.model.initial_tangent(dz, dx);
    }

    fn initial_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        self.model.initial_adjoint(lambda, dz);
    }

    fn counts(&self) -> Counts {
        self.model.counts()
    }

    fn warnings(&self) -> &[Warning] {
        &self.warnings
    }
}
