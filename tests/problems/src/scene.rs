//! The numbers of shipped scenes, read apart from the code of `varda` that runs them.

use serde::Deserialize;

/// The shipped scenes of the paper's four cases.
pub(crate) const SCENES: [&str; 4] = [
    include_str!("../../../crates/varda/scenes/hanging-rod-case1.toml"),
    include_str!("../../../crates/varda/scenes/hanging-rod-case2.toml"),
    include_str!("../../../crates/varda/scenes/hanging-rod-case3.toml"),
    include_str!("../../../crates/varda/scenes/hanging-rod-case4.toml"),
];

/// What is read of a scene: the numbers alone, apart from the code of `varda` that reads the rest.
#[derive(Deserialize)]
pub(crate) struct Scene {
    pub model: SceneModel,
    pub time: Time,
    pub background: SceneBackground,
    pub observations: Observed,
}

#[derive(Deserialize)]
pub(crate) struct SceneModel {
    pub length: f64,
    pub segments: usize,
    pub gravity: [f64; 3],
    pub section: Shape,
    pub material: SceneMaterial,
    pub start: Start,
}

#[derive(Deserialize)]
pub(crate) struct Shape {
    pub radius: f64,
}

#[derive(Deserialize)]
pub(crate) struct SceneMaterial {
    pub youngs_modulus: f64,
    pub poisson_ratio: f64,
    pub density: f64,
}

#[derive(Deserialize)]
pub(crate) struct Start {
    pub director: [f64; 3],
    pub motion: Motion,
}

#[derive(Deserialize)]
pub(crate) struct Motion {
    pub radii: [f64; 2],
    pub omega: f64,
    pub ramp_periods: f64,
}

#[derive(Deserialize)]
pub(crate) struct Time {
    pub steps_per_period: f64,
    pub spin_up: usize,
    pub window: usize,
}

#[derive(Deserialize)]
pub(crate) struct SceneBackground {
    pub covariance: SceneCovariance,
}

#[derive(Deserialize)]
pub(crate) struct SceneCovariance {
    pub sigma_x_over_length: f64,
    pub sigma_v_over_mean_speed: f64,
    pub correlation_length_x: f64,
    pub correlation_length_v: f64,
    pub localization_length: f64,
}

#[derive(Deserialize)]
pub(crate) struct Observed {
    pub places: Vec<f64>,
    pub sigma_over_length: f64,
}
