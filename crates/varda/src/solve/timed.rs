//! Models that are timed from outside: libraries read no clock.

use std::ops::DerefMut;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use varda_implicit::{Counts, Error, Model, Warning};

/// Seconds that models have taken, summed over those that share it (and so over threads).
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

/// A model, borrowed or boxed, whose calls a clock times.
pub struct Timed<M> {
    model: M,
    clock: Clock,
}

impl<M> Timed<M> {
    /// `model`, timed by `clock`.
    pub fn new(model: M, clock: &Clock) -> Self {
        Timed { model, clock: clock.clone() }
    }
}

impl<M: DerefMut> Model for Timed<M>
where
    M::Target: Model,
{
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<(), Error> {
        timing(&self.clock.0.forward, || self.model.step(k, x, x_next))
    }

    fn linearize(&mut self, k: usize, x: &[f64], x_next: &[f64]) -> Result<(), Error> {
        timing(&self.clock.0.adjoint, || self.model.linearize(k, k, x, x_next))
    }

    fn tangent(&mut self, k: usize, dx: &mut [f64]) {
        timing(&self.clock.0.tangent, || self.model.tangent(k, dx));
    }

    fn adjoint(&mut self, k: usize, lambda: &mut [f64]) {
        timing(&self.clock.0.adjoint, || self.model.adjoint(k, lambda));
    }

    fn tangent_block(&mut self, k: usize, dx: &mut [f64]) {
        timing(&self.clock.0.tangent, || self.model.tangent_block(k, dx));
    }

    fn adjoint_block(&mut self, k: usize, lambda: &mut [f64]) {
        timing(&self.clock.0.adjoint, || self.model.adjoint_block(k, lambda));
    }

    fn keep_at_most(&mut self, steps: usize) {
        self.model.keep_at_most(steps);
    }

    fn bytes_per_step(&self) -> usize {
        self.model.bytes_per_step()
    }

    fn bytes_kept(&self) -> usize {
        self.model.bytes_kept()
    }

    fn control_dim(&self) -> usize {
        self.model.control_dim()
    }

    fn initial_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        timing(&self.clock.0.forward, || self.model.initial_state(z, x))
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
        self.model.warnings()
    }
}
