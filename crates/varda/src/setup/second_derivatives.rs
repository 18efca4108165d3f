//! Which scenes have no exact Hessian, and why.

use crate::scene::{Estimate, Integrator, MOVES_SUPPORTS, Model, Scene, SensorKind};

/// The key of a scene that leaves its model without second derivatives, and the reason.
pub(crate) fn without_second_derivatives(scene: &Scene) -> Option<String> {
    let Model::Rod(_) = &scene.model else { return None };
    let why = "a rod at rest is solved anew at every step, which has first derivatives alone";
    let at_rest = scene.time.integrator == Integrator::QuasiStatic;
    at_rest.then(|| format!("time.integrator \"quasi-static\": {why}"))
}

/// The same of what is observed.
pub(crate) fn observed_without_second_derivatives(scene: &Scene) -> Option<String> {
    let sensors = scene.observations.sensors();
    let without =
        [SensorKind::SupportMoment, SensorKind::Moment, SensorKind::Direction, SensorKind::Orientation];
    if let Some(sensor) = sensors.iter().find(|sensor| without.contains(&sensor.kind)) {
        let of = "moments, directions and orientations have first derivatives alone";
        return Some(format!("sensor {:?} of observations.sensors: {of}", sensor.name));
    }
    let moves = |table: &str, keys: &Estimate| {
        let (key, _) = keys.given().into_iter().find(|(key, _)| MOVES_SUPPORTS.contains(key))?;
        let why = "moves supports, and what observations.sensors read has first derivatives by that alone";
        Some(format!("{table}.{key} {why}"))
    };
    let moved = moves("estimate", &scene.estimate).or_else(|| moves("consider", &scene.consider));
    moved.filter(|_| !sensors.is_empty())
}
