//! Weak constraint: over forcing, over states, by block-tridiagonal Cholesky, and their limits.

use crate::cost::{coupled, curved_problem, relative};
use crate::family::{ignore, wide_problem};
use crate::matrix::*;
use crate::models::*;
use varda_assimilation::*;
use varda_covariance::{Covariance, Dense, Diagonal, Precision};
use varda_implicit::{ControlMap, Model, Work};

/// Every second component, error every third step.
fn partial(n: usize) -> Forcing {
    Forcing { components: (0..n).step_by(2).collect(), steps: 3, held: false }
}

fn minimize(problem: &mut dyn LeastSquares, v: &mut [f64], inner: InnerSolver) -> Minimum {
    let options = OuterLoopOptions::default()
        .with_inner(inner)
        .with_gradient_tolerance(1e-11)
        .with_inner_tolerance(1e-10)
        .with_max_inner(1000)
        .with_max_iterations(500);
    let minimum = outer_loop(problem, v, &options, &mut ignore()).unwrap();
    assert_eq!(minimum.status, Status::Converged, "{inner:?} {minimum:?}");
    minimum
}

#[test]
fn gradients_are_those_of_j_in_both_forms() {
    for (held, steps, half) in [(false, 1, false), (false, 3, true), (true, 3, true), (true, 5, false)] {
        let components: Vec<usize> = (0..6).step_by(if half { 2 } else { 1 }).collect();
        let q = coupled(components.len(), 0.2);
        let forcing = Forcing { components, steps, held };
        let b = coupled(6, 0.5);

        let (mut model, background, mut set) = curved_problem();
        let transform = ControlTransform::new(background, &b).unwrap();
        let mut cost = WeakForcing::new(&mut model, transform, &q, forcing.clone(), &mut set).unwrap();
        // The last observation is at step 12.
        assert_eq!(cost.forcings(), if held { 12usize.div_ceil(steps) } else { 12 / steps });
        let n = cost.dim();
        assert_eq!(n, 6 + cost.forcings() * q.dim());
        check_gradient(&mut cost, &normals(60, n), &normals(61, n));
        assert!(cost.terms().model_error > 0.0);
        assert!(transposed(&mut cost) <= 1e-14);
        // The dense Hessian by products.
        let mut hessian = vec![0.0; n * n];
        cost.hessian(&mut hessian).unwrap();
        let (dv, mut product) = (normals(62, n), vec![0.0; n]);
        cost.hessian_apply(&dv, &mut product).unwrap();
        let expected: Vec<f64> = (0..n).map(|i| (0..n).map(|j| hessian[i + j * n] * dv[j]).sum()).collect();
        assert!(relative(&product, &expected) <= 1e-13);
        // The posterior of the initial state is the leading block of the whole one's.
        let whole = Posterior::from_hessian(n, &hessian).unwrap().control_variable_variance();
        let first = Posterior::of_initial_state(&mut cost).unwrap().control_variable_variance();
        assert!(first.len() == 6 && relative(&first, &whole[..6]) <= 1e-11);
        drop(cost);
        if held {
            continue;
        }

        let (mut model, background, mut set) = curved_problem();
        let mut cost = WeakState::new(&mut model, background, &b, &q, forcing, &mut set).unwrap();
        let start = cost.background().unwrap();
        let at =
            |seed| -> Vec<f64> { start.iter().zip(normals(seed, n)).map(|(x, e)| x + 0.1 * e).collect() };
        check_gradient(&mut cost, &at(63), &at(64));
        assert!(transposed(&mut cost) <= 1e-14);
        let (mut v, mut gradient) = (start.clone(), vec![0.0; n]);
        v.iter_mut().zip(normals(66, n)).for_each(|(v, e)| *v += 0.01 * e);
        cost.linearize(&v, &mut gradient).unwrap();
        let first = Posterior::of_initial_state(&mut cost).unwrap();
        assert!(first.spectrum().len() == 6 && first.spectrum().iter().all(|mu| *mu > 1.0 - 1e-12));
        // The gradient in p is that along its increments: ∇q(0)·p = ∇J·increment(p).
        let (p, mut dv, mut g, mut gp) = (normals(65, n), vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        cost.evaluate(&at(63), Some(&mut g)).unwrap();
        cost.linearize(&at(63), &mut gp).unwrap();
        cost.increment(&p, &mut dv).unwrap();
        assert!((dot(&gp, &p) - dot(&g, &dv)).abs() <= 1e-12 * norm(&g) * norm(&dv));
    }
}

/// |⟨G p, w⟩ − ⟨p, Gᵀ w⟩|, relative to the norms.
fn transposed(problem: &mut dyn LeastSquares) -> f64 {
    let (n, m) = (problem.dim(), problem.observation_dim());
    let (p, w) = (normals(66, n), normals(67, m));
    let (mut dy, mut back) = (vec![0.0; m], vec![0.0; n]);
    problem.jacobian(&p, &mut dy).unwrap();
    problem.jacobian_transpose(&w, &mut back).unwrap();
    assert!(dot(&dy, &w).abs() > 1e-3 * norm(&dy) * norm(&w), "an empty test");
    (dot(&dy, &w) - dot(&p, &back)).abs() / (norm(&dy) * norm(&w))
}

#[test]
fn a_wrong_adjoint_is_caught() {
    let (mut model, background, mut set) = curved_problem();
    model.mutation = 1e-3;
    let (b, q) = (coupled(6, 0.5), coupled(6, 0.2));
    let mut cost = WeakState::new(&mut model, background, &b, &q, Forcing::every_step(6), &mut set).unwrap();
    // Away from a trajectory of the model: on one, its error has no gradient that M_0ᵀ would carry.
    let mut v = cost.background().unwrap();
    v.iter_mut().zip(normals(63, 78)).for_each(|(x, e)| *x += 0.1 * e);
    let mut g = vec![0.0; v.len()];
    cost.evaluate(&v, Some(&mut g)).unwrap();
    assert!(transposed(&mut cost) > 1e-6);
    assert!(relative(&crate::cost::difference_gradient(&mut cost, &v), &g) > 1e-6);
}

/// A linear window: forcing, states, direct, dual and the RTS smoother with Q.
#[test]
fn the_weak_forms_are_the_smoother_on_a_linear_window() {
    let (n, steps) = (4, 8);
    let (b, q) = (coupled(n, 0.8), coupled(n, 0.3));
    let (mut model, background, mut set) = linear_window(n, steps);
    let step = step_matrix(&mut model, n);
    let (_, smoothed) = kalman(&step, &Matrix::of(&b), Some(&Matrix::of(&q)), &background, &set, steps);
    let check = |name: &str, state: &dyn Fn(usize) -> Vec<f64>| {
        for k in 0..=steps {
            let error = relative(&state(k), &smoothed[k].0);
            assert!(error <= 1e-9, "{name} {k}: {error:e}");
        }
    };
    let transform = ControlTransform::new(background.clone(), &b).unwrap();
    let mut cost =
        WeakForcing::new(&mut model, transform.clone(), &q, Forcing::every_step(n), &mut set).unwrap();
    let mut values = Vec::new();
    for inner in [InnerSolver::Primal, InnerSolver::Dual, InnerSolver::Direct] {
        let mut v = vec![0.0; cost.dim()];
        values.push(minimize(&mut cost, &mut v, inner).value);
        check("forcing", &|k| cost.state(k).to_vec());
        // What the forcing says, and the model with it, are the states.
        let mut eta = vec![0.0; n];
        cost.forcing(&v, 2, &mut eta);
        let moved: Vec<f64> = step.apply(cost.state(2)).iter().zip(&eta).map(|(x, e)| x + e).collect();
        assert!(relative(&moved, cost.state(3)) <= 1e-13);
    }
    let start = vec![0.0; cost.dim()];
    let blue = Blue::new(&mut cost, &start, Gain::Observation).unwrap();
    assert!(relative(&blue.control_covariance(&transform), &smoothed[0].1.by_columns()) <= 1e-9);
    drop(cost);
    let mut cost = WeakState::new(&mut model, background, &b, &q, Forcing::every_step(n), &mut set).unwrap();
    for inner in [InnerSolver::Primal, InnerSolver::Dual, InnerSolver::Direct] {
        let mut v = cost.background().unwrap();
        let minimum = minimize(&mut cost, &mut v, inner);
        assert_eq!(minimum.outer_iterations, 1, "{inner:?}");
        values.push(minimum.value);
        check("states", &|k| cost.state(k).to_vec());
        for k in 0..=steps {
            assert!(relative(&v[k * n..(k + 1) * n], cost.state(k)) == 0.0);
        }
    }
    let start = cost.background().unwrap();
    let over_states = Blue::new(&mut cost, &start, Gain::Information).unwrap();
    assert!(relative(&over_states.control_covariance(&transform), &smoothed[0].1.by_columns()) <= 1e-9);
    assert!(relative(&over_states.analysis(&transform), &smoothed[0].0) <= 1e-9);
    values.extend([blue.value, over_states.value]);
    assert!(values.iter().all(|j| (j - values[0]).abs() <= 1e-12 * j), "{values:?}");
}

/// One direct increment against the dense one in p, on a nonlinear problem with observations between steps
/// and several steps in a sub-window.
#[test]
fn the_block_tridiagonal_increment_is_the_dense_one() {
    for steps in [1, 4, 5, 20] {
        let (mut model, background, mut set) = curved_problem();
        let (b, q) = (coupled(6, 0.5), coupled(6, 0.2));
        // Components in another order.
        let forcing = Forcing { components: vec![3, 1, 0, 2, 5, 4], steps, held: false };
        let mut cost = WeakState::new(&mut model, background, &b, &q, forcing, &mut set).unwrap();
        let n = cost.dim();
        let start: Vec<f64> =
            cost.background().unwrap().iter().zip(normals(68, n)).map(|(x, e)| x + 0.1 * e).collect();
        let (mut g, mut direct, mut krylov) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        cost.linearize(&start, &mut g).unwrap();
        cost.direct(&g, &mut direct).unwrap();
        let limits = InnerLimits { residual: 1e-14, iterations: n };
        conjugate_gradients(&mut cost, &g, &limits, &mut krylov).unwrap();
        assert!(relative(&direct, &krylov) <= 1e-11, "{steps}: {:e}", relative(&direct, &krylov));
    }
    let (mut model, background, mut set) = curved_problem();
    let (b, q) = (coupled(6, 0.5), coupled(3, 0.2));
    let mut cost = WeakState::new(&mut model, background, &b, &q, partial(6), &mut set).unwrap();
    let start = cost.background().unwrap();
    let mut g = vec![0.0; start.len()];
    cost.linearize(&start, &mut g).unwrap();
    assert!(matches!(cost.direct(&g.clone(), &mut g), Err(Error::Length { expected: 6, found: 3, .. })));
}

#[test]
fn the_weak_forms_agree_on_nonlinear_windows() {
    let problems: [(usize, Forcing, Dense); 3] = [
        (6, Forcing::every_step(6), coupled(6, 0.2)),
        (6, partial(6), coupled(3, 0.3)),
        (30, Forcing { steps: 2, ..Forcing::every_step(30) }, coupled(30, 0.2)),
    ];
    for (n, forcing, q) in problems {
        let make = || if n == 6 { curved_problem() } else { wide_problem() };
        let b = coupled(n, 0.3);
        let (mut model, background, mut set) = make();
        let transform = ControlTransform::new(background.clone(), &b).unwrap();
        let mut over_forcing =
            WeakForcing::new(&mut model, transform, &q, forcing.clone(), &mut set).unwrap();
        let mut v = vec![0.0; over_forcing.dim()];
        let one = minimize(&mut over_forcing, &mut v, InnerSolver::Primal);
        let (mut model, _, mut set) = make();
        let mut over_states = WeakState::new(&mut model, background, &b, &q, forcing, &mut set).unwrap();
        for inner in [InnerSolver::Primal, InnerSolver::Dual] {
            let mut x = over_states.background().unwrap();
            let two = minimize(&mut over_states, &mut x, inner);
            // 1e-8 is what the issue asks for; gradients are at 1e-11 of the first.
            assert!((one.value - two.value).abs() <= 1e-10 * one.value, "{} {}", one.value, two.value);
            for (a, b) in [
                (one.terms.background, two.terms.background),
                (one.terms.observation, two.terms.observation),
                (one.terms.model_error, two.terms.model_error),
            ] {
                assert!((a - b).abs() <= 1e-8 * one.value, "{:?} {:?}", one.terms, two.terms);
            }
            for k in [0, 3, 6] {
                let error = relative(over_states.state(k), over_forcing.state(k));
                assert!(error <= 1e-8, "{n} {inner:?} {k}: {error:e}");
            }
        }
        assert!(one.terms.model_error > 1e-3);
    }
}

/// ‖x₀(weak) − x₀(strong)‖ falls like Q, that is like σ_q².
#[test]
fn weak_becomes_strong_as_q_vanishes() {
    let b = coupled(6, 0.5);
    let (mut model, background, mut set) = curved_problem();
    let transform = ControlTransform::new(background.clone(), &b).unwrap();
    let mut strong = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
    let mut v = vec![0.0; 6];
    minimize(&mut strong, &mut v, InnerSolver::Primal);
    drop(strong);
    let sigmas = [1e-2, 1e-3, 1e-4];
    let gaps = sigmas.map(|sigma| {
        let q = Diagonal::uniform(6, sigma).unwrap();
        let forcing = Forcing::every_step(6);
        let mut cost = WeakForcing::new(&mut model, transform.clone(), &q, forcing, &mut set).unwrap();
        let mut weak = vec![0.0; cost.dim()];
        weak[..6].copy_from_slice(&v);
        minimize(&mut cost, &mut weak, InnerSolver::Primal);
        relative(&weak[..6], &v)
    });
    for pair in gaps.windows(2) {
        let rate = (pair[0] / pair[1]).log10();
        assert!((rate - 2.0).abs() <= 0.1, "{gaps:?}");
    }
}

#[test]
fn work_is_counted_and_a_steps_error_enters_after_it() {
    let (mut model, background, mut set) = curved_problem();
    let (b, q) = (coupled(6, 0.5), coupled(3, 0.2));
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = WeakForcing::new(&mut model, transform, &q, partial(6), &mut set).unwrap();
    let n = cost.dim();
    let (v, mut g, mut out) = (normals(60, n), vec![0.0; n], vec![0.0; n]);
    cost.evaluate(&v, Some(&mut g)).unwrap();
    let once = varda_implicit::Counts {
        model_steps: 12,
        linearizations: 12,
        adjoint_steps: 12,
        ..Default::default()
    };
    assert_eq!(cost.counts().model, once);
    cost.hessian_apply(&v, &mut out).unwrap();
    let product = varda_implicit::Counts { tangent_steps: 12, adjoint_steps: 24, ..once };
    assert_eq!(cost.counts().model, product);
    assert_eq!((cost.counts().tangent_sweeps, cost.counts().adjoint_sweeps), (1, 2));
    // Component 1 is not forced: the third step lands where the model says.
    let landed = run(&mut Rk4::new(Lorenz96(6), 0.03), cost.state(2), 1).pop().unwrap();
    assert_eq!(cost.state(3)[1], landed[1]);
    let mut eta = vec![0.0; 3];
    cost.forcing(&v, 0, &mut eta);
    assert_eq!(cost.state(3)[2], landed[2] + eta[1]);
}

#[test]
fn bad_model_errors_are_refused() {
    let b = Diagonal::uniform(6, 0.5).unwrap();
    let q = Diagonal::uniform(2, 0.1).unwrap();
    let attempt = |components: Vec<usize>, steps: usize, held: bool| {
        let (mut model, background, mut set) = curved_problem();
        let forcing = Forcing { components, steps, held };
        let (b, q): (&dyn Precision, &dyn Precision) = (&b, &q);
        WeakState::new(&mut model, background, b, q, forcing, &mut set).err()
    };
    assert!(attempt(vec![0, 5], 2, false).is_none());
    assert!(matches!(attempt(vec![0], 2, false), Some(Error::Length { expected: 2, found: 1, .. })));
    assert!(matches!(attempt(vec![0, 0], 2, false), Some(Error::OperatorEntry { row: 1, column: 0, .. })));
    assert!(matches!(attempt(vec![0, 6], 2, false), Some(Error::OperatorEntry { row: 1, column: 6, .. })));
    assert!(matches!(attempt(vec![0, 5], 0, false), Some(Error::Setting { .. })));
    assert!(matches!(attempt(vec![0, 5], 2, true), Some(Error::Setting { .. })));
}

/// Lorenz-96 with one more component, which the control lacks: it starts from the others, follows the square
/// of the first and feeds nothing but itself and an observation.
struct Carrying {
    inner: Rk4<Lorenz96>,
    z: Vec<f64>,
    first: Vec<f64>,
}

impl Model for Carrying {
    fn dim(&self) -> usize {
        7
    }
    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, varda_implicit::Error> {
        x_next[6] = 0.5 * x[6] + 0.1 * x[0] * x[0];
        self.inner.step(k, &x[..6], &mut x_next[..6])
    }
    fn linearize(
        &mut self,
        slot: usize,
        k: usize,
        x: &[f64],
        x_next: &[f64],
    ) -> Result<Work, varda_implicit::Error> {
        // As strict as an implicit model: the pair must be a step, bit for bit.
        let mut landed = vec![0.0; 7];
        self.step(k, x, &mut landed)?;
        if landed != x_next {
            return Err(varda_implicit::Error::NotAStep { step: k });
        }
        self.first.resize(self.first.len().max(slot + 1), 0.0);
        self.first[slot] = x[0];
        self.inner.linearize(slot, k, &x[..6], &x_next[..6])
    }
    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        for dx in dx.chunks_exact_mut(7) {
            dx[6] = 0.5 * dx[6] + 0.2 * self.first[slot] * dx[0];
            self.inner.tangent(slot, &mut dx[..6]);
        }
    }
    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        for lambda in lambda.chunks_exact_mut(7) {
            self.inner.adjoint(slot, &mut lambda[..6]);
            lambda[0] += 0.2 * self.first[slot] * lambda[6];
            lambda[6] *= 0.5;
        }
    }
    fn release(&mut self, from_slot: usize) {
        self.inner.release(from_slot);
    }
    fn slot_bytes(&self) -> usize {
        self.inner.slot_bytes()
    }
    fn bytes(&self) -> usize {
        self.inner.bytes()
    }
    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        Some(self)
    }
}

impl ControlMap for Carrying {
    fn control_len(&self) -> usize {
        6
    }
    fn to_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), varda_implicit::Error> {
        self.z = z.to_vec();
        x[..6].copy_from_slice(z);
        x[6] = z[1] * z[2];
        Ok(())
    }
    fn to_state_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        dx[..6].copy_from_slice(dz);
        dx[6] = self.z[1] * dz[2] + self.z[2] * dz[1];
    }
    fn to_state_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        dz.copy_from_slice(&lambda[..6]);
        dz[1] += self.z[2] * lambda[6];
        dz[2] += self.z[1] * lambda[6];
    }
}

/// As on a rod: Q on [X, V], the rest of the state carried along by the model, through every boundary of a
/// sub-window.
#[test]
fn a_state_longer_than_the_control_and_partly_forced() {
    let (_, background, _) = curved_problem();
    let values = normals(70, 12);
    let observations: Vec<Observation> = (0..4)
        .map(|j| {
            observation(&[6, 1, 3], 3 * j, if j < 3 { 0.4 } else { 0.0 }, &values[3 * j..3 * j + 3], 0.5)
        })
        .collect();
    let make = || ObservationSet::new(9, vec![all_of(7)], observations.clone()).unwrap();
    let model = || Carrying { inner: Rk4::new(Lorenz96(6), 0.03), z: Vec::new(), first: Vec::new() };
    let (b, q) = (coupled(6, 0.3), coupled(6, 0.2));
    let forcing = Forcing { components: (0..6).collect(), steps: 2, held: false };

    let (mut first, mut set) = (model(), make());
    let transform = ControlTransform::new(background.clone(), &b).unwrap();
    let mut over_forcing = WeakForcing::new(&mut first, transform, &q, forcing.clone(), &mut set).unwrap();
    let n = over_forcing.dim();
    check_gradient(&mut over_forcing, &normals(71, n), &normals(72, n));
    let mut v = vec![0.0; n];
    let one = minimize(&mut over_forcing, &mut v, InnerSolver::Primal);

    let (mut second, mut set) = (model(), make());
    let mut over_states = WeakState::new(&mut second, background, &b, &q, forcing, &mut set).unwrap();
    let start = over_states.background().unwrap();
    let at = |seed| -> Vec<f64> { start.iter().zip(normals(seed, n)).map(|(x, e)| x + 0.1 * e).collect() };
    check_gradient(&mut over_states, &at(73), &at(74));
    let mut x = start.clone();
    let two = minimize(&mut over_states, &mut x, InnerSolver::Dual);
    assert!((one.value - two.value).abs() <= 1e-10 * one.value, "{} {}", one.value, two.value);
    assert!(relative(over_states.state(9), over_forcing.state(9)) <= 1e-8);
}

/// A window of Lorenz-63 in which everything that starts from the background ends in a wrong minimum (J about
/// 1268 against 13.3). States that start near the observations are led to the right one, with an error of the
/// model too small to matter, and the strong constraint from there.
#[test]
fn states_that_start_at_the_observations_find_the_minimum_that_others_miss() {
    let options = OuterLoopOptions::default().with_max_inner(1000).with_max_iterations(500);
    for (steps, sigma, wrong) in [(100, 0.01, 1267.0), (200, 0.05, 2287.0)] {
        let (truth, background, mut set) = lorenz63_twin(90, steps, 10);
        let b = Diagonal::uniform(3, 1.0).unwrap();
        let q = Diagonal::uniform(3, sigma).unwrap();
        let mut model = Rk4::new(Lorenz63, 0.01);
        let transform = ControlTransform::new(background.clone(), &b).unwrap();
        let mut cost =
            WeakForcing::new(&mut model, transform.clone(), &q, Forcing::every_step(3), &mut set).unwrap();
        let mut from = |start: &[f64]| {
            let mut v = vec![0.0; cost.dim()];
            v[..3].copy_from_slice(start);
            let minimum = outer_loop(&mut cost, &mut v, &options, &mut ignore()).unwrap();
            assert_eq!(minimum.status, Status::Converged);
            minimum.value
        };
        let lowest = from(&truth.iter().zip(&background).map(|(t, b)| t - b).collect::<Vec<_>>());
        assert!(from(&[0.0; 3]) > wrong);
        drop(cost);

        let seen: Vec<Vec<f64>> = set.observations().iter().map(|o| o.values.clone()).collect();
        let mut cost =
            WeakState::new(&mut model, background.clone(), &b, &q, Forcing::every_step(3), &mut set).unwrap();
        // Linear between observations 10 steps apart, the background first.
        let mut x = cost.control(&background, &mut |k, x| {
            let (i, w) = (k / 10, (k % 10) as f64 / 10.0);
            let at = |i: usize| if i == 0 { &background } else { &seen[i.min(seen.len()) - 1] };
            (0..3).for_each(|c| x[c] = (1.0 - w) * at(i)[c] + w * at(i + 1)[c]);
        });
        let minimum = outer_loop(&mut cost, &mut x, &options, &mut ignore()).unwrap();
        assert_eq!(minimum.status, Status::Converged);
        assert!(minimum.outer_iterations <= 15, "{}", minimum.outer_iterations);
        assert!((minimum.value - lowest).abs() <= 1e-8 * lowest, "{} {lowest}", minimum.value);
        drop(cost);

        if steps == 100 {
            let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
            let mut strong = |start: Vec<f64>| {
                let mut v = start;
                trust_region(&mut cost, &mut v, &TrustRegionOptions::default(), &mut ignore()).unwrap().value
            };
            let right = strong(truth.iter().zip(&background).map(|(t, b)| t - b).collect());
            let led = strong(x[..3].iter().zip(&background).map(|(x, b)| x - b).collect());
            assert!((led - right).abs() <= 1e-8 * right, "{led} {right}");
            assert!(strong(vec![0.0; 3]) > wrong);
        }
    }
}

/// A cost over states is not whitened: minimizers with the Hessian say so, those with gradients alone work.
#[test]
fn minimizers_with_a_hessian_refuse_a_cost_that_is_not_whitened() {
    let (b, q) = (coupled(6, 0.5), coupled(6, 0.2));
    for name in Minimizer::NAMES {
        let (mut model, background, mut set) = curved_problem();
        let mut cost =
            WeakState::new(&mut model, background, &b, &q, Forcing::every_step(6), &mut set).unwrap();
        let mut v = vec![0.0; cost.dim()];
        let minimizer = Minimizer::named(name).unwrap().with_stopping(Stopping::new(1e-2, 20));
        let ended = minimizer.minimize(&mut cost, &mut v, &mut ignore());
        match *name {
            "lbfgs" | "adam" | "argmin-lbfgs" => {
                let minimum = ended.unwrap();
                assert!(minimum.gradient_norm < minimum.gradient_norm_first, "{name}: {minimum:?}");
            }
            _ => assert!(
                matches!(ended, Err(Error::NotWhitened { minimizer }) if minimizer == *name),
                "{name}"
            ),
        }
    }
}
