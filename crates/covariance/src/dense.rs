//! A dense covariance of full rank, with its Cholesky root.

use crate::error::Error;
use crate::input::{check_lengths, check_matrix};
use crate::operator::{Covariance, Precision};
use varda_linalg::dense::Cholesky;

/// A dense covariance of full rank, kept as its lower Cholesky factor: B = L Lᵀ, B^{1/2} = L.
///
/// n²/2 multiplications for `root`, `root_transpose` and `whiten`, n² for `apply` and `solve`.
///
/// ```
/// use varda_covariance::{Covariance, Dense};
///
/// // [[4, 2], [2, 5]] = L Lᵀ with L = [[2, 0], [1, 2]]
/// let b = Dense::new(2, &[4.0, 2.0, 2.0, 5.0])?;
/// let mut x = [0.0; 2];
/// b.root(&[1.0, 1.0], &mut x);
/// assert_eq!(x, [2.0, 3.0]);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Dense {
    factor: Cholesky,
}

impl Dense {
    /// From a symmetric positive definite n × n matrix, row by row.
    ///
    /// # Errors
    ///
    /// [`Error::Size`], [`Error::NonFinite`], [`Error::NotSymmetric`] for what is not such a matrix,
    /// [`Error::Singular`] if it has no usable Cholesky root, [`Error::NotPositiveDefinite`] if it is no
    /// covariance.
    pub fn new(n: usize, matrix: &[f64]) -> Result<Self, Error> {
        check_matrix(n, matrix)?;
        Ok(Self { factor: Cholesky::well_determined(n, matrix)? })
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
        variance.fill(0.0);
        for j in 0..self.dim() {
            for (variance, l) in variance[j..].iter_mut().zip(self.factor.column(j)) {
                *variance += l * l;
            }
        }
    }
}

impl Precision for Dense {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.dim(), y, self.dim());
        y.copy_from_slice(x);
        self.factor.solve(y);
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.dim());
        v.copy_from_slice(x);
        self.factor.forward(v);
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.dim(), x, self.dim());
        x.copy_from_slice(v);
        self.factor.backward(x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Truncated;

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
        b.whiten_transpose(&[3.0, 2.0], &mut out);
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
        assert!(matches!(truncated, Some(Error::NotPositiveSemidefinite { value, .. })
                if (value + 1.0).abs() < 1e-14));
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
