//! What a covariance is like: its spectrum, condition number and effective rank.

use crate::error::Error;
use crate::operator::Covariance;

/// The eigenvalues λ₁ ≥ λ₂ ≥ … ≥ λ_n of a covariance. See [`Spectrum::of`].
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// All n eigenvalues, descending, in the square of the field's unit. Those of a singular covariance may
    /// be round-off of either sign.
    pub eigenvalues: Vec<f64>,
}

impl Spectrum {
    /// The eigenvalues of a covariance, which is formed column by column: n products, O(n³) time, O(n²)
    /// memory. For a covariance made of smaller ones, those of its parts are cheaper.
    ///
    /// ```
    /// use varda_covariance::{Diagonal, Spectrum};
    ///
    /// let spectrum = Spectrum::of(&Diagonal::new(vec![1.0, 3.0])?)?;
    /// assert_eq!(spectrum.condition_number(), 9.0);
    /// # Ok::<(), varda_covariance::Error>(())
    /// ```
    ///
    /// # Errors
    ///
    /// [`Error::Eigen`] if the eigenvalue iteration fails, [`Error::NonFinite`] if `apply` gave a value that
    /// is not finite.
    pub fn of(covariance: &(impl Covariance + ?Sized)) -> Result<Self, Error> {
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
        Ok(Self::new(varda_linalg::eigenvalues(n, &matrix)?))
    }

    /// Sorts the eigenvalues.
    pub fn new(mut eigenvalues: Vec<f64>) -> Self {
        eigenvalues.sort_by(|a, b| b.total_cmp(a));
        Self { eigenvalues }
    }

    /// λ₁/λ_n; infinite if λ_n ≤ 0. Beyond 1/(n ε) it says no more than "singular". NaN without
    /// eigenvalues.
    pub fn condition_number(&self) -> f64 {
        match (self.eigenvalues.first(), self.eigenvalues.last()) {
            (Some(largest), Some(smallest)) if *smallest > 0.0 => largest / smallest,
            (Some(_), Some(_)) => f64::INFINITY,
            _ => f64::NAN,
        }
    }

    /// The condition number where double precision knows it: `None` where λ_n is not above n ε λ₁, the
    /// rounding of the eigenvalues. The condition is then above 1/(n ε), some 1e16/n: "above 1e16" for all
    /// that arithmetic can tell.
    pub fn reliable_condition_number(&self) -> Option<f64> {
        let (largest, smallest) = (*self.eigenvalues.first()?, *self.eigenvalues.last()?);
        (smallest > self.eigenvalues.len() as f64 * f64::EPSILON * largest).then(|| largest / smallest)
    }

    /// (Σ λ)² / Σ λ²: the number of equal eigenvalues that would spread the variance as widely
    /// (Bretherton et al. 1999). Between 1 and n; 0 where nothing varies.
    pub fn effective_rank(&self) -> f64 {
        let squares: f64 = self.eigenvalues.iter().map(|value| value * value).sum();
        if squares == 0.0 { 0.0 } else { self.total_variance().powi(2) / squares }
    }

    /// The part of the total variance in the leading `rank` directions, Σ_{k ≤ rank} λ_k / Σ λ; 1 where
    /// nothing varies.
    pub fn explained_variance(&self, rank: usize) -> f64 {
        let total = self.total_variance();
        if total == 0.0 { 1.0 } else { self.eigenvalues.iter().take(rank).sum::<f64>() / total }
    }

    /// Σ λ = tr B.
    pub fn total_variance(&self) -> f64 {
        self.eigenvalues.iter().fold(0.0, |sum, value| sum + value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_a_small_spectrum() {
        let spectrum = Spectrum::new(vec![1.0, 4.0, 3.0]);
        assert_eq!(spectrum.eigenvalues, [4.0, 3.0, 1.0]);
        assert_eq!(spectrum.condition_number(), 4.0);
        assert_eq!(spectrum.reliable_condition_number(), Some(4.0));
        assert_eq!(Spectrum::new(vec![1.0, 4e-16]).reliable_condition_number(), None);
        assert_eq!(Spectrum::new(vec![1.0, 5e-16]).reliable_condition_number(), Some(1.0 / 5e-16));
        assert_eq!(spectrum.total_variance(), 8.0);
        assert_eq!(spectrum.effective_rank(), 64.0 / 26.0);
        assert_eq!(spectrum.explained_variance(2), 7.0 / 8.0);
        assert_eq!(Spectrum::new(vec![1.0, 0.0]).condition_number(), f64::INFINITY);
        assert!(Spectrum::new(vec![]).condition_number().is_nan());
    }

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
        assert!(matches!(Spectrum::of(&Broken(2)), Err(Error::NonFinite { row: 1, column: 0, .. })));
        assert_eq!(Spectrum::of(&Broken(0)).unwrap().eigenvalues, [0.0; 0]);
    }
}
