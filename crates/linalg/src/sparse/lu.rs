//! P A Q = L U for a sparse pattern.

use crate::{BadPivot, clear_upper_registers};
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::linalg::{LuError, lu};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{ColMut, Conj, Par};

/// The numbers of one sparse LU factor.
pub(crate) type NumericLu = lu::NumericLu<usize, f64>;

/// LU factorizations of sparse matrices with one pattern.
pub(crate) struct SparseLu {
    pattern: SymbolicSparseColMat<usize>,
    symbolic: lu::SymbolicLu<usize>,
    scratch: MemBuffer,
    probe: Vec<f64>,
}

impl SparseLu {
    /// # Panics
    /// If this is not a pattern of n rows and columns.
    pub(crate) fn new(n: usize, columns: &[usize], rows: &[usize]) -> Self {
        let pattern = SymbolicSparseColMat::new_checked(n, n, columns.to_vec(), None, rows.to_vec());
        let symbolic = lu::factorize_symbolic_lu(pattern.as_ref(), Default::default())
            .expect("room for the symbolic factor");
        let scratch = symbolic
            .factorize_numeric_lu_scratch::<f64>(Par::Seq, Default::default())
            .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq))
            .or(symbolic.solve_transpose_in_place_scratch::<f64>(1, Par::Seq));
        Self { pattern, symbolic, scratch: MemBuffer::new(scratch), probe: vec![0.0; n] }
    }

    pub(crate) fn factor(&mut self, values: &[f64], factor: &mut NumericLu) -> Result<(), BadPivot> {
        // An infinite pivot leaves finite solutions.
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            return Err(BadPivot { row: self.pattern.row_idx()[at] });
        }
        let made = self.symbolic.factorize_numeric_lu(
            factor,
            SparseColMatRef::new(self.pattern.as_ref(), values),
            Par::Seq,
            MemStack::new(&mut self.scratch),
            Default::default(),
        );
        clear_upper_registers();
        made.map_err(|e| match e {
            LuError::SymbolicSingular { index } => BadPivot { row: index },
            LuError::Generic(_) => BadPivot { row: 0 },
        })?;
        // faer factors a singular matrix without an error: its solutions are not finite
        let mut probe = std::mem::take(&mut self.probe);
        probe.fill(1.0);
        self.solve(factor, &mut probe);
        let bad = probe.iter().position(|p| !p.is_finite());
        self.probe = probe;
        bad.map_or(Ok(()), |row| Err(BadPivot { row }))
    }

    /// b ← A⁻¹ b.
    pub(crate) fn solve(&mut self, factor: &NumericLu, b: &mut [f64]) {
        lu::LuRef::new_unchecked(&self.symbolic, factor).solve_in_place_with_conj(
            Conj::No,
            ColMut::from_slice_mut(b).as_mat_mut(),
            Par::Seq,
            MemStack::new(&mut self.scratch),
        );
        clear_upper_registers();
    }

    /// b ← A⁻ᵀ b.
    pub(crate) fn solve_transpose(&mut self, factor: &NumericLu, b: &mut [f64]) {
        lu::LuRef::new_unchecked(&self.symbolic, factor).solve_transpose_in_place_with_conj(
            Conj::No,
            ColMut::from_slice_mut(b).as_mat_mut(),
            Par::Seq,
            MemStack::new(&mut self.scratch),
        );
        clear_upper_registers();
    }
}
