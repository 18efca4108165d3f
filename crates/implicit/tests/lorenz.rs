//! Lorenz models through RK4 and one-leg steps: reference numbers, conformance, order of accuracy.

use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{ImplicitModel, Keep, Model, OneLeg, Rk4, Trajectory, check};

/// Cost and gradient of the problem "Lorenz-96 values" (docs/reference-problems.md): N components, every
/// other one observed at steps 10, 20, …, 100.
fn cost_and_gradient(n: usize) -> (f64, Vec<f64>) {
    let truth0: Vec<f64> = (0..n).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
    let background: Vec<f64> =
        truth0.iter().enumerate().map(|(i, x)| x + 0.5 * (2.3 * i as f64 + 1.0).cos()).collect();
    let x0: Vec<f64> = background.iter().enumerate().map(|(i, x)| x + 0.1 * (i as f64).sin()).collect();
    let mut model = Rk4::new(Lorenz96::new(n, 8.0), 0, 0.01);
    let (mut truth, mut trajectory) = (Trajectory::new(), Trajectory::new());
    truth.run(&mut model, &truth0, 100, Keep::States).unwrap();
    trajectory.run(&mut model, &x0, 100, Keep::Linearizations).unwrap();
    // x − y at an observed step, for the component 2j
    let departure = |k: usize, j: usize| {
        let noise = (12.9898 * (k * n + j) as f64).sin();
        trajectory.state(k)[2 * j] - truth.state(k)[2 * j] - noise
    };
    let observed = |k: usize| k > 0 && k.is_multiple_of(10);
    let mut cost: f64 = x0.iter().zip(&background).map(|(x, b)| 0.5 * (x - b).powi(2) / 0.25).sum();
    for k in (0..=100).filter(|k| observed(*k)) {
        cost += (0..n / 2).map(|j| 0.5 * departure(k, j).powi(2)).sum::<f64>();
    }
    let mut gradient = vec![0.0; n];
    let mut sweep = trajectory.clone();
    let swept = sweep.adjoint(&mut model, &mut gradient, &mut |k, _, lambda| {
        if observed(k) {
            (0..n / 2).for_each(|j| lambda[2 * j] += departure(k, j));
        }
    });
    swept.unwrap();
    for ((g, x), b) in gradient.iter_mut().zip(&x0).zip(&background) {
        *g += (x - b) / 0.25;
    }
    (cost, gradient)
}

#[test]
fn lorenz96_matches_the_reference_numbers() {
    for (n, cost, norm, first) in [
        (40, 388.6557570224758, 2499.876979576174, Some(-248.04375322925)),
        (1000, 6131.583457861555, 11107.61576870228, None),
    ] {
        let (j, g) = cost_and_gradient(n);
        let size = g.iter().map(|g| g * g).sum::<f64>().sqrt();
        // another program, another order of summation: rounding grown by 100 steps of a chaotic model
        assert!((j / cost - 1.0).abs() <= 1e-11, "{j} {cost}");
        assert!((size / norm - 1.0).abs() <= 1e-11, "{size} {norm}");
        if let Some(first) = first {
            assert!((g[0] / first - 1.0).abs() <= 1e-11, "{} {first}", g[0]);
        }
    }
}

fn conforms(model: &mut dyn Model, x: &[f64]) {
    let scale = vec![0.1; x.len()];
    for outcome in check::conformance(model, 3, x, &scale, 7).unwrap() {
        assert!(outcome.pass, "{outcome:?}");
    }
    let window = check::window(model, x, 40, &scale, 11).unwrap();
    assert!(window.pass, "{window:?}");
}

#[test]
fn every_ready_made_step_conforms() {
    let x: Vec<f64> = (0..8).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
    conforms(&mut Rk4::new(Lorenz63::default(), 0, 0.01), &x[..3]);
    conforms(&mut Rk4::new(Lorenz96::new(8, 8.0), 5, 0.02), &x);
    conforms(&mut Rk4::new(Lorenz96::new(4, 8.0), 5, 0.02), &x[..4]);
    conforms(&mut ImplicitModel::new(OneLeg::implicit_euler(Lorenz63::default(), 1e-11), 0, 0.01), &x[..3]);
    conforms(
        &mut ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz63::default(), 1e-11), 0, 0.01),
        &x[..3],
    );
    conforms(&mut ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(8, 8.0), 1e-11), 0, 0.02), &x);
    // large enough for the blocked dense factorization
    let x: Vec<f64> = (0..40).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
    conforms(&mut ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(40, 8.0), 1e-11), 0, 0.02), &x);
}

#[test]
fn steps_have_their_order_of_accuracy() {
    let x0 = [1.0, 3.0, 20.0];
    let end = |model: &mut dyn Model, steps: usize| {
        let mut trajectory = Trajectory::new();
        trajectory.run(model, &x0, steps, Keep::States).unwrap();
        trajectory.state(steps).to_vec()
    };
    let reference = end(&mut Rk4::new(Lorenz63::default(), 0, 0.5 / 20_000.0), 20_000);
    let error = |order: u32, steps: usize| {
        let length = 0.5 / steps as f64;
        let rhs = Lorenz63::default();
        let x = match order {
            1 => end(&mut ImplicitModel::new(OneLeg::implicit_euler(rhs, 1e-11), 0, length), steps),
            2 => end(&mut ImplicitModel::new(OneLeg::implicit_midpoint(rhs, 1e-11), 0, length), steps),
            _ => end(&mut Rk4::new(rhs, 0, length), steps),
        };
        x.iter().zip(&reference).map(|(x, r)| (x - r).powi(2)).sum::<f64>().sqrt()
    };
    for (order, steps) in [(1, 4000), (2, 1000), (4, 400)] {
        let fitted = (error(order, steps) / error(order, 2 * steps)).log2();
        assert!((fitted - f64::from(order)).abs() <= 0.05, "order {order}: {fitted}");
    }
}
