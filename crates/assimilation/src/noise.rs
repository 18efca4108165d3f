//! The error covariance R of all observations: independent rows and correlated blocks.

use crate::correlated::Correlated;
use crate::{Error, Observation};
use std::ops::Range;

/// The error covariance R of all m values of a window, by its square root: σ for independent rows, a block
/// for each observation with correlated errors.
///
/// A clone shares the blocks; take one from [`ObservationSet::errors`](crate::ObservationSet::errors) before
/// a cost borrows the set.
#[derive(Debug, Clone, Default)]
pub struct ObservationErrors {
    /// σ of independent rows, 1 of correlated ones.
    pub(crate) scale: Vec<f64>,
    pub(crate) blocks: Vec<(Range<usize>, Correlated)>,
}

impl ObservationErrors {
    /// Of observations in their order in the stacked vector.
    pub(crate) fn new(observations: &[Observation], offsets: &[usize]) -> Result<Self, Error> {
        let mut noise = Self::default();
        for (observation, &first) in observations.iter().zip(offsets) {
            match &observation.correlation {
                None => noise.scale.extend(&observation.sigma),
                Some(block) => {
                    let (m, r) = (observation.rows.len(), block.covariance());
                    for found in [r.dim(), r.root_dim()] {
                        if found != m {
                            let what = "the error covariance of an observation";
                            return Err(Error::Length { what, expected: m, found });
                        }
                    }
                    noise.scale.extend(vec![1.0; m]);
                    noise.blocks.push((first..first + m, block.clone()));
                }
            }
        }
        Ok(noise)
    }

    /// m.
    pub fn dim(&self) -> usize {
        self.scale.len()
    }

    /// d ← R^{1/2}ᵀ d, stacked: the inverse of what
    /// [`whiten_transpose`](crate::ObservationSet::whiten_transpose) does.
    ///
    /// # Panics
    /// If `d` is not of length `dim`.
    pub fn root_transpose(&self, d: &mut [f64]) {
        assert_eq!(d.len(), self.dim(), "length of d");
        d.iter_mut().zip(&self.scale).for_each(|(d, s)| *d *= s);
        for (rows, block) in &self.blocks {
            // R^{1/2}ᵀ = R^{-1/2} R
            let mut product = vec![0.0; rows.len()];
            block.covariance().apply(&d[rows.clone()], &mut product);
            block.covariance().whiten(&product, &mut d[rows.clone()]);
        }
    }
}
