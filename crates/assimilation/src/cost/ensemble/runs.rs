//! Runs of several models side by side.

use crate::Error;
#[cfg(feature = "rayon")]
use rayon::prelude::*;
#[cfg(feature = "rayon")]
use std::sync::Arc;
use varda_implicit::{Log, Model};
#[cfg(feature = "rayon")]
use varda_linalg::interrupt;

/// Runs every model from its control over `steps` steps, in parallel with the feature `rayon`. A run is a
/// pure function of its control, so that who runs it does not matter; the error is that of the first model
/// that failed.
pub(super) fn run_all<'m>(
    models: &mut [Box<dyn Model + Send + 'm>],
    controls: &[f64],
    states: &mut [f64],
    steps: usize,
    log: &mut Log,
) -> Result<(), Error> {
    Ok(run_each(models, controls, states, steps, log).into_iter().try_for_each(|ended| ended)?)
}

/// The same, with how each of them ended.
pub(crate) fn run_each<'m>(
    models: &mut [Box<dyn Model + Send + 'm>],
    controls: &[f64],
    states: &mut [f64],
    steps: usize,
    log: &mut Log,
) -> Vec<Result<(), varda_implicit::Error>> {
    let (n, n_z) = (models[0].dim(), models[0].control_dim());
    let length = (steps + 1) * n;
    #[cfg(feature = "rayon")]
    let asked = interrupt::asked();
    #[cfg(feature = "rayon")]
    let ended: Vec<(Log, Result<(), varda_implicit::Error>)> = models
        .par_iter_mut()
        .zip(controls.par_chunks_exact(n_z))
        .zip(states.par_chunks_exact_mut(length))
        .map(|((model, z), states)| {
            let mut run = || run_one(&mut **model, z, states, n);
            // a question is one of a thread: the others ask it too
            match &asked {
                Some(ends) => interrupt::within(Arc::clone(ends), run),
                None => run(),
            }
        })
        .collect();
    #[cfg(not(feature = "rayon"))]
    let ended: Vec<(Log, Result<(), varda_implicit::Error>)> = models
        .iter_mut()
        .zip(controls.chunks_exact(n_z))
        .zip(states.chunks_exact_mut(length))
        .map(|((model, z), states)| run_one(&mut **model, z, states, n))
        .collect();
    for (run, _) in &ended {
        log.add(run);
    }
    ended.into_iter().map(|(_, ended)| ended).collect()
}

/// Fills `states`, x₀ first, with the run from the control z.
fn run_one(
    model: &mut dyn Model,
    z: &[f64],
    states: &mut [f64],
    n: usize,
) -> (Log, Result<(), varda_implicit::Error>) {
    let mut log = Log::default();
    let ended = model.initial_state(z, &mut states[..n]).and_then(|()| {
        (0..states.len() / n - 1).try_for_each(|k| {
            let (x, x_next) = states[k * n..(k + 2) * n].split_at_mut(n);
            log.step(k, model.step(k, x, x_next)?);
            Ok(())
        })
    });
    (log, ended)
}
