//! What `[consider]` must satisfy beyond the type of each key.

use super::estimate::OF_BASE;
use super::invalid::{Check, invalid};
use super::validate_estimate::validate_estimate;
use super::{Scene, Unknown};

pub(super) fn validate_consider(scene: &Scene) -> Check {
    let given = scene.consider.given();
    if given.is_empty() {
        return Ok(());
    }
    let own = scene.estimate.given();
    for (key, unknown) in &given {
        let path = format!("consider.{key}");
        if own.iter().any(|(other, _)| other == key) {
            return invalid(path, "is estimated: leave it out here, or in [estimate]");
        }
        let is_field = matches!(unknown, Unknown::Every(prior) if prior.correlation_length.is_some());
        if is_field || OF_BASE.iter().any(|(base, _)| base == key) {
            let message = "is a function of place or time: [estimate] takes such, [consider] takes numbers";
            return invalid(path, message);
        }
        if *key == "observation_sigma" {
            let message = "is no number of the model: `sources` of summary.json says what σ of each marker \
                           does";
            return invalid(path, message);
        }
    }
    let algorithm = &scene.algorithm;
    let refuse = |path: &str, what: &str| invalid(path, format!("{what} [consider]: leave one out"));
    if !algorithm.method.is_strong() {
        return refuse("algorithm.method", "weak and ensemble methods do not go with");
    }
    if algorithm.cycles.is_some() {
        return refuse("algorithm.cycles", "windows one after the other do not go with");
    }
    if !scene.recordings.is_empty() {
        return refuse("recordings", "several recordings do not go with");
    }
    if scene.time.tolerance.is_some() {
        return refuse("time.tolerance", "time steps that adapt do not go with");
    }
    validate_estimate(&scene.estimate.with(&scene.consider), scene).map_err(|mut wrong| {
        if let Some(key) = wrong.path.strip_prefix("estimate.")
            && given.iter().any(|(given, _)| key == *given || key.starts_with(&format!("{given}.")))
        {
            wrong.path = format!("consider.{key}");
        }
        wrong
    })
}
