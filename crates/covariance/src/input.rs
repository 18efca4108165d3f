//! Checks of what a user hands in.

use crate::error::Error;

/// Size, finiteness and symmetry of a matrix that a user gave.
pub(crate) fn check_matrix(n: usize, matrix: &[f64]) -> Result<(), Error> {
    if n == 0 {
        return Err(Error::Size { what: "the covariance", expected: 1, found: 0 });
    }
    if matrix.len() != n * n {
        return Err(Error::Size { what: "the covariance", expected: n * n, found: matrix.len() });
    }
    if let Some(at) = matrix.iter().position(|value| !value.is_finite()) {
        return Err(Error::NonFinite { row: at / n, column: at % n, value: matrix[at] });
    }
    for row in 0..n {
        for column in 0..row {
            let (value, mirror) = (matrix[row * n + column], matrix[column * n + row]);
            // Products of matrices leave some n ε between the two halves.
            let scale = (matrix[row * n + row].abs() * matrix[column * n + column].abs()).sqrt();
            if !((value - mirror).abs() <= 1e-12 * scale) {
                return Err(Error::NotSymmetric { row, column, value, mirror });
            }
        }
    }
    Ok(())
}

/// max(tolerance, n ε): below n ε of the largest, rounding decides.
pub(crate) fn usable_tolerance(n: usize, tolerance: f64) -> Result<f64, Error> {
    if !(0.0..1.0).contains(&tolerance) {
        return Err(Error::Parameter {
            what: "truncation tolerance",
            value: tolerance,
            range: "at least 0, below 1",
        });
    }
    Ok(tolerance.max(n as f64 * f64::EPSILON))
}

/// Panics unless the two slices of a product have the lengths of its input and output.
pub(crate) fn check_lengths(input: &[f64], input_dim: usize, output: &[f64], output_dim: usize) {
    assert_eq!(input.len(), input_dim, "length of the input vector");
    assert_eq!(output.len(), output_dim, "length of the output vector");
}
