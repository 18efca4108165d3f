//! Loads at their extremes: drag at huge speeds and densities, follower forces far beyond buckling, tables
//! that jump.

use super::common::refused;
use super::rod_shapes::{DOT_REASON, DOWN, fixed_clamp, largest, line, section};
use crate::row::Rows;
use problems::rods::{rod_scale, wave};
use std::sync::Arc;
use varda_implicit::{ImplicitModel, Model, check};
use varda_rod::{
    Damping, Drag, Error, FollowerForce, Load, Loads, RecordedMotion, Rest, Rod, RodStep, Search, Supports,
    Vector3, rest,
};

pub(super) fn run(rows: &mut Rows) {
    fast_and_dense(rows);
    far_beyond_buckling(rows);
    jumps(rows);
}

fn of(load: impl Load + 'static) -> Loads {
    Loads { of_motion: vec![Arc::new(load)], ..Loads::default() }
}

/// A free straight rod thrown across itself: a step of backward Euler solves V + a Δt V² = V₀.
fn fast_and_dense(rows: &mut Rows) {
    let all = [1.0, 1e3, 1e6].map(|speed| [1e-3, 1e3, 1e8].map(|density| (speed, density)));
    for (speed, density) in rows.grid("drag", all.concat()) {
        rows.case(&format!("drag at {speed:e} m/s in {density:e} kg/m³"), |case| {
            let rod = Rod::uniform(1.0, 10, &section())?;
            let (drag, dt) = (Drag::of(density, 0.02), 0.01);
            let a = 0.5 * density * 0.02 * drag.normal / section().mass_per_length * dt;
            let vertices = line([0.0; 3], DOWN, &rod.rest_lengths);
            let step = RodStep::new(rod, Supports::default(), of(drag), Damping::default())?;
            let mut z = step.control_at_rest(&Rest { vertices, theta: Vec::new() });
            z[33..].chunks_exact_mut(3).for_each(|v| v[0] = speed);
            let mut model = ImplicitModel::new(step, 0, dt);
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&z, &mut x)?;
            let (mut next, mut v) = (x.clone(), speed);
            for k in 0..5 {
                model.step(k, &x, &mut next)?;
                std::mem::swap(&mut x, &mut next);
                v = 2.0 * v / (1.0 + (1.0 + 4.0 * a * v).sqrt());
            }
            let error = largest(x[33..].chunks_exact(3).map(|w| w[0] - v));
            // of the velocity (x − x_k)/Δt, from places that have gone as far as speed Δt
            let rounding = 1e-15 * (1.0 + speed * dt) / dt * 20.0;
            case.at_most("speed after five steps", error, (1e-11 / dt).max(rounding), "m/s").because(
                "a step ends when an update falls below 1e-11 L; speeds are differences of places over Δt",
            );
            let mut scale = rod_scale(model.step_ref());
            scale[33..].fill(speed.max(1.0));
            let dot = check::window(&mut model, &x, 3, &scale, 2)?;
            case.at_most("dot product of three steps", dot.value, dot.bound, "-").because(DOT_REASON);
            Ok(())
        });
    }
}

/// A column under a follower force that is many times what makes it flutter: straight it is at rest, and bent
/// it goes its way. One that buckles a single segment is refused.
fn far_beyond_buckling(rows: &mut Rows) {
    for times in rows.grid("follower force over 20 EI/L²", [10.0, 30.0, 1e2]) {
        rows.case(&format!("follower force of {times:e} times flutter"), |case| {
            let (rod, supports, loads) = pushed(times)?;
            let shape = rest(&rod, &supports, &loads, 0.0, &Search::default())?.rest;
            let expected = -0.05 - 0.95 * (1.0 - 20.0 * times * section().ei1 / section().ea);
            case.at_most(
                "straight at rest: place of the tip",
                (shape.vertices[20].z - expected).abs(),
                1e-10,
                "m",
            )
            .because("statics end with an update below 1e-11 L");
            let step = RodStep::new(rod, supports, loads, Damping::default())?;
            let mut z = step.control_at_rest(&shape);
            let free = z.len() / 2;
            z[..free].iter_mut().enumerate().for_each(|(i, z)| *z += 1e-4 * wave(i, 5));
            let mut model = ImplicitModel::new(step, 0, 1e-3);
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&z, &mut x)?;
            let scale = rod_scale(model.step_ref());
            let dot = check::window(&mut model, &x, 5, &scale, 2)?;
            case.at_most("dot product of five steps", dot.value, dot.bound, "-").because(DOT_REASON);
            let taylor = check::taylor_step(&mut model, 0, &x, &direction(&scale), &scale)?;
            case.at_most("Taylor slope − 2", (taylor.slope - 2.0).abs(), 0.05, "-")
                .because("a fit over ten halvings");
            Ok(())
        });
    }
    rows.case("follower force of 1e3 times flutter", |case| {
        let (rod, supports, loads) = pushed(1e3)?;
        let found = rest(&rod, &supports, &loads, 0.0, &Search::default());
        refused(case, "half of EA", found, "the Jacobian ∂G/∂u is singular");
        Ok(())
    });
}

/// Clamped, under a follower force of so many times 20 EI/L² against its end.
fn pushed(times: f64) -> Result<(Rod, Supports, Loads), Error> {
    let rod = Rod::uniform(1.0, 20, &section())?;
    let force = -20.0 * times * section().ei1;
    let loads = of(FollowerForce::new(&rod, 1.0, move |_| [0.0, 0.0, force])?);
    Ok((rod, Supports::clamped_start(fixed_clamp()), loads))
}

fn direction(scale: &[f64]) -> Vec<f64> {
    scale.iter().enumerate().map(|(i, s)| s * wave(i, 31)).collect()
}

/// A force that jumps within a nanosecond is, from the next step on, the constant one.
fn jumps(rows: &mut Rows) {
    rows.case("a table that jumps", |case| {
        let rod = Rod::uniform(1.0, 10, &section())?;
        let to = Vector3::new(0.5, 0.2, -0.3);
        let rows = [Vector3::zeros(), Vector3::zeros(), to, to];
        let table = RecordedMotion::through(&[-1.0, 0.0, 1e-9, 1.0], &rows)?;
        let run = |force: FollowerForce| -> Result<Vec<f64>, Box<dyn std::error::Error>> {
            let supports = Supports::clamped_start(fixed_clamp());
            let step = RodStep::new(rod.clone(), supports, of(force), Damping::default())?;
            let vertices = line([0.0; 3], DOWN, &rod.rest_lengths);
            let z = step.control_at_rest(&Rest { vertices, theta: Vec::new() });
            let mut model = ImplicitModel::new(step, 0, 0.01);
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&z, &mut x)?;
            let mut next = x.clone();
            for k in 0..10 {
                model.step(k, &x, &mut next)?;
                std::mem::swap(&mut x, &mut next);
            }
            Ok(x)
        };
        let (a, b) = (run(FollowerForce::new(&rod, 1.0, table)?)?, run(FollowerForce::new(&rod, 1.0, to)?)?);
        let off = largest(a[..27].iter().zip(&b).map(|(a, b)| a - b));
        case.at_most("places after ten steps", off, 1e-11, "m")
            .because("the same forces but for their rounding");
        Ok(())
    });
}
