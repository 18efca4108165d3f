//! Errors correlated from one observation to others, against the dense R they stand for.

use crate::cost::coupled;
use crate::matrix::check_gradient;
use crate::models::{all_of, dot, normals};
use varda_assimilation::{
    ControlTransform, CostFunction, Error, LeastSquares, Observation, ObservationSet, StrongConstraint,
};
use varda_covariance::{Dense, Kernel, Precision};
use varda_implicit::{Rk4, lorenz::Lorenz63};

/// Forgets itself in 2.5 steps.
const MEMORY: Kernel = Kernel::Matern32 { length: 2.5 };

/// Components x and z at some steps, one of them between two, and y with errors of its own; every component
/// has its chain in time.
fn seen() -> Vec<Observation> {
    let at = |k: usize, w: f64, rows: &[usize], sigma: f64| {
        let values = normals(90 + k as u64, rows.len()).iter().map(|e| 2.0 + e).collect();
        let chains = rows.iter().map(|row| (7 * row, k as f64 + w)).collect();
        Observation::new(k, rows.to_vec(), values, sigma).between(w).chained(MEMORY, chains)
    };
    vec![
        // not in the order of time
        at(6, 0.0, &[2, 0], 0.4),
        at(2, 0.0, &[0, 2], 0.3),
        Observation::new(4, vec![1], vec![3.0], 0.5),
        at(3, 0.25, &[0], 0.6),
        at(9, 0.0, &[2], 0.2),
    ]
}

/// R by its definition, in the order of the set.
fn defined(set: &ObservationSet) -> Vec<f64> {
    let m = set.dim();
    let mut place = Vec::new();
    for o in set.observations() {
        let t = o.step as f64 + o.weight;
        place.extend(o.rows.iter().zip(&o.sigma).map(|(row, sigma)| (*row, t, *sigma)));
    }
    let entry = |i: usize, j: usize| {
        let ((a, s, p), (b, t, q)) = (place[i], place[j]);
        let d = 3.0_f64.sqrt() * (s - t).abs() / 2.5;
        match a == b && (a != 1 || i == j) {
            true => p * q * (1.0 + d) * (-d).exp(),
            false => 0.0,
        }
    };
    (0..m * m).map(|ij| entry(ij % m, ij / m)).collect()
}

fn close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    // a condition number of about ten
    let wrong = found.iter().zip(expected).find(|(f, e)| !((*f - *e).abs() <= 1e-13 * (1.0 + e.abs())));
    assert!(wrong.is_none(), "{wrong:?}");
}

#[test]
fn chains_are_the_dense_covariance_that_they_stand_for() {
    let set = ObservationSet::new(10, vec![all_of(3)], seen()).unwrap();
    let (m, r) = (set.dim(), defined(&set));
    assert!(set.is_correlated());
    close(&set.error_covariance(), &r);
    let dense = Dense::new(m, &r).unwrap();
    let (d, mut white, mut solved) = (normals(3, m), normals(3, m), vec![0.0; m]);
    set.whiten(&mut white);
    dense.solve(&d, &mut solved);
    close(&[dot(&white, &white)], &[dot(&d, &solved)]);
    set.whiten_transpose(&mut white);
    close(&white, &solved);
    // R^{1/2} and its transpose
    let mut product = normals(4, m);
    set.errors().root_transpose(&mut product);
    set.errors().root(&mut product);
    let expected: Vec<f64> = (0..m).map(|i| dot(&normals(4, m), &r[i * m..][..m])).collect();
    close(&product, &expected);
}

/// One wrong entry of R is seen.
#[test]
fn a_place_that_is_off_is_seen() {
    let mut moved = seen();
    moved[0].chain.as_mut().unwrap().entries[1].1 += 1e-3;
    let set = ObservationSet::new(10, vec![all_of(3)], moved).unwrap();
    let worst = |r: Vec<f64>| r.iter().zip(defined(&set)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(worst(set.error_covariance()) > 1e-6);
}

#[test]
fn a_chain_of_which_rows_are_left_out_is_that_of_the_rest() {
    let set = ObservationSet::new(10, vec![all_of(3)], seen()).unwrap();
    let (m, full) = (set.dim(), set.error_covariance());
    let rest = set.without(&[1, 4]).unwrap();
    let kept: Vec<usize> = (0..m).filter(|i| ![1, 4].contains(i)).collect();
    let expected: Vec<f64> = {
        let column = |j: usize| kept.iter().map(|i| full[i + j * m]).collect::<Vec<f64>>();
        kept.iter().flat_map(|j| column(*j)).collect()
    };
    close(&rest.error_covariance(), &expected);
}

#[test]
fn cost_gradient_and_products_at_two_controls() {
    let b = coupled(3, 0.4);
    let mut set = ObservationSet::new(10, vec![all_of(3)], seen()).unwrap();
    let (m, r) = (set.dim(), defined(&set));
    let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
    let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b).unwrap();
    let values = set.values().to_vec();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    check_gradient(&mut cost, &normals(48, 3), &normals(49, 3));
    for seed in [50, 60] {
        let (v, dv, dy) = (normals(seed, 3), normals(seed + 1, 3), normals(seed + 2, m));
        let j = cost.evaluate(&v, Some(&mut [0.0; 3])).unwrap();
        let d: Vec<f64> = cost.predicted().iter().zip(&values).map(|(h, y)| y - h).collect();
        let mut solved = vec![0.0; m];
        Dense::new(m, &r).unwrap().solve(&d, &mut solved);
        let expected = 0.5 * (dot(&v, &v) + dot(&d, &solved));
        assert!((j - expected).abs() <= 1e-13 * expected, "{j} {expected}");
        let (mut gv, mut gty, mut av) = (vec![0.0; m], vec![0.0; 3], vec![0.0; 3]);
        cost.jacobian(&dv, &mut gv).unwrap();
        cost.jacobian_transpose(&dy, &mut gty).unwrap();
        let (left, right) = (dot(&gv, &dy), dot(&dv, &gty));
        // sums of some ten products
        assert!((left - right).abs() <= 1e-12 * (1.0 + left.abs()), "{left} {right}");
        cost.hessian_apply(&dv, &mut av).unwrap();
        let mut hessian = vec![0.0; 9];
        cost.hessian(&mut hessian).unwrap();
        for i in 0..3 {
            let row: f64 = (0..3).map(|j| hessian[i + 3 * j] * dv[j]).sum();
            assert!((row - av[i]).abs() <= 1e-11 * (1.0 + av[i].abs()), "{row} {}", av[i]);
        }
    }
}

#[test]
fn what_is_no_chain_is_an_error() {
    let of = |seen: Vec<Observation>| ObservationSet::new(10, vec![all_of(3)], seen).err();
    let mut twice = seen();
    twice.push(twice[0].clone());
    assert!(matches!(of(twice), Some(Error::Covariance(_))));
    let mut mixed = seen();
    mixed[0].chain.as_mut().unwrap().kernel = Kernel::Matern12 { length: 2.5 };
    assert!(matches!(of(mixed), Some(Error::MixedChain)));
    let mut short = seen();
    short[0].chain.as_mut().unwrap().entries.pop();
    assert!(matches!(of(short), Some(Error::Length { .. })));
    let mut nowhere = seen();
    nowhere[0].chain.as_mut().unwrap().entries[0].1 = f64::NAN;
    assert!(of(nowhere).is_some());
}
