//! Schemes whose state holds the state before: BDF2 against its printed recursion, in parts, and on a grid of
//! times.

use varda_implicit::lorenz::Lorenz63;
use varda_implicit::{
    Adaptive, Error, ImplicitModel, Keep, Model, NewtonOptions, OneLeg, Rhs, Scheme, Substepped, Trajectory,
    accepted_times, check, largest_error,
};

/// ẋ = −3x + cos 2t.
#[derive(Clone)]
struct Relaxation;

impl Rhs for Relaxation {
    fn dim(&self) -> usize {
        1
    }
    fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
        f[0] = -3.0 * x[0] + (2.0 * t).cos();
    }
    fn tangent(&mut self, _t: f64, _x: &[f64], dx: &[f64], df: &mut [f64]) {
        df[0] = -3.0 * dx[0];
    }
    fn adjoint_add(&mut self, _t: f64, _x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx[0] -= 3.0 * lambda[0];
    }
}

/// x at every time of a grid, by formulas for a linear equation.
fn by_hand(times: &[f64]) -> Vec<f64> {
    let mut x = vec![0.7];
    for k in 0..times.len() - 1 {
        let h = times[k + 1] - times[k];
        let next = if k == 0 {
            // x₁ = x₀ + h (−3 (x₀ + x₁)/2 + cos 2t_½)
            (x[0] * (1.0 - 1.5 * h) + h * (times[0] + times[1]).cos()) / (1.0 + 1.5 * h)
        } else {
            // the derivative at t_{k+1} of the parabola through the last three points (Lagrange)
            let (a, b) = (h, times[k + 1] - times[k - 1]);
            let (now, before) = (x[k], x[k - 1]);
            let weights = [1.0 / a + 1.0 / b, -b / (a * (b - a)), a / (b * (b - a))];
            let rest = weights[1] * now + weights[2] * before;
            ((2.0 * times[k + 1]).cos() - rest) / (weights[0] + 3.0)
        };
        x.push(next);
    }
    x
}

fn run(model: &mut ImplicitModel<OneLeg<Relaxation>>, steps: usize) -> Vec<f64> {
    let mut x0 = [0.0; 2];
    model.initial_state(&[0.7], &mut x0).unwrap();
    let mut trajectory = Trajectory::new();
    trajectory.run(model, &x0, steps, Keep::States).unwrap();
    for k in 1..=steps {
        assert_eq!(trajectory.state(k)[1], trajectory.state(k - 1)[0], "the state before, step {k}");
    }
    (0..=steps).map(|k| trajectory.state(k)[0]).collect()
}

#[test]
fn bdf2_is_its_printed_recursion_on_even_and_uneven_grids() {
    let even: Vec<f64> = (0..=20).map(|k| f64::from(k + 5) * 0.1).collect();
    let uneven: Vec<f64> = (0..=20).map(|k| 0.5 + 0.005 * f64::from(k * (k + 3)) / 2.0).collect();
    let step = || OneLeg::bdf2(Relaxation, 1e-14);
    let ours = [
        run(&mut ImplicitModel::new(step(), 5, 0.1), 20),
        run(&mut ImplicitModel::on_times(step(), even.clone()), 20),
        run(&mut ImplicitModel::on_times(step(), uneven.clone()), 20),
    ];
    for (ours, times) in ours.iter().zip([&even, &even, &uneven]) {
        for (a, b) in ours.iter().zip(by_hand(times)) {
            // A stable recursion of 20 steps: a few roundings of numbers of size 1.
            assert!((a - b).abs() < 1e-14, "{a} and {b}");
        }
    }
}

#[test]
fn the_state_before_conforms_on_any_grid() {
    let (x, scale) = ([1.2, -0.7, 10.3, 1.1, -0.6, 10.5], [0.1; 6]);
    let uneven: Vec<f64> = (0..12).map(|k| 0.002 * f64::from(k * (k + 3))).collect();
    for mut model in [
        ImplicitModel::new(OneLeg::bdf2(Lorenz63::default(), 1e-12), 0, 0.01),
        ImplicitModel::on_times(OneLeg::bdf2(Lorenz63::default(), 1e-12), uneven),
    ] {
        for k in [0, 4] {
            for outcome in check::conformance(&mut model, k, &x, &scale, 7).unwrap() {
                assert!(outcome.pass, "step {k}: {outcome:?}");
            }
        }
        let window = check::window(&mut model, &x, 10, &scale, 11).unwrap();
        assert!(window.pass, "{window:?}");
    }
}

/// Newton's method cut short: steps are halved, and every part has the part before it for its past.
#[test]
fn steps_in_parts_conform_and_hand_on_whole_steps() {
    let options = NewtonOptions::default().with_max_iterations(3);
    let mut model =
        ImplicitModel::new(OneLeg::bdf2(Lorenz63::default(), 1e-11), 0, 0.1).with_options(options);
    let x = [1.0, 3.0, 20.0, 1.1, 2.6, 21.0];
    let mut next = [0.0; 6];
    let work = model.step(3, &x, &mut next).unwrap();
    assert!(work.substeps > 0, "the step was to be halved");
    assert_eq!(next[3..], x[..3], "the step before the next one is the whole of this one");
    for outcome in check::conformance(&mut model, 3, &x, &[1e-3; 6], 5).unwrap() {
        assert!(outcome.pass, "{outcome:?}");
    }
    let window = check::window(&mut model, &x, 8, &[1e-3; 6], 5).unwrap();
    assert!(window.pass, "{window:?}");
}

/// The tangent of x₀'s own history and the control's, step 0 reading neither.
#[test]
fn the_control_is_without_the_state_before() {
    let mut model = ImplicitModel::new(OneLeg::bdf2(Lorenz63::default(), 1e-12), 0, 0.01);
    assert_eq!((model.dim(), model.control_dim()), (6, 3));
    let mut x0 = [0.0; 6];
    model.initial_state(&[1.0, 2.0, 3.0], &mut x0).unwrap();
    assert_eq!(x0, [1.0, 2.0, 3.0, 1.0, 2.0, 3.0]);
    let (mut dx, mut dz) = ([0.0; 6], [0.0; 3]);
    model.initial_tangent(&[0.5, -1.0, 2.0], &mut dx);
    assert_eq!(dx, [0.5, -1.0, 2.0, 0.5, -1.0, 2.0]);
    model.initial_adjoint(&[1.0, 10.0, 100.0, 2.0, 20.0, 200.0], &mut dz);
    assert_eq!(dz, [3.0, 30.0, 300.0]);
    // another past, the same first step
    let (mut a, mut b) = ([0.0; 6], [0.0; 6]);
    model.step(0, &x0, &mut a).unwrap();
    model.step(0, &[1.0, 2.0, 3.0, -9.0, 9.0, 0.0], &mut b).unwrap();
    assert_eq!(a, b);
}

/// A pulse of width 0.02 s: ẋ = −x + pulse(t).
struct Pulse;

impl Rhs for Pulse {
    fn dim(&self) -> usize {
        1
    }
    fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
        f[0] = -x[0] + 50.0 * (-((t - 0.5) / 0.02).powi(2)).exp();
    }
    fn tangent(&mut self, _t: f64, _x: &[f64], dx: &[f64], df: &mut [f64]) {
        df[0] = -dx[0];
    }
    fn adjoint_add(&mut self, _t: f64, _x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx[0] -= lambda[0];
    }
}

/// Steps are short where the pulse is, and the error at the end falls as the tolerance does.
#[test]
fn accepted_steps_follow_the_error() {
    let options = |tolerance| Adaptive { tolerance, first: 0.01, shortest: 1e-6, longest: 0.2 };
    for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
        let step = || OneLeg::new(Pulse, scheme, 1e-13);
        let n = if scheme == Scheme::Bdf2 { 2 } else { 1 };
        let (x0, scale) = (vec![0.3; n], vec![1.0; n]);
        let end = |times: &[f64]| {
            let mut model = ImplicitModel::on_times(step(), times.to_vec());
            let mut trajectory = Trajectory::new();
            trajectory.run(&mut model, &x0, times.len() - 1, Keep::States).unwrap();
            trajectory.state(times.len() - 1)[0]
        };
        // x(1) = 0.3/e + ∫ e^{s−1} f(s) ds by the trapezoidal rule, exact to rounding for a smooth pulse
        let pulse = |s: f64| 50.0 * (-((s - 0.5) / 0.02_f64).powi(2)).exp() * (s - 1.0).exp();
        let exact =
            0.3 * (-1.0_f64).exp() + (0..10_000).map(|i| 1e-4 * pulse(1e-4 * f64::from(i))).sum::<f64>();
        let mut errors = Vec::new();
        for tolerance in [1e-3, 1e-5] {
            let times =
                accepted_times(&mut step(), scheme, &x0, &scale, &[0.0, 0.25, 1.0], &options(tolerance))
                    .unwrap();
            assert!(times.contains(&0.25) && times.first() == Some(&0.0) && times.last() == Some(&1.0));
            let along = |x0: &[f64]| largest_error(&mut step(), scheme, x0, &scale, &times).unwrap();
            // as they were accepted; and from where the transient is ten thousand times as large they are not
            assert!(along(&x0) <= tolerance && along(&vec![3e3; n]) > tolerance, "{scheme:?}");
            let length = |near: f64| {
                let i = times.partition_point(|t| *t <= near);
                times[i] - times[i - 1]
            };
            assert!(length(0.5) < 0.2 * length(0.9), "{scheme:?}: {times:?}");
            errors.push((end(&times) - exact).abs());
            // as many errors of the size of the tolerance as there are steps
            assert!(errors[errors.len() - 1] < times.len() as f64 * tolerance, "{scheme:?}: {errors:?}");
        }
        assert!(errors[1] < 0.2 * errors[0], "{scheme:?}: {errors:?}");
    }
    let strict = Adaptive { tolerance: 1e-9, first: 0.01, shortest: 0.01, longest: 0.2 };
    let mut step = OneLeg::new(Pulse, Scheme::Midpoint, 1e-13);
    let refused = accepted_times(&mut step, Scheme::Midpoint, &[0.3], &[1.0], &[0.0, 1.0], &strict);
    assert!(matches!(refused, Err(Error::ToleranceNotMet { .. })), "{refused:?}");
}

#[test]
fn grouped_steps_are_one_step_with_exact_derivatives() {
    let times: Vec<f64> = (0..12).map(|k| 0.002 * f64::from(k * (k + 3))).collect();
    let through = [times[0], times[3], times[4], times[11]];
    let inner = || ImplicitModel::on_times(OneLeg::bdf2(Lorenz63::default(), 1e-12), times.clone());
    let mut model = Substepped::through(inner(), &times, &through);
    let (x, scale) = ([1.2, -0.7, 10.3, 1.2, -0.7, 10.3], [0.1; 6]);
    let mut trajectory = Trajectory::new();
    trajectory.run(&mut model, &x, 3, Keep::States).unwrap();
    let mut every = Trajectory::new();
    every.run(&mut inner(), &x, 11, Keep::States).unwrap();
    assert_eq!(trajectory.state(1), every.state(3));
    assert_eq!(trajectory.state(3), every.state(11));
    for k in [0, 2] {
        for outcome in check::conformance(&mut model, k, &x, &scale, 7).unwrap() {
            assert!(outcome.pass, "step {k}: {outcome:?}");
        }
    }
    let window = check::window(&mut model, &x, 3, &scale, 11).unwrap();
    assert!(window.pass, "{window:?}");
    assert!(matches!(model.linearize(1, 1, &x, &x), Err(Error::NotAStep { step: 1 })));
}
