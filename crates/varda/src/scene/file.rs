//! Reading a scene: from a file or the binary, with overrides; and finding the files it names.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;

use super::estimate::{PriorSpread, Unknown};
use super::grid::TimeGrid;
use super::invalid::Invalid;
use super::place::Place;
use super::sizes::{DATA_BYTES, SCENE_BYTES};
use super::tree::Node;
use super::{Method, Scene, recordings, schema_check, shipped, tree, validate};
use crate::Error;

/// A scene that has been read and checked. It can point at the lines of its keys and find its files.
#[derive(Debug, Clone)]
pub struct SceneFile {
    /// Name of the scene: that of the file without its ending.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// The scenes of `[[recordings]]`, each with what differs in it.
    pub(crate) recordings: Vec<SceneFile>,
    /// What an estimate has found of the observations so far; nothing of that is in the file.
    pub(crate) adjusted: Adjusted,
    label: String,
    text: Arc<str>,
    folder: Option<PathBuf>,
    places: BTreeMap<String, Place>,
}

/// What passes of an estimate change in how observations are read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Adjusted {
    /// Added to the times of a recording \[s\].
    pub(crate) clock: f64,
    /// Factor of σ of all observations.
    pub(crate) sigma: f64,
}

impl Default for Adjusted {
    fn default() -> Self {
        Adjusted { clock: 0.0, sigma: 1.0 }
    }
}

impl SceneFile {
    /// Opens a scene: the path of a TOML file, or the name of a shipped scene. `overrides` are `key=value`.
    ///
    /// # Errors
    /// [`Error::NoScene`], [`Error::Read`], or [`Error::Scene`] with file, line and column.
    pub fn open(name: &str, overrides: &[String]) -> Result<SceneFile, Error> {
        let path = Path::new(name);
        if let Some(shipped) = shipped::find(name).filter(|_| !path.is_file()) {
            return SceneFile::parse(
                shipped.name,
                &format!("{}.toml", shipped.name),
                shipped.text,
                None,
                overrides,
            );
        }
        let text = read_text(path, SCENE_BYTES).map_err(|reason| match reason.kind() {
            std::io::ErrorKind::NotFound => shipped::not_found(name),
            _ => Error::Read { place: "scene".into(), path: path.to_path_buf(), reason },
        })?;
        let stem = path.file_stem().map_or("scene".into(), |s| s.to_string_lossy());
        SceneFile::parse(&stem, name, &text, Some(path.parent().unwrap_or(Path::new(""))), overrides)
    }

    /// Reads a scene from text; `label` stands for the file in messages, `folder` is where its files are
    /// (`None`: among those shipped in the binary).
    ///
    /// # Errors
    /// [`Error::Scene`].
    #[allow(clippy::missing_panics_doc)] // a schema is plain JSON
    pub fn parse(
        name: &str,
        label: &str,
        text: &str,
        folder: Option<&Path>,
        overrides: &[String],
    ) -> Result<SceneFile, Error> {
        if text.len() as u64 > SCENE_BYTES {
            let message = format!("{} bytes: a scene has at most {SCENE_BYTES}", text.len());
            return Err(Error::Scene { place: label.to_string(), message, excerpt: String::new() });
        }
        let mut root = tree::parse(label, text)?;
        for assignment in overrides {
            tree::set(&mut root, assignment)?;
        }
        tree::rename(&mut root, (label, text), ["model", "point_forces", "forces"])?;
        let schema = serde_json::to_value(schemars::schema_for!(Scene)).expect("a schema is plain JSON");
        let folder = folder.map(Path::to_path_buf);
        let written = Written { label, text: &Arc::from(text) };
        let mut file = SceneFile::from_tree(name, written, &root, folder.clone(), &schema)?;
        let parts = recordings::trees(&root, file.scene.recordings.len());
        for (one, part) in file.scene.recordings.iter().zip(parts) {
            let part = SceneFile::from_tree(&one.name, written, &part, folder.clone(), &schema);
            file.recordings.push(part.map_err(|error| error.of_recording(&one.name))?);
        }
        Ok(file)
    }

    fn from_tree(
        name: &str,
        written: Written,
        root: &Node,
        folder: Option<PathBuf>,
        schema: &serde_json::Value,
    ) -> Result<SceneFile, Error> {
        let Written { label, text } = written;
        let wrong = |place: &Place, message: String| {
            let excerpt = place.excerpt(text);
            Error::Scene { place: locate(label, Some(place)), message, excerpt }
        };
        schema_check::check(root, "", schema, schema).map_err(|w| wrong(&w.place, w.message))?;
        let scene = Scene::deserialize(root.to_json()).map_err(|e| wrong(&root.place, e.to_string()))?;
        let mut places = BTreeMap::new();
        root.places("", &mut places);
        let file = SceneFile {
            name: name.to_string(),
            scene,
            recordings: Vec::new(),
            adjusted: Adjusted::default(),
            label: label.to_string(),
            text: Arc::clone(text),
            folder,
            places,
        };
        let of_shapes = file.scene.algorithm.method == Method::Static;
        let missing = ["time", "background"].into_iter().find(|key| !file.places.contains_key(*key));
        if let (false, Some(key)) = (of_shapes, missing) {
            return Err(file.invalid("", format!("[{key}] is missing; only method \"static\" has none")));
        }
        file.checked(validate::validate(&file.scene))?;
        Ok(file)
    }

    /// The text that was read, without what overrides say.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Whether the scene has `[[recordings]]`, several recordings in one estimate.
    pub fn has_recordings(&self) -> bool {
        !self.recordings.is_empty()
    }

    /// The scene with the constants of `[consider]` among those of `[estimate]`; `None` where there are none.
    pub(crate) fn with_considered(&self) -> Option<SceneFile> {
        if self.scene.consider.given().is_empty() {
            return None;
        }
        let mut file = self.clone();
        let considered = std::mem::take(&mut file.scene.consider);
        file.scene.estimate = file.scene.estimate.with(&considered);
        let keys = self.places.iter().filter_map(|(path, place)| {
            let key = path.strip_prefix("consider.")?;
            Some((format!("estimate.{key}"), place.clone()))
        });
        file.places.extend(keys);
        Some(file)
    }

    /// An error that points at the key `path` (dotted; its nearest written parent where it was not written).
    pub fn invalid(&self, path: &str, message: impl Into<String>) -> Error {
        let place = self.place(path);
        Error::Scene {
            place: locate(&self.label, place),
            message: message.into(),
            excerpt: place.map_or(String::new(), |place| place.excerpt(&self.text)),
        }
    }

    /// The prior of an unknown that is one number; `None` where it is not estimated.
    ///
    /// # Errors
    /// [`Error::Scene`] naming its key.
    pub(crate) fn prior_of_one(
        &self,
        key: &str,
        unknown: &Option<Unknown>,
    ) -> Result<Option<PriorSpread>, Error> {
        let Some(unknown) = unknown else { return Ok(None) };
        let (path, prior) = self.checked(unknown.priors(key, 1))?.remove(0);
        self.checked(prior.spread(&path)).map(Some)
    }

    /// Turns a wrong key into the error that points at it.
    pub(crate) fn checked<T>(&self, read: Result<T, Invalid>) -> Result<T, Error> {
        read.map_err(|i| self.invalid(&i.path, i.message))
    }

    /// The grid of time of the window.
    ///
    /// # Errors
    /// [`Error::Scene`] where `[time]` does not say the length of a step.
    pub fn grid(&self) -> Result<TimeGrid, Error> {
        self.checked(TimeGrid::of(&self.scene))
    }

    /// Where the file that the key `path` names is.
    ///
    /// # Errors
    /// [`Error::Scene`] where a shipped scene names a file that is not shipped.
    pub(crate) fn source(&self, path: &str, file: &str) -> Result<Source, Error> {
        let from_command_line = matches!(self.place(path), Some(Place::Set(_)));
        let full = match &self.folder {
            _ if from_command_line => PathBuf::from(file),
            Some(folder) => folder.join(file),
            None => {
                return match shipped::data(file) {
                    Some(text) => Ok(Source::Shipped { name: file.to_string(), text }),
                    None => Err(self.invalid(
                        path,
                        format!(
                            "no file {file:?} is shipped; give one with --set \
                         {path}=…"
                        ),
                    )),
                };
            }
        };
        Ok(Source::File { place: locate(&self.label, self.place(path)), path: full })
    }

    fn place(&self, path: &str) -> Option<&Place> {
        let mut path = path;
        loop {
            match (self.places.get(path), path.rfind('.')) {
                (Some(place), _) => return Some(place),
                (None, Some(dot)) => path = &path[..dot],
                (None, None) => return None,
            }
        }
    }
}

/// The text of a scene and its name in messages.
#[derive(Clone, Copy)]
struct Written<'a> {
    label: &'a str,
    text: &'a Arc<str>,
}

/// Where a data file is.
pub(crate) enum Source {
    /// In the program.
    Shipped { name: String, text: &'static str },
    /// In the file system; `place` is that of the key that names it.
    File { place: String, path: PathBuf },
}

impl Source {
    /// Its name in messages.
    pub(crate) fn label(&self) -> String {
        match self {
            Source::Shipped { name, .. } => name.clone(),
            Source::File { path, .. } => path.display().to_string(),
        }
    }

    /// Its text.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub(crate) fn read(self) -> Result<String, Error> {
        match self {
            Source::Shipped { text, .. } => Ok(text.to_string()),
            Source::File { place, path } => {
                read_text(&path, DATA_BYTES).map_err(|reason| Error::Read { place, path, reason })
            }
        }
    }
}

/// The text of a file with at most `most` bytes.
fn read_text(path: &Path, most: u64) -> std::io::Result<String> {
    let mut bytes = Vec::new();
    std::fs::File::open(path)?.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let message = format!("it has more than {most} bytes");
        return Err(std::io::Error::new(std::io::ErrorKind::FileTooLarge, message));
    }
    let not_text = |message: String| std::io::Error::new(std::io::ErrorKind::InvalidData, message);
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(not_text("it is UTF-16 text: save it as UTF-8".into()));
    }
    String::from_utf8(bytes).map_err(|e| {
        let before = &e.as_bytes()[..e.utf8_error().valid_up_to()];
        let line = 1 + before.iter().filter(|byte| **byte == b'\n').count();
        not_text(format!("line {line} is no UTF-8 text"))
    })
}

fn locate(label: &str, place: Option<&Place>) -> String {
    match place {
        Some(Place::Text { line, column }) => format!("{label}:{line}:{column}"),
        Some(set @ Place::Set(_)) => set.to_string(),
        None => label.to_string(),
    }
}
