//! Transport along a line: Fourier modes, the Cole–Hopf solution, conservation, conformance, one answer in
//! every layout.

use std::f64::consts::TAU;

use varda_implicit::line::{Ends, Line, Transport};
use varda_implicit::{ImplicitModel, Keep, Model, OneLeg, Rhs, Rk4, Structure, Trajectory, check};

const SPEED: f64 = 0.7;
const DIFFUSIVITY: f64 = 0.01;

fn periodic(points: usize) -> Line {
    Line { points, length: 1.0, ends: Ends::Periodic }
}

fn sampled(line: &Line, u: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..line.points).map(|i| u(line.position(i))).collect()
}

fn end(model: &mut dyn Model, u0: &[f64], steps: usize) -> Vec<f64> {
    let mut trajectory = Trajectory::new();
    trajectory.run(model, u0, steps, Keep::States).unwrap();
    trajectory.state(steps).to_vec()
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// The three integrators with their orders.
fn integrator(order: u32, rhs: Transport, length: f64) -> Box<dyn Model> {
    match order {
        1 => Box::new(ImplicitModel::new(OneLeg::implicit_euler(rhs, 1e-12), 0, length)),
        2 => Box::new(ImplicitModel::new(OneLeg::implicit_midpoint(rhs, 1e-12), 0, length)),
        _ => Box::new(Rk4::new(rhs, 0, length)),
    }
}

/// u = e^{−ν κ² t} cos κ(s − ct), κ = 2π m/L.
fn fourier(mode: f64, t: f64) -> impl Fn(f64) -> f64 {
    let wave = TAU * mode;
    move |s| (-DIFFUSIVITY * wave * wave * t).exp() * (wave * (s - SPEED * t)).cos()
}

#[test]
fn space_is_of_second_order_against_the_exact_fourier_solution() {
    let error = |points: usize| {
        let line = periodic(points);
        // steps so short that RK4 adds nothing: 1e-3⁴ times the sixth power of a frequency near 10/s
        let mut model = Rk4::new(Transport::advection_diffusion(line, SPEED, DIFFUSIVITY), 0, 1e-3);
        let u = end(&mut model, &sampled(&line, fourier(2.0, 0.0)), 500);
        distance(&u, &sampled(&line, fourier(2.0, 0.5)))
    };
    let fitted = (error(64) / error(128)).log2();
    assert!((fitted - 2.0).abs() <= 0.05, "{fitted}");
}

/// The semi-discrete solution of a mode: every mode of the grid has the rate −i c sin(κh)/h − 2ν (1 −
/// cos κh)/h².
fn semi_discrete(line: &Line, mode: f64, t: f64) -> Vec<f64> {
    let (wave, h) = (TAU * mode, line.spacing());
    let damping = 2.0 * DIFFUSIVITY * (1.0 - (wave * h).cos()) / (h * h);
    let frequency = SPEED * (wave * h).sin() / h;
    sampled(line, |s| (-damping * t).exp() * (wave * s - frequency * t).cos())
}

#[test]
fn time_has_the_order_of_the_integrator_against_the_exact_rates_of_the_grid() {
    let line = periodic(32);
    let rhs = Transport::advection_diffusion(line, SPEED, DIFFUSIVITY);
    for (order, steps) in [(1, 800), (2, 100), (4, 25)] {
        let error = |steps: usize| {
            let u =
                end(&mut *integrator(order, rhs, 0.5 / steps as f64), &semi_discrete(&line, 2.0, 0.0), steps);
            distance(&u, &semi_discrete(&line, 2.0, 0.5))
        };
        let fitted = (error(steps) / error(2 * steps)).log2();
        assert!((fitted - f64::from(order)).abs() <= 0.05, "order {order}: {fitted}");
    }
}

/// The closed form of Burgers' equation by Cole (1951) and Hopf (1950): u = −2ν φ′/φ, φ = 1 + ¾
/// e^{−ν κ² t} cos κs, κ = 2π. It vanishes at s = 0 and s = ½.
fn cole_hopf(viscosity: f64, t: f64) -> impl Fn(f64) -> f64 {
    let wave = 0.75 * (-viscosity * TAU * TAU * t).exp();
    move |s| 2.0 * viscosity * TAU * wave * (TAU * s).sin() / (1.0 + wave * (TAU * s).cos())
}

#[test]
fn burgers_converges_to_the_cole_hopf_solution() {
    let viscosity = 0.1;
    for ends in [Ends::Periodic, Ends::Fixed { left: 0.0, right: 0.0 }] {
        // halving h and Δt together: what is left is the order of both for the midpoint rule, that of time
        // for Euler
        for (order, finest) in [(2, 80), (1, 160)] {
            let error = |cells: usize| {
                let line = match ends {
                    Ends::Periodic => periodic(cells),
                    Ends::Fixed { .. } => Line { points: cells - 1, length: 0.5, ends },
                };
                let rhs = Transport::burgers(line, viscosity);
                let steps = if order == 2 { cells / 4 } else { cells / 4 * cells / 40 };
                let u = end(
                    &mut *integrator(order, rhs, 0.25 / steps as f64),
                    &sampled(&line, cole_hopf(viscosity, 0.0)),
                    steps,
                );
                distance(&u, &sampled(&line, cole_hopf(viscosity, 0.25)))
            };
            // Euler's steps shrink with h², so that it too gains a factor of four
            let fitted = (error(finest) / error(2 * finest)).log2();
            assert!((fitted - 2.0).abs() <= 0.05, "{ends:?}, order {order}: {fitted}");
        }
    }
}

#[test]
fn a_front_between_fixed_ends_stands() {
    // u = −A tanh(A (s − ½)/2ν) is steady; its ends are not zero
    let (viscosity, height) = (0.05, 1.0);
    let front = |s: f64| -height * (height * (s - 0.5) / (2.0 * viscosity)).tanh();
    let error = |points: usize| {
        let line = Line { points, length: 1.0, ends: Ends::Fixed { left: front(0.0), right: front(1.0) } };
        let u0 = sampled(&line, front);
        let u = end(&mut *integrator(1, Transport::burgers(line, viscosity), 0.5), &u0, 100);
        distance(&u, &u0)
    };
    let fitted = (error(99) / error(199)).log2();
    assert!((fitted - 2.0).abs() <= 0.05, "{fitted}");
}

#[test]
fn transport_without_viscosity_keeps_sum_and_energy() {
    let line = periodic(50);
    let u0 = sampled(&line, |s| 0.3 + (TAU * s).sin());
    let step = OneLeg::implicit_midpoint(Transport::burgers(line, 0.0), 1e-13);
    // long after the front has formed at 1/2π s
    let u = end(&mut ImplicitModel::new(step, 0, 0.01), &u0, 100);
    let sum = |u: &[f64]| u.iter().sum::<f64>();
    let energy = |u: &[f64]| u.iter().map(|u| u * u).sum::<f64>();
    // the midpoint rule keeps what is quadratic; a hundred steps of rounding in sums of fifty terms near one
    assert!((sum(&u) - sum(&u0)).abs() <= 1e-11, "{}", sum(&u) - sum(&u0));
    assert!((energy(&u) - energy(&u0)).abs() <= 1e-11, "{}", energy(&u) - energy(&u0));
    assert!(distance(&u, &u0) > 0.5);
}

/// The values of ∂f/∂x as a full matrix, row by row.
fn jacobian(rhs: &mut Transport, u: &[f64]) -> Vec<f64> {
    let n = u.len();
    let structure = rhs.structure();
    let mut values = vec![f64::NAN; 3 * n];
    assert!(rhs.jacobian(0.0, u, &mut values));
    let mut full = vec![0.0; n * n];
    match structure {
        Structure::Sparse { columns, rows } => {
            for j in 0..n {
                (columns[j]..columns[j + 1]).for_each(|p| full[rows[p] * n + j] = values[p]);
            }
        }
        Structure::Band { half_bandwidth: 1 } => {
            for (p, v) in values.into_iter().enumerate() {
                let (i, j) = (p / 3, p / 3 + p % 3);
                if (1..=n).contains(&j) {
                    full[i * n + j - 1] = v;
                } else {
                    assert_eq!(v, 0.0);
                }
            }
        }
        other => panic!("{other:?}"),
    }
    full
}

#[test]
fn every_line_conforms_through_every_integrator() {
    for ends in [Ends::Periodic, Ends::Fixed { left: 0.4, right: -0.9 }] {
        for points in [3, 4, 30] {
            let line = Line { points, length: 1.0, ends };
            let u = sampled(&line, |s| 0.2 + (TAU * s).sin() + 0.3 * (3.0 * TAU * s).cos());
            for mut rhs in
                [Transport::advection_diffusion(line, SPEED, DIFFUSIVITY), Transport::burgers(line, 0.02)]
            {
                let full = jacobian(&mut rhs, &u);
                let mut column = vec![0.0; points];
                for j in 0..points {
                    let mut unit = vec![0.0; points];
                    unit[j] = 1.0;
                    rhs.tangent(0.0, &u, &unit, &mut column);
                    assert!((0..points).all(|i| full[i * points + j] == column[i]), "{ends:?} {points} {j}");
                }
                let scale = vec![0.1; points];
                for order in [1, 2, 4] {
                    let mut model = integrator(order, rhs, 0.01);
                    for outcome in check::conformance(&mut *model, 2, &u, &scale, 3).unwrap() {
                        assert!(outcome.pass, "{ends:?} {points} order {order}: {outcome:?}");
                    }
                    let window = check::window(&mut *model, &u, 30, &scale, 5).unwrap();
                    assert!(window.pass, "{ends:?} {points} order {order}: {window:?}");
                }
            }
        }
    }
}

#[test]
fn the_gradient_of_a_burgers_window_passes_taylor() {
    let line = periodic(64);
    let u0 = sampled(&line, |s| 0.5 + (TAU * s).sin());
    let mut model =
        ImplicitModel::new(OneLeg::implicit_midpoint(Transport::burgers(line, 0.01), 1e-12), 0, 0.01);
    let mut trajectory = Trajectory::new();
    trajectory.run(&mut model, &u0, 40, Keep::Linearizations).unwrap();
    let mut gradient = vec![0.0; 64];
    let swept = trajectory.adjoint(&mut model, &mut gradient, &mut |k, x, lambda| {
        if k == 20 || k == 40 {
            lambda.iter_mut().zip(x).for_each(|(l, u)| *l += u);
        }
    });
    swept.unwrap();
    let direction = sampled(&line, |s| 0.1 * (2.0 * TAU * s).cos());
    let mut cost = |u0: &[f64]| {
        let mut run = Trajectory::new();
        run.run(&mut model, u0, 40, Keep::States)?;
        Ok([20, 40].iter().map(|k| run.state(*k).iter().map(|u| 0.5 * u * u).sum::<f64>()).sum())
    };
    let taylor = check::taylor(&mut cost, &gradient, &u0, &direction).unwrap();
    assert!((taylor.slope - 2.0).abs() <= 0.05, "{taylor:?}");
    // the same test with one gradient value off by a thousandth of the largest
    gradient[10] += 1e-3 * gradient.iter().fold(0.0, |m: f64, g| m.max(g.abs()));
    assert!(!check::taylor(&mut cost, &gradient, &u0, &direction).unwrap().pass);
}

/// The same right-hand side with a dense Jacobian, column by column from its tangent.
struct Dense(Transport);

impl Rhs for Dense {
    fn dim(&self) -> usize {
        self.0.dim()
    }
    fn eval(&mut self, t: f64, u: &[f64], f: &mut [f64]) {
        self.0.eval(t, u, f);
    }
    fn tangent(&mut self, t: f64, u: &[f64], du: &[f64], df: &mut [f64]) {
        self.0.tangent(t, u, du, df);
    }
    fn adjoint_add(&mut self, t: f64, u: &[f64], lambda: &[f64], du: &mut [f64]) {
        self.0.adjoint_add(t, u, lambda, du);
    }
}

#[test]
fn sparse_and_band_give_the_answer_of_dense() {
    // below and above the size from which dense matrices are factored in blocks
    for (ends, points) in [(Ends::Periodic, 20), (Ends::Fixed { left: 0.5, right: -0.3 }, 40)] {
        let line = Line { points, length: 1.0, ends };
        let u0 = sampled(&line, |s| 0.3 + (TAU * s).sin());
        let answer = |model: &mut dyn Model| {
            let mut trajectory = Trajectory::new();
            trajectory.run(model, &u0, 30, Keep::Linearizations).unwrap();
            let mut lambda = vec![0.0; points];
            trajectory.adjoint(model, &mut lambda, &mut |k, _, l| l[k % points] += 1.0).unwrap();
            lambda.extend_from_slice(trajectory.state(30));
            lambda
        };
        let rhs = Transport::burgers(line, 0.02);
        let own = answer(&mut ImplicitModel::new(OneLeg::implicit_midpoint(rhs, 1e-11), 0, 0.02));
        let dense = answer(&mut ImplicitModel::new(OneLeg::implicit_midpoint(Dense(rhs), 1e-11), 0, 0.02));
        // thirty damped steps of well conditioned systems
        assert!(distance(&own, &dense) <= 1e-12, "{ends:?}: {:e}", distance(&own, &dense));
    }
}

/// Between points a smooth field is seen with an error of fourth order, across the seam of a circle as well.
#[test]
fn places_between_points_are_of_fourth_order() {
    let u = |s: f64| (TAU * s).sin() + 0.5 * (2.0 * TAU * s).cos();
    let error = |points: usize| {
        let line = periodic(points);
        let field = sampled(&line, u);
        let seen = |s: f64| line.between(s).0.iter().map(|(i, w)| w * field[*i]).sum::<f64>();
        (0..=1000).map(|i| f64::from(i) / 1000.0).map(|s| (seen(s) - u(s)).abs()).fold(0.0, f64::max)
    };
    let slope = (error(32) / error(64)).log2();
    assert!((slope - 4.0).abs() < 0.1, "{slope}");
    for ends in [Ends::Periodic, Ends::Fixed { left: 1.0, right: 1.0 }] {
        let line = Line { points: 5, length: 2.0, ends };
        for s in [0.0, 0.1, 0.99, 1.0, 1.9, 2.0] {
            let (weights, of_ends) = line.between(s);
            let sum = of_ends + weights.iter().map(|(_, w)| w).sum::<f64>();
            assert!((sum - 1.0).abs() < 1e-14, "a constant is seen as it is, at {s}: {sum}");
        }
        for i in 0..5 {
            assert_eq!(line.between(line.position(i)), (vec![(i, 1.0)], 0.0));
            assert_eq!(line.nearest(line.position(i) + 0.4 * line.spacing()), i);
        }
    }
}
