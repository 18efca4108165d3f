//! Correlation kernels, tapers, and the matrices they fill; exact conditioning on known points.

use crate::error::Error;
use varda_linalg::dense::Cholesky;
use varda_linalg::dot_in_lanes;

/// A homogeneous covariance function: B(i, j) = σ² k(d_ij) t(d_ij), kernel k times taper t.
///
/// Plain data. To draw errors from the kernel before localization and give B after it, use two of these, one
/// with [`Taper::None`] (take a [`Truncated`](crate::Truncated) root of that one: smooth kernels are
/// singular).
///
/// # Positive semidefiniteness
///
/// The elementwise product of two positive semidefinite matrices is one (Schur 1911), so k t is a covariance
/// wherever both k and t are. All kernels here are, for Euclidean distances in any dimension; the triangle
/// only for |s_i − s_j| in one dimension; Gaspari–Cohn in up to three. Along a closed curve, or for any
/// other distance, nothing is promised: the factorization then decides, with a typed error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CovarianceFunction {
    /// Standard deviation σ of every component, in the unit of the field.
    pub sigma: f64,
    /// Correlation kernel k.
    pub kernel: Kernel,
    /// Localization t.
    pub taper: Taper,
}

/// A correlation kernel k(d), k(0) = 1, with correlation length L [m, or the unit of d].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Kernel {
    /// k = exp(−d²/(2L²)). Infinitely smooth, hence singular in floating point where L covers a few
    /// points: the condition number is 1e25 for a hundred points over 5 L.
    Gaussian {
        /// Correlation length L.
        length: f64,
    },
    /// Matérn, ν = 1/2: k = exp(−d/L). Continuous, nowhere differentiable.
    Matern12 {
        /// Correlation length L.
        length: f64,
    },
    /// Matérn, ν = 3/2: k = (1 + a) exp(−a), a = √3 d/L. Once differentiable.
    Matern32 {
        /// Correlation length L.
        length: f64,
    },
    /// Matérn, ν = 5/2: k = (1 + a + a²/3) exp(−a), a = √5 d/L. Twice differentiable.
    Matern52 {
        /// Correlation length L.
        length: f64,
    },
}

/// A localization t(d), t(0) = 1. `support` is the distance L_loc from which on t is zero, for every taper
/// alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Taper {
    /// t = 1.
    None,
    /// t = max(0, 1 − d/L_loc). A covariance in one dimension only.
    Triangle {
        /// L_loc.
        support: f64,
    },
    /// The fifth-order piecewise rational function of Gaspari and Cohn (1999), equation (4.10), whose c is
    /// half the support: c = L_loc/2, t = 0 for d ≥ 2c = L_loc. With z = d/c,
    ///
    /// ```text
    /// t = 1 − 5z²/3 + 5z³/8 + z⁴/2 − z⁵/4                       0 ≤ z ≤ 1
    /// t = 4 − 5z + 5z²/3 + 5z³/8 − z⁴/2 + z⁵/12 − 2/(3z)        1 ≤ z ≤ 2
    /// ```
    GaspariCohn {
        /// L_loc = 2c.
        support: f64,
    },
}

/// k(d) t(d): the localized correlation at distance d ≥ 0.
pub fn correlation(kernel: Kernel, taper: Taper, d: f64) -> f64 {
    kernel.at(d) * taper.at(d)
}

impl Kernel {
    /// k(d), for d ≥ 0.
    pub fn at(self, d: f64) -> f64 {
        match self {
            Kernel::Gaussian { length } => (-0.5 * (d / length).powi(2)).exp(),
            Kernel::Matern12 { length } => (-d / length).exp(),
            Kernel::Matern32 { length } => {
                let a = 3.0_f64.sqrt() * d / length;
                (1.0 + a) * (-a).exp()
            }
            Kernel::Matern52 { length } => {
                let a = 5.0_f64.sqrt() * d / length;
                (1.0 + a + a * a / 3.0) * (-a).exp()
            }
        }
    }

    /// The correlation length L.
    pub fn length(self) -> f64 {
        match self {
            Kernel::Gaussian { length }
            | Kernel::Matern12 { length }
            | Kernel::Matern32 { length }
            | Kernel::Matern52 { length } => length,
        }
    }
}

impl Taper {
    /// t(d), for d ≥ 0.
    pub fn at(self, d: f64) -> f64 {
        match self {
            Taper::None => 1.0,
            Taper::Triangle { support } => (1.0 - d / support).max(0.0),
            Taper::GaspariCohn { support } => {
                let z = 2.0 * d / support;
                if z <= 1.0 {
                    1.0 + z * z * (-5.0 / 3.0 + z * (0.625 + z * (0.5 - z * 0.25)))
                } else if z < 2.0 {
                    let polynomial = 4.0 + z * (-5.0 + z * (5.0 / 3.0 + z * (0.625 + z * (-0.5 + z / 12.0))));
                    // Cancellation near z = 2 leaves round-off of either sign.
                    (polynomial - 2.0 / (3.0 * z)).max(0.0)
                } else {
                    0.0
                }
            }
        }
    }

    /// The distance L_loc from which on the taper is zero; infinite without a taper.
    pub fn support(self) -> f64 {
        match self {
            Taper::None => f64::INFINITY,
            Taper::Triangle { support } | Taper::GaspariCohn { support } => support,
        }
    }
}

impl CovarianceFunction {
    /// The symmetric n × n matrix σ² k(|s_i − s_j|) t(|s_i − s_j|) of the places s along a line, row
    /// by row.
    ///
    /// # Errors
    ///
    /// [`Error::Parameter`] for σ, L or L_loc that is not positive, [`Error::NonFinite`] for a place that is
    /// not finite.
    pub fn matrix(&self, places: &[f64]) -> Result<Vec<f64>, Error> {
        self.conditioned_matrix(places, &[])
    }

    /// Like [`matrix`](Self::matrix) for n points with any distance: `distance(i, j)` is asked for j ≤ i.
    ///
    /// # Errors
    ///
    /// As [`matrix`](Self::matrix).
    pub fn matrix_by(&self, n: usize, distance: impl Fn(usize, usize) -> f64) -> Result<Vec<f64>, Error> {
        self.conditioned_matrix_by(n, 0, distance)
    }

    /// The matrix at the places `free` of a field that is known exactly (zero error) at the places `known`:
    ///
    /// ```text
    /// B = σ² (k_ff − k_fc k_cc⁻¹ k_cf) ∘ t_ff
    /// ```
    ///
    /// The kernel is conditioned first, the taper multiplies afterwards, elementwise. The variance is nowhere
    /// raised, and is zero at a free place that is also known (such a B has no Cholesky root: leave known
    /// points out).
    ///
    /// # Errors
    ///
    /// As [`matrix`](Self::matrix), and [`Error::KnownPoints`] if k_cc is singular to working precision.
    pub fn conditioned_matrix(&self, free: &[f64], known: &[f64]) -> Result<Vec<f64>, Error> {
        let place = |i: usize| if i < free.len() { free[i] } else { known[i - free.len()] };
        self.conditioned_matrix_by(free.len(), known.len(), |i, j| (place(i) - place(j)).abs())
    }

    /// Like [`conditioned_matrix`](Self::conditioned_matrix) with any distance between points, of which 0 …
    /// free − 1 are free and free … free + known − 1 known.
    ///
    /// # Errors
    ///
    /// As [`conditioned_matrix`](Self::conditioned_matrix).
    pub fn conditioned_matrix_by(
        &self,
        free: usize,
        known: usize,
        distance: impl Fn(usize, usize) -> f64,
    ) -> Result<Vec<f64>, Error> {
        self.validate()?;
        let kernel = |row: usize, column: usize| {
            let value = self.kernel.at(distance(row, column));
            if value.is_finite() { Ok(value) } else { Err(Error::NonFinite { row, column, value }) }
        };
        let mut matrix = vec![0.0; free * free];
        for i in 0..free {
            for j in 0..=i {
                matrix[i * free + j] = kernel(i, j)?;
            }
        }

        // With k_cc = L Lᵀ, row i of W holds L⁻¹ k_ci, and k_fc k_cc⁻¹ k_cf = W Wᵀ.
        if known > 0 {
            let mut cc = vec![0.0; known * known];
            for i in 0..known {
                for j in 0..=i {
                    // column j, row i
                    cc[i + j * known] = kernel(free + i, free + j)?;
                }
            }
            let factor = Cholesky::well_determined(known, &cc).map_err(|error| match Error::from(error) {
                Error::NotPositiveDefinite { pivot, value, .. } | Error::Singular { pivot, value, .. } => {
                    Error::KnownPoints { point: pivot, value }
                }
                other => other,
            })?;
            let mut w = vec![0.0; free * known];
            for (i, row) in w.chunks_exact_mut(known).enumerate() {
                for (c, k) in row.iter_mut().enumerate() {
                    *k = kernel(free + c, i)?;
                }
                factor.forward(row);
            }
            for i in 0..free {
                for j in 0..=i {
                    matrix[i * free + j] -= dot_in_lanes(&w[i * known..][..known], &w[j * known..][..known]);
                }
                // At a known point the difference is round-off of either sign.
                matrix[i * free + i] = matrix[i * free + i].max(0.0);
            }
        }

        for i in 0..free {
            for j in 0..=i {
                let value = self.sigma * self.sigma * matrix[i * free + j] * self.taper.at(distance(i, j));
                matrix[i * free + j] = value;
                matrix[j * free + i] = value;
            }
        }
        Ok(matrix)
    }

    pub(crate) fn validate(&self) -> Result<(), Error> {
        let positive = |what, value: f64, finite: bool| {
            if value > 0.0 && (value.is_finite() || !finite) {
                Ok(())
            } else {
                Err(Error::Parameter { what, value, range: "positive" })
            }
        };
        positive("standard deviation", self.sigma, true)?;
        positive("correlation length", self.kernel.length(), true)?;
        positive("taper support", self.taper.support(), false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_and_tapers_at_hand_computed_places() {
        let e = std::f64::consts::E;
        let close = |a: f64, b: f64| assert!((a - b).abs() <= 1e-15, "{a} is not {b}");
        close(Kernel::Gaussian { length: 0.5 }.at(0.5), e.powf(-0.5));
        close(Kernel::Matern12 { length: 0.5 }.at(1.0), e.powi(-2));
        close(Kernel::Matern32 { length: 3.0_f64.sqrt() }.at(1.0), 2.0 / e);
        close(Kernel::Matern52 { length: 5.0_f64.sqrt() }.at(1.0), (7.0 / 3.0) / e);
        close(Taper::Triangle { support: 4.0 }.at(1.0), 0.75);
        // Gaspari & Cohn (4.10) at z = 1: −1/4 + 1/2 + 5/8 − 5/3 + 1 = 5/24; at z = 3/2: 19/1152 (both in
        // fractions).
        close(Taper::GaspariCohn { support: 2.0 }.at(1.0), 5.0 / 24.0);
        close(Taper::GaspariCohn { support: 2.0 }.at(1.5), 19.0 / 1152.0);
        for taper in [Taper::Triangle { support: 2.0 }, Taper::GaspariCohn { support: 2.0 }] {
            close(taper.at(0.0), 1.0);
            assert_eq!(taper.at(2.0), 0.0);
            assert_eq!(taper.at(9.0), 0.0);
            assert!((0..2000).all(|i| taper.at(i as f64 * 1e-3) >= taper.at((i + 1) as f64 * 1e-3) - 1e-15));
        }
        close(correlation(Kernel::Matern12 { length: 1.0 }, Taper::Triangle { support: 2.0 }, 1.0), 0.5 / e);
    }

    #[test]
    fn bad_parameters_are_named() {
        let good = CovarianceFunction {
            sigma: 1.0,
            kernel: Kernel::Gaussian { length: 1.0 },
            taper: Taper::Triangle { support: 1.0 },
        };
        let what = |f: CovarianceFunction| match f.matrix(&[0.0, 1.0]) {
            Err(Error::Parameter { what, .. }) => what,
            other => panic!("{other:?}"),
        };
        assert_eq!(what(CovarianceFunction { sigma: 0.0, ..good }), "standard deviation");
        assert_eq!(what(CovarianceFunction { sigma: f64::NAN, ..good }), "standard deviation");
        assert_eq!(
            what(CovarianceFunction { kernel: Kernel::Matern32 { length: -1.0 }, ..good }),
            "correlation length"
        );
        assert_eq!(
            what(CovarianceFunction { taper: Taper::GaspariCohn { support: 0.0 }, ..good }),
            "taper support"
        );
        assert!(matches!(good.matrix(&[0.0, f64::NAN]), Err(Error::NonFinite { row: 1, column: 0, .. })));
    }

    #[test]
    fn coinciding_known_points_are_refused() {
        let f =
            CovarianceFunction { sigma: 1.0, kernel: Kernel::Gaussian { length: 0.5 }, taper: Taper::None };
        let result = f.conditioned_matrix(&[0.5], &[0.0, 0.0]);
        assert!(matches!(result, Err(Error::KnownPoints { point: 1, .. })), "{result:?}");
        assert!(f.conditioned_matrix(&[0.5], &[0.0, 0.04]).is_ok());
    }
}
