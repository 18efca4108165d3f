//! Errors: typed, with the numbers that failed.

/// Why a factorization or an eigenvalue problem failed. Indices count from zero.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// It was asked to end ([`interrupt::within`](crate::interrupt::within)).
    #[error("interrupted")]
    Interrupted,
    /// An entry is NaN or infinite.
    #[error("entry ({row}, {column}) of the matrix is {value}")]
    NonFinite {
        /// Row of the entry.
        row: usize,
        /// Column of the entry.
        column: usize,
        /// The entry.
        value: f64,
    },
    /// The matrix is not symmetric.
    #[error("the matrix is not symmetric: entry ({row}, {column}) is {value:e}, its mirror image {mirror:e}")]
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
    /// Cholesky met a negative pivot.
    #[error(
        "the matrix is not positive definite: pivot {pivot} is {value:.3e}, from a diagonal entry of \
         {diagonal:.3e}"
    )]
    NotPositiveDefinite {
        /// Index of the pivot.
        pivot: usize,
        /// Its value.
        value: f64,
        /// The diagonal entry it started from.
        diagonal: f64,
    },
    /// Cholesky met a pivot that is zero to rounding.
    #[error(
        "the matrix is singular to working precision: pivot {pivot} is {value:.3e}, not above rounding \
         ({tolerance:.3e}) in its diagonal entry of {diagonal:.3e}"
    )]
    Singular {
        /// Index of the pivot.
        pivot: usize,
        /// Its value.
        value: f64,
        /// The diagonal entry it started from.
        diagonal: f64,
        /// The value it had to exceed.
        tolerance: f64,
    },
    /// A product of an iterative method gave values that are not finite.
    #[error("product {iteration} of an iterative method is not finite")]
    NonFiniteProduct {
        /// Index of the iteration.
        iteration: usize,
    },
    /// Conjugate gradients met a direction p with pᵀ A p ≤ 0.
    #[error("the operator is not positive definite: curvature {curvature:e} in iteration {iteration}")]
    NegativeCurvature {
        /// Index of the iteration.
        iteration: usize,
        /// pᵀ A p.
        curvature: f64,
    },
    /// A sparse pattern that is none.
    #[error("a pattern of {n} rows and columns cannot have {what}: {found}")]
    Pattern {
        /// Number of rows and columns.
        n: usize,
        /// What is wrong.
        what: &'static str,
        /// The number that is out of order.
        found: usize,
    },
    /// The symmetric eigenvalue iteration failed, or gave values that are not finite.
    #[error("the eigenvalues of a {dim} × {dim} matrix could not be computed")]
    Eigen {
        /// Size of the matrix.
        dim: usize,
    },
}

impl Error {
    /// Checks the pivot that row `pivot` of a Cholesky factorization was left with after `terms` products.
    ///
    /// At most terms · ε a_ii counts as singular: rounding alone changes the pivot by that much, whatever
    /// its sign (Higham 2002, theorem 10.3).
    pub(crate) fn check_pivot(terms: usize, pivot: usize, value: f64, diagonal: f64) -> Result<(), Error> {
        // the inverse of a subnormal number overflows
        let tolerance = (terms as f64 * f64::EPSILON * diagonal.abs()).max(f64::MIN_POSITIVE);
        if value > tolerance {
            return Ok(());
        }
        // Rounding grows in the pivots of a singular matrix, but not to half of the digits.
        let rounding = value >= -f64::EPSILON.sqrt() * diagonal.abs();
        Err(if rounding {
            Error::Singular { pivot, value, diagonal, tolerance }
        } else {
            Error::NotPositiveDefinite { pivot, value, diagonal }
        })
    }
}
