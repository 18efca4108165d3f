//! A covariance of compact support along a line: B and its Cholesky root are bands.

use crate::error::Error;
use crate::input::check_lengths;
use crate::kernel::CovarianceFunction;
use crate::operator::{Covariance, Precision};
use varda_linalg::band::Cholesky;
use varda_linalg::dot_in_lanes;

/// A covariance whose entries vanish further than w places from the diagonal, kept as its lower Cholesky
/// factor, B = L Lᵀ, B^{1/2} = L, which vanishes there too (Golub and Van Loan 2013, section 4.3).
///
/// n (w + 1) numbers and n w² operations to build, n w for every product: linear in n for points of a given
/// density. The same B as a [`Dense`](crate::Dense) one takes n² and n³/3.
///
/// ```
/// use varda_covariance::{Banded, Covariance, CovarianceFunction, Kernel, Taper};
///
/// let places: Vec<f64> = (0..100_000).map(|i| 0.01 * i as f64).collect();
/// let taper = Taper::GaspariCohn { support: 0.1 };
/// let b = CovarianceFunction { sigma: 2.0, kernel: Kernel::Matern32 { length: 0.05 }, taper };
/// let b = Banded::along(&b, &places)?;
/// // ten points in the support, where rounding puts one at its very end
/// assert!(b.dim() == 100_000 && b.half_bandwidth() <= 10);
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Banded {
    factor: Cholesky,
}

impl Banded {
    /// The covariance function at places that ascend along a line. The band is as wide as the support of its
    /// taper asks for.
    ///
    /// # Errors
    ///
    /// [`Error::Parameter`] for σ, L or L_loc that is not positive, a taper without a finite support, or a
    /// place that does not ascend; [`Error::NonFinite`], [`Error::Singular`], [`Error::NotPositiveDefinite`]
    /// as [`Dense::new`](crate::Dense::new).
    pub fn along(function: &CovarianceFunction, places: &[f64]) -> Result<Self, Error> {
        function.validate()?;
        let support = function.taper.support();
        if !support.is_finite() {
            return Err(Error::Parameter {
                what: "taper support of a band",
                value: support,
                range: "finite",
            });
        }
        if let Some(pair) = places.windows(2).find(|pair| !(pair[0] <= pair[1])) {
            return Err(Error::Parameter {
                what: "place along the line",
                value: pair[1],
                range: "ascending",
            });
        }
        let first = |i: usize| places.partition_point(|s| places[i] - s >= support).min(i);
        let w = (0..places.len()).map(|i| i - first(i)).max().unwrap_or(0);
        let mut band = vec![0.0; places.len() * (w + 1)];
        for i in 0..places.len() {
            for j in first(i)..=i {
                let d = places[i] - places[j];
                let correlation = crate::kernel::correlation(function.kernel, function.taper, d);
                band[i * (w + 1) + w + j - i] = function.sigma * function.sigma * correlation;
            }
        }
        Self::new(places.len(), w, band)
    }

    /// From the lower band of a symmetric positive definite matrix: row i holds columns i − w … i, entry
    /// (i, j) at `i (w + 1) + w + j − i`. Entries left of column 0 are not read.
    ///
    /// # Errors
    ///
    /// [`Error::Size`], [`Error::NonFinite`], [`Error::Singular`], [`Error::NotPositiveDefinite`] as
    /// [`Dense::new`](crate::Dense::new).
    pub fn new(n: usize, half_bandwidth: usize, band: Vec<f64>) -> Result<Self, Error> {
        let w = half_bandwidth;
        if n == 0 || band.len() != n * (w + 1) {
            let expected = n.max(1) * (w + 1);
            return Err(Error::Size { what: "the band of the covariance", expected, found: band.len() });
        }
        Ok(Self { factor: Cholesky::new(w, band)? })
    }

    /// w: entries further than this from the diagonal are zero.
    pub fn half_bandwidth(&self) -> usize {
        self.factor.half_bandwidth()
    }
}

impl Covariance for Banded {
    fn dim(&self) -> usize {
        self.factor.dim()
    }

    fn root_dim(&self) -> usize {
        self.factor.dim()
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.dim(), y, self.dim());
        self.factor.apply(x, y);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.dim(), x, self.dim());
        self.factor.product(v, x);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.dim());
        self.factor.transpose_product(x, v);
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.dim(), "length of the variance");
        for (i, variance) in variance.iter_mut().enumerate() {
            let (_, row) = self.factor.row(i);
            *variance = dot_in_lanes(row, row);
        }
    }
}

impl Precision for Banded {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.dim(), y, self.dim());
        y.copy_from_slice(x);
        self.factor.solve(y);
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.dim(), v, self.dim());
        v.copy_from_slice(x);
        self.factor.forward(v);
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.dim(), x, self.dim());
        x.copy_from_slice(v);
        self.factor.backward(x);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Dense, Kernel, Taper};

    fn function(taper: Taper) -> CovarianceFunction {
        CovarianceFunction { sigma: 0.7, kernel: Kernel::Gaussian { length: 0.3 }, taper }
    }

    /// Unequal places, two of them further apart than the support.
    fn places() -> Vec<f64> {
        (0..40)
            .map(|i| 0.05 * i as f64 + 0.02 * (3.0 * i as f64).sin() + if i > 25 { 1.0 } else { 0.0 })
            .collect()
    }

    #[test]
    fn the_same_covariance_as_a_dense_one() {
        for taper in [Taper::Triangle { support: 0.33 }, Taper::GaspariCohn { support: 0.5 }] {
            let f = function(taper);
            let places = places();
            let (band, dense) =
                (Banded::along(&f, &places).unwrap(), Dense::new(40, &f.matrix(&places).unwrap()).unwrap());
            assert!((5..15).contains(&band.half_bandwidth()), "{}", band.half_bandwidth());
            let x: Vec<f64> = (0..40).map(|i| (1.7 * i as f64).sin()).collect();
            let (mut a, mut b) = (vec![0.0; 40], vec![0.0; 40]);
            let mut same = |what: &str, product: &dyn Fn(&dyn Precision, &mut [f64]), tolerance: f64| {
                product(&band, &mut a);
                product(&dense, &mut b);
                let size = b.iter().fold(0.0_f64, |m, b| m.max(b.abs()));
                let gap = a.iter().zip(&b).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs()));
                assert!(gap <= tolerance * size, "{what}: {gap:e} of {size:e}");
            };
            // B = L Lᵀ is kept to ε; L itself, its inverse and B⁻¹ to ε times a condition of up to
            // some 1e5
            same("apply", &|c, y| c.apply(&x, y), 1e-14);
            same("root", &|c, y| c.root(&x, y), 1e-11);
            same("root_transpose", &|c, y| c.root_transpose(&x, y), 1e-11);
            same("variance", &|c, y| c.variance(y), 1e-14);
            same("solve", &|c, y| c.solve(&x, y), 1e-9);
            same("whiten", &|c, y| c.whiten(&x, y), 1e-10);
            same("whiten_transpose", &|c, y| c.whiten_transpose(&x, y), 1e-10);
        }
    }

    #[test]
    fn a_2_by_2_by_hand() {
        // [[4, 2], [2, 5]] = L Lᵀ with L = [[2, 0], [1, 2]]; what lies left of column 0 is not read
        let b = Banded::new(2, 1, vec![f64::NAN, 4.0, 2.0, 5.0]).unwrap();
        let mut out = [0.0; 2];
        b.root(&[1.0, 1.0], &mut out);
        assert_eq!(out, [2.0, 3.0]);
        b.solve(&[2.0, -3.0], &mut out);
        assert_eq!(out, [1.0, -1.0]);
    }

    #[test]
    fn bad_bands_are_typed_errors() {
        let f = function(Taper::Triangle { support: 0.5 });
        let along = |places: &[f64]| Banded::along(&f, places).unwrap_err();
        assert!(matches!(along(&[0.0, 0.2, 0.1]), Error::Parameter { what: "place along the line", .. }));
        assert!(matches!(along(&[0.0, f64::NAN]), Error::Parameter { what: "place along the line", .. }));
        assert!(matches!(along(&[0.0, 0.2, 0.2]), Error::Singular { pivot: 2, .. }));
        assert!(matches!(along(&[]), Error::Size { .. }));
        let endless = Banded::along(&function(Taper::None), &[0.0, 1.0]);
        assert!(matches!(endless, Err(Error::Parameter { what: "taper support of a band", .. })));
        assert!(matches!(
            Banded::new(2, 1, vec![0.0, 1.0, 2.0, 1.0]),
            Err(Error::NotPositiveDefinite { pivot: 1, .. })
        ));
        assert!(matches!(
            Banded::new(2, 1, vec![0.0, 1.0, f64::NAN, 1.0]),
            Err(Error::NonFinite { row: 1, column: 0, .. })
        ));
        assert!(matches!(Banded::new(2, 1, vec![1.0; 3]), Err(Error::Size { expected: 4, found: 3, .. })));
    }
}
