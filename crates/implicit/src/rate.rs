//! How fast a state changes at a step: what a curve between two steps is drawn with.

use std::ops::Range;

/// The rate ẋ of some components of a state, at the steps of a [`Model`](crate::Model).
///
/// With it an observation between two steps sees a cubic through both states with their rates
/// (Hermite), and not a straight line, whose error is (ωΔt)²/8 of the amplitude of an oscillation. A rate
/// is known where the state holds it ([`VelocityRate`]: positions and their velocities) or where
/// ẋ = f(t, x) is solved by an explicit method ([`Rk4`](crate::Rk4)).
///
/// `&mut self` is for work space: every result is a function of the arguments alone.
pub trait Rate {
    /// The components whose rate is known.
    fn components(&self) -> Range<usize>;

    /// Length Δt of step k, from x_k to x_{k+1} (s).
    fn length(&self, k: usize) -> f64;

    /// `rate` = ẋ of those components in state x_k.
    fn eval(&mut self, k: usize, x: &[f64], rate: &mut [f64]);

    /// `rate` = ∂ẋ/∂x dx.
    fn tangent(&mut self, k: usize, x: &[f64], dx: &[f64], rate: &mut [f64]);

    /// dx += (∂ẋ/∂x)ᵀ λ.
    fn adjoint_add(&mut self, k: usize, x: &[f64], lambda: &[f64], dx: &mut [f64]);

    /// out += Σ_i λ_i ∂²ẋ_i/∂x² dx, where the model has second derivatives. Nothing (the default)
    /// where the rate is linear in the state.
    fn second_adjoint_add(&mut self, _k: usize, _x: &[f64], _dx: &[f64], _lambda: &[f64], _out: &mut [f64]) {}
}

/// The rate where one block of the state is the rate of another: ẋ_{p+i} = x_{v+i}.
///
/// ```
/// use varda_implicit::{Rate, VelocityRate};
///
/// // The state is [position, velocity], the steps take 0.1 s.
/// let mut rate = VelocityRate::new(0..1, 1, |_| 0.1);
/// let mut v = [0.0];
/// rate.eval(0, &[2.0, -3.0], &mut v);
/// assert_eq!((v, rate.length(7)), ([-3.0], 0.1));
/// ```
#[derive(Debug, Clone)]
pub struct VelocityRate<L> {
    positions: Range<usize>,
    velocities: Range<usize>,
    length: L,
}

impl<L: Fn(usize) -> f64> VelocityRate<L> {
    /// The components `positions` have as their rates those from `first_velocity` on; step k takes
    /// `length(k)` seconds.
    pub fn new(positions: Range<usize>, first_velocity: usize, length: L) -> Self {
        let velocities = first_velocity..first_velocity + positions.len();
        Self { positions, velocities, length }
    }
}

impl<L: Fn(usize) -> f64> Rate for VelocityRate<L> {
    fn components(&self) -> Range<usize> {
        self.positions.clone()
    }

    fn length(&self, k: usize) -> f64 {
        (self.length)(k)
    }

    fn eval(&mut self, _: usize, x: &[f64], rate: &mut [f64]) {
        rate.copy_from_slice(&x[self.velocities.clone()]);
    }

    fn tangent(&mut self, _: usize, _: &[f64], dx: &[f64], rate: &mut [f64]) {
        rate.copy_from_slice(&dx[self.velocities.clone()]);
    }

    fn adjoint_add(&mut self, _: usize, _: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx[self.velocities.clone()].iter_mut().zip(lambda).for_each(|(dx, l)| *dx += l);
    }
}
