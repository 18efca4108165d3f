//! One solver for every [`Structure`].

use crate::Structure;
use crate::band::{self, BLOCK, BadPivot};
use crate::dense::lu::LuWork;
use crate::sparse::{NumericLu, SparseLu};
use std::fmt;

/// Factors and solves matrices of one structure.
///
/// Band matrices go through [`crate::band`], dense ones through LU with partial pivoting (faer's from 32
/// unknowns on, a plain loop below), sparse ones through faer's sparse LU, whose symbolic part is computed
/// once. Nothing is allocated after the first factorization into a [`Factor`], except inside faer for a
/// sparse matrix, where the fill may grow with the pivots.
///
/// ```
/// use varda_linalg::{LinearSolver, Structure};
///
/// let structure = Structure::SymmetricBand { half_bandwidth: 1 };
/// let values = structure.values(3, |i, j| if i == j { 2.0 } else { -1.0 });
/// let mut solver = LinearSolver::new(3, &structure);
/// let mut factor = solver.empty_factor();
/// assert_eq!(solver.factor(&values, &mut factor)?, 0); // no negative eigenvalue
/// let mut x = [1.0, 0.0, 1.0];
/// solver.solve(&factor, &mut x);
/// assert!(x.iter().all(|x| (x - 1.0).abs() < 1e-15));
/// # Ok::<(), varda_linalg::BadPivot>(())
/// ```
pub struct LinearSolver {
    n: usize,
    structure: Structure,
    work: Work,
    shifted: Vec<f64>,
    column: Vec<f64>,
}

/// What a structure's factorizations need beside the values.
enum Work {
    SymmetricBand { w: usize },
    Band { w: usize },
    Dense(LuWork),
    Sparse(Box<SparseLu>),
}

/// The factor of one matrix; belongs to the [`LinearSolver`] that made it.
///
/// ```
/// use varda_linalg::{Factor, LinearSolver, Structure};
///
/// let mut solver = LinearSolver::new(2, &Structure::Dense);
/// let mut factors: Vec<Factor> = vec![solver.empty_factor(), solver.empty_factor()];
/// solver.factor(&[2.0, 0.0, 0.0, 4.0], &mut factors[0])?;
/// solver.factor(&[1.0, 0.0, 0.0, 8.0], &mut factors[1])?;
/// let mut x = [4.0, 8.0];
/// solver.solve(&factors[0], &mut x); // the first is still there
/// assert_eq!(x, [2.0, 2.0]);
/// # Ok::<(), varda_linalg::BadPivot>(())
/// ```
#[derive(Debug, Clone)]
pub struct Factor {
    values: Vec<f64>,
    /// Band: the row swapped with row k. Dense: the row of A that came to place k.
    pivots: Vec<usize>,
    sparse: NumericLu,
}

impl Factor {
    /// Heap memory held, in bytes, without what faer holds for a sparse matrix.
    pub fn bytes(&self) -> usize {
        size_of_val(self.values.as_slice()) + size_of_val(self.pivots.as_slice())
    }
}

impl LinearSolver {
    /// A solver for matrices of n rows and the given structure.
    ///
    /// # Panics
    /// If a sparse structure is not a pattern of n rows and columns.
    pub fn new(n: usize, structure: &Structure) -> Self {
        let work = match structure {
            Structure::SymmetricBand { half_bandwidth } => Work::SymmetricBand { w: *half_bandwidth },
            Structure::Band { half_bandwidth } => Work::Band { w: *half_bandwidth },
            Structure::Dense => Work::Dense(LuWork::new(n)),
            Structure::Sparse { columns, rows } => Work::Sparse(Box::new(SparseLu::new(n, columns, rows))),
        };
        let mut solver =
            Self { n, structure: structure.clone(), work, shifted: Vec::new(), column: vec![0.0; n] };
        solver.shifted = vec![0.0; solver.values_len()];
        solver
    }

    /// Number of values of a matrix of this structure.
    pub fn values_len(&self) -> usize {
        self.structure.values_len(self.n)
    }

    /// Room for a factor.
    pub fn empty_factor(&self) -> Factor {
        let (values, pivots) = match self.structure {
            Structure::Dense => (self.n * self.n, self.n),
            Structure::SymmetricBand { half_bandwidth } => (self.n * (half_bandwidth + 1), 0),
            Structure::Band { half_bandwidth } => (band::lu_len(self.n, half_bandwidth), self.n),
            Structure::Sparse { .. } => (0, 0),
        };
        Factor { values: vec![0.0; values], pivots: vec![0; pivots], sparse: NumericLu::new() }
    }

    /// Factors the matrix with these values. Returns the number of its negative eigenvalues for a symmetric
    /// band, 0 for the other structures, whose factors do not show it.
    ///
    /// # Errors
    /// [`BadPivot`] if the matrix is singular to rounding or not finite.
    ///
    /// # Panics
    /// If `values` has not [`values_len`](Self::values_len) values or `factor` is of another solver.
    pub fn factor(&mut self, values: &[f64], factor: &mut Factor) -> Result<usize, BadPivot> {
        match &mut self.work {
            Work::SymmetricBand { w } => {
                factor.values.copy_from_slice(values);
                return band::ldlt_factor(*w, &mut factor.values);
            }
            Work::Band { w } => band::lu_factor(*w, values, &mut factor.values, &mut factor.pivots)?,
            Work::Dense(work) => {
                factor.values.copy_from_slice(values);
                work.factor(values, &mut factor.values, &mut factor.pivots)?;
            }
            Work::Sparse(work) => work.factor(values, &mut factor.sparse)?,
        }
        Ok(0)
    }

    /// Factors the matrix with `shift` times |a_ii| added to every diagonal entry. Where that is less than
    /// 10⁻⁸ of the largest on the diagonal (a zero, say), the latter is taken.
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
        let Factor { values, pivots, sparse } = factor;
        match &mut self.work {
            Work::SymmetricBand { w } => band::ldlt_solve(*w, values, b),
            Work::Band { w } => band::lu_solve(*w, values, pivots, b),
            Work::Dense(work) => work.solve(values, pivots, b),
            Work::Sparse(work) => work.solve(sparse, b),
        }
    }

    /// b ← A⁻ᵀ b.
    ///
    /// # Panics
    /// If the length of `b` is not n.
    pub fn solve_transpose(&mut self, factor: &Factor, b: &mut [f64]) {
        let Factor { values, pivots, sparse } = factor;
        match &mut self.work {
            Work::SymmetricBand { w } => band::ldlt_solve(*w, values, b),
            Work::Band { w } => band::lu_solve_transpose(*w, values, pivots, b),
            Work::Dense(work) => work.solve_transpose(values, pivots, b),
            Work::Sparse(work) => work.solve_transpose(sparse, b),
        }
    }

    /// B ← A⁻¹ B for a block of right-hand sides, row by row: entry (i, c) in `b[i][c]`. A column's bits
    /// do not depend on the others.
    ///
    /// # Panics
    /// If B has not n rows.
    pub fn solve_block(&mut self, factor: &Factor, b: &mut [[f64; BLOCK]]) {
        match self.work {
            Work::SymmetricBand { w } => band::ldlt_solve_block(w, &factor.values, b),
            _ => self.each_column(b, &mut |solver, column| solver.solve(factor, column)),
        }
    }

    /// B ← A⁻ᵀ B, as `solve_block`.
    ///
    /// # Panics
    /// If B has not n rows.
    pub fn solve_transpose_block(&mut self, factor: &Factor, b: &mut [[f64; BLOCK]]) {
        match self.work {
            Work::SymmetricBand { w } => band::ldlt_solve_block(w, &factor.values, b),
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

    /// A direction z with zᵀ A z < 0, and that number, for a symmetric band with a negative pivot; `None`
    /// otherwise.
    ///
    /// # Panics
    /// If the length of `z` is not n.
    pub fn negative_curvature(&self, factor: &Factor, z: &mut [f64]) -> Option<f64> {
        match self.work {
            Work::SymmetricBand { w } => band::ldlt_negative_curvature(w, &factor.values, z),
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
}

impl fmt::Debug for LinearSolver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LinearSolver")
            .field("n", &self.n)
            .field("structure", &self.structure)
            .finish_non_exhaustive()
    }
}
