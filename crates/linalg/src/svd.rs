//! Singular values of dense matrices (faer's).

use crate::interrupt::apart;
use crate::{Error, clear_upper_registers};
use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::svd::{ComputeSvdVectors, svd, svd_scratch};
use faer::{Mat, MatRef, Par};

/// The singular value decomposition of an m × n matrix, A vᵢ = sᵢ uᵢ, with k = min(m, n)
/// singular values.
///
/// I + AᵀA has the eigenvalues 1 + sᵢ², and 1 for the v beyond k: right to ε s₁ in s, where the
/// product AᵀA would lose all below √ε s₁.
///
/// ```
/// // one row (3, 4)
/// let svd = varda_linalg::Svd::new(1, 2, &[3.0, 4.0])?;
/// assert!((svd.values[0] - 5.0).abs() < 1e-14);
/// assert!((svd.right[0].abs() - 0.6).abs() < 1e-15 && (svd.right[3].abs() - 0.6).abs() < 1e-15);
/// # Ok::<(), varda_linalg::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Svd {
    /// s, descending.
    pub values: Vec<f64>,
    /// u of the k singular values, one after the other.
    pub left: Vec<f64>,
    /// v, an orthonormal basis of all n vectors, one after the other; the first k belong to the singular
    /// values. Of [`thin`](Self::thin) those k alone.
    pub right: Vec<f64>,
}

impl Svd {
    /// Of the m × n matrix given column by column.
    ///
    /// # Errors
    /// [`Error::Eigen`] if the iteration fails or a value is not finite (an entry is NaN, say);
    /// [`Error::Interrupted`] where it was asked to end.
    ///
    /// # Panics
    /// If `matrix` is not of length m n.
    pub fn new(m: usize, n: usize, matrix: &[f64]) -> Result<Self, Error> {
        if m.min(n) == 0 {
            let right = (0..n * n).map(|i| f64::from(i % (n + 1) == 0)).collect();
            return Ok(Self { values: Vec::new(), left: Vec::new(), right });
        }
        apart(m.min(n), matrix, move |matrix| Self::of(m, n, matrix, ComputeSvdVectors::Full))
    }

    /// As [`new`](Self::new), without the v of no singular value: for m ≪ n in time n m² and memory n m.
    ///
    /// # Errors
    /// As for `new`.
    ///
    /// # Panics
    /// As for `new`.
    pub fn thin(m: usize, n: usize, matrix: &[f64]) -> Result<Self, Error> {
        if m.min(n) == 0 {
            return Ok(Self { values: Vec::new(), left: Vec::new(), right: Vec::new() });
        }
        apart(m.min(n), matrix, move |matrix| Self::of(m, n, matrix, ComputeSvdVectors::Thin))
    }

    fn of(m: usize, n: usize, matrix: &[f64], vectors: ComputeSvdVectors) -> Result<Self, Error> {
        assert_eq!(matrix.len(), m * n, "a {m} × {n} matrix");
        let k = m.min(n);
        if !matrix.iter().all(|entry| entry.is_finite()) {
            return Err(Error::Eigen { dim: k });
        }
        let rights = if matches!(vectors, ComputeSvdVectors::Thin) { k } else { n };
        let (mut values, mut left, mut right) = (Diag::zeros(k), Mat::zeros(m, k), Mat::zeros(n, rights));
        let thin = ComputeSvdVectors::Thin;
        let scratch = svd_scratch::<f64>(m, n, thin, vectors, Par::Seq, Default::default());
        let mut scratch = MemBuffer::new(scratch);
        let done = svd(
            MatRef::from_column_major_slice(matrix, m, n),
            values.as_mut(),
            Some(left.as_mut()),
            Some(right.as_mut()),
            Par::Seq,
            MemStack::new(&mut scratch),
            Default::default(),
        );
        clear_upper_registers();
        let entries = |of: &Mat<f64>| of.col_iter().flat_map(|z| z.iter()).copied().collect::<Vec<f64>>();
        let values: Vec<f64> = values.column_vector().iter().copied().collect();
        let (left, right) = (entries(&left), entries(&right));
        if done.is_ok() && values.iter().chain(&left).chain(&right).all(|x| x.is_finite()) {
            Ok(Self { values, left, right })
        } else {
            Err(Error::Eigen { dim: k })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Svd;

    /// Orthonormal factors that give the matrix back, of any shape.
    #[test]
    fn it_is_a_decomposition() {
        for (m, n) in [(1, 1), (3, 7), (7, 3), (5, 5), (0, 4), (4, 0)] {
            let matrix: Vec<f64> = (0..m * n).map(|i| (1.7 * i as f64 + 0.3).sin()).collect();
            let svd = Svd::new(m, n, &matrix).unwrap();
            assert_eq!((svd.values.len(), svd.right.len()), (m.min(n), n * n));
            for j in 0..n {
                for i in 0..m {
                    let entry: f64 = (0..svd.values.len())
                        .map(|k| svd.left[k * m + i] * svd.values[k] * svd.right[k * n + j])
                        .sum();
                    assert!((entry - matrix[i + j * m]).abs() <= 1e-14, "{m} {n}");
                }
                for l in 0..n {
                    let dot: f64 = (0..n).map(|i| svd.right[j * n + i] * svd.right[l * n + i]).sum();
                    assert!((dot - f64::from(j == l)).abs() <= 1e-14, "{m} {n}");
                }
            }
            let thin = Svd::thin(m, n, &matrix).unwrap();
            let size = svd.values.first().copied().unwrap_or(0.0);
            assert!(thin.values.iter().zip(&svd.values).all(|(a, b)| (a - b).abs() <= 1e-14 * size));
            assert_eq!((thin.values.len(), thin.right.len()), (m.min(n), m.min(n) * n));
            for j in 0..n {
                for i in 0..m {
                    let term = |k: usize| thin.left[k * m + i] * thin.values[k] * thin.right[k * n + j];
                    let entry: f64 = (0..thin.values.len()).map(term).sum();
                    assert!((entry - matrix[i + j * m]).abs() <= 1e-14, "{m} {n}");
                }
            }
            assert!(svd.values.windows(2).all(|s| s[0] >= s[1]));
        }
        assert!(Svd::new(1, 1, &[f64::NAN]).is_err());
    }
}
