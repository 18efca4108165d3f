//! The dense Gauss–Newton Hessian, from G by rows or by columns, which processes share.

use std::ops::Range;

use super::dense_work::Dense;
use super::{CostFunction, StrongConstraint};
use crate::{Error, ranks};
use varda_linalg::dense::{View, gram};
use varda_linalg::interrupt;

impl StrongConstraint<'_> {
    /// A = I + GᵀG at the base point. A column of G takes a tangent product for every step of the window, a
    /// row an adjoint product for every step before its observation: whichever is fewer.
    pub(super) fn dense_hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let (n, m) = (self.dim(), self.observations.dim());
        assert_eq!(out.len(), n * n, "length of the Hessian");
        let (dense, by_rows, swept) = self.dense_factor();
        if swept.is_err() {
            self.dense = dense;
            return swept;
        }
        let gt = if by_rows {
            View::new(&dense.jacobian, n, m)
        } else {
            View::new(&dense.jacobian, m, n).transpose()
        };
        gram(gt, out);
        self.dense = dense;
        for j in 0..n {
            out[j + j * n] += 1.0;
        }
        Ok(())
    }

    /// G by columns, at the base point.
    pub(super) fn dense_g(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let (n, m) = (self.dim(), self.observations.dim());
        assert_eq!(out.len(), m * n, "length of G");
        let (dense, by_rows, swept) = self.dense_factor();
        if by_rows {
            let rows = View::new(&dense.jacobian, n, m);
            out.copy_from_slice(&rows.transpose().to_matrix().into_columns());
        } else {
            out.copy_from_slice(&dense.jacobian);
        }
        self.dense = dense;
        swept
    }

    /// G in the work space, by its rows (true) or by its columns. Processes do blocks of these and gather
    /// them.
    fn dense_factor(&mut self) -> (Dense, bool, Result<(), Error>) {
        let (n, m) = (self.dim(), self.observations.dim());
        let mut dense = std::mem::take(&mut self.dense);
        dense.dy.resize(m, 0.0);
        dense.dv.resize(n, 0.0);
        let [of_rows, of_columns] = [self.observations.steps_of_rows(), vec![self.last; n]];
        let [of_all_rows, of_all_columns] = [&of_rows, &of_columns].map(|steps| steps.iter().sum::<usize>());
        let by_rows = of_all_rows < of_all_columns;
        let steps = if by_rows { of_rows } else { of_columns };
        let ranks = ranks::for_numbers(of_all_rows.min(of_all_columns).saturating_mul(self.state_dim));
        let all = || 0..steps.len();
        let own = ranks.as_ref().map_or_else(all, |r| ranks::share_of_work(&steps, r.rank(), r.count()));
        dense.jacobian.clear();
        dense.jacobian.resize(own.len() * if by_rows { n } else { m }, 0.0);
        let mut swept = if by_rows { self.rows(&mut dense, own) } else { self.columns(&mut dense, own) };
        if let (Some(ranks), Ok(())) = (ranks, &swept) {
            dense.jacobian = ranks.all_gather(&self.linearized_at(), &dense.jacobian);
        }
        if swept.is_ok() && m > 0 {
            swept = self.whiten_factor(&mut dense.jacobian, by_rows);
        }
        (dense, by_rows, swept)
    }

    /// What products follow from: v, the predictions and R^{-1/2}.
    pub(super) fn linearized_at(&self) -> Vec<f64> {
        [&self.base.v, self.base.predicted.values(), &self.root_precision].concat()
    }

    /// R^{-1/2} times H M U, by rows or by columns.
    fn whiten_factor(&self, jacobian: &mut [f64], by_rows: bool) -> Result<(), Error> {
        let (n, m) = (self.dim(), self.observations.dim());
        let whitening: Vec<f64> = (0..m).map(|i| self.whitening(i)).collect();
        if by_rows {
            self.observations.whiten_rows(n, jacobian);
            for (row, whitening) in jacobian.chunks_exact_mut(n).zip(&whitening) {
                row.iter_mut().for_each(|g| *g *= whitening);
            }
            return Ok(());
        }
        for column in jacobian.chunks_exact_mut(m) {
            left_early()?;
            self.observations.whiten_blocks(column);
            column.iter_mut().zip(&whitening).for_each(|(g, whitening)| *g *= whitening);
        }
        Ok(())
    }

    /// (H M U)ᵀ column by column: rows of H M U in one sweep, each joining at its observation.
    fn rows(&mut self, dense: &mut Dense, own: Range<usize>) -> Result<(), Error> {
        let (n, m, head) = (self.dim(), self.observations.dim(), self.transform.dim());
        self.counts.adjoint_sweeps += m;
        let Dense { jacobian, block, dy, .. } = dense;
        let Self { model, transform, observations, errors, base, state_dim, last, dz, .. } = self;
        let (size, last) = (*state_dim, *last);
        let predicted = &base.predicted;
        block.clear();
        block.resize(own.len() * size, 0.0);
        // Of the rows of all processes those from here on are under way; where that is among the own ones.
        let mut first = m;
        let place = |row: usize| row.clamp(own.start, own.end) - own.start;
        let mut add = |k: usize, x: &[f64], block: &mut [f64]| {
            let seen = observations.rows_at(k);
            first = first.min(seen.start);
            for i in place(seen.start)..place(seen.end) {
                dy[own.start + i] = 1.0;
                observations.adjoint_add(k, x, dy, predicted, &mut block[i * size..(i + 1) * size]);
                dy[own.start + i] = 0.0;
            }
            if let (Some(errors), Some(before)) = (&mut *errors, k.checked_sub(1)) {
                let rows = jacobian.chunks_exact_mut(n).zip(block.chunks_exact(size));
                rows.skip(place(first)).for_each(|(row, l)| errors.adjoint_add(before, l, &mut row[head..]));
            }
            first
        };
        match model {
            Some(model) if last > 0 => {
                let mut first = m;
                base.trajectory.for_each_step_reversed(&mut **model, &mut |step| {
                    if interrupt::requested() {
                        return;
                    }
                    if step.k + 1 == last {
                        first = add(last, step.x_next, block);
                    }
                    step.adjoint_of_share(m - first, &mut block[place(first) * size..]);
                    first = add(step.k, step.x, block);
                })?;
            }
            _ => {
                add(0, base.trajectory.state(0), block);
            }
        }
        for (row, lambda) in jacobian.chunks_exact_mut(n).zip(block.chunks_exact(size)) {
            left_early()?;
            match model {
                Some(model) => model.initial_adjoint(lambda, dz),
                None => dz.copy_from_slice(lambda),
            }
            transform.adjoint(dz, &mut row[..head]);
        }
        Ok(())
    }

    /// Columns of H M U in one sweep.
    fn columns(&mut self, dense: &mut Dense, own: Range<usize>) -> Result<(), Error> {
        let (n, m, head) = (self.dim(), self.observations.dim(), self.transform.dim());
        self.counts.tangent_sweeps += n;
        if m == 0 {
            return Ok(());
        }
        let Dense { jacobian, block, dv, .. } = dense;
        let Self { model, transform, observations, errors, base, state_dim: size, dz, .. } = self;
        block.clear();
        block.resize(own.len() * *size, 0.0);
        for (j, dx) in own.clone().zip(block.chunks_exact_mut(*size)).take_while(|(j, _)| *j < head) {
            dv[j] = 1.0;
            transform.tangent(&dv[..head], dz);
            dv[j] = 0.0;
            match model {
                Some(model) => model.initial_tangent(dz, dx),
                None => dx.copy_from_slice(dz),
            }
        }
        let predicted = &base.predicted;
        let mut see = |k: usize, x: &[f64], block: &mut [f64]| {
            let columns = block.chunks_exact_mut(*size).zip(jacobian.chunks_exact_mut(m));
            for (j, (dx, dy)) in own.clone().zip(columns) {
                if j % ASKED_EVERY == 0 && interrupt::requested() {
                    return;
                }
                if let (Some(errors), Some(before)) = (&mut *errors, k.checked_sub(1)) {
                    dv[j] = 1.0;
                    errors.tangent_add(before, &dv[head..], dx);
                    dv[j] = 0.0;
                }
                observations.tangent_add(k, x, dx, predicted, dy);
            }
        };
        see(0, base.trajectory.state(0), block);
        if let Some(model) = model {
            base.trajectory.for_each_step(&mut **model, &mut |step| {
                if interrupt::requested() {
                    return;
                }
                step.tangent_of_share(n, block);
                see(step.k + 1, step.x_next, block);
            })?;
        }
        left_early()
    }
}

/// Columns between two questions whether to end.
const ASKED_EVERY: usize = 64;

/// An error where this thread was told to end: G is not whole.
fn left_early() -> Result<(), Error> {
    if interrupt::requested() { Err(varda_linalg::Error::Interrupted.into()) } else { Ok(()) }
}
