//! Observations between two steps: the cubic through states and rates, and its derivatives.

use std::f64::consts::TAU;
use std::ops::{ControlFlow, Range};

use varda_assimilation::{
    ControlTransform, CostFunction, LeastSquares, NewtonOptions, Observation, ObservationOperator,
    ObservationSet, StrongConstraint, newton,
};
use varda_covariance::Diagonal;
use varda_implicit::{ControlMap, Error, Model, Rate, Rk4, VelocityRate, Work, check, lorenz::Lorenz63};

use crate::models::{Products, all_of, dot, normals};

/// x'' = −x in steps that are exact, the state [x, x']; with or without its rate.
struct Swing {
    step: f64,
    with_rate: bool,
}

impl Swing {
    fn turn(&self, x: &mut [f64], angle: f64) {
        let (s, c) = angle.sin_cos();
        (x[0], x[1]) = (c * x[0] + s * x[1], c * x[1] - s * x[0]);
    }
}

impl Model for Swing {
    fn dim(&self) -> usize {
        2
    }
    fn step(&mut self, _: usize, x: &[f64], next: &mut [f64]) -> Result<Work, Error> {
        next.copy_from_slice(x);
        self.turn(next, self.step);
        Ok(Work::default())
    }
    fn linearize(&mut self, _: usize, _: usize, _: &[f64], _: &[f64]) -> Result<Work, Error> {
        Ok(Work::default())
    }
    fn tangent(&mut self, _: usize, dx: &mut [f64]) {
        dx.chunks_exact_mut(2).for_each(|dx| self.turn(dx, self.step));
    }
    fn adjoint(&mut self, _: usize, lambda: &mut [f64]) {
        lambda.chunks_exact_mut(2).for_each(|l| self.turn(l, -self.step));
    }
    fn release(&mut self, _: usize) {}
    fn slot_bytes(&self) -> usize {
        0
    }
    fn bytes(&self) -> usize {
        0
    }
    fn rate(&self) -> Option<Box<dyn Rate>> {
        let step = self.step;
        self.with_rate.then(|| -> Box<dyn Rate> { Box::new(VelocityRate::new(0..1, 1, move |_| step)) })
    }
    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        None
    }
}

/// cos t seen half way between the steps of two periods, exactly.
fn amplitude(steps_a_period: usize, with_rate: bool) -> f64 {
    let step = TAU / steps_a_period as f64;
    let seen = (0..2 * steps_a_period)
        .map(|k| Observation::new(k, vec![0], vec![((k as f64 + 0.5) * step).cos()], 1e-4).between(0.5));
    let mut set = ObservationSet::new(2 * steps_a_period, vec![all_of(2)], seen.collect()).unwrap();
    let b = Diagonal::uniform(2, 1.0).unwrap();
    let mut model = Swing { step, with_rate };
    let transform = ControlTransform::new(vec![0.0; 2], &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let mut v = [0.0; 2];
    newton(&mut cost, &mut v, &NewtonOptions::default(), &mut |_| ControlFlow::Continue(())).unwrap();
    v[0].hypot(v[1])
}

#[test]
fn an_oscillation_seen_between_steps_keeps_its_amplitude() {
    // A chord is 1 − cos(ωΔt/2) too small in its middle: 1.23 % at 20 steps a period, so that the
    // amplitude comes out as 1/cos(ωΔt/2), 1.25 % too large. The cubic is off by (ωΔt)⁴/384 = 2.5e-5.
    let (line, cubic) = (amplitude(20, false) - 1.0, amplitude(20, true) - 1.0);
    assert!((line - 0.01247).abs() < 1e-4, "{line}");
    assert!(cubic.abs() < 1e-4, "{cubic}");
    // Fourth order: 2⁴ from 10 to 20 steps a period, within what the next order adds.
    let order = ((amplitude(10, true) - 1.0).abs() / cubic.abs()).log2();
    assert!((order - 4.0).abs() < 0.2, "{order}");
}

/// A set over five states of three numbers with two nonlinear and a linear operator, on and between steps.
fn mixed() -> ObservationSet {
    let operators: Vec<Box<dyn ObservationOperator>> = vec![Box::new(Products(3)), all_of(3)];
    let at = |step, w, operator| {
        let mut seen = Observation::new(step, vec![1, 0], vec![3.0, -1.0], 0.5).between(w);
        seen.operator = operator;
        seen
    };
    let seen =
        vec![at(0, 0.3, 0), at(0, 0.3, 1), at(1, 0.8, 0), at(2, 0.0, 0), at(2, 0.5, 1), at(3, 0.99, 0)];
    ObservationSet::new(4, operators, seen).unwrap()
}

/// Lorenz-63 and a state and direction at every step.
fn lorenz() -> (Rk4<Lorenz63>, Vec<f64>, Vec<f64>) {
    let x = normals(1, 15).iter().map(|x| 5.0 * x).collect();
    (Rk4::new(Lorenz63::default(), 0, 0.02), x, normals(2, 15))
}

#[test]
fn predictions_are_those_of_the_hermite_polynomial() {
    let (model, x, _) = lorenz();
    let mut set = mixed();
    set.follow(model.rate());
    let mut run = set.prediction();
    (0..5).for_each(|k| set.observe_add(k, &x[3 * k..][..3], &mut run).unwrap());
    // Newton's divided differences at 0, 0, 1, 1, with the rates by hand.
    let rate = |x: &[f64]| {
        [10.0 * (x[1] - x[0]), x[0] * (28.0 - x[2]) - x[1], x[0] * x[1] - 8.0 / 3.0 * x[2]].map(|v| 0.02 * v)
    };
    for (i, o) in set.observations().iter().enumerate().filter(|(_, o)| o.weight > 0.0) {
        let (a, b) = (&x[3 * o.step..][..3], &x[3 * o.step + 3..][..3]);
        let state: Vec<f64> = (0..3)
            .map(|c| {
                let (da, slope, db) = (rate(a)[c], b[c] - a[c], rate(b)[c]);
                let w = o.weight;
                a[c] + w * (da + w * ((slope - da) + (w - 1.0) * (da + db - 2.0 * slope)))
            })
            .collect();
        let expected = match o.operator {
            0 => [state[0] * state[1], state[0] * state[0]],
            _ => [state[1], state[0]],
        };
        for (found, expected) in run.values()[set.rows(i)].iter().zip(expected) {
            // two formulas for one polynomial: a few roundings of terms of size 100
            assert!((found - expected).abs() < 1e-12 * expected.abs().max(100.0), "{found} {expected}");
        }
    }
}

/// ⟨H' dx, w⟩ and ⟨dx, H'ᵀ w⟩ with a rate.
fn products(rate: Option<Box<dyn Rate>>) -> [f64; 2] {
    let (_, x, dx) = lorenz();
    let mut set = mixed();
    set.follow(rate);
    let mut run = set.prediction();
    (0..5).for_each(|k| set.observe_add(k, &x[3 * k..][..3], &mut run).unwrap());
    let w = normals(3, set.dim());
    let (mut dy, mut back) = (vec![0.0; set.dim()], vec![0.0; 15]);
    for k in 0..5 {
        set.tangent_add(k, &x[3 * k..][..3], &dx[3 * k..][..3], &run, &mut dy);
        set.adjoint_add(k, &x[3 * k..][..3], &w, &run, &mut back[3 * k..][..3]);
    }
    [dot(&dy, &w), dot(&dx, &back)]
}

/// A rate whose transpose has one entry wrong by one part in a thousand.
struct Mutated(Box<dyn Rate>);

impl Rate for Mutated {
    fn components(&self) -> Range<usize> {
        self.0.components()
    }
    fn length(&self, k: usize) -> f64 {
        self.0.length(k)
    }
    fn eval(&mut self, k: usize, x: &[f64], rate: &mut [f64]) {
        self.0.eval(k, x, rate);
    }
    fn tangent(&mut self, k: usize, x: &[f64], dx: &[f64], rate: &mut [f64]) {
        self.0.tangent(k, x, dx, rate);
    }
    fn adjoint_add(&mut self, k: usize, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        self.0.adjoint_add(k, x, lambda, dx);
        dx[1] += 1e-3 * 10.0 * lambda[0];
    }
}

#[test]
fn the_adjoint_is_the_transpose_of_the_tangent_and_a_wrong_one_is_caught() {
    let (model, ..) = lorenz();
    let velocity: Box<dyn Rate> = Box::new(VelocityRate::new(0..1, 1, |_| 0.3));
    let off = |[left, right]: [f64; 2]| (left - right).abs() / left.abs();
    // some hundred products of size 10 and less: 1e-13 is a few hundred roundings
    assert!(off(products(model.rate())) < 1e-13);
    assert!(off(products(Some(velocity))) < 1e-13);
    assert!(off(products(model.rate().map(|rate| -> Box<dyn Rate> { Box::new(Mutated(rate)) }))) > 1e-8);
}

#[test]
fn gradient_and_hessian_are_exact() {
    let (mut model, ..) = lorenz();
    let mut set = mixed();
    let b = Diagonal::uniform(3, 1.0).unwrap();
    let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    assert!(cost.observations().is_cubic());
    let (v, d, mut gradient) = ([0.3, -0.2, 0.5], [0.7, -1.0, 0.4], [0.0; 3]);
    cost.evaluate(&v, Some(&mut gradient)).unwrap();
    let mut j = |v: &[f64]| Ok(cost.evaluate(v, None).expect("a cost"));
    let taylor = check::taylor(&mut j, &gradient, &v, &d).unwrap();
    assert!(taylor.pass && taylor.slope < 2.05, "{taylor:?}");

    // A = I + GᵀG, G from differences of H(x): central ones of 1e-5 are right to 1e-9 of G.
    let mut seen = |v: &[f64]| {
        let mut gradient = [0.0; 3];
        cost.evaluate(v, Some(&mut gradient)).unwrap();
        cost.predicted().to_vec()
    };
    let columns: Vec<Vec<f64>> = (0..3)
        .map(|j| {
            let shifted =
                |h: f64| -> Vec<f64> { (0..3).map(|i| v[i] + if i == j { h } else { 0.0 }).collect() };
            let (plus, minus) = (seen(&shifted(1e-5)), seen(&shifted(-1e-5)));
            plus.iter().zip(&minus).map(|(p, m)| (p - m) / (2e-5 * 0.5)).collect()
        })
        .collect();
    seen(&v);
    let mut a = [0.0; 9];
    cost.hessian(&mut a).unwrap();
    for i in 0..3 {
        let (mut unit, mut product) = ([0.0; 3], [0.0; 3]);
        unit[i] = 1.0;
        cost.hessian_apply(&unit, &mut product).unwrap();
        for k in 0..3 {
            let expected = dot(&columns[i], &columns[k]) + f64::from(u8::from(i == k));
            assert!((a[i + 3 * k] - expected).abs() < 1e-7 * expected.abs().max(1.0), "{i} {k}");
            // two orders of summation
            assert!((product[k] - a[i + 3 * k]).abs() < 1e-11 * a[i + 3 * k].abs().max(1.0), "{i} {k}");
        }
    }
}

#[test]
fn observations_on_steps_keep_their_bits() {
    let (model, x, _) = lorenz();
    let seen = |_| Observation::new(2, vec![0, 1], vec![3.0, -1.0], 0.5);
    let set = || ObservationSet::new(4, vec![Box::new(Products(3))], (0..1).map(seen).collect()).unwrap();
    let (mut with, mut without) = (set(), set());
    with.follow(model.rate());
    let predicted = |set: &mut ObservationSet| {
        let mut run = set.prediction();
        (0..5).for_each(|k| set.observe_add(k, &x[3 * k..][..3], &mut run).unwrap());
        assert_eq!(run.bytes(), 0);
        run.values().to_vec()
    };
    assert_eq!(predicted(&mut with), predicted(&mut without));
}
