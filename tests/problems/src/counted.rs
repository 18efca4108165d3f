//! A model that remembers what it did, for rows that call single steps.

use std::ops::{Deref, DerefMut};
use varda_implicit::{ControlMap, Counts, Error, Log, Model, Work};

/// Any model, with the log of its calls.
pub struct Counted<M> {
    model: M,
    log: Log,
}

impl<M> Counted<M> {
    /// Nothing has been counted yet.
    pub fn new(model: M) -> Self {
        Self { model, log: Log::default() }
    }

    /// The model.
    pub fn into_inner(self) -> M {
        self.model
    }

    /// The work so far; products are not counted.
    pub fn counts(&self) -> Counts {
        self.log.counts
    }
}

impl<M> Deref for Counted<M> {
    type Target = M;

    fn deref(&self) -> &M {
        &self.model
    }
}

impl<M> DerefMut for Counted<M> {
    fn deref_mut(&mut self) -> &mut M {
        &mut self.model
    }
}

impl<M: Model> Model for Counted<M> {
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        let work = self.model.step(k, x, x_next)?;
        self.log.step(k, work.clone());
        Ok(work)
    }

    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error> {
        let work = self.model.linearize(slot, k, x, x_next)?;
        self.log.linearization(k, work.clone());
        Ok(work)
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        self.model.tangent(slot, dx);
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        self.model.adjoint(slot, lambda);
    }

    fn release(&mut self, from_slot: usize) {
        self.model.release(from_slot);
    }

    fn slot_bytes(&self) -> usize {
        self.model.slot_bytes()
    }

    fn bytes(&self) -> usize {
        self.model.bytes()
    }

    fn rate(&self) -> Option<Box<dyn varda_implicit::Rate>> {
        self.model.rate()
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        self.model.control_map()
    }

    fn second_order(&mut self) -> Option<&mut dyn varda_implicit::SecondOrder> {
        self.model.second_order()
    }
}
