//! P A = L U.

use crate::{BadPivot, clear_upper_registers};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::lu::partial_pivoting::factor::{lu_in_place, lu_in_place_scratch};
use faer::{MatMut, Par};

/// Matrices from this size on are factored in blocks.
const BLOCKED_FROM: usize = 32;

/// Work space for LU factorizations with partial pivoting of n × n matrices.
pub(crate) struct LuWork {
    permuted: Vec<f64>,
    inverse: Vec<usize>,
    scratch: MemBuffer,
}

impl LuWork {
    pub(crate) fn new(n: usize) -> Self {
        let scratch = lu_in_place_scratch::<usize, f64>(n, n, Par::Seq, Default::default());
        Self { permuted: vec![0.0; n], inverse: vec![0; n], scratch: MemBuffer::new(scratch) }
    }

    /// Factors `lu`, which holds a copy of `values`, column by column in place, L with a unit diagonal;
    /// `pivots[k]` is the row of A that came to place k.
    pub(crate) fn factor(
        &mut self,
        values: &[f64],
        lu: &mut [f64],
        pivots: &mut [usize],
    ) -> Result<(), BadPivot> {
        let n = pivots.len();
        if n >= BLOCKED_FROM {
            lu_in_place(
                MatMut::from_column_major_slice_mut(lu, n, n),
                pivots,
                &mut self.inverse,
                Par::Seq,
                MemStack::new(&mut self.scratch),
                Default::default(),
            );
            clear_upper_registers();
        } else {
            unblocked(n, lu, pivots);
        }
        for k in 0..n {
            let largest = values[k * n..(k + 1) * n].iter().fold(0.0_f64, |m, v| m.max(v.abs()));
            let pivot = lu[k * (n + 1)];
            let usable = pivot.abs() > f64::EPSILON * largest && pivot.is_normal();
            if !usable {
                return Err(BadPivot { row: k });
            }
        }
        Ok(())
    }

    /// b ← A⁻¹ b.
    pub(crate) fn solve(&mut self, lu: &[f64], pivots: &[usize], b: &mut [f64]) {
        let (n, x) = (pivots.len(), &mut self.permuted);
        assert_eq!(b.len(), n, "factor and right-hand side differ in size");
        for (x, &p) in x.iter_mut().zip(pivots) {
            *x = b[p];
        }
        b.copy_from_slice(x);
        for k in 0..n {
            let y = b[k];
            for (b, l) in b[k + 1..].iter_mut().zip(&lu[k * n + k + 1..(k + 1) * n]) {
                *b -= l * y;
            }
        }
        for k in (0..n).rev() {
            b[k] /= lu[k * (n + 1)];
            let y = b[k];
            for (b, u) in b[..k].iter_mut().zip(&lu[k * n..k * n + k]) {
                *b -= u * y;
            }
        }
    }

    /// b ← A⁻ᵀ b.
    pub(crate) fn solve_transpose(&mut self, lu: &[f64], pivots: &[usize], b: &mut [f64]) {
        let (n, x) = (pivots.len(), &mut self.permuted);
        assert_eq!(b.len(), n, "factor and right-hand side differ in size");
        for k in 0..n {
            let dot: f64 = lu[k * n..k * n + k].iter().zip(&b[..k]).map(|(u, y)| u * y).sum();
            b[k] = (b[k] - dot) / lu[k * (n + 1)];
        }
        for k in (0..n).rev() {
            let dot: f64 = lu[k * n + k + 1..(k + 1) * n].iter().zip(&b[k + 1..]).map(|(l, y)| l * y).sum();
            b[k] -= dot;
        }
        for (&y, &p) in b.iter().zip(pivots) {
            x[p] = y;
        }
        b.copy_from_slice(x);
    }
}

/// LU with partial pivoting of a small matrix stored column by column.
fn unblocked(n: usize, a: &mut [f64], rows: &mut [usize]) {
    for (i, row) in rows.iter_mut().enumerate() {
        *row = i;
    }
    for k in 0..n {
        let mut p = k;
        for i in k + 1..n {
            if a[k * n + i].abs() > a[k * n + p].abs() {
                p = i;
            }
        }
        rows.swap(k, p);
        (0..n).for_each(|j| a.swap(j * n + k, j * n + p));
        let reciprocal = 1.0 / a[k * (n + 1)];
        a[k * (n + 1) + 1..(k + 1) * n].iter_mut().for_each(|l| *l *= reciprocal);
        let (left, right) = a.split_at_mut((k + 1) * n);
        for column in right.chunks_exact_mut(n) {
            let y = column[k];
            for (c, l) in column[k + 1..].iter_mut().zip(&left[k * (n + 1) + 1..]) {
                *c -= l * y;
            }
        }
    }
}
