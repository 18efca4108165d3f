//! σ of the analysis at every time of window and forecast, in the state and at what is observed.

use varda_assimilation::{ObservationOperator, propagate_root};
use varda_implicit::Model;
use varda_rod::{InternalForces, RodStep};

use crate::Error;
use crate::outcome::{ObservedValue, Rejected, Trajectories};
use crate::scene::TimeGrid;
use crate::setup::Problem;
use crate::setup::observations::{Seen, observe};

/// σ of the components of every state of the analysis, one state after the other, and of every row of H at
/// the times that were seen.
pub(super) struct Spread {
    pub(super) states: Vec<f64>,
    /// For each of what was seen, σ of the rows of its site.
    seen: Vec<Vec<f64>>,
    /// σ of the forces within a rod and of its reactions, from step 1 on.
    pub(super) forces: Vec<InternalForces>,
}

/// σ of the forces within a rod, from step to step.
struct ForceSpread {
    rod: RodStep,
    /// W of the state before.
    before: Vec<f64>,
}

impl ForceSpread {
    /// Of the analysis at step k ≥ 1, W its columns there: √Σ (∂F/∂x_{k−1} w_{k−1} + ∂F/∂x_k
    /// w_k)².
    fn at(
        &mut self,
        grid: &TimeGrid,
        k: usize,
        states: [&[f64]; 2],
        w: &[f64],
    ) -> Result<InternalForces, varda_rod::Error> {
        let (mut sigma, mut squares) = (InternalForces::default(), Vec::new());
        let before = (grid.time(k - 1), states[0]);
        let mut add = |of: &mut InternalForces| {
            if squares.is_empty() {
                sigma = of.clone();
                squares.resize(of.numbers().count(), 0.0);
            }
            let mut next = squares.iter_mut();
            of.numbers().for_each(|v| *next.next().expect("as many numbers as before") += *v * *v);
        };
        self.rod.internal_forces_tangent(grid.time(k), states[1], before, [w, &self.before], &mut add)?;
        sigma.numbers().zip(squares).for_each(|(sigma, square)| *sigma = square.sqrt());
        Ok(sigma)
    }
}

/// Carries the posterior of the control along the run of the analysis; `None` where there is no root of it,
/// or the run cannot be linearized.
pub(super) fn along(
    problem: &Problem,
    model: &mut dyn Model,
    control: &[f64],
    root: &[f64],
    runs: &Trajectories,
) -> Result<Option<Spread>, Error> {
    if root.is_empty() {
        return Ok(None);
    }
    let (n, all) = (runs.dim, &problem.observed.seen);
    let mut spread = Spread {
        states: Vec::with_capacity(runs.analysis.len()),
        seen: vec![Vec::new(); all.len()],
        forces: Vec::new(),
    };
    let mut within = match problem.system.rod() {
        Some(rod) => Some(ForceSpread { rod: rod.parts.dynamics()?, before: Vec::new() }),
        None => None,
    };
    // what was seen in the order of its steps
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.sort_by_key(|i| all[*i].step);
    let mut operator = problem.observed.operator()?;
    let grid = problem.experiment.grid;
    // rows of H W of what was seen between two steps, until the later one
    let mut waiting: Vec<(usize, Vec<f64>)> = Vec::new();
    let mut next = order.iter().copied().peekable();
    let mut buffer = vec![0.0; operator.dim()];
    let done = propagate_root(model, control, root, &runs.analysis, &mut |k, w| {
        spread.states.extend(deviations(w, n));
        let state = &runs.analysis[k * n..(k + 1) * n];
        if let Some(forces) = &mut within {
            let before = k.checked_sub(1).map(|k| &runs.analysis[k * n..(k + 1) * n]);
            match before.map(|before| forces.at(&grid, k, [before, state], w)).transpose() {
                Ok(sigma) => {
                    spread.forces.extend(sigma);
                    forces.before.clear();
                    forces.before.extend_from_slice(w);
                }
                Err(_) => {
                    spread.forces.clear();
                    within = None;
                }
            }
        }
        if waiting.is_empty() && next.peek().is_none_or(|i| all[*i].step != k) {
            return Ok(());
        }
        observe(operator.as_mut(), grid.at(k), state, &mut buffer)?;
        let mut seen_through = Vec::with_capacity(w.len() / n * operator.dim());
        for column in w.chunks_exact(n) {
            operator.tangent(grid.at(k), state, column, &mut buffer);
            seen_through.extend_from_slice(&buffer);
        }
        let rows = |i: usize| -> Vec<f64> {
            let range = problem.observed.sites[all[i].site].rows.clone();
            seen_through.chunks_exact(buffer.len()).flat_map(|hw| &hw[range.clone()]).copied().collect()
        };
        for (i, before) in waiting.drain(..) {
            let weight = all[i].weight;
            let between: Vec<f64> =
                before.iter().zip(rows(i)).map(|(a, b)| (1.0 - weight) * a + weight * b).collect();
            spread.seen[i] = deviations(&between, problem.observed.sites[all[i].site].rows.len());
        }
        while let Some(i) = next.next_if(|i| all[*i].step == k) {
            let at = rows(i);
            if all[i].weight == 0.0 {
                spread.seen[i] = deviations(&at, problem.observed.sites[all[i].site].rows.len());
            } else {
                waiting.push((i, at));
            }
        }
        Ok(())
    });
    Ok(done.is_ok().then_some(spread))
}

/// Square roots of the diagonal of W Wᵀ, W with `rows` rows, by columns.
fn deviations(w: &[f64], rows: usize) -> Vec<f64> {
    let mut sum = vec![0.0; rows];
    for column in w.chunks_exact(rows) {
        sum.iter_mut().zip(column).for_each(|(s, w)| *s += w * w);
    }
    sum.into_iter().map(f64::sqrt).collect()
}

/// Everything that was seen, with background, analysis and σ beside it, in the order of time.
///
/// # Errors
/// [`Error::Assimilation`] where a state cannot be observed.
pub(super) fn observed_values(
    problem: &Problem,
    runs: &Trajectories,
    spread: Option<&Spread>,
    rejected: &[Rejected],
) -> Result<Vec<ObservedValue>, Error> {
    let grid = problem.experiment.grid;
    let mut operator = problem.observed.operator()?;
    let mut at_background = Predicted::of(operator.dim());
    let mut at_analysis = Predicted::of(operator.dim());
    let in_space = problem.observed.space.is_some();
    let mut order: Vec<usize> = (0..problem.observed.seen.len()).collect();
    let seen = &problem.observed.seen;
    order.sort_by(|a, b| seen[*a].at().total_cmp(&seen[*b].at()));
    let mut out = Vec::new();
    for i in order {
        let one = &seen[i];
        let site = &problem.observed.sites[one.site];
        let background = at_background.rows(operator.as_mut(), &grid, runs, &runs.background, one)?;
        let analysis = at_analysis.rows(operator.as_mut(), &grid, runs, &runs.analysis, one)?;
        let refused = rejected.iter().any(|r| r.label == site.label && r.step == one.step);
        let reason = match () {
            () if one.at() > grid.steps as f64 => "after the window",
            () if site.withheld => "withheld",
            () if refused => "background check",
            () => "",
        };
        for (c, value) in one.values.iter().enumerate() {
            let Some(value) = *value else { continue };
            let row = site.rows.start + c;
            out.push(ObservedValue {
                time: grid.start + one.at() * grid.step,
                label: site.label.clone(),
                axis: if in_space { ["x", "y", "z"][c] } else { "" },
                value,
                background: background[row],
                analysis: analysis[row],
                sigma: one.sigma,
                sigma_analysis: spread.and_then(|s| s.seen[i].get(c)).copied(),
                used: reason.is_empty(),
                reason,
            });
        }
    }
    Ok(out)
}

/// H along a run; keeps the rows of the last two steps.
struct Predicted {
    steps: [Option<usize>; 2],
    rows: [Vec<f64>; 2],
}

impl Predicted {
    fn of(rows: usize) -> Predicted {
        Predicted { steps: [None; 2], rows: [vec![0.0; rows], vec![0.0; rows]] }
    }

    /// All rows at the time of what was seen; NaN where the run ended before.
    fn rows(
        &mut self,
        operator: &mut dyn ObservationOperator,
        grid: &TimeGrid,
        runs: &Trajectories,
        states: &[f64],
        seen: &Seen,
    ) -> Result<Vec<f64>, Error> {
        let mut all = vec![0.0; operator.dim()];
        for (step, weight) in [(seen.step, 1.0 - seen.weight), (seen.step + 1, seen.weight)] {
            if weight == 0.0 {
                continue;
            }
            let Some(x) = runs.state(states, step) else { return Ok(vec![f64::NAN; all.len()]) };
            let slot = step % 2;
            if self.steps[slot] != Some(step) {
                observe(operator, grid.at(step), x, &mut self.rows[slot])?;
                self.steps[slot] = Some(step);
            }
            all.iter_mut().zip(&self.rows[slot]).for_each(|(sum, row)| *sum += weight * row);
        }
        Ok(all)
    }
}
