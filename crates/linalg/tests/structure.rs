//! Structures: places, columns and colourings of random patterns.

use proptest::prelude::*;
use varda_linalg::{Error, Structure};

fn structures() -> impl Strategy<Value = (usize, Structure)> {
    (1..14_usize).prop_flat_map(|n| {
        let pairs = prop::collection::vec((0..n, 0..n), 0..40);
        let sparse = pairs.prop_map(move |pairs| Structure::from_pairs(n, pairs).unwrap());
        let structure = prop_oneof![
            Just(Structure::Dense),
            (0..4_usize).prop_map(|half_bandwidth| Structure::Band { half_bandwidth }),
            (0..4_usize).prop_map(|half_bandwidth| Structure::SymmetricBand { half_bandwidth }),
            (0..4_usize).prop_map(move |w| Structure::periodic_band(n, w)),
            sparse,
        ];
        (Just(n), structure)
    })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(256) })]

    #[test]
    fn columns_and_places_are_the_same_pattern((n, structure) in structures()) {
        prop_assert!(structure.check(n).is_ok());
        let mut found = 0;
        for j in 0..n {
            let column: Vec<(usize, usize)> = structure.column(n, j).collect();
            prop_assert!(column.windows(2).all(|pair| pair[0].0 < pair[1].0));
            for i in 0..n {
                let here = column.iter().find(|entry| entry.0 == i).map(|entry| entry.1);
                prop_assert_eq!(here, structure.position(n, i, j));
                if let Some(place) = here {
                    prop_assert!(place < structure.values_len(n));
                    found += 1;
                }
            }
        }
        if let Structure::Sparse { rows, .. } = &structure {
            prop_assert_eq!(found, rows.len());
        }
    }

    /// What a colouring is for: the matrix comes back from one product a group.
    #[test]
    fn a_product_for_every_group_gives_back_the_matrix((n, structure) in structures()) {
        let groups = structure.colouring(n);
        let mut columns: Vec<usize> = groups.concat();
        columns.sort_unstable();
        prop_assert_eq!(columns, (0..n).collect::<Vec<_>>());

        let values: Vec<f64> = (0..structure.values_len(n)).map(|p| 1.0 + p as f64).collect();
        let mut back = vec![0.0; values.len()];
        let mut y = vec![0.0; n];
        for group in &groups {
            let mut x = vec![0.0; n];
            group.iter().for_each(|&j| x[j] = 1.0);
            structure.product(&values, &x, &mut y);
            for &j in group {
                structure.column(n, j).for_each(|(i, p)| back[p] = y[i]);
            }
        }
        for j in 0..n {
            for (_, p) in structure.column(n, j) {
                prop_assert_eq!(back[p], values[p]);
            }
        }
        if let Structure::Sparse { rows, .. } = &structure {
            let fullest = (0..n).map(|i| rows.iter().filter(|row| **row == i).count()).max().unwrap();
            prop_assert!(groups.len() >= fullest);
        }
    }
}

#[test]
fn a_ring_of_tridiagonal_couplings_takes_three_or_four_groups() {
    for n in [4, 5, 6, 40, 41] {
        let ring = Structure::periodic_band(n, 1);
        let expected: Vec<usize> = if n == 4 { vec![0, 1, 3] } else { vec![0, 1, n - 1] };
        assert_eq!(ring.column(n, 0).map(|(i, _)| i).collect::<Vec<_>>(), expected);
        let groups = ring.colouring(n).len();
        assert!(groups == 3 || n % 3 != 0 && groups <= 5, "{n}: {groups}");
    }
    assert_eq!(Structure::periodic_band(3, 1), Structure::Dense);
}

#[test]
fn patterns_that_are_none_are_named() {
    let check = |columns: &[usize], rows: &[usize]| {
        Structure::Sparse { columns: columns.to_vec(), rows: rows.to_vec() }.check(2)
    };
    assert_eq!(check(&[0, 1, 2], &[0, 1]), Ok(()));
    for (columns, rows) in [
        (&[0, 1][..], &[0][..]),
        (&[0, 1, 3], &[0, 1]),
        (&[1, 1, 2], &[0, 1]),
        (&[0, 2, 1], &[0]),
        (&[0, 2, 2], &[1, 0]),
        (&[0, 2, 2], &[1, 1]),
        (&[0, 1, 2], &[0, 2]),
    ] {
        assert!(matches!(check(columns, rows), Err(Error::Pattern { n: 2, .. })), "{columns:?} {rows:?}");
    }
    assert!(matches!(Structure::from_pairs(2, [(0, 2)]), Err(Error::Pattern { found: 2, .. })));
}

#[cfg(feature = "sprs")]
#[test]
fn a_csmat_by_rows_or_columns_is_the_same_structure() {
    let mut triplets = sprs::TriMat::new((3, 3));
    for (i, j, value) in [(0, 0, 1.0), (1, 1, 2.0), (2, 2, 3.0), (2, 0, 4.0)] {
        triplets.add_triplet(i, j, value);
    }
    let (by_columns, by_rows) = (triplets.to_csc::<usize>(), triplets.to_csr::<usize>());
    let structure = Structure::from_csmat(&by_columns).unwrap();
    assert_eq!(structure, Structure::from_pairs(3, [(0, 0), (2, 0), (1, 1), (2, 2)]).unwrap());
    assert_eq!(structure, Structure::from_csmat(&by_rows).unwrap());
    assert_eq!(structure.values_from_csmat(&by_rows).unwrap(), [1.0, 4.0, 2.0, 3.0]);
    let band = Structure::Band { half_bandwidth: 2 };
    assert_eq!(band.values_from_csmat(&by_rows).unwrap()[10], 4.0);
    let narrow = Structure::tridiagonal().values_from_csmat(&by_rows);
    assert!(matches!(narrow, Err(Error::Pattern { found: 2, .. })));
    let symmetric = Structure::SymmetricBand { half_bandwidth: 2 }.values_from_csmat(&by_rows);
    assert!(matches!(symmetric, Err(Error::NotSymmetric { row: 2, column: 0, .. })));
    let wide = sprs::CsMat::<f64>::zero((2, 3));
    assert!(Structure::from_csmat(&wide).is_err());
}

#[cfg(feature = "nalgebra")]
#[test]
fn dense_matrices_go_to_nalgebra_and_back() {
    use varda_linalg::dense::Matrix;
    let given = nalgebra::DMatrix::from_fn(2, 3, |i, j| (i + 10 * j) as f64);
    let ours = Matrix::from(&given);
    assert_eq!(ours[(1, 2)], 21.0);
    assert_eq!(nalgebra::DMatrix::from(ours.clone()), given);
    assert_eq!(Matrix::from(given), ours);
}
