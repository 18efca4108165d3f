//! A Matérn field as a motion of its value and derivatives along the line.

use super::triangle::{Square, lower, times};
use crate::kernel::Kernel;

/// The stochastic differential equation dz = F z da + e_p dβ of the states z = (f, f′/λ, …), a = λ s,
/// scaled so that f has variance 1. F = N − 1 with a nilpotent N, since (1 + d/da)^{p+1} f is white noise.
pub(super) struct Motion {
    /// p + 1: 1, 2 or 3.
    pub(super) states: usize,
    /// λ = √(2ν)/L.
    pub(super) rate: f64,
    /// N.
    nilpotent: Square,
    /// Density of the white noise.
    density: f64,
    /// Triangular root of the covariance of z.
    pub(super) stationary: Square,
}

/// Nodes u ± and weights of Gauss and Legendre's rule with eight points on [−1, 1].
const NODES: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_47),
    (0.960_289_856_497_536_2, 0.101_228_536_290_376_26),
];

impl Motion {
    /// `None` for a kernel that is not Markov.
    pub(super) fn of(kernel: Kernel) -> Option<Motion> {
        let (states, two_nu, density): (usize, f64, f64) = match kernel {
            Kernel::Gaussian { .. } => return None,
            Kernel::Matern12 { .. } => (1, 1.0, 2.0),
            Kernel::Matern32 { .. } => (2, 3.0, 4.0),
            Kernel::Matern52 { .. } => (3, 5.0, 16.0 / 3.0),
        };
        let mut nilpotent = Square::default();
        let mut stationary = Square::default();
        // Variances of f, f′/λ, f″/λ² are 1, 1 (ν = 3/2), and 1, 1/3, 1 with −1/3 between f and
        // f″ (ν = 5/2).
        match states {
            1 => stationary[0][0] = 1.0,
            2 => {
                nilpotent[0] = [1.0, 1.0, 0.0];
                nilpotent[1] = [-1.0, -1.0, 0.0];
                (stationary[0][0], stationary[1][1]) = (1.0, 1.0);
            }
            _ => {
                nilpotent = [[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [-1.0, -3.0, -2.0]];
                stationary[0][0] = 1.0;
                stationary[1][1] = (1.0_f64 / 3.0).sqrt();
                stationary[2] = [-1.0 / 3.0, 0.0, (8.0_f64 / 9.0).sqrt()];
            }
        }
        Some(Motion { states, rate: two_nu.sqrt() / kernel.length(), nilpotent, density, stationary })
    }

    /// Φ = exp(F a) = e^{−a} (1 + a N + a² N²/2).
    pub(super) fn transition(&self, a: f64) -> Square {
        let square = times(&self.nilpotent, &self.nilpotent);
        let decay = (-a).exp();
        let mut phi = Square::default();
        for i in 0..self.states {
            for j in 0..self.states {
                let one = if i == j { 1.0 } else { 0.0 };
                // 0 ∞ far away, where the exponential has vanished.
                let entry = if decay > 0.0 {
                    decay * (one + a * (self.nilpotent[i][j] + 0.5 * a * square[i][j]))
                } else {
                    0.0
                };
                phi[i][j] = entry;
            }
        }
        phi
    }

    /// The triangular root of Q(a) = density × ∫₀ᵃ Φ(u) e_p e_pᵀ Φ(u)ᵀ du: by eight nodes, whose
    /// error is below rounding for a ≤ 1 (the integrand is a polynomial of degree four times e^{−2u});
    /// beyond by doubling, Q(2a) = Q(a) + Φ(a) Q(a) Φ(a)ᵀ.
    pub(super) fn noise(&self, a: f64) -> Square {
        if a > 60.0 {
            return self.stationary;
        }
        let rows = if a > 1.0 {
            let (half, phi) = (self.noise(0.5 * a), self.transition(0.5 * a));
            let moved = times(&phi, &half);
            (0..self.states).map(|i| [moved[i], half[i]].concat()).collect()
        } else {
            let last = self.states - 1;
            let mut rows = vec![Vec::with_capacity(8); self.states];
            for (node, weight) in NODES {
                for node in [node, -node] {
                    let phi = self.transition(0.5 * a * (1.0 + node));
                    let root = (0.5 * a * weight * self.density).sqrt();
                    for (row, phi) in rows.iter_mut().zip(phi) {
                        row.push(root * phi[last]);
                    }
                }
            }
            rows
        };
        self.triangle(rows)
    }

    fn triangle(&self, mut rows: Vec<Vec<f64>>) -> Square {
        lower(&mut rows);
        let mut root = Square::default();
        for (root, row) in root.iter_mut().zip(&rows) {
            root[..row.len()].copy_from_slice(row);
        }
        root
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::markov::triangle::between;

    fn of(root: &Square) -> Square {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| root[i][k] * root[j][k]).sum()))
    }

    /// P = Φ P Φᵀ + Q, and the first row of Φ P is the kernel.
    #[test]
    fn the_motion_is_stationary_and_has_the_kernel() {
        for kernel in [
            Kernel::Matern12 { length: 1.0 },
            Kernel::Matern32 { length: 1.0 },
            Kernel::Matern52 { length: 1.0 },
        ] {
            let motion = Motion::of(kernel).unwrap();
            let p = of(&motion.stationary);
            for d in [1e-6, 1e-3, 0.1, 0.44, 0.45, 1.0, 7.0, 26.0, 27.0, 1e3] {
                let a = motion.rate * d;
                let (phi, q) = (motion.transition(a), of(&motion.noise(a)));
                let moved = between(&phi, &p);
                for i in 0..3 {
                    for j in 0..3 {
                        // Some ten products of numbers up to 10 (entries of Φ near a = 1).
                        let gap = moved[i][j] + q[i][j] - p[i][j];
                        assert!(gap.abs() <= 20.0 * f64::EPSILON, "{kernel:?} {d} {i} {j} {gap:e}");
                    }
                }
                let covariance = times(&phi, &p)[0][0];
                assert!((covariance - kernel.at(d)).abs() <= 4.0 * f64::EPSILON, "{kernel:?} {d}");
            }
        }
    }

    /// To leading order a five-fold, three-fold, single integral of white noise: variances a⁵/20, a³/3, a.
    #[test]
    fn the_noise_of_a_short_way_has_all_its_digits() {
        let leading = [
            (Kernel::Matern12 { length: 1.0 }, 2.0, 1, 1.0),
            (Kernel::Matern32 { length: 1.0 }, 4.0, 3, 3.0),
            (Kernel::Matern52 { length: 1.0 }, 16.0 / 3.0, 5, 20.0),
        ];
        for (kernel, density, power, denominator) in leading {
            let motion = Motion::of(kernel).unwrap();
            for a in [1e-4_f64, 1e-8, 1e-12] {
                let root = motion.noise(a)[0][0];
                let expected = (density * a.powi(power) / denominator).sqrt();
                // The next term is a times a factor below 2.
                assert!(
                    (root / expected - 1.0).abs() <= 2.0 * a + 1e-14,
                    "{kernel:?} {a} {root:e} {expected:e}"
                );
            }
        }
    }
}
