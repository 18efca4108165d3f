//! Which scenes have no exact Hessian, and why.

use crate::scene::{Integrator, Model, Scene};

/// The key of a scene that leaves its model without second derivatives, and the reason.
pub(crate) fn without_second_derivatives(scene: &Scene) -> Option<String> {
    let Model::Rod(_) = &scene.model else { return None };
    let why = "a rod at rest is solved anew at every step, which has first derivatives alone";
    let at_rest = scene.time.integrator == Integrator::QuasiStatic;
    at_rest.then(|| format!("time.integrator \"quasi-static\": {why}"))
}
