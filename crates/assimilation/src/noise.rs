//! The error covariance R of the observations: independent rows and correlated blocks.

use crate::{Error, Observation, ObservationSet};
use std::fmt;
use std::ops::Range;
use std::sync::Arc;
use varda_covariance::{Covariance, Dense, Precision};

/// The error covariance R_k of one observation whose rows have correlated errors; shared by all observations
/// of one instrument.
#[derive(Clone)]
pub struct Correlated(Arc<dyn Precision + Send + Sync>);

impl Correlated {
    /// R_k.
    pub fn covariance(&self) -> &dyn Precision {
        &*self.0
    }
}

impl fmt::Debug for Correlated {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "Correlated({} rows)", self.0.dim())
    }
}

/// Equal if they are the same object.
impl PartialEq for Correlated {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::addr_eq(Arc::as_ptr(&self.0), Arc::as_ptr(&other.0))
    }
}

impl Observation {
    /// With errors of its rows that are correlated: R_k instead of diag σ², one row of R_k for each row of
    /// the observation. Its standard deviations become the square roots of the diagonal of R_k.
    ///
    /// ```
    /// use std::sync::Arc;
    /// use varda_assimilation::Observation;
    /// use varda_covariance::Dense;
    ///
    /// let r = Arc::new(Dense::new(2, &[0.04, 0.03, 0.03, 0.09])?);
    /// let seen = Observation::new(20, vec![0, 2], vec![8.1, 14.9], 1.0).correlated(r);
    /// assert!((seen.sigma[0] - 0.2).abs() < 1e-15 && (seen.sigma[1] - 0.3).abs() < 1e-15);
    /// # Ok::<(), varda_covariance::Error>(())
    /// ```
    pub fn correlated(self, r: Arc<dyn Precision + Send + Sync>) -> Self {
        let mut sigma = vec![0.0; r.dim()];
        r.variance(&mut sigma);
        sigma.iter_mut().for_each(|s| *s = s.sqrt());
        Self { sigma, correlation: Some(Correlated(r)), ..self }
    }

    /// Without the rows that `keep` refuses; of a correlated block the marginal covariance of the rows that
    /// stay.
    pub(crate) fn retain(&mut self, keep: &dyn Fn(usize) -> bool) -> Result<(), Error> {
        let kept: Vec<usize> = (0..self.rows.len()).filter(|&i| keep(i)).collect();
        if kept.len() == self.rows.len() {
            return Ok(());
        }
        self.rows = kept.iter().map(|&i| self.rows[i]).collect();
        self.values = kept.iter().map(|&i| self.values[i]).collect();
        self.sigma = kept.iter().map(|&i| self.sigma[i]).collect();
        if let Some(Correlated(r)) = self.correlation.take()
            && !kept.is_empty()
        {
            let (mut unit, mut column) = (vec![0.0; r.dim()], vec![0.0; r.dim()]);
            let mut marginal = Vec::new();
            for &j in &kept {
                unit[j] = 1.0;
                r.apply(&unit, &mut column);
                unit[j] = 0.0;
                marginal.extend(kept.iter().map(|&i| column[i]));
            }
            self.correlation = Some(Correlated(Arc::new(Dense::new(kept.len(), &marginal)?)));
        }
        Ok(())
    }
}

/// R^{-1/2} of all rows of a window: a division by σ for independent rows, a whitening for each correlated
/// block.
#[derive(Default)]
pub(crate) struct Noise {
    /// σ of independent rows, 1 of correlated ones.
    scale: Vec<f64>,
    blocks: Vec<(Range<usize>, Correlated)>,
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

impl ObservationSet {
    /// d ← R^{-1/2} d, stacked.
    ///
    /// # Panics
    /// If `d` is not of length `dim`.
    pub fn whiten(&self, d: &mut [f64]) {
        assert_eq!(d.len(), self.dim(), "length of d");
        d.iter_mut().zip(&self.noise.scale).for_each(|(d, s)| *d /= s);
        self.whiten_blocks(d);
    }

    /// d ← R^{-1/2}ᵀ d, stacked.
    ///
    /// # Panics
    /// If `d` is not of length `dim`.
    pub fn whiten_transpose(&self, d: &mut [f64]) {
        assert_eq!(d.len(), self.dim(), "length of d");
        self.whiten_blocks_transpose(d);
        d.iter_mut().zip(&self.noise.scale).for_each(|(d, s)| *d /= s);
    }

    /// R, dense, by columns: for small problems and references.
    pub fn error_covariance(&self) -> Vec<f64> {
        let m = self.dim();
        let mut r = vec![0.0; m * m];
        self.sigma().iter().enumerate().for_each(|(i, s)| r[i + i * m] = s * s);
        for (rows, block) in &self.noise.blocks {
            let (mut unit, mut column) = (vec![0.0; rows.len()], vec![0.0; rows.len()]);
            for j in 0..rows.len() {
                unit[j] = 1.0;
                block.covariance().apply(&unit, &mut column);
                unit[j] = 0.0;
                r[(rows.start + j) * m + rows.start..][..rows.len()].copy_from_slice(&column);
            }
        }
        r
    }

    /// Whether some observation has correlated errors.
    pub fn is_correlated(&self) -> bool {
        !self.noise.blocks.is_empty()
    }

    /// σ of independent rows, 1 of correlated ones.
    pub(crate) fn row_scale(&self) -> &[f64] {
        &self.noise.scale
    }

    /// The correlated blocks of R^{-1/2} alone.
    pub(crate) fn whiten_blocks(&self, d: &mut [f64]) {
        for (rows, block) in &self.noise.blocks {
            let raw = d[rows.clone()].to_vec();
            block.covariance().whiten(&raw, &mut d[rows.clone()]);
        }
    }

    /// Their transposes.
    pub(crate) fn whiten_blocks_transpose(&self, d: &mut [f64]) {
        for (rows, block) in &self.noise.blocks {
            let raw = d[rows.clone()].to_vec();
            block.covariance().whiten_transpose(&raw, &mut d[rows.clone()]);
        }
    }

    /// The blocks of R^{-1/2} on the rows of G, given as the columns of Gᵀ, each of length n.
    pub(crate) fn whiten_rows(&self, n: usize, transposed: &mut [f64]) {
        for (rows, block) in &self.noise.blocks {
            let (mut raw, mut white) = (vec![0.0; rows.len()], vec![0.0; rows.len()]);
            for j in 0..n {
                rows.clone().zip(&mut raw).for_each(|(i, raw)| *raw = transposed[i * n + j]);
                block.covariance().whiten(&raw, &mut white);
                rows.clone().zip(&white).for_each(|(i, white)| transposed[i * n + j] = *white);
            }
        }
    }
}
