//! What scenes must satisfy in which a rod is at rest, or whose state is known.

use super::estimate::OF_OBSERVATIONS;
use super::invalid::{Check, invalid};
use super::{Integrator, Method, Model, Scene, Time};

/// Keys of `[estimate]` that only a motion shows.
const OF_MOTION: [&str; 3] = ["damping_stiffness", "damping_mass", "clock"];

pub(super) fn validate_static(scene: &Scene) -> Check {
    let (method, integrator) = (scene.algorithm.method, scene.time.integrator);
    let known = scene.background.covariance.is_of_known_state();
    if method == Method::Static {
        if scene.time != Time::of_shapes() {
            let message = "method \"static\" is for shapes without times: leave [time] out; of supports that \
                           move slowly take method \"4dvar\" with integrator \"quasi-static\"";
            return invalid("time", message);
        }
        if !known {
            let message = "method \"static\" has no other unknowns than [estimate]: leave [background] out, \
                           or say kind = \"known\"";
            return invalid("background.covariance.kind", message);
        }
        if scene.report.forecast != 0.0 {
            return invalid("report.forecast", "a shape without times has no forecast");
        }
    }
    if integrator == Integrator::QuasiStatic {
        let Model::Rod(rod) = &scene.model else {
            return invalid("time.integrator", "\"quasi-static\" is for rods");
        };
        if rod.twist_inertia {
            let message = "nothing spins in a rod at rest: leave it out, or integrator \"quasi-static\"";
            return invalid("model.twist_inertia", message);
        }
        if !known {
            let message = "a rod at rest at every step does not depend on its state at the start: kind = \
                           \"known\"";
            return invalid("background.covariance.kind", message);
        }
        let given = scene.estimate.given();
        if let Some((key, _)) = given.iter().find(|(key, _)| OF_MOTION.contains(key)) {
            return invalid(format!("estimate.{key}"), format!("`{key}`: a rod at rest does not show it"));
        }
    }
    if !known {
        return Ok(());
    }
    let given = scene.estimate.given();
    if given.iter().all(|(key, _)| OF_OBSERVATIONS.contains(key)) && method == Method::Static
        || given.is_empty()
    {
        let message = "the state is known, and [estimate] names no constant of the model: nothing is unknown";
        return invalid("estimate", message);
    }
    if method == Method::WeakState {
        let message = "method \"weak-state\" needs the inverse of B, which a known state has not";
        return invalid("algorithm.method", message);
    }
    Ok(())
}
