//! Correlated observation errors in every method: windows with errors of the model, ensembles and their
//! hybrids, cycles; against the closed form with the dense R.

use crate::cost::{coupled, relative};
use crate::ensemble::{linear, spanning};
use crate::family::ignore;
use crate::matrix::{Matrix, kalman, step_matrix};
use crate::models::*;
use std::sync::Arc;
use varda_assimilation::*;
use varda_covariance::{Dense, Ensemble, Hybrid, Kernel, Localization, Taper};
use varda_implicit::Model;

const N: usize = 5;
const STEPS: usize = 8;

/// R of three rows: variances 0.04, 0.09, 0.16 and strong correlations.
fn r() -> Arc<Dense> {
    Arc::new(Dense::new(3, &[0.04, 0.045, 0.02, 0.045, 0.09, 0.03, 0.02, 0.03, 0.16]).unwrap())
}

/// Two components with errors that remember four steps, three with errors correlated among them at two
/// times, and one value with an error of its own.
fn window() -> ObservationSet {
    let y = normals(31, 20);
    let memory = Kernel::Matern32 { length: 4.0 };
    let mut seen: Vec<Observation> = (0..5)
        .map(|j| {
            let at = 2 * j;
            let chain = vec![(0, at as f64), (1, at as f64)];
            observation(&[0, 3], at, 0.0, &y[2 * j..2 * j + 2], 0.3).chained(memory, chain)
        })
        .collect();
    for (step, from) in [(3, 10), (8, 13)] {
        seen.push(Observation::new(step, vec![1, 2, 4], y[from..from + 3].to_vec(), 1.0).correlated(r()));
    }
    seen.push(observation(&[2], 5, 0.0, &y[16..17], 0.2));
    ObservationSet::new(STEPS, vec![all_of(N)], seen).unwrap()
}

/// The prediction of every value of a set from the run x₀ = x, x_{k+1} = M x_k + η_k.
fn predicted(set: &mut ObservationSet, steps: usize, x: &[f64], eta: &dyn Fn(usize) -> Vec<f64>) -> Vec<f64> {
    let (mut model, mut x, mut next) = (linear(x.len()), x.to_vec(), x.to_vec());
    let mut out = set.prediction();
    for k in 0..=steps {
        set.observe_add(k, &x, &mut out).unwrap();
        model.step(k, &x, &mut next).unwrap();
        next.iter_mut().zip(eta(k)).for_each(|(x, e)| *x += e);
        std::mem::swap(&mut x, &mut next);
    }
    out.values().to_vec()
}

/// z_b + K d and B − K H B of a control z with covariance B, whose values are H z, with the dense R.
fn closed_form(set: &ObservationSet, h: &Matrix, b: &Matrix, background: &[f64]) -> (Vec<f64>, Matrix, f64) {
    let m = set.dim();
    let dense = set.error_covariance();
    let r = Matrix::new(m, m, |i, j| dense[i + j * m]);
    let hb = h.times(b);
    let s = hb.times(&h.transpose()).plus(&r);
    let d: Vec<f64> = set.values().iter().zip(h.apply(background)).map(|(y, p)| y - p).collect();
    let weights = s.solve(&Matrix::column(&d)).column_at(0);
    let increment = hb.transpose().apply(&weights);
    let analysis = background.iter().zip(&increment).map(|(x, dx)| x + dx).collect();
    (analysis, b.minus(&hb.transpose().times(&s.solve(&hb))), 0.5 * dot(&d, &weights))
}

/// The map from (x₀, η_0 … η_{errors−1}) to the values.
fn values_of(set: &mut ObservationSet, errors: usize) -> Matrix {
    let columns: Vec<Vec<f64>> = (0..N * (errors + 1))
        .map(|j| {
            let unit = |block: usize| (0..N).map(|i| f64::from(block * N + i == j)).collect::<Vec<f64>>();
            let eta = |k: usize| if k < errors { unit(k + 1) } else { vec![0.0; N] };
            predicted(set, STEPS, &unit(0), &eta)
        })
        .collect();
    Matrix::new(set.dim(), columns.len(), |i, j| columns[j][i])
}

fn tight(problem: &mut dyn LeastSquares, v: &mut [f64], inner: InnerSolver) -> Minimum {
    let options = OuterLoopOptions::default()
        .with_inner(inner)
        .with_gradient_tolerance(1e-12)
        .with_inner_tolerance(1e-13)
        .with_max_inner(1000);
    outer_loop(problem, v, &options, &mut ignore()).unwrap()
}

/// Values of order one by two ways; S = H B Hᵀ + R has a condition number of some hundreds, so that 1e-9 is
/// ten thousand times its rounding, and what gradients of 1e-12 of the first leave.
fn close(what: &str, found: &[f64], expected: &[f64]) {
    let gap = relative(found, expected);
    assert!(gap <= 1e-9, "{what}: {gap:e}");
}

const SOLVERS: [InnerSolver; 3] = [InnerSolver::Primal, InnerSolver::Dual, InnerSolver::Direct];

#[test]
fn strong_methods_give_the_closed_form_over_a_window() {
    let (b, background) = (coupled(N, 0.6), normals(1, N));
    let mut set = window();
    let h = values_of(&mut set, 0);
    let (analysis, p, value) = closed_form(&set, &h, &Matrix::of(&b), &background);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut model = linear(N);
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
    let control = |v: &[f64]| {
        let mut z = vec![0.0; N];
        transform.control(v, &mut z);
        z
    };
    for name in ["trust-region", "gauss-newton-cg", "newton", "lbfgs"] {
        let mut minimizer = Minimizer::named(name).unwrap();
        minimizer.stopping_mut().gradient_tolerance = 1e-12;
        let mut v = vec![0.0; N];
        let minimum = minimizer.minimize(&mut cost, &mut v, &mut ignore()).unwrap();
        close(name, &control(&v), &analysis);
        assert!((minimum.value - value).abs() <= 1e-10 * value, "{name}");
    }
    for inner in SOLVERS {
        let mut v = vec![0.0; N];
        let minimum = tight(&mut cost, &mut v, inner);
        close(&format!("{inner:?}"), &control(&v), &analysis);
        assert!((minimum.value - value).abs() <= 1e-10 * value, "{inner:?}");
        close("variance", &Posterior::new(&mut cost).unwrap().covariance(&transform), &p.by_columns());
    }
    for gain in [Gain::Observation, Gain::Information] {
        let blue = Blue::new(&mut cost, &[0.0; N], gain).unwrap();
        close("BLUE", &blue.analysis(&transform), &analysis);
        close("P of BLUE", &blue.control_covariance(&transform), &p.by_columns());
    }
    // with R taken for diagonal it is another analysis
    let (others, seen) = window().into_parts();
    let alone = seen.into_iter().map(|o| {
        let sigma = o.sigma.clone();
        o.sigmas(sigma)
    });
    let mut diagonal = ObservationSet::new(STEPS, others, alone.collect()).unwrap();
    let h = values_of(&mut diagonal, 0);
    let (other, ..) = closed_form(&diagonal, &h, &Matrix::of(&b), &normals(1, N));
    assert!(!diagonal.is_correlated() && relative(&other, &analysis) > 1e-2);
}

/// Both weak forms: states of the whole window, J, σ of the start and of every error, and the factor on Q.
#[test]
fn weak_methods_give_the_closed_form_of_states_and_errors() {
    let (b, q, background) = (coupled(N, 0.6), coupled(N, 0.2), normals(1, N));
    let mut set = window();
    let h = values_of(&mut set, STEPS);
    let n = N * (STEPS + 1);
    let (b_dense, q_dense) = (Matrix::of(&b), Matrix::of(&q));
    let prior = |factor: f64| {
        Matrix::new(n, n, |i, j| match (i / N, j / N) {
            (0, 0) => b_dense.at(i, j),
            (a, c) if a == c => factor * q_dense.at(i % N, j % N),
            _ => 0.0,
        })
    };
    let mut zero = vec![0.0; n];
    zero[..N].copy_from_slice(&background);
    let (z, p, value) = closed_form(&set, &h, &prior(1.0), &zero);
    let mut states = z[..N].to_vec();
    let mut model = linear(N);
    for k in 0..STEPS {
        let mut next = vec![0.0; N];
        model.step(k, &states[k * N..], &mut next).unwrap();
        next.iter_mut().zip(&z[(k + 1) * N..]).for_each(|(x, e)| *x += e);
        states.extend(next);
    }
    let every = || Forcing::every_step(N);
    let transform = ControlTransform::new(background.clone(), &b).unwrap();
    let check = |what: &str, cost: &mut dyn LeastSquares, found: Vec<f64>, j: f64| {
        close(what, &found, &states);
        assert!((j - value).abs() <= 1e-9 * value, "{what}: {j} {value}");
        let posterior = WeakPosterior::new(cost).unwrap();
        let diagonal =
            |block: usize| (0..N).map(|i| p.at(block * N + i, block * N + i)).collect::<Vec<f64>>();
        close(&format!("{what}: σ² of x₀"), &posterior.initial().variance(&transform), &diagonal(0));
        for j in 0..STEPS {
            close(&format!("{what}: σ² of η"), &posterior.error_variance(&q, j), &diagonal(j + 1));
        }
        posterior.scale().unwrap().factor
    };
    let mut factors = Vec::new();
    for inner in SOLVERS {
        let mut cost = WeakForcing::new(&mut model, transform.clone(), &q, every(), &mut set).unwrap();
        let mut v = vec![0.0; cost.dim()];
        let minimum = tight(&mut cost, &mut v, inner);
        cost.linearize(&v, &mut vec![0.0; v.len()]).unwrap();
        let found = (0..=STEPS).flat_map(|k| cost.state(k).to_vec()).collect();
        factors.push(check(&format!("weak-forcing, {inner:?}"), &mut cost, found, minimum.value));
        drop(cost);
        let mut cost = WeakState::new(&mut model, background.clone(), &b, &q, every(), &mut set).unwrap();
        let mut v = cost.background().unwrap();
        let minimum = tight(&mut cost, &mut v, inner);
        cost.linearize(&v, &mut vec![0.0; v.len()]).unwrap();
        let found = (0..=STEPS).flat_map(|k| cost.state(k).to_vec()).collect();
        factors.push(check(&format!("weak-state, {inner:?}"), &mut cost, found, minimum.value));
    }
    for name in ["trust-region", "lbfgs"] {
        let mut cost = WeakForcing::new(&mut model, transform.clone(), &q, every(), &mut set).unwrap();
        let mut minimizer = Minimizer::named(name).unwrap();
        minimizer.stopping_mut().gradient_tolerance = 1e-12;
        let mut v = vec![0.0; cost.dim()];
        let minimum = minimizer.minimize(&mut cost, &mut v, &mut ignore()).unwrap();
        cost.linearize(&v, &mut vec![0.0; v.len()]).unwrap();
        let found = (0..=STEPS).flat_map(|k| cost.state(k).to_vec()).collect();
        factors.push(check(&format!("weak-forcing, {name}"), &mut cost, found, minimum.value));
    }
    // Where the likelihood is largest 2 J_q is its expectation (Desroziers and Ivanov 2001): with a²Q in the
    // closed form.
    // the factor is looked for to 1e-6
    let factor = factors[0];
    assert!(factors.iter().all(|f| (f / factor - 1.0).abs() <= 1e-6), "{factors:?}");
    let (z, p, _) = closed_form(&set, &h, &prior(factor * factor), &zero);
    let mut twice = [0.0; 2];
    for k in 1..=STEPS {
        let solved = q_dense.solve(&Matrix::column(&z[k * N..(k + 1) * N])).column_at(0);
        twice[0] += dot(&z[k * N..(k + 1) * N], &solved) / factor.powi(2);
        let block = Matrix::new(N, N, |i, j| p.at(k * N + i, k * N + j));
        let left = q_dense.solve(&block);
        twice[1] += N as f64 - (0..N).map(|i| left.at(i, i)).sum::<f64>() / factor.powi(2);
    }
    assert!((twice[0] / twice[1] - 1.0).abs() <= 1e-4, "{twice:?}");
}

fn make() -> Box<dyn Model + Send> {
    Box::new(linear(N))
}

/// z, the variances by the posterior and J of an ensemble's quadratic.
fn solved(cost: &mut EnVar) -> (Vec<f64>, Vec<f64>, f64) {
    let mut v = vec![0.0; cost.dim()];
    cost.solve(&mut v).unwrap();
    let mut z = vec![0.0; N];
    cost.transform().control(&v, &mut z);
    let j = cost.evaluate(&v, None).unwrap();
    // the gradient and both ways to a gain find the same
    let mut gradient = vec![0.0; v.len()];
    cost.evaluate(&v, Some(&mut gradient)).unwrap();
    assert!(norm(&gradient) <= 1e-10, "{:e}", norm(&gradient));
    let (variance, _) = cost.posterior_variance().unwrap();
    (z, variance, j)
}

#[test]
fn an_ensemble_that_spans_gives_the_closed_form_over_a_window() {
    let (b, background) = (coupled(N, 0.6), normals(1, N));
    let mut set = window();
    let h = values_of(&mut set, 0);
    let (analysis, p, value) = closed_form(&set, &h, &Matrix::of(&b), &background);
    let diagonal: Vec<f64> = (0..N).map(|i| p.at(i, i)).collect();
    let ensemble = Ensemble::new(&spanning(&b, &background), Localization::none(N)).unwrap();
    let mut cost = EnVar::new(&make, background.clone(), &ensemble, &mut set, &[]).unwrap();
    let (z, variance, j) = solved(&mut cost);
    close("4D-EnVar", &z, &analysis);
    close("4D-EnVar, variance", &variance, &diagonal);
    assert!((j - value).abs() <= 1e-10 * value);
    let columns = cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot).unwrap();
    let by_root: Vec<f64> = (0..N).map(|p| columns.chunks(N).map(|x| x[p] * x[p]).sum()).collect();
    close("4D-EnVar, members", &by_root, &diagonal);
    let mut v = vec![0.0; cost.dim()];
    let minimum = cost.minimize(&mut v, &EnVarOptions::default(), &mut ignore()).unwrap();
    assert!((minimum.value - value).abs() <= 1e-9 * value, "{} {value}", minimum.value);
}

/// Everything at step 0, each value of one component: localization in the places of the observations is that
/// of B, whatever R couples. Few values and many, without and with a static part.
#[test]
fn a_localized_ensemble_gives_the_closed_form_of_its_localized_covariance() {
    let (fixed, background) = (coupled(N, 0.4), normals(1, N));
    let distance = |i: usize, j: usize| i.abs_diff(j) as f64;
    let taper = Taper::GaspariCohn { support: 4.0 };
    let localization = Localization::by_distance(taper, N, distance, 0.0).unwrap();
    let members: Vec<f64> = normals(4, 4 * N).iter().map(|x| 0.5 * x).collect();
    let ensemble = Ensemble::new(&members, localization).unwrap();
    let along = Kernel::Matern12 { length: 2.0 };
    let few = vec![0, 1, 3, 4];
    let many: Vec<usize> = (0..30).map(|i| i % N).collect();
    for rows in [few, many] {
        let (m, y) = (rows.len(), normals(9, rows.len()));
        let set = || {
            let entries = rows.iter().enumerate().map(|(i, &row)| (i / N, row as f64)).collect();
            let seen = Observation::new(0, rows.clone(), y.clone(), 0.3).chained(along, entries);
            ObservationSet::new(0, vec![all_of(N)], vec![seen]).unwrap()
        };
        let h = Matrix::new(m, N, |i, j| f64::from(rows[i] == j));
        let of_ensemble = Matrix::of(&ensemble);
        let (analysis, p, value) = closed_form(&set(), &h, &of_ensemble, &background);
        let mut seen = set();
        let mut cost = EnVar::new(&make, background.clone(), &ensemble, &mut seen, &rows).unwrap();
        let (z, variance, j) = solved(&mut cost);
        let diagonal = |p: &Matrix| (0..N).map(|i| p.at(i, i)).collect::<Vec<f64>>();
        close("localized", &z, &analysis);
        close("localized, variance", &variance, &diagonal(&p));
        assert!((j - value).abs() <= 1e-10 * value, "{j} {value}");
        drop(cost);

        let hybrid = Hybrid::new(&fixed, 0.6, ensemble.clone(), 0.8).unwrap();
        let fixed = Matrix::of(&fixed);
        let both = Matrix::new(N, N, |i, j| 0.36 * fixed.at(i, j) + 0.64 * of_ensemble.at(i, j));
        let (analysis, p, value) = closed_form(&set(), &h, &both, &background);
        let mut seen = set();
        let mut cost = EnVar::hybrid(&make, background.clone(), &hybrid, &mut seen, &rows).unwrap();
        let (z, variance, j) = solved(&mut cost);
        close("hybrid", &z, &analysis);
        close("hybrid, variance", &variance, &diagonal(&p));
        assert!((j - value).abs() <= 1e-10 * value, "{j} {value}");
    }
}

/// A static part alone: its increments persist, so every value is H of x_b run on, and H of the increment.
#[test]
fn a_hybrid_without_its_ensemble_gives_the_closed_form_of_lasting_increments() {
    let (b, background) = (coupled(N, 0.6), normals(1, N));
    let ensemble = Ensemble::new(&spanning(&b, &background), Localization::none(N)).unwrap();
    let hybrid = Hybrid::new(&b, 1.0, ensemble, 0.0).unwrap();
    let mut set = window();
    let run = predicted(&mut set, STEPS, &background, &|_| vec![0.0; N]);
    let rows: Vec<usize> = set.observations().iter().flat_map(|o| o.rows.clone()).collect();
    let h = Matrix::new(set.dim(), N, |i, j| f64::from(rows[i] == j));
    // d = y − H(M x_b), as that of a background 0 from values y − H(M x_b)
    let d: Vec<f64> = set.values().iter().zip(&run).map(|(y, hx)| y - hx).collect();
    let (m, dense) = (set.dim(), set.error_covariance());
    let r = Matrix::new(m, m, |i, j| dense[i + j * m]);
    let hb = h.times(&Matrix::of(&b));
    let weights = hb.times(&h.transpose()).plus(&r).solve(&Matrix::column(&d)).column_at(0);
    let increment = hb.transpose().apply(&weights);
    let expected: Vec<f64> = background.iter().zip(&increment).map(|(x, dx)| x + dx).collect();
    let mut cost = EnVar::hybrid(&make, background, &hybrid, &mut set, &[]).unwrap();
    close("hybrid, static alone", &solved(&mut cost).0, &expected);
}

/// Three components with one R at every second step from 1 on.
fn seen(window: usize) -> impl Fn(usize) -> Result<ObservationSet, Error> {
    move |first| {
        let of = |k: usize| normals(300 + (first + k) as u64, 3);
        let ks = (0..=window).filter(|k| first + k > 0 && (first + k) % 2 == 1);
        let seen = ks.map(|k| Observation::new(k, vec![0, 2, 3], of(k), 1.0).correlated(r()));
        ObservationSet::new(window, vec![all_of(N)], seen.collect())
    }
}

/// Cycles by strong and weak windows and by an ensemble that spans: the Kalman filter with the dense R.
#[test]
fn cycles_are_a_kalman_filter_with_the_dense_covariance() {
    const ALL: usize = 12;
    let (b, q, background) = (coupled(N, 0.6), coupled(N, 0.2), normals(1, N));
    let step = step_matrix(&mut linear(N), N);
    let whole = seen(ALL)(0).unwrap();
    assert!(whole.is_correlated());
    let forcing = Forcing::every_step(N);
    let exact = || {
        let options = TrustRegionOptions::default().with_gradient_tolerance(1e-13).with_initial_radius(1e3);
        Minimizer::TrustRegion(options)
    };
    let draws = |_: usize| -> Normals { Box::new(|| f64::NAN) };
    let make = |_: usize| -> Box<dyn Model + Send> { Box::new(linear(N)) };
    let propagated =
        CycledCovariance::Propagated { first: &b, inflation: 1.0, static_part: None, dropped: 0.0 };
    let of_ensemble = CycledCovariance::Ensemble(CycledEnsemble {
        inflation: CycledInflation::Fixed(1.0),
        spread: 1.0,
        rotation: None,
        localization: Localization::none(N),
        anchors: &|_| Vec::new(),
        static_part: None,
        update: CycledUpdate::SquareRoot,
        options: EnVarOptions::default().with_max_outer(1),
    });
    for (what, weak, carried) in [
        ("strong", false, &propagated),
        ("weak-forcing", true, &propagated),
        ("ensemble", false, &of_ensemble),
    ] {
        let with_q = Matrix::of(&q);
        let filter = kalman(&step, &Matrix::of(&b), weak.then_some(&with_q), &background, &whole, ALL).0;
        let truth = |k: usize| filter[k].0.clone();
        let errors =
            CycledErrors { q: &q, forcing: &forcing, estimated: CycledEstimate::Forcing, normals: &draws };
        let cycling = Cycling {
            first: 0,
            window: 4,
            shift: 4,
            cycles: ALL / 4,
            make_model: &make,
            observations: &|first| seen(4)(first),
            truth: Some(&truth),
            model_error: weak.then_some(errors),
            posterior: false,
        };
        let mut state = match what {
            "ensemble" => CycleState::from_members(spanning(&b, &background), N),
            _ => CycleState::new(background.clone()),
        };
        let ended =
            cycle(&cycling, &mut state, carried, &exact(), &mut |_, _| std::ops::ControlFlow::Continue(()));
        let ended = ended.unwrap();
        assert_eq!(ended.len(), 3);
        for c in &ended {
            let end = c.errors.unwrap().end;
            assert!(end <= 1e-9, "{what}, cycle {}: {end:e}", c.index);
        }
    }
}
