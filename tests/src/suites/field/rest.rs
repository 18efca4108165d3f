//! Rods held anywhere, found at rest without being told how.

use super::common::greatest;
use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;
use problems::statics::{Catenary, elastica_height};
use std::sync::Arc;
use varda_rod::{Clamp, ClampAt, Loads, Rod, Search, Section, Supports, Vector3, rest};

/// Weight per length of the cables [N/m].
const WEIGHT: f64 = 0.5;
const GRAVITY: f64 = 9.81;

/// Cables slack between two hooks one metre apart: segments, length [m], rise [m], EA [N], EI = GJ [N m²];
/// drawn from what is ordinary.
#[rustfmt::skip]
const CABLES: [(usize, f64, f64, f64, f64); 56] = [
    (30, 1.5, 0.4, 1e4, 1e-4),
    (40, 1.5, 0.3, 1e5, 1e-6),
    (20, 1.5, 0.0, 1e5, 1e-4),
    (40, 1.5, 0.1, 1e4, 1e-4),
    (80, 1.3, 0.4, 1e5, 1e-6),
    (50, 1.3, 0.5, 1e4, 1e-4),
    (30, 1.1, 0.4, 1e5, 1e-4),
    (20, 1.1, 0.4, 1e3, 1e-4),
    (40, 1.05, 0.2, 1e5, 1e-4),
    (60, 1.3, 0.5, 1e5, 1e-4),
    (50, 1.5, 0.3, 1e4, 1e-4),
    (40, 1.05, 0.0, 1e4, 1e-4),
    (50, 1.1, 0.2, 1e5, 1e-4),
    (80, 1.2, 0.3, 1e5, 1e-6),
    (50, 1.5, 0.2, 1e5, 1e-6),
    (60, 1.3, 0.4, 1e4, 1e-4),
    (40, 1.05, 0.2, 1e5, 1e-6),
    (40, 1.5, 0.4, 1e5, 1e-6),
    (60, 1.2, 0.2, 1e3, 1e-4),
    (20, 1.3, 0.5, 1e5, 1e-4),
    (20, 1.2, 0.0, 1e5, 1e-4),
    (30, 1.05, 0.2, 1e5, 1e-4),
    (50, 1.05, 0.0, 1e5, 1e-6),
    (60, 1.05, 0.3, 1e5, 1e-6),
    (40, 1.5, 0.2, 1e5, 1e-6),
    (30, 1.05, 0.2, 1e3, 1e-4),
    (60, 1.05, 0.1, 1e5, 1e-4),
    (40, 1.5, 0.2, 1e4, 1e-4),
    (80, 1.05, 0.2, 1e4, 1e-5),
    (40, 1.1, 0.3, 1e5, 1e-4),
    (50, 1.5, 0.3, 1e5, 1e-6),
    (80, 1.5, 0.0, 1e5, 1e-6),
    (60, 1.2, 0.3, 1e4, 1e-4),
    (40, 1.3, 0.2, 1e5, 1e-6),
    (40, 1.5, 0.2, 1e3, 1e-4),
    (50, 1.5, 0.2, 1e3, 1e-4),
    (50, 1.5, 0.4, 1e4, 1e-4),
    (20, 1.2, 0.3, 1e4, 1e-5),
    (80, 1.2, 0.4, 1e4, 1e-5),
    (80, 1.3, 0.0, 1e5, 1e-6),
    (20, 1.05, 0.2, 1e4, 1e-5),
    (80, 1.3, 0.2, 1e5, 1e-6),
    (60, 1.2, 0.1, 1e4, 1e-5),
    (30, 1.2, 0.2, 1e5, 1e-6),
    (40, 1.2, 0.3, 1e3, 1e-4),
    (20, 1.5, 0.5, 1e4, 1e-4),
    (40, 1.5, 0.1, 1e4, 1e-5),
    (30, 1.2, 0.1, 1e5, 1e-4),
    (80, 1.05, 0.0, 1e5, 1e-6),
    (40, 1.2, 0.5, 1e4, 1e-4),
    (50, 1.1, 0.0, 1e4, 1e-5),
    (80, 1.1, 0.4, 1e5, 1e-4),
    (40, 1.1, 0.0, 1e3, 1e-4),
    (60, 1.1, 0.2, 1e5, 1e-6),
    (30, 1.2, 0.2, 1e3, 1e-4),
    (60, 1.2, 0.4, 1e4, 1e-4),
];

pub(super) fn run(options: &Options, rows: &mut Rows) {
    let every = if options.quick { 10 } else { 1 };
    rows.area("slack cable");
    rows.reason("bending of 1e-4 N m² moves the catenary by less than 2e-3 m, the mesh by less");
    for (i, cable) in CABLES.iter().enumerate().step_by(every) {
        rows.case(&format!("{i:02}"), |case| slack_cable(case, cable));
    }
    rows.area("two clamps in line");
    rows.reason("second order of the mesh: 4e-4 of the length at 80 segments");
    for share in [0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 0.99].into_iter().step_by(every) {
        rows.case(&format!("D/L {share}"), |case| elastica(case, share));
    }
    rows.area("coil");
    let coils = (1..=10).flat_map(|i| [0.0, 5.0, 40.0].map(|twist| (6.0 * f64::from(i), twist)));
    for (curvature, twist) in coils.step_by(every) {
        rows.case(&format!("k {curvature} twist {twist}"), |case| coil(case, curvature, twist));
    }
}

fn slack_cable(case: &mut Case, &(n, length, rise, ea, ei): &(usize, f64, f64, f64, f64)) -> Outcome {
    let section = Section { ea, ei1: ei, ei2: ei, gj: ei, mass_per_length: WEIGHT / GRAVITY };
    let rod = Rod::uniform(length, n, &section)?;
    let mut supports = Supports::default();
    supports.prescribed.push((0, Arc::new([0.0; 3])));
    supports.prescribed.push((n, Arc::new([1.0, 0.0, rise])));
    let loads = Loads { gravity: Vector3::new(0.0, 0.0, -GRAVITY), ..Loads::default() };
    let found = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
    let catenary = Catenary::between(length, [1.0, rise], WEIGHT, ea).ok_or("no catenary")?;
    let off = rod.arc_lengths().into_iter().zip(&found.rest.vertices).map(|(s, x)| {
        let [a, z] = catenary.at(s);
        (x - Vector3::new(a, 0.0, z)).norm()
    });
    case.at_most("places", off.fold(0.0, greatest), 2e-3, "m").computed(found.energy);
    // the hooks carry its weight, and pull as the catenary does
    let pull = found.reactions[0].force - Vector3::new(-catenary.pull, 0.0, catenary.lift);
    let lift: f64 = found.reactions.iter().map(|r| r.force.z).sum();
    case.at_most("weight carried", (lift - WEIGHT * length).abs() / (WEIGHT * length), 1e-8, "-")
        .because("Newton's method ends at rounding");
    case.at_most("reaction", pull.norm() / catenary.pull.hypot(catenary.lift), 1e-2, "-")
        .because("bending at the hooks and the mesh, against a cable without either");
    Ok(())
}

/// Two clamps in line, their faces at a share of the length, without weight.
fn elastica(case: &mut Case, share: f64) -> Outcome {
    let section = Section { ea: 1e6, ei1: 1e-3, ei2: 1e-3, gj: 1e-3, mass_per_length: 0.1 };
    let rod = Rod::uniform_between(1.0, 80, &section, [true; 2])?;
    let clamp = |x: f64| Some(Clamp::new(ClampAt::Face, [x, 0.0, 0.0], Vector3::x(), Vector3::z()));
    let supports = Supports { start: clamp(0.0), end: clamp(share), ..Supports::default() };
    let found = rest(&rod, &supports, &Loads::default(), 0.0, &Search::default())?;
    let height = found.rest.vertices.iter().map(|x| x.y.hypot(x.z)).fold(0.0, greatest);
    case.at_most("height", (height - elastica_height(1.0, share)).abs(), 4e-4, "m").computed(height);
    Ok(())
}

/// One metre of a coil of natural curvature k and twist t: a helix of radius k/(k² + t²), at ease.
fn coil(case: &mut Case, curvature: f64, twist: f64) -> Outcome {
    let n = 200;
    let section = Section { ea: 1e4, ei1: 1e-3, ei2: 1e-3, gj: 0.8e-3, mass_per_length: 0.1 };
    let rod = Rod::uniform_between(1.0, n, &section, [true, false])?.naturally([curvature, 0.0], twist);
    let supports =
        Supports::clamped_start(Clamp::new(ClampAt::Face, Vector3::zeros(), Vector3::z(), Vector3::x()));
    let found = rest(&rod, &supports, &Loads::default(), 0.0, &Search::default())?;
    case.at_most("energy", found.energy.abs(), 1e-20, "J").because("the rest shape has none");
    let chord = (found.rest.vertices[n] - found.rest.vertices[0]).norm();
    let rate = curvature.hypot(twist);
    let expected = (2.0 * curvature / (rate * rate) * (0.5 * rate).sin()).hypot(twist / rate);
    case.at_most("end to end", (chord - expected).abs(), 5e-3, "m")
        .computed(chord)
        .because("chords of the mesh for arcs of up to 0.3 rad");
    Ok(())
}
