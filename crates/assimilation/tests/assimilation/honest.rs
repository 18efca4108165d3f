//! Ends and spreads that mean what they say: a gradient that vanishes on a hill, copies of an eigenvalue, a
//! static part of B, nothing observed.

use crate::cost::coupled;
use crate::models::*;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Diagonal};
use varda_implicit::Model;

/// Every minimizer that a whitened cost can be given to.
fn minimizers() -> Vec<Minimizer> {
    let all = [
        Minimizer::Auto(AutoOptions::default()),
        Minimizer::TrustRegion(TrustRegionOptions::default()),
        Minimizer::TrustRegion(TrustRegionOptions::default().with_dense_limit(0)),
        Minimizer::NewtonCg(NewtonCgOptions::default()),
        Minimizer::Lbfgs(LbfgsOptions::default().with_max_iterations(200)),
        Minimizer::Adam(AdamOptions::default().with_max_iterations(20_000).with_gradient_tolerance(1e-3)),
    ];
    all.into()
}

/// y = x_i² of each component, one by one.
struct Squares(usize);

impl ObservationOperator for Squares {
    fn dim(&self) -> usize {
        self.0
    }
    fn state_dim(&self) -> usize {
        self.0
    }
    fn observe(&mut self, _at: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
        y.iter_mut().zip(x).for_each(|(y, x)| *y = x * x);
        Ok(())
    }
    fn tangent(&mut self, _at: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
        dy.iter_mut().zip(x.iter().zip(dx)).for_each(|(dy, (x, dx))| *dy = 2.0 * x * dx);
    }
    fn adjoint_add(&mut self, _at: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
        dx.iter_mut().zip(x.iter().zip(dy)).for_each(|(dx, (x, dy))| *dx += 2.0 * x * dy);
    }
}

/// x_i² of the first `seen` of n components observed as 1 ± 0.1, from x_b = 0 ± 1.
fn with_hill(n: usize, seen: usize, minimizer: &Minimizer) -> (Minimum, Vec<f64>) {
    let y = observation(&(0..seen).collect::<Vec<_>>(), 0, 0.0, &vec![1.0; seen], 0.1);
    let mut set = ObservationSet::new(0, vec![Box::new(Squares(n))], vec![y]).unwrap();
    let b = Diagonal::uniform(n, 1.0).unwrap();
    let transform = ControlTransform::new(vec![0.0; n], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
    let mut v = vec![0.0; n];
    let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
    (minimum, v)
}

/// J = ½x² + 50 (1 − x²)² has a maximum of 50 at 0, and minima at x² = 1 − 1/200, where J is
/// ½ (1 − 1/400).
#[test]
fn a_maximum_without_gradient_is_left_by_every_minimizer() {
    let lowest = 0.5 * (1.0 - 1.0 / 400.0);
    for minimizer in minimizers() {
        let (minimum, v) = with_hill(1, 1, &minimizer);
        assert!(minimum.started_beside, "{minimizer:?}");
        assert_eq!(minimum.status, Status::Converged, "{minimizer:?}: {minimum:?}");
        // To the gradient that is left: the curvature is 398.
        let left = minimum.gradient_norm;
        assert!((minimum.value - lowest).abs() <= left * left + 1e-14, "{minimizer:?}: {minimum:?}");
        assert!((v[0].abs() - (1.0 - 1.0 / 200.0f64).sqrt()).abs() <= left + 1e-14, "{minimizer:?}: {v:?}");
    }
}

/// One of thirty components goes downhill from the background: a random direction alone would not show it.
#[test]
fn a_saddle_with_one_way_down_is_left() {
    for minimizer in minimizers() {
        let (minimum, _) = with_hill(30, 1, &minimizer);
        assert!(minimum.started_beside && minimum.value < 0.6, "{minimizer:?}: {minimum:?}");
    }
}

/// A minimum that is one stays one: y = x² seen as −1, whose misfit nothing lowers.
#[test]
fn a_minimum_without_gradient_is_kept() {
    for minimizer in minimizers() {
        let y = observation(&[0, 1], 0, 0.0, &[-1.0, -2.0], 0.1);
        let mut set = ObservationSet::new(0, vec![Box::new(Squares(2))], vec![y]).unwrap();
        let b = Diagonal::uniform(2, 1.0).unwrap();
        let transform = ControlTransform::new(vec![0.0; 2], &b).unwrap();
        let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
        let mut v = vec![0.0; 2];
        let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
        assert_eq!((minimum.status, minimum.started_beside), (Status::Converged, false), "{minimizer:?}");
        assert_eq!(v, [0.0; 2]);
    }
}

/// Some of n unknowns of B = I seen directly with one σ: variances σ²/(1 + σ²) there and 1 elsewhere.
fn seen_alike(n: usize, seen: usize, sigma: f64) -> (LowRankPosterior, Vec<f64>) {
    let y = observation(&(0..seen).collect::<Vec<_>>(), 0, 0.0, &normals(3, seen), sigma);
    let mut set = ObservationSet::new(0, vec![all_of(n)], vec![y]).unwrap();
    let b = Diagonal::uniform(n, 1.0).unwrap();
    let transform = ControlTransform::new(vec![0.0; n], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
    cost.evaluate(&vec![0.0; n], Some(&mut vec![0.0; n])).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let posterior = LowRankPosterior::lanczos(&mut cost, &LanczosOptions::default(), &mut rng).unwrap();
    let variance = posterior.control_variable_variance();
    (posterior, variance)
}

#[test]
fn lanczos_finds_every_copy_of_an_eigenvalue() {
    for (n, seen, sigma) in
        [(3, 2, 0.1), (40, 20, 0.5), (144, 12, 0.1), (144, 144, 0.3), (1, 1, 0.1), (5, 0, 1.0)]
    {
        let (posterior, variance) = seen_alike(n, seen, sigma);
        let right = sigma * sigma / (1.0 + sigma * sigma);
        for (i, v) in variance.iter().enumerate() {
            let expected = if i < seen { right } else { 1.0 };
            // The bound asked for.
            assert!((v - expected).abs() <= 1e-6, "{n} {seen} {i}: {v} {expected}");
        }
        let freedom = seen as f64 * (1.0 - right);
        assert!(
            (posterior.degrees_of_freedom() - freedom).abs() <= 1e-5,
            "{}",
            posterior.degrees_of_freedom()
        );
        assert!(posterior.error_bound().is_some_and(|bound| bound <= 1e-6), "{:?}", posterior.error_bound());
        // Two products a direction and the probes.
        assert!(posterior.products() <= 2 * seen + 10 + 6, "{seen}: {}", posterior.products());
    }
}

/// Nothing seen and x still: B grows by β² B_s a window.
#[test]
fn the_spread_of_a_propagated_posterior_has_its_static_part() {
    let make = |_: usize| -> Box<dyn Model + Send> { Box::new(Rk4::new(Linear(1, vec![0.0]), 0.1)) };
    let nothing = |_: usize| ObservationSet::new(1, vec![all_of(1)], vec![]);
    let cycling = Cycling {
        first: 0,
        window: 1,
        shift: 1,
        cycles: 4,
        make_model: &make,
        observations: &nothing,
        truth: None,
        model_error: None,
        posterior: false,
    };
    let b = Diagonal::uniform(1, 1.0).unwrap();
    for (inflation, beta) in [(1.0, 1.0), (1.2, 0.5), (1.0, 0.0)] {
        let static_part = (beta > 0.0).then_some((&b as &dyn Covariance, beta));
        let covariance = CycledCovariance::Propagated { first: &b, inflation, static_part, dropped: 0.0 };
        let mut state = CycleState::new(vec![0.3]);
        let minimizer = Minimizer::default();
        let go_on = &mut |_: &Cycle, _: &CycleState| ControlFlow::Continue(());
        let cycles = cycle(&cycling, &mut state, &covariance, &minimizer, go_on).unwrap();
        let mut variance = 1.0_f64;
        for c in &cycles {
            variance = inflation * inflation * variance + beta * beta;
            let spread = c.spread().unwrap();
            assert!((spread - variance.sqrt()).abs() <= 1e-12, "{beta} {}: {spread}", c.index);
        }
    }
}

/// Without observations the estimate is the background, and its covariance is B, in both forms.
#[test]
fn the_closed_form_without_observations_is_the_background() {
    for n in [1, 4] {
        let b = coupled(n, 0.8);
        let mut covariance = vec![0.0; n * n];
        for j in 0..n {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            b.apply(&unit, &mut covariance[j * n..][..n]);
        }
        for gain in [Gain::Observation, Gain::Information] {
            let mut set = ObservationSet::new(0, vec![all_of(n)], vec![]).unwrap();
            let transform = ControlTransform::new(normals(1, n), &b).unwrap();
            let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
            let blue = Blue::new(&mut cost, &vec![0.0; n], gain).unwrap();
            assert_eq!((blue.value, blue.analysis(&transform)), (0.0, transform.background().to_vec()));
            for (p, b) in blue.control_covariance(&transform).iter().zip(&covariance) {
                assert!((p - b).abs() <= 1e-13, "{gain:?}: {p} {b}");
            }
        }
    }
}

/// σ of ten orders and more below that of the background: some of n unknowns seen through rows that
/// mix them, so that nothing is diagonal. P by exact elimination: a row that is known leaves the others
/// what B gives them.
#[test]
fn a_posterior_exists_however_small_sigma_is() {
    // two of four unknowns, B = I, seen as x₀ + x₁ and x₀ − x₁
    let rows = [(0, 0, 1.0), (0, 1, 1.0), (1, 0, 1.0), (1, 1, -1.0)];
    for sigma in [1e-3, 1e-8, 1e-10, 1e-14, 1e-100] {
        for seen in [1, 2] {
            let h = LinearObservation::new(seen, 4, &rows[..2 * seen]).unwrap();
            let y = observation(&(0..seen).collect::<Vec<_>>(), 0, 0.0, &normals(3, seen), sigma);
            let mut set = ObservationSet::new(0, vec![Box::new(h)], vec![y]).unwrap();
            let b = Diagonal::uniform(4, 1.0).unwrap();
            let transform = ControlTransform::new(vec![0.0; 4], &b).unwrap();
            let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
            cost.evaluate(&[0.0; 4], Some(&mut [0.0; 4])).unwrap();
            // of (x₀ ± x₁)/√2: one or both known to σ/√2
            let known = sigma * sigma / (2.0 + sigma * sigma);
            let expected = if seen == 2 { known } else { 0.5 * (1.0 + known) };
            let by_posterior = Posterior::new(&mut cost).unwrap();
            let of_initial = Posterior::of_initial_state(&mut cost).unwrap();
            let blues = [Gain::Observation, Gain::Information].map(|gain| {
                let blue = Blue::new(&mut cost, &[0.0; 4], gain).unwrap();
                let p = blue.control_covariance(&transform);
                (0..4).map(|i| p[i + 4 * i]).collect::<Vec<f64>>()
            });
            let posteriors = [&by_posterior, &of_initial].map(|p| p.variance(&transform));
            for (i, variance) in posteriors.iter().chain(&blues).enumerate() {
                for (v, right) in variance.iter().zip([expected, expected, 1.0, 1.0]) {
                    // To the digits that a factorization resolves: 10⁻⁶ relative, and rounding of B
                    // in the two forms of the closed one.
                    let bound = 1e-5 * right + if i < 2 { 0.0 } else { 1e-15 };
                    assert!((v - right).abs() <= bound, "{sigma:e} {seen} {i}: {v:e} {right:e}");
                }
            }
            let freedom = seen as f64 * (1.0 - known);
            assert!((by_posterior.degrees_of_freedom() - freedom).abs() <= 1e-6);
        }
    }
}

/// A linear window whose minimum is forty standard deviations away takes one iteration, dense and by
/// products.
#[test]
fn a_linear_problem_takes_one_iteration() {
    for n in [6, 150] {
        let b = coupled(n, 0.8);
        let seen = [3, 8].map(|k| {
            let y: Vec<f64> = normals(k as u64, 3).iter().map(|y| 30.0 + y).collect();
            observation(&[0, 2, 5], k, 0.0, &y, 0.3)
        });
        let mut set = ObservationSet::new(10, vec![all_of(n)], seen.into()).unwrap();
        let transform = ControlTransform::new(normals(1, n), &b).unwrap();
        let mut model = crate::ensemble::linear(n);
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        let blue = Blue::new(&mut cost, &vec![0.0; n], Gain::Observation).unwrap();
        assert!(norm(&blue.control_variable) > 10.0, "a test of the radius");
        for minimizer in [Minimizer::Auto(AutoOptions::default()), Minimizer::default()] {
            let mut v = vec![0.0; n];
            let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
            assert_eq!(
                (minimum.status, minimum.outer_iterations),
                (Status::Converged, 1),
                "{n}: {minimum:?}"
            );
            let gap: Vec<f64> = v.iter().zip(&blue.control_variable).map(|(v, b)| v - b).collect();
            assert!(norm(&gap) <= 1e-6, "{n}: {:e}", norm(&gap));
        }
    }
}
