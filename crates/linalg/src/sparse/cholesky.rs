//! Π A Πᵀ = L Lᵀ.

use crate::vector::dot;
use crate::{Error, Structure, clear_upper_registers};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Par, Side};

/// In which order the rows of a sparse matrix are eliminated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ordering {
    /// As they are: for chains and other narrow bands.
    Natural,
    /// By approximate minimum degree (Amestoy, Davis and Duff 1996): for grids in two and more dimensions.
    MinimumDegree,
}

/// The Cholesky factor of a sparse symmetric positive definite matrix, Π A Πᵀ = L Lᵀ with a permutation
/// Π: (Π x)_k = x_{p(k)}.
///
/// Vectors of A are in its own order, those between L and Lᵀ in the order of elimination. R = Πᵀ L is a
/// square root of A, A = R Rᵀ, and R⁻ᵀ one of its inverse.
///
/// When to use: precision matrices and discretized elliptic operators. For a band along a line
/// [`band::Cholesky`](crate::band::Cholesky) is simpler and faster.
///
/// Cost: on a grid of n points in two dimensions some 10 n^{3/2} operations and 5 n log₂ n numbers;
/// products and solves allocate nothing.
///
/// ```
/// use varda_linalg::Structure;
/// use varda_linalg::sparse::{Cholesky, Ordering};
///
/// let arrow = Structure::from_pairs(3, [(0, 0), (1, 1), (2, 2), (2, 0), (0, 2), (2, 1), (1, 2)])?;
/// let values = arrow.values(3, |i, j| if i == j { 4.0 } else { 1.0 });
/// let factor = Cholesky::new(3, &arrow, &values, Ordering::MinimumDegree)?;
/// let mut x = [5.0, 5.0, 6.0];
/// factor.solve(&mut x);
/// assert!(x.iter().all(|x| (x - 1.0).abs() < 1e-15));
/// # Ok::<(), varda_linalg::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Cholesky {
    columns: Vec<usize>,
    rows: Vec<usize>,
    values: Vec<f64>,
    /// p.
    order: Vec<usize>,
    /// One place of every cycle of p that moves something.
    cycles: Vec<usize>,
}

impl Cholesky {
    /// Factorizes a matrix of any [`Structure`], of which the upper triangle is read.
    ///
    /// # Errors
    /// [`Error::Pattern`] for a broken structure, [`Error::NonFinite`] for an entry, [`Error::Singular`] or
    /// [`Error::NotPositiveDefinite`] for a pivot that is not above rounding of its diagonal entry.
    ///
    /// # Panics
    /// If there are not as many values as the structure has.
    pub fn new(n: usize, structure: &Structure, values: &[f64], ordering: Ordering) -> Result<Self, Error> {
        structure.check(n)?;
        assert_eq!(values.len(), structure.values_len(n), "values of the structure");
        let (mut columns, mut rows, mut upper) = (vec![0], Vec::new(), Vec::new());
        let mut diagonal = vec![0.0; n];
        for j in 0..n {
            for (i, place) in structure.column(n, j).take_while(|(i, _)| *i <= j) {
                let value = values[place];
                if !value.is_finite() {
                    return Err(Error::NonFinite { row: i, column: j, value });
                }
                if i == j {
                    diagonal[j] = value;
                }
                rows.push(i);
                upper.push(value);
            }
            columns.push(rows.len());
        }
        // The upper triangle alone: faer takes a matrix in natural order for that, whatever else it holds.
        let pattern = SymbolicSparseColMatRef::new_checked(n, n, &columns, None, &rows);
        let ordering = match ordering {
            Ordering::Natural => SymmetricOrdering::Identity,
            Ordering::MinimumDegree => SymmetricOrdering::Amd,
        };
        let simplicial = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SIMPLICIAL,
            ..Default::default()
        };
        let symbolic: SymbolicCholesky<usize> =
            factorize_symbolic_cholesky(pattern, Side::Upper, ordering, simplicial)
                .expect("room for the symbolic factor");
        let SymbolicCholeskyRaw::Simplicial(shape) = symbolic.raw() else {
            unreachable!("a simplicial factorization was asked for")
        };
        let order = match symbolic.perm() {
            Some(permutation) => permutation.arrays().0.to_vec(),
            None => (0..n).collect(),
        };
        let mut factor = Self {
            columns: shape.col_ptr().to_vec(),
            rows: shape.row_idx().to_vec(),
            values: vec![0.0; shape.len_val()],
            cycles: cycles(&order),
            order,
        };
        let scratch = symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let made = symbolic.factorize_numeric_llt(
            &mut factor.values,
            SparseColMatRef::new(pattern, &upper),
            Side::Upper,
            Default::default(),
            Par::Seq,
            MemStack::new(&mut MemBuffer::new(scratch)),
            Default::default(),
        );
        clear_upper_registers();
        // faer counts the pivot that failed from one
        let stopped = made.err().map(|LltError::NonPositivePivot { index }| index - 1);
        factor.check_pivots(&diagonal, stopped)?;
        Ok(factor)
    }

    /// Every pivot must be above rounding of its diagonal entry; row `stopped` has no pivot yet.
    fn check_pivots(&self, diagonal: &[f64], stopped: Option<usize>) -> Result<(), Error> {
        let n = self.dim();
        let last = stopped.map_or(n, |k| k + 1);
        // by row of L, the number of its entries and the sum of the squares left of the diagonal
        let (mut terms, mut squares) = (vec![1; n], vec![0.0; n]);
        for j in 0..last {
            for p in self.columns[j] + 1..self.columns[j + 1] {
                let i = self.rows[p];
                terms[i] += 1;
                if i < last {
                    squares[i] += self.values[p] * self.values[p];
                }
            }
        }
        for k in 0..last {
            let (pivot, own) = (self.order[k], self.values[self.columns[k]]);
            let value = if stopped == Some(k) { diagonal[pivot] - squares[k] } else { own * own };
            Error::check_pivot(terms[k], pivot, value, diagonal[pivot])?;
            if stopped == Some(k) {
                // positive by this sum, not by the other
                return Err(Error::Singular { pivot, value, diagonal: diagonal[pivot], tolerance: value });
            }
        }
        Ok(())
    }

    /// n.
    pub fn dim(&self) -> usize {
        self.order.len()
    }

    /// Number of entries of L.
    pub fn entries(&self) -> usize {
        self.rows.len()
    }

    fn column(&self, j: usize) -> (f64, &[usize], &[f64]) {
        let range = self.columns[j]..self.columns[j + 1];
        let (rows, values) = (&self.rows[range.clone()], &self.values[range]);
        (values[0], &rows[1..], &values[1..])
    }

    /// x = Πᵀ L v = R v.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn root(&self, v: &[f64], x: &mut [f64]) {
        x.copy_from_slice(v);
        self.check(x.len());
        for j in (0..x.len()).rev() {
            let (diagonal, rows, values) = self.column(j);
            let v = x[j];
            x[j] *= diagonal;
            rows.iter().zip(values).for_each(|(i, l)| x[*i] += l * v);
        }
        self.to_given_order(x);
    }

    /// v = Lᵀ Π x = Rᵀ x.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.to_elimination_order(x, v);
        for j in 0..v.len() {
            let (diagonal, rows, values) = self.column(j);
            v[j] = diagonal * v[j] + rows.iter().zip(values).map(|(i, l)| l * v[*i]).sum::<f64>();
        }
    }

    /// v = L⁻¹ Π x = R⁻¹ x.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn root_inverse(&self, x: &[f64], v: &mut [f64]) {
        self.to_elimination_order(x, v);
        self.forward(v);
    }

    /// x = Πᵀ L⁻ᵀ v = R⁻ᵀ v.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn root_inverse_transpose(&self, v: &[f64], x: &mut [f64]) {
        x.copy_from_slice(v);
        self.check(x.len());
        self.backward(x);
        self.to_given_order(x);
    }

    /// y = A⁻¹ x.
    ///
    /// # Panics
    /// If a slice is not of length n.
    pub fn solve_into(&self, x: &[f64], y: &mut [f64]) {
        self.root_inverse(x, y);
        self.backward(y);
        self.to_given_order(y);
    }

    /// x ← A⁻¹ x.
    ///
    /// # Panics
    /// If `x` is not of length n.
    pub fn solve(&self, x: &mut [f64]) {
        self.check(x.len());
        // the inverse of what `to_given_order` does
        for &start in &self.cycles {
            let first = x[start];
            let mut k = start;
            while self.order[k] != start {
                x[k] = x[self.order[k]];
                k = self.order[k];
            }
            x[k] = first;
        }
        self.forward(x);
        self.backward(x);
        self.to_given_order(x);
    }

    /// The diagonal of A⁻¹, by the equations of Takahashi, Fagan and Chen (1973) for its entries where L
    /// has some: about as many operations as the factorization, and as much memory again as L takes.
    pub fn inverse_diagonal(&self) -> Vec<f64> {
        let n = self.dim();
        let mut z = vec![0.0; self.values.len()];
        // where row i is among those of column j, plus one
        let mut places = vec![0; n];
        let mut sums = Vec::new();
        for j in (0..n).rev() {
            let (diagonal, rows, values) = self.column(j);
            sums.clear();
            sums.resize(rows.len(), 0.0);
            rows.iter().enumerate().for_each(|(t, &i)| places[i] = t + 1);
            for (t, (&k, l_k)) in rows.iter().zip(values).enumerate() {
                let start = self.columns[k];
                sums[t] += l_k * z[start];
                for p in start + 1..self.columns[k + 1] {
                    if let Some(s) = places[self.rows[p]].checked_sub(1) {
                        sums[s] += l_k * z[p];
                        sums[t] += values[s] * z[p];
                    }
                }
            }
            rows.iter().for_each(|&i| places[i] = 0);
            let start = self.columns[j];
            for (t, sum) in sums.iter().enumerate() {
                z[start + 1 + t] = -sum / diagonal;
            }
            let below = &z[start + 1..start + 1 + rows.len()];
            z[start] = (1.0 / diagonal - dot(values, below)) / diagonal;
        }
        let mut inverse: Vec<f64> = (0..n).map(|j| z[self.columns[j]]).collect();
        self.to_given_order(&mut inverse);
        inverse
    }

    /// v ← L⁻¹ v.
    fn forward(&self, v: &mut [f64]) {
        for j in 0..v.len() {
            let (diagonal, rows, values) = self.column(j);
            v[j] /= diagonal;
            let y = v[j];
            rows.iter().zip(values).for_each(|(i, l)| v[*i] -= l * y);
        }
    }

    /// v ← L⁻ᵀ v.
    fn backward(&self, v: &mut [f64]) {
        for j in (0..v.len()).rev() {
            let (diagonal, rows, values) = self.column(j);
            let sum: f64 = rows.iter().zip(values).map(|(i, l)| l * v[*i]).sum();
            v[j] = (v[j] - sum) / diagonal;
        }
    }

    /// v = Π x.
    fn to_elimination_order(&self, x: &[f64], v: &mut [f64]) {
        self.check(x.len());
        self.check(v.len());
        v.iter_mut().zip(&self.order).for_each(|(v, &p)| *v = x[p]);
    }

    /// v ← Πᵀ v.
    fn to_given_order(&self, v: &mut [f64]) {
        for &start in &self.cycles {
            let mut carried = v[start];
            let mut k = start;
            loop {
                k = self.order[k];
                std::mem::swap(&mut carried, &mut v[k]);
                if k == start {
                    break;
                }
            }
        }
    }

    fn check(&self, length: usize) {
        assert_eq!(length, self.dim(), "vectors of {} values", self.dim());
    }
}

/// One element of every cycle longer than one.
fn cycles(order: &[usize]) -> Vec<usize> {
    let mut seen = vec![false; order.len()];
    let mut starts = Vec::new();
    for start in 0..order.len() {
        if !seen[start] && order[start] != start {
            starts.push(start);
        }
        let mut k = start;
        while !seen[k] {
            seen[k] = true;
            k = order[k];
        }
    }
    starts
}
