//! R and R^{-1/2} of a set of observations.

use crate::ObservationSet;
use crate::noise::ObservationErrors;

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
                rows.iter().zip(&column).for_each(|(&row, c)| r[row + rows[j] * m] = *c);
            }
        }
        r
    }

    /// R by its square root.
    pub fn errors(&self) -> &ObservationErrors {
        &self.noise
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
        self.noise.through_blocks(d, |r, d, out| r.whiten(d, out));
    }

    /// Their transposes.
    pub(crate) fn whiten_blocks_transpose(&self, d: &mut [f64]) {
        self.noise.through_blocks(d, |r, d, out| r.whiten_transpose(d, out));
    }

    /// The blocks of R^{-1/2} on the rows of G, given as the columns of Gᵀ, each of length n.
    pub(crate) fn whiten_rows(&self, n: usize, transposed: &mut [f64]) {
        for (rows, block) in &self.noise.blocks {
            let (mut raw, mut white) = (vec![0.0; rows.len()], vec![0.0; rows.len()]);
            for j in 0..n {
                rows.iter().zip(&mut raw).for_each(|(i, raw)| *raw = transposed[i * n + j]);
                block.covariance().whiten(&raw, &mut white);
                rows.iter().zip(&white).for_each(|(i, white)| transposed[i * n + j] = *white);
            }
        }
    }
}
