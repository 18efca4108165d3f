//! What further observations would do to a posterior, before they are made.

use crate::Error;
use crate::cost::solve_identity_plus;
use varda_linalg::dense::{View, product};

/// The diagonal of E P' Eᵀ, the variances of some quantities e = E x after further observations, from a
/// root W of the posterior, P = W Wᵀ:
///
/// ```text
///     P' = W (I + GᵀG)⁻¹ Wᵀ,    G = R^{-1/2} H W
/// ```
///
/// for the linearized problem; no value is needed. `root` is
/// E W, t × r by columns; `rows` are the rows of G, r numbers each. Costs some m² r + m r t for m rows
/// below r, else r³ and m r².
///
/// ```
/// use varda_assimilation::variance_after;
///
/// // one number with σ = 2, seen once more with σ = 2
/// let variance = variance_after(1, &[2.0], &[1.0])?;
/// assert!((variance[0] - 2.0).abs() < 1e-15);
/// # Ok::<(), varda_assimilation::Error>(())
/// ```
///
/// # Errors
/// Numbers that are not finite.
///
/// # Panics
/// If `root` or `rows` is no multiple of `r`.
pub fn variance_after(r: usize, root: &[f64], rows: &[f64]) -> Result<Vec<f64>, Error> {
    let (t, m) = (root.len() / r.max(1), rows.len() / r.max(1));
    assert!(t * r == root.len() && m * r == rows.len(), "matrices of {r} columns");
    let (e, gt) = (View::new(root, t, r), View::new(rows, r, m));
    let mut variance = vec![0.0; t];
    for column in root.chunks_exact(t.max(1)) {
        variance.iter_mut().zip(column).for_each(|(v, w)| *v += w * w);
    }
    if t == 0 || m == 0 {
        return Ok(variance);
    }
    if m < r {
        // E Eᵀ − E Gᵀ (I + G Gᵀ)⁻¹ G Eᵀ
        let mut seen = vec![0.0; m * t];
        product(gt.transpose(), e.transpose(), &mut seen);
        let mut solved = seen.clone();
        solve_identity_plus(gt, &mut solved)?;
        let columns = seen.chunks_exact(m).zip(solved.chunks_exact(m));
        for (variance, (seen, solved)) in variance.iter_mut().zip(columns) {
            *variance -= seen.iter().zip(solved).map(|(a, b)| a * b).sum::<f64>();
        }
    } else {
        let back = e.transpose().to_matrix().into_columns();
        let mut solved = back.clone();
        solve_identity_plus(gt.transpose(), &mut solved)?;
        for (variance, (e, solved)) in
            variance.iter_mut().zip(back.chunks_exact(r).zip(solved.chunks_exact(r)))
        {
            *variance = e.iter().zip(solved).map(|(a, b)| a * b).sum();
        }
    }
    Ok(variance)
}

#[cfg(test)]
mod tests {
    use super::variance_after;

    /// Both forms, against Kalman's update of one row after the other.
    #[test]
    fn both_forms_are_kalmans_update() {
        let (r, t) = (4, 3);
        let wave = |i: usize, k: usize| (1.0 + 3.7 * i as f64 + 1.3 * k as f64).sin();
        let root: Vec<f64> = (0..t * r).map(|i| wave(i, 0)).collect();
        for m in [1, 2, 3, 4, 7] {
            let rows: Vec<f64> = (0..m * r).map(|i| wave(i, m)).collect();
            let ours = variance_after(r, &root, &rows).unwrap();
            // C, the covariance of ξ, one row of σ = 1 at a time
            let mut c = vec![0.0; r * r];
            (0..r).for_each(|i| c[i * r + i] = 1.0);
            for g in rows.chunks_exact(r) {
                let cg: Vec<f64> = (0..r).map(|i| (0..r).map(|j| c[i * r + j] * g[j]).sum()).collect();
                let s = 1.0 + g.iter().zip(&cg).map(|(a, b)| a * b).sum::<f64>();
                (0..r * r).for_each(|at| c[at] -= cg[at / r] * cg[at % r] / s);
            }
            for (row, ours) in ours.iter().enumerate() {
                let e = |j: usize| root[row + j * t];
                let theirs: f64 = (0..r * r).map(|at| e(at / r) * c[at] * e(at % r)).sum();
                // a few dozen operations, and differences of numbers of size one
                assert!((ours - theirs).abs() <= 1e-13, "{m} rows: {ours} {theirs}");
            }
        }
    }
}
