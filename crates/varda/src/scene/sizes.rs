//! How large a scene may be: a few digits must not ask for more than a machine has.
//!
//! Bounds of single keys are in the schema (`maximum`); here are those of files and of several keys together.

use super::grid::TimeGrid;
use super::invalid::{Check, invalid};
use super::{Observations, Scene};

/// Most bytes of a scene's TOML.
pub const SCENE_BYTES: u64 = 1 << 20;

/// Most bytes of a CSV file.
pub const DATA_BYTES: u64 = 1 << 28;

/// Most steps of a window, of a spin-up, of a forecast, of a sequence of windows.
pub const STEPS: usize = 10_000_000;

/// Most numbers in the states of one run (steps × state), or of an ensemble's runs together. What else a run
/// takes is compared with `[limits] memory` before it begins.
pub const NUMBERS: usize = 1_000_000_000;

/// Most observed values.
pub const VALUES: usize = 10_000_000;

/// A number of a scene is 0, or its size is between `SMALLEST` and `LARGEST`: fourth powers and their
/// products stay numbers.
pub(super) const SMALLEST: f64 = 1e-50;
pub(super) const LARGEST: f64 = 1e50;

/// Checks sizes that depend on several keys, each already within its own bounds.
pub(super) fn validate_sizes(scene: &Scene) -> Check {
    let time = &scene.time;
    let state = match &scene.model {
        // Three coordinates and velocities a vertex and an angle an edge.
        super::Model::Rod(rod) => 7 * (rod.rest_lengths()?.len() + 1),
        model => model.components().unwrap_or(0),
    };
    let cycles = scene.algorithm.cycles.as_ref();
    let (steps, key) = match cycles {
        Some(cycles) => (cycles.steps(time.window), "algorithm.cycles.count"),
        None => (time.window, "time.window"),
    };
    if steps > STEPS {
        return invalid(key, format!("{steps} steps in all: at most {STEPS} can be run"));
    }
    let forecast = scene.report.forecast / TimeGrid::of(scene)?.step;
    if !(forecast <= STEPS as f64) {
        let message = format!("a forecast of {forecast:.3e} steps: at most {STEPS} can be run");
        return invalid("report.forecast", message);
    }
    for (key, steps) in
        [("time.spin_up", time.spin_up), (key, steps), ("report.forecast", steps + forecast as usize)]
    {
        if (steps + 1) * state > NUMBERS {
            let message = format!(
                "{steps} steps of a state of {state} numbers are {:.1e} numbers: at most {NUMBERS:.0e} can \
                 be kept",
                ((steps + 1) * state) as f64
            );
            return invalid(key, message);
        }
    }
    if let Some(members) = scene.algorithm.members().map(|e| e.members) {
        let numbers = (members + 1).saturating_mul((time.window + 1) * state);
        if numbers > NUMBERS {
            let message = format!(
                "{members} members of {} steps of {state} numbers are {numbers:.1e} numbers: at most \
                 {NUMBERS:.0e} can be kept",
                time.window + 1,
                numbers = numbers as f64
            );
            return invalid("algorithm.ensemble.members", message);
        }
    }
    let Observations::Synthetic(synthetic) = &scene.observations else { return Ok(()) };
    let each = match (synthetic.places.len(), synthetic.components.len()) {
        (0, 0) if synthetic.sensors.is_empty() => state,
        (places, components) => {
            let each = if synthetic.place_sigma()?.is_some() { 3 } else { 0 };
            let sensors = synthetic.sensors.iter().map(|s| s.kind.values()).sum::<usize>();
            (each + 2 * synthetic.cameras.len()) * places + components + sensors
        }
    };
    let (times, key) = match (&synthetic.steps, synthetic.every) {
        (Some(list), _) => (list.len() * cycles.map_or(1, |c| c.count), "observations.steps"),
        (None, every) => (steps / every.unwrap_or(1), "observations.every"),
    };
    let values = times.saturating_mul(each);
    if values > VALUES {
        let message =
            format!("{values} observed values ({times} times {each}): at most {VALUES} can be used");
        return invalid(key, message);
    }
    Ok(())
}
