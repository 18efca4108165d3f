//! What fits and what does not: innovations against the assumed σ, markers kept back, forecasts beside simple ones.

use serde::Serialize;
use varda_assimilation::{Analysis, ObservationSet};
use varda_implicit::Model;

use crate::Error;
use crate::run::window::Trajectories;
use crate::scene::Use;
use crate::setup::problem::RodView;
use crate::setup::rod_observations::Window;

/// Innovations d = y − H(x) of one marker, place or component.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Fit {
    /// Whose.
    pub label: String,
    /// Number of observed values.
    pub count: usize,
    /// Assumed σ (root mean square over the values).
    pub sigma: f64,
    /// Root mean square of d at the background.
    pub rms_background: f64,
    /// Root mean square of d at the analysis.
    pub rms_analysis: f64,
    /// Mean of d at the analysis.
    pub mean_analysis: f64,
    /// Root mean square of d/σ at the analysis: about 1 where model and σ are right.
    pub ratio: f64,
}

/// Distances \[m\] between a marker that was kept back and where the model has it, root mean square over the window.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Withheld {
    /// Which marker.
    pub label: String,
    /// Number of times.
    pub count: usize,
    /// From x_b \[m\].
    pub rms_background: f64,
    /// From x_a \[m\].
    pub rms_analysis: f64,
    /// From x_a, less the mean error: what is left when the marker's place in the scene is a constant off \[m\].
    pub moving_analysis: f64,
}

/// Distances \[m\] between a marker and its forecast, root mean square over the time after the window.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Forecast {
    /// Which marker.
    pub label: String,
    /// Whether it was assimilated before.
    pub assimilated: bool,
    /// Number of times.
    pub count: usize,
    /// The model from x_a \[m\].
    pub analysis: f64,
    /// The model from x_b \[m\].
    pub background: f64,
    /// Persistence: the marker stays where it was last seen in the window \[m\].
    pub persistence: f64,
    /// The model at rest in its static equilibrium \[m\].
    pub static_model: f64,
    /// The model from x_a, less its mean error \[m\].
    pub moving_analysis: f64,
    /// The best constant forecast there is: how far the marker moves about its mean place \[m\].
    pub moving_constant: f64,
}

/// Innovations at background and analysis, label by label in the order of their first appearance.
///
/// # Errors
/// [`Error::Assimilation`] where a state cannot be observed.
pub fn fit(observations: &mut ObservationSet, runs: &Trajectories) -> Result<Vec<Fit>, Error> {
    let at_background = innovations(observations, runs, &runs.background)?;
    let at_analysis = innovations(observations, runs, &runs.analysis)?;
    let mut labels: Vec<&str> = Vec::new();
    for o in observations.observations() {
        if !labels.contains(&o.label.as_str()) {
            labels.push(&o.label);
        }
    }
    let of_label = |label: &&str| {
        let rows: Vec<usize> = observations
            .observations()
            .iter()
            .enumerate()
            .filter(|(_, o)| o.label == **label)
            .flat_map(|(i, _)| observations.rows(i))
            .collect();
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
        }
    };
    Ok(labels.iter().map(of_label).collect())
}

/// d = y − H(x) of a run; NaN where it ended early.
pub(crate) fn innovations(
    observations: &mut ObservationSet,
    runs: &Trajectories,
    states: &[f64],
) -> Result<Vec<f64>, Error> {
    let mut predicted = vec![0.0; observations.dim()];
    let last = observations.last_step().unwrap_or(0);
    for k in 0..=last {
        match runs.state(states, k) {
            Some(x) => observations.observe_add(k, x, &mut predicted)?,
            // A run that ended early has no innovations; its warning says so.
            None => return Ok(vec![f64::NAN; observations.dim()]),
        }
    }
    let mut d = vec![0.0; predicted.len()];
    observations.innovations(&predicted, &mut d);
    Ok(d)
}

/// Sentences about what does not fit.
pub fn remarks(fit: &[Fit], analysis: &Analysis) -> Vec<String> {
    let mut out = Vec::new();
    let m = analysis.observations as f64;
    // At the minimum 2J is χ² with m degrees of freedom: 4 of its standard deviations, √(2/m) of 1 each.
    let spread = 4.0 * (2.0 / m).sqrt();
    if m > 0.0 && (analysis.chi2 - 1.0).abs() > spread {
        let why = if analysis.chi2 > 1.0 {
            "σ of the observations or of the background is too small, or the model does not describe what was seen"
        } else {
            "σ of the observations or of the background is larger than it need be"
        };
        out.push(format!("2J/m = {:.2} is not within 1 ± {spread:.2}: {why}", analysis.chi2));
    }
    for f in fit.iter().filter(|f| f.count >= 10 && f.ratio > 1.5) {
        out.push(format!(
            "{}: innovations after the analysis are {:.1} times their assumed σ ({:.3e}): this does not fit",
            f.label, f.ratio, f.sigma
        ));
    }
    out
}

/// What the analysis says about markers kept back, and about the time after the window.
///
/// # Errors
/// [`Error::Rod`] where a state has no markers, [`Error::Model`] where the rod has no static equilibrium.
pub fn beyond(
    rod: &mut RodView,
    window: &Window,
    runs: &Trajectories,
    model: &mut dyn Model,
) -> Result<(Vec<Withheld>, Vec<Forecast>), Error> {
    let end = window.steps as f64;
    let mut withheld = Vec::new();
    let mut forecasts = Vec::new();
    let later = rod.sightings.seen.iter().any(|s| s.at() > end);
    let at_rest = if later {
        let control = rod.parts.at_rest(window.time(window.steps))?;
        let mut state = vec![0.0; model.dim()];
        model.initial_state(&control, &mut state)?;
        state
    } else {
        Vec::new()
    };
    for (site, place) in rod.sightings.sites.clone().iter().enumerate() {
        let seen: Vec<(f64, usize, f64, [f64; 3])> = rod
            .sightings
            .seen
            .iter()
            .filter(|s| s.site == site)
            .filter_map(|s| s.position(&rod.sightings.rotation).map(|p| (s.at(), s.step, s.weight, p)))
            .collect();
        let inside: Vec<_> = seen.iter().filter(|s| s.0 <= end).copied().collect();
        let after: Vec<_> = seen.iter().filter(|s| s.0 > end).copied().collect();
        let mut miss = |states: &[f64], seen: &[(f64, usize, f64, [f64; 3])]| -> Result<Spread, Error> {
            let mut errors = Vec::with_capacity(seen.len());
            for &(_, k, w, p) in seen {
                match place_at(rod, runs, states, site, k, w)? {
                    Some(q) => errors.push(std::array::from_fn(|i| p[i] - q[i])),
                    // A run that ended early has no error; its warning says so.
                    None => return Ok(Spread { rms: f64::NAN, moving: f64::NAN }),
                }
            }
            Ok(Spread::of(&errors))
        };
        if place.used == Use::Withhold && !inside.is_empty() {
            let analysis = miss(&runs.analysis, &inside)?;
            withheld.push(Withheld {
                label: place.label.clone(),
                count: inside.len(),
                rms_background: miss(&runs.background, &inside)?.rms,
                rms_analysis: analysis.rms,
                moving_analysis: analysis.moving,
            });
        }
        if !after.is_empty() {
            let analysis = miss(&runs.analysis, &after)?;
            let background = miss(&runs.background, &after)?;
            let still = place_of(rod, &at_rest, site, window.steps)?;
            let constant = |q: &[f64; 3]| {
                let errors: Vec<[f64; 3]> =
                    after.iter().map(|s| std::array::from_fn(|i| s.3[i] - q[i])).collect();
                Spread::of(&errors)
            };
            forecasts.push(Forecast {
                label: place.label.clone(),
                assimilated: place.used == Use::Assimilate,
                count: after.len(),
                analysis: analysis.rms,
                background: background.rms,
                persistence: inside.last().map_or(f64::NAN, |s| constant(&s.3).rms),
                static_model: constant(&still).rms,
                moving_analysis: analysis.moving,
                moving_constant: constant(&still).moving,
            });
        }
    }
    Ok((withheld, forecasts))
}

/// Where a run has a site at step k + w; `None` where the run ended before.
fn place_at(
    rod: &mut RodView,
    runs: &Trajectories,
    states: &[f64],
    site: usize,
    k: usize,
    w: f64,
) -> Result<Option<[f64; 3]>, Error> {
    let Some(x) = runs.state(states, k) else { return Ok(None) };
    let p = place_of(rod, x, site, k)?;
    if w == 0.0 {
        return Ok(Some(p));
    }
    let Some(next) = runs.state(states, k + 1) else { return Ok(None) };
    let q = place_of(rod, next, site, k + 1)?;
    Ok(Some(std::array::from_fn(|i| (1.0 - w) * p[i] + w * q[i])))
}

fn place_of(rod: &mut RodView, state: &[f64], site: usize, k: usize) -> Result<[f64; 3], Error> {
    let mut places = vec![0.0; 3 * rod.sightings.sites.len()];
    rod.sites.places(k, state, &mut places)?;
    Ok([places[3 * site], places[3 * site + 1], places[3 * site + 2]])
}

/// Root mean square of some error vectors, with their mean and without it.
struct Spread {
    rms: f64,
    moving: f64,
}

impl Spread {
    fn of(errors: &[[f64; 3]]) -> Spread {
        let n = errors.len() as f64;
        let mean: [f64; 3] = std::array::from_fn(|i| errors.iter().map(|e| e[i]).sum::<f64>() / n);
        let rms = |about: [f64; 3]| {
            let squares = errors.iter().flat_map(|e| (0..3).map(move |i| (e[i] - about[i]).powi(2)));
            (squares.sum::<f64>() / n).sqrt()
        };
        Spread { rms: rms([0.0; 3]), moving: rms(mean) }
    }
}
