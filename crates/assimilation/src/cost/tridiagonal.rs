//! The direct solve of the weak-constraint increment over states, for small problems.

use super::StrongConstraint;
use crate::{Error, LeastSquares};
use varda_covariance::Precision;
use varda_linalg::axpy;
use varda_linalg::dense::{Cholesky, Matrix};

/// p = −A⁻¹ g through the block-tridiagonal system in the whitened states s (z = B^{1/2} s_0, ξ_j =
/// Q^{1/2} s_j), where p = T s:
///
/// ```text
///     T_jj = I,    T_{j+1,j} = −F_j,    F_j = Q^{-1/2} M_j (B or Q)^{1/2},
///     C_j = R^{-1/2} H M (B or Q)^{1/2} of sub-window j
///     (TᵀT + CᵀC) s = −Tᵀ g :    diagonal blocks I + F_jᵀF_j + C_jᵀC_j,
///     below them −F_j + C_{j+1}ᵀ C_j
/// ```
///
/// An observation between two steps couples neighbours and no others. Costs a tangent run of every sub-window
/// for every component of its state, O(N n³) arithmetic and O(N n² + m n) memory.
pub(super) fn solve(
    window: &mut StrongConstraint,
    q: &dyn Precision,
    gradient: &[f64],
    p: &mut [f64],
) -> Result<(), Error> {
    window.return_to_base()?;
    let (n, head, m) = (window.state_dim, window.transform.dim(), window.observation_dim());
    let Some(count) = window.errors.as_ref().map(|e| e.count()) else { unreachable!() };
    if q.dim() != n {
        return Err(Error::Length {
            what: "the forced components of a block-tridiagonal solve",
            expected: n,
            found: q.dim(),
        });
    }
    let size = |j: usize| if j == 0 { head } else { n };
    let start = |j: usize| if j == 0 { 0 } else { head + (j - 1) * n };
    let g = |j: usize, sign: f64| {
        let part = gradient[start(j)..start(j) + size(j)].iter().map(|g| sign * g);
        Matrix::from_columns(size(j), 1, part.collect())
    };

    // Forward: s_j = inverse_j (y_j − below_jᵀ s_{j+1}), factors kept.
    let mut rows: Vec<Row> = Vec::new();
    let (mut f, mut c) = (Matrix::zeros(0, 0), Matrix::zeros(m, head));
    for j in 0..=count {
        let c_before = std::mem::replace(&mut c, Matrix::zeros(m, size(j)));
        let f_before = std::mem::replace(&mut f, Matrix::zeros(if j < count { n } else { 0 }, size(j)));
        for i in 0..size(j) {
            column(window, q, j, i, &mut f, &mut c);
        }
        let mut diagonal =
            Matrix::identity(size(j)).plus(1.0, f.transpose(), f.view()).plus(1.0, c.transpose(), c.view());
        let mut y = g(j, -1.0);
        if j < count {
            y = y.plus(1.0, f.transpose(), g(j + 1, 1.0).view());
        }
        if let Some(before) = rows.last_mut() {
            let mut below = Matrix::zeros(n, size(j - 1)).plus(1.0, c.transpose(), c_before.view());
            axpy(-1.0, f_before.as_slice(), below.as_mut_slice());
            let mut solved = below.transpose().to_matrix();
            before.factor.solve_columns(solved.as_mut_slice());
            diagonal = diagonal.plus(-1.0, below.view(), solved.view());
            let mut solved = before.y.clone();
            before.factor.solve_columns(solved.as_mut_slice());
            y = y.plus(-1.0, below.view(), solved.view());
            (before.below, before.f) = (below, f_before);
        }
        let factor = Cholesky::new(size(j), diagonal.as_slice())
            .map_err(|_| Error::NotPositiveDefinite { smallest: f64::NAN })?;
        rows.push(Row { factor, y, below: Matrix::zeros(0, size(j)), f: Matrix::zeros(0, 0) });
    }

    // Backward, and p = T s.
    let mut after: Option<Matrix> = None;
    for (j, row) in rows.iter().enumerate().rev() {
        let mut s = row.y.clone();
        if let Some(after) = &after {
            s = s.plus(-1.0, row.below.transpose(), after.view());
        }
        row.factor.solve_columns(s.as_mut_slice());
        if let Some(after) = &after {
            let next = after.clone().plus(-1.0, row.f.view(), s.view());
            p[start(j + 1)..start(j + 1) + n].copy_from_slice(next.as_slice());
        }
        after = Some(s);
    }
    if let Some(s) = after {
        p[..head].copy_from_slice(s.as_slice());
    }
    if p.iter().all(|p| p.is_finite()) {
        Ok(())
    } else {
        Err(Error::NotPositiveDefinite { smallest: f64::NAN })
    }
}

struct Row {
    factor: Cholesky,
    y: Matrix,
    below: Matrix,
    f: Matrix,
}

/// Column i of F_j and C_j: a tangent run of sub-window j from component i of its whitened start.
fn column(
    window: &mut StrongConstraint,
    q: &dyn Precision,
    j: usize,
    i: usize,
    f: &mut Matrix,
    c: &mut Matrix,
) {
    let StrongConstraint {
        model: Some(model),
        errors: Some(errors),
        lambda: dx,
        dz,
        dy,
        last,
        transform,
        observations,
        base,
        root_precision,
        ..
    } = window
    else {
        unreachable!()
    };
    let n = dx.len();
    let steps = errors.forcing().steps;
    let components = &errors.forcing().components;
    let mut root = vec![0.0; n];
    if j == 0 {
        let mut unit = vec![0.0; transform.dim()];
        unit[i] = 1.0;
        transform.tangent(&unit, dz);
        model.initial_tangent(dz, dx);
    } else {
        let mut unit = vec![0.0; n];
        unit[i] = 1.0;
        q.root(&unit, &mut root);
        components.iter().zip(&root).for_each(|(&c, r)| dx[c] = *r);
    }
    let end = (j + 1) * steps;
    dy.fill(0.0);
    for k in j * steps..=(*last).min(end) {
        // At its end the state is another unknown.
        if k == end {
            components.iter().zip(&mut root).for_each(|(&c, r)| *r = dx[c]);
            let mut whitened = vec![0.0; n];
            q.whiten(&root, &mut whitened);
            (0..n).for_each(|r| f[(r, i)] = whitened[r]);
            break;
        }
        observations.tangent_add(k, base.trajectory.state(k), dx, &base.predicted, dy);
        if k < *last {
            base.trajectory.tangent_of_step(&mut **model, k, dx);
        }
    }
    observations.whiten_blocks(dy);
    for (r, (dy, root)) in dy.iter().zip(&*root_precision).enumerate() {
        c[(r, i)] = dy * root;
    }
}
