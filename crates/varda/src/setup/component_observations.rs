//! Observed components of a model that is not a rod, and places on a line.

use std::collections::{BTreeMap, HashSet};

use varda_assimilation::{LinearObservation, Selection};
use varda_implicit::ParameterPlaces;
use varda_implicit::line::Line;

use super::component_rows::{self, ComponentRow, Subject};
use super::components::ComponentSystem;
use super::files::Files;
use super::observations::{Draws, Observed, Seen, Site};
use super::recorded_rows::{Clock, LeftOut, summary, text_of};
use super::recording::Recorded;
use super::seen_with::with_constants;
use crate::Error;
use crate::outcome::{Quantity, SitesAre};
use crate::scene::{Recording, Synthetic, TimeGrid, rounded};

/// The components that a twin experiment observes; their values are not yet drawn.
pub(crate) fn synthetic(
    files: &Files,
    keys: &Synthetic,
    system: &ComponentSystem,
    grid: TimeGrid,
) -> Result<Observed, Error> {
    let n = system.names.len();
    let components: Vec<usize> =
        if keys.components.is_empty() { (0..n).collect() } else { keys.components.clone() };
    let site = |(row, &c): (usize, &usize)| Site {
        label: system.names[c].clone(),
        quantity: Quantity::Component,
        camera: None,
        sensor: None,
        rows: row..row + 1,
        anchors: vec![c],
        place: system.line.map(|line| line.position(c)),
        withheld: false,
    };
    let steps = files.scene.checked(keys.observed_steps(grid.steps))?;
    let (sigma, count) = (files.scene.checked(keys.component_sigma())?, components.len());
    let (constants, seeing, models) = (places(system), system.estimates.seen.clone(), system.models());
    Ok(Observed {
        errors: None,
        sites: components.iter().enumerate().map(site).collect(),
        seen: Vec::new(),
        space: None,
        left_out: Vec::new(),
        recording: None,
        make_operator: Box::new(move || {
            Ok(with_constants(
                Selection::new(components.clone(), n)?,
                constants.clone(),
                seeing.clone(),
                &[],
                &models,
            ))
        }),
        rotations: std::rc::Rc::default(),
        draws: Some(Draws { steps, sigma: vec![sigma; count], within: vec![None; count] }),
    })
}

/// Where the constants that are estimated stand in a state.
fn places(system: &ComponentSystem) -> Option<ParameterPlaces> {
    let (n, constants) = (system.names.len(), system.estimates.len());
    (constants > 0).then(|| ParameterPlaces::of_state(n, constants, n, 0))
}

/// A component, or a place on the line by its bits; in this order in reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Place {
    Component(usize),
    OnLine(u64),
}

/// What a recording saw, in the model's time.
///
/// # Errors
/// [`Error::Data`] or [`Error::Scene`] naming the line or the key.
pub(crate) fn recorded(
    files: &Files,
    recording: &Recording,
    system: &ComponentSystem,
    grid: TimeGrid,
) -> Result<Observed, Error> {
    let (label, text) = text_of(files, "observations.file", &recording.file)?;
    let rows = component_rows::rows(&label, &text)?;
    let bad = |line: usize, message: String| Error::Data { place: format!("{label}:{line}"), message };

    let places = rows.iter().map(|row| place(row, system).map_err(|e| bad(row.line, e)));
    let places: Vec<Place> = places.collect::<Result<_, _>>()?;
    let mut site_of: BTreeMap<Place, usize> = places.iter().map(|place| (*place, 0)).collect();
    site_of.values_mut().enumerate().for_each(|(i, site)| *site = i);

    let clock = Clock { recording, grid, shift: files.scene.adjusted.clock };
    let mut left = LeftOut::default();
    let (mut seen, mut recorded, mut known) = (Vec::new(), Vec::new(), HashSet::new());
    for (row, place) in rows.iter().zip(&places) {
        let site = site_of[place];
        let sigma = row.sigma.or(recording.sigma).ok_or_else(|| {
            bad(row.line, "no standard deviation: fill `sigma`, or give observations.sigma".to_string())
        })?;
        recorded.push(Recorded { time: row.time, site, position: [row.value, None, None], sigma });
        let at = clock.place(row.time, row.time_rounding, &mut left).map_err(|e| bad(row.line, e))?;
        let Some(at) = at else { continue };
        if !known.insert((site, row.time.to_bits(), row.value.map(f64::to_bits))) {
            left.repeated += 1;
            continue;
        }
        seen.push(Seen {
            site,
            step: at.floor() as usize,
            weight: at.fract(),
            values: vec![row.value],
            sigma,
        });
    }
    let kept = |_: usize| false;
    let sites: Vec<Site> = site_of.keys().enumerate().map(|(i, p)| site(i, *p, system)).collect();
    let times: Vec<f64> = rows.iter().map(|row| row.time).collect();
    let sites_are = match site_of.keys().next() {
        Some(Place::OnLine(_)) => SitesAre::Places,
        _ => SitesAre::Components,
    };
    let counted = left.count(rows.len(), &seen, kept, grid);
    let summary = summary(sites_are, counted, (&times, &clock), &sites, &recorded);
    let places: Vec<Place> = site_of.into_keys().collect();
    let (n, line) = (system.names.len(), system.line);
    let (constants, seeing, models) = (self::places(system), system.estimates.seen.clone(), system.models());
    Ok(Observed {
        errors: None,
        sites,
        seen,
        space: None,
        left_out: left.into_texts(),
        recording: Some(summary),
        make_operator: Box::new(move || {
            Ok(with_constants(operator(&places, n, line)?, constants.clone(), seeing.clone(), &[], &models))
        }),
        rotations: std::rc::Rc::default(),
        draws: None,
    })
}

/// What a row is about.
fn place(row: &ComponentRow, system: &ComponentSystem) -> Result<Place, String> {
    match (&row.subject, system.line) {
        (Subject::Component(written), _) => component(written, &system.names).map(Place::Component),
        (Subject::Place(s), Some(line)) => {
            let length = line.length;
            if *s >= 0.0 && *s <= length * (1.0 + 1e-9) {
                // −0 is 0
                return Ok(Place::OnLine((s + 0.0).to_bits()));
            }
            let in_millimetres = *s > 20.0 * length && 1e-3 * s <= length;
            let unit = if in_millimetres { ": millimetres? Name the column s_mm" } else { "" };
            Err(format!("s_m = {} is off the line (0 to {length} m){unit}", rounded(*s)))
        }
        (Subject::Place(_), None) => {
            Err("this model has no line: name the observed components in a column `component`".into())
        }
    }
}

/// The component with a name, or a number from 0.
fn component(written: &str, names: &[String]) -> Result<usize, String> {
    let last = names.len() - 1;
    let by_name = || names.iter().position(|name| name == written);
    match written.parse::<usize>() {
        Ok(number) if number <= last => Ok(number),
        Ok(number) => {
            let from_one = if number == names.len() { ": numbers count from 0" } else { "" };
            Err(format!("component {number} is none of the model's, 0 to {last}{from_one}"))
        }
        Err(_) => by_name().ok_or_else(|| {
            format!(
                "component {written:?} is none of the model's: {} to {}, or 0 to {last}",
                names[0], names[last]
            )
        }),
    }
}

fn site(row: usize, place: Place, system: &ComponentSystem) -> Site {
    let (label, anchor, place) = match (place, system.line) {
        (Place::OnLine(s), Some(line)) => {
            let s = f64::from_bits(s);
            (format!("s = {s} m"), line.nearest(s), Some(s))
        }
        (Place::Component(c), line) => (system.names[c].clone(), c, line.map(|line| line.position(c))),
        (Place::OnLine(_), None) => unreachable!("a place without a line was refused"),
    };
    let (quantity, camera) = (Quantity::Component, None);
    let (rows, anchors, sensor) = (row..row + 1, vec![anchor], None);
    Site { label, quantity, camera, sensor, rows, anchors, place, withheld: false }
}

/// H of the places: components as they are, places on a line between its points.
fn operator(
    places: &[Place],
    n: usize,
    line: Option<Line>,
) -> Result<LinearObservation, varda_assimilation::Error> {
    let (mut entries, mut known) = (Vec::new(), vec![0.0; places.len()]);
    for (row, place) in places.iter().enumerate() {
        match (place, line) {
            (Place::Component(c), _) => entries.push((row, *c, 1.0)),
            (Place::OnLine(s), Some(line)) => {
                let (weights, of_ends) = line.between(f64::from_bits(*s));
                entries.extend(weights.into_iter().map(|(i, w)| (row, i, w)));
                known[row] = of_ends;
            }
            (Place::OnLine(_), None) => unreachable!("a place without a line was refused"),
        }
    }
    LinearObservation::new(places.len(), n, &entries).map(|h| h.plus(known))
}
