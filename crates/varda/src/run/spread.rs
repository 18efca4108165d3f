//! σ of the analysis at every time of window and forecast, in the state and at what is observed.

use std::borrow::Cow;

use varda_assimilation::{Carried, ObservationSet, Prediction, Squares, propagate_errors, propagate_root};
use varda_implicit::{Model, ParameterPlaces};
use varda_rod::{InternalForces, RodStep};

use super::fit::predicted;
use super::next_observation::Gathering;
use super::shares::Given;
use super::sources::SourcesOfSpread;
use crate::Error;
use crate::outcome::{
    KnownConstants, NextObservation, ObservedValue, Rejected, Sensitivity, Sources, Trajectories,
};
use crate::scene::TimeGrid;
use crate::setup::Problem;
use crate::setup::rod::RodSystem;
use crate::solve::{PosteriorSpread, forcing};

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
    /// What the uncertainty of some numbers of the run comes from, and how they depend on observed values.
    pub(super) sources: (Vec<Sources>, Vec<Sensitivity>),
}

/// σ of the forces within a rod, from step to step.
pub(super) struct ForceSpread {
    rod: RodStep,
    /// Where unknown constants stand in a state, and how many of them the rod depends on.
    places: ParameterPlaces,
    constants: usize,
}

impl ForceSpread {
    /// Of a rod with the constants of a state.
    pub(super) fn of(rod: &RodSystem, state: &[f64]) -> Result<ForceSpread, Error> {
        let (places, constants) = (rod.parts.places()?, rod.estimates().of_rod.len());
        Ok(ForceSpread { rod: rod.with_constants_of(state)?.0, places, constants })
    }

    /// Columns of states without their constants, and the constants of the rod in each.
    fn split<'c>(&self, columns: &'c [f64]) -> (Cow<'c, [f64]>, Vec<f64>) {
        if self.places.own_dim() == self.places.dim() {
            return (Cow::Borrowed(columns), Vec::new());
        }
        let (own, count) = (self.places.own_dim(), columns.len() / self.places.dim());
        let (mut states, mut constants) = (vec![0.0; count * own], Vec::new());
        for (long, own) in columns.chunks_exact(self.places.dim()).zip(states.chunks_exact_mut(own)) {
            self.places.gather(long, own);
            constants.extend_from_slice(&long[self.places.parameters()][..self.constants]);
        }
        (Cow::Owned(states), constants)
    }

    /// Of the analysis at a step, from the states before and now, W their columns:
    /// √Σ (∂F/∂x_{k−1} w_{k−1} + ∂F/∂x_k w_k + ∂F/∂p w_p)².
    fn at(
        &mut self,
        grid: &TimeGrid,
        at: &Carried,
        before: &[f64],
        now: &[f64],
    ) -> Result<InternalForces, varda_rod::Error> {
        let [(dx_before, _), (dx, dp)] = [at.before, at.now].map(|w| self.split(w));
        let [(before, _), (now, _)] = [before, now].map(|x| self.split(x));
        let mut sums: Option<(InternalForces, Squares)> = None;
        let mut add = |of: &mut InternalForces| {
            let first = || (of.clone(), at.squares(of.clone().numbers().count()));
            sums.get_or_insert_with(first).1.add(of.numbers().map(|v| *v));
        };
        let before = (grid.time(at.step - 1), &before[..]);
        self.rod.internal_forces_tangent(
            grid.time(at.step),
            &now,
            before,
            [&dx, &dx_before, &dp],
            &mut add,
        )?;
        let Some((mut sigma, squares)) = sums else { return Ok(InternalForces::default()) };
        sigma.numbers().zip(squares.end()).for_each(|(sigma, square)| *sigma = square.sqrt());
        Ok(sigma)
    }
}

impl ForceSpread {
    /// The segment with the largest tension at a step, and what columns of the states do to it.
    pub(super) fn tightest(
        &mut self,
        grid: &TimeGrid,
        at: &Carried,
        before: &[f64],
        now: &[f64],
    ) -> Result<(usize, Vec<f64>), varda_rod::Error> {
        let [(dx_before, _), (dx, dp)] = [at.before, at.now].map(|w| self.split(w));
        let [(before, _), (now, _)] = [before, now].map(|x| self.split(x));
        let (t, before) = (grid.time(at.step), (grid.time(at.step - 1), &before[..]));
        let tension = self.rod.internal_forces(t, &now, before)?.tension;
        let edge = (0..tension.len()).max_by(|a, b| tension[*a].total_cmp(&tension[*b])).unwrap_or(0);
        let mut row = Vec::new();
        let mut see = |of: &mut InternalForces| row.push(of.tension[edge]);
        self.rod.internal_forces_tangent(t, &now, before, [&dx, &dx_before, &dp], &mut see)?;
        Ok((edge, row))
    }
}

/// Carries a posterior along the run of the analysis; `None` where it has no root, or the run cannot be
/// linearized.
pub(super) fn along(
    problem: &Problem,
    model: &mut dyn Model,
    (control, posterior): (&[f64], Option<&PosteriorSpread>),
    runs: &Trajectories,
    rejected: &[Rejected],
    is_one_of_several: bool,
) -> Result<Option<Spread>, Error> {
    let Some(posterior) = posterior else { return Ok(None) };
    if let (Some(columns), Some(q)) = (&posterior.with_errors, &problem.model_error) {
        let mut along = Along::new(problem, model, runs, None)?;
        let forcing = forcing(problem.experiment.scene.algorithm.model_error.as_ref(), control.len());
        let errors = (&forcing, q.as_ref());
        let done = propagate_errors(model, columns, errors, &runs.analysis, &mut |at| {
            along.see(at);
            Ok(())
        });
        return if done.is_ok() { along.end().map(Some) } else { Ok(None) };
    }
    let root = &posterior.root;
    if root.is_empty() {
        return Ok(None);
    }
    let mut along = Along::new(problem, model, runs, Some((root, control.len())))?;
    let columns = root.len() / control.len().max(1);
    along.sources = SourcesOfSpread::new(problem, rejected, columns, is_one_of_several);
    let mut before: Vec<f64> = Vec::new();
    let done = propagate_root(model, control, root, &runs.analysis, &mut |step, now| {
        along.see(&Carried { step, dim: runs.dim, before: &before, now, less: 0 });
        if along.looks_back() {
            before.clear();
            before.extend_from_slice(now);
        }
        Ok(())
    });
    if done.is_err() {
        return Ok(None);
    }
    let sources = along.sources.take().map(|sources| sources.answer(control, root));
    Ok(Some(Spread { sources: sources.unwrap_or_default(), ..along.end()? }))
}

/// What is gathered at every step.
struct Along<'a> {
    problem: &'a Problem,
    runs: &'a Trajectories,
    grid: TimeGrid,
    set: ObservationSet,
    /// For each of the observations the number of what was seen.
    order: Vec<usize>,
    /// H(x) of the analysis.
    run: Prediction,
    /// The first observation that is not done.
    next: usize,
    forces: Option<ForceSpread>,
    further: Option<Gathering>,
    given: Option<Given>,
    sources: Option<SourcesOfSpread<'a>>,
    spread: Spread,
}

impl<'a> Along<'a> {
    /// A root of the posterior with the length of its columns, if it has one.
    fn new(
        problem: &'a Problem,
        model: &dyn Model,
        runs: &'a Trajectories,
        root: Option<(&[f64], usize)>,
    ) -> Result<Self, Error> {
        let grid = problem.experiment.grid;
        let (mut set, order) = problem.observed.everything(&grid)?;
        set.follow(model.rate());
        let forces = match problem.system.rod() {
            Some(rod) => Some(ForceSpread::of(rod, &runs.analysis[..runs.dim])?),
            None => None,
        };
        let mut run = set.prediction();
        observe_all(&mut set, runs, &mut run)?;
        let spread = Spread {
            states: Vec::with_capacity(runs.analysis.len()),
            seen: vec![Vec::new(); problem.observed.seen.len()],
            forces: Vec::new(),
            known: Vec::new(),
            next: None,
            sources: Default::default(),
        };
        let further = root.and_then(|(root, length)| Gathering::new(problem, root.len() / length.max(1)));
        let constants = problem.system.estimates().len();
        let given = root.and_then(|(root, length)| Given::of(root, length, constants));
        Ok(Along {
            problem,
            runs,
            grid,
            set,
            order,
            run,
            next: 0,
            forces,
            further,
            given,
            sources: None,
            spread,
        })
    }

    /// Whether columns of the step before are asked for.
    fn looks_back(&self) -> bool {
        self.forces.is_some() || self.set.observations()[self.next..].iter().any(|o| o.step < o.last_step())
    }

    fn see(&mut self, at: &Carried) {
        let k = at.step;
        self.spread.states.extend(at.variance().into_iter().map(f64::sqrt));
        if let Some(further) = &mut self.further {
            further.see(k, at.dim, at.now);
        }
        if let Some(given) = self.given.as_ref().filter(|_| k == 0 || k == self.grid.steps) {
            self.spread.known.extend(given.shown(self.problem, k, at.dim, at.now));
        }
        if let (Some(forces), Some(before)) = (&mut self.forces, k.checked_sub(1)) {
            let [before, now] = [before, k].map(|k| &self.runs.analysis[k * at.dim..(k + 1) * at.dim]);
            match forces.at(&self.grid, at, before, now) {
                Ok(sigma) => self.spread.forces.push(sigma),
                Err(_) => {
                    self.spread.forces.clear();
                    self.forces = None;
                }
            }
        }
        self.observe(at);
        if let Some(sources) = self.sources.as_mut().filter(|_| k == self.grid.steps) {
            sources.end(at.dim, at.now);
            if let (Some(forces), Some(before)) = (&mut self.forces, k.checked_sub(1)) {
                let [before, now] = [before, k].map(|k| &self.runs.analysis[k * at.dim..(k + 1) * at.dim]);
                if let Ok((edge, row)) = forces.tightest(&self.grid, at, before, now) {
                    let when = self.grid.time(k);
                    sources.add(format!("tension of segment {edge}, t = {when:.4} s"), "N", row);
                }
            }
        }
    }

    /// σ of the rows whose observations end at this step.
    fn observe(&mut self, at: &Carried) {
        let (k, n, first) = (at.step, at.dim, self.next);
        let Self { set, run, runs, .. } = self;
        let ended = |o: &&varda_assimilation::Observation| o.last_step() <= k;
        let count = set.observations()[first..].iter().take_while(ended).count();
        if count == 0 {
            return;
        }
        let looks_back = set.observations()[first..first + count].iter().any(|o| o.step < k);
        let rows = set.rows(first).start..set.rows(first + count - 1).end;
        let (mut dy, mut values) = (vec![0.0; set.dim()], Vec::new());
        for (c, column) in at.now.chunks_exact(n).enumerate() {
            if looks_back {
                let (before, k) = (&at.before[c * n..(c + 1) * n], k - 1);
                set.tangent_add(k, &runs.analysis[k * n..(k + 1) * n], before, run, &mut dy);
            }
            set.tangent_add(k, &runs.analysis[k * n..(k + 1) * n], column, run, &mut dy);
            values.extend_from_slice(&dy[rows.clone()]);
            for k in [k.saturating_sub(1), k] {
                dy[set.rows_at(k)].fill(0.0);
            }
        }
        let squares = at.sum_of_squares(rows.len(), values.chunks_exact(rows.len().max(1)));
        for i in first..first + count {
            let own = set.observations()[i].rows.len();
            let size = |row: usize| squares[row - rows.start].sqrt();
            self.spread.seen[self.order[i]] = set.rows(i).take(own).map(size).collect();
            if let Some(sources) = &mut self.sources {
                for (c, row) in set.rows(i).take(own).enumerate() {
                    let of_row = values.chunks_exact(rows.len()).map(|column| column[row - rows.start]);
                    sources.see(self.order[i], c, run.values()[row], of_row);
                }
            }
        }
        self.next += count;
    }

    fn end(self) -> Result<Spread, Error> {
        let next = self.further.map(Gathering::answer).transpose()?.flatten();
        Ok(Spread { next, ..self.spread })
    }
}

/// H(x) of the analysis, as far as it ran.
fn observe_all(set: &mut ObservationSet, runs: &Trajectories, run: &mut Prediction) -> Result<(), Error> {
    for k in 0..=set.last_step().unwrap_or(0) {
        let Some(x) = runs.state(&runs.analysis, k) else { break };
        set.observe_add(k, x, run)?;
    }
    Ok(())
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
                axis: site.quantity.axes()[c],
                unit: site.quantity.unit(),
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
