//! The classical explicit Runge–Kutta method, with its exact discrete adjoint.

use crate::{ControlMap, Error, Model, Rate, Rhs, SecondOrder, Work};
use std::ops::Range;

/// ẋ = f(t, x) by the classical Runge–Kutta method of order four on a uniform grid of time.
///
/// ```text
/// x_{k+1} = x_k + Δt/6 (k₁ + 2k₂ + 2k₃ + k₄),  k_i = f(t_k + c_i Δt, X_i),
/// X₁ = x_k,  X₂ = x_k + Δt/2 k₁,  X₃ = x_k + Δt/2 k₂,  X₄ = x_k + Δt k₃
/// c = (0, ½, ½, 1)
/// ```
///
/// Tangent and adjoint are those of this discrete step: its derivative at the stages X_i, and the transpose
/// of that. A linearization keeps the four stages; it takes them over from a step just taken, and costs three
/// evaluations of f otherwise.
///
/// # When to use it
///
/// Where f is smooth and not stiff: Δt times the largest |eigenvalue| of ∂f/∂x must stay below some 2.8.
/// f is `Clone`: a copy of it is the model's rate, for observations between steps ([`Rate`]).
///
/// ```
/// use varda_implicit::{Model, Rk4, lorenz::Lorenz96};
///
/// let mut model = Rk4::new(Lorenz96::new(40, 8.0), 0, 0.05);
/// let (mut x, mut next) = (vec![8.0; 40], vec![0.0; 40]);
/// x[20] += 0.01;
/// model.step(0, &x, &mut next)?;
/// model.linearize(0, 0, &x, &next)?; // into slot 0
/// let mut dx = vec![0.0; 40];
/// dx[20] = 1.0;
/// model.tangent(0, &mut dx);
/// // x = 8 is an equilibrium that perturbations move away from
/// assert!((next[20] - 8.0 - 0.01 * dx[20]).abs() < 1e-5);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Rk4<R> {
    rhs: R,
    first: usize,
    length: f64,
    /// X₁ … X₄ of the last step, one after the other.
    stages: Vec<f64>,
    /// The step `stages` belongs to.
    last: Option<usize>,
    slope: Vec<f64>,
    sum: Vec<f64>,
    point: Vec<f64>,
    slots: Vec<Stages>,
    /// Work space of second derivatives: nothing until they are asked for.
    second: Vec<f64>,
}

/// The linearization of a step: its stages X₁ … X₄, one after the other; none in an empty slot.
#[derive(Debug, Clone, Default)]
struct Stages {
    step: usize,
    values: Vec<f64>,
}

/// Place of the stages in the step.
const PLACE: [f64; 4] = [0.0, 0.5, 0.5, 1.0];
/// Weights of the slopes.
const WEIGHT: [f64; 4] = [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0];

impl<R: Rhs> Rk4<R> {
    /// A model whose step k starts at (first_index + k) · length seconds.
    ///
    /// # Panics
    /// If the length is not positive and finite.
    pub fn new(rhs: R, first_index: usize, length: f64) -> Self {
        assert!(length > 0.0 && length.is_finite(), "a step needs a positive length, not {length}");
        let n = rhs.dim();
        Self {
            rhs,
            first: first_index,
            length,
            stages: vec![0.0; 4 * n],
            last: None,
            slope: vec![0.0; n],
            sum: vec![0.0; n],
            point: vec![0.0; n],
            slots: Vec::new(),
            second: Vec::new(),
        }
    }

    /// The right-hand side.
    pub fn rhs(&self) -> &R {
        &self.rhs
    }

    /// Time at stage i of step k [s].
    fn time(&self, k: usize, i: usize) -> f64 {
        (self.first + k) as f64 * self.length + PLACE[i] * self.length
    }

    /// Fills `stages` and, up to the slope of the last stage asked for, `sum` = Σ w_i k_i.
    fn run(&mut self, k: usize, x: &[f64], slopes: usize) {
        let n = x.len();
        self.last = Some(k);
        self.stages[..n].copy_from_slice(x);
        self.sum.fill(0.0);
        for i in 0..slopes {
            let t = self.time(k, i);
            let (done, next) = self.stages.split_at_mut((i + 1) * n);
            self.rhs.eval(t, &done[i * n..], &mut self.slope);
            add(WEIGHT[i], &self.slope, &mut self.sum);
            if i < 3 {
                let h = PLACE[i + 1] * self.length;
                for ((next, x), s) in next[..n].iter_mut().zip(x).zip(&self.slope) {
                    *next = x + h * s;
                }
            }
        }
    }
}

impl<R: Rhs + Clone + 'static> Model for Rk4<R> {
    fn dim(&self) -> usize {
        self.slope.len()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        assert!(x.len() == self.dim() && x_next.len() == self.dim(), "a state has {} values", self.dim());
        self.run(k, x, 4);
        for ((next, x), s) in x_next.iter_mut().zip(x).zip(&self.sum) {
            *next = x + self.length * s;
        }
        // a sum is finite only if all its terms are; one that overflows is looked at more closely
        if !x_next.iter().sum::<f64>().is_finite() && !x_next.iter().all(|v| v.is_finite()) {
            self.last = None;
            return Err(Error::NonFinite { step: k, what: "x_{k+1}" });
        }
        Ok(Work::default())
    }

    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error> {
        let n = self.dim();
        assert!(x.len() == n && x_next.len() == n, "a state has {n} values");
        if self.last != Some(k) || !same_bits(&self.stages[..n], x) {
            self.run(k, x, 3);
        }
        if self.slots.len() <= slot {
            self.slots.resize_with(slot + 1, Stages::default);
        }
        let kept = &mut self.slots[slot];
        kept.step = k;
        kept.values.resize(4 * n, 0.0);
        std::mem::swap(&mut kept.values, &mut self.stages);
        self.last = None;
        Ok(Work::default())
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        self.check(slot, dx);
        dx.chunks_exact_mut(self.slope.len()).for_each(|dx| self.tangent_of_one(slot, dx));
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        self.check(slot, lambda);
        lambda.chunks_exact_mut(self.slope.len()).for_each(|lambda| self.adjoint_of_one(slot, lambda));
    }

    fn release(&mut self, from_slot: usize) {
        self.slots.truncate(from_slot);
        self.slots.shrink_to(from_slot);
    }

    fn slot_bytes(&self) -> usize {
        size_of_val(self.stages.as_slice()) + size_of::<Stages>()
    }

    fn bytes(&self) -> usize {
        self.slots.iter().map(|s| size_of_val(s.values.as_slice()) + size_of::<Stages>()).sum()
    }

    fn rate(&self) -> Option<Box<dyn Rate>> {
        Some(Box::new(RhsRate { rhs: self.rhs.clone(), first: self.first, length: self.length }))
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        None
    }

    fn second_order(&mut self) -> Option<&mut dyn SecondOrder> {
        if self.rhs.has_second_derivatives() { Some(self) } else { None }
    }
}

impl<R: Rhs + Clone + 'static> SecondOrder for Rk4<R> {
    /// With δX_i the tangents of the stages and μ_i, p_i = (∂f/∂X_i)ᵀ μ_i the adjoint's:
    ///
    /// ```text
    /// ṗ_i = (∂f/∂X_i)ᵀ μ̇_i + Σ_j μ_{i,j} ∂²f_j/∂x²(X_i) δX_i
    /// ```
    fn adjoint_derivative(
        &mut self,
        slot: usize,
        dx: &[f64],
        lambda: &[f64],
        derivative: &mut [f64],
    ) -> Result<(), Error> {
        self.check(slot, derivative);
        let n = dx.len();
        let k = self.slots[slot].step;
        self.second.resize(8 * n, 0.0);
        let mut second = std::mem::take(&mut self.second);
        let (moved, rest) = second.split_at_mut(4 * n);
        let [mu, mu_dot, p, p_dot] = fourths(rest, n);
        moved[..n].copy_from_slice(dx);
        for i in 0..3 {
            let t = self.time(k, i);
            let stage = &self.slots[slot].values[i * n..(i + 1) * n];
            let (done, next) = moved.split_at_mut((i + 1) * n);
            self.rhs.tangent(t, stage, &done[i * n..], &mut self.slope);
            let h = PLACE[i + 1] * self.length;
            next[..n].iter_mut().zip(dx).zip(&self.slope).for_each(|((next, d), s)| *next = d + h * s);
        }
        // λ + Σ p_i, and its derivative, in place
        self.sum.copy_from_slice(derivative);
        p.fill(0.0);
        p_dot.fill(0.0);
        for i in (0..4).rev() {
            let (t, weight) = (self.time(k, i), self.length * WEIGHT[i]);
            let after = PLACE.get(i + 1).map_or(0.0, |c| self.length * c);
            for j in 0..n {
                mu[j] = weight * lambda[j] + after * p[j];
                mu_dot[j] = weight * derivative[j] + after * p_dot[j];
            }
            let at = i * n..(i + 1) * n;
            let stage = &self.slots[slot].values[at.clone()];
            self.rhs.adjoint(t, stage, mu, p);
            self.rhs.adjoint(t, stage, mu_dot, p_dot);
            self.rhs.second_adjoint_add(t, stage, &moved[at], mu, p_dot);
            add(1.0, p_dot, &mut self.sum);
        }
        derivative.copy_from_slice(&self.sum);
        self.second = second;
        if derivative.iter().all(|d| d.is_finite()) {
            Ok(())
        } else {
            Err(Error::NonFinite { step: k, what: "the second derivative of x_{k+1}" })
        }
    }
}

/// Four slices of length n, one after the other.
fn fourths(all: &mut [f64], n: usize) -> [&mut [f64]; 4] {
    let (a, rest) = all.split_at_mut(n);
    let (b, rest) = rest.split_at_mut(n);
    let (c, d) = rest.split_at_mut(n);
    [a, b, c, &mut d[..n]]
}

impl<R: Rhs> Rk4<R> {
    /// The slot must hold a linearization, and the columns be whole.
    fn check(&self, slot: usize, columns: &[f64]) {
        let n = self.slope.len();
        assert!(columns.len().is_multiple_of(n), "a column has {n} values");
        let held = self.slots.get(slot).is_some_and(|kept| !kept.values.is_empty());
        assert!(held, "slot {slot} holds no linearization");
    }

    fn tangent_of_one(&mut self, slot: usize, dx: &mut [f64]) {
        let n = dx.len();
        let k = self.slots[slot].step;
        self.sum.fill(0.0);
        self.point.copy_from_slice(dx);
        for i in 0..4 {
            let t = self.time(k, i);
            let stage = &self.slots[slot].values[i * n..(i + 1) * n];
            self.rhs.tangent(t, stage, &self.point, &mut self.slope);
            let h = PLACE.get(i + 1).unwrap_or(&0.0) * self.length;
            for (((p, d), s), sum) in self.point.iter_mut().zip(dx.iter()).zip(&self.slope).zip(&mut self.sum)
            {
                *sum += WEIGHT[i] * s;
                *p = d + h * s;
            }
        }
        add(self.length, &self.sum, dx);
    }

    fn adjoint_of_one(&mut self, slot: usize, lambda: &mut [f64]) {
        // With p_i = (∂f/∂X_i)ᵀ μ_i:
        //   μ₄ = Δt/6 λ,  μ₃ = Δt/3 λ + Δt p₄,  μ₂ = Δt/3 λ + Δt/2 p₃,  μ₁ = Δt/6
        //   λ + Δt/2 p₂,  Mᵀλ = λ + p₄ + p₃ + p₂ + p₁,
        // in as few passes over memory as that allows: p₄ goes without its factor Δt/6, p₁ straight into
        // the result.
        let n = lambda.len();
        let k = self.slots[slot].step;
        let time = [0, 1, 2, 3].map(|i| self.time(k, i));
        let weight = WEIGHT.map(|w| self.length * w);
        let after = [1, 2, 3].map(|i| self.length * PLACE[i]);
        let Self { rhs, slots, slope: mu, point: p, sum, .. } = self;
        let stage = |i: usize| &slots[slot].values[i * n..(i + 1) * n];

        rhs.adjoint(time[3], stage(3), lambda, p);
        for (((mu, l), p), sum) in mu.iter_mut().zip(lambda.iter()).zip(p.iter()).zip(sum.iter_mut()) {
            *mu = weight[2] * l + after[2] * weight[3] * p;
            *sum = l + weight[3] * p;
        }
        rhs.adjoint(time[2], stage(2), mu, p);
        for (((mu, l), p), sum) in mu.iter_mut().zip(lambda.iter()).zip(p.iter()).zip(sum.iter_mut()) {
            *mu = weight[1] * l + after[1] * p;
            *sum += p;
        }
        rhs.adjoint(time[1], stage(1), mu, p);
        for (((mu, l), p), sum) in mu.iter_mut().zip(lambda.iter_mut()).zip(p.iter()).zip(sum.iter()) {
            *mu = weight[0] * *l + after[0] * p;
            *l = sum + p;
        }
        rhs.adjoint_add(time[0], stage(0), mu, lambda);
    }
}

/// ẋ = f(t_k, x).
struct RhsRate<R> {
    rhs: R,
    first: usize,
    length: f64,
}

impl<R> RhsRate<R> {
    fn time(&self, k: usize) -> f64 {
        (self.first + k) as f64 * self.length
    }
}

impl<R: Rhs> Rate for RhsRate<R> {
    fn components(&self) -> Range<usize> {
        0..self.rhs.dim()
    }

    fn length(&self, _: usize) -> f64 {
        self.length
    }

    fn eval(&mut self, k: usize, x: &[f64], rate: &mut [f64]) {
        self.rhs.eval(self.time(k), x, rate);
    }

    fn tangent(&mut self, k: usize, x: &[f64], dx: &[f64], rate: &mut [f64]) {
        self.rhs.tangent(self.time(k), x, dx, rate);
    }

    fn adjoint_add(&mut self, k: usize, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        self.rhs.adjoint_add(self.time(k), x, lambda, dx);
    }

    fn second_adjoint_add(&mut self, k: usize, x: &[f64], dx: &[f64], lambda: &[f64], out: &mut [f64]) {
        self.rhs.second_adjoint_add(self.time(k), x, dx, lambda, out);
    }
}

/// Whether two states of one length agree in every bit; without an early way out, that it may run on whole
/// vectors.
fn same_bits(a: &[f64], b: &[f64]) -> bool {
    a.iter().zip(b).fold(0, |differing, (a, b)| differing | (a.to_bits() ^ b.to_bits())) == 0
}

/// y += a x.
fn add(a: f64, x: &[f64], y: &mut [f64]) {
    y.iter_mut().zip(x).for_each(|(y, x)| *y += a * x);
}
