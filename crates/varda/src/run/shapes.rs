//! Runs of a rod in space: its vertices step by step, what was seen of it, and one marker followed through
//! all runs.

use varda_rod::{Curvature, InternalForces};

use crate::Error;
use crate::outcome::{Shapes, Track, Trajectories};
use crate::scene::TimeGrid;
use crate::setup::Problem;
use crate::setup::observations::{Observed, ObservedSpace, observe};

/// Vertices of all runs; `None` for models that are not in space.
///
/// # Errors
/// [`Error::Rod`].
pub(crate) fn vertices(problem: &Problem, runs: &Trajectories) -> Result<Option<Shapes>, Error> {
    let Some(rod) = problem.system.rod() else { return Ok(None) };
    let grid = &problem.experiment.grid;
    // what is held is where the constants of a run put it
    let of = |states: &[f64]| -> Result<Vec<Vec<[f64; 3]>>, Error> {
        let Some(first) = states.get(..runs.dim) else { return Ok(Vec::new()) };
        let (mut dynamics, _) = rod.with_constants_of(first)?;
        let states = states.chunks_exact(runs.dim).enumerate();
        let mut points =
            |k, x| dynamics.vertices(grid.time(k), x).map(|v| v.into_iter().map(Into::into).collect());
        Ok(states.map(|(k, x)| points(k, x)).collect::<Result<Vec<_>, varda_rod::Error>>()?)
    };
    Ok(Some(Shapes {
        background: of(&runs.background)?,
        analysis: of(&runs.analysis)?,
        truth: of(&runs.truth)?,
        ..Shapes::default()
    }))
}

/// Vertices of all runs, what was seen, the track of one marker, and the forces within the rod; `None` for
/// models that are not in space.
///
/// # Errors
/// [`Error::Rod`], [`Error::Assimilation`] where a marker has no place in a state.
pub(crate) fn with_observations(problem: &Problem, runs: &Trajectories) -> Result<Option<Shapes>, Error> {
    let Some(shapes) = vertices(problem, runs)? else { return Ok(None) };
    let observed = &problem.observed;
    let track = observed
        .space
        .as_ref()
        .map(|space| track(observed, space, &problem.experiment.grid, runs))
        .transpose()?;
    let (forces, curvature) = within(problem, runs)?;
    Ok(Some(Shapes { seen: observed.sights(), track: track.flatten(), forces, curvature, ..shapes }))
}

/// Forces and moments within the rod of the analysis, from step 1 on, and its curvature from step 0 on.
fn within(problem: &Problem, runs: &Trajectories) -> Result<Within, Error> {
    let none = (Vec::new(), Vec::new());
    let Some(rod) = problem.system.rod() else { return Ok(none) };
    let Some(first) = runs.analysis.get(..runs.dim) else { return Ok(none) };
    let (mut dynamics, _) = rod.with_constants_of(first)?;
    let (grid, places) = (&problem.experiment.grid, rod.parts.places()?);
    let own = |x: &[f64]| {
        let mut own = vec![0.0; places.own_dim()];
        places.gather(x, &mut own);
        own
    };
    let states: Vec<Vec<f64>> = runs.analysis.chunks_exact(runs.dim).map(own).collect();
    let curvature =
        states.iter().enumerate().map(|(k, x)| dynamics.curvature(grid.time(k), x).ok()).collect();
    let pairs = states.windows(2).enumerate();
    let found = pairs.map(|(k, x)| dynamics.internal_forces(grid.time(k + 1), &x[1], (grid.time(k), &x[0])));
    Ok((found.collect::<Result<_, _>>()?, curvature))
}

/// What a rod has within it, step by step.
type Within = (Vec<InternalForces>, Vec<Option<Curvature>>);

/// The track of the first marker that was kept back, which says most; else of the last site, which is the
/// free end in most scenes.
fn track(
    observed: &Observed,
    space: &ObservedSpace,
    grid: &TimeGrid,
    runs: &Trajectories,
) -> Result<Option<Track>, Error> {
    let sites = &observed.sites;
    let Some(last) = sites.len().checked_sub(1) else { return Ok(None) };
    let site = sites.iter().position(|s| s.withheld).unwrap_or(last);
    let row = 3 * site;
    let mut operator = (space.make_places)()?;
    let mut places = vec![0.0; operator.dim()];
    let mut of = |states: &[f64]| -> Result<Vec<[f64; 3]>, Error> {
        let mut line = Vec::new();
        for (step, x) in states.chunks_exact(runs.dim).enumerate() {
            observe(operator.as_mut(), grid.at(step), x, &mut places)?;
            line.push([places[row], places[row + 1], places[row + 2]]);
        }
        Ok(line)
    };
    Ok(Some(Track {
        label: sites[site].of_point().to_string(),
        site,
        withheld: sites[site].withheld,
        background: of(&runs.background)?,
        analysis: of(&runs.analysis)?,
        truth: of(&runs.truth)?,
    }))
}
