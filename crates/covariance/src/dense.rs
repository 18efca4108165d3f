//! A dense covariance of full rank, with its Cholesky root; a dense covariance of truncated rank.

use crate::cholesky::{Cholesky, add_scaled, dot};
#[cfg(feature = "eigen")]
use crate::diagnostics::Spectrum;
use crate::error::Error;
use crate::operator::{Covariance, Precision, check_lengths};

/// A dense covariance of full rank, kept as its lower Cholesky factor: B = L Lᵀ, B^{1/2} = L.
///
/// n²/2 multiplications for `root`, `root_transpose` and `whiten`, n² for `apply` and `solve`.
#[derive(Debug, Clone)]
pub struct Dense {
    factor: Cholesky,
}

/// A dense covariance B = U Uᵀ of rank r ≤ n: U is n × r. No inverse; a draw from it lies in the span of U.
///
/// The way to a root of a singular covariance, such as a smooth kernel without a taper.
#[derive(Debug, Clone)]
pub struct Truncated {
    n: usize,
    /// U column by column.
    columns: Vec<f64>,
    explained: f64,
}

impl Dense {
    /// From a symmetric positive definite n × n matrix, row by row.
    ///
    /// # Errors
    ///
    /// [`Error::Size`], [`Error::NonFinite`], [`Error::NotSymmetric`] for what is not such a matrix,
    /// [`Error::Singular`] if it has no usable Cholesky root, [`Error::NotPositiveDefinite`] if it is no covariance.
    pub fn new(n: usize, matrix: &[f64]) -> Result<Self, Error> {
        check_matrix(n, matrix)?;
        Ok(Self { factor: Cholesky::new(n, matrix)? })
    }
}

impl Covariance for Dense {
    fn dim(&self) -> usize {
        self.factor.dim()
    }

    fn root_dim(&self) -> usize {
        self.factor.dim()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.dim(), y, self.dim());
        self.factor.apply(x, y);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.dim(), x, self.dim());
        self.factor.product(v, x);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.dim());
        self.factor.transpose_product(x, v);
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.dim(), "length of the variance");
        for (i, variance) in variance.iter_mut().enumerate() {
            let row = self.factor.row(i);
            *variance = dot(row, row);
        }
    }
}

impl Precision for Dense {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.dim(), y, self.dim());
        self.factor.solve(x, y);
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.dim());
        self.factor.forward(x, v);
    }
}

impl Truncated {
    /// The root of a pivoted Cholesky factorization stopped at the rank where no variance left exceeds τ times the
    /// largest variance, τ = max(`tolerance`, n ε) (Higham 2002, section 10.3): |B − U Uᵀ|_ij ≤ τ max b_ii. Costs n r²
    /// against some 10 n³ of `eigen`. The same τ asks for more here, and keeps a higher rank: it is relative
    /// to a variance at one point, where that of `eigen` is relative to λ₁, up to n times as large.
    ///
    /// # Errors
    ///
    /// As `eigen`, where a remaining variance below −τ max b_ii takes the place of the eigenvalue. A
    /// matrix that is indefinite without showing it on the diagonal is not found out: use `eigen` on data of doubtful origin.
    pub fn pivoted_cholesky(n: usize, matrix: &[f64], tolerance: f64) -> Result<Self, Error> {
        check_matrix(n, matrix)?;
        let tolerance = usable_tolerance(n, tolerance)?;
        let mut left: Vec<f64> = (0..n).map(|i| matrix[i * n + i]).collect();
        let largest = left.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
        let mut columns: Vec<f64> = Vec::new();
        loop {
            let smallest = left.iter().fold(f64::INFINITY, |a, &b| a.min(b));
            if smallest < -tolerance * largest.abs() {
                return Err(Error::NotPositiveSemidefinite { value: smallest, largest });
            }
            if largest <= 0.0 {
                return Err(Error::Zero);
            }
            let pivot = (1..n).fold(0, |best, i| if left[i] > left[best] { i } else { best });
            if columns.len() == n * n || left[pivot] <= tolerance * largest {
                return Ok(Self::from_columns(n, columns, matrix));
            }
            let root = left[pivot].sqrt();
            let mut column: Vec<f64> = (0..n).map(|i| matrix[i * n + pivot]).collect();
            for earlier in columns.chunks_exact(n) {
                add_scaled(-earlier[pivot], earlier, &mut column);
            }
            for (left, entry) in left.iter_mut().zip(&mut column) {
                *entry /= root;
                *left -= *entry * *entry;
            }
            left[pivot] = 0.0;
            columns.extend(column);
        }
    }

    /// The part of the total variance that was kept: tr(U Uᵀ) / tr B, at most 1 up to rounding.
    pub fn explained_variance(&self) -> f64 {
        self.explained
    }

    pub(crate) fn from_columns(n: usize, columns: Vec<f64>, matrix: &[f64]) -> Self {
        let trace: f64 = (0..n).map(|i| matrix[i * n + i]).sum();
        let explained = dot(&columns, &columns) / trace;
        Self { n, columns, explained }
    }

    fn columns(&self) -> std::slice::ChunksExact<'_, f64> {
        self.columns.chunks_exact(self.n)
    }
}

impl Covariance for Truncated {
    fn dim(&self) -> usize {
        self.n
    }

    fn root_dim(&self) -> usize {
        self.columns.len() / self.n
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.n, y, self.n);
        y.fill(0.0);
        for column in self.columns() {
            add_scaled(dot(column, x), column, y);
        }
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.root_dim(), x, self.n);
        x.fill(0.0);
        for (v, column) in v.iter().zip(self.columns()) {
            add_scaled(*v, column, x);
        }
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.n, v, self.root_dim());
        for (v, column) in v.iter_mut().zip(self.columns()) {
            *v = dot(column, x);
        }
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.n, "length of the variance");
        variance.fill(0.0);
        for column in self.columns() {
            for (variance, u) in variance.iter_mut().zip(column) {
                *variance += u * u;
            }
        }
    }

    /// The eigenvalues of the r × r matrix Uᵀ U, and n − r zeros.
    #[cfg(feature = "eigen")]
    fn spectrum(&self) -> Result<Spectrum, Error> {
        let rank = self.root_dim();
        let column = |k: usize| &self.columns[k * self.n..][..self.n];
        let gram: Vec<f64> = (0..rank * rank).map(|ij| dot(column(ij / rank), column(ij % rank))).collect();
        let mut eigenvalues = crate::eigen::values_descending(rank, &gram)?;
        eigenvalues.resize(self.n, 0.0);
        Ok(Spectrum { eigenvalues })
    }
}

/// Size, finiteness and symmetry of a matrix that a user gave.
pub(crate) fn check_matrix(n: usize, matrix: &[f64]) -> Result<(), Error> {
    if n == 0 {
        return Err(Error::Size { what: "the covariance", expected: 1, found: 0 });
    }
    if matrix.len() != n * n {
        return Err(Error::Size { what: "the covariance", expected: n * n, found: matrix.len() });
    }
    if let Some(at) = matrix.iter().position(|value| !value.is_finite()) {
        return Err(Error::NonFinite { row: at / n, column: at % n, value: matrix[at] });
    }
    for row in 0..n {
        for column in 0..row {
            let (value, mirror) = (matrix[row * n + column], matrix[column * n + row]);
            // Products of matrices leave some n ε between the two halves.
            let scale = (matrix[row * n + row].abs() * matrix[column * n + column].abs()).sqrt();
            if !((value - mirror).abs() <= 1e-12 * scale) {
                return Err(Error::NotSymmetric { row, column, value, mirror });
            }
        }
    }
    Ok(())
}

/// max(tolerance, n ε): below n ε of the largest, rounding decides.
pub(crate) fn usable_tolerance(n: usize, tolerance: f64) -> Result<f64, Error> {
    if !(0.0..1.0).contains(&tolerance) {
        return Err(Error::Parameter {
            what: "truncation tolerance",
            value: tolerance,
            range: "at least 0, below 1",
        });
    }
    Ok(tolerance.max(n as f64 * f64::EPSILON))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_2_by_2_by_hand() {
        // [[4, 2], [2, 5]] = L Lᵀ with L = [[2, 0], [1, 2]]: exact in floating point.
        let b = Dense::new(2, &[4.0, 2.0, 2.0, 5.0]).unwrap();
        let mut out = [0.0; 2];
        b.root(&[1.0, 1.0], &mut out);
        assert_eq!(out, [2.0, 3.0]);
        b.root_transpose(&[1.0, 1.0], &mut out);
        assert_eq!(out, [3.0, 2.0]);
        b.apply(&[1.0, -1.0], &mut out);
        assert_eq!(out, [2.0, -3.0]);
        b.solve(&[2.0, -3.0], &mut out);
        assert_eq!(out, [1.0, -1.0]);
        b.whiten(&[2.0, 3.0], &mut out);
        assert_eq!(out, [1.0, 1.0]);
        b.variance(&mut out);
        assert_eq!(out, [4.0, 5.0]);
    }

    #[test]
    fn bad_matrices_are_typed_errors() {
        let nan = f64::NAN;
        let new =
            |n: usize, matrix: &[f64]| (Dense::new(n, matrix).err(), Truncated::eigen(n, matrix, 0.0).err());
        let both = |n: usize, matrix: &[f64]| {
            let (dense, truncated) = new(n, matrix);
            assert_eq!(format!("{dense:?}"), format!("{truncated:?}"));
            dense.unwrap()
        };
        assert!(matches!(both(0, &[]), Error::Size { .. }));
        assert!(matches!(both(2, &[1.0, 0.0, 1.0]), Error::Size { expected: 4, found: 3, .. }));
        assert!(matches!(both(2, &[1.0, nan, nan, 1.0]), Error::NonFinite { row: 0, column: 1, .. }));
        assert!(matches!(both(2, &[1.0, 0.5, 0.4, 1.0]), Error::NotSymmetric { row: 1, column: 0, .. }));

        let (dense, truncated) = new(2, &[1.0, 2.0, 2.0, 1.0]);
        assert_eq!(dense, Some(Error::NotPositiveDefinite { pivot: 1, value: -3.0, variance: 1.0 }));
        assert!(
            matches!(truncated, Some(Error::NotPositiveSemidefinite { value, .. }) if (value + 1.0).abs() < 1e-14)
        );
        let pivoted = Truncated::pivoted_cholesky(2, &[1.0, 2.0, 2.0, 1.0], 0.0).err();
        assert_eq!(pivoted, Some(Error::NotPositiveSemidefinite { value: -3.0, largest: 1.0 }));

        let (dense, truncated) = new(2, &[0.0; 4]);
        assert!(matches!(dense, Some(Error::Singular { pivot: 0, .. })));
        assert_eq!(truncated, Some(Error::Zero));
        assert_eq!(Truncated::pivoted_cholesky(2, &[0.0; 4], 0.0).err(), Some(Error::Zero));
        assert!(matches!(Truncated::eigen(1, &[1.0], nan), Err(Error::Parameter { .. })));
        assert!(matches!(Truncated::eigen(1, &[1.0], 1.0), Err(Error::Parameter { .. })));
    }

    #[test]
    fn truncation_keeps_what_exceeds_the_tolerance() {
        // diag(4, 1, 0.01): at 0.1 two eigenvalues stay, 5 of a trace of 5.01.
        let matrix = [1.0, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 4.0];
        for b in [
            Truncated::eigen(3, &matrix, 0.1).unwrap(),
            Truncated::pivoted_cholesky(3, &matrix, 0.1).unwrap(),
        ] {
            assert_eq!((b.dim(), b.root_dim()), (3, 2));
            assert!((b.explained_variance() - 5.0 / 5.01).abs() < 1e-15);
            let mut variance = [9.0; 3];
            b.variance(&mut variance);
            assert_eq!(variance, [1.0, 0.0, 4.0]);
            assert_eq!(b.spectrum().unwrap().eigenvalues, [4.0, 1.0, 0.0]);
            // Descending: the first column carries the variance 4.
            let mut x = [9.0; 3];
            b.root(&[1.0, 0.0], &mut x);
            assert_eq!(x.map(f64::abs), [0.0, 0.0, 2.0]);
        }
    }

    #[test]
    #[should_panic(expected = "length of the input vector")]
    fn wrong_length_panics() {
        Dense::new(1, &[1.0]).unwrap().root(&[1.0, 2.0], &mut [0.0]);
    }
}
