//! The inverse Hessian that L-BFGS builds up.

use crate::cost::{dot, norm};
use std::collections::VecDeque;

/// What L-BFGS knows of the inverse of the Hessian of J.
#[derive(Debug, Clone)]
pub struct InverseHessian {
    n: usize,
    capacity: usize,
    /// s, y and 1 / sᵀy, oldest first.
    kept: VecDeque<(Vec<f64>, Vec<f64>, f64)>,
    skipped: usize,
}

impl InverseHessian {
    /// Knows nothing yet, H = I, and will keep the last `capacity` pairs.
    pub fn new(n: usize, capacity: usize) -> Self {
        Self { n, capacity, kept: VecDeque::new(), skipped: 0 }
    }

    /// n.
    pub fn dim(&self) -> usize {
        self.n
    }

    /// Pairs kept.
    pub fn pairs(&self) -> usize {
        self.kept.len()
    }

    /// Pairs that failed the curvature test.
    pub fn skipped(&self) -> usize {
        self.skipped
    }

    /// s and y of the i-th pair kept, oldest first.
    pub(crate) fn pair(&self, i: usize) -> (&[f64], &[f64]) {
        (&self.kept[i].0, &self.kept[i].1)
    }

    /// Takes in that a step s changed the gradient by y, if sᵀy > 10⁻⁸ ‖s‖‖y‖; says whether it
    /// did.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn store(&mut self, s: &[f64], y: &[f64]) -> bool {
        assert_eq!((s.len(), y.len()), (self.n, self.n), "length of a pair");
        let curvature = dot(s, y);
        if !(curvature > 1e-8 * norm(s) * norm(y)) {
            self.skipped += 1;
            return false;
        }
        if self.kept.len() == self.capacity {
            self.kept.pop_front();
        }
        self.kept.push_back((s.to_vec(), y.to_vec(), 1.0 / curvature));
        true
    }

    /// out = H x with H built up from I: in the control variable the Hessian is I where nothing was observed.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn apply(&self, x: &[f64], out: &mut [f64]) {
        self.two_loops(1.0, x, out);
    }

    /// p = −H g with H built up from γI; −g where nothing is known.
    pub(super) fn direction(&self, g: &[f64], p: &mut [f64]) {
        let gamma = self.kept.back().map_or(1.0, |(_, y, rho)| 1.0 / (rho * dot(y, y)));
        self.two_loops(gamma, g, p);
        p.iter_mut().for_each(|p| *p = -*p);
    }

    /// The first step to try along that direction: one prior standard deviation at most where nothing is
    /// known.
    pub(super) fn first_step(&self, g: &[f64]) -> f64 {
        if self.kept.is_empty() { (1.0 / norm(g)).min(1.0) } else { 1.0 }
    }

    pub(super) fn clear(&mut self) {
        self.kept.clear();
    }

    pub(super) fn two_loops(&self, gamma: f64, x: &[f64], out: &mut [f64]) {
        assert_eq!(x.len(), self.n, "length of x");
        out.copy_from_slice(x);
        let mut along = vec![0.0; self.kept.len()];
        for ((s, y, rho), a) in self.kept.iter().zip(&mut along).rev() {
            *a = rho * dot(s, out);
            out.iter_mut().zip(y).for_each(|(out, y)| *out -= *a * y);
        }
        out.iter_mut().for_each(|out| *out *= gamma);
        for ((s, y, rho), a) in self.kept.iter().zip(&along) {
            let b = a - rho * dot(y, out);
            out.iter_mut().zip(s).for_each(|(out, s)| *out += b * s);
        }
    }
}
