//! Patterns of square matrices.

use crate::Error;

/// Where the entries of a square matrix may be non-zero, and how its values are laid out in a slice.
///
/// ```
/// use varda_linalg::Structure;
///
/// let band = Structure::SymmetricBand { half_bandwidth: 1 };
/// let values = band.values(3, |i, j| if i == j { 2.0 } else { -1.0 });
/// assert_eq!(values, [0.0, 2.0, -1.0, 2.0, -1.0, 2.0]); // row by row, the lower triangle
/// let mut y = [0.0; 3];
/// band.product(&values, &[1.0, 2.0, 3.0], &mut y);
/// assert_eq!(y, [0.0, 0.0, 4.0]);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub enum Structure {
    /// All n² entries, column by column: entry (i, j) at `i + j n`.
    Dense,
    /// Symmetric with half-bandwidth w; row i of the lower triangle holds columns i−w … i: entry (i, j),
    /// j ≤ i, at `i (w + 1) + (j + w − i)`. Length n (w + 1); entries left of column 0 are zero.
    SymmetricBand {
        /// w: entries with |i − j| > w are zero.
        half_bandwidth: usize,
    },
    /// General with half-bandwidth w; row i holds columns i−w … i+w: entry (i, j) at `i (2w + 1) + (j + w
    /// − i)`.
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
    /// General with half-bandwidth 1.
    pub fn tridiagonal() -> Self {
        Structure::Band { half_bandwidth: 1 }
    }

    /// Sparse, with entries where i − j modulo n lies within −w … w: a chain of n unknowns closed to a
    /// ring, each coupled to w neighbours on either side. [`Structure::Dense`] where that is every entry.
    pub fn periodic_band(n: usize, half_bandwidth: usize) -> Self {
        let w = half_bandwidth;
        if 2 * w + 1 >= n {
            return Structure::Dense;
        }
        let column = |j: usize| {
            let mut rows: Vec<usize> = (0..=2 * w).map(|k| (j + n + k - w) % n).collect();
            rows.sort_unstable();
            rows
        };
        let columns = (0..=n).map(|j| j * (2 * w + 1)).collect();
        Structure::Sparse { columns, rows: (0..n).flat_map(column).collect() }
    }

    /// Sparse, with an entry for every pair (row, column), in any order; a pair given twice is one entry. The
    /// diagonal is in it only where it is given.
    ///
    /// ```
    /// use varda_linalg::Structure;
    ///
    /// let arrow = Structure::from_pairs(3, [(0, 0), (1, 1), (2, 2), (2, 0), (2, 1), (0, 2), (1, 2)])?;
    /// assert_eq!(arrow.values_len(3), 7);
    /// assert_eq!(arrow.position(3, 2, 1), Some(3));
    /// # Ok::<(), varda_linalg::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Pattern`] for a row or a column that is not below n.
    pub fn from_pairs(n: usize, pairs: impl IntoIterator<Item = (usize, usize)>) -> Result<Self, Error> {
        let mut pairs: Vec<(usize, usize)> = pairs.into_iter().map(|(i, j)| (j, i)).collect();
        pairs.sort_unstable();
        pairs.dedup();
        if let Some((j, i)) = pairs.iter().find(|(j, i)| *j >= n || *i >= n) {
            return Err(Error::Pattern { n, what: "a row or column out of range", found: *i.max(j) });
        }
        let mut columns = vec![0; n + 1];
        pairs.iter().for_each(|(j, _)| columns[j + 1] += 1);
        (0..n).for_each(|j| columns[j + 1] += columns[j]);
        Ok(Structure::Sparse { columns, rows: pairs.into_iter().map(|(_, i)| i).collect() })
    }

    /// Checks that this is a structure of an n × n matrix. Only a sparse one can fail.
    ///
    /// # Errors
    /// [`Error::Pattern`] unless there are n + 1 offsets, from 0 on and nowhere descending to the number of
    /// rows, and the rows of every column ascend below n.
    pub fn check(&self, n: usize) -> Result<(), Error> {
        let Structure::Sparse { columns, rows } = self else { return Ok(()) };
        let wrong = |what, found| Err(Error::Pattern { n, what, found });
        if columns.len() != n + 1 {
            return wrong("a number of column offsets other than n + 1", columns.len());
        }
        if columns[0] != 0 || columns[n] != rows.len() {
            return wrong("offsets that do not span the rows", columns[n]);
        }
        for (j, offsets) in columns.windows(2).enumerate() {
            let Some(column) = rows.get(offsets[0]..offsets[1]) else {
                return wrong("offsets that descend at column", j);
            };
            if column.windows(2).any(|pair| pair[0] >= pair[1]) || column.last().is_some_and(|i| *i >= n) {
                return wrong("rows that do not ascend below n in column", j);
            }
        }
        Ok(())
    }

    /// Number of values of an n × n matrix of this structure.
    pub fn values_len(&self, n: usize) -> usize {
        match self {
            Structure::Dense => n * n,
            Structure::SymmetricBand { half_bandwidth } => n * (half_bandwidth + 1),
            Structure::Band { half_bandwidth } => n * (2 * half_bandwidth + 1),
            Structure::Sparse { rows, .. } => rows.len(),
        }
    }

    /// Where the diagonal entry (i, i) of an n × n matrix is among its values; `None` where a sparse pattern
    /// leaves it out.
    pub fn diagonal(&self, n: usize, i: usize) -> Option<usize> {
        self.position(n, i, i)
    }

    /// Where entry (i, j) of an n × n matrix is among its values (of a symmetric band, that of its mirror
    /// image too); `None` where it is zero by structure.
    pub fn position(&self, n: usize, i: usize, j: usize) -> Option<usize> {
        match self {
            Structure::Dense => Some(i + j * n),
            Structure::SymmetricBand { half_bandwidth: w } => {
                let (i, j) = (i.max(j), i.min(j));
                (i - j <= *w).then(|| i * (w + 1) + j + w - i)
            }
            Structure::Band { half_bandwidth: w } => {
                (i.abs_diff(j) <= *w).then(|| i * (2 * w + 1) + j + w - i)
            }
            Structure::Sparse { columns, rows } => {
                let column = &rows[columns[j]..columns[j + 1]];
                column.binary_search(&i).ok().map(|p| columns[j] + p)
            }
        }
    }

    /// The entries of column j of an n × n matrix: row and place among the values, rows ascending. Of a
    /// symmetric band all of them, those above the diagonal at the places of their mirror images.
    pub fn column(&self, n: usize, j: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let range = match self {
            Structure::Dense => 0..n,
            Structure::SymmetricBand { half_bandwidth: w } | Structure::Band { half_bandwidth: w } => {
                j.saturating_sub(*w)..(j + w + 1).min(n)
            }
            Structure::Sparse { columns, .. } => columns[j]..columns[j + 1],
        };
        range.map(move |k| match self {
            Structure::Dense => (k, k + j * n),
            Structure::SymmetricBand { half_bandwidth: w } => {
                (k, k.max(j) * (w + 1) + k.min(j) + w - k.max(j))
            }
            Structure::Band { half_bandwidth: w } => (k, k * (2 * w + 1) + j + w - k),
            Structure::Sparse { rows, .. } => (rows[k], k),
        })
    }

    /// The values of the n × n matrix with these entries, asked for where the structure has some: of a
    /// symmetric band j ≤ i.
    ///
    /// ```
    /// let values = varda_linalg::Structure::tridiagonal().values(2, |i, j| (10 * i + j) as f64);
    /// assert_eq!(values, [0.0, 0.0, 1.0, 10.0, 11.0, 0.0]);
    /// ```
    pub fn values(&self, n: usize, entry: impl Fn(usize, usize) -> f64) -> Vec<f64> {
        let mut values = vec![0.0; self.values_len(n)];
        let symmetric = matches!(self, Structure::SymmetricBand { .. });
        for j in 0..n {
            self.column(n, j)
                .filter(|(i, _)| !symmetric || *i >= j)
                .for_each(|(i, p)| values[p] = entry(i, j));
        }
        values
    }

    /// y = A x for the n × n matrix with these values.
    ///
    /// # Panics
    /// If a length does not fit.
    pub fn product(&self, values: &[f64], x: &[f64], y: &mut [f64]) {
        let n = x.len();
        assert!(values.len() == self.values_len(n) && y.len() == n, "lengths differ");
        y.fill(0.0);
        for (j, x) in x.iter().enumerate() {
            self.column(n, j).for_each(|(i, p)| y[i] += values[p] * x);
        }
    }

    /// Groups of columns of an n × n matrix that share no row, each column in one of them: one product of a
    /// matrix with the sum of a group's unit vectors holds every entry of its columns apart (Curtis, Powell
    /// and Reid 1974).
    ///
    /// n groups for a dense matrix, 2w + 1 for a band of half-bandwidth w, symmetric or not. For a sparse one
    /// each column joins the first group that is free: no fewer groups than the fullest row has entries, and
    /// rarely many more.
    ///
    /// ```
    /// use varda_linalg::Structure;
    ///
    /// let groups = Structure::tridiagonal().colouring(5);
    /// assert_eq!(groups, [vec![0, 3], vec![1, 4], vec![2]]);
    /// ```
    ///
    /// # Panics
    /// If a sparse structure is not a pattern of n columns.
    pub fn colouring(&self, n: usize) -> Vec<Vec<usize>> {
        let (columns, rows) = match self {
            Structure::Dense => return (0..n).map(|j| vec![j]).collect(),
            Structure::SymmetricBand { half_bandwidth: w } | Structure::Band { half_bandwidth: w } => {
                let period = 2 * w + 1;
                return (0..period.min(n)).map(|first| (first..n).step_by(period).collect()).collect();
            }
            Structure::Sparse { columns, rows } => (columns, rows),
        };
        // by row, the groups that have an entry there
        let mut taken: Vec<Vec<usize>> = vec![Vec::new(); n];
        let mut groups: Vec<Vec<usize>> = Vec::new();
        let mut barred = Vec::new();
        for j in 0..n {
            let column = &rows[columns[j]..columns[j + 1]];
            column.iter().flat_map(|&i| &taken[i]).for_each(|&g| barred[g] = j + 1);
            let group = barred.iter().position(|&by| by != j + 1).unwrap_or(groups.len());
            if group == groups.len() {
                groups.push(Vec::new());
                barred.push(0);
            }
            groups[group].push(j);
            column.iter().for_each(|&i| taken[i].push(group));
        }
        groups
    }
}
