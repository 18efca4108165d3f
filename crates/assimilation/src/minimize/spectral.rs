//! A quadratic model by its eigenpairs, in which the step for any trust radius costs O(n k).

use crate::{Error, cost::dot, cost::norm};
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use varda_linalg::Eigen;
use varda_linalg::krylov::{Ritz, RitzPair};

/// q(p) = gᵀp + ½ pᵀ A p on the span of k orthonormal vectors z_i with zᵢᵀ A z_j = μ_i δ_ij.
pub(super) struct Spectral {
    /// μ, ascending.
    pub(super) values: Vec<f64>,
    /// z_i, one after the other, each of length n.
    pub(super) vectors: Vec<f64>,
    /// c_i = zᵢᵀ g.
    slope: Vec<f64>,
    /// ‖A z_i − μ_i z_i‖; empty for a dense matrix, whose pairs are exact.
    residuals: Vec<f64>,
}

/// The minimizer of q within a ball.
pub(super) struct Step {
    /// −q(p) ≥ 0.
    pub(super) decrease: f64,
    /// λ ≥ 0 with (A + λI) p = −g.
    pub(super) damping: f64,
    /// ‖p‖.
    pub(super) norm: f64,
}

/// Eigenvalues, ascending, and eigenvectors by columns of a symmetric matrix given by columns.
pub(crate) fn eigen(n: usize, matrix: &[f64]) -> Result<(Vec<f64>, Vec<f64>), Error> {
    let Eigen { values, vectors } = Eigen::new(n, matrix)?;
    Ok((values, vectors))
}

impl Spectral {
    /// From a dense symmetric matrix, by columns.
    pub(super) fn dense(matrix: &[f64], g: &[f64]) -> Result<Self, Error> {
        let (values, vectors) = eigen(g.len(), matrix)?;
        Ok(Self::new(values, vectors, g))
    }

    /// On a Krylov space.
    pub(super) fn of(ritz: Ritz, g: &[f64]) -> Self {
        let residuals = ritz.coupling.iter().map(|e| e.abs()).collect();
        Self { residuals, ..Self::new(ritz.values, ritz.vectors, g) }
    }

    fn new(values: Vec<f64>, vectors: Vec<f64>, g: &[f64]) -> Self {
        let slope = vectors.chunks_exact(g.len()).map(|z| dot(z, g)).collect();
        Self { values, vectors, slope, residuals: Vec::new() }
    }

    /// The Ritz pairs, largest first; none for a dense matrix.
    pub(super) fn pairs(&self) -> Vec<RitzPair> {
        let n = self.vectors.len() / self.values.len().max(1);
        let pairs = self.values.iter().zip(self.vectors.chunks_exact(n.max(1))).zip(&self.residuals).rev();
        pairs.map(|((&value, z), &residual)| RitzPair { value, vector: z.to_vec(), residual }).collect()
    }

    /// p = argmin q over ‖p‖ ≤ radius (Moré and Sorensen 1983, exactly, the eigenvalues being known).
    pub(super) fn step(&self, radius: f64, p: &mut [f64]) -> Step {
        self.step_for(&self.slope, radius, p)
    }

    /// The step for a gradient that differs from g by `share` of its norm, in a direction drawn at random
    /// within the span; the decrease is that of q.
    pub(super) fn perturbed_step(
        &self,
        share: f64,
        rng: &mut ChaCha8Rng,
        radius: f64,
        p: &mut [f64],
    ) -> Step {
        let mut other: Vec<f64> = self.slope.iter().map(|_| StandardNormal.sample(rng)).collect();
        let scale = share * norm(&self.slope) / norm(&other);
        other.iter_mut().zip(&self.slope).for_each(|(o, c)| *o = c + scale * *o);
        self.step_for(&other, radius, p)
    }

    fn step_for(&self, slope: &[f64], radius: f64, p: &mut [f64]) -> Step {
        let lowest = self.values[0];
        let size = |lambda: f64| {
            let sum: f64 = self.values.iter().zip(slope).map(|(mu, c)| (c / (mu + lambda)).powi(2)).sum();
            sum.sqrt()
        };
        let scale = self.values[self.values.len() - 1].abs().max(lowest.abs());
        // Just inside the open interval of admissible λ.
        let floor = if lowest > 0.0 { 0.0 } else { -lowest + 1e-12 * scale.max(f64::MIN_POSITIVE) };
        let inside = size(floor) <= radius;
        let damping =
            if inside { floor } else { boundary(floor, norm(slope) / radius - lowest, radius, &size) };
        p.fill(0.0);
        let mut along_lowest = -slope[0] / (lowest + damping);
        if inside && lowest <= 0.0 && radius.is_finite() {
            // Hard case: the gradient has next to nothing along the lowest eigenvector; go along it to the
            // boundary.
            let missing = radius * radius - size(damping).powi(2);
            along_lowest = (along_lowest.powi(2) + missing).sqrt().copysign(along_lowest);
        }
        let mut decrease = 0.0;
        for (i, z) in self.vectors.chunks_exact(p.len()).enumerate() {
            let mu = self.values[i];
            let h = if i == 0 { along_lowest } else { -slope[i] / (mu + damping) };
            decrease -= h * (self.slope[i] + 0.5 * mu * h);
            for (p, z) in p.iter_mut().zip(z) {
                *p += h * z;
            }
        }
        Step { decrease, damping, norm: norm(p) }
    }
}

/// λ in (low, high] with size(λ) = radius, for a decreasing `size`: Newton on 1/size, which is nearly
/// linear, within a shrinking bracket.
fn boundary(mut low: f64, mut high: f64, radius: f64, size: &dyn Fn(f64) -> f64) -> f64 {
    let mut lambda = high;
    // Bisection alone would reach the last bit of any double in 1100 halvings; in practice a dozen are made.
    for _ in 0..200 {
        let s = size(lambda);
        if (s - radius).abs() <= 1e-10 * radius {
            break;
        }
        if s > radius {
            low = lambda
        } else {
            high = lambda
        }
        // Secant through 1/size at λ and at the low end of the bracket.
        let s_low = size(low);
        let (f, f_low) = (1.0 / s - 1.0 / radius, 1.0 / s_low - 1.0 / radius);
        let next = lambda - f * (lambda - low) / (f - f_low);
        lambda = if next > low && next < high { next } else { 0.5 * (low + high) };
        if !(high - low > f64::EPSILON * high) {
            break;
        }
    }
    lambda
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Optimality of a trust-region step, independent of how it was found: (A + λI) p = −g, λ ≥ 0, λ
    /// (radius − ‖p‖) = 0, A + λI ⪰ 0.
    fn check(matrix: &[f64], g: &[f64], radius: f64) {
        let n = g.len();
        let spectral = Spectral::dense(matrix, g).unwrap();
        let mut p = vec![0.0; n];
        let step = spectral.step(radius, &mut p);
        let mut q = 0.0;
        for i in 0..n {
            let ap: f64 = (0..n).map(|j| matrix[i + j * n] * p[j]).sum();
            // 1e-9: the boundary is met to 1e-10 of the radius.
            assert!(
                (ap + step.damping * p[i] + g[i]).abs() <= 1e-9 * (1.0 + norm(g)),
                "{i}: {ap} {}",
                step.damping
            );
            q += p[i] * (g[i] + 0.5 * ap);
        }
        assert!((q + step.decrease).abs() <= 1e-9 * (1.0 + q.abs()));
        assert!(step.norm <= radius * (1.0 + 1e-9));
        assert!(step.damping <= 1e-9 || (step.norm - radius).abs() <= 1e-9 * radius);
        assert!(spectral.values[0] + step.damping >= 0.0);
    }

    #[test]
    fn steps_are_optimal_inside_on_the_boundary_and_in_the_hard_case() {
        let convex = [4.0, 1.0, 0.5, 1.0, 3.0, 0.2, 0.5, 0.2, 100.0];
        let saddle = [-2.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.0, 5.0];
        for radius in [1e-3, 0.1, 1.0, 10.0] {
            check(&convex, &[1.0, -2.0, 30.0], radius);
            check(&saddle, &[1.0, -2.0, 3.0], radius);
            check(&saddle, &[0.0, -2.0, 3.0], radius);
        }
    }
}
