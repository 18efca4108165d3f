//! Band factorizations against faer's dense ones.

use faer::prelude::*;
use faer::{Mat, Side};
use proptest::prelude::*;
use varda_linalg::band::*;
use varda_linalg::{LinearSolver, Structure};

/// The full matrix of a symmetric band.
fn full_symmetric(n: usize, w: usize, a: &[f64]) -> Mat<f64> {
    Mat::from_fn(n, n, |i, j| {
        let (i, j) = (i.max(j), i.min(j));
        if i - j <= w { a[i * (w + 1) + j + w - i] } else { 0.0 }
    })
}

fn full_band(n: usize, w: usize, a: &[f64]) -> Mat<f64> {
    Mat::from_fn(n, n, |i, j| if i.abs_diff(j) <= w { a[i * (2 * w + 1) + j + w - i] } else { 0.0 })
}

/// ‖A x − b‖ / (‖A‖ ‖x‖ + ‖b‖), largest components and rows.
fn residual(a: &Mat<f64>, x: &[f64], b: &[f64]) -> f64 {
    let n = b.len();
    let top = |v: &[f64]| v.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let rows = (0..n).map(|i| (0..n).map(|j| a[(i, j)].abs()).sum::<f64>()).fold(0.0, f64::max);
    let rest =
        (0..n).map(|i| ((0..n).map(|j| a[(i, j)] * x[j]).sum::<f64>() - b[i]).abs()).fold(0.0, f64::max);
    rest / (rows * top(x) + top(b))
}

fn column(v: &[f64]) -> Mat<f64> {
    Mat::from_fn(v.len(), 1, |i, _| v[i])
}

/// A symmetric band of random values, `weight` times the half-bandwidth on the diagonal: positive definite
/// where that is 3 in every row, indefinite where some signs are turned.
fn symmetric_band() -> impl Strategy<Value = (usize, usize, Vec<f64>, Vec<f64>)> {
    (1..40usize, prop_oneof![0..13usize, Just(5), Just(8), Just(10)])
        .prop_flat_map(|(n, w)| {
            let values = prop::collection::vec(-1.0..1.0, n * (w + 1));
            (
                Just(n),
                Just(w),
                values,
                prop::collection::vec(-1.0..1.0, n),
                prop::collection::vec(any::<bool>(), n),
            )
        })
        .prop_map(|(n, w, mut a, b, signs)| {
            for i in 0..n {
                for p in 0..w.saturating_sub(i) {
                    a[i * (w + 1) + p] = 0.0;
                }
                let size = 3.0 * (w + 1) as f64 + a[i * (w + 1) + w];
                a[i * (w + 1) + w] = if signs[i] { size } else { -size };
            }
            (n, w, a, b)
        })
}

fn general_band() -> impl Strategy<Value = (usize, usize, Vec<f64>, Vec<f64>)> {
    (1..40usize, 0..13usize).prop_flat_map(|(n, w)| {
        let values = prop::collection::vec(-1.0..1.0, n * (2 * w + 1));
        (Just(n), Just(w), values, prop::collection::vec(-1.0..1.0, n))
    })
}

proptest! {
    #[test]
    fn ldlt_agrees_with_dense_lblt_definite_or_not((n, w, a, b) in symmetric_band()) {
        let dense = full_symmetric(n, w, &a);
        let mut factor = a.clone();
        let negative = ldlt_factor(w, &mut factor).unwrap();
        let eigenvalues = dense.self_adjoint_eigenvalues(Side::Lower).unwrap();
        prop_assert_eq!(negative, eigenvalues.iter().filter(|e| **e < 0.0).count());

        let mut x = b.clone();
        ldlt_solve(w, &factor, &mut x);
        // the diagonal dominates: no growth, residuals of a few roundings
        prop_assert!(residual(&dense, &x, &b) <= 1e-14);
        let reference = dense.lblt(Side::Lower).solve(column(&b));
        for i in 0..n {
            prop_assert!((x[i] - reference[(i, 0)]).abs() <= 1e-13);
        }

        // right-hand sides at once are as many solves, bit by bit, and no column sees the others
        let scale: [f64; BLOCK] = std::array::from_fn(|c| 1.0 - 2.0 * c as f64);
        let mut block: Vec<[f64; BLOCK]> = b.iter().map(|b| scale.map(|s| s * b)).collect();
        let first = |b: &f64| scale.map(|s| if s == 1.0 { *b } else { 0.0 });
        let mut alone: Vec<[f64; BLOCK]> = b.iter().map(first).collect();
        ldlt_solve_block(w, &factor, &mut block);
        ldlt_solve_block(w, &factor, &mut alone);
        for i in 0..n {
            for (v, s) in block[i].iter().zip(scale) {
                prop_assert!((v - s * x[i]).abs() <= 1e-14 * s.abs());
            }
            prop_assert_eq!(block[i][0].to_bits(), alone[i][0].to_bits());
            prop_assert_eq!(block[i][0].to_bits(), x[i].to_bits());
        }

        let mut z = vec![0.0; n];
        match ldlt_negative_curvature(w, &factor, &mut z) {
            None => prop_assert_eq!(negative, 0),
            Some(curvature) => {
                let z = column(&z);
                let found = (z.transpose() * &dense * &z)[(0, 0)];
                prop_assert!(curvature < 0.0 && (found - curvature).abs() <= 1e-12 * curvature.abs());
            }
        }
    }

    #[test]
    fn lu_agrees_with_dense_lu((n, w, a, b) in general_band()) {
        let dense = full_band(n, w, &a);
        let (mut factor, mut pivots) = (vec![0.0; lu_len(n, w)], vec![0; n]);
        // random bands are never singular, but may be ill conditioned: residuals are what is small
        lu_factor(w, &a, &mut factor, &mut pivots).unwrap();
        let (mut x, mut y) = (b.clone(), b.clone());
        lu_solve(w, &factor, &pivots, &mut x);
        lu_solve_transpose(w, &factor, &pivots, &mut y);
        prop_assert!(residual(&dense, &x, &b) <= 1e-13);
        prop_assert!(residual(&dense.transpose().to_owned(), &y, &b) <= 1e-13);
        let reference = dense.partial_piv_lu().solve(column(&b));
        let size = (0..n).fold(1.0_f64, |m, i| m.max(reference[(i, 0)].abs()));
        let singular = dense.singular_values().unwrap();
        let condition = singular[0] / singular[n - 1];
        for i in 0..n {
            prop_assert!((x[i] - reference[(i, 0)]).abs() <= 1e-14 * condition * size);
        }
    }

    #[test]
    fn every_structure_solves_the_same_system((n, w, a, b) in symmetric_band()) {
        let dense = full_symmetric(n, w, &a);
        let at = |i: usize, j: usize| dense[(i, j)];
        let inside = |j: usize| j.saturating_sub(w)..(j + w + 1).min(n);
        let mut columns = vec![0];
        let (mut rows, mut sparse) = (Vec::new(), Vec::new());
        for j in 0..n {
            rows.extend(inside(j));
            sparse.extend(inside(j).map(|i| at(i, j)));
            columns.push(rows.len());
        }
        let general: Vec<f64> = (0..n)
            .flat_map(|i| (0..=2 * w).map(move |p| (i, i + p)))
            .map(|(i, p)| if p >= w && p - w < n { at(i, p - w) } else { 0.0 })
            .collect();
        let column_major: Vec<f64> = (0..n * n).map(|p| at(p % n, p / n)).collect();
        let mut expected = b.clone();
        let mut expected_size = vec![0.0; n];
        for (case, (structure, values)) in [
            (Structure::SymmetricBand { half_bandwidth: w }, a.clone()),
            (Structure::Band { half_bandwidth: w }, general),
            (Structure::Dense, column_major),
            (Structure::Sparse { columns, rows }, sparse),
        ]
        .into_iter()
        .enumerate()
        {
            let mut solver = LinearSolver::new(n, &structure);
            let mut factor = solver.empty_factor();
            // shifted by |diagonal| and back: the second factorization must forget the first
            solver.factor_shifted(&values, 1.0, &mut factor).ok();
            solver.factor(&values, &mut factor).unwrap();
            let (mut x, mut y, mut size) = (b.clone(), b.clone(), vec![0.0; n]);
            solver.solve(&factor, &mut x);
            solver.solve_transpose(&factor, &mut y);
            solver.absolute_product(&values, &b, &mut size);
            if case == 0 {
                expected.copy_from_slice(&x);
                expected_size.copy_from_slice(&size);
            }
            for i in 0..n {
                prop_assert!((x[i] - expected[i]).abs() <= 1e-13, "{:?}", structure);
                prop_assert!((y[i] - expected[i]).abs() <= 1e-13, "{:?}", structure);
                prop_assert!((size[i] - expected_size[i]).abs() <= 1e-12);
            }
        }
    }
}

#[test]
fn dense_transpose_solve_of_an_unsymmetric_matrix() {
    for n in [1, 2, 3, 7, 31, 32, 50] {
        let entry = |i: usize, j: usize| {
            (1.3 * (i * n + 2 * j) as f64).sin() + if (i + 1) % n == j { 3.0 } else { 0.0 }
        };
        let dense = Mat::from_fn(n, n, entry);
        let values: Vec<f64> = (0..n * n).map(|p| entry(p % n, p / n)).collect();
        let b: Vec<f64> = (0..n).map(|i| (i as f64).cos()).collect();
        let mut solver = LinearSolver::new(n, &Structure::Dense);
        let mut factor = solver.empty_factor();
        solver.factor(&values, &mut factor).unwrap();
        let (mut x, mut y) = (b.clone(), b.clone());
        solver.solve(&factor, &mut x);
        solver.solve_transpose(&factor, &mut y);
        assert!(residual(&dense, &x, &b) <= 1e-14, "n = {n}");
        assert!(residual(&dense.transpose().to_owned(), &y, &b) <= 1e-14, "n = {n}");
    }
}

#[test]
fn unusable_pivots_are_named() {
    // [[1, 1], [1, 1]] leaves nothing for the second row; so does what rounding makes of it
    assert_eq!(ldlt_factor(1, &mut [0.0, 1.0, 1.0, 1.0]), Err(BadPivot { row: 1 }));
    assert_eq!(ldlt_factor(1, &mut [0.0, 0.1, 0.1, 0.1 + 1e-17]), Err(BadPivot { row: 1 }));
    for w in [3, 8, 10] {
        for (row, bad) in [(0, 0.0), (4, f64::NAN), (17, f64::INFINITY), (29, 0.0)] {
            let mut a = vec![0.0; 30 * (w + 1)];
            (0..30).for_each(|i| a[i * (w + 1) + w] = 2.0);
            a[row * (w + 1) + w] = bad;
            assert_eq!(ldlt_factor(w, &mut a), Err(BadPivot { row }), "w = {w}");
        }
    }
    let mut pivots = [0; 2];
    let mut factor = vec![0.0; lu_len(2, 1)];
    assert_eq!(
        lu_factor(1, &[0.0, 1.0, 1.0, 1.0, 1.0, 0.0], &mut factor, &mut pivots),
        Err(BadPivot { row: 1 })
    );
    assert!(lu_factor(1, &[0.0, f64::NAN, 1.0, 1.0, 1.0, 0.0], &mut factor, &mut pivots).is_err());
    // a zero on the diagonal is no obstacle to pivoting
    lu_factor(1, &[0.0, 0.0, 1.0, 1.0, 0.0, 0.0], &mut factor, &mut pivots).unwrap();
    let mut x = [2.0, 3.0];
    lu_solve(1, &factor, &pivots, &mut x);
    assert_eq!(x, [3.0, 2.0]);

    for (structure, values) in [
        (Structure::Dense, vec![1.0, 2.0, 2.0, 4.0]),
        (Structure::Dense, vec![1.0, f64::NAN, 2.0, 4.0]),
        (Structure::Sparse { columns: vec![0, 2, 4], rows: vec![0, 1, 0, 1] }, vec![1.0, 2.0, 2.0, 4.0]),
        (Structure::Sparse { columns: vec![0, 1, 1], rows: vec![0] }, vec![1.0]),
    ] {
        let mut solver = LinearSolver::new(2, &structure);
        let mut factor = solver.empty_factor();
        assert!(solver.factor(&values, &mut factor).is_err(), "{structure:?} {values:?}");
    }
}
