//! Patterns of square matrices.

/// Where the entries of a square matrix may be non-zero, and how its values are laid out in a slice.
#[derive(Debug, Clone, PartialEq)]
pub enum Structure {
    /// All n² entries, column by column: entry (i, j) at `i + j n`.
    Dense,
    /// Symmetric with half-bandwidth w; row i of the lower triangle holds columns i−w … i:
    /// entry (i, j), j ≤ i, at `i (w + 1) + (j + w − i)`. Length n (w + 1); entries left of column 0 are zero.
    SymmetricBand {
        /// w: entries with |i − j| > w are zero.
        half_bandwidth: usize,
    },
    /// General with half-bandwidth w; row i holds columns i−w … i+w: entry (i, j) at `i (2w + 1) + (j + w − i)`.
    Band {
        /// w: entries with |i − j| > w are zero.
        half_bandwidth: usize,
    },
    /// Compressed sparse columns: values in the order of `rows`.
    Sparse {
        /// Offsets of the columns, n + 1 of them.
        columns: Vec<usize>,
        /// Row index of every value, ascending within a column.
        rows: Vec<usize>,
    },
}

impl Structure {
    /// Where the diagonal entry (i, i) of an n × n matrix is among its values; `None` where a sparse pattern leaves it out.
    pub fn diagonal(&self, n: usize, i: usize) -> Option<usize> {
        match self {
            Structure::Dense => Some(i * (n + 1)),
            Structure::SymmetricBand { half_bandwidth: w } => Some(i * (w + 1) + w),
            Structure::Band { half_bandwidth: w } => Some(i * (2 * w + 1) + w),
            Structure::Sparse { columns, rows } => {
                let column = &rows[columns[i]..columns[i + 1]];
                column.binary_search(&i).ok().map(|p| columns[i] + p)
            }
        }
    }
}
