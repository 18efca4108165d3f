//! A model that is timed from outside: libraries read no clock.

use std::time::{Duration, Instant};

use varda_implicit::{Counts, Error, Model, Warning};

/// Any model, with the seconds its calls took.
pub struct Timed<'a> {
    model: &'a mut dyn Model,
    /// Steps and initial states.
    pub forward: Duration,
    /// Linearizations and adjoint products.
    pub adjoint: Duration,
    /// Tangent products.
    pub tangent: Duration,
}

impl<'a> Timed<'a> {
    /// Starts at zero.
    pub fn new(model: &'a mut dyn Model) -> Self {
        Timed { model, forward: Duration::ZERO, adjoint: Duration::ZERO, tangent: Duration::ZERO }
    }
}

impl Model for Timed<'_> {
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<(), Error> {
        let start = Instant::now();
        let result = self.model.step(k, x, x_next);
        self.forward += start.elapsed();
        result
    }

    fn linearize(&mut self, k: usize, x: &[f64], x_next: &[f64]) -> Result<(), Error> {
        let start = Instant::now();
        let result = self.model.linearize(k, x, x_next);
        self.adjoint += start.elapsed();
        result
    }

    fn tangent(&mut self, k: usize, dx: &mut [f64]) {
        let start = Instant::now();
        self.model.tangent(k, dx);
        self.tangent += start.elapsed();
    }

    fn adjoint(&mut self, k: usize, lambda: &mut [f64]) {
        let start = Instant::now();
        self.model.adjoint(k, lambda);
        self.adjoint += start.elapsed();
    }

    fn tangent_block(&mut self, k: usize, dx: &mut [f64]) {
        let start = Instant::now();
        self.model.tangent_block(k, dx);
        self.tangent += start.elapsed();
    }

    fn adjoint_block(&mut self, k: usize, lambda: &mut [f64]) {
        let start = Instant::now();
        self.model.adjoint_block(k, lambda);
        self.adjoint += start.elapsed();
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
        let start = Instant::now();
        let result = self.model.initial_state(z, x);
        self.forward += start.elapsed();
        result
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
