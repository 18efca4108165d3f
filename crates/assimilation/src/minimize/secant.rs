//! The part of the Hessian that Gauss–Newton drops, learnt from the gradients on the way.

use crate::cost::{dot, norm};

/// S = Σ w_i r_i r_iᵀ ≈ ∇²J − A, by symmetric rank-one updates (structured: only the dropped
/// second-order part is learnt, the Gauss–Newton part A is recomputed at every point; Dennis, Gay and
/// Welsch 1981, Nocedal and Wright 2006 §6.2 and §10.3).
///
/// Used only while it has shown that it predicts gradients better than A alone does.
pub(super) struct Secant {
    terms: Vec<(f64, Vec<f64>)>,
    /// Pairs kept; when they are full S starts again from zero.
    capacity: usize,
    trusted: bool,
}

impl Secant {
    pub(super) fn new(capacity: usize) -> Self {
        Self { terms: Vec::new(), capacity, trusted: false }
    }

    /// Whether S is to be added to the model.
    pub(super) fn trusted(&self) -> bool {
        self.trusted
    }

    /// Leaves S out until it has proved itself again.
    pub(super) fn distrust(&mut self) {
        self.trusted = false;
    }

    /// out += S p.
    pub(super) fn apply_add(&self, p: &[f64], out: &mut [f64]) {
        for (w, r) in &self.terms {
            let c = w * dot(r, p);
            out.iter_mut().zip(r).for_each(|(out, r)| *out += c * r);
        }
    }

    /// matrix += S, by columns.
    pub(super) fn matrix_add(&self, matrix: &mut [f64]) {
        for (w, r) in &self.terms {
            for (column, rj) in matrix.chunks_exact_mut(r.len()).zip(r) {
                column.iter_mut().zip(r).for_each(|(a, ri)| *a += w * rj * ri);
            }
        }
    }

    /// Takes in that over the last step s the gradient changed by A s + `dropped`, A being that of the new
    /// point.
    pub(super) fn update(&mut self, s: &[f64], dropped: &[f64]) {
        let mut known = vec![0.0; s.len()];
        self.apply_add(s, &mut known);
        let difference = |known: &[f64]| dropped.iter().zip(known).map(|(d, k)| d - k).collect::<Vec<f64>>();
        self.trusted = norm(&difference(&known)) < norm(dropped);

        if self.terms.len() == self.capacity {
            self.terms.clear();
            known.fill(0.0);
        }
        let r = difference(&known);
        let curvature = dot(&r, s);
        if curvature.abs() > 1e-8 * norm(&r) * norm(s) {
            self.terms.push((1.0 / curvature, r));
        }
    }
}
