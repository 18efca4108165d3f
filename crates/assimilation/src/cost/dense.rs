//! The dense Gauss–Newton Hessian, from G by rows or by columns.

use super::dense_work::Dense;
use super::{CostFunction, StrongConstraint};
use crate::Error;
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

    /// G in the work space, by its rows (true) or by its columns.
    fn dense_factor(&mut self) -> (Dense, bool, Result<(), Error>) {
        let (n, m) = (self.dim(), self.observations.dim());
        let mut dense = std::mem::take(&mut self.dense);
        dense.jacobian.clear();
        dense.jacobian.resize(m * n, 0.0);
        dense.dy.resize(m, 0.0);
        dense.dv.resize(n, 0.0);
        let by_rows = self.observations.steps_of_rows() < n * self.last;
        let swept = if by_rows { self.rows(&mut dense) } else { self.columns(&mut dense) };
        (dense, by_rows, swept)
    }

    /// Gᵀ column by column: all rows of G in one sweep, each joining at its observation.
    fn rows(&mut self, dense: &mut Dense) -> Result<(), Error> {
        let (n, m, head) = (self.dim(), self.observations.dim(), self.transform.dim());
        self.counts.adjoint_sweeps += m;
        let Dense { jacobian, block, dy, .. } = dense;
        let Self { model, transform, observations, errors, base, state_dim, last, dz, .. } = self;
        let (size, last) = (*state_dim, *last);
        let predicted = &base.predicted;
        block.clear();
        block.resize(m * size, 0.0);
        // Rows from here on are under way.
        let mut first = m;
        let mut add = |k: usize, x: &[f64], block: &mut [f64]| {
            let seen = observations.rows_at(k);
            first = first.min(seen.start);
            for i in seen {
                dy[i] = 1.0;
                observations.adjoint_add(k, x, dy, predicted, &mut block[i * size..(i + 1) * size]);
                dy[i] = 0.0;
            }
            if let (Some(errors), Some(before)) = (&mut *errors, k.checked_sub(1)) {
                let rows = jacobian.chunks_exact_mut(n).zip(block.chunks_exact(size));
                rows.skip(first).for_each(|(row, l)| errors.adjoint_add(before, l, &mut row[head..]));
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
                    step.adjoint(&mut block[first * size..]);
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
        self.observations.whiten_rows(n, jacobian);
        for (i, row) in jacobian.chunks_exact_mut(n).enumerate() {
            let whitening = self.whitening(i);
            row.iter_mut().for_each(|g| *g *= whitening);
        }
        Ok(())
    }

    /// G column by column, all in one sweep.
    fn columns(&mut self, dense: &mut Dense) -> Result<(), Error> {
        let (n, m, head) = (self.dim(), self.observations.dim(), self.transform.dim());
        self.counts.tangent_sweeps += n;
        if m == 0 {
            return Ok(());
        }
        let Dense { jacobian, block, dv, .. } = dense;
        let Self { model, transform, observations, errors, base, state_dim: size, dz, .. } = self;
        block.clear();
        block.resize(n * *size, 0.0);
        for (j, dx) in block.chunks_exact_mut(*size).enumerate().take(head) {
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
            for (j, (dx, dy)) in block.chunks_exact_mut(*size).zip(jacobian.chunks_exact_mut(m)).enumerate() {
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
                step.tangent(block);
                see(step.k + 1, step.x_next, block);
            })?;
        }
        let whitening: Vec<f64> = (0..m).map(|i| self.whitening(i)).collect();
        for column in jacobian.chunks_exact_mut(m) {
            left_early()?;
            self.observations.whiten_blocks(column);
            column.iter_mut().zip(&whitening).for_each(|(g, whitening)| *g *= whitening);
        }
        Ok(())
    }
}

/// Columns between two questions whether to end.
const ASKED_EVERY: usize = 64;

/// An error where this thread was told to end: G is not whole.
fn left_early() -> Result<(), Error> {
    if interrupt::requested() { Err(varda_linalg::Error::Interrupted.into()) } else { Ok(()) }
}
