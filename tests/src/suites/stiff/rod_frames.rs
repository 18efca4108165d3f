//! Frames of rods: many turns between them, and many rounds of a clamp.

use super::rod_shapes::{
    DOT_REASON, DOWN, SILICONE, figures, fixed_clamp, held, largest, line, model, run_from, section, weight,
};
use crate::row::Rows;
use problems::rods::rod_scale;
use std::f64::consts::TAU;
use varda_implicit::{At, Model, ObservationOperator, check};
use varda_rod::{
    Clamp, ClampAt, Framed, Loads, Marker, Markers, Rod, Section, Supports, Vector3, derivatives,
};

pub(super) fn run(rows: &mut Rows) {
    twisted(rows);
    tilt_loop(rows, 100_000);
}

/// Many turns per vertex: τ counts them, E = ½ GJ τ²/l̄ exactly.
fn twisted(rows: &mut Rows) {
    for turns in rows.grid("turns per vertex", [0.5, 1.0, 10.0, 1000.0]) {
        rows.case(&format!("{turns} turns per vertex"), |case| {
            let n = 10;
            let rod = Rod::uniform(1.0, n, &section())?;
            let vertices = line([0.0; 3], DOWN, &rod.rest_lengths);
            let theta: Vec<f64> = (0..n).map(|e| TAU * turns * e as f64).collect();
            let d = derivatives(
                &rod,
                &Framed {
                    vertices: &vertices,
                    directors: &vec![Vector3::x(); n],
                    reference_twist: &vec![0.0; n - 1],
                    theta: &theta,
                },
            )?;
            let expected = 0.5 * rod.gj[0] * (TAU * turns).powi(2) / 0.1 * (n - 1) as f64;
            case.at_most("relative error of the energy", (d.energy.twist / expected - 1.0).abs(), 1e-13, "-")
                .because("nine terms of some ten roundings each");
            // a rod that is naturally so: at rest as it lies
            let natural = Rod::uniform(1.0, n, &Section::ellipse(&SILICONE, 0.012, 0.008))?
                .naturally([0.0; 2], TAU * turns / 0.1);
            let loads = Loads::default();
            let supports = Supports::clamped_start(fixed_clamp());
            let mut model = model(natural, supports, loads, 0.01)?;
            let x = run_from(&mut model, &vertices, 10)?;
            let free = model.step_ref().free_vertices().len();
            let error = largest((0..free).map(|f| x[3 * f + 2] + 0.1 * (f + 2) as f64));
            let work = figures(&mut model, 10, 0.01, &x);
            case.at_most("naturally twisted: moved in ten steps", error, 1e-11, "m")
                .because("a step ends when an update falls below 1e-11 L")
                .work(work);
            let angle =
                x[6 * free..].iter().enumerate().map(|(f, t)| t / (TAU * turns * (f + 1) as f64) - 1.0);
            case.at_most("naturally twisted: relative error of θ", largest(angle), 1e-12, "-")
                .because("ten solves of a tridiagonal system of condition 1e2");
            let scale = rod_scale(model.step_ref());
            let dot = check::window(&mut model, &x, 3, &scale, 4)?;
            case.at_most("dot product of three steps", dot.value, dot.bound, "-").because(DOT_REASON);
            Ok(())
        });
    }
}

/// A clamp that tilts round a cone, again and again: frames stay orthonormal, nothing drifts; and the frame
/// carried along round the cone turns by the solid angle.
fn tilt_loop(rows: &mut Rows, steps: usize) {
    rows.case(&format!("tilt loop, {steps} steps"), |case| {
        let (alpha, per_loop, dt) = (0.4_f64, 100, 0.01);
        let rod = Rod::uniform(0.3, 6, &section())?;
        let omega = TAU / (per_loop as f64 * dt);
        let tangent = move |t: f64| {
            let (s, c) = (omega * t).sin_cos();
            [alpha.sin() * c, alpha.sin() * s, -alpha.cos()]
        };
        let clamp = Clamp::new(ClampAt::Edge, [0.0; 3], tangent, [0.0, 1.0, 0.2]);
        let start = line([0.0; 3], tangent(0.0), &rod.rest_lengths);
        // backward Euler damps the swing: a steady round is reached within a few loops
        let mut model = model(rod, Supports::clamped_start(clamp), weight(), dt)?;
        let tip = |offset: [f64; 3]| Marker { s: 0.28, offset: offset.into() };
        let all = [tip([0.0; 3]), tip([1.0, 0.0, 0.0]), tip([0.0, 1.0, 0.0]), tip([0.0, 0.0, 1.0])];
        let mut markers = Markers::new(model.step_ref(), &all)?;
        let mut x = run_from(&mut model, &start, 0)?;
        let (mut next, mut p, mut worst) = (x.clone(), [0.0; 12], 0.0_f64);
        let mut early = Vec::new();
        for k in 0..steps {
            model.step(k, &x, &mut next)?;
            std::mem::swap(&mut x, &mut next);
            markers
                .observe(At { step: k + 1, time: model.time(k + 1) }, &x, &mut p)
                .map_err(|e| e.to_string())?;
            let axis = |i: usize| -> [f64; 3] { std::array::from_fn(|c| p[3 * i + c] - p[c]) };
            for i in 1..4 {
                for j in 1..=i {
                    let dot: f64 = (0..3).map(|c| axis(i)[c] * axis(j)[c]).sum();
                    worst = worst.max((dot - f64::from(u8::from(i == j))).abs());
                }
            }
            if k + 1 == steps / 2 {
                early = x.clone();
            }
        }
        let work = figures(&mut model, steps, dt, &x);
        case.at_most("frames: departure from orthonormal", worst, 1e-12, "-")
            .because("a frame is made anew from the places at every step, by some twenty roundings an edge")
            .work(work);
        let drift = largest(x.iter().zip(&early).map(|(a, b)| a - b));
        case.at_most("drift from half way to the end", drift, 1e-9, "m, m/s")
            .because("places are solved to 1e-11 L, velocities are differences of them over Δt = 0.01 s");
        Ok(())
    });
    rows.case("holonomy of a tilt loop", |case| {
        let (alpha, pieces) = (0.4_f64, steps);
        let rod = Rod::uniform(0.2, 2, &section())?;
        let supports = Supports {
            prescribed: vec![held(0, [0.0; 3])],
            free_frame: (DOWN.into(), [1.0, 0.0, 0.0].into()),
            ..Supports::default()
        };
        let mut model = model(rod, supports, weight(), 0.01)?;
        let along = |phi: f64| [alpha.sin() * phi.cos(), alpha.sin() * phi.sin(), -alpha.cos()];
        let state = |phi: f64| -> Vec<f64> {
            let t = along(phi);
            let places = (1..=2).flat_map(|v| t.map(|t| 0.1 * v as f64 * t));
            places.chain([0.0; 6]).collect()
        };
        let at = |offset: [f64; 3]| Marker { s: 0.05, offset: offset.into() };
        let mut markers =
            Markers::new(model.step_mut(), &[at([0.0; 3]), at([1.0, 0.0, 0.0]), at([0.0, 1.0, 0.0])])?;
        let (mut turned, mut p, mut dp) = (0.0, [0.0; 9], [0.0; 9]);
        let step = TAU / pieces as f64;
        for i in 0..pieces {
            // midpoint rule over a period of a smooth function
            let phi = step * (i as f64 + 0.5);
            let rate = [-alpha.sin() * phi.sin(), alpha.sin() * phi.cos(), 0.0];
            let dx: Vec<f64> =
                (1..=2).flat_map(|v| rate.map(|r| 0.1 * v as f64 * r)).chain([0.0; 6]).collect();
            let x = state(phi);
            let now = At { step: 0, time: 0.0 };
            markers.observe(now, &x, &mut p).map_err(|e| e.to_string())?;
            markers.tangent(now, &x, &dx, &mut dp);
            turned += step * (0..3).map(|c| (dp[3 + c] - dp[c]) * (p[6 + c] - p[c])).sum::<f64>();
        }
        let solid_angle = TAU * (1.0 - alpha.cos());
        case.at_most(
            "turn of the carried frame − solid angle",
            (turned.abs() - solid_angle).abs(),
            1e-12,
            "rad",
        )
        .because("a sum of as many terms as pieces, each rounded at 1e-17")
        .computed(turned);
        Ok(())
    });
}
