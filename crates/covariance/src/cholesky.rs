//! The Cholesky factor B = L Lᵀ that the dense covariance and the conditioning share.

use crate::error::Error;

/// Lower Cholesky factor of a symmetric positive definite matrix, n × n row by row, zero above the diagonal.
#[derive(Debug, Clone)]
pub(crate) struct Cholesky {
    n: usize,
    l: Vec<f64>,
}

impl Cholesky {
    /// Factorizes the lower triangle of a matrix of n × n finite values.
    ///
    pub(crate) fn new(n: usize, matrix: &[f64]) -> Result<Self, Error> {
        let mut l = vec![0.0; n * n];
        for i in 0..n {
            let (above, row) = l.split_at_mut(i * n);
            for j in 0..i {
                let partial = dot(&row[..j], &above[j * n..][..j]);
                row[j] = (matrix[i * n + j] - partial) / above[j * n + j];
            }
            let variance = matrix[i * n + i];
            let value = variance - dot(&row[..i], &row[..i]);
            row[i] = usable_pivot(n, i, value, variance)?.sqrt();
        }
        Ok(Self { n, l })
    }

    /// n.
    pub(crate) fn dim(&self) -> usize {
        self.n
    }

    /// x = L v.
    pub(crate) fn product(&self, v: &[f64], x: &mut [f64]) {
        for i in 0..self.n {
            x[i] = dot(self.row(i), &v[..=i]);
        }
    }

    /// v = Lᵀ x.
    pub(crate) fn transpose_product(&self, x: &[f64], v: &mut [f64]) {
        v.fill(0.0);
        for i in 0..self.n {
            add_scaled(x[i], self.row(i), &mut v[..=i]);
        }
    }

    /// y = L Lᵀ x.
    pub(crate) fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.transpose_product(x, y);
        for i in (0..self.n).rev() {
            y[i] = dot(self.row(i), &y[..=i]);
        }
    }

    /// v = L⁻¹ x.
    pub(crate) fn forward(&self, x: &[f64], v: &mut [f64]) {
        for i in 0..self.n {
            let row = self.row(i);
            v[i] = (x[i] - dot(&row[..i], &v[..i])) / row[i];
        }
    }

    /// y = (L Lᵀ)⁻¹ x.
    pub(crate) fn solve(&self, x: &[f64], y: &mut [f64]) {
        self.forward(x, y);
        for i in (0..self.n).rev() {
            let row = self.row(i);
            y[i] /= row[i];
            let y_i = y[i];
            add_scaled(-y_i, &row[..i], &mut y[..i]);
        }
    }

    /// Row i of L up to its diagonal.
    pub(crate) fn row(&self, i: usize) -> &[f64] {
        &self.l[i * self.n..][..=i]
    }
}

/// A pivot that came from `terms` products, if it can be trusted. At most terms · ε b_ii is singular: rounding alone changes it by that much
/// (Higham 2002, theorem 10.3), whatever sign it comes out with.
pub(crate) fn usable_pivot(terms: usize, pivot: usize, value: f64, variance: f64) -> Result<f64, Error> {
    // the inverse of a subnormal number overflows
    let tolerance = (terms as f64 * f64::EPSILON * variance.abs()).max(f64::MIN_POSITIVE);
    if value > tolerance {
        return Ok(value);
    }
    // Rounding grows in the pivots of a singular kernel, but not to half of the digits.
    let rounding = value >= -f64::EPSILON.sqrt() * variance.abs();
    Err(if rounding {
        Error::Singular { pivot, value, variance, tolerance }
    } else {
        Error::NotPositiveDefinite { pivot, value, variance }
    })
}

/// Σ a_i b_i in four running sums: fast, and the same bits every time.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a4, a_rest) = a.as_chunks::<4>();
    let (b4, b_rest) = b.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (p, q) in a4.iter().zip(b4) {
        for k in 0..4 {
            sums[k] += p[k] * q[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(p, q)| p * q).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// y += a x.
pub(crate) fn add_scaled(a: f64, x: &[f64], y: &mut [f64]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += a * x;
    }
}
