//! What an observation between two steps costs: H(x) is that of a cubic there, or a straight line.

use std::collections::HashMap;

use varda_assimilation::ObservationSet;

use crate::Error;
use crate::outcome::Trajectories;
use crate::setup::Problem;
use crate::setup::observations::observe;

/// A curve that is off by more than this many σ is said.
const SEEN: f64 = 0.5;

/// How far the curves of H(x) between the steps of the analysis are from the motion, where that can be seen.
/// At a fraction w of a step a straight line is off by ½ w (1 − w) |Δ²H|, a cubic through states and
/// rates by w² (1 − w)² |Δ⁴H|/24, with Δ²H and Δ⁴H the differences of H at steps: (ωΔt)²/8
/// and (ωΔt)⁴/384 of the amplitude of an oscillation in the middle of a step. An analysis makes up
/// for it by an amplitude that is too large, and fits well.
///
/// # Errors
/// [`Error::Assimilation`] where the analysis cannot be observed.
pub(super) fn remark(
    problem: &Problem,
    observations: &ObservationSet,
    runs: &Trajectories,
) -> Result<Option<String>, Error> {
    let between = || observations.observations().iter().filter(|o| o.weight > 0.0);
    if between().next().is_none() || runs.dim == 0 {
        return Ok(None);
    }
    let mut operator = problem.observed.operator()?;
    let grid = &problem.experiment.grid;
    let mut seen = HashMap::new();
    let mut predicted = |k: usize| -> Result<Option<Vec<f64>>, Error> {
        if let Some(known) = seen.get(&k) {
            return Ok(Clone::clone(known));
        }
        let found = match runs.state(&runs.analysis, k) {
            Some(x) => {
                let mut y = vec![0.0; operator.dim()];
                observe(operator.as_mut(), grid.at(k), x, &mut y)?;
                Some(y)
            }
            None => None,
        };
        seen.insert(k, found.clone());
        Ok(found)
    };
    let (order, curve) = if observations.is_cubic() { (4, "cubic") } else { (2, "straight line") };
    let (mut worst, mut time, mut label, mut count) = (0.0_f64, 0.0, String::new(), 0);
    for o in between() {
        // The two differences about the step, or the one that there is.
        let first = o.step.saturating_sub(order / 2);
        let states = (first..first + order + 2).map(&mut predicted).collect::<Result<Vec<_>, _>>()?;
        let known: Vec<&Vec<f64>> = states.iter().map_while(Option::as_ref).collect();
        if known.len() <= order {
            continue;
        }
        let both = known.len() > order + 1 && o.step >= order / 2;
        let inside = o.weight * (1.0 - o.weight);
        for (row, sigma) in o.rows.iter().zip(&o.sigma) {
            let values: Vec<f64> = known.iter().map(|y| y[*row]).collect();
            let before = difference(&values[..=order]);
            let after = if both { difference(&values[1..]) } else { before };
            let mean = 0.5 * (before + after).abs() / sigma;
            let off = if order == 4 { inside * inside / 24.0 } else { 0.5 * inside } * mean;
            count += usize::from(off > SEEN);
            if off > worst {
                (worst, time) = (off, grid.start + (o.step as f64 + o.weight) * grid.step);
                label.clone_from(&o.label);
            }
        }
    }
    Ok((worst > SEEN).then(|| {
        format!(
            "{count} observed values lie between two steps where a {curve} is off by more than \
             {SEEN} sigma, at most {worst:.1} ({label}, {time:.4} s): amplitudes come out too large, with a \
             good fit; take steps that end at the observations, or smaller ones"
        )
    }))
}

/// The difference of as high an order as values allow.
fn difference(values: &[f64]) -> f64 {
    match values {
        [] => 0.0,
        [one] => *one,
        _ => difference(&values[1..]) - difference(&values[..values.len() - 1]),
    }
}
