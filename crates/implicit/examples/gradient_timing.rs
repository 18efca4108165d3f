//! Times a gradient and a Gauss–Newton product of Lorenz 96 through RK4, in plain forward runs.
#![allow(clippy::print_stdout)]

use std::hint::black_box;
use std::time::Instant;

use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{Keep, Rk4, Trajectory};

fn main() {
    println!("{:>6} {:>13} {:>15} {:>14}", "N", "forward [µs]", "gradient / fwd", "product / fwd");
    for n in [40, 1000] {
        let x0: Vec<f64> = (0..n).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
        let mut model = Rk4::new(Lorenz96::new(n, 8.0), 0, 0.01);
        let mut trajectory = Trajectory::new();
        let mut lambda = vec![0.0; n];
        let forward = least(n, || {
            trajectory.run(&mut model, black_box(&x0), 100, Keep::States).expect("a finite run");
        });
        let gradient = least(n, || {
            trajectory.run(&mut model, black_box(&x0), 100, Keep::Linearizations).expect("a finite run");
            trajectory
                .adjoint(&mut model, &mut lambda, &mut |k, _, lambda| lambda[0] += k as f64)
                .expect("no step runs again");
        });
        let product = least(n, || {
            lambda.copy_from_slice(black_box(&x0));
            trajectory.tangent(&mut model, &mut lambda, &mut |_, _, _| {}).expect("no step runs again");
            trajectory
                .adjoint(&mut model, &mut lambda, &mut |k, _, lambda| lambda[0] += k as f64)
                .expect("no step runs again");
        });
        println!("{n:>6} {forward:>13.2} {:>15.2} {:>14.2}", gradient / forward, product / forward);
    }
}

/// Least over batches of the time of one call [µs].
fn least(n: usize, mut call: impl FnMut()) -> f64 {
    let repeats = 8_000 / n + 1;
    let batch = |_| {
        let start = Instant::now();
        (0..repeats).for_each(|_| call());
        start.elapsed().as_secs_f64() * 1e6 / repeats as f64
    };
    (0..51).map(batch).fold(f64::INFINITY, f64::min)
}
