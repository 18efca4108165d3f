//! Twist that buckles a rod: the turn at which the statics' Hessian gets its first negative eigenvalue.

use super::common::slope;
use crate::row::{Case, Outcome, Rows};
use std::f64::consts::{PI, TAU};
use varda_rod::{Clamp, ClampAt, Loads, Rest, Rod, Section, Supports, Vector3, modes};

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
