//! Sparse Cholesky factors against nalgebra's dense ones.

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use varda_linalg::sparse::{Cholesky, Ordering};
use varda_linalg::{Error, Structure};

/// A random symmetric pattern, diagonally dominant values.
fn matrices() -> impl Strategy<Value = (usize, Structure, Vec<f64>)> {
    (1..25_usize).prop_flat_map(|n| {
        let pairs = prop::collection::vec((0..n, 0..n, -1.0..1.0), 0..3 * n);
        pairs.prop_map(move |pairs| {
            let mirrored = pairs.iter().flat_map(|&(i, j, _)| [(i, j), (j, i)]).chain((0..n).map(|i| (i, i)));
            let structure = Structure::from_pairs(n, mirrored).unwrap();
            let mut dense = DMatrix::<f64>::zeros(n, n);
            for &(i, j, value) in &pairs {
                dense[(i, j)] = value;
                dense[(j, i)] = value;
            }
            for i in 0..n {
                dense[(i, i)] = 1.0 + dense.row(i).iter().map(|a| a.abs()).sum::<f64>();
            }
            let values = structure.values(n, |i, j| dense[(i, j)]);
            (n, structure, values)
        })
    })
}

fn dense(n: usize, structure: &Structure, values: &[f64]) -> DMatrix<f64> {
    DMatrix::from_fn(n, n, |i, j| structure.position(n, i, j).map_or(0.0, |p| values[p]))
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(128) })]

    #[test]
    fn roots_solves_and_the_diagonal_of_the_inverse(
        (n, structure, values) in matrices(), natural in any::<bool>(),
    ) {
        let ordering = if natural { Ordering::Natural } else { Ordering::MinimumDegree };
        let factor = Cholesky::new(n, &structure, &values, ordering).unwrap();
        let a = dense(n, &structure, &values);
        let inverse = a.clone().cholesky().unwrap().inverse();
        let b = DVector::from_fn(n, |i, _| (i as f64 * 1.3).cos());
        let mut out = vec![0.0; n];
        let mut back = vec![0.0; n];
        // Diagonally dominant with entries of at most some 10: condition below 100, a few n ε.
        let near = |found: &[f64], expected: &DVector<f64>| {
            (DVector::from_column_slice(found) - expected).amax() <= 1e-12
        };

        // A = R Rᵀ and A⁻¹ = R⁻ᵀ R⁻¹
        factor.root_transpose(b.as_slice(), &mut out);
        factor.root(&out, &mut back);
        prop_assert!(near(&back, &(&a * &b)));
        factor.root_inverse(b.as_slice(), &mut out);
        factor.root_inverse_transpose(&out, &mut back);
        prop_assert!(near(&back, &(&inverse * &b)));
        factor.solve_into(b.as_slice(), &mut out);
        prop_assert!(near(&out, &(&inverse * &b)));
        out.copy_from_slice(b.as_slice());
        factor.solve(&mut out);
        prop_assert_eq!(&out, &back);
        // R⁻¹ undoes R
        factor.root(b.as_slice(), &mut out);
        factor.root_inverse(&out, &mut back);
        prop_assert!(near(&back, &b));
        prop_assert!(near(&factor.inverse_diagonal(), &inverse.diagonal()));
    }
}

/// What faer would answer to a whole matrix in natural order: no error, and a wrong solution.
#[test]
fn both_triangles_in_natural_order_are_right() {
    let n = 6;
    let structure = Structure::periodic_band(n, 2);
    let values = structure.values(n, |i, j| if i == j { 7.0 } else { -1.0 });
    let factor = Cholesky::new(n, &structure, &values, Ordering::Natural).unwrap();
    let mut x = vec![3.0; n];
    factor.solve(&mut x);
    assert!(x.iter().all(|x| (x - 1.0).abs() <= 1e-14), "{x:?}");
}

#[test]
fn bad_matrices_name_the_row_in_the_given_order() {
    let arrow = Structure::from_pairs(3, (0..3).flat_map(|i| [(i, i), (i, 0), (0, i)])).unwrap();
    let new = |values: &dyn Fn(usize, usize) -> f64| {
        Cholesky::new(3, &arrow, &arrow.values(3, values), Ordering::MinimumDegree).map(|_| ())
    };
    assert_eq!(new(&|i, j| if i == j { 4.0 } else { 1.0 }), Ok(()));
    // Rows 1 and 2 leave 1 − ½ − ½ of row 0: nothing; with 0.4 on its diagonal less than nothing.
    let diagonal = |first: f64| {
        move |i: usize, j: usize| {
            if i != j {
                1.0
            } else if i == 0 {
                first
            } else {
                2.0
            }
        }
    };
    assert!(matches!(new(&diagonal(1.0)), Err(Error::Singular { pivot: 0, .. })));
    assert!(matches!(
        new(&diagonal(0.4)),
        Err(Error::NotPositiveDefinite { pivot: 0, value, diagonal: 0.4 }) if (value + 0.6).abs() < 1e-15
    ));
    assert!(matches!(
        new(&|i, j| if (i, j) == (2, 2) { -1.0 } else { 0.0 }),
        Err(Error::Singular { .. } | Error::NotPositiveDefinite { .. })
    ));
    assert!(matches!(new(&|i, j| if i + j == 2 { f64::NAN } else { 1.0 }), Err(Error::NonFinite { .. })));
    let missing = Structure::from_pairs(2, [(0, 0)]).unwrap();
    let missing = Cholesky::new(2, &missing, &[1.0], Ordering::Natural);
    assert!(matches!(missing, Err(Error::Singular { pivot: 1, .. })), "{missing:?}");
}

#[test]
fn nothing_and_one_unknown() {
    let empty =
        Cholesky::new(0, &Structure::from_pairs(0, []).unwrap(), &[], Ordering::MinimumDegree).unwrap();
    empty.solve(&mut []);
    assert_eq!(empty.inverse_diagonal(), [0.0; 0]);
    let one = Cholesky::new(1, &Structure::Dense, &[4.0], Ordering::MinimumDegree).unwrap();
    let mut x = [8.0];
    one.solve(&mut x);
    assert_eq!((x, one.inverse_diagonal()), ([2.0], vec![0.25]));
}
