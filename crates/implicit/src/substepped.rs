//! Several steps of a model as one.

use crate::{ControlMap, Error, Model, Rate, SecondOrder, Work};
use std::ops::Range;

/// A model whose step k is the steps `first[k]` … `first[k + 1]` − 1 of another, in order: M_k =
/// M′_{b−1} … M′_a.
///
/// Observations and outputs then stay on an even grid of time while the steps in between have the lengths
/// that [`accepted_times`](crate::accepted_times) found. Work is that of the steps really taken.
///
/// Linearizing needs the states in between: those of the last step taken are at hand, else it is run again.
///
/// ```
/// use varda_implicit::{Model, Rk4, Substepped, lorenz::Lorenz63};
///
/// // Steps of 0.01, two and then three of them to an observation.
/// let mut fine = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let (mut x, mut next) = ([1.0, 3.0, 20.0], [0.0; 3]);
/// for k in 0..2 {
///     fine.step(k, &x, &mut next)?;
///     x = next;
/// }
/// let mut coarse = Substepped::new(fine, vec![0, 2, 5]);
/// coarse.step(0, &[1.0, 3.0, 20.0], &mut next)?;
/// assert_eq!(next, x);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug)]
pub struct Substepped<M> {
    model: M,
    first: Vec<usize>,
    /// The last step taken, and all its states.
    last: Option<usize>,
    states: Vec<f64>,
    /// The step whose linearization a slot holds.
    linearized: Vec<usize>,
    /// Work space of second derivatives.
    tangents: Vec<f64>,
    adjoints: Vec<f64>,
}

impl<M: Model> Substepped<M> {
    /// Groups the steps of `model` at the given boundaries.
    ///
    /// # Panics
    /// If there are fewer than two boundaries or they do not ascend.
    pub fn new(model: M, first: Vec<usize>) -> Self {
        let ascending = first.windows(2).all(|f| f[0] < f[1]);
        assert!(first.len() > 1 && ascending, "groups of steps need two or more ascending boundaries");
        Self {
            model,
            first,
            last: None,
            states: Vec::new(),
            linearized: Vec::new(),
            tangents: Vec::new(),
            adjoints: Vec::new(),
        }
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

    /// The inner slots that a slot stands for: as many as the longest step needs.
    fn inner(&self, slot: usize) -> std::ops::Range<usize> {
        let k = *self.linearized.get(slot).unwrap_or_else(|| panic!("slot {slot} holds no linearization"));
        let first = slot * self.longest();
        first..first + self.first[k + 1] - self.first[k]
    }

    fn run(&mut self, k: usize, x: &[f64]) -> Result<Work, Error> {
        assert!(k + 1 < self.first.len(), "step {k} of {}", self.first.len() - 1);
        let (n, steps) = (x.len(), self.first[k]..self.first[k + 1]);
        self.last = None;
        self.states.resize((steps.len() + 1) * n, 0.0);
        self.states[..n].copy_from_slice(x);
        let mut did = Work { steps: 0, ..Work::default() };
        for (i, step) in steps.enumerate() {
            let (x, x_next) = self.states[i * n..(i + 2) * n].split_at_mut(n);
            did.add(self.model.step(step, x, x_next).map_err(|e| e.at_step(k))?);
        }
        self.last = Some(k);
        Ok(did)
    }
}

impl<M: Model> Model for Substepped<M> {
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        let did = self.run(k, x)?;
        x_next.copy_from_slice(&self.states[self.states.len() - x.len()..]);
        Ok(did)
    }

    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error> {
        let mut did = Work { steps: 0, ..Work::default() };
        if !(self.last == Some(k) && self.states.starts_with(x)) {
            // states in between are run again: the Newton iterations count, the steps do not
            did = Work { steps: 0, ..self.run(k, x)? };
        }
        if !self.states.ends_with(x_next) {
            return Err(Error::NotAStep { step: k });
        }
        if self.linearized.len() <= slot {
            self.linearized.resize(slot + 1, k);
        }
        self.linearized[slot] = k;
        let (n, inner, first) = (x.len(), self.inner(slot), self.first[k]);
        for (i, inner_slot) in inner.enumerate() {
            let (x, x_next) = self.states[i * n..(i + 2) * n].split_at(n);
            let linearized = self.model.linearize(inner_slot, first + i, x, x_next);
            did.add(linearized.map_err(|e| e.at_step(k))?);
        }
        Ok(did)
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        self.inner(slot).for_each(|inner| self.model.tangent(inner, dx));
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        self.inner(slot).rev().for_each(|inner| self.model.adjoint(inner, lambda));
    }

    fn release(&mut self, from_slot: usize) {
        self.linearized.truncate(from_slot);
        self.model.release(from_slot.saturating_mul(self.longest()));
    }

    fn slot_bytes(&self) -> usize {
        self.longest() * self.model.slot_bytes()
    }

    fn bytes(&self) -> usize {
        self.model.bytes()
    }

    fn rate(&self) -> Option<Box<dyn Rate>> {
        let rate = self.model.rate()?;
        Some(Box::new(Grouped { rate, first: self.first.clone() }))
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        self.model.control_map()
    }

    fn second_order(&mut self) -> Option<&mut dyn SecondOrder> {
        if self.model.second_order().is_some() { Some(self) } else { None }
    }
}

impl<M: Model> SecondOrder for Substepped<M> {
    fn adjoint_derivative(
        &mut self,
        slot: usize,
        dx: &[f64],
        lambda: &[f64],
        derivative: &mut [f64],
    ) -> Result<(), Error> {
        let (n, inner) = (dx.len(), self.inner(slot));
        let steps = inner.len();
        // dx at the start of every inner step, λ at its end
        self.tangents.resize(steps * n, 0.0);
        self.adjoints.resize(steps * n, 0.0);
        self.tangents[..n].copy_from_slice(dx);
        self.adjoints[(steps - 1) * n..].copy_from_slice(lambda);
        for i in 1..steps {
            let (before, after) = self.tangents.split_at_mut(i * n);
            after[..n].copy_from_slice(&before[(i - 1) * n..]);
            self.model.tangent(inner.start + i - 1, &mut after[..n]);
        }
        for i in (1..steps).rev() {
            let (before, after) = self.adjoints.split_at_mut(i * n);
            let before = &mut before[(i - 1) * n..];
            before.copy_from_slice(&after[..n]);
            self.model.adjoint(inner.start + i, before);
        }
        let second = self.model.second_order().expect("asked for only where it is");
        for (i, slot) in inner.enumerate().rev() {
            let at = i * n..(i + 1) * n;
            second.adjoint_derivative(slot, &self.tangents[at.clone()], &self.adjoints[at], derivative)?;
        }
        Ok(())
    }

    fn initial_adjoint_derivative(&mut self, delta: &[f64], lambda: &[f64], dz: &mut [f64]) {
        if let Some(second) = self.model.second_order() {
            second.initial_adjoint_derivative(delta, lambda, dz);
        }
    }
}

/// The rate of a model whose steps are those of another in groups.
struct Grouped {
    rate: Box<dyn Rate>,
    first: Vec<usize>,
}

impl Rate for Grouped {
    fn components(&self) -> Range<usize> {
        self.rate.components()
    }

    fn length(&self, k: usize) -> f64 {
        (self.first[k]..self.first[k + 1]).map(|inner| self.rate.length(inner)).sum()
    }

    fn eval(&mut self, k: usize, x: &[f64], rate: &mut [f64]) {
        self.rate.eval(self.first[k], x, rate);
    }

    fn tangent(&mut self, k: usize, x: &[f64], dx: &[f64], rate: &mut [f64]) {
        self.rate.tangent(self.first[k], x, dx, rate);
    }

    fn adjoint_add(&mut self, k: usize, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        self.rate.adjoint_add(self.first[k], x, lambda, dx);
    }

    fn second_adjoint_add(&mut self, k: usize, x: &[f64], dx: &[f64], lambda: &[f64], out: &mut [f64]) {
        self.rate.second_adjoint_add(self.first[k], x, dx, lambda, out);
    }
}
