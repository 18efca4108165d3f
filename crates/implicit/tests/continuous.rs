//! The continuous tangent equation (paper 2.22) and its adjoint (with its minus, run backwards) beside the
//! discrete ones: of the same order as the integrator, and no better.

use varda_implicit::lorenz::Lorenz63;
use varda_implicit::{ImplicitModel, Keep, Model, OneLeg, Rhs, Rk4, Trajectory, check};

const X0: [f64; 3] = [1.0, 3.0, 20.0];
const TIME: f64 = 0.5;

/// Σ a_i b_i.
fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn model(order: u32, steps: usize) -> Box<dyn Model> {
    let (rhs, length) = (Lorenz63::default(), TIME / steps as f64);
    match order {
        1 => Box::new(ImplicitModel::new(OneLeg::implicit_euler(rhs, 1e-12), 0, length)),
        2 => Box::new(ImplicitModel::new(OneLeg::implicit_midpoint(rhs, 1e-12), 0, length)),
        _ => Box::new(Rk4::new(rhs, 0, length)),
    }
}

fn run(order: u32, steps: usize) -> (Box<dyn Model>, Trajectory) {
    let (mut model, mut trajectory) = (model(order, steps), Trajectory::new());
    trajectory.run(&mut *model, &X0, steps, Keep::Linearizations).unwrap();
    (model, trajectory)
}

/// v after one step of length h along v̇ = A(x) v, where `apply` is the product with A at x: by a method of
/// the given order, with x known at both ends and, to fourth order, halfway.
fn one_step(order: u32, h: f64, x: [&[f64]; 2], v: &mut [f64; 3], apply: fn(&[f64], &[f64; 3]) -> [f64; 3]) {
    let moved = |v: &[f64; 3], h: f64, k: &[f64; 3]| std::array::from_fn(|i| v[i] + h * k[i]);
    let mean: [f64; 3] = std::array::from_fn(|i| 0.5 * (x[0][i] + x[1][i]));
    let k1 = apply(x[0], v);
    *v = match order {
        1 => moved(v, h, &k1),
        2 => moved(v, h, &apply(&mean, &moved(v, 0.5 * h, &k1))),
        _ => {
            // the middle of the cubic through both states with both slopes; h is negative on the way back
            let (mut f0, mut f1) = ([0.0; 3], [0.0; 3]);
            Lorenz63::default().eval(0.0, x[0], &mut f0);
            Lorenz63::default().eval(0.0, x[1], &mut f1);
            let middle: [f64; 3] = std::array::from_fn(|i| mean[i] + h / 8.0 * (f0[i] - f1[i]));
            let k2 = apply(&middle, &moved(v, 0.5 * h, &k1));
            let k3 = apply(&middle, &moved(v, 0.5 * h, &k2));
            let k4 = apply(x[1], &moved(v, h, &k3));
            std::array::from_fn(|i| v[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]))
        }
    };
}

/// dδx/dt = ∂f/∂x δx (paper 2.22).
fn continuous_tangent(order: u32, trajectory: &Trajectory, dx: &mut [f64; 3]) {
    let steps = trajectory.steps();
    for k in 0..steps {
        one_step(order, TIME / steps as f64, [trajectory.state(k), trajectory.state(k + 1)], dx, |x, dx| {
            let mut df = [0.0; 3];
            Lorenz63::default().tangent(0.0, x, dx, &mut df);
            df
        });
    }
}

/// dλ/dt = −(∂f/∂x)ᵀ λ, from the end of the window to its start.
fn continuous_adjoint(order: u32, trajectory: &Trajectory, lambda: &mut [f64; 3]) {
    let steps = trajectory.steps();
    for k in (0..steps).rev() {
        one_step(
            order,
            -TIME / steps as f64,
            [trajectory.state(k + 1), trajectory.state(k)],
            lambda,
            |x, l| {
                let mut sum = [0.0; 3];
                Lorenz63::default().adjoint_add(0.0, x, l, &mut sum);
                sum.map(|s| -s)
            },
        );
    }
}

/// The gradient of ½‖x_N‖², discrete and continuous, and their relative distance.
fn gradients(order: u32, steps: usize) -> ([f64; 3], [f64; 3], f64) {
    let (mut model, mut trajectory) = run(order, steps);
    let mut discrete = [0.0; 3];
    let swept = trajectory.adjoint(&mut *model, &mut discrete, &mut |k, x, lambda| {
        if k == steps {
            lambda.copy_from_slice(x);
        }
    });
    swept.unwrap();
    let mut continuous = [0.0; 3];
    continuous.copy_from_slice(trajectory.state(steps));
    continuous_adjoint(order, &trajectory, &mut continuous);
    let apart: [f64; 3] = std::array::from_fn(|i| continuous[i] - discrete[i]);
    (discrete, continuous, (dot(&apart, &apart) / dot(&discrete, &discrete)).sqrt())
}

#[test]
fn the_continuous_adjoint_misses_the_discrete_gradient_by_the_order_of_the_integrator() {
    for (order, steps) in [(1, 4000), (2, 800), (4, 400)] {
        let (coarse, fine) = (gradients(order, steps).2, gradients(order, 2 * steps).2);
        let fitted = (coarse / fine).log2();
        assert!((fitted - f64::from(order)).abs() <= 0.1, "order {order}: {fitted}, {coarse:e} {fine:e}");
    }
}

#[test]
fn only_the_discrete_gradient_passes_taylor() {
    for order in [1, 2, 4] {
        // long steps, that the error of fourth order stands out of the curvature
        let steps = 20;
        let (discrete, continuous, apart) = gradients(order, steps);
        let mut model = model(order, steps);
        let mut trajectory = Trajectory::new();
        let mut cost = |x0: &[f64]| {
            trajectory.run(&mut *model, x0, steps, Keep::States)?;
            Ok(0.5 * trajectory.state(steps).iter().map(|x| x * x).sum::<f64>())
        };
        let direction = [0.1, -0.2, 0.3];
        let right = check::taylor(&mut cost, &discrete, &X0, &direction).unwrap();
        assert!((right.slope - 2.0).abs() <= 0.05, "order {order}: {right:?}");
        let wrong = check::taylor(&mut cost, &continuous, &X0, &direction).unwrap();
        assert!(!wrong.pass, "order {order}: {apart:e} {wrong:?}");
    }
}

#[test]
fn what_the_dot_product_sees_of_the_continuous_pair() {
    let mismatch = |order: u32, steps: usize| {
        let (mut model, trajectory) = run(order, steps);
        let (dx, lambda) = ([0.3, -0.5, 0.8], [0.7, 0.2, -0.4]);
        let (mut forward, mut backward) = (dx, lambda);
        continuous_tangent(order, &trajectory, &mut forward);
        continuous_adjoint(order, &trajectory, &mut backward);
        let discrete = check::dot_product(&mut *model, 0..steps, &[1.0; 3], 1).unwrap();
        assert!(discrete.pass, "{discrete:?}");
        (dot(&forward, &lambda) - dot(&dx, &backward)).abs() / dot(&forward, &lambda).abs()
    };
    for (order, steps) in [(1, 4000), (2, 800)] {
        let (coarse, fine) = (mismatch(order, steps), mismatch(order, 2 * steps));
        let fitted = (coarse / fine).log2();
        assert!((fitted - f64::from(order)).abs() <= 0.1, "order {order}: {fitted}, {coarse:e} {fine:e}");
    }
    // By RK4 the stages read the same backwards, so that this pair is transposed to rounding, and still no
    // derivative of the run: the gradient above is wrong where this test passes.
    let transposed = mismatch(4, 20);
    assert!(transposed <= 1e-14 && gradients(4, 20).2 > 1e-6, "{transposed:e}");
}
