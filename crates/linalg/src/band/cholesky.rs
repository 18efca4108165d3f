//! A = L Lᵀ for a band.

use crate::Error;
use crate::vector::{axpy, dot_in_lanes};

/// The lower Cholesky factor of a symmetric positive definite band matrix, A = L Lᵀ; L vanishes outside the
/// band too (Golub and Van Loan 2013, section 4.3).
///
/// n w² operations, n (w + 1) numbers; products and solves with one vector take 2 n w multiplications and
/// allocate nothing.
///
/// When to use: where the square root L is wanted. For solves alone [`ldlt_factor`](super::ldlt_factor) is
/// faster.
///
/// ```
/// use varda_linalg::band::Cholesky;
///
/// // [[4, 2], [2, 5]] = L Lᵀ with L = [[2, 0], [1, 2]]
/// let factor = Cholesky::new(1, vec![0.0, 4.0, 2.0, 5.0])?;
/// let mut x = [2.0, -3.0];
/// factor.solve(&mut x);
/// assert_eq!(x, [1.0, -1.0]);
/// # Ok::<(), varda_linalg::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Cholesky {
    n: usize,
    w: usize,
    /// Row i of L holds columns i − w … i; those left of column 0 are zero.
    l: Vec<f64>,
}

impl Cholesky {
    /// Factorizes a band in the layout of `Structure::SymmetricBand`, in place. Entries left of column 0 are
    /// not read.
    ///
    /// # Errors
    /// [`Error::NonFinite`] for an entry; [`Error::Singular`] or [`Error::NotPositiveDefinite`] for a pivot
    /// that is not above rounding of its diagonal entry.
    ///
    /// # Panics
    /// If the length of `band` is not a multiple of w + 1.
    pub fn new(half_bandwidth: usize, band: Vec<f64>) -> Result<Self, Error> {
        let (w, mut l) = (half_bandwidth, band);
        assert!(l.len().is_multiple_of(w + 1), "a band of half-bandwidth {w} needs rows of {} values", w + 1);
        let n = l.len() / (w + 1);
        for i in 0..n {
            let start = i.saturating_sub(w);
            let (above, row) = l.split_at_mut(i * (w + 1));
            // columns start … i of this row
            let outside = w - (i - start);
            row[..outside].fill(0.0);
            if let Some(at) = row[outside..=w].iter().position(|v| !v.is_finite()) {
                return Err(Error::NonFinite { row: i, column: start + at, value: row[outside + at] });
            }
            for j in start..i {
                // columns max(start, j − w) … j − 1, all of them from start on as j < i
                let pivot_row = &above[j * (w + 1)..(j + 1) * (w + 1)];
                let (length, shift) = (j - start, w - (j - start));
                let partial = dot_in_lanes(&row[outside..outside + length], &pivot_row[shift..w]);
                row[outside + length] = (row[outside + length] - partial) / pivot_row[w];
            }
            let diagonal = row[w];
            let value = diagonal - dot_in_lanes(&row[outside..w], &row[outside..w]);
            Error::check_pivot(w + 1, i, value, diagonal)?;
            row[w] = value.sqrt();
        }
        Ok(Self { n, w, l })
    }

    /// n.
    pub fn dim(&self) -> usize {
        self.n
    }

    /// w: entries further than this from the diagonal are zero.
    pub fn half_bandwidth(&self) -> usize {
        self.w
    }

    /// The first column of row i within the band, and the row from there to its diagonal.
    pub fn row(&self, i: usize) -> (usize, &[f64]) {
        let start = i.saturating_sub(self.w);
        let row = &self.l[i * (self.w + 1)..(i + 1) * (self.w + 1)];
        (start, &row[self.w - (i - start)..])
    }

    /// x = L v.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn product(&self, v: &[f64], x: &mut [f64]) {
        self.check(v.len(), x.len());
        for (i, x) in x.iter_mut().enumerate() {
            let (start, row) = self.row(i);
            *x = dot_in_lanes(row, &v[start..=i]);
        }
    }

    /// v = Lᵀ x.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn transpose_product(&self, x: &[f64], v: &mut [f64]) {
        self.check(x.len(), v.len());
        v.fill(0.0);
        for (i, x) in x.iter().enumerate() {
            let (start, row) = self.row(i);
            axpy(*x, row, &mut v[start..=i]);
        }
    }

    /// y = L Lᵀ x.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.transpose_product(x, y);
        for i in (0..self.n).rev() {
            let (start, row) = self.row(i);
            y[i] = dot_in_lanes(row, &y[start..=i]);
        }
    }

    /// x ← L⁻¹ x.
    ///
    /// # Panics
    /// If `x` is not of length n.
    pub fn forward(&self, x: &mut [f64]) {
        self.check(x.len(), self.n);
        for i in 0..self.n {
            let (start, row) = self.row(i);
            x[i] = (x[i] - dot_in_lanes(&row[..i - start], &x[start..i])) / row[i - start];
        }
    }

    /// x ← L⁻ᵀ x.
    ///
    /// # Panics
    /// If `x` is not of length n.
    pub fn backward(&self, x: &mut [f64]) {
        self.check(x.len(), self.n);
        for i in (0..self.n).rev() {
            let (start, row) = self.row(i);
            x[i] /= row[i - start];
            let x_i = x[i];
            axpy(-x_i, &row[..i - start], &mut x[start..i]);
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

    fn check(&self, a: usize, b: usize) {
        assert!(a == self.n && b == self.n, "vectors of {} values", self.n);
    }
}
