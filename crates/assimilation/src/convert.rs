//! Conversions from and to nalgebra (feature `nalgebra`) and sprs (feature `sprs`).

#[cfg(feature = "nalgebra")]
mod nalgebra {
    use crate::{
        Blue, ControlTransform, Error, Gain, LinearObservation, Observation, ObservationSet, StrongConstraint,
    };
    use nalgebra::{DMatrix, DVector};
    use std::sync::Arc;
    use varda_covariance::{Covariance, Dense};

    impl<'a> ControlTransform<'a> {
        /// As [`ControlTransform::new`], around a vector of nalgebra (feature `nalgebra`).
        ///
        /// ```
        /// use nalgebra::{DMatrix, DVector};
        /// use varda_assimilation::ControlTransform;
        /// use varda_covariance::Dense;
        ///
        /// let b = Dense::try_from(&DMatrix::from_row_slice(2, 2, &[4.0, 0.0, 0.0, 1.0]))?;
        /// let transform = ControlTransform::from_dvector(&DVector::from_vec(vec![1.0, 2.0]), &b)?;
        /// let v = DVector::from_vec(vec![0.5, -1.0]);
        /// assert_eq!(transform.control_dvector(&v).as_slice(), [2.0, 1.0]);
        /// assert_eq!(transform.increment_dvector(&v).as_slice(), [1.0, -1.0]);
        /// # Ok::<(), Box<dyn std::error::Error>>(())
        /// ```
        ///
        /// # Errors
        /// As for [`ControlTransform::new`].
        pub fn from_dvector(
            background: &DVector<f64>,
            covariance: &'a dyn Covariance,
        ) -> Result<Self, Error> {
            Self::new(background.as_slice().to_vec(), covariance)
        }

        /// z = z_b + U v (feature `nalgebra`).
        ///
        /// # Panics
        /// If v is not of length `dim`.
        pub fn control_dvector(&self, v: &DVector<f64>) -> DVector<f64> {
            let mut z = DVector::zeros(self.control_dim());
            self.control(v.as_slice(), z.as_mut_slice());
            z
        }

        /// dz = U dv (feature `nalgebra`).
        ///
        /// # Panics
        /// If dv is not of length `dim`.
        pub fn increment_dvector(&self, dv: &DVector<f64>) -> DVector<f64> {
            let mut dz = DVector::zeros(self.control_dim());
            self.tangent(dv.as_slice(), dz.as_mut_slice());
            dz
        }
    }

    impl Blue {
        /// The estimate from matrices (feature `nalgebra`): x ~ N(x_b, B) by its transform, y = H x + ε with
        /// ε ~ N(0, R), H of m × n, R of m × m.
        ///
        /// ```
        /// use nalgebra::{DMatrix, DVector};
        /// use varda_assimilation::{Blue, ControlTransform, Gain};
        /// use varda_covariance::Dense;
        ///
        /// // one of two components, as uncertain as its background
        /// let b = Dense::try_from(&DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.5, 1.0]))?;
        /// let transform = ControlTransform::from_dvector(&DVector::zeros(2), &b)?;
        /// let h = DMatrix::from_row_slice(1, 2, &[1.0, 0.0]);
        /// let (r, y) = (DMatrix::identity(1, 1), DVector::from_vec(vec![2.0]));
        /// let blue = Blue::from_dmatrix(&transform, &h, &r, &y, Gain::Observation)?;
        /// assert!((blue.analysis_dvector(&transform) - DVector::from_vec(vec![1.0, 0.5])).norm() < 1e-14);
        /// let p = blue.control_covariance_dmatrix(&transform);
        /// assert!((p - DMatrix::from_row_slice(2, 2, &[0.5, 0.25, 0.25, 0.875])).norm() < 1e-14);
        /// # Ok::<(), Box<dyn std::error::Error>>(())
        /// ```
        ///
        /// # Errors
        /// Sizes that disagree, values that are not finite, an R that is not symmetric and positive definite;
        /// as for [`Blue::new`].
        pub fn from_dmatrix(
            transform: &ControlTransform,
            h: &DMatrix<f64>,
            r: &DMatrix<f64>,
            y: &DVector<f64>,
            gain: Gain,
        ) -> Result<Self, Error> {
            let (m, n) = h.shape();
            if y.len() != m {
                return Err(Error::Length { what: "the observed vector", expected: m, found: y.len() });
            }
            let entries: Vec<(usize, usize, f64)> =
                (0..m).flat_map(|i| (0..n).map(move |j| (i, j, h[(i, j)]))).collect();
            let h = LinearObservation::new(m, n, &entries)?;
            let seen = Observation::new(0, (0..m).collect(), y.as_slice().to_vec(), 1.0)
                .correlated(Arc::new(Dense::try_from(r)?));
            let mut set = ObservationSet::new(0, vec![Box::new(h)], vec![seen])?;
            let mut cost = StrongConstraint::without_model(transform.clone(), &mut set)?;
            Self::new(&mut cost, &vec![0.0; transform.dim()], gain)
        }

        /// z_a = z_b + U v_a (feature `nalgebra`).
        ///
        /// # Panics
        /// If v is shorter than the transform's.
        pub fn analysis_dvector(&self, transform: &ControlTransform) -> DVector<f64> {
            DVector::from_vec(self.analysis(transform))
        }

        /// P_z = U P_v Uᵀ (feature `nalgebra`).
        ///
        /// # Panics
        /// If v is shorter than the transform's.
        pub fn control_covariance_dmatrix(&self, transform: &ControlTransform) -> DMatrix<f64> {
            let n = transform.control_dim();
            DMatrix::from_vec(n, n, self.control_covariance(transform))
        }

        /// v_a (feature `nalgebra`).
        pub fn control_dvector(&self) -> DVector<f64> {
            DVector::from_column_slice(&self.control_variable)
        }

        /// K in the control variable and whitened observations, n × m (feature `nalgebra`).
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
