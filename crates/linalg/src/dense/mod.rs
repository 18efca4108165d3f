//! Dense matrices in slices, column by column: products, Cholesky and LU factorizations (blocked, faer's).

mod cholesky;
pub(crate) mod lu;

pub use cholesky::Cholesky;

use crate::clear_upper_registers;
use crate::interrupt::parts;
use faer::linalg::matmul::{matmul, triangular};
use faer::{Accum, MatMut, MatRef, Par};
use std::ops::{Index, IndexMut};

/// A matrix in a slice, column by column, read as it is or transposed.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    values: &'a [f64],
    rows: usize,
    columns: usize,
    transposed: bool,
}

impl<'a> View<'a> {
    /// The matrix of `rows` rows and `columns` columns with entry (i, j) in `values[i + j * rows]`.
    ///
    /// # Panics
    /// If `values` is not of length rows · columns.
    pub fn new(values: &'a [f64], rows: usize, columns: usize) -> Self {
        assert_eq!(values.len(), rows * columns, "a {rows} × {columns} matrix");
        Self { values, rows, columns, transposed: false }
    }

    /// The transpose, of the same values.
    pub fn transpose(self) -> Self {
        Self { transposed: !self.transposed, ..self }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        if self.transposed { self.columns } else { self.rows }
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        if self.transposed { self.rows } else { self.columns }
    }

    /// A copy that owns its values.
    pub fn to_matrix(self) -> Matrix {
        let (rows, columns) = (self.rows(), self.columns());
        let entry = |i: usize, j: usize| match self.transposed {
            true => self.values[j + i * columns],
            false => self.values[i + j * rows],
        };
        let values = (0..columns).flat_map(|j| (0..rows).map(move |i| entry(i, j))).collect();
        Matrix { rows, columns, values }
    }

    fn faer(&self) -> MatRef<'a, f64> {
        let matrix = MatRef::from_column_major_slice(self.values, self.rows, self.columns);
        if self.transposed { matrix.transpose() } else { matrix }
    }
}

/// A dense matrix that owns its values, kept column by column.
#[derive(Debug, Clone, PartialEq)]
pub struct Matrix {
    rows: usize,
    columns: usize,
    values: Vec<f64>,
}

impl Matrix {
    /// The zero matrix.
    pub fn zeros(rows: usize, columns: usize) -> Self {
        Self { rows, columns, values: vec![0.0; rows * columns] }
    }

    /// The n × n identity.
    pub fn identity(n: usize) -> Self {
        let mut identity = Self::zeros(n, n);
        (0..n).for_each(|i| identity[(i, i)] = 1.0);
        identity
    }

    /// From its values, column by column.
    ///
    /// # Panics
    /// If `values` is not of length rows · columns.
    pub fn from_columns(rows: usize, columns: usize, values: Vec<f64>) -> Self {
        assert_eq!(values.len(), rows * columns, "a {rows} × {columns} matrix");
        Self { rows, columns, values }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The values, column by column.
    pub fn into_columns(self) -> Vec<f64> {
        self.values
    }

    /// The values, column by column.
    pub fn as_slice(&self) -> &[f64] {
        &self.values
    }

    /// The values, column by column.
    pub fn as_mut_slice(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// As an operand of a product.
    pub fn view(&self) -> View<'_> {
        View::new(&self.values, self.rows, self.columns)
    }

    /// The transpose, as an operand of a product.
    pub fn transpose(&self) -> View<'_> {
        self.view().transpose()
    }

    fn check(&self, i: usize, j: usize) {
        let (rows, columns) = (self.rows, self.columns);
        assert!(i < rows && j < columns, "({i}, {j}) in a {rows} × {columns} matrix");
    }

    /// This matrix plus α A B.
    ///
    /// # Panics
    /// If the sizes do not fit.
    pub fn plus(mut self, alpha: f64, a: View, b: View) -> Self {
        assert!(a.rows() == self.rows && b.columns() == self.columns, "sizes of a product and its result");
        add_product(alpha, a, b, &mut self.values);
        self
    }
}

impl Index<(usize, usize)> for Matrix {
    type Output = f64;

    fn index(&self, (i, j): (usize, usize)) -> &f64 {
        self.check(i, j);
        &self.values[i + j * self.rows]
    }
}

impl IndexMut<(usize, usize)> for Matrix {
    fn index_mut(&mut self, (i, j): (usize, usize)) -> &mut f64 {
        self.check(i, j);
        &mut self.values[i + j * self.rows]
    }
}

/// C = A B, column by column.
///
/// ```
/// use varda_linalg::dense::{View, product};
///
/// let a = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]; // 3 × 2
/// let mut c = [0.0; 4];
/// product(View::new(&a, 3, 2).transpose(), View::new(&a, 3, 2), &mut c);
/// assert_eq!(c, [14.0, 32.0, 32.0, 77.0]);
/// ```
///
/// # Panics
/// If the sizes do not fit.
pub fn product(a: View, b: View, c: &mut [f64]) {
    accumulate(Accum::Replace, 1.0, a, b, c);
}

/// C ← C + α A B.
///
/// # Panics
/// If the sizes do not fit.
pub fn add_product(alpha: f64, a: View, b: View, c: &mut [f64]) {
    accumulate(Accum::Add, alpha, a, b, c);
}

/// The columns of C in parts, between which a long product can be left.
fn accumulate(how: Accum, alpha: f64, a: View, b: View, c: &mut [f64]) {
    let mut whole = result(a, b, c);
    for (from, count) in parts(a.rows() * a.columns(), b.columns()) {
        let part = whole.as_mut().subcols_mut(from, count);
        matmul(part, how, a.faer(), b.faer().subcols(from, count), alpha, Par::Seq);
    }
    clear_upper_registers();
}

/// The symmetric matrix C = A Aᵀ, n × n for A with n rows: half the work of [`product`].
///
/// ```
/// use varda_linalg::dense::{View, gram};
///
/// let a = [1.0, 3.0, 2.0, 4.0]; // [1 2; 3 4], column by column
/// let mut c = [0.0; 4];
/// gram(View::new(&a, 2, 2), &mut c);
/// assert_eq!(c, [5.0, 11.0, 11.0, 25.0]);
/// ```
///
/// # Panics
/// If `c` is not of length n².
pub fn gram(a: View, c: &mut [f64]) {
    let n = a.rows();
    let mut lower = result(a, a.transpose(), c);
    for (from, count) in parts(n * a.columns(), n) {
        let rows = a.faer().subrows(from, count);
        triangular::matmul(
            lower.as_mut().submatrix_mut(from, from, count, count),
            triangular::BlockStructure::TriangularLower,
            Accum::Replace,
            rows,
            triangular::BlockStructure::Rectangular,
            rows.transpose(),
            triangular::BlockStructure::Rectangular,
            1.0,
            Par::Seq,
        );
        let after = from + count;
        if after < n {
            let below = lower.as_mut().submatrix_mut(after, from, n - after, count);
            let (left, right) = (a.faer().subrows(after, n - after), rows.transpose());
            matmul(below, Accum::Replace, left, right, 1.0, Par::Seq);
        }
    }
    clear_upper_registers();
    for j in 0..n {
        for i in 0..j {
            c[i + j * n] = c[j + i * n];
        }
    }
}

fn result<'c>(a: View, b: View, c: &'c mut [f64]) -> MatMut<'c, f64> {
    assert!(
        a.columns() == b.rows() && c.len() == a.rows() * b.columns(),
        "the product of {} × {} and {} × {} into {} values",
        a.rows(),
        a.columns(),
        b.rows(),
        b.columns(),
        c.len()
    );
    MatMut::from_column_major_slice_mut(c, a.rows(), b.columns())
}
