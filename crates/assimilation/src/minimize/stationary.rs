//! A first point without a gradient: a minimum, or the top of a hill.

use super::minimum::{Iteration, Minimum, Start};
use super::stopping::{NOISE, Status, Stopping};
use crate::{CostFunction, Error};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::ops::ControlFlow;
use varda_linalg::krylov::Lanczos;

/// Gradients at most that are spent on looking.
const LOOKS: usize = 12;
/// Length of the difference between two gradients that gives a curvature, in standard deviations.
const DIFFERENCE: f64 = 1e-4;
/// How far beside the point J is compared.
const BESIDE: [f64; 3] = [1e-3, 1e-2, 1e-1];

/// A run of a minimizer.
type Run<'r, C> = dyn FnMut(&mut C, &mut [f64], &Start, &mut Tell) -> Result<Minimum, Error> + 'r;

/// Who hears of an iteration.
type Tell<'t> = dyn FnMut(&Iteration) -> ControlFlow<()> + 't;

/// Runs a minimizer. Where it ends at once, at a first point without a gradient, J is looked at beside it:
/// where it is lower there, the point was no minimum, and the minimizer starts again from the lowest place
/// seen (`Minimum::started_beside`).
///
/// A vanishing gradient is also that of a maximum or a saddle: y = x² seen from x_b = 0. J ≥ 0, so
/// that nothing is looked for where J itself is below the floor of a gradient.
pub(super) fn run_from<C: CostFunction + ?Sized>(
    cost: &mut C,
    v: &mut [f64],
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    run: &mut Run<C>,
) -> Result<Minimum, Error> {
    let first = v.to_vec();
    let minimum = run(cost, v, start, on_iteration)?;
    let stayed = minimum.status == Status::Converged && minimum.outer_iterations == 0 && v == first;
    if start.index > 0 || !stayed || minimum.value <= Stopping::default().gradient_floor {
        return Ok(minimum);
    }
    let mut gradient = vec![0.0; v.len()];
    cost.evaluate(v, Some(&mut gradient))?;
    match lower_beside(cost, v, minimum.value, &gradient) {
        Some(beside) => {
            v.copy_from_slice(&beside);
            let minimum = run(cost, v, &Start { index: 1, ..*start }, on_iteration)?;
            Ok(Minimum { started_beside: true, ..minimum })
        }
        None => {
            cost.evaluate(v, Some(&mut gradient))?;
            Ok(minimum)
        }
    }
}

/// The lowest point seen beside v along the direction of least curvature in the Krylov space of a random
/// direction (a fixed seed), if J is lower there than at v.
fn lower_beside<C: CostFunction + ?Sized>(
    cost: &mut C,
    v: &[f64],
    value: f64,
    gradient: &[f64],
) -> Option<Vec<f64>> {
    let n = v.len();
    if n == 0 {
        return None;
    }
    let beside = |p: &[f64], t: f64| -> Vec<f64> { v.iter().zip(p).map(|(v, p)| v + t * p).collect() };
    let mut curvature = |p: &[f64], out: &mut [f64]| -> Result<(), Error> {
        cost.evaluate(&beside(p, DIFFERENCE), Some(out))?;
        out.iter_mut().zip(gradient).for_each(|(out, g)| *out = (*out - g) / DIFFERENCE);
        Ok(())
    };
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let random: Vec<f64> = (0..n).map(|_| StandardNormal.sample(&mut rng)).collect();
    let mut lanczos = Lanczos::new(n);
    lanczos.begin(&random);
    for _ in 0..n.min(LOOKS) {
        lanczos.extend(&mut curvature).ok()?;
        if lanczos.invariant() {
            break;
        }
    }
    let least = lanczos.ritz().ok()?.vectors[..n].to_vec();
    let mut best = (value * (1.0 - NOISE), None);
    for t in BESIDE.into_iter().flat_map(|t| [t, -t]) {
        let trial = beside(&least, t);
        if let Ok(value) = cost.evaluate(&trial, None)
            && value < best.0
        {
            best = (value, Some(trial));
        }
    }
    best.1
}
