//! What an observation between two steps costs: H(x) is a straight line there.

use std::collections::HashMap;

use varda_assimilation::ObservationSet;

use crate::Error;
use crate::outcome::Trajectories;
use crate::setup::Problem;
use crate::setup::observations::observe;

/// A line that is off by more than this many σ is said.
const SEEN: f64 = 0.5;

/// How far the straight lines of H(x) between the steps of the analysis are from the curve through its
/// steps, where that can be seen: at a fraction w of a step the chord is off by ½ w (1 − w) |Δ²H|,
/// with Δ²H the second difference; (ωΔt)²/8 of the amplitude of an oscillation in the middle of a
/// step. An analysis makes up for it by an amplitude that is too large, and fits well.
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
    let (mut worst, mut time, mut label, mut count) = (0.0_f64, 0.0, String::new(), 0);
    for o in between() {
        // The two second differences about the step, or the one that there is.
        let first = o.step.saturating_sub(1);
        let states = [first, first + 1, first + 2, first + 3].map(&mut predicted);
        let [a, b, c, d] = states;
        let (Some(a), Some(b), Some(c)) = (a?, b?, c?) else { continue };
        let d = if o.step == 0 { None } else { d? };
        for (row, sigma) in o.rows.iter().zip(&o.sigma) {
            let (row, before) = (*row, a[*row] - 2.0 * b[*row] + c[*row]);
            let after = d.as_ref().map_or(before, |d| b[row] - 2.0 * c[row] + d[row]);
            let off = 0.25 * o.weight * (1.0 - o.weight) * (before + after).abs() / sigma;
            count += usize::from(off > SEEN);
            if off > worst {
                (worst, time) = (off, grid.start + (o.step as f64 + o.weight) * grid.step);
                label.clone_from(&o.label);
            }
        }
    }
    Ok((worst > SEEN).then(|| {
        format!(
            "{count} observed values lie between two steps where a straight line is off by more than \
             {SEEN} sigma, at most {worst:.1} ({label}, {time:.4} s): amplitudes come out too large, with a \
             good fit; take steps that end at the observations, or smaller ones"
        )
    }))
}
