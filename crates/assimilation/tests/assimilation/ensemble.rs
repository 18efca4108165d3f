//! 4D-EnVar and its hybrid: what they equal, what they call, what they return.

use crate::cost::coupled;
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Diagonal, Ensemble, Hybrid, Localization, Taper};
use varda_implicit::Model;

const N: usize = 6;

/// A stable linear model that couples neighbours.
pub(crate) fn linear(n: usize) -> Rk4<Linear> {
    let mut a = vec![0.0; n * n];
    for i in 0..n {
        a[i * n + i] = -0.4;
        a[i * n + (i + 1) % n] = 1.1;
        a[i * n + (i + n - 1) % n] = -0.7;
    }
    Rk4::new(Linear(n, a), 0.1)
}

/// Components 0, 2 and 5 seen at steps 0, 4, 7.5 and 10.
pub(crate) fn observed(seed: u64) -> ObservationSet {
    let y = normals(seed, 12);
    let seen = [(0, 0.0), (4, 0.0), (7, 0.5), (10, 0.0)]
        .iter()
        .enumerate()
        .map(|(j, (step, weight))| {
            observation(&[0, 2, 5], *step, *weight, &y[3 * j..3 * j + 3], 0.3 + 0.1 * j as f64)
        })
        .collect();
    ObservationSet::new(12, vec![all_of(N)], seen).unwrap()
}

/// X with X Xᵀ = B, all columns: an ensemble that spans, and represents B exactly (n + 1 members whose
/// perturbations sum to zero).
pub(crate) fn spanning(b: &dyn Covariance, mean: &[f64]) -> Vec<f64> {
    let n = b.dim();
    // A Helmert basis: n vectors of length n + 1, orthonormal and orthogonal to (1, …, 1).
    let mut members = vec![0.0; (n + 1) * n];
    let (mut unit, mut column) = (vec![0.0; n], vec![0.0; n]);
    for j in 0..n {
        unit[j] = 1.0;
        b.root(&unit, &mut column);
        unit[j] = 0.0;
        let length = (((j + 1) * (j + 2)) as f64).sqrt();
        for i in 0..=j + 1 {
            let h = if i <= j { 1.0 } else { -((j + 1) as f64) } / length;
            for p in 0..n {
                members[i * n + p] += (n as f64).sqrt() * h * column[p];
            }
        }
    }
    members.chunks_exact_mut(n).for_each(|x| x.iter_mut().zip(mean).for_each(|(x, m)| *x += m));
    members
}

fn boxed(make: impl Fn() -> Rk4<Linear>) -> impl Fn() -> Box<dyn Model + Send> {
    move || Box::new(make())
}

fn difference(a: &[f64], b: &[f64]) -> f64 {
    norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>()) / norm(b)
}

/// z_a, the variances of P_a and J by strong 4D-Var.
fn strong(
    b: &dyn Covariance,
    background: &[f64],
    set: &mut ObservationSet,
    model: &mut dyn Model,
) -> (Vec<f64>, Vec<f64>, f64) {
    let transform = ControlTransform::new(background.to_vec(), b).unwrap();
    let mut cost = StrongConstraint::new(model, transform.clone(), set).unwrap();
    let mut v = vec![0.0; transform.dim()];
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-12).with_initial_radius(100.0);
    let minimum = trust_region(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(())).unwrap();
    let posterior = Posterior::new(&mut cost).unwrap();
    let mut z = background.to_vec();
    transform.control(&v, &mut z);
    (z, posterior.variance(&transform), minimum.value)
}

#[test]
fn a_spanning_ensemble_is_linear_strong_4dvar_and_calls_no_tangent_or_adjoint() {
    let b = coupled(N, 0.8);
    let background = normals(1, N);
    let (mut set, mut again) = (observed(2), observed(2));
    let (expected, variance, value) = strong(&b, &background, &mut again, &mut linear(N));
    let ensemble = Ensemble::new(&spanning(&b, &background), Localization::none(N)).unwrap();
    for spread in [1.0, 1e-3] {
        let make = boxed(|| linear(N));
        let mut cost = EnVar::new(&make, ensemble.mean().to_vec(), &ensemble, &mut set, &[]).unwrap();
        let mut v = vec![0.0; cost.dim()];
        cost.set_spread(spread);
        cost.relinearize(&v).unwrap();
        let minimum = cost
            .minimize(&mut v, &EnVarOptions::default().with_max_outer(1), &mut |_| ControlFlow::Continue(()));
        let minimum = minimum.unwrap();
        assert_eq!((minimum.status, minimum.outer_iterations), (Status::Converged, 1));
        let mut z = background.clone();
        cost.transform().control(&v, &mut z);
        // Differences over 1e-3 lose three digits to rounding.
        assert!(difference(&z, &expected) <= 1e-11 / spread, "{:e}", difference(&z, &expected));
        assert!((minimum.value - value).abs() <= 1e-11 / spread * value);
        // The posterior by its dense Hessian and by the square root are that of 4D-Var.
        let transform = cost.transform().clone();
        let by_hessian = Posterior::new(&mut cost).unwrap().variance(&transform);
        let columns = cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot).unwrap();
        let by_root: Vec<f64> = (0..N).map(|p| columns.chunks(N).map(|x| x[p] * x[p]).sum()).collect();
        assert!(difference(&by_hessian, &variance) <= 1e-10 / spread);
        assert!(difference(&by_root, &variance) <= 1e-10 / spread);
        let sum: Vec<f64> = (0..N).map(|p| columns.chunks(N).map(|x| x[p]).sum()).collect();
        assert!(norm(&sum) <= 1e-10 / spread, "the update moved the mean");
        let counts = cost.counts();
        assert_eq!(
            (counts.model.tangent_steps, counts.model.adjoint_steps, counts.model.linearizations),
            (0, 0, 0)
        );
        assert_eq!((counts.tangent_sweeps, counts.adjoint_sweeps), (0, 0));
        // Twice (the constructor's and the one here) the control and N + 1 members over 10 steps, none beyond
        // the last observation, and once the control from the analysis, whose J is reported.
        assert_eq!((counts.forward_runs, counts.model.model_steps), (17, 170));
    }
    // The check can fail: with other observations the analysis is another one.
    assert!(difference(&strong(&b, &background, &mut observed(3), &mut linear(N)).0, &expected) > 1e-2);
}

#[test]
fn every_minimizer_finds_the_exact_solve() {
    let (background, b) = (normals(1, N), coupled(N, 0.8));
    let ensemble = Ensemble::new(&spanning(&b, &background), Localization::none(N)).unwrap();
    let mut set = observed(2);
    let mut cost = EnVar::new(&boxed(|| linear(N)), background, &ensemble, &mut set, &[]).unwrap();
    let mut expected = vec![0.0; cost.dim()];
    cost.solve(&mut expected).unwrap();
    for minimizer in [
        Minimizer::default(),
        Minimizer::TrustRegion(TrustRegionOptions::default().with_dense_limit(0)),
        Minimizer::NewtonCg(NewtonCgOptions::default()),
        Minimizer::Newton(NewtonOptions::default()),
    ] {
        let mut v = vec![0.0; cost.dim()];
        let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
        assert_eq!(minimum.status, Status::Converged);
        assert!(difference(&v, &expected) <= 1e-7, "{minimizer:?}");
    }
}

/// Localized and hybrid, on Lorenz-96: no closed form shared with the code under test.
fn curved<'a>(hybrid: &'a Hybrid<'a>, set: &'a mut ObservationSet, background: &[f64]) -> EnVar<'a> {
    let anchors: Vec<usize> = set.observations().iter().flat_map(|o| o.rows.clone()).collect();
    EnVar::hybrid(&|| Box::new(Rk4::new(Lorenz96(N), 0.03)), background.to_vec(), hybrid, set, &anchors)
        .unwrap()
}

fn localized(seed: u64, members: usize) -> Ensemble {
    let taper = Taper::GaspariCohn { support: 5.0 };
    let c = Localization::by_distance(taper, N, |i, j| i.abs_diff(j) as f64, 0.0).unwrap();
    let members: Vec<f64> = normals(seed, members * N).iter().map(|x| 0.3 * x).collect();
    Ensemble::new(&members, c).unwrap()
}

fn variance_is_that_of_the_dense_hessian(cost: &mut EnVar) {
    let (variance, degrees_of_freedom) = cost.posterior_variance().unwrap();
    let transform = cost.transform().clone();
    let dense = Posterior::new(cost).unwrap();
    // Two eigenvalue decompositions of matrices of condition 1e3 at most.
    for (a, b) in variance.iter().zip(dense.variance(&transform)) {
        assert!((a - b).abs() <= 1e-11 * b, "{a} {b}");
    }
    assert!((degrees_of_freedom - dense.degrees_of_freedom()).abs() <= 1e-10);
}

/// In observation space, and, where the members are fewer than the observations, among the members.
#[test]
fn posterior_variance_is_that_of_the_dense_hessian() {
    let static_part = coupled(N, 0.4);
    let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
    let hybrid = Hybrid::new(&static_part, 0.6, localized(4, 5), 0.8).unwrap();
    let mut set = observed(6);
    let mut cost = curved(&hybrid, &mut set, &background);
    assert!(cost.dim() > 12);
    variance_is_that_of_the_dense_hessian(&mut cost);

    let members: Vec<f64> = normals(4, 5 * N).iter().map(|x| 0.3 * x).collect();
    let few = Ensemble::new(&members, Localization::none(N)).unwrap();
    let mut set = observed(6);
    let make = || -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz96(N), 0.03)) };
    let mut cost = EnVar::new(&make, background, &few, &mut set, &[]).unwrap();
    assert!(cost.dim() < 12);
    variance_is_that_of_the_dense_hessian(&mut cost);
}

/// One component seen with σ = 1e-9 by a strong constraint and by members, fewer and more values than
/// unknowns: its variance is σ² b/(b + σ²) to rounding of the root (ε √(b/σ²) = 1e-7), where
/// GGᵀ would leave 1e-16 b.
#[test]
fn tiny_sigmas_leave_exact_variances() {
    let sigma = 1e-9;
    let members: Vec<f64> = normals(4, 5 * N).iter().map(|x| 0.3 * x).collect();
    let few = Ensemble::new(&members, Localization::none(N)).unwrap();
    let make = || -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz96(N), 0.03)) };
    for rows in [vec![0], vec![0; 8]] {
        let seen = observation(&rows, 0, 0.0, &vec![0.0; rows.len()], sigma * (rows.len() as f64).sqrt());
        let mut set = ObservationSet::new(0, vec![all_of(N)], vec![seen.clone()]).unwrap();
        let cost = EnVar::new(&make, vec![0.0; N], &few, &mut set, &[]).unwrap();
        let mean = |p: usize| (0..5).map(|i| members[i * N + p]).sum::<f64>() / 5.0;
        let b = (0..5).map(|i| (members[i * N] - mean(0)).powi(2)).sum::<f64>() / 4.0;
        let expected = sigma * sigma * b / (b + sigma * sigma);
        let (variance, freedom) = cost.posterior_variance().unwrap();
        assert!((variance[0] / expected - 1.0).abs() < 1e-6, "{} {expected}", variance[0]);
        assert!((freedom - 1.0).abs() < 1e-12);
    }
    let b = coupled(N, 0.4);
    let mut set =
        ObservationSet::new(0, vec![all_of(N)], vec![observation(&[0], 0, 0.0, &[0.0], sigma)]).unwrap();
    let transform = ControlTransform::new(vec![0.0; N], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
    cost.evaluate(&[0.0; N], Some(&mut [0.0; N])).unwrap();
    let posterior = Posterior::new(&mut cost).unwrap();
    let mut prior = vec![0.0; N];
    b.variance(&mut prior);
    let expected = sigma * sigma * prior[0] / (prior[0] + sigma * sigma);
    let found = posterior.variance(&transform)[0];
    assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
    assert_eq!(posterior.spectrum()[..N - 1], [1.0; N - 1]);
}

#[test]
fn gradient_and_products_at_two_successive_linearizations() {
    let static_part = coupled(N, 0.4);
    let hybrid = Hybrid::new(&static_part, 0.6, localized(4, 5), 0.8).unwrap();
    let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
    let mut set = observed(6);
    let mut cost = curved(&hybrid, &mut set, &background);
    let (n, m) = (cost.dim(), cost.observation_dim());
    assert_eq!((n, m), (N + 5 * hybrid.ensemble().localization().rank(), 12));
    for (about, at) in [(7, 8), (9, 10)] {
        let about: Vec<f64> = normals(about, n).iter().map(|v| 0.3 * v).collect();
        cost.relinearize(&about).unwrap();
        // Where it was linearized the quadratic J is the nonlinear one.
        let value = cost.evaluate(&about, None).unwrap();
        assert!((value - cost.nonlinear_value(&about).unwrap()).abs() <= 1e-12 * value);
        let (v, p) = (normals(at, n), normals(at + 20, n));
        let mut g = vec![0.0; n];
        let value = cost.evaluate(&v, Some(&mut g)).unwrap();
        let scale = |h: f64| -> Vec<f64> { v.iter().zip(&p).map(|(v, p)| v + h * p).collect() };
        // Quadratic: the remainder is exactly ½ h² pᵀ A p, at every h.
        let mut product = vec![0.0; n];
        cost.hessian_apply(&p, &mut product).unwrap();
        for h in [1.0, 0.1, 0.01] {
            let rest = cost.evaluate(&scale(h), None).unwrap() - value - h * dot(&g, &p);
            let expected = 0.5 * h * h * dot(&p, &product);
            assert!((rest - expected).abs() <= 1e-11 * value, "{h}: {rest} {expected}");
        }
        let (dv, w) = (normals(at + 30, n), normals(at + 40, m));
        let (mut dy, mut back) = (vec![0.0; m], vec![0.0; n]);
        cost.jacobian(&dv, &mut dy).unwrap();
        cost.jacobian_transpose(&w, &mut back).unwrap();
        assert!((dot(&dy, &w) - dot(&dv, &back)).abs() <= 1e-14 * norm(&dy) * norm(&w) * 10.0);
        let mut hessian = vec![0.0; n * n];
        cost.hessian(&mut hessian).unwrap();
        let by_matrix: Vec<f64> = (0..n).map(|i| (0..n).map(|j| hessian[i + j * n] * p[j]).sum()).collect();
        assert!(difference(&by_matrix, &product) <= 1e-12);
        // The exact solve is where the gradient vanishes.
        let mut best = vec![0.0; n];
        cost.solve(&mut best).unwrap();
        cost.evaluate(&best, Some(&mut g)).unwrap();
        assert!(norm(&g) <= 1e-10 * norm(&best), "{:e}", norm(&g));
    }
}

/// For a small spread the ensemble's G is that of the tangent, at any v: against strong 4D-Var with the same
/// root.
#[test]
fn the_bundle_is_the_tangent_and_outer_loops_reach_the_minimum_of_strong_4dvar() {
    let b = coupled(N, 0.3);
    let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
    let ensemble = Ensemble::new(&spanning(&b, &background), Localization::none(N)).unwrap();
    let (mut set, mut again) = (observed(6), observed(6));
    let mut model = Rk4::new(Lorenz96(N), 0.03);
    let (expected, _, value) = strong(&b, &background, &mut again, &mut model);
    let mut cost =
        EnVar::new(&|| Box::new(Rk4::new(Lorenz96(N), 0.03)), background.clone(), &ensemble, &mut set, &[])
            .unwrap();
    cost.set_spread(1e-5);
    let options = EnVarOptions::default().with_max_outer(60).with_step_tolerance(1e-9);
    let mut v = vec![0.0; cost.dim()];
    cost.relinearize(&v).unwrap();
    let mut values = Vec::new();
    let minimum = cost
        .minimize(&mut v, &options, &mut |i| {
            values.push(i.value);
            ControlFlow::Continue(())
        })
        .unwrap();
    assert_eq!(minimum.status, Status::Converged, "{values:?}");
    let mut z = background.clone();
    cost.transform().control(&v, &mut z);
    // One-sided differences over 1e-5 leave a relative 1e-5 in the gradient, J is stationary: its square.
    assert!(difference(&z, &expected) <= 1e-4, "{:e}", difference(&z, &expected));
    assert!((minimum.value - value).abs() <= 1e-8 * value, "{} {value}", minimum.value);
    let model = cost.counts().model;
    assert_eq!((model.tangent_steps, model.adjoint_steps, model.linearizations), (0, 0, 0));
}

#[test]
fn the_same_bits_on_one_thread_and_on_two() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let static_part = coupled(N, 0.4);
            let hybrid = Hybrid::new(&static_part, 0.6, localized(4, 7), 0.8).unwrap();
            let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
            let mut set = observed(6);
            let mut cost = curved(&hybrid, &mut set, &background);
            let mut v = vec![0.0; cost.dim()];
            let minimum =
                cost.minimize(&mut v, &EnVarOptions::default(), &mut |_| ControlFlow::Continue(())).unwrap();
            let columns = cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot).unwrap();
            (v, minimum.value, minimum.outer_iterations, columns)
        })
    };
    let one = run(1);
    assert!(one.2 > 1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(3));
}

/// β = (1, 0): nothing moves with the window but the innovations (3D-FGAT). β = (0, 1): 4D-EnVar. Dense
/// references by hand.
#[test]
fn hybrid_weights_zero_and_one_are_the_pure_ends() {
    let static_part = coupled(N, 0.4);
    let ensemble = localized(4, 5);
    let background = normals(5, N);
    let analyse = |weights: (f64, f64)| {
        let hybrid = Hybrid::new(&static_part, weights.0, ensemble.clone(), weights.1).unwrap();
        let mut set = observed(6);
        let mut cost = curved(&hybrid, &mut set, &background);
        let mut v = vec![0.0; cost.dim()];
        cost.solve(&mut v).unwrap();
        let mut z = background.clone();
        cost.transform().control(&v, &mut z);
        (z, cost.whitened_innovations().to_vec())
    };
    let (fgat, innovations) = analyse((1.0, 0.0));

    // 3D-FGAT: 3D-Var with the innovations of the run as observations of the increment at one time.
    let rows: Vec<usize> = (0..4).flat_map(|_| [0, 2, 5]).collect();
    let sigma: Vec<f64> = (0..4).flat_map(|j| [0.3 + 0.1 * f64::from(j); 3]).collect();
    let mut at_once = observation(&rows, 0, 0.0, &innovations, 1.0);
    at_once.values.iter_mut().zip(&sigma).for_each(|(d, s)| *d *= s);
    at_once.sigma = sigma;
    let mut set = ObservationSet::new(0, vec![all_of(N)], vec![at_once]).unwrap();
    let transform = ControlTransform::new(vec![0.0; N], &static_part).unwrap();
    let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
    let mut v = vec![0.0; N];
    Minimizer::Newton(NewtonOptions::default())
        .minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))
        .unwrap();
    let mut increment = vec![0.0; N];
    transform.control(&v, &mut increment);
    let found: Vec<f64> = fgat.iter().zip(&background).map(|(z, b)| z - b).collect();
    assert!(difference(&found, &increment) <= 1e-8, "{:e}", difference(&found, &increment));

    let (pure, _) = analyse((0.0, 1.0));
    let mut set = observed(6);
    let anchors: Vec<usize> = rows.clone();
    let mut cost = EnVar::new(
        &|| Box::new(Rk4::new(Lorenz96(N), 0.03)),
        background.clone(),
        &ensemble,
        &mut set,
        &anchors,
    )
    .unwrap();
    let mut v = vec![0.0; cost.dim()];
    cost.solve(&mut v).unwrap();
    let mut z = background.clone();
    cost.transform().control(&v, &mut z);
    assert!(difference(&pure, &z) <= 1e-13);
    assert!(difference(&pure, &fgat) > 1e-3);
}

/// With everything at step 0 localization in observation space is the Schur product in state space: BLUE with
/// the dense C ∘ X Xᵀ.
#[test]
fn localization_is_the_schur_product_where_everything_is_seen_at_once() {
    let ensemble = localized(4, 4);
    let background = normals(5, N);
    let seen = || {
        ObservationSet::new(0, vec![all_of(N)], vec![observation(&[0, 3, 4], 0, 0.0, &[1.0, -0.5, 0.2], 0.5)])
    };
    let (mut set, mut again) = (seen().unwrap(), seen().unwrap());
    let mut cost =
        EnVar::new(&boxed(|| linear(N)), background.clone(), &ensemble, &mut set, &[0, 3, 4]).unwrap();
    let mut v = vec![0.0; cost.dim()];
    cost.solve(&mut v).unwrap();
    let mut z = background.clone();
    cost.transform().control(&v, &mut z);
    let (expected, _, _) = strong(&ensemble, &background, &mut again, &mut linear(N));
    assert!(difference(&z, &expected) <= 1e-9, "{:e}", difference(&z, &expected));
}

#[test]
fn perturbed_observations_have_the_posterior_spread_on_average() {
    let b = coupled(N, 0.8);
    let background = normals(1, N);
    let (_, variance, _) = strong(&b, &background, &mut observed(2), &mut linear(N));
    // 4000 members drawn from B: sampling errors of 1/√8000 in a standard deviation, 5 of them allowed.
    let members: Vec<f64> = (0..4000)
        .flat_map(|i| {
            let mut x = vec![0.0; N];
            b.root(&normals(10_000 + i, N), &mut x);
            x
        })
        .collect();
    let ensemble = Ensemble::new(&members, Localization::none(N)).unwrap();
    let mut set = observed(2);
    let mut cost = EnVar::new(&boxed(|| linear(N)), background, &ensemble, &mut set, &[]).unwrap();
    let noise = normals(3, 4000 * 12);
    let mut next = 0;
    let mut normal = || {
        next += 1;
        noise[next - 1]
    };
    let columns =
        cost.posterior_perturbations(&mut EnsembleUpdate::PerturbedObservations(&mut normal)).unwrap();
    for p in 0..N {
        let spread = columns.chunks(N).map(|x| x[p] * x[p]).sum::<f64>().sqrt();
        assert!((spread / variance[p].sqrt() - 1.0).abs() <= 0.06, "{p}: {spread} {}", variance[p].sqrt());
    }
}

#[test]
fn what_does_not_fit_is_an_error_and_a_failing_member_leaves_the_cost_as_it_was() {
    let ensemble = localized(4, 5);
    let b = Diagonal::uniform(N, 1.0).unwrap();
    let mut set = observed(6);
    let make = boxed(|| linear(N));
    for anchors in [vec![], vec![0; 3], vec![N; 12]] {
        assert!(EnVar::new(&make, vec![0.0; N], &ensemble, &mut set, &anchors).is_err());
    }
    assert!(matches!(
        EnVar::new(&boxed(|| linear(N + 1)), vec![0.0; N], &ensemble, &mut set, &[0; 12]),
        Err(Error::Length { expected: 7, found: 6, .. })
    ));
    let hybrid = Hybrid::new(&b, 1.0, ensemble, 1.0).unwrap();
    let bounded = || -> Box<dyn Model + Send> {
        let mut model = linear(N);
        model.bound = 50.0;
        Box::new(model)
    };
    let mut cost = EnVar::hybrid(&bounded, vec![0.0; N], &hybrid, &mut set, &[0; 12]).unwrap();
    let v = normals(1, cost.dim());
    let mut before = vec![0.0; v.len()];
    let value = cost.evaluate(&v, Some(&mut before)).unwrap();
    let far: Vec<f64> = v.iter().map(|v| 1e3 * v).collect();
    assert!(matches!(cost.relinearize(&far), Err(Error::Model(_))));
    let mut after = vec![0.0; v.len()];
    assert_eq!(cost.evaluate(&v, Some(&mut after)).unwrap(), value);
    assert_eq!(before, after);
}
