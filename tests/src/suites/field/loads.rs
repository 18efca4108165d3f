//! Moments, follower forces and drag against closed forms.

use super::common::greatest;
use crate::row::{Outcome, Rows};
use crate::suites::Options;
use nalgebra::DMatrix;
use std::f64::consts::TAU;
use std::sync::Arc;
use varda_implicit::{ImplicitModel, Model, Scheme};
use varda_rod::{
    Clamp, ClampAt, Damping, Drag, FollowerForce, Framed, Load, Loads, Moment, RecordedMotion, Rest, Rod,
    RodStep, Search, Section, Supports, Vector3, derivatives, equilibrium, rest, straight_guess,
};

/// EI = GJ = L = ρA = 1, and stiff in stretch.
const BEAM: Section = Section { ea: 1e6, ei1: 1.0, ei2: 1.0, gj: 1.0, mass_per_length: 1.0 };
/// A cable of 5 mm.
const CABLE: Section = Section { ea: 300.0, ei1: 1e-4, ei2: 1e-4, gj: 7e-5, mass_per_length: 0.03 };

type Failure = Box<dyn std::error::Error>;

pub(super) fn run(options: &Options, rows: &mut Rows) {
    rows.area("loads");
    rows.case("a cantilever rolled into a circle", |case| {
        let (coarse, fine) = (circle(20)?, circle(40)?);
        case.at_most("end moment 2π EI/L, 20 segments: tip from the clamp", coarse, 0.06, "L")
            .because("a polygon of 20 sides: second order in the mesh, π/20 squared with a factor of two");
        case.at_most("order of the mesh: 2 − order", 2.0 - (coarse / fine).log2(), 0.1, "-")
            .because("terms of fourth order");
        Ok(())
    });
    rows.case("a moment about the axis", |case| {
        case.at_most("end turned by M L/GJ, relative error", twisted(20)?, 1e-9, "-")
            .because("linear, to the last update of statics; the last edge turns at its middle");
        Ok(())
    });
    rows.case("falling in drag", |case| {
        for (what, along) in [("across", false), ("along", true)] {
            case.at_most(&format!("terminal velocity {what}, relative error"), falling(along)?, 1e-9, "-")
                .because("600 time constants of tanh(t g/v∞)");
        }
        Ok(())
    });
    rows.case("swinging in drag", |case| {
        let (greatest_rise, drop) = swinging()?;
        case.at_most("energy gained in a step, share of the first", greatest_rise, 1e-6, "-")
            .because("midpoint keeps energy but for the strain energy's fourth derivative in a step");
        case.at_most("energy left after 2 s, share of the first", 1.0 - drop, 0.5, "-")
            .because("drag takes most of it in the first swing");
        Ok(())
    });
    rows.case("a follower force in a table", |case| {
        case.at_most("steps of a table and of its function differ", in_a_table()?, 1e-9, "m")
            .because("the same force at all times of a step: Newton's last update, 20 times");
        Ok(())
    });
    rows.case("Beck's column", |case| beck(case, options));
}

/// Distance of the tip from the clamp's face under the end moment 2π EI/L, which grows in ten stages.
fn circle(segments: usize) -> Result<f64, Failure> {
    let (rod, supports) = cantilever(BEAM, segments, ClampAt::Face)?;
    let mut shape = straight_guess(&rod, &supports, 0.0, Vector3::x())?;
    for stage in 1..=10 {
        let moment = Moment::new(&rod, 1.0, [0.0, -TAU * f64::from(stage) / 10.0, 0.0])?;
        shape = equilibrium(&rod, &supports, &of(moment), 0.0, &shape)?.0;
    }
    Ok(shape.vertices[segments].norm())
}

/// |θ_end GJ/(M s) − 1|, s the length from the clamp's face to the middle of the last edge.
fn twisted(segments: usize) -> Result<f64, Failure> {
    let (rod, supports) = cantilever(BEAM, segments, ClampAt::Face)?;
    let found =
        rest(&rod, &supports, &of(Moment::about_tangent(&rod, 1.0, |_| 2.5)?), 0.0, &Search::default())?;
    let middle = 1.0 - 0.5 * rod.rest_lengths[segments - 1];
    Ok((found.rest.theta[segments - 1] / (2.5 * middle) - 1.0).abs())
}

fn of(load: impl Load + 'static) -> Loads {
    Loads { of_motion: vec![Arc::new(load)], ..Loads::default() }
}

/// Along x from the origin, m₁ upwards; one metre beyond the face or the end vertex.
fn cantilever(section: Section, segments: usize, at: ClampAt) -> Result<(Rod, Supports), Failure> {
    let supports = Supports::clamped_start(Clamp::new(at, [0.0; 3], Vector3::x(), Vector3::z()));
    let rod = match at {
        ClampAt::Face => Rod::with_segments(&Rod::equal_segments(1.0, segments, [true, false]), &section)?,
        ClampAt::Edge => Rod::uniform(1.0, segments, &section)?,
    };
    Ok((rod, supports))
}

/// Relative error of the speed of a straight rod that has fallen for long: √(m g/(½ ρ d C)).
fn falling(along: bool) -> Result<f64, Failure> {
    let (rho, d, g) = (1.2, 0.01, 9.81);
    let drag = Drag::of(rho, d);
    let coefficient = if along { drag.tangential } else { drag.normal };
    let terminal = (CABLE.mass_per_length * g / (0.5 * rho * d * coefficient)).sqrt();
    let rod = Rod::uniform(1.0, 10, &CABLE)?;
    let loads = Loads { gravity: [0.0, 0.0, -g].into(), ..of(drag) };
    let step = RodStep::new(rod.clone(), Supports::default(), loads, Damping::default())?;
    let direction = if along { Vector3::z() } else { Vector3::x() };
    let vertices = rod.arc_lengths().iter().map(|s| direction * *s).collect();
    let z = step.control_at_rest(&Rest { vertices, theta: vec![0.0; 10] });
    let dt = 0.5 * terminal / g;
    let mut model = ImplicitModel::new(step, 0, dt);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    advance(&mut model, &mut x, 80)?;
    let velocities = &x[33..66];
    Ok(largest(
        velocities.chunks_exact(3).map(|v| (Vector3::from_column_slice(v) / terminal + Vector3::z()).norm()),
    ))
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |most, v| greatest(v.abs(), most))
}

fn advance<M: Model>(model: &mut M, x: &mut Vec<f64>, steps: usize) -> Outcome {
    let mut next = x.clone();
    for k in 0..steps {
        model.step(k, x, &mut next)?;
        std::mem::swap(x, &mut next);
    }
    Ok(())
}

/// The greatest rise of energy in a step of a cable that swings in water at rest, and how much it lost in 2
/// s, as shares of what there was.
fn swinging() -> Result<(f64, f64), Failure> {
    let (rod, supports) = cantilever(CABLE, 20, ClampAt::Edge)?;
    let loads = Loads { gravity: [0.0, 0.0, -3.0].into(), ..of(Drag::of(1000.0, 0.005)) };
    let step = RodStep::new(rod.clone(), supports.clone(), loads.clone(), Damping::default())?;
    let z = step.control_at_rest(&straight_guess(&rod, &supports, 0.0, Vector3::x())?);
    let mut model = ImplicitModel::new(step.with_scheme(Scheme::Midpoint), 0, 0.002);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let mut lowest =
        equilibrium(&rod, &supports, &loads, 0.0, &straight_guess(&rod, &supports, 0.0, Vector3::x())?)?
            .0
            .vertices;
    let bottom = potential(&rod, &mut lowest)?;
    let mut all = Vec::new();
    for _ in 0..=1000 {
        let mut vertices = model.step_mut().vertices(0.0, &x)?;
        let moving = x[x.len() / 2..].chunks_exact(3).zip(&rod.masses[2..]);
        let kinetic: f64 = moving.map(|(v, m)| 0.5 * m * Vector3::from_column_slice(v).norm_squared()).sum();
        all.push(kinetic + potential(&rod, &mut vertices)? - bottom);
        advance(&mut model, &mut x, 1)?;
    }
    let rise = largest(all.windows(2).map(|e| (e[1] - e[0]).max(0.0))) / all[0];
    Ok((rise, 1.0 - all[1000] / all[0]))
}

/// Elastic energy and that of the weight, of an isotropic rod, for which any directors do.
fn potential(rod: &Rod, vertices: &mut [Vector3<f64>]) -> Result<f64, Failure> {
    let n = rod.segments();
    let across: Vec<_> =
        vertices.windows(2).map(|x| (x[1] - x[0]).cross(&Vector3::new(0.3, 1.0, 0.1))).collect();
    let (zero, theta) = (vec![0.0; n - 1], vec![0.0; n]);
    let at = Framed { vertices, directors: &across, reference_twist: &zero, theta: &theta };
    let weight: f64 = rod.masses.iter().zip(vertices.iter()).map(|(m, x)| 3.0 * m * x.z).sum();
    Ok(derivatives(rod, &at)?.energy.total() + weight)
}

/// A force across and along the tip, from the rows of a table and from the function that they are rows of:
/// how far the tips are apart after 20 steps.
fn in_a_table() -> Result<f64, Failure> {
    let force = |t: f64| Vector3::new(0.002, 0.01 * t, -0.005 + 0.03 * t);
    let times: Vec<f64> = (0..=10).map(|k| 0.03 * f64::from(k)).collect();
    let rows: Vec<_> = times.iter().map(|t| force(*t)).collect();
    let table = RecordedMotion::through(&times, &rows)?;
    let (rod, supports) = cantilever(CABLE, 10, ClampAt::Edge)?;
    let follow = |follower: FollowerForce| -> Result<Vec<f64>, Failure> {
        let step = RodStep::new(rod.clone(), supports.clone(), of(follower), Damping::default())?;
        let z = step.control_at_rest(&straight_guess(&rod, &supports, 0.0, Vector3::x())?);
        let mut model = ImplicitModel::new(step.with_scheme(Scheme::Bdf2), 0, 0.01);
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&z, &mut x)?;
        advance(&mut model, &mut x, 20)?;
        Ok(x[24..27].to_vec())
    };
    let (a, b) =
        (follow(FollowerForce::new(&rod, 1.0, table)?)?, follow(FollowerForce::new(&rod, 1.0, force)?)?);
    if !(a[1].hypot(a[2]) > 1e-3) {
        return Err(format!("the tip has hardly moved: {a:?}").into());
    }
    Ok(largest(a.iter().zip(&b).map(|(a, b)| a - b)))
}

/// A cantilever pushed along its last edge, which flutters at 20.05 EI/L² (Beck 1952), and where strain
/// rates are damped however little at 10.94 EI/L² (Bolotin and Zhinzher 1969).
fn beck(case: &mut crate::row::Case, options: &Options) -> Outcome {
    const MESH: &str = "second order in the mesh, which has 20 segments";
    let undamped = flutter(20, 0.0, [15.0, 25.0], 1e-7)?;
    case.at_most("undamped: flutter at 20.05 EI/L²", (undamped / 20.0510 - 1.0).abs(), 0.01, "-")
        .computed(undamped)
        .because(MESH);
    let damped = flutter(20, 1e-4, [8.0, 15.0], 0.0)?;
    case.at_most("vanishing strain-rate damping: 10.94 EI/L²", (damped / 10.94 - 1.0).abs(), 0.01, "-")
        .computed(damped)
        .because(MESH);
    if !options.quick {
        let fine = flutter(40, 0.0, [15.0, 25.0], 1e-7)?;
        let order = ((undamped / 20.0510 - 1.0) / (fine / 20.0510 - 1.0)).abs().log2();
        case.at_most("undamped: 2 − order of the mesh", 2.0 - order, 0.3, "-")
            .because("20.051 has five digits, the error of 40 segments is a few of the last");
    }
    Ok(())
}

/// The load P \[EI/L²\] between two at which the largest eigenvalue of a step's tangent about the straight
/// rod, across it in one plane, leaves the unit circle by more than `margin`.
fn flutter(
    segments: usize,
    damping: f64,
    [mut low, mut high]: [f64; 2],
    margin: f64,
) -> Result<f64, Failure> {
    let grows =
        |p: f64| -> Result<bool, Failure> { Ok(spectral_radius(segments, damping, p)? > 1.0 + margin) };
    if grows(low)? || !grows(high)? {
        return Err(format!("no onset of flutter between {low} and {high}").into());
    }
    while high - low > 1e-4 {
        let middle = 0.5 * (low + high);
        *(if grows(middle)? { &mut high } else { &mut low }) = middle;
    }
    Ok(0.5 * (low + high))
}

fn spectral_radius(segments: usize, damping: f64, p: f64) -> Result<f64, Failure> {
    let (rod, supports) = cantilever(BEAM, segments, ClampAt::Face)?;
    let loads = of(FollowerForce::tangential(&rod, 1.0, move |_| -p)?);
    let guess = straight_guess(&rod, &supports, 0.0, Vector3::x())?;
    let shape = equilibrium(&rod, &supports, &loads, 0.0, &guess)?.0;
    let damping = Damping { stiffness: damping, mass: 0.0 };
    let step = RodStep::new(rod, supports, loads, damping)?.with_scheme(Scheme::Midpoint);
    let (z, free) = (step.control_at_rest(&shape), step.free_vertices().len());
    let mut model = ImplicitModel::new(step, 0, 0.02);
    let n = model.dim();
    let mut x = vec![0.0; n];
    model.initial_state(&z, &mut x)?;
    // the first step has no step before it
    let mut before = x.clone();
    model.step(0, &x, &mut before)?;
    model.step(1, &before, &mut x)?;
    model.linearize(0, 1, &before, &x)?;
    // y of places and velocities; and again, where the state ends with the one before
    let own = 6 * free + model.step_ref().free_angles().len();
    let one = |from: usize| (0..2 * free).map(move |i| from + 3 * i + 1);
    let rows: Vec<usize> = if n > own { one(0).chain(one(own)).collect() } else { one(0).collect() };
    let mut matrix = DMatrix::zeros(rows.len(), rows.len());
    for (column, j) in rows.iter().enumerate() {
        let mut dx = vec![0.0; n];
        dx[*j] = 1.0;
        model.tangent(0, &mut dx);
        for (row, i) in rows.iter().enumerate() {
            matrix[(row, column)] = dx[*i];
        }
    }
    Ok(largest(matrix.complex_eigenvalues().iter().map(|l| l.norm())))
}
