//! Products of an implicit step with many columns at once: one pass over its factor for every few of them.

use crate::ImplicitStep;
use crate::implicit::{Part, add};
use varda_linalg::LinearSolver;
use varda_linalg::band::BLOCK;

/// Work space, allocated by the first product.
#[derive(Debug, Default)]
pub(crate) struct Block {
    u: Vec<f64>,
    /// Unknowns of the columns, row by row.
    rows: Vec<[f64; BLOCK]>,
    /// dx of the columns, one after the other.
    dx: Vec<f64>,
    /// The histories of the columns, one after the other.
    history: Vec<f64>,
}

impl Block {
    fn resize(&mut self, state: usize, unknowns: usize, history: usize) {
        self.u.resize(unknowns, 0.0);
        self.rows.resize(unknowns, [0.0; BLOCK]);
        self.dx.resize(BLOCK * state, 0.0);
        self.history.resize(BLOCK * history, 0.0);
    }

    /// Every column, of length n, through all parts of a step; see [`ImplicitModel`](crate::ImplicitModel).
    pub(crate) fn tangent<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        parts: &[Part],
        n: usize,
        dx: &mut [f64],
    ) {
        let (past, own) = (step.history(), n - step.history());
        self.resize(n, step.unknowns(), past);
        let Self { u: du, rows, dx: dx_next, history } = self;
        for columns in dx.chunks_mut(BLOCK * n) {
            for (c, dx) in columns.chunks_exact(n).enumerate() {
                history[c * past..(c + 1) * past].copy_from_slice(&dx[..past]);
            }
            for part in parts {
                for (c, dx) in columns.chunks_exact(n).enumerate() {
                    step.previous(&part.at, &part.x, &part.u, dx, du);
                    rows.iter_mut().zip(du.iter()).for_each(|(row, d)| row[c] = -d);
                }
                solver.solve_block(&part.factor, rows);
                for (c, (dx, dx_next)) in
                    columns.chunks_exact_mut(n).zip(dx_next.chunks_exact_mut(n)).enumerate()
                {
                    du.iter_mut().zip(rows.iter()).for_each(|(d, row)| *d = row[c]);
                    step.advance_tangent(&part.at, &part.x, &part.u, dx, du, &mut dx_next[..own]);
                    dx_next[own..].copy_from_slice(&dx[..past]);
                    dx.copy_from_slice(dx_next);
                }
            }
            for (c, dx) in columns.chunks_exact_mut(n).enumerate() {
                dx[own..].copy_from_slice(&history[c * past..(c + 1) * past]);
            }
        }
    }

    /// The transpose.
    pub(crate) fn adjoint<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        parts: &[Part],
        n: usize,
        lambda: &mut [f64],
    ) {
        let (past, own) = (step.history(), n - step.history());
        self.resize(n, step.unknowns(), past);
        let Self { u: mu, rows, dx, history } = self;
        for columns in lambda.chunks_mut(BLOCK * n) {
            for (c, lambda) in columns.chunks_exact_mut(n).enumerate() {
                history[c * past..(c + 1) * past].copy_from_slice(&lambda[own..]);
                lambda[own..].fill(0.0);
            }
            for part in parts.iter().rev() {
                for (c, (lambda, dx)) in columns.chunks_exact(n).zip(dx.chunks_exact_mut(n)).enumerate() {
                    step.advance_adjoint(&part.at, &part.x, &part.u, &lambda[..own], dx, mu);
                    rows.iter_mut().zip(mu.iter()).for_each(|(row, m)| row[c] = -m);
                }
                solver.solve_transpose_block(&part.factor, rows);
                for (c, (lambda, dx)) in columns.chunks_exact_mut(n).zip(dx.chunks_exact_mut(n)).enumerate() {
                    mu.iter_mut().zip(rows.iter()).for_each(|(m, row)| *m = row[c]);
                    step.previous_transpose_add(&part.at, &part.x, &part.u, mu, dx);
                    add(&mut dx[..past], &lambda[own..]);
                    lambda.copy_from_slice(dx);
                }
            }
            for (c, lambda) in columns.chunks_exact_mut(n).enumerate() {
                add(&mut lambda[..past], &history[c * past..(c + 1) * past]);
            }
        }
    }
}
