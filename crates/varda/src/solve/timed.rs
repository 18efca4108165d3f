//! Models that are timed from outside: libraries read no clock.

use std::ops::DerefMut;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use varda_implicit::{ControlMap, Counts, Error, Log, Model, Rate, Refusal, SecondOrder, Work};
use varda_linalg::interrupt;

/// Seconds spent in models, summed over all models that share the clock (and so over threads).
#[derive(Debug, Clone, Default)]
pub struct Clock(Arc<Nanoseconds>);

#[derive(Debug, Default)]
struct Nanoseconds {
    forward: AtomicU64,
    adjoint: AtomicU64,
    tangent: AtomicU64,
}

impl Clock {
    /// In steps and initial states \[s\].
    pub fn forward(&self) -> f64 {
        seconds(&self.0.forward)
    }

    /// In linearizations and adjoint products \[s\].
    pub fn adjoint(&self) -> f64 {
        seconds(&self.0.adjoint)
    }

    /// In tangent products \[s\].
    pub fn tangent(&self) -> f64 {
        seconds(&self.0.tangent)
    }
}

fn seconds(total: &AtomicU64) -> f64 {
    1e-9 * total.load(Ordering::Relaxed) as f64
}

/// Runs `work` and adds the time it took to `total`.
fn timing<T>(total: &AtomicU64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    total.fetch_add(start.elapsed().as_nanos() as u64, Ordering::Relaxed);
    result
}

/// A model, borrowed or boxed, whose calls a clock times and a log counts.
pub struct Timed<M> {
    model: M,
    /// Length of the model's control.
    control: usize,
    clock: Clock,
    log: Log,
}

impl<M: DerefMut> Timed<M>
where
    M::Target: Model,
{
    /// `model`, timed by `clock`.
    pub fn new(mut model: M, clock: &Clock) -> Self {
        Timed { control: model.control_dim(), model, clock: clock.clone(), log: Log::default() }
    }
}

impl<M> Timed<M> {
    /// What the model did, and what its steps went through.
    pub fn log(&self) -> &Log {
        &self.log
    }
}

impl<M: DerefMut> Model for Timed<M>
where
    M::Target: Model,
{
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        if interrupt::requested() {
            return Err(Error::Refused { step: k, reason: Refusal::new("interrupted") });
        }
        let work = timing(&self.clock.0.forward, || self.model.step(k, x, x_next))?;
        self.log.step(k, work.clone());
        Ok(work)
    }

    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error> {
        let work = timing(&self.clock.0.adjoint, || self.model.linearize(slot, k, x, x_next))?;
        self.log.linearization(k, work.clone());
        Ok(work)
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        if interrupt::requested() {
            // what comes of it is not looked at
            return;
        }
        self.log.counts.tangent_steps += dx.len() / self.model.dim().max(1);
        timing(&self.clock.0.tangent, || self.model.tangent(slot, dx));
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        if interrupt::requested() {
            return;
        }
        self.log.counts.adjoint_steps += lambda.len() / self.model.dim().max(1);
        timing(&self.clock.0.adjoint, || self.model.adjoint(slot, lambda));
    }

    fn count_elsewhere(&mut self, done: Counts) {
        self.log.counts = self.log.counts + done;
        self.model.count_elsewhere(done);
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

    fn rate(&self) -> Option<Box<dyn Rate>> {
        self.model.rate()
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        if self.model.control_map().is_some() { Some(self) } else { None }
    }

    fn second_order(&mut self) -> Option<&mut dyn SecondOrder> {
        if self.model.second_order().is_some() { Some(self) } else { None }
    }
}

/// The second derivatives of the model: their time is the adjoint's.
impl<M: DerefMut> SecondOrder for Timed<M>
where
    M::Target: Model,
{
    fn tangent_kept(&mut self, slot: usize, dx: &mut [f64]) {
        if interrupt::requested() {
            return;
        }
        self.log.counts.tangent_steps += 1;
        let model = self.model.second_order().expect("asked for only where it is");
        timing(&self.clock.0.tangent, || model.tangent_kept(slot, dx));
    }

    fn adjoint_derivative(
        &mut self,
        slot: usize,
        dx: &[f64],
        lambda: &[f64],
        derivative: &mut [f64],
    ) -> Result<(), Error> {
        if interrupt::requested() {
            return Ok(());
        }
        self.log.counts.adjoint_derivatives += 1;
        let model = self.model.second_order().expect("asked for only where it is");
        timing(&self.clock.0.adjoint, || model.adjoint_derivative(slot, dx, lambda, derivative))
    }

    fn initial_adjoint_derivative(&mut self, delta: &[f64], lambda: &[f64], dz: &mut [f64]) {
        if let Some(model) = self.model.second_order() {
            model.initial_adjoint_derivative(delta, lambda, dz);
        }
    }
}

/// The map of the model: its initial states are timed too.
impl<M: DerefMut> ControlMap for Timed<M>
where
    M::Target: Model,
{
    fn control_len(&self) -> usize {
        self.control
    }

    fn to_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        timing(&self.clock.0.forward, || self.model.initial_state(z, x))
    }

    fn to_state_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        self.model.initial_tangent(dz, dx);
    }

    fn to_state_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        self.model.initial_adjoint(lambda, dz);
    }
}
