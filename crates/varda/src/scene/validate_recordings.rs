//! What `[[recordings]]` must satisfy.

use std::collections::BTreeSet;

use super::estimate::OF_BASE;
use super::invalid::{Check, invalid};
use super::{Hessian, Scene};

pub(super) fn validate_recordings(scene: &Scene) -> Check {
    let Some(first) = scene.recordings.first() else { return Ok(()) };
    let mut names = BTreeSet::new();
    for (i, one) in scene.recordings.iter().enumerate() {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let path = format!("recordings.{i}.name");
        if one.name.is_empty() || !one.name.chars().all(plain) || one.name == "figures" {
            return invalid(path, "a folder's name: letters, digits, \"-\" and \"_\", and not \"figures\"");
        }
        if !names.insert(one.name.to_lowercase()) {
            return invalid(path, format!("two recordings are called {:?}", one.name));
        }
        let both = one.estimate.0.keys().find(|key| is_shared(scene, key));
        if let Some(key) = both {
            let message = "[estimate] has it for all recordings: leave it out there or here";
            return invalid(format!("recordings.{i}.estimate.{key}"), message);
        }
        if let Some(key) = OF_PASSES.into_iter().find(|key| one.estimate.0.contains_key(*key)) {
            return invalid(format!("recordings.{i}.estimate.{key}"), of_passes(key));
        }
    }
    let given = scene.estimate.given();
    if given.is_empty() {
        let message = format!(
            "recordings share the constants of [estimate], which names none: assimilate {:?} and the others \
             one by one, or name what is unknown",
            first.name
        );
        return invalid("recordings", message);
    }
    if let Some((key, _)) = given.iter().find(|(key, _)| OF_PASSES.contains(key)) {
        return invalid(format!("estimate.{key}"), of_passes(key));
    }
    if let Some((key, _)) = given.iter().find(|(key, _)| OF_BASE.iter().any(|(base, _)| base == key)) {
        let message = "errors of a recorded base are each recording's own: name it in the `estimate` of \
                       [[recordings]]";
        return invalid(format!("estimate.{key}"), message);
    }
    let algorithm = &scene.algorithm;
    if !algorithm.method.is_strong() {
        let message = format!(
            "method {:?} takes one recording; several take \"4dvar\", \"3dvar\", \"static\", their \
             incremental and dual forms, or \"blue\"",
            algorithm.method.name()
        );
        return invalid("algorithm.method", message);
    }
    let one_only = "this is for one recording: leave it out beside [[recordings]]";
    for (key, is_given) in [
        ("cycles", algorithm.cycles.is_some()),
        ("window_growth", !algorithm.window_growth.is_empty()),
        ("background_check", algorithm.background_check.is_some()),
        ("model_error", algorithm.model_error.is_some()),
        ("hessian", algorithm.hessian == Hessian::Exact),
    ] {
        if is_given {
            return invalid(format!("algorithm.{key}"), one_only);
        }
    }
    if scene.time.tolerance.is_some() {
        return invalid("time.tolerance", one_only);
    }
    Ok(())
}

/// Keys that passes over one recording find.
const OF_PASSES: [&str; 2] = ["clock", "observation_sigma"];

fn of_passes(key: &str) -> String {
    format!("`{key}` is found in passes over one recording: estimate it from each, without [[recordings]]")
}

/// Whether `[estimate]` has a key.
fn is_shared(scene: &Scene, key: &str) -> bool {
    scene.estimate.given().iter().any(|(given, _)| *given == key)
}
