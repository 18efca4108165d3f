//! The direct solve of the weak-constraint increment over states, for small problems.

use super::StrongConstraint;
use crate::{Error, GaussNewton};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};
use varda_covariance::Precision;

/// p = −A⁻¹ g through the block-tridiagonal system in the whitened states s (z = B^{1/2} s_0, ξ_j = Q^{1/2} s_j), where p = T s:
///
/// ```text
///     T_jj = I,    T_{j+1,j} = −F_j,    F_j = Q^{-1/2} M_j (B or Q)^{1/2},    C_j = R^{-1/2} H M (B or Q)^{1/2} of sub-window j
///     (TᵀT + CᵀC) s = −Tᵀ g :    diagonal blocks I + F_jᵀF_j + C_jᵀC_j,    below them −F_j + C_{j+1}ᵀ C_j
/// ```
///
/// An observation between two steps couples neighbours and no others. Costs a tangent run of every sub-window for every component of its
/// state, O(N n³) arithmetic and O(N n² + m n) memory.
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
    let g = |j: usize| Mat::from_fn(size(j), 1, |i, _| gradient[start(j) + i]);

    // Forward: s_j = inverse_j (y_j − below_jᵀ s_{j+1}), factors kept.
    let mut rows: Vec<Row> = Vec::new();
    let (mut f, mut c) = (Mat::zeros(0, 0), Mat::zeros(m, head));
    for j in 0..=count {
        let c_before = std::mem::replace(&mut c, Mat::zeros(m, size(j)));
        let f_before = std::mem::replace(&mut f, Mat::zeros(if j < count { n } else { 0 }, size(j)));
        for i in 0..size(j) {
            column(window, q, j, i, &mut f, &mut c);
        }
        let mut diagonal = Mat::<f64>::identity(size(j), size(j)) + f.transpose() * &f + c.transpose() * &c;
        let mut y = -g(j);
        if j < count {
            y += f.transpose() * g(j + 1);
        }
        if let Some(before) = rows.last_mut() {
            let below = c.transpose() * &c_before - &f_before;
            diagonal -= &below * before.factor.solve(below.transpose());
            y -= &below * before.factor.solve(&before.y);
            (before.below, before.f) = (below, f_before);
        }
        let failed = Error::NotPositiveDefinite { smallest: f64::NAN };
        if !(diagonal.norm_max().is_finite()) {
            return Err(failed);
        }
        let Ok(factor) = diagonal.llt(Side::Lower) else { return Err(failed) };
        rows.push(Row { factor, y, below: Mat::zeros(0, size(j)), f: Mat::zeros(0, 0) });
    }

    // Backward, and p = T s.
    let mut after: Option<Mat<f64>> = None;
    for (j, row) in rows.iter().enumerate().rev() {
        let s = match &after {
            Some(after) => {
                let s = row.factor.solve(&row.y - row.below.transpose() * after);
                let carried = &row.f * &s;
                (0..n).for_each(|i| p[start(j + 1) + i] = after[(i, 0)] - carried[(i, 0)]);
                s
            }
            None => row.factor.solve(&row.y),
        };
        after = Some(s);
    }
    if let Some(s) = after {
        (0..head).for_each(|i| p[i] = s[(i, 0)]);
    }
    if p.iter().all(|p| p.is_finite()) {
        Ok(())
    } else {
        Err(Error::NotPositiveDefinite { smallest: f64::NAN })
    }
}

struct Row {
    factor: Llt<f64>,
    y: Mat<f64>,
    below: Mat<f64>,
    f: Mat<f64>,
}

/// Column i of F_j and C_j: a tangent run of sub-window j from component i of its whitened start.
fn column(
    window: &mut StrongConstraint,
    q: &dyn Precision,
    j: usize,
    i: usize,
    f: &mut Mat<f64>,
    c: &mut Mat<f64>,
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
        observations.tangent_add(k, base.trajectory.state(k), dx, dy);
        if k < *last {
            model.tangent(k, dx);
        }
    }
    for (r, (dy, root)) in dy.iter().zip(&*root_precision).enumerate() {
        c[(r, i)] = dy * root;
    }
}
