//! How well the analysis fits: innovations against the assumed σ, markers kept back, forecasts beside
//! simpler ones.

use std::collections::HashMap;

use varda_assimilation::{Observation, ObservationOperator, ObservationSet};
use varda_implicit::{At, Model, Rate};

use super::departures::{Departure, Surroundings};
use crate::Error;
use crate::outcome::{Distance, Fit, Forecast, ObservedValue, Sight, Trajectories, Withheld};
use crate::scene::TimeGrid;
use crate::setup::Problem;
use crate::setup::observations::{ObservedSpace, Site, observe};

/// Innovations at background and analysis, label by label in the order of their first appearance.
///
/// # Errors
/// [`Error::Assimilation`] where a state cannot be observed.
pub(crate) fn fit(observations: &mut ObservationSet, runs: &Trajectories) -> Result<Vec<Fit>, Error> {
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
    /// Whether the axes of values are those of places.
    pub(crate) in_space: bool,
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
            in_space: false,
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
    // in space the sites stand in the order of arc length
    let mut order: Vec<usize> = (0..sites.len()).collect();
    if let Some(space) = space {
        order.sort_by(|a, b| space.arc_lengths[*a].total_cmp(&space.arc_lengths[*b]));
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
        in_space: space.is_some(),
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

/// Gravity and the held points of a rod, in the axes of what was observed.
fn surroundings(problem: &Problem) -> Option<Surroundings> {
    let (rod, space) = (problem.system.rod()?, problem.observed.space.as_ref()?);
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
    let sights = problem.observed.sights();
    let (sights, mut places) = SitePlaces::of(space, sights, grid, model.rate())?;
    let at_background = places.along(runs, &runs.background)?;
    let at_analysis = places.along(runs, &runs.analysis)?;
    let at_rest = if sights.iter().any(|s| s.at() > end) {
        let at_rest = rod.parts.at_rest(grid.time(grid.steps))?;
        let control = rod.control_at_rest(&at_rest)?;
        let mut state = vec![0.0; model.dim()];
        model.initial_state(&control, &mut state)?;
        state
    } else {
        Vec::new()
    };
    let mut of_sites = vec![Vec::new(); problem.observed.sites.len()];
    sights.iter().enumerate().for_each(|(j, sight)| of_sites[sight.site].push(j));
    for (i, (site, of_site)) in problem.observed.sites.iter().zip(of_sites).enumerate() {
        let (inside, after): (Vec<usize>, Vec<usize>) =
            of_site.into_iter().partition(|j| sights[*j].at() <= end);
        // A run that ended early has NaN for an error; its warning says so.
        let miss = |places: &[[f64; 3]], seen: &[usize]| {
            let error = |j: &usize| std::array::from_fn(|c| sights[*j].position[c] - places[*j][c]);
            MeanErrors::of(&seen.iter().map(error).collect::<Vec<[f64; 3]>>())
        };
        if site.withheld && !inside.is_empty() {
            let analysis = miss(&at_analysis, &inside);
            withheld.push(Withheld {
                label: site.label.clone(),
                count: inside.len(),
                rms_background: miss(&at_background, &inside).rms,
                rms_analysis: analysis.rms,
                moving_analysis: analysis.moving,
            });
        }
        if !after.is_empty() {
            let analysis = miss(&at_analysis, &after);
            let background = miss(&at_background, &after);
            let still = places.of_site(&at_rest, i)?;
            let constant = |q: &[f64; 3]| {
                let errors: Vec<[f64; 3]> =
                    after.iter().map(|j| std::array::from_fn(|c| sights[*j].position[c] - q[c])).collect();
                MeanErrors::of(&errors)
            };
            forecasts.push(Forecast {
                label: site.label.clone(),
                assimilated: !site.withheld,
                count: after.len(),
                analysis: analysis.rms,
                background: background.rms,
                persistence: inside.last().map_or(f64::NAN, |j| constant(&sights[*j].position).rms),
                static_model: constant(&still).rms,
                moving_analysis: analysis.moving,
                moving_constant: constant(&still).moving,
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
    rate: Option<Box<dyn Rate>>,
) -> Result<Vec<Distance>, Error> {
    let (observed, grid) = (&problem.observed, &problem.experiment.grid);
    let mut sums = vec![(0, 0.0); observed.sites.len()];
    if let Some(space) = &observed.space {
        let (sights, mut places) = SitePlaces::of(space, observed.sights(), grid, rate)?;
        for (sight, place) in sights.iter().zip(places.along(runs, &runs.analysis)?) {
            let sum = &mut sums[sight.site];
            sum.0 += 1;
            sum.1 += (0..3).map(|c| (sight.position[c] - place[c]).powi(2)).sum::<f64>();
        }
    } else {
        let mut observations = observed.set(grid)?;
        observations.follow(rate);
        let d = innovations(&mut observations, runs, &runs.analysis)?;
        for (i, o) in observations.observations().iter().enumerate() {
            let Some(site) = observed.sites.iter().position(|site| site.label == o.label) else { continue };
            sums[site].0 += observations.rows(i).len();
            sums[site].1 += d[observations.rows(i)].iter().map(|d| d * d).sum::<f64>();
        }
    }
    let of_site = |(site, (count, sum)): (&Site, (usize, f64))| Distance {
        label: site.label.clone(),
        count,
        rms: (sum / count as f64).sqrt(),
    };
    Ok(observed.sites.iter().zip(sums).filter(|(_, sum)| sum.0 > 0).map(of_site).collect())
}

/// Where sites are in the model's axes.
struct SitePlaces {
    operator: Box<dyn ObservationOperator>,
    sights: ObservationSet,
    at_end: At,
}

impl SitePlaces {
    /// Of what was seen within window and forecast, which is given back in the order of time.
    fn of(
        space: &ObservedSpace,
        mut sights: Vec<Sight>,
        grid: &TimeGrid,
        rate: Option<Box<dyn Rate>>,
    ) -> Result<(Vec<Sight>, SitePlaces), Error> {
        sights.retain(|s| s.at() <= grid.last_step() as f64);
        sights.sort_by(|a, b| a.step.cmp(&b.step).then(a.weight.total_cmp(&b.weight)));
        let seen = sights.iter().map(|s| {
            let rows = (3 * s.site..3 * s.site + 3).collect();
            Observation::new(s.step, rows, s.position.to_vec(), s.sigma).between(s.weight)
        });
        let mut set = ObservationSet::on_times(grid.times(), vec![(space.make_places)()?], seen.collect())?;
        set.follow(rate);
        let operator = (space.make_places)()?;
        Ok((sights, SitePlaces { operator, sights: set, at_end: grid.at(grid.steps) }))
    }

    /// The place of a site in a state at the end of the window.
    fn of_site(&mut self, state: &[f64], site: usize) -> Result<[f64; 3], Error> {
        let mut values = vec![0.0; self.operator.dim()];
        observe(self.operator.as_mut(), self.at_end, state, &mut values)?;
        Ok(std::array::from_fn(|c| values[3 * site + c]))
    }

    /// The places in a run where and when sites were seen; NaN where the run ended before.
    fn along(&mut self, runs: &Trajectories, states: &[f64]) -> Result<Vec<[f64; 3]>, Error> {
        let predicted = predicted(&mut self.sights, runs, states)?;
        Ok(predicted.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect())
    }
}

/// Root mean square of some error vectors, with their mean and without it.
struct MeanErrors {
    rms: f64,
    moving: f64,
}

impl MeanErrors {
    fn of(errors: &[[f64; 3]]) -> MeanErrors {
        let n = errors.len() as f64;
        let mean: [f64; 3] = std::array::from_fn(|i| errors.iter().map(|e| e[i]).sum::<f64>() / n);
        let rms = |about: [f64; 3]| {
            let squares = errors.iter().flat_map(|e| (0..3).map(move |i| (e[i] - about[i]).powi(2)));
            (squares.sum::<f64>() / n).sqrt()
        };
        MeanErrors { rms: rms([0.0; 3]), moving: rms(mean) }
    }
}
