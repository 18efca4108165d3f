//! The cable between two grippers of fixtures/gripped-cable, as a scene.

use super::folder::scene_in;
use problems::recordings;
use varda::scene::SceneFile;

pub(super) use recordings::CABLE_SIGMA as SIGMA;

/// The cable from a time of the recording on \[s\], with the constants that it was made with and the odd
/// markers assimilated.
///
/// # Errors
/// A scene that `sets` make wrong.
pub(super) fn gripped_cable(begin: f64, sets: &[&str]) -> Result<SceneFile, varda::Error> {
    scene_in(&recordings::gripped_cable_folder(), &recordings::gripped_cable(begin), sets)
}
