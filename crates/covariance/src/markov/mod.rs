//! Matérn fields along a line in O(n): the Cholesky root as a recursion with one to three states a point.

mod motion;
mod passes;
mod triangle;

use crate::error::Error;
use crate::input::check_lengths;
use crate::kernel::{CovarianceFunction, Taper};
use crate::operator::{Covariance, Precision};
use motion::Motion;
use triangle::Square;

/// The covariance of a Matérn kernel without a taper at places along a line, conditioned on places without
/// error, for any spacing: B = L Lᵀ with the Cholesky root L of the dense matrix, in O(n).
///
/// A Matérn field with ν = p + 1/2 is the first of p + 1 states of a linear stochastic differential
/// equation driven by white noise, z = (f, f′/λ, …), λ = √(2ν)/L (Hartikainen and Särkkä 2010).
/// From one place to the next
///
/// ```text
/// z_k = Φ_k z_{k−1} + q_k,    q_k ~ N(0, Q_k),    Φ_k = exp(F λ (s_k − s_{k−1}))
/// ```
///
/// Places without error are met beforehand by a sweep backward, which turns Φ_k and Q_k into those of the
/// field that goes through them. A Kalman filter that observes every f_k exactly then leaves one number of
/// noise a place, and x = L v is
///
/// ```text
/// z_k = T_k z_{k−1} + g_k v_k,    x_k = (z_k)₀
/// ```
///
/// with products with Lᵀ, L⁻¹ and L⁻ᵀ by the same numbers. All roots of covariances are carried as
/// triangles and joined by reflections (Kailath, Sayed and Hassibi 2000, chapter 12), so that nothing is
/// subtracted: there is a root at correlation lengths a thousand times the line, where the matrix is
/// singular to working precision. Twelve numbers a place are kept.
///
/// ```
/// use varda_covariance::{Covariance, CovarianceFunction, Kernel, Markov, Taper};
///
/// // one metre held at its two ends, in 10 000 parts
/// let kernel = Kernel::Matern52 { length: 0.3 };
/// let function = CovarianceFunction { sigma: 0.01, kernel, taper: Taper::None };
/// let free: Vec<f64> = (1..10_000).map(|i| 1e-4 * i as f64).collect();
/// let b = Markov::new(&function, &free, &[0.0, 1.0])?;
///
/// let mut variance = vec![0.0; b.dim()];
/// b.variance(&mut variance);
/// // held in its place, not in its slope: σ² (1 − k²) = 1.9e-7 σ² a tenth of a millimetre away
/// assert!(variance[0] < 1e-6 * variance[4999]);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Markov {
    places: Vec<Place>,
    /// The least ratio of a pivot of the Cholesky factorization to the variance before it.
    least_pivot: f64,
}

/// From the place before to this one.
#[derive(Debug, Clone)]
struct Place {
    /// T.
    transition: Square,
    /// g; its first entry is the diagonal entry of L.
    gain: [f64; 3],
}

impl Markov {
    /// The covariance at the places `free`, which ascend, of a field that is known exactly (zero error) at
    /// the places `known`, in any order \[m, or the unit of the correlation length\].
    ///
    /// # Errors
    ///
    /// [`Error::NotMarkov`] for a Gaussian kernel or a taper; [`Error::Parameter`] for σ or L that is not
    /// positive; [`Error::Size`] without a free place; [`Error::Places`] for places that are not finite, do
    /// not ascend, or that coincide with each other or with known ones, to the resolution of the kernel.
    pub fn new(function: &CovarianceFunction, free: &[f64], known: &[f64]) -> Result<Self, Error> {
        function.validate()?;
        let motion = match (Motion::of(function.kernel), function.taper) {
            (Some(motion), Taper::None) => motion,
            _ => return Err(Error::NotMarkov),
        };
        if free.is_empty() {
            return Err(Error::Size { what: "the covariance", expected: 1, found: 0 });
        }
        let places = passes::places(&motion, free, known)?;
        let mut b = Markov { places, least_pivot: f64::INFINITY };
        let mut variance = vec![0.0; free.len()];
        b.variance(&mut variance);
        for (i, (place, variance)) in b.places.iter_mut().zip(&variance).enumerate() {
            let pivot = place.gain[0] * place.gain[0];
            if !(pivot >= f64::MIN_POSITIVE) {
                let before = if i == 0 { free[0] } else { free[i - 1] };
                return Err(Error::Places { index: i, place: free[i], before });
            }
            b.least_pivot = b.least_pivot.min(pivot / variance);
            place.gain.iter_mut().for_each(|g| *g *= function.sigma);
        }
        Ok(b)
    }

    /// Whether B is positive definite to working precision: every pivot of its Cholesky factorization is
    /// above n ε of its variance. Otherwise the root and B are as good as ever, but what the inverse gives
    /// is determined by rounding.
    pub fn is_well_determined(&self) -> bool {
        self.least_pivot > self.places.len() as f64 * f64::EPSILON
    }

    /// x ← L x.
    fn root_in_place(&self, x: &mut [f64]) {
        let mut z = [0.0; 3];
        for (place, x) in self.places.iter().zip(x) {
            z = triangle::product(&place.transition, z);
            for (z, g) in z.iter_mut().zip(place.gain) {
                *z += g * *x;
            }
            *x = z[0];
        }
    }

    /// x ← Lᵀ x.
    fn transpose_in_place(&self, x: &mut [f64]) {
        let mut w = [0.0; 3];
        for (place, x) in self.places.iter().zip(x).rev() {
            w[0] += *x;
            *x = triangle::dot(place.gain, w);
            w = triangle::transpose_product(&place.transition, w);
        }
    }

    /// x ← L⁻¹ x.
    fn whiten_in_place(&self, x: &mut [f64]) {
        let mut z = [0.0; 3];
        for (place, x) in self.places.iter().zip(x) {
            z = triangle::product(&place.transition, z);
            let v = (*x - z[0]) / place.gain[0];
            z = [*x, z[1] + place.gain[1] * v, z[2] + place.gain[2] * v];
            *x = v;
        }
    }

    /// x ← L⁻ᵀ x.
    fn whiten_transpose_in_place(&self, x: &mut [f64]) {
        let mut w = [0.0; 3];
        for (place, x) in self.places.iter().zip(x).rev() {
            *x = (*x - triangle::dot(place.gain, w)) / place.gain[0];
            w[0] += *x;
            w = triangle::transpose_product(&place.transition, w);
        }
    }

    fn copied(&self, from: &[f64], to: &mut [f64]) {
        check_lengths(from, self.places.len(), to, self.places.len());
        to.copy_from_slice(from);
    }
}

impl Covariance for Markov {
    fn dim(&self) -> usize {
        self.places.len()
    }

    fn root_dim(&self) -> usize {
        self.places.len()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.copied(x, y);
        self.transpose_in_place(y);
        self.root_in_place(y);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        self.copied(v, x);
        self.root_in_place(x);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.copied(x, v);
        self.transpose_in_place(v);
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.dim(), "length of the variance");
        let mut p = Square::default();
        for (place, variance) in self.places.iter().zip(variance) {
            p = triangle::between(&place.transition, &p);
            for (row, a) in p.iter_mut().zip(place.gain) {
                for (p, b) in row.iter_mut().zip(place.gain) {
                    *p += a * b;
                }
            }
            *variance = p[0][0];
        }
    }
}

impl Precision for Markov {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.copied(x, y);
        self.whiten_in_place(y);
        self.whiten_transpose_in_place(y);
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        self.copied(x, v);
        self.whiten_in_place(v);
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        self.copied(v, x);
        self.whiten_transpose_in_place(x);
    }
}
