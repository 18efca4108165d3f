//! What asks for eigenvalues: the spectrum of a covariance, and the root of truncated rank by eigenvectors (feature `eigen`).

use faer::{MatRef, Side};

use crate::dense::{Truncated, check_matrix, usable_tolerance};
use crate::diagnostics::Spectrum;
use crate::error::Error;
use crate::operator::Covariance;

/// Asks for the feature `eigen`.
impl Truncated {
    /// The eigen root of a symmetric positive semidefinite n × n matrix given row by row: with eigenvalues λ₁ ≥ λ₂ ≥ …
    /// and eigenvectors e_k, column k of U is √λ_k e_k, for every λ_k > τ λ₁, τ = max(`tolerance`, n ε). The best
    /// approximation of its rank (Eckart and Young 1936): |B − U Uᵀ|₂ ≤ τ λ₁.
    ///
    /// # Errors
    ///
    /// [`Error::Parameter`] for a tolerance outside [0, 1); [`Error::Size`], [`Error::NonFinite`],
    /// [`Error::NotSymmetric`] for what is not such a matrix; [`Error::NotPositiveSemidefinite`] for an eigenvalue below
    /// −τ λ₁; [`Error::Zero`] for a zero matrix; [`Error::Eigen`] if the eigenvalue iteration fails.
    pub fn eigen(n: usize, matrix: &[f64], tolerance: f64) -> Result<Self, Error> {
        check_matrix(n, matrix)?;
        let tolerance = usable_tolerance(n, tolerance)?;
        let decomposition = MatRef::from_column_major_slice(matrix, n, n)
            .self_adjoint_eigen(Side::Lower)
            .map_err(|_| Error::Eigen { dim: n })?;
        let values = decomposition.S().column_vector();
        let vectors = decomposition.U();
        if !(0..n).all(|k| values[k].is_finite() && (0..n).all(|i| vectors[(i, k)].is_finite())) {
            return Err(Error::Eigen { dim: n });
        }

        // Ascending, as faer gives them.
        let (smallest, largest) = (values[0], values[n - 1]);
        if smallest < -tolerance * largest.abs() {
            return Err(Error::NotPositiveSemidefinite { value: smallest, largest });
        }
        if largest <= 0.0 {
            return Err(Error::Zero);
        }
        let mut columns = Vec::new();
        for k in (0..n).rev().take_while(|&k| values[k] > tolerance * largest) {
            let root = values[k].sqrt();
            columns.extend((0..n).map(|i| root * vectors[(i, k)]));
        }
        Ok(Self::from_columns(n, columns, matrix))
    }
}

/// The spectrum of B formed column by column through `apply`.
pub(crate) fn spectrum_by_products<C: Covariance + ?Sized>(covariance: &C) -> Result<Spectrum, Error> {
    let n = covariance.dim();
    let mut matrix = vec![0.0; n * n];
    let mut unit = vec![0.0; n];
    for (j, column) in matrix.chunks_exact_mut(n.max(1)).enumerate() {
        unit[j] = 1.0;
        covariance.apply(&unit, column);
        unit[j] = 0.0;
        if let Some(i) = column.iter().position(|value| !value.is_finite()) {
            return Err(Error::NonFinite { row: i, column: j, value: column[i] });
        }
    }
    Ok(Spectrum { eigenvalues: values_descending(n, &matrix)? })
}

/// The eigenvalues of a symmetric n × n matrix.
pub(crate) fn values_descending(n: usize, matrix: &[f64]) -> Result<Vec<f64>, Error> {
    match MatRef::from_column_major_slice(matrix, n, n).self_adjoint_eigenvalues(Side::Lower) {
        // faer gives Ok with NaN for a matrix with NaN.
        Ok(mut values) if values.iter().all(|value| value.is_finite()) => {
            values.reverse();
            Ok(values)
        }
        _ => Err(Error::Eigen { dim: n }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_that_is_not_finite_is_an_error() {
        struct Broken(usize);
        impl Covariance for Broken {
            fn dim(&self) -> usize {
                self.0
            }
            fn root_dim(&self) -> usize {
                self.0
            }
            fn apply(&self, _: &[f64], y: &mut [f64]) {
                y.copy_from_slice(&[1.0, f64::NAN][..self.0]);
            }
            fn root(&self, _: &[f64], _: &mut [f64]) {}
            fn root_transpose(&self, _: &[f64], _: &mut [f64]) {}
            fn variance(&self, _: &mut [f64]) {}
        }
        assert!(matches!(Broken(2).spectrum(), Err(Error::NonFinite { row: 1, column: 0, .. })));
        assert_eq!(Broken(0).spectrum().unwrap().eigenvalues, [0.0; 0]);
    }
}
