//! Correlated observation errors: every method gives the closed form with the dense R.

use crate::cost::coupled;
use crate::matrix::check_gradient;
use crate::models::{all_of, normals, observation};
use std::ops::ControlFlow;
use std::sync::Arc;
use varda_assimilation::{
    Blue, ControlTransform, CostFunction, EnVar, Error, Gain, InnerSolver, LeastSquares, LinearObservation,
    Minimizer, Observation, ObservationSet, OuterLoopOptions, Posterior, StrongConstraint, outer_loop,
    predicted_variance,
};
use varda_covariance::{Covariance, Dense, Ensemble, Localization};
use varda_implicit::{Model, Rk4, lorenz::Lorenz63};

/// R of three rows: variances 0.04, 0.09, 0.16 and strong correlations.
const R: [f64; 9] = [0.04, 0.045, 0.02, 0.045, 0.09, 0.03, 0.02, 0.03, 0.16];

fn r() -> Arc<Dense> {
    Arc::new(Dense::new(3, &R).unwrap())
}

/// x with A x = b by elimination with pivots, A by columns.
fn solve(n: usize, matrix: &[f64], right: &[f64]) -> Vec<f64> {
    let (mut a, mut x) = (matrix.to_vec(), right.to_vec());
    for k in 0..n {
        let pivot = (k..n).max_by(|&i, &j| a[i + k * n].abs().total_cmp(&a[j + k * n].abs())).unwrap();
        (0..n).for_each(|j| a.swap(k + j * n, pivot + j * n));
        x.swap(k, pivot);
        for i in k + 1..n {
            let f = a[i + k * n] / a[k + k * n];
            (k..n).for_each(|j| a[i + j * n] -= f * a[k + j * n]);
            x[i] -= f * x[k];
        }
    }
    for k in (0..n).rev() {
        x[k] = (x[k] - (k + 1..n).map(|j| a[k + j * n] * x[j]).sum::<f64>()) / a[k + k * n];
    }
    x
}

/// H, four rows of a state of five: one with independent errors before and three with correlated ones.
fn operator() -> Vec<(usize, usize, f64)> {
    normals(7, 20).into_iter().enumerate().map(|(i, h)| (i / 5, i % 5, h)).collect()
}

fn set() -> ObservationSet {
    let seen = vec![
        Observation::new(0, vec![0], vec![0.7], 0.3),
        Observation::new(0, vec![1, 2, 3], vec![1.1, -0.4, 0.2], 1.0).correlated(r()),
    ];
    let h = LinearObservation::new(4, 5, &operator()).unwrap();
    ObservationSet::new(0, vec![Box::new(h)], seen).unwrap()
}

/// z_a − z_b = B Hᵀ (H B Hᵀ + R)⁻¹ (y − H z_b), and the trace of P_z = B − B Hᵀ (H B Hᵀ +
/// R)⁻¹ H B.
fn closed_form(b: &dyn Covariance, background: &[f64]) -> (Vec<f64>, f64) {
    let (n, m) = (5, 4);
    let mut h = vec![0.0; m * n];
    operator().into_iter().for_each(|(i, j, value)| h[i * n + j] = value);
    let set = set();
    let mut bht = vec![0.0; n * m];
    bht.chunks_exact_mut(n).zip(h.chunks_exact(n)).for_each(|(column, row)| b.apply(row, column));
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let mut s = set.error_covariance();
    for i in 0..m {
        (0..m).for_each(|j| s[i + j * m] += dot(&h[i * n..][..n], &bht[j * n..][..n]));
    }
    let d: Vec<f64> =
        set.values().iter().zip(h.chunks_exact(n)).map(|(y, row)| y - dot(row, background)).collect();
    let w = solve(m, &s, &d);
    let increment = (0..n).map(|i| (0..m).map(|j| bht[i + j * n] * w[j]).sum()).collect();
    let mut variance = vec![0.0; n];
    b.variance(&mut variance);
    let trace = (0..n)
        .map(|i| {
            let row: Vec<f64> = (0..m).map(|j| bht[i + j * n]).collect();
            variance[i] - dot(&row, &solve(m, &s, &row))
        })
        .sum();
    (increment, trace)
}

fn close(what: &str, found: &[f64], expected: &[f64]) {
    for (f, e) in found.iter().zip(expected) {
        // Condition numbers of a few hundred; gradients fall by 1e-10.
        assert!((f - e).abs() <= 1e-9 * (1.0 + e.abs()), "{what}: {found:?} {expected:?}");
    }
}

/// (H B Hᵀ)_ii by dense products, of rows with correlated errors as of one without.
#[test]
fn predicted_variances_are_those_of_the_dense_product() {
    let b = coupled(5, 0.6);
    let mut set = set();
    let errors = set.errors().clone();
    let transform = ControlTransform::new(vec![0.3, -0.2, 0.5, 0.1, -0.6], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
    let n = cost.dim();
    cost.evaluate(&vec![0.0; n], Some(&mut vec![0.0; n])).unwrap();
    let found = predicted_variance(&mut cost, &errors).unwrap();
    let mut h = [0.0; 20];
    operator().into_iter().for_each(|(i, j, value)| h[i * 5 + j] = value);
    let expected: Vec<f64> = h
        .chunks_exact(5)
        .map(|row| {
            let mut product = vec![0.0; 5];
            b.apply(row, &mut product);
            row.iter().zip(&product).map(|(h, p)| h * p).sum()
        })
        .collect();
    close("variance", &found, &expected);
    assert!(expected.iter().all(|variance| *variance > 0.1), "{expected:?}");
}

#[test]
fn every_method_gives_the_closed_form_with_the_dense_covariance() {
    let b = coupled(5, 0.6);
    let background = vec![0.3, -0.2, 0.5, 0.1, -0.6];
    let (increment, trace) = closed_form(&b, &background);
    let transform = ControlTransform::new(background.clone(), &b).unwrap();
    let moved = |v: &[f64]| {
        let mut z = vec![0.0; 5];
        transform.tangent(v, &mut z);
        z
    };
    for name in ["trust-region", "gauss-newton-cg", "newton", "lbfgs"] {
        let mut observations = set();
        let mut cost = StrongConstraint::without_model(transform.clone(), &mut observations).unwrap();
        let mut minimizer = Minimizer::named(name).unwrap();
        minimizer.stopping_mut().gradient_tolerance = 1e-11;
        let mut v = vec![0.0; 5];
        minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
        close(name, &moved(&v), &increment);
        cost.evaluate(&v, Some(&mut [0.0; 5])).unwrap();
        let posterior = Posterior::new(&mut cost).unwrap();
        close("trace of the posterior", &[posterior.trace(&transform)], &[trace]);
        let blocks = Posterior::of_initial_state(&mut cost).unwrap();
        close("trace by rows", &[blocks.trace(&transform)], &[trace]);
    }
    for inner in [InnerSolver::Primal, InnerSolver::Dual, InnerSolver::Direct] {
        let mut observations = set();
        let mut cost = StrongConstraint::without_model(transform.clone(), &mut observations).unwrap();
        let options = OuterLoopOptions::default().with_inner(inner).with_inner_tolerance(1e-12);
        let mut v = vec![0.0; 5];
        outer_loop(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(())).unwrap();
        close("outer loop", &moved(&v), &increment);
    }
    for gain in [Gain::Observation, Gain::Information] {
        let mut observations = set();
        let mut cost = StrongConstraint::without_model(transform.clone(), &mut observations).unwrap();
        let blue = Blue::new(&mut cost, &[0.0; 5], gain).unwrap();
        close("BLUE", &moved(&blue.control_variable), &increment);
    }
}

#[test]
fn an_ensemble_gives_the_closed_form_of_its_covariance() {
    let columns = normals(11, 20);
    let ensemble = Ensemble::from_perturbations(&columns, Localization::none(5)).unwrap();
    let background = vec![0.3, -0.2, 0.5, 0.1, -0.6];
    let (increment, _) = closed_form(&ensemble, &background);
    let mut observations = set();
    // At step 0 only: the model is not run.
    let make = || -> Box<dyn Model + Send> {
        Box::new(Rk4::new(varda_implicit::lorenz::Lorenz96::new(5, 8.0), 0, 0.01))
    };
    let mut cost = EnVar::new(&make, background.clone(), &ensemble, &mut observations, &[]).unwrap();
    let mut v = vec![0.0; cost.dim()];
    Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
    let mut z = vec![0.0; 5];
    cost.transform().tangent(&v, &mut z);
    close("4D-EnVar", &z, &increment);
    let (value, linear) = (cost.nonlinear_value(&v).unwrap(), cost.evaluate(&v, None).unwrap());
    assert!((value - linear).abs() <= 1e-12 * linear, "{value} {linear}");
}

#[test]
fn gradient_products_and_dense_hessians_agree_along_a_trajectory() {
    let b = coupled(3, 0.4);
    let few = vec![
        Observation::new(4, vec![0, 1, 2], vec![2.0, 3.0, 18.0], 1.0).correlated(r()),
        observation(&[1], 6, 0.5, &[4.0], 0.3),
        Observation::new(8, vec![2, 0, 1], vec![17.0, 3.0, 5.0], 1.0).between(0.3).correlated(r()),
    ];
    // With many observations G is formed by columns, with few by rows.
    let many: Vec<Observation> =
        (1..9).flat_map(|k| vec![few[0].clone().at_step(k), few[1].clone()]).collect();
    for (seen, delta) in [(few.clone(), f64::INFINITY), (many, f64::INFINITY), (few, 2.0)] {
        let mut set = ObservationSet::new(10, vec![all_of(3)], seen).unwrap();
        let m = set.dim();
        let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
        let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        cost.set_huber(delta).unwrap();
        check_gradient(&mut cost, &normals(48, 3), &normals(49, 3));
        let (v, dv, dy) = (normals(50, 3), normals(51, 3), normals(52, m));
        cost.evaluate(&v, Some(&mut [0.0; 3])).unwrap();
        let (mut gv, mut gty, mut av) = (vec![0.0; m], vec![0.0; 3], vec![0.0; 3]);
        cost.jacobian(&dv, &mut gv).unwrap();
        cost.jacobian_transpose(&dy, &mut gty).unwrap();
        let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
        let (left, right) = (dot(&gv, &dy), dot(&dv, &gty));
        // Sums of some ten products.
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
fn rows_left_out_leave_their_marginal_covariance_and_wrong_sizes_are_errors() {
    let all = set();
    assert!(all.is_correlated());
    let full = all.error_covariance();
    let rest = all.without(&[2]).unwrap();
    let kept = [0, 1, 3];
    for (i, &a) in kept.iter().enumerate() {
        for (j, &c) in kept.iter().enumerate() {
            assert!((rest.error_covariance()[i + 3 * j] - full[a + 4 * c]).abs() < 1e-15);
        }
    }
    let wrong = Observation::new(0, vec![0, 1], vec![0.0; 2], 1.0).correlated(r());
    assert!(ObservationSet::new(0, vec![all_of(5)], vec![wrong]).is_err());
    let b = coupled(5, 0.6);
    let mut observations = set();
    let transform = ControlTransform::new(vec![0.0; 5], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform, &mut observations).unwrap();
    assert!(matches!(cost.background_check(3.0), Err(Error::CorrelatedErrors { .. })));
}
