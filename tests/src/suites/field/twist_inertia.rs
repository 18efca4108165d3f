//! Sections with inertia against a spin about the tangent: frequencies, orders in mesh and time, energy, the
//! massless limit, derivatives.

use super::common::{greatest, slope, state_after};
use crate::row::{Case, Outcome, Rows};
use problems::rods::wave;
use std::f64::consts::PI;
use varda_implicit::{ImplicitModel, Model, Scheme, check};
use varda_rod::{
    Clamp, ClampAt, Damping, Framed, Loads, Rest, Rod, RodStep, Section, Supports, TwistUnknowns, Vector3,
    energy, modes,
};

type Failure = Box<dyn std::error::Error>;

const SCHEMES: [(Scheme, f64); 3] =
    [(Scheme::BackwardEuler, 1.0), (Scheme::Midpoint, 2.0), (Scheme::Bdf2, 2.0)];
/// Bends and stretches little: its slowest motions are twist.
const STIFF: Section = Section { ea: 1e6, ei1: 10.0, ei2: 10.0, gj: 8e-4, mass_per_length: 0.1 };
/// Bends, twists and turns about as fast.
const SOFT: Section = Section { ea: 1e2, ei1: 1e-3, ei2: 2e-3, gj: 8e-4, mass_per_length: 0.1 };
/// ρ(I₁ + I₂) [kg m], a radius of gyration of 14 mm: waves of twist travel at 6.3 m/s.
const ROTARY: f64 = 2e-5;
const LENGTH: f64 = 0.5;

pub(super) fn run(rows: &mut Rows, quick: bool) {
    rows.area("twist inertia");
    let all = [1, 2].map(|ends| [1, 2, 3].map(|mode| (ends, mode))).concat();
    for (ends, mode) in rows.grid("torsional modes", all) {
        let held = if ends == 1 { "one clamp" } else { "two clamps" };
        rows.case(&format!("torsional mode {mode}, {held}"), |case| frequency(case, ends, mode));
    }
    for (scheme, order) in SCHEMES {
        rows.case(&format!("torsional oscillation, {scheme:?}"), |case| oscillation(case, scheme, order));
        rows.case(&format!("motion in space, {scheme:?}"), |case| in_space(case, scheme, order, quick));
        rows.case(&format!("derivatives, {scheme:?}"), |case| derivatives(case, scheme));
    }
    rows.case("energy by the midpoint rule", energy_is_kept);
    for scheme in [Scheme::BackwardEuler, Scheme::Bdf2] {
        rows.case(&format!("massless limit, {scheme:?}"), |case| massless(case, scheme));
    }
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |most, v| greatest(most, v.abs()))
}

fn clamp(x: f64) -> Clamp {
    Clamp::new(ClampAt::Face, [x, 0.0, 0.0], Vector3::x(), Vector3::z())
}

/// A straight rod along x, clamped at its start or at both ends.
fn straight(segments: usize, ends: usize) -> Result<(Rod, Supports), Failure> {
    let rod = Rod::uniform_between(LENGTH, segments, &STIFF, [true, ends == 2])?;
    let end = (ends == 2).then(|| clamp(LENGTH));
    Ok((rod.with_rotary_inertia(ROTARY), Supports { end, ..Supports::clamped_start(clamp(0.0)) }))
}

/// Clamped at one end ω = (2n − 1)π/2L √(GJ/ρ(I₁ + I₂)), at both nπ/L √(…).
fn frequency(case: &mut Case, ends: usize, mode: usize) -> Outcome {
    let half_waves = if ends == 1 { mode as f64 - 0.5 } else { mode as f64 };
    let expected = half_waves * PI / LENGTH * (STIFF.gj / ROTARY).sqrt();
    let mut errors = Vec::new();
    for segments in [20, 40, 80] {
        let (rod, supports) = straight(segments, ends)?;
        let vertices = rod.arc_lengths().iter().map(|s| Vector3::x() * *s).collect();
        let shape = Rest { vertices, theta: vec![0.0; segments] };
        let found = modes(&rod, &supports, &Loads::default(), 0.0, &shape, mode)?;
        let omega = found.modes[mode - 1].omega_squared.sqrt();
        errors.push((rod.rest_lengths[segments / 2], omega / expected - 1.0));
        if segments == 80 {
            case.at_most("ω at 80 segments", (omega / expected - 1.0).abs(), 1e-3, "-")
                .computed(omega)
                .because("(3π/80)²/24 of the third mode");
        }
    }
    let [_, (h, coarse), (l, fine)] = errors[..] else { return Err("three meshes".into()) };
    let limit = (h * h * fine - l * l * coarse) / (h * h - l * l);
    case.at_most("ω extrapolated from 40 and 80", limit.abs(), 2e-6, "-")
        .because("the fourth order, 4 (3π/80)⁴/1920, and a mode converged to 1e-6, squared");
    let order = slope(&errors);
    case.at_most("order in the mesh", (order - 2.0).abs(), 0.02, "-")
        .computed(order)
        .because("a series in even powers of the mesh");
    Ok(())
}

/// The state after a run.
fn end(step: RodStep, z: &[f64], time: f64, steps: usize) -> Result<Vec<f64>, Failure> {
    state_after(step, z, time / steps as f64, steps)
}

/// The lowest mode of the mesh, let go: θ cos ωt and −ω θ sin ωt.
fn oscillation(case: &mut Case, scheme: Scheme, order: f64) -> Outcome {
    let segments = 12;
    let l = LENGTH / (segments as f64 - 0.5);
    let speed = (STIFF.gj / ROTARY).sqrt();
    let omega = 2.0 * speed / l * (0.25 * PI * l / LENGTH).sin();
    let time = 4.0 / omega;
    let mut errors = [Vec::new(), Vec::new()];
    let first = if order == 1.0 { 400 } else { 100 };
    for steps in [first, 2 * first, 4 * first] {
        let (rod, supports) = straight(segments, 1)?;
        let s = rod.arc_lengths();
        let step = RodStep::new(rod, supports, Loads::default(), Damping::default())?;
        let step = step.with_scheme(scheme).with_spins_in_control();
        let (free, angles) = (step.free_vertices().to_vec(), step.free_angles().len());
        let mut z = vec![0.0; step.control_len()];
        free.iter().enumerate().for_each(|(f, &v)| z[3 * f] = s[v]);
        let first_angle = 6 * free.len();
        for f in 0..angles {
            z[first_angle + f] = 0.1 * (0.5 * PI * (f + 1) as f64 * l / LENGTH).sin();
        }
        let x = end(step, &z, time, steps)?;
        let off = |kind: usize, factor: f64| {
            let from = first_angle + kind * angles;
            largest((0..angles).map(|f| x[from + f] - factor * z[first_angle + f])) / factor.abs()
        };
        let (cos, sin) = ((omega * time).cos(), (omega * time).sin());
        let h = time / steps as f64;
        errors[0].push((h, off(0, cos)));
        errors[1].push((h, off(1, -omega * sin)));
    }
    for (what, errors) in ["angles", "spins"].into_iter().zip(&errors) {
        let fitted = slope(errors);
        case.at_most(&format!("{what}: order in time"), (fitted - order).abs(), 0.05, "-")
            .computed(fitted)
            .because("ωΔt from 0.04 down (0.01 at first order)");
    }
    Ok(())
}

/// Curved, anisotropic, clamped at its start, which moves and turns; thrown with speeds, angles and spins.
fn thrown(scheme: Scheme, moving: bool, damping: Damping) -> Result<(RodStep, Vec<f64>), Failure> {
    let segments = 6;
    let rod = Rod::uniform_between(LENGTH, segments, &SOFT, [true, false])?.naturally([1.0, 0.5], 2.0);
    let s = rod.arc_lengths();
    let clamp = match moving {
        true => {
            let place = |t: f64| [20.0 * t * t, 10.0 * t * t, 0.0];
            let tangent = |t: f64| Vector3::new(1.0, 60.0 * t * t, 40.0 * t * t);
            Clamp::new(ClampAt::Face, place, tangent, Vector3::z()).with_turns(|t: f64| 15.0 * t * t)
        }
        false => clamp(0.0),
    };
    let supports = Supports::clamped_start(clamp);
    let step = RodStep::new(rod.with_rotary_inertia(ROTARY), supports, Loads::default(), damping)?;
    let step = step.with_scheme(scheme).with_spins_in_control();
    let (free, angles) = (step.free_vertices().to_vec(), step.free_angles().len());
    let mut z = vec![0.0; step.control_len()];
    let n = 3 * free.len();
    for (f, &v) in free.iter().enumerate() {
        let bent = (0.5 * PI * s[v] / LENGTH).sin().powi(2);
        z[3 * f] = s[v];
        z[n + 3 * f + 1] = 3.0 * bent;
        z[n + 3 * f + 2] = -2.0 * bent * bent;
    }
    for f in 0..angles {
        let mode = (0.5 * PI * (f + 1) as f64 / (angles as f64 + 0.5)).sin();
        z[2 * n + f] = 0.3 * mode;
        z[2 * n + angles + f] = 20.0 * mode;
    }
    Ok((step, z))
}

/// Against the midpoint rule with short steps, extrapolated.
fn in_space(case: &mut Case, scheme: Scheme, order: f64, quick: bool) -> Outcome {
    let time = 0.03;
    let run = |scheme: Scheme, steps: usize| -> Result<Vec<f64>, Failure> {
        let (step, z) = thrown(scheme, true, Damping::default())?;
        let mut x = end(step, &z, time, steps)?;
        x.truncate(z.len());
        Ok(x)
    };
    let finest = if quick { 6400 } else { 12800 };
    let (coarse, fine) = (run(Scheme::Midpoint, finest / 2)?, run(Scheme::Midpoint, finest)?);
    let reference: Vec<f64> = fine.iter().zip(&coarse).map(|(f, c)| f + (f - c) / 3.0).collect();
    let first = if order == 1.0 { finest / 8 } else { finest / 32 };
    let (step, z) = thrown(scheme, true, Damping::default())?;
    let (n, angles) = (3 * step.free_vertices().len(), step.free_angles().len());
    assert_eq!(z.len(), 2 * n + 2 * angles);
    let groups = [("places", 0..n), ("angles", 2 * n..2 * n + angles), ("spins", 2 * n + angles..z.len())];
    let mut errors = [Vec::new(), Vec::new(), Vec::new()];
    for steps in [first, 2 * first, 4 * first] {
        let x = run(scheme, steps)?;
        for (errors, (_, range)) in errors.iter_mut().zip(&groups) {
            let off = largest(range.clone().map(|i| x[i] - reference[i]));
            errors.push((time / steps as f64, off));
        }
    }
    for (errors, (what, _)) in errors.iter().zip(&groups) {
        let fitted = slope(errors);
        let list: Vec<String> = errors.iter().map(|e| format!("{:.2e}", e.1)).collect();
        case.at_most(&format!("{what}: order in time"), (fitted - order).abs(), 0.1, "-")
            .computed(fitted)
            .note(list.join(" "))
            .because(
                "terms of the next order are a tenth at the first point and halve with every further one",
            );
    }
    Ok(())
}

/// ½ Σ m v² + ½ Σ I ω² + E of a rod whose clamp stands, at a state.
fn total_energy(step: &mut RodStep, x: &[f64]) -> Result<f64, Failure> {
    let vertices = step.vertices(0.0, x)?;
    let (free, spinning) = (step.free_vertices().to_vec(), step.free_angles().to_vec());
    let n = step.rod().segments();
    let mut theta = vec![0.0; n];
    let mut kinetic = 0.0;
    for (f, &v) in free.iter().enumerate() {
        let speed = &x[3 * (free.len() + f)..][..3];
        kinetic += 0.5 * step.rod().masses[v] * speed.iter().map(|v| v * v).sum::<f64>();
    }
    for (f, &e) in spinning.iter().enumerate() {
        theta[e] = x[6 * free.len() + f];
        let spin = x[6 * free.len() + spinning.len() + f];
        kinetic += 0.5 * step.rod().spin_inertia[e] * spin * spin;
    }
    // Bishop's frame, from the clamp's director on
    let mut directors = vec![Vector3::z()];
    let tangent = |e: usize| (vertices[e + 1] - vertices[e]).normalize();
    for e in 1..n {
        let (p, q, d) = (tangent(e - 1), tangent(e), directors[e - 1]);
        directors.push(d - (p + q) * (d.dot(&q) / (1.0 + p.dot(&q))));
    }
    let framed = Framed {
        vertices: &vertices,
        directors: &directors,
        reference_twist: &vec![0.0; n - 1],
        theta: &theta,
    };
    Ok(kinetic + energy(step.rod(), &framed, &vertices, &theta)?.total())
}

/// Greatest change of the energy during a run, over the energy.
fn drift(steps: usize, time: f64) -> Result<f64, Failure> {
    let (step, z) = thrown(Scheme::Midpoint, false, Damping::default())?;
    let (mut watch, _) = thrown(Scheme::Midpoint, false, Damping::default())?;
    let mut model = ImplicitModel::new(step, 0, time / steps as f64);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let (mut next, mut worst) = (x.clone(), 0.0_f64);
    let first = total_energy(&mut watch, &x)?;
    for k in 0..steps {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
        worst = worst.max((total_energy(&mut watch, &x)? / first - 1.0).abs());
    }
    Ok(worst)
}

fn energy_is_kept(case: &mut Case) -> Outcome {
    // of a straight rod that only twists, in the linear regime, to rounding: through its amplitude
    let (rod, supports) = straight(12, 1)?;
    let s = rod.arc_lengths();
    let inertia = rod.spin_inertia.clone();
    let step = RodStep::new(rod, supports, Loads::default(), Damping::default())?;
    let step = step.with_scheme(Scheme::Midpoint).with_spins_in_control();
    let (free, angles) = (step.free_vertices().to_vec(), step.free_angles().to_vec());
    let first = 6 * free.len();
    let mut z = vec![0.0; step.control_len()];
    free.iter().enumerate().for_each(|(f, &v)| z[3 * f] = s[v]);
    (first..z.len()).for_each(|i| z[i] = 0.1 * wave(i, 3));
    let l = LENGTH / 11.5;
    let of = |x: &[f64]| {
        let theta = |e: usize| if e == 0 { 0.0 } else { x[first + e - 1] };
        let twist: f64 = angles.iter().map(|&e| 0.5 * STIFF.gj / l * (theta(e) - theta(e - 1)).powi(2)).sum();
        let spins = &x[first + angles.len()..];
        twist + angles.iter().zip(spins).map(|(&e, w)| 0.5 * inertia[e] * w * w).sum::<f64>()
    };
    let x = end(step, &z, 2.0, 1000)?;
    case.at_most("twist alone: change in 1000 steps", (of(&x) / of(&z) - 1.0).abs(), 1e-11, "-")
        .because("quadratic: kept but for the rounding of a thousand solves");
    let time = 0.3;
    let changes: Result<Vec<(f64, f64)>, Failure> =
        [600, 1200, 2400].iter().map(|&n| Ok((time / n as f64, drift(n, time)?))).collect();
    let changes = changes?;
    case.at_most("in space: change within 0.3 s at Δt = 0.125 ms", changes[2].1, 5e-6, "-")
        .because("of second order, measured 6e-7: the energy is not quadratic");
    let order = slope(&changes);
    case.at_most("in space: order of the change", 2.0 - order, 0.2, "-")
        .computed(order)
        .because("three halvings of the step; what grows with time would show as a lower order");
    Ok(())
}

/// As I → 0, at fixed steps, angles and places tend to those of massless twist, in proportion to I.
fn massless(case: &mut Case, scheme: Scheme) -> Outcome {
    let run = |rotary: Option<f64>| -> Result<Vec<f64>, Failure> {
        let rod = Rod::uniform_between(LENGTH, 8, &SOFT, [true, false])?.naturally([0.5, 0.2], 1.0);
        let s = rod.arc_lengths();
        let rod = rotary.map_or_else(|| rod.clone(), |rotary| rod.clone().with_rotary_inertia(rotary));
        let turning = clamp(0.0).with_turns(|t: f64| 2.0 * t * t);
        let supports = Supports::clamped_start(turning);
        let step = RodStep::with_twist(
            rod,
            supports,
            Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() },
            Damping::default(),
            TwistUnknowns::WhereNeeded,
        )?;
        let step = step.with_scheme(scheme);
        let mut z = vec![0.0; step.control_len()];
        step.free_vertices().iter().enumerate().for_each(|(f, &v)| z[3 * f] = s[v]);
        let x = end(step, &z, 0.4, 80)?;
        Ok(x[..6 * 7 + 7].to_vec())
    };
    let quasi_static = run(None)?;
    let mut errors = [Vec::new(), Vec::new()];
    for scale in [1e-3, 1e-4, 1e-5, 1e-9] {
        let x = run(Some(scale * ROTARY))?;
        let off = |range: std::ops::Range<usize>| largest(range.map(|i| x[i] - quasi_static[i]));
        errors[0].push((scale, off(0..21)));
        errors[1].push((scale, off(42..49)));
    }
    for (what, unit, errors) in [("places", "m", &errors[0]), ("angles", "rad", &errors[1])] {
        let order = slope(&errors[..3]);
        case.at_most(&format!("{what}: order in I"), (order - 1.0).abs(), 0.05, "-")
            .computed(order)
            .because("I from 1e-3 to 1e-5 of a usual one");
        case.at_most(&format!("{what}: 1e-9 of a usual I"), errors[3].1, 1e-7, unit)
            .because("1e-4 of the difference at 1e-5, and the ends of 80 steps, 1e-11 L each, amplified");
    }
    Ok(())
}

/// Dot product and Taylor slope of a step within a motion in space, and a wrong entry of either.
fn derivatives(case: &mut Case, scheme: Scheme) -> Outcome {
    let (step, z) = thrown(scheme, true, Damping { stiffness: 0.002, mass: 0.5 })?;
    let (n, angles) = (6 * step.free_vertices().len(), step.free_angles().len());
    let mut model = ImplicitModel::new(step, 0, 2e-3);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let mut next = x.clone();
    for k in 0..3 {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    let sizes = [(n / 2, 0.01), (n / 2, 1.0), (angles, 0.1), (angles, 10.0)];
    let mut scale: Vec<f64> = sizes.iter().flat_map(|(count, size)| vec![*size; *count]).collect();
    scale.extend_from_within(..x.len() - scale.len());
    model.step(3, &x, &mut next)?;
    model.linearize(0, 3, &x, &next)?;
    let dx: Vec<f64> = scale.iter().enumerate().map(|(i, s)| s * wave(i, 1)).collect();
    let lambda: Vec<f64> = scale.iter().enumerate().map(|(i, s)| wave(i, 2) / s).collect();
    let (mut forward, mut backward) = (dx.clone(), lambda.clone());
    model.tangent(0, &mut forward);
    model.adjoint(0, &mut backward);
    let norm = forward.iter().zip(&scale).map(|(v, s)| (v / s).powi(2)).sum::<f64>().sqrt();
    let dot = check::compare(&dx, &forward, &lambda, &backward, norm, [&scale, &scale])?;
    case.at_most("dot product", dot.value, dot.bound, "-").because("50 ε times the condition of the test");
    // an entry of the adjoint that belongs to a spin
    backward[n + angles + 1] *= 1.001;
    let wrong = check::compare(&dx, &forward, &lambda, &backward, norm, [&scale, &scale])?;
    case.at_most("bound over the error of a wrong entry of the adjoint", wrong.bound / wrong.value, 0.1, "-")
        .because("an entry off by a thousandth is far beyond rounding");

    let mut taylor = |forward: &[f64]| -> Result<f64, Failure> {
        let mut errors = Vec::new();
        for h in [1e-2, 5e-3, 2.5e-3] {
            let moved: Vec<f64> = x.iter().zip(&dx).map(|(x, d)| x + h * d).collect();
            let mut to = moved.clone();
            model.step(3, &moved, &mut to)?;
            let left = (0..x.len()).map(|i| (to[i] - next[i] - h * forward[i]) / scale[i]);
            errors.push((h, largest(left)));
        }
        Ok(slope(&errors))
    };
    let right = taylor(&forward)?;
    case.at_most("Taylor slope", (right - 2.0).abs(), 0.1, "-")
        .computed(right)
        .because("three steps of 1e-2 and less of usual sizes");
    forward[n + angles + 1] *= 1.1;
    let wrong = taylor(&forward)?;
    case.at_most("Taylor slope with a wrong entry of the tangent", wrong, 1.5, "-")
        .because("what is left is of first order");
    Ok(())
}
