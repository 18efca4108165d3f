//! The cable between two grippers of fixtures/gripped-cable, as a scene.

use super::folder::scene_in;
use std::path::Path;
use varda::scene::SceneFile;

/// σ of a coordinate of a marker \[m\].
pub(super) const SIGMA: f64 = 1e-3;

/// The cable from a time of the recording on \[s\], with the constants that it was made with and the odd
/// markers assimilated.
///
/// # Errors
/// A scene that `sets` make wrong.
pub(super) fn gripped_cable(begin: f64, sets: &[&str]) -> Result<SceneFile, varda::Error> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/gripped-cable");
    scene_in(&folder, &scene(begin), sets)
}

fn scene(begin: f64) -> String {
    let marker = |i: usize| {
        let used = if i.is_multiple_of(2) { "withhold" } else { "assimilate" };
        format!("{{ name = \"m{i}\", arc_length = {}, use = \"{used}\" }}, ", i as f64 / 12.0)
    };
    let markers: String = (1..=11).map(marker).collect();
    let gripper = |file: &str| {
        format!(
            "motion = {{ kind = \"pose\", file = \"{file}\", time_zero = {begin}, sigma = 1e-4, \
             sigma_angle = 8.727e-4 }}"
        )
    };
    format!(
        r#"
[model]
kind = "rod"
length = 1.0
segments = 61
clamp = "face"
gravity = [0.0, 0.0, -9.81]
section = {{ kind = "stiffness", ea = 1e3, ei = [3e-3, 3e-3], gj = 3e-3, mass_per_length = 0.08 }}
natural_curvature = [2.0, 0.0]
damping = {{ stiffness = 0.02, mass = 0.7 }}
[model.start]
{}
[model.end]
{}
[time]
integrator = "bdf2"
step = 0.01
window = 50
[background]
from = "static-equilibrium"
[background.covariance]
kind = "kernel"
sigma_x = 0.03
sigma_v = 0.5
correlation_length_x = 0.2
correlation_length_v = 0.2
localization_length = 1.0
prior = "clamp"
[observations]
kind = "file"
file = "markers.csv"
sigma = {SIGMA}
time_zero = {begin}
outside_window = "skip"
markers = [{markers}]
[report]
forecast = 0.5
"#,
        gripper("poses_a.csv"),
        gripper("poses_b.csv")
    )
}
