//! The linearization of a step as a list of substeps, and its products with one column or many.

use crate::{ImplicitStep, Interval, SolvedStep};
use varda_linalg::band::BLOCK;
use varda_linalg::{Factor, LinearSolver};

/// The linearization of a substep.
#[derive(Debug)]
pub(crate) struct Substep {
    pub(crate) at: Interval,
    pub(crate) x: Vec<f64>,
    pub(crate) u: Vec<f64>,
    pub(crate) factor: Factor,
    /// What the step keeps for its products.
    pub(crate) kept: Vec<f64>,
}

impl Substep {
    pub(crate) fn solved(&self) -> SolvedStep<'_> {
        SolvedStep { at: &self.at, x: &self.x, u: &self.u, kept: &self.kept }
    }
}

/// The linearization of one step: its substeps in order of time. Substeps beyond `used` keep their memory for
/// later.
#[derive(Debug, Default)]
pub(crate) struct Linearized {
    pub(crate) used: usize,
    pub(crate) substeps: Vec<Substep>,
}

impl Linearized {
    /// The place of substep p ≤ the number of places so far, of a step whose state, unknowns and kept
    /// numbers have these lengths.
    pub(crate) fn place(
        &mut self,
        p: usize,
        state: usize,
        unknowns: usize,
        kept: usize,
        solver: &LinearSolver,
    ) -> &mut Substep {
        if self.substeps.len() == p {
            self.substeps.push(Substep {
                at: Interval { index: 0, start: 0.0, length: 0.0, previous: None },
                x: vec![0.0; state],
                u: vec![0.0; unknowns],
                factor: solver.empty_factor(),
                kept: vec![0.0; kept],
            });
        }
        &mut self.substeps[p]
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        let substep = |s: &Substep| substep_bytes(s.x.len() + s.u.len() + s.kept.len(), &s.factor);
        size_of::<Self>() + self.substeps.iter().map(substep).sum::<usize>()
    }
}

/// Bytes of one substep that has this many numbers beside its factor, without the factor's share for a
/// sparse Jacobian.
pub(crate) fn substep_bytes(numbers: usize, factor: &Factor) -> usize {
    numbers * size_of::<f64>() + factor.bytes() + size_of::<Substep>()
}

/// Work space of the products.
#[derive(Debug, Default)]
pub(crate) struct Products {
    /// Unknowns of one column.
    u: Vec<f64>,
    /// Unknowns of the columns, row by row.
    rows: Vec<[f64; BLOCK]>,
    /// dx of the columns, one after the other.
    dx: Vec<f64>,
    /// The histories of the columns, one after the other: the first components of dx, or the last of λ.
    history: Vec<f64>,
}

impl Products {
    /// Work space for single columns; that for many is allocated by the first product with many.
    pub(crate) fn new(state: usize, unknowns: usize, history: usize) -> Self {
        Self { u: vec![0.0; unknowns], rows: Vec::new(), dx: vec![0.0; state], history: vec![0.0; history] }
    }

    fn resize_for_many(&mut self, state: usize, history: usize) {
        self.rows.resize(self.u.len(), [0.0; BLOCK]);
        self.dx.resize(BLOCK * state, 0.0);
        self.history.resize(BLOCK * history, 0.0);
    }

    /// dx ← M dx through all substeps, see [`ImplicitModel`](crate::ImplicitModel).
    pub(crate) fn tangent<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        substeps: &[Substep],
        dx: &mut [f64],
    ) {
        let (n, past) = (dx.len(), step.history());
        let own = n - past;
        let Self { u: du, dx: dx_next, history, .. } = self;
        let (history, dx_next) = (&mut history[..past], &mut dx_next[..n]);
        history.copy_from_slice(&dx[..past]);
        for substep in substeps {
            step.previous(&substep.solved(), dx, du);
            solver.solve(&substep.factor, du);
            du.iter_mut().for_each(|d| *d = -*d);
            step.advance_tangent(&substep.solved(), dx, du, &mut dx_next[..own]);
            dx_next[own..].copy_from_slice(&dx[..past]);
            dx.copy_from_slice(dx_next);
        }
        dx[own..].copy_from_slice(history);
    }

    /// λ ← Mᵀ λ through all substeps.
    pub(crate) fn adjoint<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        substeps: &[Substep],
        lambda: &mut [f64],
    ) {
        let (n, past) = (lambda.len(), step.history());
        let own = n - past;
        let Self { u: mu, dx, history, .. } = self;
        let (history, dx) = (&mut history[..past], &mut dx[..n]);
        history.copy_from_slice(&lambda[own..]);
        lambda[own..].fill(0.0);
        for substep in substeps.iter().rev() {
            step.advance_adjoint(&substep.solved(), &lambda[..own], dx, mu);
            solver.solve_transpose(&substep.factor, mu);
            mu.iter_mut().for_each(|m| *m = -*m);
            step.previous_transpose_add(&substep.solved(), mu, dx);
            add(&mut dx[..past], &lambda[own..]);
            lambda.copy_from_slice(dx);
        }
        add(&mut lambda[..past], history);
    }

    /// `tangent` of every column of length n: one pass over a factor for every few of them.
    pub(crate) fn tangent_of_many<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        substeps: &[Substep],
        n: usize,
        dx: &mut [f64],
    ) {
        let (past, own) = (step.history(), n - step.history());
        self.resize_for_many(n, past);
        let Self { u: du, rows, dx: dx_next, history } = self;
        for columns in dx.chunks_mut(BLOCK * n) {
            for (c, dx) in columns.chunks_exact(n).enumerate() {
                history[c * past..(c + 1) * past].copy_from_slice(&dx[..past]);
            }
            for substep in substeps {
                for (c, dx) in columns.chunks_exact(n).enumerate() {
                    step.previous(&substep.solved(), dx, du);
                    rows.iter_mut().zip(du.iter()).for_each(|(row, d)| row[c] = -d);
                }
                solver.solve_block(&substep.factor, rows);
                for (c, (dx, dx_next)) in
                    columns.chunks_exact_mut(n).zip(dx_next.chunks_exact_mut(n)).enumerate()
                {
                    du.iter_mut().zip(rows.iter()).for_each(|(d, row)| *d = row[c]);
                    let next = &mut dx_next[..own];
                    step.advance_tangent(&substep.solved(), dx, du, next);
                    dx_next[own..].copy_from_slice(&dx[..past]);
                    dx.copy_from_slice(dx_next);
                }
            }
            for (c, dx) in columns.chunks_exact_mut(n).enumerate() {
                dx[own..].copy_from_slice(&history[c * past..(c + 1) * past]);
            }
        }
    }

    /// `adjoint` of every column of length n.
    pub(crate) fn adjoint_of_many<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        substeps: &[Substep],
        n: usize,
        lambda: &mut [f64],
    ) {
        let (past, own) = (step.history(), n - step.history());
        self.resize_for_many(n, past);
        let Self { u: mu, rows, dx, history } = self;
        for columns in lambda.chunks_mut(BLOCK * n) {
            for (c, lambda) in columns.chunks_exact_mut(n).enumerate() {
                history[c * past..(c + 1) * past].copy_from_slice(&lambda[own..]);
                lambda[own..].fill(0.0);
            }
            for substep in substeps.iter().rev() {
                for (c, (lambda, dx)) in columns.chunks_exact(n).zip(dx.chunks_exact_mut(n)).enumerate() {
                    step.advance_adjoint(&substep.solved(), &lambda[..own], dx, mu);
                    rows.iter_mut().zip(mu.iter()).for_each(|(row, m)| row[c] = -m);
                }
                solver.solve_transpose_block(&substep.factor, rows);
                for (c, (lambda, dx)) in columns.chunks_exact_mut(n).zip(dx.chunks_exact_mut(n)).enumerate() {
                    mu.iter_mut().zip(rows.iter()).for_each(|(m, row)| *m = row[c]);
                    step.previous_transpose_add(&substep.solved(), mu, dx);
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

pub(crate) fn add(target: &mut [f64], values: &[f64]) {
    target.iter_mut().zip(values).for_each(|(t, v)| *t += v);
}
