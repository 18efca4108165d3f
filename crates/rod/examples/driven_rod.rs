//! A rod of 25 segments, driven at its upper end: where its tip is after two seconds, and what a step costs.
#![allow(clippy::print_stdout)]

use std::f64::consts::PI;
use std::time::Instant;

use varda_implicit::{ImplicitModel, Model};
use varda_rod::{Clamp, ClampAt, Damping, Loads, Material, Rod, RodStep, Section, Supports, TwistUnknowns};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let material = Material { youngs_modulus: 1e6, shear_modulus: 1e6 / 3.0, density: 1200.0 };
    for (segments, twist) in [
        (25, TwistUnknowns::WhereNeeded),
        (25, TwistUnknowns::Always),
        (250, TwistUnknowns::WhereNeeded),
        (250, TwistUnknowns::Always),
    ] {
        let rod = Rod::uniform(1.0, segments, &Section::circle(&material, 0.005))?;
        let omega = 2.0 * PI;
        let drive = move |t: f64| [0.10 * (1.0 - (omega * t).cos()), 0.05 * (omega * t).sin(), 0.0];
        let clamp = Clamp::new(ClampAt::Edge, drive, [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
        let loads = Loads { gravity: [0.0, 0.0, -9.81].into(), ..Loads::default() };
        let step =
            RodStep::with_twist(rod, Supports::clamped_start(clamp), loads, Damping::default(), twist)?;

        // Control z = [X₀, V₀]: hanging straight down, at rest.
        let mut z = vec![0.0; step.control_len()];
        for (i, &v) in step.free_vertices().iter().enumerate() {
            z[3 * i + 2] = -(v as f64) / segments as f64;
        }
        let mut model = ImplicitModel::new(step, 0, 0.02);
        let mut best = f64::INFINITY;
        let (mut tip, mut iterations) = (Vec::new(), 0);
        for _ in 0..9 {
            let started = Instant::now();
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&z, &mut x)?;
            let mut next = x.clone();
            for k in 0..100 {
                iterations += model.step(k, &x, &mut next)?.newton_iterations;
                std::mem::swap(&mut x, &mut next);
            }
            best = best.min(started.elapsed().as_secs_f64());
            tip = x[3 * segments - 6..3 * segments - 3].to_vec();
        }
        let iterations = iterations / 9;
        println!(
            "{segments} segments, twist {twist:?}: tip {tip:.6?} m, {:.2} ms for 100 steps, {iterations} \
             iterations, {:.3} µs per segment and iteration",
            1e3 * best,
            1e6 * best / (segments * iterations) as f64
        );
    }
    Ok(())
}
