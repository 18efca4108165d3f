//! The checkpoint of a sequence of windows: a folder `<result>.partial` next to the result, from which a run
//! can be resumed.
//!
//! ```text
//! scene.json     the scene, overrides and defaults included
//! data.json      a checksum of every file it names
//! cycles.jsonl   the rows of the windows done, one on a line
//! state.json     the start of the next window; it decides which rows count
//! lock           locked by the run that writes here
//! ```
//!
//! The state is written under another name and renamed, so that a run killed at any moment leaves the state
//! after its last finished window; a row after it is removed when the run is resumed.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value as Json;
use varda_assimilation::CycleState;

use crate::Error;
use crate::outcome::CycleRow;
use crate::scene::{Scene, SceneFile};
use crate::setup::files::InputFile;

/// The folder, open for the windows to come.
#[derive(Debug)]
pub struct Checkpoint {
    folder: PathBuf,
    rows: File,
    /// Freed with the process, however it ends.
    _lock: File,
}

/// An unfinished run, taken up.
#[derive(Debug)]
pub struct Resumed {
    /// The folder.
    pub checkpoint: Checkpoint,
    /// The state after the last finished window; `None` where no window was finished.
    pub state: Option<CycleState>,
    /// The rows of the finished windows.
    pub done: Vec<CycleRow>,
}

/// [`CycleState`] with the version that wrote it.
#[derive(Serialize, Deserialize)]
struct Stored {
    version: String,
    next: usize,
    background: Vec<f64>,
    columns: Vec<f64>,
}

impl Checkpoint {
    /// The folder of a result.
    pub fn folder(result: &Path) -> PathBuf {
        let mut name = result.file_name().unwrap_or("varda".as_ref()).to_os_string();
        name.push(".partial");
        result.with_file_name(name)
    }

    /// Begins the folder of a new run.
    ///
    /// # Errors
    /// [`Error::Unfinished`] where there is one already, [`Error::Write`].
    pub fn begin(result: &Path, file: &SceneFile, inputs: &[InputFile]) -> Result<Checkpoint, Error> {
        let folder = Checkpoint::folder(result);
        let failed = |reason| Error::Write { path: folder.clone(), reason };
        if let Some(parent) = folder.parent() {
            std::fs::create_dir_all(parent).map_err(failed)?;
        }
        match std::fs::create_dir(&folder) {
            Err(e) if e.kind() == std::io::ErrorKind::AlreadyExists => {
                return Err(Error::Unfinished { path: folder });
            }
            made => made.map_err(failed)?,
        }
        let lock = lock(&folder)?;
        let sums: BTreeMap<&str, u64> = inputs.iter().map(|i| (i.key.as_str(), i.checksum)).collect();
        replace(&folder, "data.json", &json(&sums))?;
        replace(&folder, "scene.json", &json(&file.scene))?;
        let rows = File::create_new(folder.join("cycles.jsonl")).map_err(failed)?;
        Ok(Checkpoint { folder, rows, _lock: lock })
    }

    /// Resumes the run of a scene. A run that ended within its first window begins again, without a state.
    /// The number of windows may differ from before; the scene, and `inputs`, the files it names, may not.
    ///
    /// # Errors
    /// [`Error::Resume`] where there is nothing to resume, or it belongs to another scene or version, or to a
    /// run that has not ended; [`Error::Write`].
    pub fn resume(result: &Path, file: &SceneFile, inputs: &[InputFile]) -> Result<Resumed, Error> {
        let folder = Checkpoint::folder(result);
        let refuse = |reason: &str| Error::Resume { path: folder.clone(), reason: reason.to_string() };
        if !folder.is_dir() {
            return Err(refuse("there is no unfinished run"));
        }
        let lock = lock(&folder)?;
        let read = |name: &str| std::fs::read_to_string(folder.join(name));
        let unfit = |name: &str, e: serde_json::Error| refuse(&format!("{name}: {e}"));
        let scene: Scene = match read("scene.json") {
            Ok(text) => stored(&text).map_err(|e| unfit("scene.json", e))?,
            Err(_) => return Err(refuse("it has no scene.json; remove it and begin again")),
        };
        if let Some(difference) = difference("", &uncounted(&scene), &uncounted(&file.scene)) {
            return Err(refuse(&format!(
                "it belongs to another scene, seed or --set: {difference}; only algorithm.cycles.count may \
                 differ"
            )));
        }
        let text = read("data.json").unwrap_or_default();
        let before: BTreeMap<String, u64> = stored(&text).map_err(|e| unfit("data.json", e))?;
        for InputFile { key, path, checksum } in inputs {
            if before.get(key) != Some(checksum) {
                return Err(refuse(&format!("the file {path} ({key}) has changed since it was begun")));
            }
        }
        replace(&folder, "scene.json", &json(&file.scene))?;
        let failed = |reason| Error::Write { path: folder.join("cycles.jsonl"), reason };
        let mut rows = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(folder.join("cycles.jsonl"))
            .map_err(failed)?;
        let (mut state, mut done, mut length) = (None, Vec::new(), 0);
        if let Ok(text) = read("state.json") {
            let written: Stored = stored(&text).map_err(|e| unfit("state.json", e))?;
            if written.version != env!("CARGO_PKG_VERSION") {
                return Err(refuse(&format!("it was written by version {}", written.version)));
            }
            let text = read("cycles.jsonl").map_err(failed)?;
            for line in text.split_inclusive('\n').take(written.next) {
                done.push(stored::<CycleRow>(line).map_err(|e| unfit("cycles.jsonl", e))?);
                length += line.len() as u64;
            }
            if done.len() != written.next {
                return Err(refuse("cycles.jsonl has fewer rows than state.json says"));
            }
            let after = written.state();
            let CycleState { background, columns, .. } = &after;
            let n = background.len();
            let fits = |row: &CycleRow| row.background.len() == n && row.analysis.len() == n;
            let finite = background.iter().chain(columns).all(|x| x.is_finite());
            if n == 0 || columns.len() % n != 0 || !finite || !done.iter().all(fits) {
                return Err(refuse("state.json and cycles.jsonl do not fit one another"));
            }
            state = Some(after);
        }
        rows.set_len(length).and_then(|()| rows.seek(std::io::SeekFrom::End(0))).map_err(failed)?;
        Ok(Resumed { checkpoint: Checkpoint { folder, rows, _lock: lock }, state, done })
    }

    /// Stores a window that is done and what the next one starts from.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn store(&mut self, row: &CycleRow, state: &CycleState) -> Result<(), Error> {
        let mut line = json(row);
        line.push('\n');
        self.rows
            .write_all(line.as_bytes())
            .map_err(|reason| Error::Write { path: self.folder.join("cycles.jsonl"), reason })?;
        replace(&self.folder, "state.json", &json(&Stored::of(state)))
    }

    /// Removes the folder: its run is finished.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn remove(self) -> Result<(), Error> {
        std::fs::remove_dir_all(&self.folder)
            .map_err(|reason| Error::Write { path: self.folder.clone(), reason })
    }
}

/// The rows of the finished windows and the state after them as a text, for processes that share the run.
pub fn to_text(state: Option<&CycleState>, done: &[CycleRow]) -> String {
    json(&(state.map(Stored::of), done))
}

/// What [`to_text`] has written.
///
/// # Errors
/// What serde says of another text.
pub fn from_text(text: &str) -> Result<(Option<CycleState>, Vec<CycleRow>), serde_json::Error> {
    let (state, done): (Option<Stored>, Vec<CycleRow>) = stored(text)?;
    Ok((state.map(Stored::state), done))
}

impl Stored {
    fn of(state: &CycleState) -> Stored {
        Stored {
            version: env!("CARGO_PKG_VERSION").to_string(),
            next: state.next,
            background: state.background.clone(),
            columns: state.columns.clone(),
        }
    }

    fn state(self) -> CycleState {
        CycleState { next: self.next, background: self.background, columns: self.columns }
    }
}

/// The scene with one window: what must be equal when a run is resumed.
fn uncounted(scene: &Scene) -> Json {
    let mut scene = scene.clone();
    if let Some(cycles) = &mut scene.algorithm.cycles {
        cycles.count = 1;
    }
    serde_json::to_value(&scene).expect("plain data")
}

/// The first key, dotted, at which two scenes differ, and how.
fn difference(key: &str, before: &Json, now: &Json) -> Option<String> {
    if let (Json::Object(b), Json::Object(n)) = (before, now) {
        let below = |k: &String| if key.is_empty() { k.clone() } else { format!("{key}.{k}") };
        let keys: BTreeSet<&String> = b.keys().chain(n.keys()).collect();
        let of =
            |table: &serde_json::Map<String, Json>, k: &String| table.get(k).cloned().unwrap_or_default();
        return keys.into_iter().find_map(|k| difference(&below(k), &of(b, k), &of(n, k)));
    }
    let shown = |value: &Json| match value.to_string() {
        _ if value.is_null() => "not given".to_string(),
        text if text.chars().count() > 40 => "another value".to_string(),
        text => text,
    };
    (before != now).then(|| format!("{key} was {} and is {} now", shown(before), shown(now)))
}

/// Reads what [`json`] wrote. Both use a [`Json`] value, as scenes do: a second reader and writer for every
/// type would add much to the time that building this crate takes.
fn stored<T: DeserializeOwned>(text: &str) -> Result<T, serde_json::Error> {
    serde_json::from_value(serde_json::from_str(text)?)
}

fn json(value: &impl Serialize) -> String {
    serde_json::to_value(value).expect("plain data").to_string()
}

/// Writes a file beside its place and renames it.
fn replace(folder: &Path, name: &str, text: &str) -> Result<(), Error> {
    let (path, beside) = (folder.join(name), folder.join(format!("{name}.new")));
    std::fs::write(&beside, text)
        .and_then(|()| std::fs::rename(&beside, &path))
        .map_err(|reason| Error::Write { path, reason })
}

fn lock(folder: &Path) -> Result<File, Error> {
    let path = folder.join("lock");
    let failed = |reason| Error::Write { path: path.clone(), reason };
    let file = OpenOptions::new().create(true).truncate(false).write(true).open(&path).map_err(failed)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => {
            Err(Error::Resume { path: folder.to_path_buf(), reason: "another run is writing to it".into() })
        }
        Err(TryLockError::Error(source)) => Err(failed(source)),
    }
}
