//! Methods that must agree: closed form, 3D-Var, incremental, dual, 4D-Var, the Kalman filter and smoother.

use crate::cost::{coupled, curved_problem, relative};
use crate::matrix::*;
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Diagonal};

pub(crate) fn ignore() -> impl FnMut(&Iteration) -> ControlFlow<()> {
    |_| ControlFlow::Continue(())
}

/// A B without `Precision`: rank 3 of 5, known by its root alone.
struct Thin;

impl Thin {
    const ROOT: [[f64; 3]; 5] =
        [[1.0, 0.0, 0.0], [0.5, 0.8, 0.0], [0.2, 0.4, 0.9], [0.0, 0.5, 0.4], [0.3, -0.2, 0.6]];
}

impl Covariance for Thin {
    fn dim(&self) -> usize {
        5
    }
    fn root_dim(&self) -> usize {
        3
    }
    fn apply(&self, x: &[f64], y: &mut [f64]) {
        let mut v = [0.0; 3];
        self.root_transpose(x, &mut v);
        self.root(&v, y);
    }
    fn root(&self, v: &[f64], x: &mut [f64]) {
        x.iter_mut().zip(Self::ROOT).for_each(|(x, row)| *x = dot(&row, v));
    }
    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        (0..3).for_each(|j| v[j] = (0..5).map(|i| Self::ROOT[i][j] * x[i]).sum());
    }
    fn variance(&self, variance: &mut [f64]) {
        variance.iter_mut().zip(Self::ROOT).for_each(|(v, row)| *v = dot(&row, &row));
    }
}

/// y = H x with a full H of 4 rows, for a state of 5.
fn linear_3dvar() -> (Vec<f64>, ObservationSet) {
    let h: Vec<_> = normals(40, 20).iter().enumerate().map(|(i, &h)| (i / 5, i % 5, h)).collect();
    let h = LinearObservation::new(4, 5, &h).unwrap();
    let mut seen = observation(&[0, 1, 2, 3], 0, 0.0, &normals(41, 4), 0.5);
    seen.sigma[2] = 0.1;
    (normals(42, 5), ObservationSet::new(0, vec![Box::new(h)], vec![seen]).unwrap())
}

/// Every way to one analysis, with J there.
fn every_way(b: &dyn Covariance) -> Vec<(&'static str, Vec<f64>, f64)> {
    let (background, mut set) = linear_3dvar();
    let transform = ControlTransform::new(background, b).unwrap();
    let n = transform.dim();
    let mut found = Vec::new();
    for (name, gain) in [("blue, observation", Gain::Observation), ("blue, information", Gain::Information)] {
        let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
        let blue = Blue::new(&mut cost, &vec![0.0; n], gain).unwrap();
        found.push((name, blue.analysis(&transform), blue.value));
    }
    let control = |v: &[f64]| {
        let mut z = vec![0.0; 5];
        transform.control(v, &mut z);
        z
    };
    let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
    let mut v = vec![0.0; n];
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-13);
    let minimum = trust_region(&mut cost, &mut v, &options, &mut ignore()).unwrap();
    found.push(("3D-Var", control(&v), minimum.value));
    for (name, inner) in
        [("incremental", InnerSolver::Primal), ("PSAS", InnerSolver::Dual), ("direct", InnerSolver::Direct)]
    {
        let mut v = vec![0.0; n];
        let options = OuterLoopOptions::default().with_inner(inner).with_inner_tolerance(1e-14);
        let minimum = outer_loop(&mut cost, &mut v, &options, &mut ignore()).unwrap();
        assert_eq!((minimum.status, minimum.outer_iterations), (Status::Converged, 1), "{name}");
        found.push((name, control(&v), minimum.value));
    }
    assert_eq!(cost.counts().model, varda_implicit::Counts::default(), "3D-Var has no model");
    // The plain dual, solved by the ordinary conjugate gradients.
    cost.evaluate(&vec![0.0; n], Some(&mut vec![0.0; n])).unwrap();
    let mut dual = Dual::new(&mut cost).unwrap();
    let mut w = vec![0.0; 4];
    let options = NewtonCgOptions::default().with_gradient_tolerance(1e-13);
    let minimum = newton_cg(&mut dual, &mut w, &options, &mut ignore()).unwrap();
    dual.increment(&w, &mut v).unwrap();
    found.push(("dual (2.12)", control(&v), -minimum.value));
    found
}

#[test]
fn blue_3dvar_incremental_and_psas_are_one_also_for_a_b_without_inverse() {
    for b in [&coupled(5, 0.8) as &dyn Covariance, &Thin] {
        let found = every_way(b);
        // The paper's (2.2) in the state space, densely, apart from all code under test.
        let (background, mut set) = linear_3dvar();
        let h = observation_matrix(&mut set, 5);
        let r = Matrix::diagonal(&set.sigma().iter().map(|s| s * s).collect::<Vec<_>>());
        let dense_b = Matrix::of(b);
        let bht = dense_b.times(&h.transpose());
        let s = h.times(&bht).plus(&r);
        let d: Vec<f64> = set.values().iter().zip(h.apply(&background)).map(|(y, p)| y - p).collect();
        let weights = s.solve(&Matrix::column(&d));
        let increment = bht.times(&weights);
        let expected: Vec<f64> = (0..5).map(|i| background[i] + increment.at(i, 0)).collect();
        let value = 0.5 * dot(&d, &weights.column_at(0));
        for (name, z, j) in &found {
            // 1e-10 asked for by the issue; 1e-12 is what is seen.
            assert!(relative(z, &expected) <= 1e-10, "{name}: {:e}", relative(z, &expected));
            assert!((j - value).abs() <= 1e-10 * value, "{name}: {j} {value}");
        }
        // And P = B − K H B both ways.
        let p = dense_b.minus(&bht.times(&s.solve(&bht.transpose())));
        let transform = ControlTransform::new(background, b).unwrap();
        for gain in [Gain::Observation, Gain::Information] {
            let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
            // Where it is linearized does not matter.
            let blue = Blue::new(&mut cost, &normals(54, transform.dim()), gain).unwrap();
            assert!(relative(&blue.analysis(&transform), &expected) <= 1e-11);
            assert!((blue.value - value).abs() <= 1e-11 * value);
            let covariance = blue.control_covariance(&transform);
            assert!(relative(&covariance, &p.by_columns()) <= 1e-12);
            let posterior = Posterior::new(&mut cost).unwrap().covariance(&transform);
            assert!(relative(&covariance, &posterior) <= 1e-12);
        }
    }
}

/// GᵀG overflows, G does not: the estimate is the observation, and its variance that of its error.
#[test]
fn a_gain_whose_square_overflows_is_right() {
    let b = Diagonal::uniform(2, 1e150).unwrap();
    let mut set =
        ObservationSet::new(0, vec![all_of(2)], vec![observation(&[0, 1], 0, 0.0, &[1.0, 2.0], 1e-10)])
            .unwrap();
    let transform = ControlTransform::new(vec![0.0; 2], &b).unwrap();
    for gain in [Gain::Observation, Gain::Information] {
        let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
        let blue = Blue::new(&mut cost, &[0.0; 2], gain).unwrap();
        for (z, y) in blue.analysis(&transform).iter().zip([1.0, 2.0]) {
            assert!((z - y).abs() <= 1e-12, "{gain:?}: {z}");
        }
        assert!(blue.value >= 0.0 && blue.value <= 1e-10, "{gain:?}: {}", blue.value);
        // P_v is 1e-320, of which few digits are left.
        let variance = blue.control_covariance(&transform)[0];
        assert!((variance / 1e-20 - 1.0).abs() <= 1e-2, "{gain:?}: {variance:e}");
    }
}

/// The iterates of both inner solvers, until the residual has fallen by 1e-10, at a given outer iterate.
fn compare_iterates(problem: &mut dyn LeastSquares, v: &[f64]) -> (usize, f64) {
    let n = problem.dim();
    let (mut g, mut primal, mut dual) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    problem.linearize(v, &mut g).unwrap();
    let mut worst = 0.0f64;
    for iterations in 1.. {
        let limits = InnerLimits { residual: 1e-10, iterations };
        let one = conjugate_gradients(problem, &g, &limits, &mut primal).unwrap();
        let two = restricted_conjugate_gradients(problem, &limits, &mut dual).unwrap();
        worst = worst.max(relative(&dual, &primal)).max((one.residual - two.residual).abs());
        if one.iterations < iterations || one.residual <= 1e-10 {
            return (one.iterations, worst);
        }
    }
    unreachable!()
}

#[test]
fn dual_iterates_are_the_primal_ones_at_every_outer_iterate() {
    let (background, mut set) = linear_3dvar();
    let b = coupled(5, 0.8);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
    for v in [vec![0.0; 5], normals(43, 5)] {
        let (iterations, worst) = compare_iterates(&mut cost, &v);
        assert!(iterations >= 4 && worst <= 1e-9, "{iterations} {worst:e}");
    }

    // More observations than unknowns, a model, a curved operator; 30 unknowns, few observations.
    let (mut model, background, mut set) = curved_problem();
    let b = coupled(6, 0.5);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    for v in [vec![0.0; 6], normals(7, 6)] {
        let (iterations, worst) = compare_iterates(&mut cost, &v);
        assert!(iterations >= 5 && worst <= 1e-9, "{iterations} {worst:e}");
    }
    let (mut model, background, mut set) = wide_problem();
    let b = coupled(30, 1.0);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    for v in [vec![0.0; 30], normals(44, 30).iter().map(|v| 0.3 * v).collect()] {
        let (iterations, worst) = compare_iterates(&mut cost, &v);
        assert!(iterations >= 10 && worst <= 1e-9, "{iterations} {worst:e}");
    }
}

/// Many iterations: a whole state of 30 seen four times with small errors, and 210 unknowns with model error.
#[test]
fn dual_iterates_stay_the_primal_ones_over_many_iterations() {
    let values = normals(55, 120);
    let observations: Vec<Observation> = (0..4)
        .map(|j| observation(&(0..30).collect::<Vec<_>>(), 2 * j, 0.0, &values[30 * j..30 * j + 30], 0.01))
        .collect();
    let (mut model, background, _) = wide_problem();
    let mut set = ObservationSet::new(6, vec![all_of(30)], observations).unwrap();
    let (b, q) = (coupled(30, 1.0), coupled(30, 0.3));
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
    let (iterations, worst) = compare_iterates(&mut cost, &[0.0; 30]);
    assert!(iterations >= 25 && worst <= 1e-9, "{iterations} {worst:e}");
    drop(cost);
    let mut cost = WeakForcing::new(&mut model, transform, &q, Forcing::every_step(30), &mut set).unwrap();
    let v: Vec<f64> = normals(56, 210).iter().map(|v| 0.1 * v).collect();
    let (iterations, worst) = compare_iterates(&mut cost, &v);
    assert!(iterations >= 80 && worst <= 1e-9, "{iterations} {worst:e}");
}

#[test]
fn inflated_errors_reach_the_inner_and_the_dual_cost() {
    let (mut model, background, mut set) = linear_window(4, 8);
    let b = coupled(4, 0.8);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let (v, p, w) = (normals(50, 4), normals(51, 4), normals(52, 12));
    cost.linearize(&v, &mut [0.0; 4]).unwrap();
    let dual_before = Dual::new(&mut cost).unwrap().evaluate(&w, None).unwrap();
    let mut inner = InnerCost::new(&mut cost);
    inner.set_observation_scale(3.0);
    let inner_value = inner.evaluate(&p, None).unwrap();
    let mut dual = Dual::new(&mut cost).unwrap();
    let dual_value = dual.evaluate(&w, None).unwrap();
    dual.set_observation_scale(1.0);
    // Some roundings of terms of this size.
    assert!((dual.evaluate(&w, None).unwrap() - dual_before).abs() <= 1e-13 * dual_before.abs());
    dual.set_observation_scale(3.0);
    assert_eq!(dual.evaluate(&w, None).unwrap(), dual_value);
    assert!((dual_value - dual_before).abs() > 0.1 * dual_before.abs());
    let moved: Vec<f64> = v.iter().zip(&p).map(|(v, p)| v + p).collect();
    let value = cost.evaluate(&moved, None).unwrap();
    assert!((inner_value - value).abs() <= 1e-13 * value);
}

#[test]
fn an_iteration_of_either_solver_costs_one_sweep_each_way() {
    let (mut model, background, mut set) = wide_problem();
    let b = coupled(30, 1.0);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let (mut g, mut p) = (vec![0.0; 30], vec![0.0; 30]);
    cost.linearize(&[0.0; 30], &mut g).unwrap();
    let sweeps = |cost: &StrongConstraint| (cost.counts().tangent_sweeps, cost.counts().adjoint_sweeps);
    let steps = cost.counts().model.model_steps;
    let limits = InnerLimits { residual: 0.0, iterations: 7 };
    assert_eq!(sweeps(&cost), (0, 1));
    conjugate_gradients(&mut cost, &g, &limits, &mut p).unwrap();
    assert_eq!(sweeps(&cost), (7, 8));
    // And one of each for the first residual.
    restricted_conjugate_gradients(&mut cost, &limits, &mut p).unwrap();
    assert_eq!(sweeps(&cost), (15, 16));
    assert_eq!(cost.counts().model.model_steps, steps);
    // Nothing to be done is done in no iteration.
    p.fill(1.0);
    let ended = conjugate_gradients(&mut cost, &[0.0; 30], &limits, &mut p).unwrap();
    assert_eq!(ended, InnerEnd { iterations: 0, residual: 0.0 });
    assert_eq!(p, vec![0.0; 30]);
}

/// Lorenz-96 with 30 variables, 12 observed values at three times.
pub(crate) fn wide_problem() -> (Rk4<Lorenz96>, Vec<f64>, ObservationSet) {
    let mut model = Rk4::new(Lorenz96(30), 0.05);
    let start: Vec<f64> = normals(45, 30).iter().map(|x| 2.0 + 3.0 * x).collect();
    let truth = run(&mut model, &start, 200).pop().unwrap();
    let background: Vec<f64> = truth.iter().zip(normals(46, 30)).map(|(x, e)| x + 0.3 * e).collect();
    let states = run(&mut model, &truth, 6);
    let noise = normals(47, 12);
    let observations = (0..3)
        .map(|j| {
            let y: Vec<f64> = (0..4).map(|i| states[2 + 2 * j][7 * i] + 0.1 * noise[4 * j + i]).collect();
            observation(&[0, 7, 14, 21], 2 + 2 * j, 0.0, &y, 0.1)
        })
        .collect();
    let set = ObservationSet::new(6, vec![all_of(30)], observations).unwrap();
    (Rk4::new(Lorenz96(30), 0.05), background, set)
}

/// Stopped early, a minimizer of the plain dual may raise the primal cost; the restricted method may not.
#[test]
fn restricted_iterates_lower_the_primal_cost_and_plain_dual_ones_need_not() {
    let (mut model, background, mut set) = wide_problem();
    let b = coupled(30, 3.0);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let mut p = vec![0.0; 30];
    let first = cost.linearize(&[0.0; 30], &mut p.clone()).unwrap();
    let mut last = first;
    for iterations in 1..10 {
        restricted_conjugate_gradients(&mut cost, &InnerLimits { residual: 0.0, iterations }, &mut p)
            .unwrap();
        let value = InnerCost::new(&mut cost).evaluate(&p, None).unwrap();
        assert!(value <= last);
        last = value;
    }
    // Plain conjugate gradients on (I + G Gᵀ) w = d.
    let mut dual = Dual::new(&mut cost).unwrap();
    let (mut w, mut g, mut product) = (vec![0.0; 12], vec![0.0; 12], vec![0.0; 12]);
    dual.evaluate(&w, Some(&mut g)).unwrap();
    let mut direction: Vec<f64> = g.iter().map(|g| -g).collect();
    let mut values = vec![first];
    for _ in 0..9 {
        dual.hessian_apply(&direction, &mut product).unwrap();
        let alpha = dot(&g, &g) / dot(&direction, &product);
        w.iter_mut().zip(&direction).for_each(|(w, d)| *w += alpha * d);
        let before = dot(&g, &g);
        dual.evaluate(&w, Some(&mut g)).unwrap();
        let beta = dot(&g, &g) / before;
        direction.iter_mut().zip(&g).for_each(|(d, g)| *d = beta * *d - g);
        // q(p) with p = Gᵀw: ½‖p‖² + ½‖G p − d‖², G p − d being the dual gradient less w.
        dual.increment(&w, &mut p).unwrap();
        let misfit: Vec<f64> = g.iter().zip(&w).map(|(g, w)| g - w).collect();
        values.push(0.5 * dot(&p, &p) + 0.5 * dot(&misfit, &misfit));
    }
    assert!(values.windows(2).any(|v| v[1] > v[0]), "{values:?}");
}

/// Nonlinear: 4D-Var, incremental, 4D-PSAS end at the same stationary point; 3D-Var with a curved H likewise.
#[test]
fn the_same_minimum_of_a_curved_cost_by_every_method() {
    let solve = |cost: &mut StrongConstraint, n: usize| {
        let mut exact = vec![0.0; n];
        let options = TrustRegionOptions::default().with_gradient_tolerance(1e-11);
        let minimum = trust_region(cost, &mut exact, &options, &mut ignore()).unwrap();
        assert_eq!(minimum.status, Status::Converged);
        let mut table = Vec::new();
        for inner in [InnerSolver::Primal, InnerSolver::Dual, InnerSolver::Direct] {
            let mut v = vec![0.0; n];
            let options = OuterLoopOptions::default().with_inner(inner).with_gradient_tolerance(1e-10);
            let found = outer_loop(cost, &mut v, &options, &mut ignore()).unwrap();
            assert_eq!(found.status, Status::Converged, "{inner:?} {found:?}");
            assert!((found.value - minimum.value).abs() <= 1e-12 * minimum.value);
            // |g| ≤ 1e-10 |g₀| ~ 1e-8 and A ≥ I.
            assert!(relative(&v, &exact) <= 1e-7, "{inner:?} {:e}", relative(&v, &exact));
            table.push((found.outer_iterations, found.inner_iterations));
        }
        // Primal and dual take the same path.
        assert_eq!(table[0], table[1]);
    };
    let (mut model, background, mut set) = wide_problem();
    let b = coupled(30, 0.5);
    let transform = ControlTransform::new(background, &b).unwrap();
    solve(&mut StrongConstraint::new(&mut model, transform, &mut set).unwrap(), 30);

    let b = coupled(3, 0.4);
    let seen = observation(&[0, 1], 0, 0.0, &[2.3, 1.1], 0.2);
    let mut set = ObservationSet::new(0, vec![Box::new(Products(3))], vec![seen]).unwrap();
    let transform = ControlTransform::new(vec![1.2, 0.7, -0.3], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
    solve(&mut cost, 3);
    assert_eq!(cost.counts().model, varda_implicit::Counts::default());
    check_gradient(&mut cost, &normals(48, 3), &normals(49, 3));
}

#[test]
fn step_control_ends_where_full_steps_are_repelled_and_failures_are_reported() {
    // The dropped second derivatives are eight times A at this minimum.
    let b = Diagonal::uniform(2, 1.0).unwrap();
    let seen = observation(&[0, 1], 0, 0.0, &[-4.0, 0.5], 1.0);
    let mut set = ObservationSet::new(0, vec![Box::new(Products(2))], vec![seen]).unwrap();
    let transform = ControlTransform::new(vec![1.0, 0.5], &b).unwrap();
    let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
    let full = OuterLoopOptions::default().with_step_control(false);
    let minimum = outer_loop(&mut cost, &mut [0.0; 2], &full, &mut ignore()).unwrap();
    assert_eq!(minimum.status, Status::MaxIterations);
    for inner in [InnerSolver::Primal, InnerSolver::Dual] {
        let mut values = Vec::new();
        let options = OuterLoopOptions::default().with_inner(inner).with_max_iterations(500);
        let mut v = [0.0; 2];
        let minimum = outer_loop(&mut cost, &mut v, &options, &mut |i| {
            values.push(i.value);
            ControlFlow::Continue(())
        })
        .unwrap();
        assert_eq!(minimum.status, Status::Converged, "{minimum:?}");
        assert!(values.windows(2).all(|w| w[1] <= w[0] * (1.0 + 1e-11)));
    }
    let stop = &mut |_: &Iteration| ControlFlow::Break(());
    let ended = outer_loop(&mut cost, &mut [0.0; 2], &OuterLoopOptions::default(), stop).unwrap();
    assert_eq!((ended.status, ended.outer_iterations), (Status::Interrupted, 0));
    for options in [
        OuterLoopOptions::default().with_max_inner(0),
        OuterLoopOptions::default().with_inner_tolerance(1.0),
        OuterLoopOptions::default().with_gradient_tolerance(f64::NAN),
    ] {
        let ended = outer_loop(&mut cost, &mut [0.0; 2], &options, &mut ignore());
        assert!(matches!(ended, Err(Error::Setting { .. })));
    }

    // A model that refuses a full step: reported without control, overcome with it.
    let (mut model, background, mut set) = curved_problem();
    model.bound = 12.0;
    let b = coupled(6, 5.0);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let start: Vec<f64> = normals(7, 6).iter().map(|v| 0.05 * v).collect();
    let failed = outer_loop(&mut cost, &mut start.clone(), &full, &mut ignore()).unwrap();
    assert_eq!(failed.status, Status::Failed, "{failed:?}");
    assert!(failed.failure.is_some());
    let ended =
        outer_loop(&mut cost, &mut start.clone(), &OuterLoopOptions::default(), &mut ignore()).unwrap();
    assert!(ended.value < failed.value);
}

/// A linear problem: the inner cost is the full cost, and one outer iteration is all of 4D-Var.
#[test]
fn on_a_linear_problem_the_inner_cost_is_the_cost() {
    let (mut model, background, mut set) = linear_window(4, 8);
    let b = coupled(4, 0.8);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let (v, p) = (normals(50, 4), normals(51, 4));
    let mut g = vec![0.0; 4];
    let value = cost.linearize(&v, &mut g).unwrap();
    let mut inner = InnerCost::new(&mut cost);
    let mut at_zero = vec![0.0; 4];
    assert!((inner.evaluate(&[0.0; 4], Some(&mut at_zero)).unwrap() - value).abs() <= 1e-14 * value);
    assert!(relative(&at_zero, &g) <= 1e-13);
    let predicted = inner.evaluate(&p, Some(&mut at_zero)).unwrap();
    let parts = inner.terms();
    check_gradient(&mut inner, &v, &p);
    let moved: Vec<f64> = v.iter().zip(&p).map(|(v, p)| v + p).collect();
    let found = cost.evaluate(&moved, Some(&mut g)).unwrap();
    assert!((found - predicted).abs() <= 1e-13 * found);
    assert!((parts.background - cost.terms().background).abs() <= 1e-13 * found);
    assert!(relative(&at_zero, &g) <= 1e-12);

    let mut by = [vec![0.0; 4], vec![0.0; 4]];
    let options = OuterLoopOptions::default().with_inner_tolerance(1e-13);
    let one = outer_loop(&mut cost, &mut by[0], &options, &mut ignore()).unwrap();
    assert_eq!((one.status, one.outer_iterations), (Status::Converged, 1));
    newton(&mut cost, &mut by[1], &NewtonOptions::default().with_gradient_tolerance(1e-13), &mut ignore())
        .unwrap();
    assert!(relative(&by[0], &by[1]) <= 1e-10);
    cost.linearize(&[0.0; 4], &mut g).unwrap();
    let mut dual = Dual::new(&mut cost).unwrap();
    check_gradient(&mut dual, &normals(52, 12), &normals(53, 12));
}

/// Kalman filter and Rauch–Tung–Striebel smoother, densely, against strong 4D-Var (Q = 0) and weak (Q >
/// 0).
#[test]
fn strong_4dvar_is_the_filter_at_the_end_and_the_smoother_at_the_start() {
    let (n, steps) = (4, 8);
    let (mut model, background, mut set) = linear_window(n, steps);
    let b = coupled(n, 0.8);
    let step = step_matrix(&mut linear_window(n, steps).0, n);
    let (filtered, smoothed) = kalman(&step, &Matrix::of(&b), None, &background, &set, steps);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
    for inner in [InnerSolver::Primal, InnerSolver::Dual] {
        let mut v = vec![0.0; n];
        let options = OuterLoopOptions::default()
            .with_inner(inner)
            .with_inner_tolerance(1e-14)
            .with_gradient_tolerance(1e-12);
        let minimum = outer_loop(&mut cost, &mut v, &options, &mut ignore()).unwrap();
        assert_eq!(minimum.status, Status::Converged);
        assert!(relative(cost.state(0), &smoothed[0].0) <= 1e-9);
        assert!(relative(cost.state(steps), &filtered[steps].0) <= 1e-9);
    }
    let blue = Blue::new(&mut cost, &[0.0; 4], Gain::Observation).unwrap();
    assert!(relative(&blue.control_covariance(&transform), &smoothed[0].1.by_columns()) <= 1e-9);
    assert!(relative(&blue.analysis(&transform), &smoothed[0].0) <= 1e-9);
    // In between they differ: the filter has not seen what comes later.
    assert!(relative(&filtered[0].0, &smoothed[0].0) > 1e-3);
}

#[test]
fn a_wrong_adjoint_is_caught_by_the_dual_too() {
    let (mut model, background, mut set) = curved_problem();
    model.mutation = 1e-3;
    let b = coupled(6, 0.5);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let (_, worst) = compare_iterates(&mut cost, &normals(7, 6));
    assert!(worst > 1e-6, "{worst:e}");
}
