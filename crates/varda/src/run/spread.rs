//! σ of the analysis at every time of window and forecast, in the state and at what is observed.

use std::collections::BTreeMap;

use varda_assimilation::{ObservationSet, Prediction, propagate_root};
use varda_implicit::{Model, ParameterPlaces};
use varda_rod::{InternalForces, RodStep};

use super::fit::predicted;
use super::next_observation::Gathering;
use super::shares::Given;
use crate::Error;
use crate::outcome::{KnownConstants, NextObservation, ObservedValue, Rejected, Trajectories};
use crate::scene::TimeGrid;
use crate::setup::Problem;
use crate::setup::rod::RodSystem;

/// σ of the components of every state of the analysis, one state after the other, and of every row of H at
/// the times that were seen.
pub(super) struct Spread {
    pub(super) states: Vec<f64>,
    /// For each of what was seen, σ of the rows of its site.
    seen: Vec<Vec<f64>>,
    /// σ of the forces within a rod and of its reactions, from step 1 on.
    pub(super) forces: Vec<InternalForces>,
    /// σ with and without the constants known, at the start and at the end of the window.
    pub(super) known: Vec<KnownConstants>,
    /// Where one more observation would help most.
    pub(super) next: Option<NextObservation>,
}

/// σ of the forces within a rod, from step to step.
struct ForceSpread {
    rod: RodStep,
    /// Where unknown constants stand in a state, and how many of them the rod depends on.
    places: ParameterPlaces,
    constants: usize,
    /// W of the state before, without its constants.
    before: Vec<f64>,
}

impl ForceSpread {
    /// Of a rod with the constants of a state.
    fn of(rod: &RodSystem, state: &[f64]) -> Result<ForceSpread, Error> {
        let (places, constants) = (rod.parts.places()?, rod.estimates().of_rod.len());
        Ok(ForceSpread { rod: rod.with_constants_of(state)?.0, places, constants, before: Vec::new() })
    }

    /// Columns of states without their constants, and the constants of the rod in each.
    fn split(&self, columns: &[f64]) -> [Vec<f64>; 2] {
        let (own, count) = (self.places.own_dim(), columns.len() / self.places.dim());
        let (mut states, mut constants) = (vec![0.0; count * own], Vec::new());
        for (long, own) in columns.chunks_exact(self.places.dim()).zip(states.chunks_exact_mut(own)) {
            self.places.gather(long, own);
            constants.extend_from_slice(&long[self.places.parameters()][..self.constants]);
        }
        [states, constants]
    }

    /// Of the analysis at step k, from the state before and now, W its columns there:
    /// √Σ (∂F/∂x_{k−1} w_{k−1} + ∂F/∂x_k w_k + ∂F/∂p w_p)². `None` at the first step.
    fn at(
        &mut self,
        grid: &TimeGrid,
        k: usize,
        before: Option<&[f64]>,
        now: &[f64],
        w: &[f64],
    ) -> Result<Option<InternalForces>, varda_rod::Error> {
        let [dx, dp] = self.split(w);
        let dx_before = std::mem::replace(&mut self.before, dx);
        let Some(before) = before else { return Ok(None) };
        let [[before, _], [now, _]] = [before, now].map(|x| self.split(x));
        let (mut sigma, mut squares) = (InternalForces::default(), Vec::new());
        let mut add = |of: &mut InternalForces| {
            if squares.is_empty() {
                sigma = of.clone();
                squares.resize(of.numbers().count(), 0.0);
            }
            let mut next = squares.iter_mut();
            of.numbers().for_each(|v| *next.next().expect("as many numbers as before") += *v * *v);
        };
        let columns = [&self.before, &dx_before, &dp].map(Vec::as_slice);
        let before = (grid.time(k - 1), before.as_slice());
        self.rod.internal_forces_tangent(grid.time(k), &now, before, columns, &mut add)?;
        sigma.numbers().zip(squares).for_each(|(sigma, square)| *sigma = square.sqrt());
        Ok(Some(sigma))
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
    let (n, grid) = (runs.dim, problem.experiment.grid);
    let (mut set, order) = problem.observed.everything(&grid)?;
    set.follow(model.rate());
    let mut spread = Spread {
        states: Vec::with_capacity(runs.analysis.len()),
        seen: vec![Vec::new(); problem.observed.seen.len()],
        forces: Vec::new(),
        known: Vec::new(),
        next: None,
    };
    let given = Given::of(root, control.len(), problem.system.estimates().len());
    let mut further = Gathering::new(problem, root.len() / control.len().max(1));
    let mut within = match problem.system.rod() {
        Some(rod) => Some(ForceSpread::of(rod, &runs.analysis[..n])?),
        None => None,
    };
    let (mut run, mut dy) = (set.prediction(), vec![0.0; set.dim()]);
    observe_all(&mut set, runs, &mut run)?;
    // Columns of H W for the rows under way, those between two steps until the later one; and the first
    // observation that is not done.
    let (mut waiting, mut next): (BTreeMap<usize, Vec<f64>>, usize) = (BTreeMap::new(), 0);
    let done = propagate_root(model, control, root, &runs.analysis, &mut |k, w| {
        spread.states.extend(deviations(w, n));
        if let Some(further) = &mut further {
            further.see(k, n, w);
        }
        if let Some(given) = given.as_ref().filter(|_| k == 0 || k == grid.steps) {
            spread.known.extend(given.shown(problem, k, n, w));
        }
        let rows = set.rows_at(k);
        let state = &runs.analysis[k * n..(k + 1) * n];
        if let Some(forces) = &mut within {
            let before = k.checked_sub(1).map(|k| &runs.analysis[k * n..(k + 1) * n]);
            match forces.at(&grid, k, before, state, w) {
                Ok(sigma) => spread.forces.extend(sigma),
                Err(_) => {
                    spread.forces.clear();
                    within = None;
                }
            }
        }
        for (j, column) in w.chunks_exact(n).enumerate().filter(|_| !rows.is_empty()) {
            set.tangent_add(k, state, column, &run, &mut dy);
            for row in rows.clone() {
                waiting.entry(row).or_insert_with(|| vec![0.0; w.len() / n])[j] += dy[row];
                dy[row] = 0.0;
            }
        }
        while let Some(o) = set.observations().get(next).filter(|o| o.last_step() <= k) {
            let size = |row: usize| waiting.remove(&row).map_or(0.0, |w| norm(&w));
            spread.seen[order[next]] = set.rows(next).take(o.rows.len()).map(size).collect();
            next += 1;
        }
        Ok(())
    });
    if done.is_ok() {
        spread.next = further.map(Gathering::answer).transpose()?.flatten();
    }
    Ok(done.is_ok().then_some(spread))
}

/// H(x) of the analysis, as far as it ran.
fn observe_all(set: &mut ObservationSet, runs: &Trajectories, run: &mut Prediction) -> Result<(), Error> {
    for k in 0..=set.last_step().unwrap_or(0) {
        let Some(x) = runs.state(&runs.analysis, k) else { break };
        set.observe_add(k, x, run)?;
    }
    Ok(())
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
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
    model: &dyn Model,
    runs: &Trajectories,
    spread: Option<&Spread>,
    rejected: &[Rejected],
) -> Result<Vec<ObservedValue>, Error> {
    let grid = problem.experiment.grid;
    let (mut set, order) = problem.observed.everything(&grid)?;
    set.follow(model.rate());
    let at_background = predicted(&mut set, runs, &runs.background)?;
    let at_analysis = predicted(&mut set, runs, &runs.analysis)?;
    let in_space = problem.observed.space.is_some();
    let mut out = Vec::new();
    for (place, i) in order.into_iter().enumerate() {
        let one = &problem.observed.seen[i];
        let site = &problem.observed.sites[one.site];
        let rows = set.rows(place);
        let refused = rejected.iter().any(|r| r.label == site.label && r.step == one.step);
        let reason = match () {
            () if one.at() > grid.steps as f64 => "after the window",
            () if site.withheld => "withheld",
            () if refused => "background check",
            () => "",
        };
        for (c, value) in one.values.iter().enumerate() {
            let Some(value) = *value else { continue };
            let row = rows.start + c;
            out.push(ObservedValue {
                time: grid.start + one.at() * grid.step,
                label: site.label.clone(),
                axis: if in_space { ["x", "y", "z"][c] } else { "" },
                value,
                background: at_background[row],
                analysis: at_analysis[row],
                sigma: one.sigma,
                sigma_analysis: spread.and_then(|s| s.seen[i].get(c)).copied(),
                used: reason.is_empty(),
                reason,
            });
        }
    }
    Ok(out)
}
