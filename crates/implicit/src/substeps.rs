//! The linearization of a step as a list of substeps, and its products with one column or many.

use crate::{ImplicitStep, Interval, Multipliers, SolvedStep};
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
    /// λ at the end of the step that `seconds` belongs to; empty where it belongs to none.
    second_of: Vec<f64>,
    /// What second derivatives keep of each substep.
    seconds: Vec<Second>,
    /// dx and du of every substep for the dx that stands first; empty where there is none.
    path: Vec<f64>,
}

/// What second derivatives keep of a substep.
#[derive(Debug, Default)]
struct Second {
    /// λ of the state after it without the history, and μ.
    lambda: Vec<f64>,
    mu: Vec<f64>,
    kept: Vec<f64>,
}

impl Second {
    fn multipliers(&self) -> Multipliers<'_> {
        Multipliers { lambda: &self.lambda, mu: &self.mu, kept: &self.kept }
    }
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

    /// To be called when the slot is linearized anew.
    pub(crate) fn forget(&mut self) {
        self.used = 0;
        self.second_of.clear();
        self.path.clear();
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        let substep = |s: &Substep| substep_bytes(s.x.len() + s.u.len() + s.kept.len(), &s.factor);
        let second = |s: &Second| {
            (s.lambda.capacity() + s.mu.capacity() + s.kept.capacity()) * size_of::<f64>()
                + size_of::<Second>()
        };
        size_of::<Self>()
            + (self.second_of.capacity() + self.path.capacity()) * size_of::<f64>()
            + self.substeps.iter().map(substep).sum::<usize>()
            + self.seconds.iter().map(second).sum::<usize>()
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
    /// λ on its way through substeps, where second derivatives are kept.
    lambda: Vec<f64>,
}

impl Products {
    /// Work space for single columns; that for many is allocated by the first product with many.
    pub(crate) fn new(state: usize, unknowns: usize, history: usize) -> Self {
        Self { u: vec![0.0; unknowns], dx: vec![0.0; state], history: vec![0.0; history], ..Self::default() }
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

    /// λ̇ ← M'ᵀ λ̇ + Σ λ_i ∂²M_i dx through all substeps: with w = (dx, du), L = λᵀS +
    /// μᵀG,
    ///
    /// ```text
    /// r = (∂S/∂u)ᵀ λ̇ + ∂²L/∂u∂(x,u) w,   ν = −(∂G/∂u)⁻ᵀ r
    /// λ̇ ← (∂S/∂x)ᵀ λ̇ + ∂²L/∂x∂(x,u) w + (∂G/∂x)ᵀ ν
    /// ```
    pub(crate) fn adjoint_derivative<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        linearized: &mut Linearized,
        [dx, lambda]: [&[f64]; 2],
        derivative: &mut [f64],
    ) {
        if linearized.second_of != lambda {
            self.keep_second(step, solver, linearized, lambda);
        }
        if linearized.path.get(..dx.len()) != Some(dx) {
            self.keep_path(step, solver, linearized, dx);
        }
        let Linearized { used, substeps, seconds, path, .. } = linearized;
        let (substeps, seconds) = (&substeps[..*used], &seconds[..*used]);
        let (n, past, unknowns) = (dx.len(), step.history(), self.u.len());
        let own = n - past;
        let now = &mut self.dx[..n];
        let (history, nu, next) = (&mut self.history[..past], &mut self.u, now);
        history.copy_from_slice(&derivative[own..]);
        derivative[own..].fill(0.0);
        for ((substep, second), at) in substeps.iter().zip(seconds).zip(path.chunks_exact(n + unknowns)).rev()
        {
            let (dx, du) = at.split_at(n);
            step.advance_adjoint(&substep.solved(), &derivative[..own], next, nu);
            step.second_add(&substep.solved(), &second.multipliers(), [dx, du], [next, nu]);
            solver.solve_transpose(&substep.factor, nu);
            nu.iter_mut().for_each(|m| *m = -*m);
            step.previous_transpose_add(&substep.solved(), nu, next);
            add(&mut next[..past], &derivative[own..]);
            derivative.copy_from_slice(next);
        }
        add(&mut derivative[..past], history);
    }

    /// dx ← M dx as `tangent`, the way kept.
    pub(crate) fn tangent_kept<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        linearized: &mut Linearized,
        dx: &mut [f64],
    ) {
        self.keep_path(step, solver, linearized, dx);
        let past = step.history();
        let own = dx.len() - past;
        dx.copy_from_slice(&self.dx[..dx.len()]);
        dx[own..].copy_from_slice(&linearized.path[..past]);
    }

    /// dx and du of every substep into the slot; dx after the last one, its history aside, into `self.dx`.
    fn keep_path<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        linearized: &mut Linearized,
        dx: &[f64],
    ) {
        let Linearized { used, substeps, path, .. } = linearized;
        let (n, past, unknowns) = (dx.len(), step.history(), self.u.len());
        let (own, now) = (n - past, &mut self.dx[..n]);
        path.resize(*used * (n + unknowns), 0.0);
        now.copy_from_slice(dx);
        for (substep, at) in substeps[..*used].iter().zip(path.chunks_exact_mut(n + unknowns)) {
            let (before, du) = at.split_at_mut(n);
            before.copy_from_slice(now);
            step.previous(&substep.solved(), before, du);
            solver.solve(&substep.factor, du);
            du.iter_mut().for_each(|d| *d = -*d);
            step.advance_tangent(&substep.solved(), before, du, &mut now[..own]);
            now[own..].copy_from_slice(&before[..past]);
        }
    }

    /// λ and μ of every substep, and what the step keeps for them.
    fn keep_second<S: ImplicitStep>(
        &mut self,
        step: &mut S,
        solver: &mut LinearSolver,
        linearized: &mut Linearized,
        lambda: &[f64],
    ) {
        let Linearized { used, substeps, second_of, seconds, .. } = linearized;
        let (n, past) = (lambda.len(), step.history());
        let own = n - past;
        second_of.clear();
        second_of.extend_from_slice(lambda);
        if seconds.len() < *used {
            seconds.resize_with(*used, Second::default);
        }
        let numbers = step.second_kept().expect("asked for only where there are second derivatives");
        let Self { u, dx, lambda: now, .. } = self;
        let dx = &mut dx[..n];
        now.clear();
        now.extend_from_slice(lambda);
        now[own..].fill(0.0);
        for (substep, second) in substeps[..*used].iter().zip(seconds.iter_mut()).rev() {
            second.kept.resize(numbers, 0.0);
            second.mu.resize(u.len(), 0.0);
            second.lambda.clear();
            second.lambda.extend_from_slice(&now[..own]);
            step.advance_adjoint(&substep.solved(), &now[..own], dx, &mut second.mu);
            solver.solve_transpose(&substep.factor, &mut second.mu);
            second.mu.iter_mut().for_each(|m| *m = -*m);
            step.previous_transpose_add(&substep.solved(), &second.mu, dx);
            add(&mut dx[..past], &now[own..]);
            now.copy_from_slice(dx);
            step.keep_second(&substep.solved(), &second.lambda, &second.mu, &mut second.kept);
        }
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
        let Self { u: du, rows, dx: dx_next, history, .. } = self;
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
        let Self { u: mu, rows, dx, history, .. } = self;
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
