//! Members of the analysis of an ensemble along a window.

use crate::outcome::Members;
use crate::setup::Problem;
use crate::setup::ensemble::steps_of_members;
use crate::setup::runs::{MakeModel, run_on};
use crate::solve::PosteriorSpread;

/// Runs every member of the analysis along window and forecast; `None` where there are none. A run that ends
/// early is NaN from there.
pub(super) fn of_window(
    problem: &Problem,
    make_model: &MakeModel,
    posterior: Option<&PosteriorSpread>,
) -> Option<Members> {
    let members = posterior.map(|p| &p.members[..]).filter(|members| !members.is_empty())?;
    let (last, mut model) = (problem.experiment.grid.last_step(), make_model(0));
    let (n, n_z) = (model.dim(), problem.background.len());
    let count = members.len() / n_z;
    let steps = steps_of_members(count, last, n);
    let mut values = Vec::with_capacity(count * steps.len() * n);
    for control in members.chunks_exact(n_z) {
        let mut states = vec![0.0; n];
        if model.initial_state(control, &mut states).is_err()
            || run_on(model.as_mut(), &mut states, last).is_err()
        {
            states.resize((last + 1) * n, f64::NAN);
        }
        steps.iter().for_each(|k| values.extend_from_slice(&states[k * n..(k + 1) * n]));
    }
    Some(Members { count, steps, states: values })
}

/// Those of one window of a sequence, of the members' runs over some steps from `first` on.
pub(super) fn of_cycle(runs: &[f64], n: usize, first: usize, [run, window]: [usize; 2]) -> Members {
    let count = runs.len() / ((run + 1) * n);
    let within = steps_of_members(count, window, n);
    let mut states = Vec::with_capacity(count * within.len() * n);
    for run in runs.chunks_exact((run + 1) * n) {
        within.iter().for_each(|k| states.extend_from_slice(&run[k * n..(k + 1) * n]));
    }
    Members { count, steps: within.into_iter().map(|k| first + k).collect(), states }
}
