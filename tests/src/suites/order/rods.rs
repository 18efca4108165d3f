//! Orders of the rod's step in time.

use super::slopes::{extrapolated, slope_row};
use crate::row::{Case, Outcome, Rows};
use problems::rods::{DT, DrivenRod, FIRST, rods};
use varda_implicit::{ImplicitModel, Model, Scheme};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const SCHEMES: [(Scheme, &str, f64); 3] = [
    (Scheme::BackwardEuler, "backward Euler", 1.0),
    (Scheme::Midpoint, "midpoint", 2.0),
    (Scheme::Bdf2, "BDF2", 2.0),
];

pub(super) fn run(rows: &mut Rows, quick: bool) {
    rows.case("hanging rod", |case| hanging_rod(case, quick));
    let twisting = ["damped anisotropic rod clamped at both ends", "anisotropic rod with twist"];
    for name in twisting.into_iter().take(if quick { 1 } else { 2 }) {
        rows.case(name, |case| twisted(case, name));
    }
}

/// Places of all vertices at the end of a run of `steps` steps of the driven rod, and Newton iterations.
fn end(scheme: Scheme, time: f64, steps: usize) -> Result<(Vec<f64>, usize)> {
    let (step, control) = DrivenRod::SOFT.step()?;
    let mut model = ImplicitModel::new(step.with_scheme(scheme), 0, time / steps as f64);
    let (x, iterations) = run_to(&mut model, &control, steps)?;
    let vertices = model.step_mut().vertices(time, &x)?;
    Ok((vertices.iter().flatten().copied().collect(), iterations))
}

fn run_to<S: varda_implicit::ImplicitStep>(
    model: &mut ImplicitModel<S>,
    control: &[f64],
    steps: usize,
) -> Result<(Vec<f64>, usize)> {
    let mut x = vec![0.0; model.dim()];
    model.initial_state(control, &mut x)?;
    let (mut next, mut iterations) = (x.clone(), 0);
    for k in 0..steps {
        iterations += model.step(k, &x, &mut next)?.newton_iterations;
        std::mem::swap(&mut x, &mut next);
    }
    Ok((x, iterations))
}

/// Root mean square over vertices of the distance.
fn rms(a: &[f64], b: &[f64]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    (3.0 * squares / a.len() as f64).sqrt()
}

/// Reference: midpoint of 2⁻¹⁶ s and twice that, extrapolated, against the same of twice the lengths
/// (Richardson's check).
///
/// The rod starts straight and unstretched: gravity sets off stretching waves of up to 1450 rad/s, which
/// backward Euler damps within a few of the usual steps. Its error is of first order only where steps of that
/// scheme are short enough to follow them, below 1e-4 s; orders are fitted over the first 1/8 s.
fn hanging_rod(case: &mut Case, quick: bool) -> Outcome {
    let (time, finest) = (0.125, 8192);
    let (reference, doubt) = reference(time, finest)?;
    case.at_most("reference: Richardson check over 1/8 s", doubt, 1e-9, "m")
        .because("a thousandth of the least error that is judged by it");
    for (scheme, name, order) in SCHEMES {
        let last = if order == 1.0 { finest } else { finest / 2 };
        let error = |n: &usize| Ok((time / *n as f64, rms(&end(scheme, time, *n)?.0, &reference)));
        let errors: Result<Vec<_>> = [last / 4, last / 2, last].iter().map(error).collect();
        slope_row(case, name, &errors?, order);
    }
    if quick {
        return Ok(());
    }
    // Errors of usual steps: docs/reference-problems.md ("Driven rod") states 5 % for backward Euler of 0.02
    // s, 0.3 to 0.6 % for midpoint of 0.01 s. The reference must be a thousand times better than what is
    // judged by it.
    let (reference, doubt) = self::reference(2.0, 32768)?;
    case.at_most("reference: Richardson check over 2 s", doubt, 5e-6, "m")
        .because("a thousandth of the least error that is judged by it");
    for (scheme, name, steps, bound) in [
        (Scheme::BackwardEuler, "backward Euler, 0.02 s: distance at 2 s", 100, 0.06),
        (Scheme::BackwardEuler, "backward Euler, 0.01 s: distance at 2 s", 200, 0.04),
        (Scheme::Midpoint, "midpoint, 0.01 s: distance at 2 s", 200, 0.006),
        (Scheme::Bdf2, "BDF2, 0.01 s: distance at 2 s", 200, 0.01),
    ] {
        let (vertices, iterations) = end(scheme, 2.0, steps)?;
        let note = format!("{:.2} Newton iterations a step", iterations as f64 / steps as f64);
        case.at_most(name, rms(&vertices, &reference), bound, "L").note(note).because(
            "measured elsewhere: about 5 % of L by backward Euler of 0.02 s, 0.3 to 0.6 % by \
                midpoint of 0.01 s; a fifth more",
        );
    }
    Ok(())
}

/// Midpoint of n and n/2 steps extrapolated, and its distance from the same of n/2 and n/4.
fn reference(time: f64, n: usize) -> Result<(Vec<f64>, f64)> {
    let runs = [n / 4, n / 2, n].map(|n| end(Scheme::Midpoint, time, n));
    let [coarse, middle, fine] = runs;
    let (coarse, middle, fine) = (coarse?.0, middle?.0, fine?.0);
    let extrapolate = |a: &[f64], b: &[f64]| -> Vec<f64> {
        a.iter().zip(b).map(|(a, b)| extrapolated(&[(2.0, *a), (1.0, *b)])).collect()
    };
    let best = extrapolate(&middle, &fine);
    let doubt = rms(&best, &extrapolate(&coarse, &middle));
    Ok((best, doubt))
}

/// Angles, strain-rate damping, clamps that move: against the same scheme of second order with much shorter
/// steps.
fn twisted(case: &mut Case, name: &str) -> Outcome {
    let time = 0.04;
    let end = |scheme, steps: usize| -> Result<(Vec<f64>, Vec<f64>)> {
        let rod = rods()?.into_iter().find(|r| r.name == name).ok_or("no such rod")?;
        let first = (FIRST as f64 * DT / time * steps as f64).round() as usize;
        let step = rod.model.into_inner().with_scheme(scheme);
        let (half, angles) = (step.control_len() / 2, step.free_angles().len());
        let mut model = ImplicitModel::new(step, first, time / steps as f64);
        let (x, _) = run_to(&mut model, &rod.control, steps)?;
        Ok((x[..half].to_vec(), x[2 * half..2 * half + angles].to_vec()))
    };
    let reference = end(Scheme::Midpoint, 12800)?;
    for (scheme, name, order) in SCHEMES {
        let first = if order == 1.0 { 1600 } else { 400 };
        let mut errors = [Vec::new(), Vec::new()];
        for steps in [first, 2 * first, 4 * first] {
            let (places, angles) = end(scheme, steps)?;
            let h = time / steps as f64;
            errors[0].push((h, rms(&places, &reference.0)));
            errors[1].push((h, rms(&angles, &reference.1)));
        }
        slope_row(case, &format!("{name}: places"), &errors[0], order);
        slope_row(case, &format!("{name}: angles"), &errors[1], order);
    }
    Ok(())
}
