//! Which scenes have no exact Hessian, and why.

use crate::scene::{Estimate, Integrator, MOVES_SUPPORTS, Model, Scene};

/// The key of a scene that leaves its model without second derivatives, and the reason.
pub(crate) fn without_second_derivatives(scene: &Scene) -> Option<String> {
    let Model::Rod(_) = &scene.model else { return None };
    if scene.time.integrator == Integrator::QuasiStatic {
        let why = "a rod at rest is solved anew at every step, which has first derivatives alone";
        return Some(format!("time.integrator \"quasi-static\": {why}"));
    }
    let moves = |table: &str, keys: &Estimate| {
        let (key, _) = keys.given().into_iter().find(|(key, _)| MOVES_SUPPORTS.contains(key))?;
        Some(format!("{table}.{key} moves supports, and what that does has first derivatives alone"))
    };
    moves("estimate", &scene.estimate).or_else(|| moves("consider", &scene.consider))
}
