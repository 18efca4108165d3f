//! Orders of the rod's step in time.

use super::slope_row;
use crate::problems::{DT, FIRST, rods, section9};
use crate::row::{Case, Outcome, Rows};
use varda_implicit::{ImplicitModel, Model, Scheme};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const SCHEMES: [(Scheme, &str, f64); 3] = [
    (Scheme::BackwardEuler, "backward Euler", 1.0),
    (Scheme::Midpoint, "midpoint", 2.0),
    (Scheme::Bdf2, "BDF2", 2.0),
];

pub(super) fn run(rows: &mut Rows, quick: bool) {
    rows.case("hanging rod", |case| hanging_rod(case, quick));
    for name in ["anisotropic rod with twist", "damped anisotropic rod clamped at both ends"] {
        rows.case(name, |case| twisted(case, name));
    }
}

/// Places of all vertices at the end of a run of `steps` steps of the rod of section 9, and Newton iterations.
fn end(scheme: Scheme, time: f64, steps: usize) -> Result<(Vec<f64>, usize)> {
    let (step, control) = section9()?;
    let mut model = ImplicitModel::new(step.with_scheme(scheme), 0, time / steps as f64);
    let x = run_to(&mut model, &control, steps)?;
    let vertices = model.step_mut().vertices(time, &x)?;
    Ok((vertices.concat(), model.counts().newton_iterations))
}

fn run_to<S: varda_implicit::ImplicitStep>(
    model: &mut ImplicitModel<S>,
    control: &[f64],
    steps: usize,
) -> Result<Vec<f64>> {
    let mut x = vec![0.0; model.dim()];
    model.initial_state(control, &mut x)?;
    let mut next = x.clone();
    for k in 0..steps {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    Ok(x)
}

/// Root mean square over vertices of the distance.
fn rms(a: &[f64], b: &[f64]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    (3.0 * squares / a.len() as f64).sqrt()
}

fn hanging_rod(case: &mut Case, _quick: bool) -> Outcome {
    for time in [0.5, 2.0] {
        let per = |n: f64| (n * time) as usize;
        let a = end(Scheme::Midpoint, time, per(8000.0))?.0;
        let b = end(Scheme::Midpoint, time, per(4000.0))?.0;
        let reference: Vec<f64> = a.iter().zip(&b).map(|(f, c)| super::extrapolated(*c, *f)).collect();
        case.inform("midpoint", rms(&a, &reference), "m");
        for (scheme, name, _) in SCHEMES {
            for n in [50.0, 100.0, 200.0, 400.0, 800.0, 1600.0, 3200.0, 6400.0, 12800.0] {
                let (x, newton) = end(scheme, time, per(n))?;
                case.inform(name, rms(&x, &reference), "m")
                    .note(format!("{time} {n} {:.3}", newton as f64 / per(n) as f64));
            }
        }
    }
    Ok(())
}

fn twisted(case: &mut Case, name: &str) -> Outcome {
    let time = 0.04;
    let make = |scheme, steps: usize| -> Result<Vec<f64>> {
        let rod = rods()?.into_iter().find(|r| r.name == name).ok_or("no such rod")?;
        let first = (FIRST as f64 * DT / time * steps as f64).round() as usize;
        let step = rod.model.into_inner().with_scheme(scheme);
        let mut model = ImplicitModel::new(step, first, time / steps as f64);
        let x = run_to(&mut model, &rod.control, steps)?;
        Ok(x)
    };
    let reference = make(Scheme::Midpoint, 12800)?;
    let half = rods()?[0].control.len() / 2;
    for (scheme, name, order) in SCHEMES {
        let mut errors = [vec![], vec![]];
        for steps in [200, 400, 800, 1600] {
            let x = make(scheme, steps)?;
            errors[0].push(rms(&x[..half], &reference[..half]));
            errors[1].push(rms(&x[2 * half..2 * half + 9], &reference[2 * half..2 * half + 9]));
        }
        slope_row(case, &format!("{name}: places"), &errors[0], order);
        slope_row(case, &format!("{name}: angles"), &errors[1], order);
    }
    Ok(())
}
