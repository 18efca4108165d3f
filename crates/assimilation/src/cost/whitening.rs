//! J_o and the products with R^{-1/2}: rows with independent errors, correlated blocks, the Huber norm.

use super::StrongConstraint;
use super::huber::huber;

impl StrongConstraint<'_> {
    /// dy ← √ρ'' R^{-1/2} dy.
    pub(super) fn whiten(&self, dy: &mut [f64]) {
        self.observations.whiten_blocks(dy);
        self.weigh(dy);
    }

    /// dy ← R^{-1/2}ᵀ √ρ'' dy.
    pub(super) fn whiten_transpose(&self, dy: &mut [f64]) {
        self.weigh(dy);
        self.observations.whiten_blocks_transpose(dy);
    }

    fn weigh(&self, dy: &mut [f64]) {
        dy.iter_mut().enumerate().for_each(|(i, dy)| *dy *= self.whitening(i));
    }

    /// √ρ'' R^{-1/2} of an independent row i; of a correlated one what follows the whitening of its block.
    pub(super) fn whitening(&self, i: usize) -> f64 {
        self.root_weight[i] * self.root_precision[i]
    }

    /// J_o at the base point or at the trial point; with `derivatives` also dy = −R^{-1/2} ρ' and √ρ''
    /// there.
    pub(super) fn observation_term(&mut self, at_base: bool, derivatives: bool) -> f64 {
        let point = if at_base { &self.base } else { &self.trial };
        let predicted = point.predicted.values();
        if self.observations.is_correlated() {
            return self.correlated_term(predicted.to_vec(), derivatives);
        }
        let rows = self.observations.values().iter().zip(predicted).zip(&self.root_precision);
        if !derivatives {
            return rows.fold(0.0, |sum, ((y, hx), root)| sum + huber(self.huber, (y - hx) * root).0);
        }
        let mut sum = 0.0;
        for ((((y, hx), root), dy), weight) in rows.zip(&mut self.dy).zip(&mut self.root_weight) {
            let (rho, slope, curvature) = huber(self.huber, (y - hx) * root);
            sum += rho;
            *dy = -slope * root;
            // ρ'' is 0 or 1
            *weight = curvature;
        }
        sum
    }

    /// `observation_term` where some errors are correlated: ρ of the whitened departures.
    fn correlated_term(&mut self, mut d: Vec<f64>, derivatives: bool) -> f64 {
        d.iter_mut().zip(self.observations.values()).for_each(|(d, y)| *d = y - *d);
        self.observations.whiten_blocks(&mut d);
        let mut sum = 0.0;
        for (i, (d, root)) in d.iter_mut().zip(&self.root_precision).enumerate() {
            let (rho, slope, curvature) = huber(self.huber, *d * root);
            sum += rho;
            *d = -slope * root;
            if derivatives {
                self.root_weight[i] = curvature;
            }
        }
        if derivatives {
            self.observations.whiten_blocks_transpose(&mut d);
            self.dy = d;
        }
        sum
    }
}
