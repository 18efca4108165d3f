//! No observations, no steps, one unknown, one member, no windows: an answer that is right, or a typed error.

use crate::cost::coupled;
use crate::ensemble::linear;
use crate::matrix::Matrix;
use crate::models::*;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Diagonal, Ensemble, Hybrid, Localization};
use varda_implicit::Model;

/// A window of `steps` steps, with the first component seen at its end, or nothing seen.
fn window(n: usize, steps: usize, seen: bool) -> ObservationSet {
    let seen = seen.then(|| observation(&[0], steps, 0.0, &[0.7], 0.5));
    ObservationSet::new(steps, vec![all_of(n)], seen.into_iter().collect()).unwrap()
}

fn go_on(_: &Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Variances of P_a for a window of a linear model, by its Jacobian with respect to x₀: the reference.
fn variances(b: &dyn Covariance, steps: usize, seen: bool) -> Vec<f64> {
    let n = b.dim();
    let matrix = Matrix::of(b);
    if !seen {
        return (0..n).map(|i| matrix.at(i, i)).collect();
    }
    let mut h = vec![0.0; n];
    for (j, h) in h.iter_mut().enumerate() {
        let mut unit = vec![0.0; n];
        unit[j] = 1.0;
        *h = run(&mut linear(n), &unit, steps).pop().unwrap()[0];
    }
    let bh = matrix.apply(&h);
    let s = dot(&h, &bh) + 0.25;
    (0..n).map(|i| matrix.at(i, i) - bh[i] * bh[i] / s).collect()
}

fn close(a: &[f64], b: &[f64], what: &str) {
    assert_eq!(a.len(), b.len(), "{what}");
    for (a, b) in a.iter().zip(b) {
        // A handful of operations on numbers of order one; minimizers and Lanczos to 1e-8.
        assert!((a - b).abs() <= 1e-8, "{what}: {a} {b}");
    }
}

/// Every cost, minimizer, inner solver, closed form and posterior on every window that has little in it.
#[test]
fn windows_with_little_in_them() {
    for (n, steps, seen) in [1, 3]
        .iter()
        .flat_map(|n| [0, 2].map(|k| (*n, k)))
        .flat_map(|(n, k)| [false, true].map(|seen| (n, k, seen)))
    {
        let case = format!("{n} unknowns, {steps} steps, seen {seen}");
        let b = coupled(n, 0.8);
        let background = normals(4, n);
        let expected = variances(&b, steps, seen);
        let transform = ControlTransform::new(background.clone(), &b).unwrap();
        let mut set = window(n, steps, seen);
        let mut model = linear(n);
        let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
        let blue = Blue::new(&mut cost, &vec![0.0; n], Gain::Observation).unwrap();
        let analysis = blue.analysis(&transform);
        if !seen {
            assert_eq!((analysis.clone(), blue.value), (background.clone(), 0.0), "{case}");
        }
        let information = Blue::new(&mut cost, &vec![0.0; n], Gain::Information).unwrap();
        for (of, blue) in [("observation", &blue), ("information", &information)] {
            let p = blue.control_covariance(&transform);
            let diagonal: Vec<f64> = (0..n).map(|i| p[i + i * n]).collect();
            close(&diagonal, &expected, &format!("{case}, {of}"));
            close(&blue.analysis(&transform), &analysis, &case);
        }
        for name in Minimizer::NAMES.iter().filter(|name| **name != "adam") {
            let mut v = vec![0.0; n];
            let minimum = Minimizer::named(name).unwrap().minimize(&mut cost, &mut v, &mut go_on).unwrap();
            assert_eq!(minimum.status, Status::Converged, "{case}, {name}");
            let mut z = vec![0.0; n];
            transform.control(&v, &mut z);
            for (z, a) in z.iter().zip(&analysis) {
                // 1e-8 of the first gradient, of order one
                assert!((z - a).abs() <= 1e-6, "{case}, {name}: {z} {a}");
            }
        }
        close(&Posterior::new(&mut cost).unwrap().variance(&transform), &expected, &case);
        close(&Posterior::of_initial_state(&mut cost).unwrap().variance(&transform), &expected, &case);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let options = LanczosOptions::default().with_tolerance(1e-9);
        let low = LowRankPosterior::lanczos(&mut cost, &options, &mut rng).unwrap();
        close(&low.variance(&transform), &expected, &format!("{case}, lanczos"));
        let m = cost.observation_dim();
        let errors = cost.observations().errors().clone();
        let predicted = predicted_variance(&mut cost, &errors).unwrap();
        assert_eq!(predicted.len(), m);
        for solver in [InnerSolver::Primal, InnerSolver::Dual, InnerSolver::Direct] {
            let mut v = vec![0.0; n];
            let options = OuterLoopOptions::default().with_inner(solver);
            let end = outer_loop(&mut cost, &mut v, &options, &mut go_on).unwrap();
            assert_eq!(end.status, Status::Converged, "{case}, {solver:?}");
            let mut z = vec![0.0; n];
            transform.control(&v, &mut z);
            close(&z, &analysis, &format!("{case}, {solver:?}"));
        }
        weak(n, steps, seen, &b, &background);
        members(n, steps, seen, &b, &background);
    }
}

/// Weak constraint with an error of the model that is next to nothing.
fn weak(n: usize, steps: usize, seen: bool, b: &dyn Covariance, background: &[f64]) {
    let q = Diagonal::uniform(n, 1e-9).unwrap();
    let transform = ControlTransform::new(background.to_vec(), b).unwrap();
    let mut set = window(n, steps, seen);
    let mut model = linear(n);
    let mut cost =
        WeakForcing::new(&mut model, transform.clone(), &q, Forcing::every_step(n), &mut set).unwrap();
    let mut v = vec![0.0; cost.dim()];
    let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut go_on).unwrap();
    assert_eq!(minimum.status, Status::Converged, "{n} {steps} {seen}");
    let posterior = Posterior::of_initial_state(&mut cost).unwrap();
    close(&posterior.variance(&transform), &variances(b, steps, seen), "weak");
}

/// Two members of one unknown span it; one member has no spread, and is refused.
fn members(n: usize, steps: usize, seen: bool, b: &dyn Covariance, background: &[f64]) {
    let whole = || Localization::none(n);
    assert!(Ensemble::new(background, whole()).is_err() && Ensemble::new(&[], whole()).is_err());
    let make = || -> Box<dyn Model + Send> { Box::new(linear(n)) };
    let members = crate::ensemble::spanning(b, background);
    let ensemble = Ensemble::new(&members, whole()).unwrap();
    let mut set = window(n, steps, seen);
    let mut cost = EnVar::new(&make, background.to_vec(), &ensemble, &mut set, &[]).unwrap();
    let mut v = vec![0.0; cost.dim()];
    let minimum = cost.minimize(&mut v, &EnVarOptions::default(), &mut go_on).unwrap();
    assert_eq!(minimum.status, Status::Converged, "{n} {steps} {seen}");
    let (variance, _) = cost.posterior_variance().unwrap();
    close(&variance, &variances(b, steps, seen), "ensemble");
    let columns = cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot).unwrap();
    let by_root: Vec<f64> = (0..n).map(|p| columns.chunks(n).map(|x| x[p] * x[p]).sum()).collect();
    close(&by_root, &variances(b, steps, seen), "members");
    let hybrid = Hybrid::new(b, 0.0, ensemble.clone(), 1.0).unwrap();
    let mut set = window(n, steps, seen);
    let cost = EnVar::hybrid(&make, background.to_vec(), &hybrid, &mut set, &[]).unwrap();
    let (variance, _) = cost.posterior_variance().unwrap();
    close(&variance, &variances(b, steps, seen), "hybrid");
}

#[test]
fn nothing_to_compare_and_nothing_to_cycle() {
    assert!(consistency(&[], &[], &[], &[], &[], &[]).is_empty());
    let model = |_: usize| -> Box<dyn Model + Send> { Box::new(linear(1)) };
    let nothing = |_: usize| ObservationSet::new(0, vec![all_of(1)], vec![]);
    let b = Diagonal::uniform(1, 1.0).unwrap();
    for cycles in [0, 2] {
        let cycling = Cycling {
            first: 0,
            window: 0,
            shift: 1,
            cycles,
            make_model: &model,
            observations: &nothing,
            truth: None,
            model_error: None,
            posterior: false,
        };
        let mut state = CycleState::new(vec![0.4]);
        let found =
            cycle(&cycling, &mut state, &CycledCovariance::Static(&b), &Minimizer::default(), &mut |_, _| {
                ControlFlow::Continue(())
            })
            .unwrap();
        assert_eq!((found.len(), state.next), (cycles, cycles));
        let still = run(&mut linear(1), &[0.4], cycles).pop().unwrap();
        close(&state.background, &still, "a window without observations");
    }
    // A set of no operators, and a grid of one time.
    assert_eq!(ObservationSet::on_times(vec![0.0], vec![], vec![]).unwrap().last_step(), None);
    assert!(ObservationSet::on_times(vec![], vec![], vec![]).is_err());
}

/// Memory goes with the observations: a step of 1.7e12, and of the largest number there is.
#[test]
fn an_observation_far_ahead_takes_no_memory() {
    for step in [1_700_000_000_000, usize::MAX] {
        let seen = vec![observation(&[0], 0, 0.5, &[0.0], 1.0), observation(&[0], step, 0.0, &[1.0], 1.0)];
        let mut set = ObservationSet::new(step, vec![all_of(1)], seen).unwrap();
        assert_eq!((set.dim(), set.last_step()), (2, Some(step)));
        let mut y = set.prediction();
        for k in [0, 1, 2, step - 1, step] {
            set.observe_add(k, &[3.0], &mut y).unwrap();
        }
        assert_eq!(y.values(), [3.0, 3.0]);
    }
}
