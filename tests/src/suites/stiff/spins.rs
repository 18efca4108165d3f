//! Twist inertia at its extremes: steps from a hundredth of a torsional period's radian to ten thousand.

use super::rod_shapes::{DOT_REASON, largest};
use crate::row::{Case, Outcome, Rows};
use problems::rods::wave;
use std::f64::consts::PI;
use varda_implicit::{ImplicitModel, Interval, Model, Scheme, check};
use varda_rod::{Clamp, ClampAt, Damping, Loads, Rod, RodStep, Section, Supports, Vector3};

const SCHEMES: [Scheme; 3] = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];
const DT: f64 = 1e-3;
const LENGTH: f64 = 0.5;
const SEGMENTS: usize = 10;
const STEPS: usize = 4;

pub(super) fn run(rows: &mut Rows) {
    let all = SCHEMES.map(|scheme| [1e-2, 1.0, 1e2, 1e4].map(|phase| (scheme, phase))).concat();
    for (scheme, phase) in rows.grid("torsion, Δt ω", all.clone()) {
        rows.case(&format!("torsion by {scheme:?}, Δt ω = {phase:e}"), |case| {
            straight(case, scheme, phase)
        });
    }
    for (scheme, phase) in rows.grid("spins in space, Δt ω", all) {
        rows.case(&format!("spins in space by {scheme:?}, Δt ω = {phase:e}"), |case| {
            in_space(case, scheme, phase)
        });
    }
}

/// Clamped at its start, the lowest mode of twist having `phase` radians in a step; a control with zero
/// angles and spins.
fn rod(section: Section, scheme: Scheme, phase: f64) -> Result<(RodStep, Vec<f64>), varda_rod::Error> {
    let rod = Rod::uniform_between(LENGTH, SEGMENTS, &section, [true, false])?;
    let wave_number = 2.0 / cell() * (0.25 * PI * cell() / LENGTH).sin();
    let rod = rod.with_rotary_inertia(section.gj * (wave_number * DT / phase).powi(2));
    let s = rod.arc_lengths();
    let clamp = Clamp::new(ClampAt::Face, Vector3::zeros(), Vector3::x(), Vector3::z());
    let step = RodStep::new(rod, Supports::clamped_start(clamp), Loads::default(), Damping::default())?;
    let step = step.with_scheme(scheme).with_spins_in_control();
    let mut z = vec![0.0; step.control_len()];
    step.free_vertices().iter().enumerate().for_each(|(f, &v)| z[3 * f] = s[v]);
    Ok((step, z))
}

fn cell() -> f64 {
    LENGTH / (SEGMENTS as f64 - 0.5)
}

/// θ and ω of θ̈ = −ω₀²θ after some steps of a scheme.
fn oscillator(scheme: Scheme, omega: f64, steps: usize) -> [f64; 2] {
    let (mut x, mut before) = ([1.0, 0.0], [1.0, 0.0]);
    for k in 0..steps {
        let previous = (k > 0).then_some(DT);
        let stage = scheme.stage(&Interval { index: k, start: DT * k as f64, length: DT, previous });
        let star: [f64; 2] = std::array::from_fn(|i| stage.from[0] * x[i] + stage.from[1] * before[i]);
        let h = stage.length;
        let y = (star[0] + h * star[1]) / (1.0 + (h * omega).powi(2));
        let stage_end = [y, (y - star[0]) / h];
        before = x;
        x = std::array::from_fn(|i| stage.to[0] * stage_end[i] + stage.to[1] * before[i]);
    }
    x
}

/// The lowest mode of the mesh, let go: what the scheme makes of one oscillator.
fn straight(case: &mut Case, scheme: Scheme, phase: f64) -> Outcome {
    let round = Section { ea: 1e4, ei1: 1.0, ei2: 1.0, gj: 8e-4, mass_per_length: 0.1 };
    let (step, mut z) = rod(round, scheme, phase)?;
    let (first, angles) = (6 * step.free_vertices().len(), step.free_angles().len());
    let mode: Vec<f64> = (1..=angles).map(|e| 0.1 * (0.5 * PI * e as f64 * cell() / LENGTH).sin()).collect();
    z[first..first + angles].copy_from_slice(&mode);
    let mut model = ImplicitModel::new(step, 0, DT);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let mut next = x.clone();
    for k in 0..STEPS {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    let [angle, spin] = oscillator(scheme, phase / DT, STEPS);
    let off = |from: usize, factor: f64| largest((0..angles).map(|f| x[from + f] - factor * mode[f]));
    // an update of 1e-11 L is one of θ over the edge's length; a few steps add up
    let tolerance = 4.0 * STEPS as f64 * 1e-11 * LENGTH / cell();
    case.at_most("angles after four steps", off(first, angle), tolerance, "rad")
        .because("a step ends when an update falls below 1e-11 L");
    case.at_most("spins after four steps", off(first + angles, spin), tolerance / DT, "rad/s")
        .because("differences of angles over Δt");
    let places = largest((0..first / 2).map(|i| x[i] - z[i]));
    case.at_most("places", places, 1e-11 * LENGTH, "m").because("a straight rod only twists");
    Ok(())
}

/// Anisotropic and thrown, so that twist, bending and frames depend on each other.
fn in_space(case: &mut Case, scheme: Scheme, phase: f64) -> Outcome {
    let tape = Section { ea: 1e2, ei1: 1e-3, ei2: 2e-3, gj: 8e-4, mass_per_length: 0.1 };
    let (step, mut z) = rod(tape, scheme, phase)?;
    let (n, angles) = (6 * step.free_vertices().len(), step.free_angles().len());
    for i in 0..n {
        z[i] += if i < n / 2 { 2e-3 } else { 1.0 } * wave(i, 4);
    }
    // spins that turn a section by a third of a radian in a step, or in a radian of the oscillation
    let spin = 0.3 / DT * phase.min(1.0);
    for f in 0..angles {
        z[n + f] = 0.2 * wave(f, 5);
        z[n + angles + f] = spin * wave(f, 6);
    }
    let mut model = ImplicitModel::new(step, 0, DT);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let sizes = [(n / 2, 0.01), (n / 2, 1.0), (angles, 0.1), (angles, spin)];
    let mut scale: Vec<f64> = sizes.iter().flat_map(|(count, size)| vec![*size; *count]).collect();
    scale.extend_from_within(..x.len() - scale.len());
    let dot = check::window(&mut model, &x, STEPS, &scale, 2)?;
    case.at_most("dot product of four steps", dot.value, dot.bound, "-").because(DOT_REASON);
    let direction: Vec<f64> = scale.iter().enumerate().map(|(i, s)| s * wave(i, 31)).collect();
    let taylor = check::taylor_step(&mut model, 0, &x, &direction, &scale)?;
    case.at_most("Taylor slope − 2", (taylor.slope - 2.0).abs(), 0.05, "-")
        .because("a fit over ten halvings");
    Ok(())
}
