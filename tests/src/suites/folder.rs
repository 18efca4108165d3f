//! Scenes with files of their own.

use std::path::{Path, PathBuf};
use varda::Error;
use varda::scene::SceneFile;

/// A silicone rod hanging from a clamp, with two markers in seen.csv; keys of the clamp go in the place of
/// the comment.
pub(super) const RECORDED_ROD: &str = r#"
[model]
kind = "rod"
length = 0.5
segments = 12
gravity = [0.0, 0.0, -9.81]
section = { kind = "circle", radius = 0.005 }
material = { youngs_modulus = 1e6, poisson_ratio = 0.5, density = 1100.0 }
[model.start]
position = [0.0, 0.0, 1.0]
tangent = [0.0, 0.0, -1.0]
director = [1.0, 0.0, 0.0]
# motion
[time]
integrator = "bdf2"
step = 0.01
window = 40
[background]
from = "static-equilibrium"
[background.covariance]
kind = "kernel"
sigma_x = 0.02
sigma_v = 0.3
correlation_length_x = 0.25
correlation_length_v = 0.25
localization_length = 0.5
prior = "clamp"
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.002
[[observations.markers]]
name = "middle"
arc_length = 0.25
[[observations.markers]]
name = "tip"
arc_length = 0.5
"#;

/// A folder for one case, removed with it.
pub(super) struct Folder(PathBuf);

impl Folder {
    pub(super) fn new(case: &str) -> std::io::Result<Folder> {
        let name: String = case.chars().map(|c| if c.is_alphanumeric() { c } else { '-' }).collect();
        let folder = std::env::temp_dir().join(format!("varda-suite-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder)?;
        Ok(Folder(folder))
    }

    pub(super) fn write(&self, file: &str, bytes: &[u8]) -> std::io::Result<()> {
        std::fs::write(self.0.join(file), bytes)
    }

    pub(super) fn scene(&self, text: &str, sets: &[&str]) -> Result<SceneFile, Error> {
        scene_in(&self.0, text, sets)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A file left in the folder of temporary files does no harm.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A scene whose files are in a folder.
pub(super) fn scene_in(folder: &Path, text: &str, sets: &[&str]) -> Result<SceneFile, Error> {
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    SceneFile::parse("scene", "scene.toml", text, Some(folder), &sets)
}
