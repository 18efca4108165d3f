//! Eigenvalues of dense symmetric matrices (faer's).

use crate::interrupt::apart;
use crate::{Error, clear_upper_registers};
use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::{Mat, MatRef, Par};

/// Eigenvalues and orthonormal eigenvectors of a symmetric matrix: A zᵢ = μᵢ zᵢ.
///
/// ```
/// let eigen = varda_linalg::Eigen::new(2, &[2.0, 1.0, 1.0, 2.0])?;
/// // A z = 3 z for the last of them
/// let z = &eigen.vectors[2..];
/// assert!((2.0 * z[0] + z[1] - eigen.values[1] * z[0]).abs() < 1e-15);
/// # Ok::<(), varda_linalg::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Eigen {
    /// μ, ascending.
    pub values: Vec<f64>,
    /// z, one after the other.
    pub vectors: Vec<f64>,
}

impl Eigen {
    /// Of the n × n matrix whose lower triangle is given column by column (the upper one, if row by row).
    ///
    /// Some 9 n³ operations. The eigenvalues are right to n ε of the largest in magnitude; those far
    /// smaller have no correct digits.
    ///
    /// ```
    /// let eigen = varda_linalg::Eigen::new(2, &[2.0, 1.0, 1.0, 2.0])?;
    /// assert!((eigen.values[0] - 1.0).abs() < 1e-15 && (eigen.values[1] - 3.0).abs() < 1e-15);
    /// # Ok::<(), varda_linalg::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Eigen`] if the iteration fails or a value is not finite (an entry is NaN, say);
    /// [`Error::Interrupted`] where it was asked to end.
    ///
    /// # Panics
    /// If `matrix` is not of length n².
    pub fn new(n: usize, matrix: &[f64]) -> Result<Self, Error> {
        apart(n, matrix, move |matrix| {
            let mut vectors = Mat::zeros(n, n);
            let values = evd(n, matrix, Some(&mut vectors))?;
            let vectors: Vec<f64> = vectors.col_iter().flat_map(|z| z.iter()).copied().collect();
            if vectors.iter().all(|z| z.is_finite()) {
                Ok(Self { values, vectors })
            } else {
                Err(Error::Eigen { dim: n })
            }
        })
    }
}

/// The eigenvalues of a symmetric matrix, ascending, at half the cost of [`Eigen::new`] or less.
///
/// ```
/// let values = varda_linalg::eigenvalues(2, &[2.0, 1.0, 1.0, 2.0])?;
/// assert!((values[0] - 1.0).abs() < 1e-15 && (values[1] - 3.0).abs() < 1e-15);
/// # Ok::<(), varda_linalg::Error>(())
/// ```
///
/// # Errors
/// As for [`Eigen::new`].
///
/// # Panics
/// As for [`Eigen::new`].
pub fn eigenvalues(n: usize, matrix: &[f64]) -> Result<Vec<f64>, Error> {
    apart(n, matrix, move |matrix| evd(n, matrix, None))
}

fn evd(n: usize, matrix: &[f64], vectors: Option<&mut Mat<f64>>) -> Result<Vec<f64>, Error> {
    // faer's estimate of its work space for no rows is below zero
    if n == 0 {
        assert!(matrix.is_empty(), "a 0 × 0 matrix");
        return Ok(Vec::new());
    }
    let matrix = MatRef::from_column_major_slice(matrix, n, n);
    let compute = if vectors.is_some() { ComputeEigenvectors::Yes } else { ComputeEigenvectors::No };
    let mut values = Diag::zeros(n);
    let mut scratch =
        MemBuffer::new(self_adjoint_evd_scratch::<f64>(n, compute, Par::Seq, Default::default()));
    let done = self_adjoint_evd(
        matrix,
        values.as_mut(),
        vectors.map(|vectors| vectors.as_mut()),
        Par::Seq,
        MemStack::new(&mut scratch),
        Default::default(),
    );
    clear_upper_registers();
    let values: Vec<f64> = values.column_vector().iter().copied().collect();
    // The decomposition of a matrix with a NaN is Ok and NaN.
    if done.is_ok() && values.iter().all(|value| value.is_finite()) {
        Ok(values)
    } else {
        Err(Error::Eigen { dim: n })
    }
}
