//! Errors: typed, with the numbers that failed.

/// Why a covariance could not be built. Indices count from zero.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The data do not have the size that was announced, or there are none.
    #[error("{what} has {found} values, expected {expected}")]
    Size {
        /// What was given.
        what: &'static str,
        /// How many values it should have.
        expected: usize,
        /// How many it has.
        found: usize,
    },
    /// A length or a standard deviation is not a positive finite number, a tolerance is not in [0, 1), …
    #[error("{what} = {value:e} is out of range ({range})")]
    Parameter {
        /// Which parameter.
        what: &'static str,
        /// Its value.
        value: f64,
        /// The range it must lie in.
        range: &'static str,
    },
    /// An entry is NaN or infinite.
    #[error("entry ({row}, {column}) of the covariance is {value}")]
    NonFinite {
        /// Row of the entry.
        row: usize,
        /// Column of the entry.
        column: usize,
        /// The entry.
        value: f64,
    },
    /// The kernel is not that of a Markov process along a line.
    #[error("only a Matérn kernel (1/2, 3/2, 5/2) without a taper is Markov along a line")]
    NotMarkov,
    /// Places along a line coincide, are not finite or do not ascend.
    #[error(
        "places along a line must ascend and differ: place {index} is {place:e}, the one before {before:e}"
    )]
    Places {
        /// Index of the place, among the free or among the known ones.
        index: usize,
        /// Where it is.
        place: f64,
        /// Where the one before is.
        before: f64,
    },
    /// The matrix is not symmetric.
    #[error(
        "the covariance is not symmetric: entry ({row}, {column}) is {value:e}, its mirror image {mirror:e}"
    )]
    NotSymmetric {
        /// Row of the entry.
        row: usize,
        /// Column of the entry.
        column: usize,
        /// The entry.
        value: f64,
        /// The entry with row and column exchanged.
        mirror: f64,
    },
    /// Cholesky met a clearly negative pivot: the matrix is no covariance at all.
    #[error(
        "the matrix is not positive definite, so it is no covariance: pivot {pivot} is {value:.3e}, \
         its variance {variance:.3e}"
    )]
    NotPositiveDefinite {
        /// Index of the pivot.
        pivot: usize,
        /// Its value.
        value: f64,
        /// The diagonal entry it started from.
        variance: f64,
    },
    /// Cholesky met a pivot that is zero to rounding: there is no usable Cholesky root and no inverse.
    #[error(
        "the covariance is singular to working precision and has no usable Cholesky root: pivot \
         {pivot} is {value:.3e}, not above rounding in its variance {variance:.3e} ({tolerance:.3e}); \
         localize the kernel with a compact taper (triangle, Gaspari–Cohn), shorten its length, or take a \
         truncated root (eigen or pivoted Cholesky), which needs no inverse"
    )]
    Singular {
        /// Index of the pivot.
        pivot: usize,
        /// Its value.
        value: f64,
        /// The diagonal entry it started from.
        variance: f64,
        /// The value it had to exceed.
        tolerance: f64,
    },
    /// An eigenvalue (or, in a pivoted Cholesky, a remaining variance) is more negative than what is counted
    /// as zero.
    #[error(
        "the matrix is not positive semidefinite, so it is no covariance: {value:e} against a largest of \
         {largest:e}"
    )]
    NotPositiveSemidefinite {
        /// The most negative eigenvalue or remaining variance.
        value: f64,
        /// The largest eigenvalue or variance.
        largest: f64,
    },
    /// Every variance is zero: nothing to estimate.
    #[error("the covariance is zero: it has no direction of positive variance")]
    Zero,
    /// The symmetric eigenvalue iteration failed, or gave values that are not finite.
    #[error("the eigenvalues of a {dim} × {dim} covariance could not be computed")]
    Eigen {
        /// Size of the matrix.
        dim: usize,
    },
    /// Another failure of linear algebra.
    #[error(transparent)]
    LinearAlgebra(varda_linalg::Error),
    /// The known points on which a kernel is conditioned are too close to tell apart, or coincide.
    #[error(
        "known point {point} says nothing new: given the known points before it, its variance \
         (relative to 1) is {value:.3e}; they coincide or lie too close for this kernel"
    )]
    KnownPoints {
        /// Index among the known points.
        point: usize,
        /// The variance left to it by those before it.
        value: f64,
    },
}

impl From<varda_linalg::Error> for Error {
    fn from(error: varda_linalg::Error) -> Self {
        use varda_linalg::Error as Linalg;
        match error {
            Linalg::NonFinite { row, column, value } => Error::NonFinite { row, column, value },
            Linalg::NotPositiveDefinite { pivot, value, diagonal: variance } => {
                Error::NotPositiveDefinite { pivot, value, variance }
            }
            Linalg::Singular { pivot, value, diagonal: variance, tolerance } => {
                Error::Singular { pivot, value, variance, tolerance }
            }
            Linalg::NotSymmetric { row, column, value, mirror } => {
                Error::NotSymmetric { row, column, value, mirror }
            }
            Linalg::Eigen { dim } => Error::Eigen { dim },
            other => Error::LinearAlgebra(other),
        }
    }
}
