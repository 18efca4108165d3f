//! Closed forms of inextensible rods, from segments extrapolated to none.
//!
//! Clamps hold the rod at their faces, half a segment of it inside. Then all
//! errors are of even order in the length of a segment (curvature sits at vertices, each standing for half a
//! segment on either side), and Richardson's extrapolation from three of them leaves the sixth order. With
//! the clamp's edge within the length (`ClampAt::Edge`) the rod is half a segment too short, an error of
//! first order.

use super::slopes::{extrapolated, slope_row};
use crate::row::{Case, Outcome, Rows};
use std::sync::Arc;
use varda_implicit::band;
use varda_rod::{
    Clamp, ClampAt, Framed, Loads, Material, Rest, Rod, Section, Supports, Vector3, derivatives, equilibrium,
    straight_guess,
};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

pub(super) fn run(rows: &mut Rows, quick: bool) {
    rows.case("elastica", |case| elastica(case, quick));
    rows.case("cantilever under its weight", |case| own_weight(case, quick));
    rows.case("standing rod", standing);
    rows.case("vibrations of the hanging rod", hanging);
    rows.case("ring", ring);
}

/// EI = 1 N m², length 1 m, mass 1 kg/m; EA L²/EI = 1e8.
const SECTION: Section = Section { ea: 1e8, ei1: 1.0, ei2: 1.0, gj: 1.0, mass_per_length: 1.0 };

/// A rod of 1 m in n segments, clamped at its start.
fn clamped(n: usize, at: ClampAt) -> Result<Rod> {
    Ok(Rod::uniform_between(1.0, n, &SECTION, [at == ClampAt::Face, false])?)
}

/// How far the tip of a horizontal cantilever sinks under loads grown in ten stages.
fn sag(n: usize, at: ClampAt, loads: &dyn Fn(f64) -> Loads) -> Result<f64> {
    let rod = clamped(n, at)?;
    let along = [1.0, 0.0, 0.0];
    let supports = Supports::clamped_start(Clamp::new(at, [0.0; 3], along, [0.0, 1.0, 0.0]));
    let mut shape: Rest = straight_guess(&rod, &supports, 0.0, along)?;
    for stage in 1..=10 {
        let share = f64::from(stage) / 10.0;
        shape = equilibrium(&rod, &supports, &loads(share), 0.0, &shape)?.0;
    }
    Ok(-shape.vertices[n][2])
}

fn tip_load(n: usize, at: ClampAt, load: f64) -> Result<f64> {
    sag(n, at, &|share| Loads {
        point_forces: vec![(1.0, Arc::new([0.0, 0.0, -share * load]))],
        ..Loads::default()
    })
}

/// Cantilever with a load at its tip (Bisshopp and Drucker 1945; docs/reference-problems.md, "Closed forms of
/// rods").
fn elastica(case: &mut Case, quick: bool) -> Outcome {
    let known = [(2.0, 0.493457), (1.0, 0.301721), (5.0, 0.713792), (10.0, 0.810609)];
    for (load, drop) in known.into_iter().take(if quick { 1 } else { 4 }) {
        let ours = limit(&SEGMENTS, 0.5, &|n| tip_load(n, ClampAt::Face, load))?.0;
        drop_row(case, &format!("drop at PL²/EI = {load}"), ours, drop);
    }
    for (what, at, inside, order) in [
        ("space: clamp at its face", ClampAt::Face, 0.5, 2.0),
        ("space: clamp at an edge", ClampAt::Edge, 0.0, 1.0),
    ] {
        let points = limit(&[10, 20, 40], inside, &|n| tip_load(n, at, 2.0))?.1;
        space_row(case, what, &points, 0.493457, order);
    }
    Ok(())
}

fn own_weight(case: &mut Case, quick: bool) -> Outcome {
    let known = [(10.0, 0.700200), (1.0, 0.123471), (2.0, 0.238507), (5.0, 0.495905), (50.0, 0.907917)];
    for (weight, drop) in known.into_iter().take(if quick { 1 } else { 5 }) {
        let loads = |share: f64| Loads { gravity: [0.0, 0.0, -share * weight].into(), ..Loads::default() };
        let ours = limit(&SEGMENTS, 0.5, &|n| sag(n, ClampAt::Face, &loads))?.0;
        drop_row(case, &format!("drop at wL³/EI = {weight}"), ours, drop);
    }
    Ok(())
}

const DROP: &str =
    "half a unit of the last digit given, a stretch of 1e-8 per unit of load, as much for the sixth order";

fn drop_row(case: &mut Case, what: &str, ours: f64, drop: f64) {
    case.at_most(what, (ours - drop).abs(), 1e-6, "L").computed(ours).because(DROP);
}

/// Numbers of segments to extrapolate from.
const SEGMENTS: [usize; 3] = [20, 40, 80];

/// Extrapolated to no segment length, `inside` of a segment being in the clamp; and the (h, values) it is
/// done from.
fn limit(
    segments: &[usize],
    inside: f64,
    value: &dyn Fn(usize) -> Result<f64>,
) -> Result<(f64, Vec<(f64, f64)>)> {
    let point = |n: &usize| Ok((1.0 / (*n as f64 - inside), value(*n)?));
    let points: Result<Vec<_>> = segments.iter().map(point).collect();
    let points = points?;
    Ok((extrapolated(&points), points))
}

/// The order at which values approach the exact one.
fn space_row(case: &mut Case, what: &str, points: &[(f64, f64)], exact: f64, order: f64) {
    let errors: Vec<(f64, f64)> = points.iter().map(|p| (p.0, (p.1 - exact).abs())).collect();
    slope_row(case, what, &errors, order);
}

/// ∂²E/∂x² of a straight vertical rod under its own weight across it (`up`: standing on its clamp, else
/// hanging), as a band of half-bandwidth 2 of the x coordinates of the free vertices; and their masses.
fn lateral(rod: &Rod, gravity: f64, up: bool) -> Result<(Vec<f64>, Vec<f64>)> {
    let n = rod.segments();
    let sign = if up { 1.0 } else { -1.0 };
    let mut vertices = vec![Vector3::zeros(); n + 1];
    for e in 0..n {
        let load: f64 = rod.masses[e + 1..].iter().sum::<f64>() * gravity;
        let length = rod.rest_lengths[e] * (1.0 - sign * load / rod.ea[e]);
        vertices[e + 1][2] = vertices[e][2] + sign * length;
    }
    let free: Vec<usize> = (2..=n).map(|v| 3 * v).collect();
    let hessian = hessian(rod, &vertices, &vec![Vector3::x(); n], &vec![0.0; n])?;
    Ok((band_of(&hessian, 4 * n + 3, &free, 2), rod.masses[2..].to_vec()))
}

fn hessian(
    rod: &Rod,
    vertices: &[Vector3<f64>],
    directors: &[Vector3<f64>],
    theta: &[f64],
) -> Result<Vec<f64>> {
    let still = vec![0.0; theta.len() - 1];
    Ok(derivatives(rod, &Framed { vertices, directors, reference_twist: &still, theta })?.hessian)
}

/// The rows and columns `kept` of a dense symmetric matrix in the layout of `band::ldlt_factor`.
fn band_of(dense: &[f64], n: usize, kept: &[usize], w: usize) -> Vec<f64> {
    let mut band = vec![0.0; kept.len() * (w + 1)];
    for i in 0..kept.len() {
        for j in i.saturating_sub(w)..=i {
            band[i * (w + 1) + w + j - i] = dense[kept[i] + n * kept[j]];
        }
    }
    band
}

/// Number of negative eigenvalues.
fn negative(w: usize, mut band: Vec<f64>) -> Result<usize> {
    Ok(band::ldlt_factor(w, &mut band)?)
}

/// Where `count` first exceeds `below`, between `low` and `high`.
fn bisect(mut low: f64, mut high: f64, below: usize, count: &dyn Fn(f64) -> Result<usize>) -> Result<f64> {
    let ends = (count(low)?, count(high)?);
    if ends.0 > below || ends.1 <= below {
        return Err(
            format!("{ends:?} negative eigenvalues at the ends of the range, {below} wanted below").into()
        );
    }
    while high - low > 1e-12 * high {
        let middle = 0.5 * (low + high);
        *(if count(middle)? > below { &mut high } else { &mut low }) = middle;
    }
    Ok(low)
}

/// Greenhill 1881: 7.837347 = (9/4) j², j the first zero of J_{−1/3}.
fn standing(case: &mut Case) -> Outcome {
    let critical = |n: usize| -> Result<f64> {
        let rod = clamped(n, ClampAt::Face)?;
        bisect(5.0, 12.0, 0, &|g| negative(2, lateral(&rod, g, true)?.0))
    };
    let (ours, points) = limit(&SEGMENTS, 0.5, &critical)?;
    case.at_most("μgL³/EI", (ours - 7.837347).abs(), 2e-6, "-")
        .computed(ours)
        .because("the digits given (5e-7), a compression of 8e-8 of 7.8, and the sixth order");
    space_row(case, "space", &points, 7.837347, 2.0);
    Ok(())
}

/// The driven rod's section, 0.96 m of it below the clamp, inextensible: its first three frequencies.
/// Segments must be short against √(EI/weight) = 2.3 cm, within which it bends below its clamp.
fn hanging(case: &mut Case) -> Outcome {
    let material = Material { youngs_modulus: 1e6, shear_modulus: 1e6 / 3.0, density: 1200.0 };
    // EA: a strain of 1e-6 under the weight, which rounding of lengths (1e-14 of a segment) does not reach.
    let section = Section { ea: 1e6, ..Section::circle(&material, 0.005) };
    let frequency = |n: usize, mode: usize| -> Result<f64> {
        let rod = Rod::uniform_between(0.96, n, &section, [true, false])?;
        let (stiffness, masses) = lateral(&rod, 9.81, false)?;
        let count = |f: f64| {
            let mut shifted = stiffness.clone();
            let omega = std::f64::consts::TAU * f;
            shifted.iter_mut().skip(2).step_by(3).zip(&masses).for_each(|(k, m)| *k -= omega * omega * m);
            negative(2, shifted)
        };
        bisect(0.1, 10.0, mode, &count)
    };
    for (mode, given) in [0.619921, 1.459562, 2.475580].into_iter().enumerate() {
        let ours = limit(&[80, 160, 320], 0.5, &|n| frequency(n, mode))?.0;
        case.at_most(&format!("frequency {}", mode + 1), (ours - given).abs(), 2e-6, "Hz")
            .computed(ours)
            .because("the digits given (5e-7), and the sixth order, which grows with the mode");
    }
    Ok(())
}

/// Michell 1889: a ring whose ends are clamped on one edge stays plane up to an inserted angle 2π√3 EI/GJ.
fn ring(case: &mut Case) -> Outcome {
    let critical = |n: usize| -> Result<f64> {
        // n edges once round, and the first again
        let around = |i: usize| std::f64::consts::TAU * i as f64 / n as f64;
        let place = |i: usize| Vector3::new(around(i).cos(), around(i).sin(), 0.0);
        let vertices: Vec<_> = (0..n + 2).map(place).collect();
        let side = 2.0 * (0.5 * around(1)).sin();
        let rod = Rod::uniform((n + 1) as f64 * side, n + 1, &Section { ea: 1e6, ..SECTION })?;
        let (full, angle) = (4 * (n + 1) + 3, 3 * (n + 2));
        let mut free = Vec::new();
        for e in 1..n {
            // Turned about the tangent of its clamp the ring has the same energy: its farthest point stays in
            // the plane.
            let held = if e == n / 2 { 1 } else { 0 };
            if e > 1 {
                free.extend(3 * e..3 * e + 3 - held);
            }
            free.push(angle + e);
        }
        bisect(1.0, 20.0, 0, &|inserted| {
            let theta: Vec<f64> = (0..=n).map(|e| inserted * e as f64 / n as f64).collect();
            let hessian = hessian(&rod, &vertices, &vec![Vector3::z(); n + 1], &theta)?;
            negative(10, band_of(&hessian, full, &free, 10))
        })
    };
    let exact = std::f64::consts::TAU * 3.0_f64.sqrt();
    let (ours, points) = limit(&[32, 64, 128], 0.0, &critical)?;
    case.at_most("inserted angle", (ours - exact).abs() / exact, 1e-5, "-").computed(ours).because(
        "extrapolated from 32, 64 and 128 edges: what is left is of order (2π/128)⁶ = 1e-8, \
            times the bending that EA = 1e6 lets through, 1e-6; ten times",
    );
    space_row(case, "space", &points, exact, 2.0);
    Ok(())
}
