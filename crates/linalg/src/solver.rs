//! One solver for every [`Structure`].

use std::fmt;

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::sparse::linalg::{LuError, lu as sparse_lu};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{ColMut, Conj, MatMut, Par};

use crate::Structure;
use crate::band::{self, BLOCK, BadPivot};

/// Factors and solves matrices of one structure.
///
/// Band matrices go through [`crate::band`], dense ones through LU with partial pivoting (faer's from 32 unknowns on, a
/// plain loop below), sparse ones through faer's sparse LU, whose symbolic part is computed once. Nothing is allocated
/// after the first factorization into a [`Factor`], except inside faer for a sparse matrix, where the fill may grow
/// with the pivots.
pub struct LinearSolver {
    n: usize,
    structure: Structure,
    symbolic: Option<sparse_lu::SymbolicLu<usize>>,
    scratch: MemBuffer,
    shifted: Vec<f64>,
    permuted: Vec<f64>,
    inverse: Vec<usize>,
    column: Vec<f64>,
}

/// The factor of one matrix; belongs to the [`LinearSolver`] that made it.
#[derive(Debug, Clone)]
pub struct Factor {
    values: Vec<f64>,
    /// Band: the row swapped with row k. Dense: the row of A that came to place k.
    pivots: Vec<usize>,
    sparse: sparse_lu::NumericLu<usize, f64>,
}

impl Factor {
    /// Heap memory held, in bytes, without what faer holds for a sparse matrix.
    pub fn bytes(&self) -> usize {
        size_of_val(self.values.as_slice()) + size_of_val(self.pivots.as_slice())
    }
}

/// Dense matrices from this size on are factored by faer.
const BLOCKED_FROM: usize = 32;

impl LinearSolver {
    /// A solver for matrices of n rows and the given structure.
    ///
    /// # Panics
    /// If a sparse structure is not a pattern of n rows and columns.
    pub fn new(n: usize, structure: &Structure) -> Self {
        let mut scratch = StackReq::new::<usize>(n);
        let mut symbolic = None;
        if let Structure::Sparse { columns, rows } = structure {
            let pattern = SymbolicSparseColMatRef::new_checked(n, n, columns, None, rows);
            let made = sparse_lu::factorize_symbolic_lu(pattern, Default::default())
                .expect("room for the symbolic factor");
            scratch = made
                .factorize_numeric_lu_scratch::<f64>(Par::Seq, Default::default())
                .or(made.solve_in_place_scratch::<f64>(1, Par::Seq))
                .or(made.solve_transpose_in_place_scratch::<f64>(1, Par::Seq));
            symbolic = Some(made);
        }
        let mut solver = Self {
            n,
            structure: structure.clone(),
            symbolic,
            scratch: MemBuffer::new(scratch),
            shifted: Vec::new(),
            permuted: vec![0.0; n],
            inverse: vec![0; n],
            column: vec![0.0; n],
        };
        solver.shifted = vec![0.0; solver.values_len()];
        solver
    }

    /// Number of values of a matrix of this structure.
    pub fn values_len(&self) -> usize {
        match &self.structure {
            Structure::Dense => self.n * self.n,
            Structure::SymmetricBand { half_bandwidth } => self.n * (half_bandwidth + 1),
            Structure::Band { half_bandwidth } => self.n * (2 * half_bandwidth + 1),
            Structure::Sparse { rows, .. } => rows.len(),
        }
    }

    /// Room for a factor.
    pub fn empty_factor(&self) -> Factor {
        let (values, pivots) = match self.structure {
            Structure::Dense => (self.n * self.n, self.n),
            Structure::SymmetricBand { half_bandwidth } => (self.n * (half_bandwidth + 1), 0),
            Structure::Band { half_bandwidth } => (band::lu_len(self.n, half_bandwidth), self.n),
            Structure::Sparse { .. } => (0, 0),
        };
        Factor { values: vec![0.0; values], pivots: vec![0; pivots], sparse: sparse_lu::NumericLu::new() }
    }

    /// Factors the matrix with these values. Returns the number of its negative eigenvalues for a symmetric band, 0 for the
    /// other structures, whose factors do not show it.
    ///
    /// # Errors
    /// [`BadPivot`] if the matrix is singular to rounding or not finite.
    ///
    /// # Panics
    /// If `values` has not [`values_len`](Self::values_len) values or `factor` is of another solver.
    pub fn factor(&mut self, values: &[f64], factor: &mut Factor) -> Result<usize, BadPivot> {
        match &self.structure {
            Structure::SymmetricBand { half_bandwidth } => {
                factor.values.copy_from_slice(values);
                return band::ldlt_factor(*half_bandwidth, &mut factor.values);
            }
            Structure::Band { half_bandwidth } => {
                band::lu_factor(*half_bandwidth, values, &mut factor.values, &mut factor.pivots)?;
            }
            Structure::Dense => {
                factor.values.copy_from_slice(values);
                self.factor_dense(values, factor)?;
            }
            Structure::Sparse { columns, rows } => {
                let pattern = SymbolicSparseColMatRef::new_checked(self.n, self.n, columns, None, rows);
                self.symbolic
                    .as_ref()
                    .expect("made in new")
                    .factorize_numeric_lu(
                        &mut factor.sparse,
                        SparseColMatRef::new(pattern, values),
                        Par::Seq,
                        MemStack::new(&mut self.scratch),
                        Default::default(),
                    )
                    .map_err(|e| match e {
                        LuError::SymbolicSingular { index } => BadPivot { row: index },
                        LuError::Generic(_) => BadPivot { row: 0 },
                    })?;
                // faer factors a singular matrix without a word: its solutions are not finite
                let mut probe = std::mem::take(&mut self.permuted);
                probe.fill(1.0);
                self.solve(factor, &mut probe);
                let bad = probe.iter().position(|p| !p.is_finite());
                self.permuted = probe;
                if let Some(row) = bad {
                    return Err(BadPivot { row });
                }
            }
        }
        Ok(0)
    }

    /// Factors the matrix with `shift` times |a_ii| added to every diagonal entry. Where that is less than 10⁻⁸ of the
    /// largest on the diagonal (a zero, say), the latter is taken.
    ///
    /// # Errors
    /// As [`factor`](Self::factor).
    pub fn factor_shifted(
        &mut self,
        values: &[f64],
        shift: f64,
        factor: &mut Factor,
    ) -> Result<usize, BadPivot> {
        self.factor_with(values, factor, |own, largest| shift * own.max(1e-8 * largest))
    }

    /// Factors the matrix with `share` times the largest |a_ii| added to every diagonal entry.
    ///
    /// # Errors
    /// As [`factor`](Self::factor).
    pub fn factor_lifted(
        &mut self,
        values: &[f64],
        share: f64,
        factor: &mut Factor,
    ) -> Result<usize, BadPivot> {
        self.factor_with(values, factor, |_, largest| share * largest)
    }

    /// Factors the matrix with `more(|a_ii|, max |a_jj|)` added to every diagonal entry.
    fn factor_with(
        &mut self,
        values: &[f64],
        factor: &mut Factor,
        more: impl Fn(f64, f64) -> f64,
    ) -> Result<usize, BadPivot> {
        let mut shifted = std::mem::take(&mut self.shifted);
        shifted.copy_from_slice(values);
        let largest = (0..self.n)
            .filter_map(|i| self.structure.diagonal(self.n, i))
            .fold(0.0_f64, |m, p| m.max(values[p].abs()));
        for p in (0..self.n).filter_map(|i| self.structure.diagonal(self.n, i)) {
            shifted[p] += more(values[p].abs(), largest);
        }
        let result = self.factor(&shifted, factor);
        self.shifted = shifted;
        result
    }

    /// b ← A⁻¹ b.
    ///
    /// # Panics
    /// If the length of `b` is not n.
    pub fn solve(&mut self, factor: &Factor, b: &mut [f64]) {
        match self.structure {
            Structure::SymmetricBand { half_bandwidth } => {
                band::ldlt_solve(half_bandwidth, &factor.values, b)
            }
            Structure::Band { half_bandwidth } => {
                band::lu_solve(half_bandwidth, &factor.values, &factor.pivots, b)
            }
            Structure::Dense => self.solve_dense(factor, b),
            Structure::Sparse { .. } => {
                let symbolic = self.symbolic.as_ref().expect("made in new");
                sparse_lu::LuRef::new_unchecked(symbolic, &factor.sparse).solve_in_place_with_conj(
                    Conj::No,
                    ColMut::from_slice_mut(b).as_mat_mut(),
                    Par::Seq,
                    MemStack::new(&mut self.scratch),
                );
            }
        }
    }

    /// b ← A⁻ᵀ b.
    ///
    /// # Panics
    /// If the length of `b` is not n.
    pub fn solve_transpose(&mut self, factor: &Factor, b: &mut [f64]) {
        match self.structure {
            Structure::SymmetricBand { half_bandwidth } => {
                band::ldlt_solve(half_bandwidth, &factor.values, b)
            }
            Structure::Band { half_bandwidth } => {
                band::lu_solve_transpose(half_bandwidth, &factor.values, &factor.pivots, b);
            }
            Structure::Dense => self.solve_dense_transpose(factor, b),
            Structure::Sparse { .. } => {
                let symbolic = self.symbolic.as_ref().expect("made in new");
                sparse_lu::LuRef::new_unchecked(symbolic, &factor.sparse).solve_transpose_in_place_with_conj(
                    Conj::No,
                    ColMut::from_slice_mut(b).as_mat_mut(),
                    Par::Seq,
                    MemStack::new(&mut self.scratch),
                );
            }
        }
    }

    /// B ← A⁻¹ B for a block of right-hand sides, row by row: entry (i, c) in `b[i][c]`. A column's bits do not depend on the others.
    ///
    /// # Panics
    /// If B has not n rows.
    pub fn solve_block(&mut self, factor: &Factor, b: &mut [[f64; BLOCK]]) {
        match self.structure {
            Structure::SymmetricBand { half_bandwidth } => {
                band::ldlt_solve_block(half_bandwidth, &factor.values, b)
            }
            _ => self.each_column(b, &mut |solver, column| solver.solve(factor, column)),
        }
    }

    /// B ← A⁻ᵀ B, as `solve_block`.
    ///
    /// # Panics
    /// If B has not n rows.
    pub fn solve_transpose_block(&mut self, factor: &Factor, b: &mut [[f64; BLOCK]]) {
        match self.structure {
            Structure::SymmetricBand { half_bandwidth } => {
                band::ldlt_solve_block(half_bandwidth, &factor.values, b)
            }
            _ => self.each_column(b, &mut |solver, column| solver.solve_transpose(factor, column)),
        }
    }

    fn each_column(&mut self, b: &mut [[f64; BLOCK]], act: &mut dyn FnMut(&mut Self, &mut [f64])) {
        let mut column = std::mem::take(&mut self.column);
        for c in 0..BLOCK {
            column.iter_mut().zip(b.iter()).for_each(|(v, row)| *v = row[c]);
            act(self, &mut column);
            b.iter_mut().zip(&column).for_each(|(row, v)| row[c] = *v);
        }
        self.column = column;
    }

    /// A direction z with zᵀ A z < 0, and that number, for a symmetric band with a negative pivot; `None` otherwise.
    ///
    /// # Panics
    /// If the length of `z` is not n.
    pub fn negative_curvature(&self, factor: &Factor, z: &mut [f64]) -> Option<f64> {
        match self.structure {
            Structure::SymmetricBand { half_bandwidth } => {
                band::ldlt_negative_curvature(half_bandwidth, &factor.values, z)
            }
            _ => None,
        }
    }

    /// y_i = Σ_j |A_ij| |x_j|.
    ///
    /// # Panics
    /// If a length does not fit.
    pub fn absolute_product(&self, values: &[f64], x: &[f64], y: &mut [f64]) {
        assert!(
            values.len() == self.values_len() && x.len() == self.n && y.len() == self.n,
            "lengths differ"
        );
        y.fill(0.0);
        match &self.structure {
            Structure::Dense => {
                for (i, v) in values.iter().enumerate() {
                    y[i % self.n] += v.abs() * x[i / self.n].abs();
                }
            }
            Structure::SymmetricBand { half_bandwidth: w } => {
                for i in 0..self.n {
                    for j in i.saturating_sub(*w)..=i {
                        let v = values[i * (w + 1) + j + w - i].abs();
                        y[i] += v * x[j].abs();
                        if j < i {
                            y[j] += v * x[i].abs();
                        }
                    }
                }
            }
            Structure::Band { half_bandwidth: w } => {
                for i in 0..self.n {
                    for j in i.saturating_sub(*w)..(i + w + 1).min(self.n) {
                        y[i] += values[i * (2 * w + 1) + j + w - i].abs() * x[j].abs();
                    }
                }
            }
            Structure::Sparse { columns, rows } => {
                for j in 0..self.n {
                    for p in columns[j]..columns[j + 1] {
                        y[rows[p]] += values[p].abs() * x[j].abs();
                    }
                }
            }
        }
    }

    /// P A = L U, column by column in place, L with a unit diagonal.
    fn factor_dense(&mut self, values: &[f64], factor: &mut Factor) -> Result<(), BadPivot> {
        let n = self.n;
        let Factor { values: lu, pivots, .. } = factor;
        if n >= BLOCKED_FROM {
            let matrix = MatMut::from_column_major_slice_mut(lu, n, n);
            let stack = MemStack::new(&mut self.scratch);
            faer::linalg::lu::partial_pivoting::factor::lu_in_place(
                matrix,
                pivots,
                &mut self.inverse,
                Par::Seq,
                stack,
                Default::default(),
            );
        } else {
            lu_in_place(n, lu, pivots);
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

    fn solve_dense(&mut self, factor: &Factor, b: &mut [f64]) {
        let (n, lu, x) = (self.n, &factor.values, &mut self.permuted);
        for (x, &p) in x.iter_mut().zip(&factor.pivots) {
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

    fn solve_dense_transpose(&mut self, factor: &Factor, b: &mut [f64]) {
        let (n, lu, x) = (self.n, &factor.values, &mut self.permuted);
        for k in 0..n {
            let dot: f64 = lu[k * n..k * n + k].iter().zip(&b[..k]).map(|(u, y)| u * y).sum();
            b[k] = (b[k] - dot) / lu[k * (n + 1)];
        }
        for k in (0..n).rev() {
            let dot: f64 = lu[k * n + k + 1..(k + 1) * n].iter().zip(&b[k + 1..]).map(|(l, y)| l * y).sum();
            b[k] -= dot;
        }
        for (&y, &p) in b.iter().zip(&factor.pivots) {
            x[p] = y;
        }
        b.copy_from_slice(x);
    }
}

impl fmt::Debug for LinearSolver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LinearSolver")
            .field("n", &self.n)
            .field("structure", &self.structure)
            .finish_non_exhaustive()
    }
}

/// LU with partial pivoting of a small matrix stored column by column.
fn lu_in_place(n: usize, a: &mut [f64], rows: &mut [usize]) {
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
