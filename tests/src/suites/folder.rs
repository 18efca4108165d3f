//! Scenes with files of their own.

use std::path::{Path, PathBuf};
use varda::Error;
use varda::scene::SceneFile;

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
