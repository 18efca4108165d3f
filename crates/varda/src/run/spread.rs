//! σ of the analysis at every time of window and forecast, in the state and at what is observed.

use std::borrow::Cow;

use varda_assimilation::{Carried, Squares, propagate_errors, propagate_root};
use varda_implicit::{Model, ParameterPlaces};
use varda_rod::{InternalForces, RodStep};

use super::fit::predicted;
use super::next_observation::Gathering;
use super::seen_spread::SeenSpread;
use super::shares::Given;
use super::sources::SourcesOfSpread;
use crate::Error;
use crate::outcome::{
    KnownConstants, NextObservation, ObservedValue, Rejected, Sensitivity, Sources, Trajectories,
};
use crate::scene::TimeGrid;
use crate::setup::Problem;
use crate::setup::observations::Seen;
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
    seen: SeenSpread<'a>,
    /// For each of its observations the number of what was seen.
    order: Vec<usize>,
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
        let seen = SeenSpread::new(set, &runs.analysis, runs.dim)?;
        let spread = Spread {
            states: Vec::with_capacity(runs.analysis.len()),
            seen: Vec::new(),
            forces: Vec::new(),
            known: Vec::new(),
            next: None,
            sources: Default::default(),
        };
        let further = root.and_then(|(root, length)| Gathering::new(problem, root.len() / length.max(1)));
        let constants = problem.system.estimates().len();
        let given = root.and_then(|(root, length)| Given::of(root, length, constants));
        Ok(Along { problem, runs, grid, seen, order, forces, further, given, sources: None, spread })
    }

    /// Whether columns of the step before are asked for.
    fn looks_back(&self) -> bool {
        self.forces.is_some() || self.seen.looks_back()
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
        let Self { seen, order, sources, .. } = self;
        seen.see(at, &mut |place, c, value, row| {
            if let Some(sources) = sources {
                sources.see(order[place], c, value, row);
            }
        });
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

    fn end(self) -> Result<Spread, Error> {
        let next = self.further.map(Gathering::answer).transpose()?.flatten();
        let mut seen = vec![Vec::new(); self.problem.observed.seen.len()];
        self.order.into_iter().zip(self.seen.sigma).for_each(|(i, sigma)| seen[i] = sigma);
        Ok(Spread { next, seen, ..self.spread })
    }
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
        let refused = rejected.iter().any(|r| r.label == site.label && r.step == one.step);
        let reason = match () {
            () if one.at() > grid.steps as f64 => "after the window",
            () if site.withheld => "withheld",
            () if refused => "background check",
            () => "",
        };
        let rows = set.rows(place);
        let runs = [&at_background[rows.clone()], &at_analysis[rows]];
        let sigma = spread.map_or(&[][..], |s| &s.seen[i]);
        out.extend(values_of(problem, one, runs, sigma, reason));
    }
    Ok(out)
}

/// The values of what was seen once, with H of background and analysis, and σ of the latter where it is
/// known.
pub(super) fn values_of<'a>(
    problem: &'a Problem,
    one: &'a Seen,
    [background, analysis]: [&'a [f64]; 2],
    sigma: &'a [f64],
    reason: &'static str,
) -> impl Iterator<Item = ObservedValue> + 'a {
    let (grid, site) = (&problem.experiment.grid, &problem.observed.sites[one.site]);
    one.values.iter().enumerate().filter_map(move |(c, value)| {
        Some(ObservedValue {
            time: grid.start + one.at() * grid.step,
            label: site.label.clone(),
            axis: site.quantity.axes()[c],
            unit: site.quantity.unit(),
            value: (*value)?,
            background: background[c],
            analysis: analysis[c],
            sigma: one.sigma,
            sigma_analysis: sigma.get(c).copied(),
            used: reason.is_empty(),
            reason,
        })
    })
}
