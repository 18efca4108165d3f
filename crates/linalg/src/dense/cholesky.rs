//! A = L Lᵀ.

use crate::interrupt::{apart, parts};
use crate::vector::{axpy, dot_in_lanes};
use crate::{Error, clear_upper_registers};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::{Mat, MatMut, MatRef, Par};

/// The lower Cholesky factor of a dense symmetric positive definite matrix, A = L Lᵀ.
///
/// n³/3 operations in blocks, n² numbers. Products and solves with one vector take n² multiplications and
/// allocate nothing.
///
/// ```
/// use varda_linalg::dense::Cholesky;
///
/// // [[4, 2], [2, 5]] = L Lᵀ with L = [[2, 0], [1, 2]]
/// let factor = Cholesky::new(2, &[4.0, 2.0, 2.0, 5.0])?;
/// let mut x = [2.0, -3.0];
/// factor.solve(&mut x);
/// assert_eq!(x, [1.0, -1.0]);
/// # Ok::<(), varda_linalg::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Cholesky {
    l: Mat<f64>,
}

impl Cholesky {
    /// Factorizes the lower triangle of an n × n matrix given column by column (the upper one if it is given
    /// row by row). Any positive pivot will do: right for I + GᵀG, whose rounding is below its smallest
    /// eigenvalue.
    ///
    /// # Errors
    /// [`Error::NonFinite`] for an entry of the triangle or, in a matrix of huge entries, of the factor;
    /// [`Error::NotPositiveDefinite`] or [`Error::Singular`] for a pivot that is not positive;
    /// [`Error::Interrupted`] where it was asked to end.
    ///
    /// # Panics
    /// If `matrix` is not of length n².
    pub fn new(n: usize, matrix: &[f64]) -> Result<Self, Error> {
        assert_eq!(matrix.len(), n * n, "a {n} × {n} matrix");
        apart(n, matrix, move |matrix| Self::of(n, matrix))
    }

    fn of(n: usize, matrix: &[f64]) -> Result<Self, Error> {
        for j in 0..n {
            if let Some(i) = (j..n).find(|&i| !matrix[i + j * n].is_finite()) {
                return Err(Error::NonFinite { row: i, column: j, value: matrix[i + j * n] });
            }
        }
        let l = match factor(n, n, matrix) {
            Ok(l) => l,
            Err(pivot) => return Err(failure(n, matrix, pivot)),
        };
        for j in 0..n {
            if let Some(i) = (j..n).find(|&i| !l[(i, j)].is_finite()) {
                return Err(Error::NonFinite { row: i, column: j, value: l[(i, j)] });
            }
        }
        Ok(Self { l })
    }

    /// As [`new`](Self::new), but a pivot within n ε of its diagonal entry is an error too: rounding alone
    /// can make it (Higham 2002, theorem 10.3).
    ///
    /// # Errors
    /// As for [`new`](Self::new).
    ///
    /// # Panics
    /// As for [`new`](Self::new).
    pub fn well_determined(n: usize, matrix: &[f64]) -> Result<Self, Error> {
        let check = |l: &Mat<f64>, upto: usize| {
            (0..upto).try_for_each(|i| Error::check_pivot(n, i, l[(i, i)] * l[(i, i)], matrix[i * (n + 1)]))
        };
        let made = Self::new(n, matrix);
        match &made {
            Ok(Self { l }) => check(l, n)?,
            Err(Error::NotPositiveDefinite { pivot, .. } | Error::Singular { pivot, .. }) => {
                if let Ok(l) = factor(n, *pivot, matrix) {
                    check(&l, *pivot)?;
                }
            }
            Err(_) => {}
        }
        made
    }

    /// n.
    pub fn dim(&self) -> usize {
        self.l.nrows()
    }

    /// Column j of L from its diagonal entry down.
    ///
    /// # Panics
    /// If j ≥ n.
    pub fn column(&self, j: usize) -> &[f64] {
        let column = self.l.col(j).try_as_col_major().expect("columns are contiguous");
        &column.as_slice()[j..]
    }

    /// x = L v.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn product(&self, v: &[f64], x: &mut [f64]) {
        self.check(v.len(), x.len());
        x.fill(0.0);
        for (j, v) in v.iter().enumerate() {
            axpy(*v, self.column(j), &mut x[j..]);
        }
    }

    /// v = Lᵀ x.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn transpose_product(&self, x: &[f64], v: &mut [f64]) {
        self.check(x.len(), v.len());
        for (j, v) in v.iter_mut().enumerate() {
            *v = dot_in_lanes(self.column(j), &x[j..]);
        }
    }

    /// y = L Lᵀ x.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.transpose_product(x, y);
        for j in (0..self.dim()).rev() {
            let column = self.column(j);
            let v = y[j];
            y[j] = column[0] * v;
            axpy(v, &column[1..], &mut y[j + 1..]);
        }
    }

    /// x ← L⁻¹ x.
    ///
    /// # Panics
    /// If `x` is not of length n.
    pub fn forward(&self, x: &mut [f64]) {
        self.check(x.len(), self.dim());
        for j in 0..self.dim() {
            let column = self.column(j);
            x[j] /= column[0];
            let v = x[j];
            axpy(-v, &column[1..], &mut x[j + 1..]);
        }
    }

    /// x ← L⁻ᵀ x.
    ///
    /// # Panics
    /// If `x` is not of length n.
    pub fn backward(&self, x: &mut [f64]) {
        self.check(x.len(), self.dim());
        for j in (0..self.dim()).rev() {
            let column = self.column(j);
            x[j] = (x[j] - dot_in_lanes(&column[1..], &x[j + 1..])) / column[0];
        }
    }

    /// x ← A⁻¹ x.
    ///
    /// # Panics
    /// If `x` is not of length n.
    pub fn solve(&self, x: &mut [f64]) {
        self.forward(x);
        self.backward(x);
    }

    /// X ← A⁻¹ X for n × k values, column by column: blocked.
    ///
    /// # Panics
    /// If the length of `x` is not a multiple of n.
    pub fn solve_columns(&self, x: &mut [f64]) {
        let n = self.dim();
        if n == 0 || x.is_empty() {
            assert!(x.is_empty(), "columns of no rows");
            return;
        }
        assert!(x.len().is_multiple_of(n), "columns of {n} values");
        let columns = x.len() / n;
        let mut x = MatMut::from_column_major_slice_mut(x, n, columns);
        let mut scratch = MemBuffer::new(llt::solve::solve_in_place_scratch::<f64>(n, columns, Par::Seq));
        for (from, count) in parts(n * n, columns) {
            let part = x.as_mut().subcols_mut(from, count);
            llt::solve::solve_in_place(self.l.as_ref(), part, Par::Seq, MemStack::new(&mut scratch));
        }
        clear_upper_registers();
    }

    fn check(&self, a: usize, b: usize) {
        assert!(a == self.dim() && b == self.dim(), "vectors of {} values", self.dim());
    }
}

/// L of the leading `size` rows and columns, zero above the diagonal; the index of a pivot that is not
/// positive.
fn factor(n: usize, size: usize, matrix: &[f64]) -> Result<Mat<f64>, usize> {
    let mut l = Mat::zeros(size, size);
    let a = MatRef::from_column_major_slice(matrix, n, n);
    l.copy_from_triangular_lower(a.submatrix(0, 0, size, size));
    let scratch = llt::factor::cholesky_in_place_scratch::<f64>(size, Par::Seq, Default::default());
    let mut scratch = MemBuffer::new(scratch);
    let made = llt::factor::cholesky_in_place(
        l.as_mut(),
        Default::default(),
        Par::Seq,
        MemStack::new(&mut scratch),
        Default::default(),
    );
    clear_upper_registers();
    match made {
        Ok(_) => {
            (0..size).for_each(|j| (0..j).for_each(|i| l[(i, j)] = 0.0));
            Ok(l)
        }
        Err(llt::factor::LltError::NonPositivePivot { index }) => Err(index),
    }
}

/// The pivot at which a factorization stopped, from the factor of the rows before it.
fn failure(n: usize, matrix: &[f64], pivot: usize) -> Error {
    let diagonal = matrix[pivot * (n + 1)];
    let mut value = f64::NAN;
    if let Ok(l) = factor(n, pivot, matrix) {
        let mut row: Vec<f64> = (0..pivot).map(|j| matrix[pivot + j * n]).collect();
        let before = Cholesky { l };
        before.forward(&mut row);
        value = diagonal - dot_in_lanes(&row, &row);
    }
    match Error::check_pivot(n, pivot, value, diagonal) {
        Err(error) => error,
        // positive by this sum, not by the other
        Ok(()) => Error::Singular { pivot, value, diagonal, tolerance: value },
    }
}
