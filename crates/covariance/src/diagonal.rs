//! Uncorrelated components: R of independent observations, or B as white noise.

use crate::error::Error;
use crate::input::check_lengths;
use crate::operator::{Covariance, Precision};

/// B = diag(σ₁², …, σ_n²), B^{1/2} = diag(σ₁, …, σ_n).
///
/// ```
/// use varda_covariance::{Diagonal, Precision};
///
/// let r = Diagonal::new(vec![0.5, 2.0])?;
/// let mut white = [0.0; 2];
/// r.whiten(&[1.0, 1.0], &mut white);
/// assert_eq!(white, [2.0, 0.5]);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Diagonal {
    sigma: Vec<f64>,
}

impl Diagonal {
    /// From the standard deviation of every component, each in its component's unit. None at all is allowed:
    /// R of no observations.
    ///
    /// # Errors
    ///
    /// [`Error::Parameter`] for a standard deviation that is not positive and finite, or whose square is
    /// neither.
    pub fn new(sigma: Vec<f64>) -> Result<Self, Error> {
        match sigma.iter().find(|&&sigma| !(sigma > 0.0 && (sigma * sigma).is_normal())) {
            Some(&value) => Err(Error::Parameter { what: "standard deviation", value, range: "positive" }),
            None => Ok(Self { sigma }),
        }
    }

    /// σ² I of size n.
    ///
    /// # Errors
    ///
    /// As [`new`](Self::new).
    pub fn uniform(n: usize, sigma: f64) -> Result<Self, Error> {
        Self::new(vec![sigma; n])
    }

    /// The standard deviations.
    pub fn sigma(&self) -> &[f64] {
        &self.sigma
    }

    fn each(&self, x: &[f64], y: &mut [f64], value: impl Fn(f64, f64) -> f64) {
        check_lengths(x, self.sigma.len(), y, self.sigma.len());
        for ((y, &x), &sigma) in y.iter_mut().zip(x).zip(&self.sigma) {
            *y = value(sigma, x);
        }
    }
}

impl Covariance for Diagonal {
    fn dim(&self) -> usize {
        self.sigma.len()
    }

    fn root_dim(&self) -> usize {
        self.sigma.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.each(x, y, |sigma, x| sigma * sigma * x);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        self.each(v, x, |sigma, v| sigma * v);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.each(x, v, |sigma, x| sigma * x);
    }

    fn variance(&self, variance: &mut [f64]) {
        self.each(&self.sigma, variance, |sigma, _| sigma * sigma);
    }
}

impl Precision for Diagonal {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.each(x, y, |sigma, x| x / (sigma * sigma));
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        self.each(x, v, |sigma, x| x / sigma);
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        self.each(v, x, |sigma, v| v / sigma);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Spectrum;

    #[test]
    fn every_operation_by_hand() {
        let r = Diagonal::new(vec![0.5, 2.0]).unwrap();
        let mut out = [0.0; 2];
        r.apply(&[8.0, 1.0], &mut out);
        assert_eq!(out, [2.0, 4.0]);
        r.solve(&[2.0, 4.0], &mut out);
        assert_eq!(out, [8.0, 1.0]);
        r.root(&[8.0, 1.0], &mut out);
        assert_eq!(out, [4.0, 2.0]);
        r.root_transpose(&[8.0, 1.0], &mut out);
        assert_eq!(out, [4.0, 2.0]);
        r.whiten(&[4.0, 2.0], &mut out);
        assert_eq!(out, [8.0, 1.0]);
        r.whiten_transpose(&[4.0, 2.0], &mut out);
        assert_eq!(out, [8.0, 1.0]);
        r.variance(&mut out);
        assert_eq!(out, [0.25, 4.0]);
        assert_eq!(Spectrum::of(&r).unwrap().eigenvalues, [4.0, 0.25]);
    }

    #[test]
    fn a_useless_standard_deviation_is_refused() {
        for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-200, 1e200] {
            assert!(matches!(Diagonal::uniform(2, sigma), Err(Error::Parameter { .. })), "{sigma}");
        }
    }
}
