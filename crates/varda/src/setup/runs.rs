//! Runs of a model.

use varda_implicit::{Log, Model};

use crate::Error;

/// Makes further instances of the model of a problem (parallel runs, ensemble members, forecasts), whose step
/// 0 is the given step of the window.
pub type MakeModel = Box<dyn Fn(usize) -> Box<dyn Model + Send>>;

/// All states of a run of `steps` steps from `x0`, one after the other.
///
/// # Errors
/// [`Error::Model`] naming the step.
pub fn run_states(model: &mut dyn Model, x0: &[f64], steps: usize) -> Result<Vec<f64>, Error> {
    let mut states = Vec::with_capacity((steps + 1) * x0.len());
    states.extend_from_slice(x0);
    run_on(model, &mut states, steps)?;
    Ok(states)
}

/// The state after `steps` steps from `x0`.
///
/// # Errors
/// A step that fails.
pub fn state_after(
    model: &mut dyn Model,
    x0: &[f64],
    steps: usize,
) -> Result<Vec<f64>, varda_implicit::Error> {
    let (mut x, mut next) = (x0.to_vec(), x0.to_vec());
    for k in 0..steps {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    Ok(x)
}

/// Continues a run from the last of its `states` to step `steps`, and returns what the model did. After an
/// error the states before the step that failed are there.
///
/// # Errors
/// A step that fails.
pub fn run_on(
    model: &mut dyn Model,
    states: &mut Vec<f64>,
    steps: usize,
) -> Result<Log, varda_implicit::Error> {
    let dim = model.dim();
    let mut next = vec![0.0; dim];
    let mut log = Log::default();
    for k in states.len() / dim - 1..steps {
        log.step(k, model.step(k, &states[k * dim..], &mut next)?);
        states.extend_from_slice(&next);
    }
    Ok(log)
}
