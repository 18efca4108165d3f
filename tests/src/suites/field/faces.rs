//! Clamps at their faces: deflections, frequencies and reactions of the free length, at second order.

use super::common::{greatest, slope};
use crate::row::{Case, Outcome, Rows};
use std::sync::Arc;
use varda_implicit::{ImplicitModel, Model};
use varda_rod::{
    Clamp, ClampAt, Damping, Framed, Loads, Marker, Markers, Rest, Rod, RodStep, Search, Section, Supports,
    Vector3, derivatives, equilibrium, modes, rest, straight_guess,
};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// EI = 1 N m², 1 kg/m, EA L²/EI = 1e8.
const BEAM: Section = Section { ea: 1e8, ei1: 1.0, ei2: 1.0, gj: 0.7, mass_per_length: 1.0 };
/// Load of a cantilever (P L²/EI, w L³/EI): deflections are linear in it to its square.
const SMALL: f64 = 1e-3;

pub(super) fn run(rows: &mut Rows, quick: bool) {
    rows.area("clamp at its face");
    rows.reason("second order of the mesh");
    for at in [ClampAt::Face, ClampAt::Edge] {
        rows.case(&format!("cantilever, {at:?}"), |case| cantilever(case, at));
    }
    rows.case("frequencies", frequencies);
    for n in if quick { vec![7] } else { vec![2, 3, 7, 40, 400] } {
        rows.case(&format!("weight, {n} segments"), |case| weight(case, n));
    }
    rows.case("mass and marker on the held edge", on_the_held_edge);
    rows.case("two segments", two_segments);
    rows.case("twisted between faces", twisted);
    rows.case("naturally curved", naturally_curved);
    rows.case("segments that differ", differing);
    rows.case("at rest in motion", at_rest_in_motion);
}

fn clamp(at: ClampAt, x: f64) -> Clamp {
    Clamp::new(at, [x, 0.0, 0.0], Vector3::x(), Vector3::z())
}

fn faces(at: ClampAt) -> [bool; 2] {
    [at == ClampAt::Face, false]
}

/// How far the tip of a cantilever sinks: under its weight, under a force at the tip.
fn sinks(rod: &Rod, at: ClampAt) -> Result<[f64; 2]> {
    let supports = Supports::clamped_start(clamp(at, 0.0));
    let guess = straight_guess(rod, &supports, 0.0, Vector3::x())?;
    let down = Vector3::new(0.0, 0.0, -SMALL);
    let own = Loads { gravity: down, ..Loads::default() };
    let tip = Loads { point_forces: vec![(rod.length(), Arc::new(down))], ..Loads::default() };
    let mut found = [0.0; 2];
    for (z, loads) in found.iter_mut().zip([own, tip]) {
        *z = -equilibrium(rod, &supports, &loads, 0.0, &guess)?.0.vertices[rod.segments()].z;
    }
    Ok(found)
}

/// w L⁴/8 EI and P L³/3 EI (Euler and Bernoulli's beam).
fn cantilever(case: &mut Case, at: ClampAt) -> Outcome {
    let meshes = [20, 40, 80];
    let mut errors = [Vec::new(), Vec::new()];
    for n in meshes {
        let z = sinks(&Rod::uniform_between(1.0, n, &BEAM, faces(at))?, at)?;
        for (errors, (z, of)) in errors.iter_mut().zip(z.into_iter().zip([8.0, 3.0])) {
            errors.push((1.0 / n as f64, z * of / SMALL - 1.0));
        }
    }
    for (errors, what) in errors.iter().zip(["under its weight", "force at the tip"]) {
        let found = errors[0].1;
        match at {
            ClampAt::Face => case.at_most(&format!("{what}, 20 segments"), found.abs(), 1.5e-3, "-"),
            // the paper's clamp: half a segment of the length does not bend
            ClampAt::Edge => case.at_most(&format!("{what}, 20 segments"), (found + 0.085).abs(), 0.02, "-"),
        }
        .computed(found);
        let (order, fitted) = (if at == ClampAt::Face { 2.0 } else { 1.0 }, slope(errors));
        case.at_most(&format!("{what}, order"), (fitted - order).abs(), 0.1, "-").computed(fitted);
    }
    Ok(())
}

/// The first three bending frequencies of a cantilever, in √(EI/ρA)/L².
fn bending_frequencies(n: usize) -> Result<[f64; 3]> {
    let rod = Rod::uniform_between(1.0, n, &BEAM, [true, false])?;
    let vertices: Vec<_> = rod.arc_lengths().into_iter().map(|s| Vector3::x() * s).collect();
    let (directors, zero) = (vec![Vector3::z(); n], vec![0.0; n]);
    let framed =
        Framed { vertices: &vertices, directors: &directors, reference_twist: &zero[1..], theta: &zero };
    let hessian = derivatives(&rod, &framed)?.hessian;
    let (free, full) = (n - 1, 4 * n + 3);
    let mut matrix = vec![0.0; free * free];
    for i in 0..free {
        for j in 0..free {
            let k = hessian[3 * (i + 2) + 2 + full * (3 * (j + 2) + 2)];
            matrix[i + free * j] = k / (rod.masses[i + 2] * rod.masses[j + 2]).sqrt();
        }
    }
    let squares = varda_linalg::eigenvalues(free, &matrix)?;
    Ok([0, 1, 2].map(|i| squares[i].sqrt()))
}

/// (β L)² of cos βL cosh βL = −1 (Euler and Bernoulli's beam).
fn frequencies(case: &mut Case) -> Outcome {
    let exact = [3.516015, 22.034492, 61.697214];
    let meshes = [20, 30, 60, 120];
    let mut found = Vec::new();
    for n in meshes {
        found.push(bending_frequencies(n)?);
    }
    let rod = Rod::uniform_between(1.0, meshes[0], &BEAM, [true, false])?;
    let supports = Supports::clamped_start(clamp(ClampAt::Face, 0.0));
    let straight = straight_guess(&rod, &supports, 0.0, Vector3::x())?;
    let by_modes = modes(&rod, &supports, &Loads::default(), 0.0, &straight, 6)?;
    let error = |mesh: usize, mode: usize| (found[mesh][mode] / exact[mode] - 1.0).abs();
    case.at_most("first, 20 segments", error(0, 0), 3e-3, "-").computed(found[0][0]);
    for mode in 0..3 {
        let name = mode + 1;
        // in pairs, one in either plane
        let found_by_modes = by_modes.modes[2 * mode].omega_squared.sqrt();
        let off = (found_by_modes / found[0][mode] - 1.0).abs();
        case.at_most(&format!("mode {name} by `modes`"), off, 1e-6, "-")
            .because("its iteration ends at 1e-8 of a vector; the other is dense");
        case.at_most(&format!("mode {name}, 60 segments"), error(2, mode), 3e-3, "-")
            .computed(found[2][mode]);
        let points: Vec<_> =
            meshes.iter().enumerate().map(|(i, n)| (1.0 / *n as f64, error(i, mode))).collect();
        let fitted = slope(&points);
        case.at_most(&format!("mode {name}, order"), (fitted - 2.0).abs(), 0.1, "-").computed(fitted);
    }
    Ok(())
}

/// All of ρAL hangs on the clamp, and its moment is that about the face.
fn weight(case: &mut Case, n: usize) -> Outcome {
    let length = 0.7;
    let rod = Rod::uniform_between(length, n, &BEAM, [true, false])?;
    let mass: f64 = rod.masses.iter().sum();
    case.at_most("mass", (mass - length).abs() / length, 1e-14, "-").because("rounding of a sum");
    let supports = Supports::clamped_start(clamp(ClampAt::Face, 0.0));
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let loads = Loads { gravity, ..Loads::default() };
    let found = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
    let reaction = &found.reactions[0];
    case.at_most("weight", (reaction.force.z - 9.81 * length).abs(), 1e-7, "N")
        .because("Newton ends at rounding");
    let loads_at = found.rest.vertices.iter().zip(&rod.masses);
    let moment: Vector3<f64> = loads_at.map(|(x, m)| x.cross(&(gravity * *m))).sum();
    case.at_most("moment", (reaction.moment + moment).norm(), 1e-7, "N m").because("Newton ends at rounding");
    // a straight rod: the trapezoidal rule is exact
    let stiff = Rod::uniform_between(length, n, &Section { ei1: 1e6, ei2: 1e6, ..BEAM }, [true, false])?;
    let found = rest(&stiff, &supports, &Loads { gravity, ..Loads::default() }, 0.0, &Search::default())?;
    let exact = 0.5 * 9.81 * length * length;
    let moment = found.reactions[0].moment.norm();
    case.at_most("moment of a stiff rod", (moment / exact - 1.0).abs(), 1e-9, "-").computed(moment);
    Ok(())
}

/// A mass between the face and the first vertex pulls at the clamp with its own arm; a marker there does not
/// move with the rod.
fn on_the_held_edge(case: &mut Case) -> Outcome {
    let mut rod = Rod::uniform_between(1.0, 10, &Section { ei1: 1e7, ei2: 1e7, ..BEAM }, [true, false])?;
    let supports = Supports::clamped_start(clamp(ClampAt::Face, 0.3));
    let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    let bare = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
    let s = 0.3 * rod.rest_lengths[0];
    rod.add_point_mass(s, 2.0)?;
    let found = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
    let more = found.reactions[0].moment - bare.reactions[0].moment;
    case.at_most("moment", (more + Vector3::y() * (2.0 * 9.81 * s)).norm(), 1e-7, "N m")
        .because("Newton's method ends at rounding of EI/L, 1e7 N m");
    let step = RodStep::new(rod, supports, loads, Damping::default())?;
    let mut x = step.control_at_rest(&found.rest);
    x.iter_mut().for_each(|x| *x += 0.01);
    let marker = Marker { s, offset: Vector3::new(0.02, 0.0, 0.0) };
    let mut markers = Markers::new(&step, &[marker])?;
    let mut y = [0.0; 3];
    varda_implicit::ObservationOperator::observe(
        &mut markers,
        varda_implicit::At { step: 0, time: 0.0 },
        &x,
        &mut y,
    )?;
    let place = Vector3::new(0.3 + s, 0.0, 0.02);
    case.at_most("marker", (Vector3::from(y) - place).norm(), 1e-14, "m").because("rounding");
    Ok(())
}

/// The smallest rods: one hinge in the middle of the free length; between two clamps, none.
fn two_segments(case: &mut Case) -> Outcome {
    let [_, tip] = sinks(&Rod::uniform_between(1.0, 2, &BEAM, [true, false])?, ClampAt::Face)?;
    // edge l = L/1.5 on a hinge EI/l: P l · l/EI · l
    let expected = SMALL * (1.0f64 / 1.5).powi(3);
    case.at_most("tip", (tip / expected - 1.0).abs(), 1e-5, "-")
        .computed(tip)
        .because("the square of the load, and Newton's last update of 1e-11 L");
    let both = Supports {
        start: Some(clamp(ClampAt::Face, 0.0)),
        end: Some(clamp(ClampAt::Face, 1.0)),
        ..Supports::default()
    };
    let three = Rod::uniform_between(1.0, 3, &BEAM, [true; 2])?;
    let found = rest(&three, &both, &Loads::default(), 0.0, &Search::default())?;
    let off = found.rest.vertices.iter().zip(three.arc_lengths()).map(|(x, s)| (x - Vector3::x() * s).norm());
    case.at_most("three between faces", off.fold(0.0, greatest), 1e-14, "m")
        .because("straight: nothing to do");
    let refused = rest(&Rod::uniform(1.0, 2, &BEAM)?, &both, &Loads::default(), 0.0, &Search::default());
    let message = refused.err().map(|e| e.to_string()).unwrap_or_default();
    let named = message.contains("between two clamps") && message.contains("at least 3");
    case.at_most("two between faces: an error that says why", f64::from(u8::from(!named)), 0.0, "-")
        .because("each clamp holds one segment")
        .note(message);
    Ok(())
}

/// A straight rod between faces, turned at its end: M = GJ φ/L, whatever the mesh.
fn twisted(case: &mut Case) -> Outcome {
    for n in [4, 25] {
        let rod = Rod::uniform_between(1.0, n, &BEAM, [true; 2])?;
        let turn = 2.0f64;
        let director = [0.0, -turn.sin(), turn.cos()];
        let end = Clamp::new(ClampAt::Face, [1.0, 0.0, 0.0], Vector3::x(), director);
        let supports =
            Supports { start: Some(clamp(ClampAt::Face, 0.0)), end: Some(end), ..Supports::default() };
        let search = Search::default().with_end_turn(turn);
        let found = rest(&rod, &supports, &Loads::default(), 0.0, &search)?;
        let moment = found.reactions[1].moment.x;
        case.at_most(&format!("moment, {n} segments"), (moment / (BEAM.gj * turn) - 1.0).abs(), 1e-9, "-")
            .computed(moment)
            .because("twist is linear along it: Newton's method ends at rounding");
    }
    Ok(())
}

/// A free rod that is naturally curved leaves its clamp as an arc of its circle.
fn naturally_curved(case: &mut Case) -> Outcome {
    let supports = Supports::clamped_start(clamp(ClampAt::Face, 0.0));
    let mut errors = Vec::new();
    for n in [20, 40, 80] {
        let k = 2.0f64;
        let rod = Rod::uniform_between(1.0, n, &BEAM, [true, false])?.naturally([k, 0.0], 0.0);
        let found = rest(&rod, &supports, &Loads::default(), 0.0, &Search::default())?;
        let tip = Vector3::new(k.sin() / k, 0.0, (1.0 - k.cos()) / k);
        errors.push((1.0 / n as f64, (found.rest.vertices[n] - tip).norm()));
        // the same from points measured on the circle
        let points: Vec<_> = (0..=200).map(|i| f64::from(i) / 200.0 * k).collect();
        let points: Vec<_> =
            points.iter().map(|a| Vector3::new(a.sin() / k, 0.0, (1.0 - a.cos()) / k)).collect();
        let straight = Rod::uniform_between(1.0, n, &BEAM, [true, false])?;
        let measured = Rest::through(&straight, &points)?;
        let measured = straight.at_ease_in(&measured.vertices, Vector3::z())?;
        let found = rest(&measured, &supports, &Loads::default(), 0.0, &Search::default())?;
        if n == 80 {
            let off = (found.rest.vertices[n] - tip).norm();
            case.at_most("tip of a measured shape, 80 segments", off, 5e-4, "m");
        }
    }
    case.at_most("tip, 80 segments", errors[2].1, 2e-4, "m");
    let fitted = slope(&errors);
    case.at_most("tip, order", (fitted - 2.0).abs(), 0.1, "-").computed(fitted);
    Ok(())
}

/// Segments that grow smoothly from the clamp, threefold to the tip: second order too.
fn differing(case: &mut Case) -> Outcome {
    let mut errors = Vec::new();
    for n in [20, 40, 80] {
        // edges of size 1 + 2u; half of the first
        let mut lengths: Vec<f64> = (0..n).map(|i| 1.0 + 2.0 * i as f64 / n as f64).collect();
        lengths[0] *= 0.5;
        let sum: f64 = lengths.iter().sum();
        lengths.iter_mut().for_each(|l| *l /= sum);
        let [own, tip] = sinks(&Rod::with_segments(&lengths, &BEAM)?, ClampAt::Face)?;
        errors.push((
            1.0 / n as f64,
            greatest((8.0 * own / SMALL - 1.0).abs(), (3.0 * tip / SMALL - 1.0).abs()),
        ));
    }
    case.at_most("80 segments", errors[2].1, 5e-4, "-").computed(errors[2].1);
    let fitted = slope(&errors);
    case.at_most("order", (fitted - 2.0).abs(), 0.15, "-").computed(fitted);
    Ok(())
}

/// The dynamics know the same rod: what is at rest stays at rest, between clamps that go round together.
fn at_rest_in_motion(case: &mut Case) -> Outcome {
    let n = 24;
    let section = Section { ea: 1e4, ei1: 1e-2, ei2: 2e-2, gj: 1e-2, mass_per_length: 0.1 };
    let rod = Rod::uniform_between(1.0, n, &section, [true; 2])?.naturally([0.5, -0.3], 1.0);
    let supports = Supports {
        start: Some(Clamp::new(ClampAt::Face, [0.0; 3], [1.0, 0.2, 0.0], Vector3::z())),
        end: Some(Clamp::new(ClampAt::Face, [0.8, 0.1, -0.1], [1.0, 0.0, 0.5], Vector3::y())),
        ..Supports::default()
    };
    let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    let found = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
    let step = RodStep::new(rod, supports, loads, Damping::default())?;
    let control = step.control_at_rest(&found.rest);
    let mut model = ImplicitModel::new(step.starting_from(&found.rest, 0.0), 0, 1e-3);
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(&control, &mut x)?;
    model.step(0, &x, &mut next)?;
    let free = 3 * (n - 3);
    let moved = x[..free].iter().zip(&next).map(|(a, b)| (a - b).abs()).fold(0.0, greatest);
    case.at_most("moves in a step", moved, 1e-9, "m").because("both end at updates of 1e-11 m");
    Ok(())
}
