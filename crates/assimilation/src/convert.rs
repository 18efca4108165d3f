//! Conversions from and to nalgebra (feature `nalgebra`) and sprs (feature `sprs`).

#[cfg(feature = "nalgebra")]
mod nalgebra {
    use crate::Blue;
    use nalgebra::{DMatrix, DVector};

    impl Blue {
        /// v_a (feature `nalgebra`).
        pub fn control_dvector(&self) -> DVector<f64> {
            DVector::from_column_slice(&self.control_variable)
        }

        /// K, n × m (feature `nalgebra`).
        pub fn gain_dmatrix(&self) -> DMatrix<f64> {
            let n = self.control_variable.len();
            DMatrix::from_column_slice(n, self.gain.len() / n.max(1), &self.gain)
        }

        /// P_v, n × n (feature `nalgebra`).
        pub fn covariance_dmatrix(&self) -> DMatrix<f64> {
            let n = self.control_variable.len();
            DMatrix::from_column_slice(n, n, &self.covariance)
        }
    }
}

#[cfg(feature = "sprs")]
mod sprs {
    use crate::{Error, LinearObservation};
    use sprs::CsMat;

    impl LinearObservation {
        /// From a sparse matrix H, a row for every value and a column for every component of the state
        /// (feature `sprs`).
        ///
        /// ```
        /// use sprs::TriMat;
        /// use varda_assimilation::LinearObservation;
        ///
        /// // the mean of the first two components, and the third
        /// let mut h = TriMat::new((2, 3));
        /// for (i, j, value) in [(0, 0, 0.5), (0, 1, 0.5), (1, 2, 1.0)] {
        ///     h.add_triplet(i, j, value);
        /// }
        /// let h = LinearObservation::from_csmat(&h.to_csr::<usize>())?;
        /// # Ok::<(), varda_assimilation::Error>(())
        /// ```
        ///
        /// # Errors
        /// A value that is not finite.
        pub fn from_csmat(h: &CsMat<f64>) -> Result<Self, Error> {
            let entries: Vec<(usize, usize, f64)> = h.iter().map(|(value, (i, j))| (i, j, *value)).collect();
            Self::new(h.rows(), h.cols(), &entries)
        }
    }
}
