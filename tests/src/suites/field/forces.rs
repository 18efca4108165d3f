//! Forces within a rod, what its supports exert, and its natural modes, against closed forms.

use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;
use std::f64::consts::PI;
use std::sync::Arc;
use varda_implicit::Scheme;
use varda_rod::{
    Clamp, ClampAt, Damping, Drag, Loads, Rest, Rod, RodStep, Search, Section, Supports, Vector3,
    internal_forces, modes, rest, straight_guess,
};

const GRAVITY: f64 = 9.81;

pub(super) fn run(options: &Options, rows: &mut Rows) {
    rows.area("forces");
    rows.case("a hanging rod", hanging);
    rows.case("a cantilever", cantilever);
    for damping in [0.0, 0.02] {
        rows.case(&format!("swung, strain-rate time {damping} s"), |case| swung(case, damping));
    }
    rows.case("towed through water", towed);
    rows.area("modes");
    let meshes: &[usize] = if options.quick { &[20, 40] } else { &[20, 40, 80, 160] };
    rows.case("hanging chain", |case| order(case, meshes, hanging_chain));
    rows.case("taut string", |case| order(case, meshes, taut_string));
    rows.case("pinned beam", |case| order(case, meshes, pinned_beam));
    rows.case("a column beyond its buckling load", column);
    rows.case("a rod on a hook without weight", free_to_turn);
}

/// EI = GJ = 1e-3 N m², stiff along itself, 0.1 kg/m.
fn section() -> Section {
    Section { ea: 1e5, ei1: 1e-3, ei2: 1e-3, gj: 1e-3, mass_per_length: 0.1 }
}

fn weight() -> Loads {
    Loads { gravity: Vector3::new(0.0, 0.0, -GRAVITY), ..Loads::default() }
}

fn hooks(places: &[(usize, [f64; 3])]) -> Supports {
    let prescribed = places.iter().map(|&(v, x)| (v, Arc::new(x) as Arc<dyn varda_rod::Motion>));
    Supports { prescribed: prescribed.collect(), ..Supports::default() }
}

/// The tension of a hanging rod is the weight below.
fn hanging(case: &mut Case) -> Outcome {
    let rod = Rod::uniform(1.0, 40, &section())?;
    let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], -Vector3::z(), Vector3::x()));
    let found = rest(&rod, &supports, &weight(), 0.0, &Search::default())?;
    let forces = internal_forces(&rod, &supports, &weight(), 0.0, &found.rest)?;
    let below = |e: usize| GRAVITY * rod.masses[e + 1..].iter().sum::<f64>();
    let off = |e: usize| (forces.tension[e] / below(e) - 1.0).abs();
    case.reason("an equilibrium to an update of 1e-11 of the length");
    case.at_most("tension over the weight below, off 1", (1..40).map(off).fold(0.0, f64::max), 1e-6, "-");
    let whole = GRAVITY * rod.masses.iter().sum::<f64>();
    case.at_most(
        "the held edge carries the whole weight, off",
        (forces.tension[0] / whole - 1.0).abs(),
        1e-9,
        "-",
    );
    Ok(())
}

/// A stiff cantilever under its weight: Q = w (L − s), M = w (L − s)²/2.
fn cantilever(case: &mut Case) -> Outcome {
    let section = Section { ei1: 10.0, ei2: 10.0, gj: 10.0, ea: 1e6, ..section() };
    let rod = Rod::uniform(1.0, 100, &section)?;
    let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], Vector3::x(), Vector3::z()));
    let found = rest(&rod, &supports, &weight(), 0.0, &Search::default())?;
    let forces = internal_forces(&rod, &supports, &weight(), 0.0, &found.rest)?;
    let (w, s) = (GRAVITY * 0.1, rod.arc_lengths());
    // m₁ points up, and the rest of the rod pulls down
    let shear = |e: usize| (forces.shear[e][0] + w * (1.0 - 0.5 * (s[e] + s[e + 1]))).abs() / w;
    let moment =
        |v: usize| (forces.bending[v - 1][0].abs() - 0.5 * w * (1.0 - s[v]).powi(2)).abs() / (0.5 * w);
    case.reason("bent by a hundredth, of whose square the linear beam knows nothing; mesh of 100");
    case.at_most("shear, of the weight", (1..100).map(shear).fold(0.0, f64::max), 2e-3, "-");
    case.at_most("bending moment, of that at the clamp", (1..100).map(moment).fold(0.0, f64::max), 2e-3, "-");
    let [fx, _, fz] = forces.reactions[0].force.into();
    case.at_most("the clamp carries the weight, off", (fz / w - 1.0).hypot(fx / w), 1e-9, "-");
    Ok(())
}

/// The impulse of a clamp that swings a rod: what it exerts is the rate of momentum less the weight, in every
/// step of backward Euler.
fn swung(case: &mut Case, damping: f64) -> Outcome {
    let rod = Rod::uniform(1.0, 20, &section())?;
    let motion = |t: f64| [0.2 * (3.0 * t).sin(), 0.1 * (5.0 * t).cos(), 0.0];
    let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, motion, -Vector3::z(), Vector3::x()));
    let guess = straight_guess(&rod, &supports, 0.0, Vector3::x())?;
    let damping = Damping { stiffness: damping, mass: 0.3 };
    let (masses, h) = (rod.masses.clone(), 0.01);
    let make = || RodStep::new(rod.clone(), supports.clone(), weight(), damping);
    let mut step = make()?.with_scheme(Scheme::BackwardEuler);
    let control = step.control_at_rest(&guess);
    let free = step.free_vertices().to_vec();
    let mut model = make()?.model(0, h);
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(&control, &mut x)?;
    let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
    for k in 0..100 {
        model.step(k, &x, &mut next)?;
        let (before, now) = (k as f64 * h, (k + 1) as f64 * h);
        let forces = step.internal_forces(now, &next, (before, &x))?;
        let velocity =
            |state: &[f64], f: usize| Vector3::from_column_slice(&state[3 * (free.len() + f)..][..3]);
        let mut expected = Vector3::zeros();
        for (f, &v) in free.iter().enumerate() {
            let (new, old) = (velocity(&next, f), velocity(&x, f));
            expected += ((new - old) / h + new * damping.mass) * masses[v];
        }
        let at = |t: f64| Vector3::from(motion(t));
        let (ahead, here, behind) = (at(now + h), at(now), at(now - h));
        let held = (ahead - here * 2.0 + behind) / (h * h) + (ahead - behind) / (2.0 * h) * damping.mass;
        expected += held * (masses[0] + masses[1]);
        expected.z += GRAVITY * masses.iter().sum::<f64>();
        worst = worst.max((forces.reactions[0].force - expected).norm());
        largest = largest.max(expected.norm());
        std::mem::swap(&mut x, &mut next);
    }
    case.reason(
        "the balance of momentum of a step, to which Newton's method is solved, is 1e-11 of the length",
    );
    case.at_most("reaction against the rate of momentum", worst / largest, 1e-6, "-");
    Ok(())
}

/// A clamp that tows a stiff rod across itself at constant speed pulls with ½ρ d C_n U² L along the way.
fn towed(case: &mut Case) -> Outcome {
    let section = Section { ei1: 1e3, ei2: 1e3, gj: 1e3, ea: 1e6, ..section() };
    let rod = Rod::uniform(1.0, 20, &section)?;
    let clamp = Clamp::new(ClampAt::Edge, |t: f64| [0.5 * t, 0.0, 0.0], -Vector3::z(), Vector3::x());
    let supports = Supports::clamped_start(clamp);
    let loads = Loads { of_motion: vec![Arc::new(Drag::of(1000.0, 0.01))], ..Loads::default() };
    let guess = straight_guess(&rod, &supports, 0.0, Vector3::x())?;
    let make = || RodStep::new(rod.clone(), supports.clone(), loads.clone(), Damping::default());
    let (mut step, h) = (make()?, 0.05);
    let mut control = step.control_at_rest(&guess);
    let speeds = control.len() / 2;
    control[speeds..].chunks_exact_mut(3).for_each(|v| v[0] = 0.5);
    let mut model = make()?.model(0, h);
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(&control, &mut x)?;
    for k in 0..200 {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    let forces = step.internal_forces(200.0 * h, &x, (199.0 * h, &next))?;
    let expected = 0.5 * 1000.0 * 0.01 * 1.2 * 0.25;
    case.reason("the rod is bent by 2e-4 of its length, and 10 s of backward Euler have brought it to rest");
    case.at_most("pull of the clamp, off", (forces.reactions[0].force.x / expected - 1.0).abs(), 1e-5, "-");
    let moment = forces.reactions[0].moment.y.abs() / (0.5 * expected) - 1.0;
    case.at_most("moment at the clamp, off", moment.abs(), 1e-3, "-");
    Ok(())
}

/// Errors of frequencies on meshes of growing fineness: at second order, and small.
fn order(
    case: &mut Case,
    meshes: &[usize],
    of: fn(usize) -> Result<f64, Box<dyn std::error::Error>>,
) -> Outcome {
    let errors = meshes.iter().map(|&n| of(n)).collect::<Result<Vec<f64>, _>>()?;
    case.reason("second order: 4 from a mesh to one twice as fine, and 0.5 of it for the terms beyond");
    for (pair, n) in errors.windows(2).zip(meshes) {
        case.at_most(
            &format!("error of {n} segments over that of {}, off 4", 2 * n),
            (pair[0] / pair[1] - 4.0).abs(),
            0.5,
            "-",
        );
    }
    case.reason("π² n²/12N² of the third mode of a string, four times that of a beam, at most");
    let last = meshes.len() - 1;
    let bound = 30.0 / (meshes[last] * meshes[last]) as f64;
    case.at_most(&format!("worst of three frequencies, {} segments", meshes[last]), errors[last], bound, "-");
    Ok(())
}

/// The worst relative error of ω² of modes at the places `at`.
fn worst(found: &varda_rod::Modes, at: [usize; 3], omegas: [f64; 3]) -> f64 {
    let off = |(&i, omega): (&usize, &f64)| (found.modes[i].omega_squared.sqrt() / omega - 1.0).abs();
    at.iter().zip(&omegas).map(off).fold(0.0, f64::max)
}

/// ω = ½ j₀ₙ √(g/L), j₀ₙ the zeros of the Bessel function J₀, in both directions.
fn hanging_chain(n: usize) -> Result<f64, Box<dyn std::error::Error>> {
    let rod = Rod::uniform(1.0, n, &Section { ea: 1e7, ei1: 0.0, ei2: 0.0, gj: 0.0, ..section() })?;
    let supports = hooks(&[(0, [0.0; 3])]);
    let found = rest(&rod, &supports, &weight(), 0.0, &Search::default())?;
    let found = modes(&rod, &supports, &weight(), 0.0, &found.rest, 6)?;
    let zeros = [2.404_825_557_695_773, 5.520_078_110_286_311, 8.653_727_912_911_013];
    Ok(worst(&found, [0, 2, 4], zeros.map(|z| 0.5 * z * GRAVITY.sqrt())))
}

/// ω = nπ √(N/ρA)/L, the rod stretched by 1 per cent.
fn taut_string(n: usize) -> Result<f64, Box<dyn std::error::Error>> {
    let section = Section { ea: 1e5, ei1: 0.0, ei2: 0.0, gj: 0.0, ..section() };
    let rod = Rod::uniform(1.0, n, &section)?;
    let supports = hooks(&[(0, [0.0; 3]), (n, [1.01, 0.0, 0.0])]);
    let at_rest = stretched(&rod, 1.01);
    let found = modes(&rod, &supports, &Loads::default(), 0.0, &at_rest, 6)?;
    // mass per stretched length
    let speed = (0.01 * 1e5 / (0.1_f64 / 1.01)).sqrt();
    Ok(worst(&found, [0, 2, 4], [1.0, 2.0, 3.0].map(|k| k * PI * speed / 1.01)))
}

/// ω = (nπ/L)² √(EI/ρA).
fn pinned_beam(n: usize) -> Result<f64, Box<dyn std::error::Error>> {
    let rod = Rod::uniform(1.0, n, &section())?;
    let supports = hooks(&[(0, [0.0; 3]), (n, [1.0, 0.0, 0.0])]);
    let found = modes(&rod, &supports, &Loads::default(), 0.0, &stretched(&rod, 1.0), 6)?;
    let unit = PI * PI * (1e-3_f64 / 0.1).sqrt();
    Ok(worst(&found, [0, 2, 4], [1.0, 4.0, 9.0].map(|k| k * unit)))
}

/// A straight rod along x, its length times `stretch`.
fn stretched(rod: &Rod, stretch: f64) -> Rest {
    let vertices = rod.arc_lengths().iter().map(|s| Vector3::new(stretch * s, 0.0, 0.0)).collect();
    Rest { vertices, theta: vec![0.0; rod.segments()] }
}

/// A pinned column buckles at π² EI/L², in both directions; at 4 times that the second mode follows.
fn column(case: &mut Case) -> Outcome {
    let rod = Rod::uniform(1.0, 40, &section())?;
    for (load, expected) in [(0.97, 0), (1.03, 2), (3.9, 2), (4.1, 4)] {
        let short = 1.0 - load * PI * PI * 1e-3 / 1e5;
        let supports = hooks(&[(0, [0.0; 3]), (40, [short, 0.0, 0.0])]);
        let found = modes(&rod, &supports, &Loads::default(), 0.0, &stretched(&rod, short), 6)?;
        case.count(&format!("modes that grow at {load} of the buckling load"), found.unstable, expected);
        let negative = found.modes.iter().filter(|m| m.omega_squared < 0.0).count();
        case.count("negative ω² among them", negative, expected);
    }
    Ok(())
}

/// A rod on a hook without weight turns freely: two modes of zero frequency, the others of a beam.
fn free_to_turn(case: &mut Case) -> Outcome {
    let rod = Rod::uniform(1.0, 80, &section())?;
    let supports = hooks(&[(0, [0.0; 3])]);
    let found = modes(&rod, &supports, &Loads::default(), 0.0, &stretched(&rod, 1.0), 4)?;
    let first = (15.418_206_f64).powi(2) * 1e-3 / 0.1;
    let free = found.modes.iter().filter(|m| m.omega_squared == 0.0).count();
    case.count("modes that are free", free, 2);
    case.reason("second order in the mesh of 80: a quarter of a per cent");
    let bending = (found.modes[2].omega_squared / first - 1.0).abs();
    case.at_most("first bending of a pinned, free beam", bending, 2.5e-3, "-");
    Ok(())
}
