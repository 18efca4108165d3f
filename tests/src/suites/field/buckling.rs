//! Twist that buckles a rod: the turn at which the statics' Hessian gets its first negative eigenvalue.

use super::common::slope;
use crate::row::{Case, Outcome, Rows};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use varda_implicit::{ImplicitModel, Model};
use varda_rod::{
    Clamp, ClampAt, Damping, Load, Loads, Moment, Rest, Rod, RodStep, Section, Supports, Vector3, modes,
};

/// EI/GJ = 1.25, and hardly to be stretched.
const SECTION: Section = Section { ea: 1e4, ei1: 1e-3, ei2: 1e-3, gj: 0.8e-3, mass_per_length: 0.1 };
/// The least root of tan(x/2) = x/2 beyond zero: M L/EI of a straight rod between clamps (Timoshenko and
/// Gere 1961, section 2.21).
const STRAIGHT: f64 = 8.986_818_916;

pub(super) fn run(rows: &mut Rows) {
    rows.area("buckling by twist");
    rows.reason("second order of the mesh, L between the faces");
    // inserted angle times GJ/EI
    rows.case("straight between clamps", |case| critical(case, STRAIGHT, straight));
    rows.case("Michell's ring", |case| critical(case, TAU * 3f64.sqrt(), ring));
    rows.case("straight between pins", pinned);
}

/// Moments M along the rod's first direction twist it between two pins: M_c = 2π EI/L (Greenhill 1883;
/// Timoshenko and Gere 1961, section 2.21). They have no potential: what shows M_c is that the rod yields
/// without bound to a force across its middle, and beyond M_c against it.
fn pinned(case: &mut Case) -> Outcome {
    let expected = TAU * SECTION.ei1;
    let mut errors = Vec::new();
    for n in [40, 80, 160] {
        let (mut low, mut high) = (0.7 * expected, 1.3 * expected);
        if !(yields(n, low)? > 0.0 && yields(n, high)? < 0.0) {
            return Err("no buckling between 0.7 and 1.3 of 2π EI/L".into());
        }
        for _ in 0..24 {
            let moment = 0.5 * (low + high);
            *(if yields(n, moment)? > 0.0 { &mut low } else { &mut high }) = moment;
        }
        errors.push((1.0 / n as f64, low / expected - 1.0));
        if n == 160 {
            case.at_most("moment, 160 segments", (low / expected - 1.0).abs(), 1.5e-3, "-").computed(low);
        }
    }
    let limit = (4.0 * errors[2].1 - errors[1].1) / 3.0;
    case.at_most("extrapolated from 80 and 160", limit.abs(), 5e-5, "-")
        .because("what is left is of fourth order: 1e-5");
    let fitted = slope(&errors);
    case.at_most("order in the mesh", (fitted - 2.0).abs(), 0.1, "-")
        .computed(fitted)
        .because("40, 80 and 160 segments");
    Ok(())
}

/// How far the middle of the rod moves along y in a step of a thousand seconds, for a speed along y that it
/// begins with: a step so long is statics, and that speed a force.
fn yields(n: usize, moment: f64) -> Result<f64, Box<dyn std::error::Error>> {
    let rod = Rod::uniform(1.0, n, &SECTION)?;
    let prescribed: Vec<(usize, Arc<dyn varda_rod::Motion>)> =
        vec![(0, Arc::new([0.0; 3])), (n, Arc::new([1.0, 0.0, 0.0]))];
    let supports = Supports { prescribed, ..Supports::default() };
    let twist = |s: f64, m: f64| -> Result<Arc<dyn Load>, varda_rod::Error> {
        Ok(Arc::new(Moment::new(&rod, s, [m, 0.0, 0.0])?))
    };
    let loads = Loads { of_motion: vec![twist(0.0, -moment)?, twist(1.0, moment)?], ..Loads::default() };
    let vertices = rod.arc_lengths().iter().map(|s| Vector3::x() * *s).collect();
    let step = RodStep::new(rod.clone(), supports, loads, Damping::default())?;
    let z = step.control_at_rest(&Rest { vertices, theta: vec![0.0; n] });
    let mut model = ImplicitModel::new(step, 0, 1e3);
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(&z, &mut x)?;
    model.step(0, &x, &mut next)?;
    model.linearize(0, 0, &x, &next)?;
    let middle = 3 * (n / 2 - 1) + 1;
    let mut dx = vec![0.0; x.len()];
    dx[z.len() / 2 + middle] = 1.0;
    model.tangent(0, &mut dx);
    Ok(dx[middle])
}

/// The critical turn on three meshes.
fn critical(case: &mut Case, expected: f64, shape: fn(usize, f64) -> Vec<Vector3<f64>>) -> Outcome {
    let expected = expected * SECTION.ei1 / SECTION.gj;
    let mut errors = Vec::new();
    for n in [40, 80, 160] {
        let rod = Rod::uniform_between(1.0, n, &SECTION, [true; 2])?;
        let vertices = shape(n, 1.0 / (n - 1) as f64);
        let (mut low, mut high) = (0.7 * expected, 1.3 * expected);
        for _ in 0..30 {
            let turn = 0.5 * (low + high);
            if stable(&rod, &vertices, turn)? { low = turn } else { high = turn }
        }
        errors.push((1.0 / n as f64, low / expected - 1.0));
        if n == 160 {
            case.at_most("inserted angle, 160 segments", (low / expected - 1.0).abs(), 1.5e-3, "-")
                .computed(low);
        }
    }
    let limit = (4.0 * errors[2].1 - errors[1].1) / 3.0;
    case.at_most("extrapolated from 80 and 160", limit.abs(), 5e-5, "-")
        .because("what is left is of fourth order: 1e-5");
    let fitted = slope(&errors);
    case.at_most("order in the mesh", (fitted - 2.0).abs(), 0.3, "-")
        .computed(fitted)
        .because("40, 80 and 160 segments; the ring's fourth order shows on the first");
    Ok(())
}

/// Whether a uniformly twisted rod of this shape is at a minimum of its energy.
fn stable(rod: &Rod, vertices: &[Vector3<f64>], turn: f64) -> Result<bool, Box<dyn std::error::Error>> {
    let n = rod.segments();
    let face = |e: usize| (vertices[e] + vertices[e + 1]) * 0.5;
    let (sin, cos) = turn.sin_cos();
    // both held edges point along x
    let clamp = |e: usize, director: [f64; 3]| Clamp::new(ClampAt::Face, face(e), Vector3::x(), director);
    let supports = Supports {
        start: Some(clamp(0, [0.0, 0.0, 1.0])),
        end: Some(clamp(n - 1, [0.0, -sin, cos])),
        ..Supports::default()
    };
    let theta = (0..n).map(|e| turn * e as f64 / (n - 1) as f64).collect();
    let shape = Rest { vertices: vertices.to_vec(), theta };
    let found = modes(rod, &supports, &Loads::default(), 0.0, &shape, 0)?;
    Ok(found.unstable == 0)
}

fn straight(n: usize, l: f64) -> Vec<Vector3<f64>> {
    (0..=n).map(|v| Vector3::x() * (v as f64 - 0.5) * l).collect()
}

/// A regular polygon, the last edge on the first.
fn ring(n: usize, l: f64) -> Vec<Vector3<f64>> {
    let mut place = Vector3::new(-0.5 * l, 0.0, 0.0);
    let mut all = vec![place];
    for e in 0..n {
        let (sin, cos) = (2.0 * PI * e as f64 / (n - 1) as f64).sin_cos();
        place += Vector3::new(cos, sin, 0.0) * l;
        all.push(place);
    }
    all
}
