//! A run of the model forward, without observations.

use super::fit::distances;
use super::shapes;
use super::window::merged;
use crate::Error;
use crate::outcome::{Simulation, Trajectories, TwinFiles, WorkCounts};
use crate::setup::Problem;
use crate::setup::runs::run_on;

/// Runs the model forward over the window and its forecast: from the truth where there is one, else from the
/// background.
///
/// # Errors
/// [`Error::Model`] naming the step that failed.
pub fn simulate(problem: &Problem) -> Result<Simulation, Error> {
    let steps = problem.experiment.grid.last_step();
    let mut model = match (&problem.truth, &problem.make_truth) {
        (Some(_), Some(make)) => make(0),
        _ => problem.model(),
    };
    let dim = model.dim();
    let mut states = vec![0.0; dim];
    let of = match &problem.truth {
        Some(truth) => {
            states.copy_from_slice(truth);
            "truth"
        }
        None => {
            model.initial_state(&problem.background, &mut states)?;
            "background"
        }
    };
    let log = run_on(model.as_mut(), &mut states, steps)?;
    let trajectories = Trajectories { dim, analysis: states, ..Trajectories::default() };
    let shapes = shapes::with_observations(problem, &trajectories)?;
    let twin = match problem.system.rod().filter(|_| problem.truth.is_some()) {
        Some(rod) => {
            let mut start = vec![0.0; dim];
            model.initial_state(&problem.background, &mut start)?;
            let (grid, end_angle) = (problem.experiment.grid, rod.end_angle(&start)?);
            let pixels = problem.observed.pixels(&grid);
            let readings = problem.observed.readings(&grid);
            Some(TwinFiles { background: problem.background.clone(), end_angle, pixels, readings })
        }
        None => None,
    };
    let distances = match problem.observed.recording {
        Some(_) => distances(problem, &trajectories, model.as_ref())?,
        None => Vec::new(),
    };
    Ok(Simulation {
        experiment: problem.experiment.clone(),
        of,
        shapes,
        trajectories,
        steps,
        counts: WorkCounts::of(log.counts),
        twin,
        distances,
        warnings: merged(&log).into_iter().collect(),
    })
}
