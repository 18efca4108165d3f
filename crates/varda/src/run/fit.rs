//! How well the analysis fits: innovations against the assumed σ, markers kept back, forecasts beside
//! simpler ones.

use std::collections::HashMap;
use std::ops::Range;

use varda_assimilation::{Observation, ObservationOperator, ObservationSet};
use varda_implicit::{At, Model, Rate};

use super::departures::{Departure, Surroundings};
use crate::Error;
use crate::outcome::{Distance, Fit, Forecast, ObservedValue, Quantity, Trajectories, Withheld};
use crate::scene::TimeGrid;
use crate::setup::Problem;
use crate::setup::observations::{MakeOperator, Observed, Site, observe};

/// Innovations at background and analysis, label by label in the order of their first appearance.
///
/// # Errors
/// [`Error::Assimilation`] where a state cannot be observed.
pub(crate) fn fit(
    observed: &Observed,
    observations: &mut ObservationSet,
    runs: &Trajectories,
) -> Result<Vec<Fit>, Error> {
    let quantities: HashMap<&str, Quantity> =
        observed.sites.iter().map(|site| (site.label.as_str(), site.quantity)).collect();
    let at_background = innovations(observations, runs, &runs.background)?;
    let at_analysis = innovations(observations, runs, &runs.analysis)?;
    let mut labels: Vec<(&str, Vec<usize>)> = Vec::new();
    let mut places = HashMap::new();
    for (i, o) in observations.observations().iter().enumerate() {
        let place = *places.entry(o.label.as_str()).or_insert_with(|| {
            labels.push((&o.label, Vec::new()));
            labels.len() - 1
        });
        labels[place].1.extend(observations.rows(i));
    }
    let of_label = |(label, rows): &(&str, Vec<usize>)| {
        let sigma = observations.sigma();
        let mean = |f: &dyn Fn(usize) -> f64| rows.iter().map(|&r| f(r)).sum::<f64>() / rows.len() as f64;
        Fit {
            label: label.to_string(),
            quantity: quantities.get(label).copied().unwrap_or(Quantity::Component),
            count: rows.len(),
            sigma: mean(&|r| sigma[r].powi(2)).sqrt(),
            rms_background: mean(&|r| at_background[r].powi(2)).sqrt(),
            rms_analysis: mean(&|r| at_analysis[r].powi(2)).sqrt(),
            mean_analysis: mean(&|r| at_analysis[r]),
            ratio: mean(&|r| (at_analysis[r] / sigma[r]).powi(2)).sqrt(),
            information: None,
        }
    };
    Ok(labels.iter().map(of_label).collect())
}

/// Adds what the values of each marker, place or component brought: their shares of tr(H P_a Hᵀ R⁻¹),
/// the degrees of freedom for signal (Cardinali, Pezzulli and Andersson 2004). Values that were refused, kept
/// back or seen later brought nothing.
pub(super) fn add_information(fits: &mut [Fit], observed: &[ObservedValue]) {
    let mut sums: HashMap<&str, Option<f64>> = HashMap::new();
    for o in observed.iter().filter(|o| o.used) {
        let sum = sums.entry(&o.label).or_insert(Some(0.0));
        *sum = sum.zip(o.sigma_analysis).map(|(sum, s)| sum + (s / o.sigma).powi(2));
    }
    for fit in fits {
        fit.information = sums.get(fit.label.as_str()).copied().unwrap_or(Some(0.0));
    }
}

/// d = y − H(x) of a run; NaN where it ended early.
pub(crate) fn innovations(
    observations: &mut ObservationSet,
    runs: &Trajectories,
    states: &[f64],
) -> Result<Vec<f64>, Error> {
    let mut d = vec![f64::NAN; observations.dim()];
    // A run that ended early has no innovations; its warning says so.
    if runs.state(states, observations.last_step().unwrap_or(0)).is_some() {
        let predicted = predicted(observations, runs, states)?;
        observations.innovations(&predicted, &mut d);
    }
    Ok(d)
}

/// H(x) of a run; NaN from where it ended early.
///
/// # Errors
/// [`Error::Assimilation`] where a state cannot be observed.
pub(super) fn predicted(
    observations: &mut ObservationSet,
    runs: &Trajectories,
    states: &[f64],
) -> Result<Vec<f64>, Error> {
    let mut prediction = observations.prediction();
    for k in 0..=observations.last_step().unwrap_or(0) {
        let Some(x) = runs.state(states, k) else { break };
        observations.observe_add(k, x, &mut prediction)?;
    }
    let mut predicted = prediction.values().to_vec();
    for (i, o) in observations.observations().iter().enumerate() {
        if runs.state(states, o.last_step()).is_none() {
            predicted[observations.rows(i)].fill(f64::NAN);
        }
    }
    Ok(predicted)
}

/// What was observed less what the analysis says, value by value.
pub(crate) struct Departures {
    /// Of values at sites in the order of `labels`; none where the run of the analysis ended early.
    pub(crate) values: Vec<Departure>,
    /// Names of the sites; in space in the order of arc length.
    pub(crate) labels: Vec<String>,
    /// The camera of each of them.
    pub(crate) cameras: Vec<Option<String>>,
    /// Of a rod.
    pub(crate) surroundings: Option<Surroundings>,
}

/// The departures at the analysis; of correlated errors what each value says beyond those before it.
///
/// # Errors
/// [`Error::Assimilation`] where a state cannot be observed.
pub(crate) fn departures(
    problem: &Problem,
    observations: &mut ObservationSet,
    runs: &Trajectories,
) -> Result<Departures, Error> {
    let d = innovations(observations, runs, &runs.analysis)?;
    let d = uncorrelated(observations, d);
    if !d.iter().all(|d| d.is_finite()) {
        return Ok(Departures {
            values: Vec::new(),
            labels: Vec::new(),
            cameras: Vec::new(),
            surroundings: None,
        });
    }
    let mut shifted = |by: isize| -> Result<Vec<f64>, Error> {
        let mut predicted = observations.prediction();
        for k in 0..=observations.last_step().unwrap_or(0) {
            let there = k.saturating_add_signed(by);
            let state = runs.state(&runs.analysis, there).or_else(|| runs.state(&runs.analysis, k));
            if let Some(x) = state {
                observations.observe_add(k, x, &mut predicted)?;
            }
        }
        Ok(predicted.values().to_vec())
    };
    let (before, predicted, after) = (shifted(-1)?, shifted(0)?, shifted(1)?);
    let grid = &problem.experiment.grid;
    let (sites, space) = (&problem.observed.sites, problem.observed.space.as_ref());
    // in space the sites stand in the order of arc length, those of each camera together
    let mut order: Vec<usize> = (0..sites.len()).collect();
    if let Some(space) = space {
        let along = |a: &usize, b: &usize| space.arc_lengths[*a].total_cmp(&space.arc_lengths[*b]);
        order.sort_by(|a, b| sites[*a].camera.cmp(&sites[*b].camera).then(along(a, b)));
    }
    let rows = sites.iter().map(|site| site.rows.end).max().unwrap_or(0);
    let mut site_of = vec![None; rows];
    order.iter().enumerate().rev().for_each(|(i, s)| site_of[sites[*s].rows.clone()].fill(Some(i)));
    let sigma = observations.sigma().to_vec();
    let mut departures = Vec::with_capacity(d.len());
    for (i, o) in observations.observations().iter().enumerate() {
        for (row, h_row) in observations.rows(i).zip(&o.rows) {
            let Some(site) = site_of.get(*h_row).copied().flatten() else { continue };
            let ahead = runs.state(&runs.analysis, o.step + 2).is_some();
            let change = if ahead { after[row] - predicted[row] } else { predicted[row] - before[row] };
            departures.push(Departure {
                site,
                quantity: sites[order[site]].quantity,
                axis: h_row - sites[order[site]].rows.start,
                time: grid.time(o.step) + o.weight * grid.step,
                value: d[row],
                sigma: sigma[row],
                predicted: predicted[row],
                rate: change / grid.step,
            });
        }
    }
    let labels: Vec<String> = order.iter().map(|s| sites[*s].label.clone()).collect();
    Ok(Departures {
        values: departures,
        labels,
        cameras: order.iter().map(|s| sites[*s].camera.clone()).collect(),
        surroundings: surroundings(problem),
    })
}

/// Departures with the correlation of their errors taken out, R^{-1/2} d in σ of each: what each says beyond
/// those before it in its chain.
fn uncorrelated(observations: &ObservationSet, mut d: Vec<f64>) -> Vec<f64> {
    if observations.is_correlated() {
        observations.whiten(&mut d);
        d.iter_mut().zip(observations.sigma()).for_each(|(d, sigma)| *d *= sigma);
    }
    d
}

/// Gravity and the held points of a rod, in the axes of what was observed; neither where that is an image.
fn surroundings(problem: &Problem) -> Option<Surroundings> {
    let (rod, space) = (problem.system.rod()?, problem.observed.space.as_ref()?);
    if problem.observed.sites.iter().any(|site| site.quantity != Quantity::Place) {
        return Some(Surroundings::default());
    }
    let turned = |x: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|i| (0..3).map(|j| space.rotation[j][i] * x[j]).sum())
    };
    let parts = &rod.parts;
    let gravity = parts.loads.gravity.norm();
    let up = (gravity > 0.0).then(|| turned((parts.loads.gravity / -gravity).into()));
    let t = problem.experiment.grid.start;
    let clamps = [&parts.supports.start, &parts.supports.end].into_iter().flatten();
    let held = clamps.map(|clamp| turned(clamp.position.at(t).into()));
    Some(Surroundings { up, pivots: held.chain([[0.0; 3]]).collect() })
}

/// The errors of the analysis at markers that were kept back, and of its forecast after the window. Nothing
/// for models that are not in space.
///
/// # Errors
/// [`Error::Assimilation`] where a marker has no place in a state, [`Error::Preparation`] where the rod has
/// no static equilibrium.
pub(crate) fn beyond(
    problem: &Problem,
    runs: &Trajectories,
    model: &mut dyn Model,
) -> Result<(Vec<Withheld>, Vec<Forecast>), Error> {
    let (mut withheld, mut forecasts) = (Vec::new(), Vec::new());
    let (Some(rod), Some(space)) = (problem.system.rod(), &problem.observed.space) else {
        return Ok((withheld, forecasts));
    };
    let grid = &problem.experiment.grid;
    let end = grid.steps as f64;
    let observed = &problem.observed;
    let mut at_rest = None;
    for (make_operator, seen) in whole(observed, &space.make_places) {
        let mut beside = Beside::of(make_operator, seen, grid, model.rate())?;
        let at_background = beside.along(runs, &runs.background)?;
        let at_analysis = beside.along(runs, &runs.analysis)?;
        if at_rest.is_none() && beside.seen.iter().any(|s| s.at() > end) {
            let control = rod.control_at_rest(&rod.parts.at_rest(grid.time(grid.steps))?)?;
            let mut state = vec![0.0; model.dim()];
            model.initial_state(&control, &mut state)?;
            at_rest = Some(state);
        }
        let mut of_sites = vec![Vec::new(); observed.sites.len()];
        beside.seen.iter().enumerate().for_each(|(j, seen)| of_sites[seen.site].push(j));
        for (site, of_site) in observed.sites.iter().zip(of_sites) {
            let (inside, after): (Vec<usize>, Vec<usize>) =
                of_site.into_iter().partition(|j| beside.seen[*j].at() <= end);
            // A run that ended early has NaN for an error; its warning says so.
            let miss = |predicted: &[Vec<f64>], seen: &[usize]| {
                let error = |j: &usize| less(&beside.seen[*j].values, &predicted[*j]);
                MeanErrors::of(&seen.iter().map(error).collect::<Vec<_>>())
            };
            if site.withheld && !inside.is_empty() {
                let analysis = miss(&at_analysis, &inside);
                withheld.push(Withheld {
                    label: site.label.clone(),
                    quantity: site.quantity,
                    count: inside.len(),
                    rms_background: miss(&at_background, &inside).rms,
                    rms_analysis: analysis.rms,
                    moving_analysis: analysis.moving,
                });
            }
            let (Some(first), Some(at_rest)) = (after.first(), &at_rest) else { continue };
            let rows = beside.seen[*first].rows.clone();
            let analysis = miss(&at_analysis, &after);
            let background = miss(&at_background, &after);
            let seen = &beside.seen;
            let time = |at: f64| grid.start + at * grid.step;
            // what stays as it was at a time
            let constant = |q: &[f64], from: f64| {
                let error = |j: &usize| {
                    let (seen, q) =
                        (&seen[*j], observed.as_from(q, seen[*j].site, [from, time(seen[*j].at())]));
                    less(&seen.values, &q)
                };
                MeanErrors::of(&after.iter().map(error).collect::<Vec<_>>())
            };
            let last = inside.last().map(|j| constant(&seen[*j].values, time(seen[*j].at())).rms);
            let end = grid.at(grid.steps);
            let still = constant(&still(beside.operator.as_mut(), end, at_rest, rows)?, end.time);
            forecasts.push(Forecast {
                label: site.label.clone(),
                quantity: site.quantity,
                assimilated: !site.withheld,
                count: after.len(),
                analysis: analysis.rms,
                background: background.rms,
                persistence: last.unwrap_or(f64::NAN),
                static_model: still.rms,
                moving_analysis: analysis.moving,
                moving_constant: still.moving,
            });
        }
    }
    Ok((withheld, forecasts))
}

/// How far a run is from what was seen, site by site, markers that are kept back included.
///
/// # Errors
/// [`Error::Assimilation`] where a state cannot be observed.
pub(crate) fn distances(
    problem: &Problem,
    runs: &Trajectories,
    model: &dyn Model,
) -> Result<Vec<Distance>, Error> {
    let (observed, grid) = (&problem.observed, &problem.experiment.grid);
    let mut sums = vec![(0, 0.0); observed.sites.len()];
    if let Some(space) = &observed.space {
        for (make_operator, seen) in whole(observed, &space.make_places) {
            let mut beside = Beside::of(make_operator, seen, grid, model.rate())?;
            let predicted = beside.along(runs, &runs.analysis)?;
            for (seen, predicted) in beside.seen.iter().zip(predicted) {
                let sum = &mut sums[seen.site];
                sum.0 += 1;
                sum.1 += less(&seen.values, &predicted).iter().map(|d| d * d).sum::<f64>();
            }
        }
    } else {
        let mut observations = observed.set(grid)?;
        observations.follow(model.rate());
        let d = innovations(&mut observations, runs, &runs.analysis)?;
        for (i, o) in observations.observations().iter().enumerate() {
            let Some(site) = observed.sites.iter().position(|site| site.label == o.label) else { continue };
            sums[site].0 += observations.rows(i).len();
            sums[site].1 += d[observations.rows(i)].iter().map(|d| d * d).sum::<f64>();
        }
    }
    let of_site = |(site, (count, sum)): (&Site, (usize, f64))| Distance {
        label: site.label.clone(),
        quantity: site.quantity,
        count,
        rms: (sum / count as f64).sqrt(),
    };
    Ok(observed.sites.iter().zip(sums).filter(|(_, sum)| sum.0 > 0).map(of_site).collect())
}

/// What was seen whole: places, and what cameras saw, each with the operator for it.
fn whole<'a>(observed: &'a Observed, make_places: &'a MakeOperator) -> Vec<(&'a MakeOperator, Vec<Whole>)> {
    let is_place = |i: usize| observed.sites[i].quantity == Quantity::Place;
    let of_places = observed.sights().into_iter().map(|s| Whole {
        site: s.site,
        rows: 3 * s.site..3 * s.site + 3,
        step: s.step,
        weight: s.weight,
        values: s.position.to_vec(),
        sigma: s.sigma,
    });
    let of_images = observed.seen.iter().filter(|s| !is_place(s.site)).filter_map(|s| {
        let values = s.values.iter().copied().collect::<Option<_>>()?;
        let rows = observed.sites[s.site].rows.clone();
        Some(Whole { site: s.site, rows, step: s.step, weight: s.weight, values, sigma: s.sigma })
    });
    let kinds =
        [(make_places, of_places.collect()), (&observed.make_operator, of_images.collect::<Vec<_>>())];
    kinds.into_iter().filter(|(_, seen): &(_, Vec<Whole>)| !seen.is_empty()).collect()
}

/// All values of a site at one time.
struct Whole {
    site: usize,
    /// Its rows of the operator.
    rows: Range<usize>,
    step: usize,
    weight: f64,
    values: Vec<f64>,
    sigma: f64,
}

impl Whole {
    /// Time within the window, in steps.
    fn at(&self) -> f64 {
        self.step as f64 + self.weight
    }
}

/// What was seen whole within window and forecast, in the order of time, and an operator for it.
struct Beside {
    operator: Box<dyn ObservationOperator>,
    seen: Vec<Whole>,
    set: ObservationSet,
}

impl Beside {
    fn of(
        make_operator: &MakeOperator,
        mut seen: Vec<Whole>,
        grid: &TimeGrid,
        rate: Option<Box<dyn Rate>>,
    ) -> Result<Beside, Error> {
        seen.retain(|s| s.at() <= grid.last_step() as f64);
        seen.sort_by(|a, b| a.step.cmp(&b.step).then(a.weight.total_cmp(&b.weight)));
        let observation = |s: &Whole| {
            Observation::new(s.step, s.rows.clone().collect(), s.values.clone(), s.sigma).between(s.weight)
        };
        let observations = seen.iter().map(observation).collect();
        let mut set = ObservationSet::on_times(grid.times(), vec![make_operator()?], observations)?;
        set.follow(rate);
        Ok(Beside { operator: make_operator()?, seen, set })
    }

    /// What a run has where and when sites were seen; NaN where the run ended before.
    fn along(&mut self, runs: &Trajectories, states: &[f64]) -> Result<Vec<Vec<f64>>, Error> {
        let predicted = predicted(&mut self.set, runs, states)?;
        Ok((0..self.seen.len()).map(|i| predicted[self.set.rows(i)].to_vec()).collect())
    }
}

/// Some rows of a state; NaN where it cannot be observed.
fn still(
    operator: &mut dyn ObservationOperator,
    at: At,
    state: &[f64],
    rows: Range<usize>,
) -> Result<Vec<f64>, Error> {
    let mut values = vec![f64::NAN; operator.dim()];
    match observe(operator, at, state, &mut values) {
        Ok(()) => Ok(values[rows].to_vec()),
        Err(varda_assimilation::Error::Observe { .. }) => Ok(vec![f64::NAN; rows.len()]),
        Err(error) => Err(error.into()),
    }
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Root mean square of some error vectors, with their mean and without it.
struct MeanErrors {
    rms: f64,
    moving: f64,
}

impl MeanErrors {
    fn of(errors: &[Vec<f64>]) -> MeanErrors {
        let (n, width) = (errors.len() as f64, errors.first().map_or(0, Vec::len));
        let mean: Vec<f64> = (0..width).map(|i| errors.iter().map(|e| e[i]).sum::<f64>() / n).collect();
        let rms = |about: &[f64]| {
            let squares = errors.iter().flat_map(|e| e.iter().zip(about).map(|(e, a)| (e - a).powi(2)));
            (squares.sum::<f64>() / n).sqrt()
        };
        MeanErrors { rms: rms(&vec![0.0; width]), moving: rms(&mean) }
    }
}
