//! The error covariance R of all observations: independent rows and correlated blocks.

use crate::correlated::Correlated;
use crate::{Error, Observation};
use std::ops::Range;

/// R^{-1/2} of all rows of a window: a division by σ for independent rows, a whitening for each correlated
/// block.
#[derive(Default)]
pub(crate) struct Noise {
    /// σ of independent rows, 1 of correlated ones.
    pub(crate) scale: Vec<f64>,
    pub(crate) blocks: Vec<(Range<usize>, Correlated)>,
}

impl Noise {
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
}
