//! A covariance known by a root of full rank, with its inverse.

use crate::Error;
use varda_covariance::{Covariance, Precision};
use varda_linalg::shorter_root;
use varda_linalg::{Svd, axpy, dot};

/// B = U S² Uᵀ from a root of it, W = U S Vᵀ, of n columns or more; its own root is U S.
pub(crate) struct FullRank {
    n: usize,
    /// U, by columns.
    directions: Vec<f64>,
    sizes: Vec<f64>,
}

impl FullRank {
    /// Of a covariance whose root may be of any length.
    ///
    /// # Errors
    /// [`Error::Singular`] where its rank is below n to rounding; a root that is not finite.
    pub(crate) fn new(b: &dyn Covariance) -> Result<Self, Error> {
        let (n, count) = (b.dim(), b.root_dim());
        let (mut unit, mut root) = (vec![0.0; count], vec![0.0; n * count]);
        for (j, column) in root.chunks_exact_mut(n.max(1)).enumerate() {
            unit[j] = 1.0;
            b.root(&unit, column);
            unit[j] = 0.0;
        }
        if count > n {
            root = shorter_root(n, &root)?;
        }
        let Svd { values: sizes, left: directions, .. } = Svd::thin(n, root.len() / n.max(1), &root)?;
        let least = n as f64 * f64::EPSILON * sizes.first().copied().unwrap_or(0.0);
        let rank = sizes.iter().filter(|s| **s > least).count();
        if rank < n {
            return Err(Error::Singular { rank, dim: n });
        }
        Ok(Self { n, directions, sizes })
    }

    /// y = Σ u f(s) (u·x).
    fn along(&self, x: &[f64], y: &mut [f64], f: impl Fn(f64) -> f64) {
        y.fill(0.0);
        for (u, s) in self.directions.chunks_exact(self.n).zip(&self.sizes) {
            axpy(f(*s) * dot(u, x), u, y);
        }
    }

    /// x = Σ u f(s) v.
    fn from(&self, v: &[f64], x: &mut [f64], f: impl Fn(f64) -> f64) {
        x.fill(0.0);
        for ((u, s), v) in self.directions.chunks_exact(self.n).zip(&self.sizes).zip(v) {
            axpy(f(*s) * v, u, x);
        }
    }

    /// v = f(s) (u·x).
    fn onto(&self, x: &[f64], v: &mut [f64], f: impl Fn(f64) -> f64) {
        for ((u, s), v) in self.directions.chunks_exact(self.n).zip(&self.sizes).zip(v) {
            *v = f(*s) * dot(u, x);
        }
    }
}

impl Covariance for FullRank {
    fn dim(&self) -> usize {
        self.n
    }

    fn root_dim(&self) -> usize {
        self.n
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.along(x, y, |s| s * s);
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        self.from(v, x, |s| s);
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.onto(x, v, |s| s);
    }

    fn variance(&self, variance: &mut [f64]) {
        variance.fill(0.0);
        for (u, s) in self.directions.chunks_exact(self.n).zip(&self.sizes) {
            variance.iter_mut().zip(u).for_each(|(v, u)| *v += (u * s).powi(2));
        }
    }
}

impl Precision for FullRank {
    fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.along(x, y, |s| 1.0 / (s * s));
    }

    fn whiten(&self, x: &[f64], v: &mut [f64]) {
        self.onto(x, v, |s| 1.0 / s);
    }

    fn whiten_transpose(&self, v: &[f64], x: &mut [f64]) {
        self.from(v, x, |s| 1.0 / s);
    }
}

#[cfg(test)]
mod tests {
    use super::FullRank;
    use crate::Error;
    use varda_covariance::{Covariance, Ensemble, Localization, Precision};

    fn carried(columns: &[f64]) -> Ensemble {
        Ensemble::from_perturbations(columns, Localization::none(2)).unwrap()
    }

    #[test]
    fn it_is_the_covariance_and_its_inverse() {
        // B = [[2, 1], [1, 5]] from three columns
        let b = carried(&[1.0, 1.0, 1.0, 0.0, 0.0, 2.0]);
        let whole = FullRank::new(&b).unwrap();
        let (mut y, mut back, mut v) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        whole.apply(&[1.0, -1.0], &mut y);
        assert!((y[0] - 1.0).abs() < 1e-14 && (y[1] + 4.0).abs() < 1e-14);
        whole.solve(&y, &mut back);
        assert!((back[0] - 1.0).abs() < 1e-14 && (back[1] + 1.0).abs() < 1e-14);
        whole.whiten(&y, &mut v);
        whole.root(&v, &mut back);
        assert!((back[0] - y[0]).abs() < 1e-14 && (back[1] - y[1]).abs() < 1e-14);
        whole.whiten_transpose(&v, &mut back);
        whole.root_transpose(&back, &mut y);
        assert!((y[0] - v[0]).abs() < 1e-14 && (y[1] - v[1]).abs() < 1e-14);
        whole.variance(&mut y);
        assert!((y[0] - 2.0).abs() < 1e-14 && (y[1] - 5.0).abs() < 1e-14);
    }

    #[test]
    fn a_rank_below_its_size_is_said() {
        let one = FullRank::new(&carried(&[1.0, 2.0]));
        assert!(matches!(one, Err(Error::Singular { rank: 1, dim: 2 })));
        let two = FullRank::new(&carried(&[1.0, 2.0, -2.0, -4.0]));
        assert!(matches!(two, Err(Error::Singular { rank: 1, dim: 2 })));
    }
}
