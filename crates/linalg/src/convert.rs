//! Conversions from and to nalgebra (feature `nalgebra`) and sprs (feature `sprs`).

#[cfg(feature = "nalgebra")]
mod nalgebra {
    use crate::dense::Matrix;
    use nalgebra::{DMatrix, DVector};

    impl From<DMatrix<f64>> for Matrix {
        fn from(matrix: DMatrix<f64>) -> Self {
            let (rows, columns) = matrix.shape();
            Matrix::from_columns(rows, columns, matrix.data.into())
        }
    }

    impl From<&DMatrix<f64>> for Matrix {
        fn from(matrix: &DMatrix<f64>) -> Self {
            Matrix::from_columns(matrix.nrows(), matrix.ncols(), matrix.as_slice().to_vec())
        }
    }

    impl From<DVector<f64>> for Matrix {
        fn from(vector: DVector<f64>) -> Self {
            Matrix::from_columns(vector.len(), 1, vector.data.into())
        }
    }

    impl From<Matrix> for DMatrix<f64> {
        fn from(matrix: Matrix) -> Self {
            DMatrix::from_vec(matrix.rows(), matrix.columns(), matrix.into_columns())
        }
    }
}

#[cfg(feature = "sprs")]
mod sprs {
    use crate::{Error, Structure};
    use sprs::CsMat;

    impl Structure {
        /// The pattern of a square sparse matrix, stored by columns or by rows (feature `sprs`).
        ///
        /// # Errors
        /// [`Error::Pattern`] if it is not square.
        pub fn from_csmat<N>(matrix: &CsMat<N>) -> Result<Self, Error> {
            let (n, columns) = matrix.shape();
            if n != columns {
                return Err(Error::Pattern { n, what: "a number of columns other than n", found: columns });
            }
            let outer = matrix.indptr();
            let inner = matrix.indices();
            let pairs = (0..n).flat_map(|o| outer.outer_inds_sz(o).map(move |p| (inner[p], o)));
            match matrix.is_csc() {
                true => Structure::from_pairs(n, pairs),
                false => Structure::from_pairs(n, pairs.map(|(i, j)| (j, i))),
            }
        }

        /// The values of a sparse matrix in this layout, zero where it has no entry (feature `sprs`).
        ///
        /// # Errors
        /// [`Error::Pattern`] for a matrix that is not square, or an entry outside the structure;
        /// [`Error::NotSymmetric`] for a symmetric band.
        pub fn values_from_csmat(&self, matrix: &CsMat<f64>) -> Result<Vec<f64>, Error> {
            let (n, columns) = matrix.shape();
            if n != columns {
                return Err(Error::Pattern { n, what: "a number of columns other than n", found: columns });
            }
            self.check(n)?;
            let mut values = vec![0.0; self.values_len(n)];
            for (&value, (i, j)) in matrix {
                let Some(place) = self.position(n, i, j) else {
                    return Err(Error::Pattern {
                        n,
                        what: "an entry outside the structure, in row",
                        found: i,
                    });
                };
                if matches!(self, Structure::SymmetricBand { .. }) {
                    let mirror = matrix.get(j, i).copied().unwrap_or(0.0);
                    if mirror != value {
                        return Err(Error::NotSymmetric { row: i, column: j, value, mirror });
                    }
                }
                values[place] = value;
            }
            Ok(values)
        }
    }
}
