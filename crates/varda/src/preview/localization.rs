//! An ensemble localized by distance, on a rod that carries signals farther than that.

use super::finding::Finding;
use super::values::{axial_stiffness, line_mass};
use crate::scene::{Model, Scene};

/// A localization length \[m\] that the way of a wave within the window crosses: what is seen of sections
/// farther away is lost. The way is that of a stretching wave, √(EA/ρA) times the window, and no longer
/// than the rod; tension goes with it, and bends what it meets.
pub(super) fn too_short(scene: &Scene, window: f64) -> Option<Finding> {
    let Model::Rod(rod) = &scene.model else { return None };
    let cut = scene.algorithm.members()?.localization_length?;
    let length: f64 = rod.rest_lengths().ok()?.iter().sum();
    let speed = (axial_stiffness(rod) / line_mass(rod)).sqrt();
    let reach = length.min(speed * window);
    (cut < reach).then(|| {
        Finding::warning(
            "algorithm.ensemble.localization_length",
            format!(
                "the ensemble's covariances are zero beyond {cut} m, while tension travels at {speed:.0} m/s \
                 along this rod: {reach:.3} m of its {length:.3} m within the window. What is seen there \
                 tells nothing of the rest of the rod, and the fit is worse for it; leave the key out and \
                 take more members, or method \"4dvar\", which needs no localization"
            ),
        )
    })
}
