//! Conversions from and to nalgebra (feature `nalgebra`) and sprs (feature `sprs`).

#[cfg(feature = "nalgebra")]
mod nalgebra {
    use crate::{Covariance, Dense, Diagonal, Ensemble, Error, Localization};
    use nalgebra::{DMatrix, DVector};

    impl TryFrom<&DMatrix<f64>> for Dense {
        type Error = Error;

        /// As [`Dense::new`].
        fn try_from(matrix: &DMatrix<f64>) -> Result<Self, Error> {
            Dense::new(matrix.nrows(), square(matrix)?)
        }
    }

    impl TryFrom<&DVector<f64>> for Diagonal {
        type Error = Error;

        /// As [`Diagonal::new`], from standard deviations.
        fn try_from(sigma: &DVector<f64>) -> Result<Self, Error> {
            Diagonal::new(sigma.as_slice().to_vec())
        }
    }

    impl Ensemble {
        /// As [`Ensemble::new`], from a matrix whose columns are the members (feature `nalgebra`).
        ///
        /// # Errors
        ///
        /// As [`Ensemble::new`].
        pub fn from_columns(members: &DMatrix<f64>, localization: Localization) -> Result<Self, Error> {
            Self::new(members.as_slice(), localization)
        }
    }

    /// The matrix of a covariance, by `dim` products (feature `nalgebra`).
    ///
    /// ```
    /// use nalgebra::DMatrix;
    /// use varda_covariance::{Dense, to_dmatrix};
    ///
    /// let given = DMatrix::from_row_slice(2, 2, &[4.0, 2.0, 2.0, 5.0]);
    /// assert_eq!(to_dmatrix(&Dense::try_from(&given)?), given);
    /// # Ok::<(), varda_covariance::Error>(())
    /// ```
    pub fn to_dmatrix(covariance: &(impl Covariance + ?Sized)) -> DMatrix<f64> {
        let n = covariance.dim();
        let mut matrix = DMatrix::zeros(n, n);
        let mut unit = vec![0.0; n];
        for (j, mut column) in matrix.column_iter_mut().enumerate() {
            unit[j] = 1.0;
            covariance.apply(&unit, column.as_mut_slice());
            unit[j] = 0.0;
        }
        matrix
    }

    fn square(matrix: &DMatrix<f64>) -> Result<&[f64], Error> {
        let (rows, columns) = matrix.shape();
        if rows == columns {
            Ok(matrix.as_slice())
        } else {
            Err(Error::Size { what: "a row of the covariance", expected: rows, found: columns })
        }
    }
}

#[cfg(feature = "nalgebra")]
pub use self::nalgebra::to_dmatrix;

#[cfg(feature = "sprs")]
mod sprs {
    use crate::{Error, SparsePrecision};
    use sprs::CsMat;
    use varda_linalg::Structure;
    use varda_linalg::sparse::Ordering;

    impl SparsePrecision {
        /// From a symmetric positive definite precision matrix P of which both triangles are stored (feature
        /// `sprs`).
        ///
        /// ```
        /// use sprs::TriMat;
        /// use varda_covariance::{Covariance, Ordering, SparsePrecision};
        ///
        /// let mut p = TriMat::new((2, 2));
        /// for (i, j, value) in [(0, 0, 2.0), (0, 1, -1.0), (1, 0, -1.0), (1, 1, 2.0)] {
        ///     p.add_triplet(i, j, value);
        /// }
        /// let b = SparsePrecision::from_csmat(&p.to_csc(), Ordering::MinimumDegree)?;
        /// let mut column = [0.0; 2];
        /// b.apply(&[3.0, 0.0], &mut column);
        /// assert!((column[0] - 2.0).abs() < 1e-15 && (column[1] - 1.0).abs() < 1e-15);
        /// # Ok::<(), varda_covariance::Error>(())
        /// ```
        ///
        /// # Errors
        ///
        /// As [`SparsePrecision::new`].
        pub fn from_csmat(precision: &CsMat<f64>, ordering: Ordering) -> Result<Self, Error> {
            let structure = Structure::from_csmat(precision)?;
            let values = structure.values_from_csmat(precision)?;
            Self::new(precision.rows(), structure, values, ordering)
        }
    }
}
