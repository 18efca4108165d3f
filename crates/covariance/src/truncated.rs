//! A dense covariance of truncated rank.

use crate::error::Error;
use crate::input::{check_lengths, check_matrix, usable_tolerance};
use crate::operator::Covariance;
use crate::spectrum::Spectrum;
use varda_linalg::{Eigen, axpy, dot_in_lanes};

/// A dense covariance B = U Uᵀ of rank r ≤ n: U is n × r. No inverse; a draw from it lies in the span of
/// U.
///
/// The way to a root of a singular covariance, such as a smooth kernel without a taper.
///
/// ```
/// use varda_covariance::{Covariance, Truncated};
///
/// // two components that always err alike: rank 1
/// let b = Truncated::eigen(2, &[1.0, 1.0, 1.0, 1.0], 1e-10)?;
/// assert_eq!((b.dim(), b.root_dim()), (2, 1));
/// # Ok::<(), varda_covariance::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Truncated {
    n: usize,
    /// U column by column.
    columns: Vec<f64>,
    explained: f64,
}

/// Known points next to each other, as the two of a clamp, take three digits of the kernel.
const KERNEL_ROUNDING: f64 = 1e3;

impl Truncated {
    /// The eigen root of a symmetric positive semidefinite n × n matrix given row by row: with eigenvalues
    /// λ₁ ≥ λ₂ ≥ … and eigenvectors e_k, column k of U is √λ_k e_k, for every λ_k > τ λ₁,
    /// τ = max(`tolerance`, n ε). The best approximation of its rank (Eckart and Young 1936): |B − U
    /// Uᵀ|₂ ≤ τ λ₁.
    ///
    /// # Errors
    ///
    /// [`Error::Parameter`] for a tolerance outside [0, 1); [`Error::Size`], [`Error::NonFinite`],
    /// [`Error::NotSymmetric`] for what is not such a matrix; [`Error::NotPositiveSemidefinite`] for an
    /// eigenvalue below −τ λ₁; [`Error::Zero`] for a zero matrix; [`Error::Eigen`] if the eigenvalue
    /// iteration fails.
    pub fn eigen(n: usize, matrix: &[f64], tolerance: f64) -> Result<Self, Error> {
        let relative = usable_tolerance(n, tolerance)?;
        Self::eigen_above(n, matrix, |largest| [relative * largest.abs(); 2])
    }

    /// The eigen root of a kernel: a symmetric matrix, given row by row, that is `variance` times a
    /// correlation, conditioned on known points or not, so that its entries are right to rounding of
    /// `variance` and no further.
    ///
    /// As [`eigen`](Self::eigen), but that an eigenvalue is refused where it is below that rounding,
    /// −10³ n ε `variance`, whatever conditioning left of the variance, and whatever the tolerance:
    /// no truncation makes a covariance of an indefinite kernel (a Gaussian of the arc of a circle, say).
    ///
    /// # Errors
    ///
    /// As `eigen`.
    pub fn of_kernel(n: usize, matrix: &[f64], tolerance: f64, variance: f64) -> Result<Self, Error> {
        let relative = usable_tolerance(n, tolerance)?;
        let rounding = KERNEL_ROUNDING * n as f64 * f64::EPSILON * variance;
        Self::eigen_above(n, matrix, |largest| [rounding, relative * largest])
    }

    /// The eigenpairs above the second of two bounds that go with the largest eigenvalue; one below minus
    /// the first is refused.
    fn eigen_above(n: usize, matrix: &[f64], bounds: impl Fn(f64) -> [f64; 2]) -> Result<Self, Error> {
        check_matrix(n, matrix)?;
        let Eigen { values, vectors } = Eigen::new(n, matrix)?;
        let (smallest, largest) = (values[0], values[n - 1]);
        let [negative, kept] = bounds(largest);
        if smallest < -negative {
            return Err(Error::NotPositiveSemidefinite { value: smallest, largest });
        }
        if largest <= 0.0 {
            return Err(Error::Zero);
        }
        let mut columns = Vec::new();
        for k in (0..n).rev().take_while(|&k| values[k] > kept) {
            let root = values[k].sqrt();
            columns.extend(vectors[k * n..][..n].iter().map(|z| root * z));
        }
        Ok(Self::from_columns(n, columns, matrix))
    }

    /// The root of a pivoted Cholesky factorization stopped at the rank where no variance left exceeds τ
    /// times the largest variance, τ = max(`tolerance`, n ε) (Higham 2002, section 10.3): |B − U Uᵀ|_ij
    /// ≤ τ max b_ii. Costs n r² against some 10 n³ of `eigen`. The same τ asks for more here, and keeps
    /// a higher rank: it is relative to a variance at one point, where that of `eigen` is relative to λ₁,
    /// up to n times as large.
    ///
    /// # Errors
    ///
    /// As `eigen`, where a remaining variance below −τ max b_ii takes the place of the eigenvalue. A
    /// matrix that is indefinite without showing it on the diagonal is not found out: use `eigen` on data of
    /// doubtful origin.
    pub fn pivoted_cholesky(n: usize, matrix: &[f64], tolerance: f64) -> Result<Self, Error> {
        check_matrix(n, matrix)?;
        let tolerance = usable_tolerance(n, tolerance)?;
        let mut left: Vec<f64> = (0..n).map(|i| matrix[i * n + i]).collect();
        let largest = left.iter().fold(f64::NEG_INFINITY, |a, &b| a.max(b));
        let mut columns: Vec<f64> = Vec::new();
        loop {
            let smallest = left.iter().fold(f64::INFINITY, |a, &b| a.min(b));
            if smallest < -tolerance * largest.abs() {
                return Err(Error::NotPositiveSemidefinite { value: smallest, largest });
            }
            if largest <= 0.0 {
                return Err(Error::Zero);
            }
            let pivot = (1..n).fold(0, |best, i| if left[i] > left[best] { i } else { best });
            if columns.len() == n * n || left[pivot] <= tolerance * largest {
                return Ok(Self::from_columns(n, columns, matrix));
            }
            let root = left[pivot].sqrt();
            let mut column: Vec<f64> = (0..n).map(|i| matrix[i * n + pivot]).collect();
            for earlier in columns.chunks_exact(n) {
                axpy(-earlier[pivot], earlier, &mut column);
            }
            for (left, entry) in left.iter_mut().zip(&mut column) {
                *entry /= root;
                *left -= *entry * *entry;
            }
            left[pivot] = 0.0;
            columns.extend(column);
        }
    }

    /// The eigenvalues of the r × r matrix Uᵀ U, and n − r zeros: O(n r² + r³).
    ///
    /// # Errors
    ///
    /// [`Error::Eigen`] if the eigenvalue iteration fails.
    pub fn spectrum(&self) -> Result<Spectrum, Error> {
        let rank = self.root_dim();
        let column = |k: usize| &self.columns[k * self.n..][..self.n];
        let gram: Vec<f64> =
            (0..rank * rank).map(|ij| dot_in_lanes(column(ij / rank), column(ij % rank))).collect();
        let mut eigenvalues = varda_linalg::eigenvalues(rank, &gram)?;
        eigenvalues.reverse();
        eigenvalues.resize(self.n, 0.0);
        Ok(Spectrum { eigenvalues })
    }

    /// The part of the total variance that was kept: tr(U Uᵀ) / tr B, at most 1 up to rounding.
    pub fn explained_variance(&self) -> f64 {
        self.explained
    }

    fn from_columns(n: usize, columns: Vec<f64>, matrix: &[f64]) -> Self {
        let trace: f64 = (0..n).map(|i| matrix[i * n + i]).sum();
        let explained = dot_in_lanes(&columns, &columns) / trace;
        Self { n, columns, explained }
    }

    fn columns(&self) -> std::slice::ChunksExact<'_, f64> {
        self.columns.chunks_exact(self.n)
    }
}

impl Covariance for Truncated {
    fn dim(&self) -> usize {
        self.n
    }

    fn root_dim(&self) -> usize {
        self.columns.len() / self.n
    }

    fn apply(&self, x: &[f64], y: &mut [f64]) {
        check_lengths(x, self.n, y, self.n);
        y.fill(0.0);
        for column in self.columns() {
            axpy(dot_in_lanes(column, x), column, y);
        }
    }

    fn root(&self, v: &[f64], x: &mut [f64]) {
        check_lengths(v, self.root_dim(), x, self.n);
        x.fill(0.0);
        for (v, column) in v.iter().zip(self.columns()) {
            axpy(*v, column, x);
        }
    }

    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        check_lengths(x, self.n, v, self.root_dim());
        for (v, column) in v.iter_mut().zip(self.columns()) {
            *v = dot_in_lanes(column, x);
        }
    }

    fn variance(&self, variance: &mut [f64]) {
        assert_eq!(variance.len(), self.n, "length of the variance");
        variance.fill(0.0);
        for column in self.columns() {
            for (variance, u) in variance.iter_mut().zip(column) {
                *variance += u * u;
            }
        }
    }
}
