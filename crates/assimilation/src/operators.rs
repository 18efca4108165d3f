//! Linear observation operators.

use crate::Error;
use varda_implicit::{At, ObservationOperator, Refusal};

/// y = H x + c with a sparse matrix H (rows × length of the state) and c = 0 unless given.
///
/// # Panics
/// Its methods panic if a slice has the wrong length.
pub struct LinearObservation {
    state_dim: usize,
    /// Row i holds the entries from `starts[i]` to `starts[i + 1]`.
    starts: Vec<usize>,
    /// Column and value of each entry, row after row.
    entries: Vec<(usize, f64)>,
    /// c.
    known: Vec<f64>,
}

impl LinearObservation {
    /// From entries (row, column, value) in any order; those that name the same place add up.
    ///
    /// # Errors
    /// An entry outside of `rows` × `state_dim` or not finite.
    pub fn new(rows: usize, state_dim: usize, entries: &[(usize, usize, f64)]) -> Result<Self, Error> {
        let bad = |&&(i, j, h): &&(usize, usize, f64)| !(i < rows && j < state_dim && h.is_finite());
        if let Some(&(row, column, value)) = entries.iter().find(bad) {
            return Err(Error::OperatorEntry { row, rows, column, columns: state_dim, value });
        }
        let mut sorted = entries.to_vec();
        sorted.sort_by_key(|&(i, j, _)| (i, j));
        let starts = (0..=rows).map(|i| sorted.partition_point(|entry| entry.0 < i)).collect();
        let entries = sorted.into_iter().map(|(_, j, h)| (j, h)).collect();
        Ok(Self { state_dim, starts, entries, known: vec![0.0; rows] })
    }

    /// With c, what is seen of a state of zeros.
    ///
    /// # Panics
    /// If `known` has not one number for each row.
    pub fn plus(self, known: Vec<f64>) -> Self {
        assert_eq!(known.len(), self.known.len(), "one number a row");
        Self { known, ..self }
    }

    /// The entries of H, row by row.
    fn rows(&self) -> impl Iterator<Item = &[(usize, f64)]> {
        self.starts.windows(2).map(|row| &self.entries[row[0]..row[1]])
    }
}

impl ObservationOperator for LinearObservation {
    fn dim(&self) -> usize {
        self.starts.len() - 1
    }

    fn state_dim(&self) -> usize {
        self.state_dim
    }

    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.tangent(at, x, x, y);
        y.iter_mut().zip(&self.known).for_each(|(y, c)| *y += c);
        Ok(())
    }

    fn tangent(&mut self, _at: At, _x: &[f64], dx: &[f64], dy: &mut [f64]) {
        assert!(dx.len() == self.state_dim && dy.len() == self.dim(), "lengths of dx and dy");
        for (row, dy) in self.rows().zip(dy) {
            *dy = row.iter().map(|&(j, h)| h * dx[j]).sum();
        }
    }

    fn adjoint_add(&mut self, _at: At, _x: &[f64], dy: &[f64], dx: &mut [f64]) {
        assert!(dx.len() == self.state_dim && dy.len() == self.dim(), "lengths of dx and dy");
        for (row, dy) in self.rows().zip(dy) {
            for &(j, h) in row {
                dx[j] += h * dy;
            }
        }
    }

    fn has_second_derivatives(&self) -> bool {
        true
    }
}

/// y_i = x_{c_i}: some components of the state, seen directly.
///
/// # Panics
/// Its methods panic if a slice has the wrong length.
pub struct Selection {
    components: Vec<usize>,
    state_dim: usize,
}

impl Selection {
    /// The given components of a state of length `state_dim`, in the given order.
    ///
    /// # Errors
    /// A component the state does not have.
    pub fn new(components: Vec<usize>, state_dim: usize) -> Result<Self, Error> {
        match components.iter().position(|&c| c >= state_dim) {
            Some(row) => {
                let (rows, column) = (components.len(), components[row]);
                Err(Error::OperatorEntry { row, rows, column, columns: state_dim, value: 1.0 })
            }
            None => Ok(Self { components, state_dim }),
        }
    }
}

impl ObservationOperator for Selection {
    fn dim(&self) -> usize {
        self.components.len()
    }

    fn state_dim(&self) -> usize {
        self.state_dim
    }

    fn observe(&mut self, at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        self.tangent(at, x, x, y);
        Ok(())
    }

    fn tangent(&mut self, _at: At, _x: &[f64], dx: &[f64], dy: &mut [f64]) {
        assert!(dx.len() == self.state_dim && dy.len() == self.dim(), "lengths of dx and dy");
        for (dy, &c) in dy.iter_mut().zip(&self.components) {
            *dy = dx[c];
        }
    }

    fn adjoint_add(&mut self, _at: At, _x: &[f64], dy: &[f64], dx: &mut [f64]) {
        assert!(dx.len() == self.state_dim && dy.len() == self.dim(), "lengths of dx and dy");
        for (dy, &c) in dy.iter().zip(&self.components) {
            dx[c] += dy;
        }
    }

    fn has_second_derivatives(&self) -> bool {
        true
    }
}
