//! Spectral preconditioning of an inner problem by what the ones before it have found.

use crate::cost::dot;
use varda_linalg::krylov::RitzPair;

/// A limited-memory preconditioner (Fisher 1998; Tshimanga, Gratton, Weaver and Sartenaer 2008, the spectral
/// form):
///
/// ```text
///     U = S₁ S₂ …,    S_j = I + Σ_i (μ_i^{-1/2} − 1) z_i z_iᵀ,    A → Uᵀ A U
/// ```
///
/// with (μ_i, z_i) the Ritz pairs of the j-th inner problem, itself preconditioned by those before it: what
/// they have found becomes eigenvalues near 1 as long as A changes little from one outer iteration to the
/// next.
pub(super) struct Preconditioner {
    levels: Vec<Vec<RitzPair>>,
    /// Pairs kept; when they would be more, all are forgotten.
    capacity: usize,
}

impl Preconditioner {
    pub(super) fn new(capacity: usize) -> Self {
        Self { levels: Vec::new(), capacity }
    }

    /// x ← U x.
    pub(super) fn apply(&self, x: &mut [f64]) {
        self.levels.iter().rev().for_each(|level| deflate(level, x));
    }

    /// x ← Uᵀ x.
    pub(super) fn apply_transpose(&self, x: &mut [f64]) {
        self.levels.iter().for_each(|level| deflate(level, x));
    }

    /// Takes in the pairs of the last inner problem, those that are good enough: a pair with residual r
    /// couples the rest of the preconditioned matrix with strength r μ^{-1/2}, which may be a few times what
    /// is left there, about 1.
    pub(super) fn learn(&mut self, mut pairs: Vec<RitzPair>) {
        pairs.retain(|pair| pair.value > 1.5 && pair.residual <= 3.0 * pair.value.sqrt());
        if self.levels.iter().map(Vec::len).sum::<usize>() + pairs.len() > self.capacity {
            self.levels.clear();
            pairs.truncate(self.capacity);
        }
        if !pairs.is_empty() {
            self.levels.push(pairs);
        }
    }
}

fn deflate(level: &[RitzPair], x: &mut [f64]) {
    for RitzPair { value, vector, .. } in level {
        let c = (1.0 / value.sqrt() - 1.0) * dot(vector, x);
        x.iter_mut().zip(vector).for_each(|(x, z)| *x += c * z);
    }
}
