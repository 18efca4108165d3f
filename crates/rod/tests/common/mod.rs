//! What several tests of derivatives use.

// each test takes a part
#![allow(dead_code)]

pub(crate) mod rods_with_parameters;

use varda_implicit::Model;
use varda_rod::{Dual64, EdgeLoad, EdgeMotion, Load, Real};

/// A smooth pseudo-random sequence in [−1, 1].
pub(crate) fn noise(seed: usize) -> impl Iterator<Item = f64> {
    (0..).map(move |i| (12.9898 * (i as f64 + 1.0) + 78.233 * seed as f64).sin())
}

pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(crate) fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}

/// No component of the tangent is off by more than `bound` of the largest.
pub(crate) fn assert_close(name: &str, tangent: &[f64], difference: &[f64], bound: f64) {
    let (error, size) = off(tangent, difference);
    assert!(size > 0.0 && error <= bound * size, "{name}: off by {error:e} of {size:e}");
}

/// The largest difference, and the largest component of `b`.
pub(crate) fn off(a: &[f64], b: &[f64]) -> (f64, f64) {
    let error = a.iter().zip(b).fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
    (error, b.iter().fold(0.0, |m: f64, b| m.max(b.abs())))
}

/// Central differences of f at x along dx, extrapolated once: error O(h⁴) and rounding ε/h.
pub(crate) fn difference(x: &[f64], dx: &[f64], h: f64, mut f: impl FnMut(&[f64]) -> Vec<f64>) -> Vec<f64> {
    let mut central = |h: f64| -> Vec<f64> {
        let at = |s: f64| -> Vec<f64> { x.iter().zip(dx).map(|(x, d)| x + s * d).collect() };
        let (a, b) = (f(&at(h)), f(&at(-h)));
        a.iter().zip(&b).map(|(a, b)| (a - b) / (2.0 * h)).collect()
    };
    let (one, half) = (central(h), central(0.5 * h));
    one.iter().zip(&half).map(|(a, b)| (4.0 * b - a) / 3.0).collect()
}

/// A tangent, its differences, and how far the dot product with the adjoint is off, relative.
pub(crate) struct Product {
    pub(crate) tangent: Vec<f64>,
    pub(crate) by_difference: Vec<f64>,
    pub(crate) gap: f64,
    /// Extra parts that the step was cut into.
    pub(crate) substeps: usize,
}

/// Three steps from a control: the products of each.
pub(crate) fn products(model: &mut dyn Model, z: &[f64]) -> Vec<Product> {
    let n = model.dim();
    let mut x = vec![0.0; n];
    model.initial_state(z, &mut x).unwrap();
    let mut all = Vec::new();
    for k in 0..3 {
        let mut next = vec![0.0; n];
        let substeps = model.step(k, &x, &mut next).unwrap().substeps;
        model.linearize(k, k, &x, &next).unwrap();
        let dx: Vec<f64> = noise(4 + k).take(n).collect();
        let by_difference = difference(&x, &dx, 3e-5, |x| {
            let mut next = vec![0.0; n];
            model.step(k, x, &mut next).unwrap();
            next
        });
        let mut tangent = dx.clone();
        model.tangent(k, &mut tangent);
        let lambda: Vec<f64> = noise(7 + k).take(n).collect();
        let mut back = lambda.clone();
        model.adjoint(k, &mut back);
        let gap = (dot(&tangent, &lambda) - dot(&dx, &back)).abs() / (norm(&tangent) * norm(&lambda));
        all.push(Product { tangent, by_difference, gap, substeps });
        x = next;
    }
    all
}

/// A force −c (v_b − v_a) on the second vertex of an edge and its opposite on the first: that on a free
/// one depends on how fast the held one moves.
pub(crate) struct Dashpot(pub(crate) f64);

impl Load for Dashpot {
    fn has_potential(&self) -> bool {
        false
    }
    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        self.acts(motion)
    }
    fn has_second_derivatives(&self) -> bool {
        true
    }
    fn on_moved_edge(&self, motion: &EdgeMotion<Dual64>) -> EdgeLoad<Dual64> {
        self.acts(motion)
    }
}

impl Dashpot {
    fn acts<T: Real>(&self, motion: &EdgeMotion<T>) -> EdgeLoad<T> {
        let [a, b] = motion.velocities;
        let mut load = EdgeLoad::none();
        let force = (b - a) * T::of(self.0);
        for c in 0..3 {
            (load.forces[c], load.forces[3 + c]) = (force[c], -force[c]);
            for (row, column, sign) in [(0, 0, -1.0), (0, 3, 1.0), (3, 0, 1.0), (3, 3, -1.0)] {
                load.by_velocities[(row + c, column + c)] = T::of(sign * self.0);
            }
        }
        load
    }
}
