//! `varda new` and `varda show`: scenes to start from.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};

use super::style;
use crate::Error;
use crate::preview::enough_segments;
use crate::scene::{STARTER, Scene, SceneFile, Shipped, shipped_data, shipped_scene};
use crate::setup::shape_scene::scene_of_file;

/// The schema beside a scene, which its first line names: editors complete and check keys by it.
const SCHEMA: &str = "varda-schema.json";

/// What a new scene is made of.
pub(super) enum From {
    /// The commented starter scene.
    Starter,
    /// A recording of a rod.
    Recording(PathBuf),
    /// A scene that comes with the program.
    Shipped(String),
}

/// Writes a scene to NAME.toml; beside it the files that a shipped one names, and the schema.
///
/// # Errors
/// [`Error::Write`] where something is there already, [`Error::Data`] for a file that is no recording,
/// [`Error::NoScene`].
pub(super) fn new(name: &str, from: From) -> Result<(), Error> {
    let path = PathBuf::from(if name.ends_with(".toml") { name.to_string() } else { format!("{name}.toml") });
    let text = match from {
        From::Starter => STARTER.to_string(),
        From::Recording(file) => {
            let place = || "--recording".to_string();
            let read = |reason| Error::Read { place: place(), path: file.clone(), reason };
            let text = String::from_utf8(super::bytes_of(&file).map_err(read)?)
                .map_err(|e| read(std::io::Error::new(std::io::ErrorKind::InvalidData, e)))?;
            with_enough_segments(&path, scene_of_file(&seen_from(&file, &path), &text)?)
        }
        From::Shipped(scene) => {
            let shipped = shipped_scene(&scene)?;
            for (file, text) in shipped_data(shipped.text) {
                write_data(&path.with_file_name("").join(file), text)?;
            }
            shipped.text.to_string()
        }
    };
    write_new(&path, &format!("#:schema ./{SCHEMA}\n{text}"))?;
    // it is that of this program, whatever another version has left there
    let schema = path.with_file_name(SCHEMA);
    std::fs::write(&schema, Scene::schema() + "\n")
        .map_err(|reason| Error::Write { path: schema, reason })?;
    style::line(format_args!("wrote {0}; next: varda check {0}", path.display()));
    Ok(())
}

/// The scene with so many segments, up to 120, that twice as many move the rod by less than σ of its
/// recording.
fn with_enough_segments(path: &Path, scene: String) -> String {
    const MOST: usize = 120;
    let folder = path.parent().unwrap_or(Path::new(""));
    let file = SceneFile::parse("new", "new", &scene, Some(folder), &[]);
    let Some(segments) = file.ok().and_then(|file| enough_segments(&file, MOST)) else { return scene };
    let with = |line: &str| match line.strip_prefix("segments = ") {
        Some(rest) => {
            let rest = rest.trim_start_matches(|c: char| c.is_ascii_digit());
            format!("segments = {segments}{rest}\n")
        }
        None => format!("{line}\n"),
    };
    scene.lines().map(with).collect()
}

/// Prints the TOML of a shipped scene.
///
/// # Errors
/// [`Error::NoScene`].
pub(super) fn show(scene: &str) -> Result<(), Error> {
    let Shipped { text, .. } = shipped_scene(scene)?;
    style::print(text);
    Ok(())
}

/// The path of a file as a scene writes it: relative to the scene where both are named relatively.
fn seen_from(file: &Path, scene: &Path) -> String {
    let folder = scene.parent().unwrap_or(Path::new(""));
    let seen = match file.strip_prefix(folder) {
        Ok(inside) => inside.to_path_buf(),
        Err(_) => std::path::absolute(file).unwrap_or_else(|_| file.to_path_buf()),
    };
    seen.display().to_string()
}

/// Writes a file that comes with a scene; the same file from before is let alone.
fn write_data(path: &Path, text: &str) -> Result<(), Error> {
    if std::fs::read_to_string(path).is_ok_and(|there| there == text) {
        return Ok(());
    }
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .map_err(|reason| Error::Write { path: folder.to_path_buf(), reason })?;
    }
    write_new(path, text)
}

/// Writes a file that is not there yet, whole or not at all.
fn write_new(path: &Path, text: &str) -> Result<(), Error> {
    let failed = |reason| Error::Write { path: path.to_path_buf(), reason };
    let mut target = OpenOptions::new().write(true).create_new(true).open(path).map_err(failed)?;
    target.write_all(text.as_bytes()).map_err(|reason| {
        // Half a file is of no use; if it cannot be removed either, nothing more can be done.
        let _ = std::fs::remove_file(path);
        failed(reason)
    })
}
