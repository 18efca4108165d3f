//! Scenes of one silicone rod with files of their own: what several tests would each write again.

// each test takes a part
#![allow(dead_code)]

use std::path::{Path, PathBuf};

use varda::Error;
use varda::scene::SceneFile;

/// The rod, half a metre in eight segments; more keys of `[model]` may follow.
pub(crate) const ROD: &str = r#"
[model]
kind = "rod"
length = 0.5
segments = 8
gravity = [0.0, 0.0, -9.81]
section = { kind = "circle", radius = 0.005 }
material = { youngs_modulus = 1e6, poisson_ratio = 0.5, density = 1100.0 }
"#;

/// A background at rest and a recording; more keys of `[observations]` may follow.
pub(crate) const SEEN: &str = r#"
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
"#;

/// A recording in which nothing was seen.
pub(crate) const NOTHING: &str = "time_s,s_m,x_m,y_m,z_m\n0.1,0.5,,,\n";

/// A folder for one case, removed with it.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(case: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("varda-{case}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    pub(crate) fn with(self, file: &str, text: &str) -> Folder {
        std::fs::write(self.0.join(file), text).unwrap();
        self
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }

    pub(crate) fn scene(&self, text: &str, sets: &[&str]) -> Result<SceneFile, Error> {
        let path = self.0.join("scene.toml");
        std::fs::write(&path, text).unwrap();
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        SceneFile::open(path.to_str().unwrap(), &sets)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // A file left in the folder of temporary files does no harm.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
