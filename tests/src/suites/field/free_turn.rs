//! Rods held at points only, whose angles are unknowns: their common turn is neutral where nothing depends on
//! it, and an unknown like others where something does.

use super::common::state_after;
use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;
use problems::rods::wave;
use std::f64::consts::TAU;
use std::sync::Arc;
use varda_implicit::{ImplicitModel, Model, Scheme, check};
use varda_rod::{
    Damping, EllipseDrive, Loads, Motion, Rod, RodStep, Search, Section, Supports, Vector3, rest,
};

/// Rods of the grid.
const RODS: usize = 170;

pub(super) fn run(options: &Options, rows: &mut Rows) {
    rows.area("no director held");
    let every = if options.quick { 10 } else { 1 };
    rows.case(&format!("{} rods", RODS.div_ceil(every)), |case| grid(case, every));
    for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
        rows.case(&format!("damped cable, {scheme:?}"), |case| other_frame(case, scheme));
    }
}

/// A rod drawn by its number, with its scheme.
fn drawn(i: usize, frame: f64) -> Result<RodStep, Box<dyn std::error::Error>> {
    let draw = |what: usize| 0.5 * (1.0 + wave(i, what));
    let pick = |what: usize, from: usize| ((draw(what) * from as f64) as usize).min(from - 1);
    let (n, length) = (10 + pick(1, 20), 0.3 + 0.7 * draw(2));
    let radius = 0.003 + 0.005 * draw(3);
    let ei = 0.25 * std::f64::consts::PI * radius.powi(4) * 1e6;
    let other = [1.0, 1.0, 0.4, 2.5][pick(4, 4)];
    let section = Section {
        ea: std::f64::consts::PI * radius * radius * 1e6,
        ei1: ei,
        ei2: ei * other,
        gj: ei * 0.33 * (1.0 + other),
        mass_per_length: std::f64::consts::PI * radius * radius * 1100.0,
    };
    let curvature = [0.0, 0.0, 0.0, 2.0][pick(5, 4)];
    let twist = [0.0, 0.0, 8.0][pick(6, 3)];
    let damping = [0.002, 0.01, 0.05, 0.0][pick(7, 4)];
    let rod = Rod::uniform(length, n, &section)?.naturally([curvature, 0.0], twist);
    let drive = EllipseDrive {
        centre: Vector3::zeros(),
        radii: [0.05 * draw(8), 0.05 * draw(9)],
        omega: 4.0 + 8.0 * draw(10),
        phase: 0.0,
        ramp: TAU / 9.0,
    };
    let mut prescribed: Vec<(usize, Arc<dyn Motion>)> = vec![(0, Arc::new(drive))];
    let down = -length * (0.7 + 0.3 * draw(11));
    match pick(12, 3) {
        0 => {}
        1 => prescribed.push((n, Arc::new([0.1 * draw(13), 0.0, down]))),
        _ => prescribed.push((n / 2, Arc::new([0.1 * draw(13), 0.0, 0.5 * down]))),
    }
    let supports = Supports {
        prescribed,
        free_frame: (-Vector3::z(), Vector3::new(frame.cos(), frame.sin(), 0.0)),
        ..Supports::default()
    };
    let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    // Midpoint rings on what is not damped.
    let scheme = match pick(14, 3) {
        0 => Scheme::BackwardEuler,
        1 if damping > 0.0 => Scheme::Midpoint,
        _ => Scheme::Bdf2,
    };
    Ok(RodStep::new(rod, supports, loads, Damping { stiffness: damping, mass: 0.0 })?.with_scheme(scheme))
}

/// At rest, then driven for thirty steps: every rod comes to its end.
fn grid(case: &mut Case, every: usize) -> Outcome {
    let (mut failed, mut last) = (0, String::new());
    for i in (0..RODS).step_by(every) {
        let outcome = || -> Outcome {
            let step = drawn(i, 0.0)?;
            let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
            let shape = rest(step.rod(), step.supports(), &loads, 0.0, &Search::default())?.rest;
            let step = step.starting_from(&shape, 0.0);
            let z = step.control_at_rest(&shape);
            places(step, &z, 30)?;
            Ok(())
        }();
        if let Err(error) = outcome {
            failed += 1;
            last = format!("{i}: {error}");
        }
    }
    case.count("runs that failed", failed, 0).note(last);
    Ok(())
}

/// Places after some steps from a control.
fn places(step: RodStep, z: &[f64], steps: usize) -> Result<Vec<f64>, Box<dyn std::error::Error>> {
    let mut x = state_after(step, z, 0.01, steps)?;
    x.truncate(z.len() / 2);
    Ok(x)
}

/// A damped cable that hangs straight from a driven pin: places do not depend on the frame that angles are
/// measured from, and derivatives are exact.
fn other_frame(case: &mut Case, scheme: Scheme) -> Outcome {
    let step = |frame: f64| -> Result<RodStep, Box<dyn std::error::Error>> {
        let radius = 0.005_f64;
        let ei = 0.25 * std::f64::consts::PI * radius.powi(4) * 1e6;
        let area = std::f64::consts::PI * radius * radius;
        let section =
            Section { ea: area * 1e6, ei1: ei, ei2: ei, gj: 2.0 / 3.0 * ei, mass_per_length: area * 1100.0 };
        let drive = EllipseDrive {
            centre: Vector3::zeros(),
            radii: [0.05, 0.03],
            omega: 9.0,
            phase: 0.0,
            ramp: TAU / 9.0,
        };
        let supports = Supports {
            prescribed: vec![(0, Arc::new(drive))],
            free_frame: (-Vector3::z(), Vector3::new(frame.cos(), frame.sin(), 0.0)),
            ..Supports::default()
        };
        let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
        let rod = Rod::uniform(0.5, 20, &section)?;
        let damping = Damping { stiffness: 0.01, mass: 0.0 };
        Ok(RodStep::new(rod, supports, loads, damping)?.with_scheme(scheme))
    };
    let mut z = vec![0.0; step(0.0)?.control_len()];
    for i in 0..20 {
        z[3 * i + 2] = -0.025 * (i + 1) as f64;
    }
    let (a, b) = (places(step(0.0)?, &z, 120)?, places(step(1.3)?, &z, 120)?);
    let off = a.iter().zip(&b).fold(0.0, |m: f64, (a, b)| if (a - b).abs() <= m { m } else { (a - b).abs() });
    case.at_most("places by another frame", off, 1e-9, "m")
        .because("Newton's method ends below 1e-11 L a step; the motion is damped");
    for (i, z) in z[..60].iter_mut().enumerate() {
        *z += 0.004 * wave(i / 3, i % 3);
    }
    let mut model = ImplicitModel::new(step(0.0)?, 0, 0.01);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let scale = problems::rods::rod_scale(model.step_ref());
    let dot = check::window(&mut model, &x, 8, &scale, 4)?;
    case.at_most("dot product of eight steps", dot.value, dot.bound, "-")
        .because("50 ε times the condition of the product");
    for finding in check::conformance(&mut model, 2, &x, &scale, 3)? {
        if finding.what.contains("Taylor") {
            case.at_most(&finding.what, finding.value, finding.bound, "-")
                .because("the first-order remainder falls like h²");
        }
    }
    Ok(())
}
