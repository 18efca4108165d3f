//! The output folder: whole or absent.
//!
//! A result `r` is made next to its place, in `.r.varda-<run>/`, and renamed; an earlier result is meanwhile
//! `.r.varda-<run>-earlier-<n>/`, and `…-earlier-<n>-replaced/` while it is being deleted. The run holds a
//! lock on `.r.varda-<run>.lock` until nothing of it is left. A lock that nobody holds is that of a run that
//! was killed: the next run into `r` removes what it left, and puts back the earlier result it had no time to
//! replace.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use crate::Error;

/// A folder being filled beside its final place. Dropped without [`ResultFolder::publish`], it is removed.
#[derive(Debug)]
pub struct ResultFolder {
    target: PathBuf,
    temporary: PathBuf,
    published: bool,
    found: Found,
    /// Its file goes when nothing else of the run is left.
    _lock: Lock,
}

/// What killed runs into the same folder had left.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Found {
    /// Folders that were removed.
    pub removed: Vec<PathBuf>,
    /// An earlier result was put back.
    pub put_back: bool,
}

/// A file that is locked as long as its run lives, and removed at its end.
#[derive(Debug)]
struct Lock {
    path: PathBuf,
    _file: File,
}

/// How often [`ResultFolder::publish`] gives way to another run that puts its folder into the same place.
const ATTEMPTS: usize = 100;
/// How often [`replaceable`] looks at a folder that seems to be no result, a millisecond apart.
const LOOKS: usize = 20;

impl ResultFolder {
    /// Starts a folder that will become `target`. Clears away first what killed runs into it have left: see
    /// [`found`](Self::found).
    ///
    /// # Errors
    /// [`Error::Occupied`] where `target` exists and is not an earlier result of Varda; [`Error::Write`].
    pub fn begin(target: &Path) -> Result<ResultFolder, Error> {
        replaceable(target)?;
        let parent = match target.parent() {
            Some(p) if !p.as_os_str().is_empty() => p.to_path_buf(),
            _ => PathBuf::from("."),
        };
        std::fs::create_dir_all(&parent).map_err(|reason| Error::Write { path: parent.clone(), reason })?;
        let prefix = prefix(target);
        let found = clear(&parent, &prefix, target)?;
        let (temporary, lock) = Lock::new(&parent, &prefix)?;
        std::fs::create_dir(&temporary).map_err(|reason| Error::Write { path: temporary.clone(), reason })?;
        Ok(ResultFolder { target: target.to_path_buf(), temporary, published: false, found, _lock: lock })
    }

    /// What killed runs had left, and is no longer there.
    pub fn found(&self) -> &Found {
        &self.found
    }

    /// Writes one file; `name` is relative to the folder.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, name: &str, text: &str) -> Result<(), Error> {
        self.write_with(name, |file| file.write_all(text.as_bytes()))
    }

    /// Writes one file piece by piece; `name` is relative to the folder.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write_with(
        &self,
        name: &str,
        write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
    ) -> Result<(), Error> {
        let path = self.temporary.join(name);
        let folder = path.parent().unwrap_or(&self.temporary);
        std::fs::create_dir_all(folder)
            .and_then(|()| {
                let mut file = BufWriter::new(File::create(&path)?);
                write(&mut file)?;
                file.flush()
            })
            .map_err(|reason| Error::Write { path: self.target.join(name), reason })
    }

    /// Puts the folder in its final place, replacing an earlier result.
    ///
    /// # Errors
    /// [`Error::Occupied`], [`Error::Write`]; nothing is left half-written, and an earlier result stays.
    pub fn publish(mut self) -> Result<PathBuf, Error> {
        let failed = |reason| Error::Write { path: self.target.clone(), reason };
        let mut earlier = Vec::new();
        // Another run may put its folder there between any two of these steps: then this one takes that one's
        // place in turn.
        let last = loop {
            replaceable(&self.target)?;
            if self.target.exists() {
                let aside = beside(&self.temporary, &format!("{EARLIER}{}", earlier.len()));
                match std::fs::rename(&self.target, &aside) {
                    Ok(()) => earlier.push(aside),
                    Err(e) if e.kind() == ErrorKind::NotFound => {}
                    Err(e) => break Err(e),
                }
            }
            match std::fs::rename(&self.temporary, &self.target) {
                Err(e) if matches!(e.kind(), ErrorKind::DirectoryNotEmpty | ErrorKind::AlreadyExists) => {
                    if earlier.len() == ATTEMPTS {
                        break Err(e);
                    }
                }
                done => break done,
            }
        };
        if let Err(reason) = last {
            if let Some(aside) = earlier.last().filter(|_| !self.target.exists()) {
                std::fs::rename(aside, &self.target).map_err(failed)?;
            }
            return Err(failed(reason));
        }
        self.published = true;
        earlier.iter().try_for_each(|aside| discard(aside))?;
        Ok(self.target.clone())
    }
}

impl Drop for ResultFolder {
    fn drop(&mut self) {
        if !self.published {
            // Nothing more can be done about a folder that will not go away while failing already.
            let _ = std::fs::remove_dir_all(&self.temporary);
        }
    }
}

impl Lock {
    /// A name for a run that no other has or had, and its lock.
    fn new(parent: &Path, prefix: &str) -> Result<(PathBuf, Lock), Error> {
        loop {
            let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
            let temporary = parent.join(format!("{prefix}{}-{}", std::process::id(), since.as_nanos()));
            let path = beside(&temporary, LOCK);
            let file = match OpenOptions::new().write(true).create_new(true).open(&path) {
                Err(e) if e.kind() == ErrorKind::AlreadyExists => continue,
                made => made.map_err(|reason| Error::Write { path: path.clone(), reason })?,
            };
            // Without locks in the file system the folders of killed runs are not removed.
            let locked = file.lock().is_ok();
            // Another run may have removed it before it was locked.
            if !locked || path.exists() {
                return Ok((temporary, Lock { path, _file: file }));
            }
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // If it cannot be removed, the next run finds it unlocked.
        let _ = std::fs::remove_file(&self.path);
    }
}

const LOCK: &str = ".lock";
const EARLIER: &str = "-earlier-";
const REPLACED: &str = "-replaced";

/// The beginning of the hidden names of a target.
fn prefix(target: &Path) -> String {
    format!(".{}.varda-", target.file_name().map_or("varda".into(), |n| n.to_string_lossy()))
}

fn beside(temporary: &Path, ending: &str) -> PathBuf {
    let mut name = temporary.file_name().unwrap_or_default().to_os_string();
    name.push(ending);
    temporary.with_file_name(name)
}

/// Deletes an earlier result, under another name first: a half-deleted result must not be put back.
fn discard(aside: &Path) -> Result<(), Error> {
    let replaced = beside(aside, REPLACED);
    std::fs::rename(aside, &replaced)
        .and_then(|()| std::fs::remove_dir_all(&replaced))
        .map_err(|reason| Error::Write { path: aside.to_path_buf(), reason })
}

/// Removes the folders of runs whose lock is free; puts an earlier result back if there is none.
fn clear(parent: &Path, prefix: &str, target: &Path) -> Result<Found, Error> {
    let mut found = Found::default();
    let names = || -> Vec<String> {
        let entries = std::fs::read_dir(parent).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
        names.retain(|n| n.starts_with(prefix));
        names.sort();
        names
    };
    let is_run = |run: &str| {
        let digits = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
        run.split_once('-').is_some_and(|(process, time)| digits(process) && digits(time))
    };
    for lock in names() {
        let Some(run) = lock.strip_suffix(LOCK) else { continue };
        if !is_run(&run[prefix.len()..]) {
            continue;
        }
        let path = parent.join(&lock);
        let Ok(file) = OpenOptions::new().write(true).open(&path) else { continue };
        if file.try_lock().is_err() {
            continue;
        }
        for name in names() {
            let folder = parent.join(&name);
            let failed = |reason| Error::Write { path: folder.clone(), reason };
            let ending = name.strip_prefix(run);
            let earlier = ending.is_some_and(|e| e.starts_with(EARLIER) && !e.ends_with(REPLACED));
            let replaced = ending.is_some_and(|e| e.starts_with(EARLIER) && e.ends_with(REPLACED));
            if earlier && !target.exists() {
                match std::fs::rename(&folder, target) {
                    Ok(()) => found.put_back = true,
                    // Another run was faster.
                    Err(_) if target.exists() => discard(&folder)?,
                    Err(reason) => return Err(failed(reason)),
                }
            } else if earlier {
                discard(&folder)?;
                found.removed.push(folder);
            } else if replaced || ending == Some("") {
                std::fs::remove_dir_all(&folder).map_err(failed)?;
                found.removed.push(folder);
            }
        }
        // Last, so that a folder that could not be removed is found again.
        let _ = std::fs::remove_file(&path);
    }
    Ok(found)
}

/// Whether `target` is free for a result, or holds one. Another run may exchange the folder between two
/// looks at it, which then seems to be no result: only what stays so is occupied.
fn replaceable(target: &Path) -> Result<(), Error> {
    for _ in 1..LOOKS {
        if in_the_way(target).is_none() {
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    match in_the_way(target) {
        None => Ok(()),
        Some(reason) => Err(Error::Occupied { path: target.to_path_buf(), reason }),
    }
}

/// Why what is at `target` is not to be replaced. A result of Varda is a folder with a `summary.json` that
/// has its keys `scene`, `version` and `status`.
fn in_the_way(target: &Path) -> Option<&'static str> {
    if !target.exists() {
        return None;
    }
    if !target.is_dir() {
        return Some("it is a file");
    }
    if std::fs::read_dir(target).is_ok_and(|mut entries| entries.next().is_none()) {
        return None;
    }
    let summary = std::fs::read_to_string(target.join("summary.json")).unwrap_or_default();
    let keys = serde_json::from_str::<serde_json::Value>(&summary).unwrap_or_default();
    let is_result = ["version", "scene", "status"].iter().all(|key| keys[key].is_string());
    (!is_result).then_some("it has no summary.json of Varda's")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let path = std::env::temp_dir().join(format!("varda-output-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        path
    }

    const SUMMARY: &str = r#"{"scene": "s", "version": "0.1.0", "status": "converged"}"#;

    #[test]
    fn an_earlier_result_is_replaced_whole() {
        let parent = folder("replace");
        let target = parent.join("result");
        for content in ["first", "second"] {
            let out = ResultFolder::begin(&target).unwrap();
            out.write("summary.json", SUMMARY).unwrap();
            out.write(&format!("{content}.csv"), content).unwrap();
            assert!(!target.join(format!("{content}.csv")).exists(), "nothing shows before it is published");
            out.publish().unwrap();
        }
        assert!(!target.join("first.csv").exists());
        assert_eq!(std::fs::read_to_string(target.join("second.csv")).unwrap(), "second");
        assert_eq!(std::fs::read_dir(&parent).unwrap().count(), 1, "no temporary folder is left");
        std::fs::remove_dir_all(&parent).unwrap();
    }

    #[test]
    fn anything_else_is_refused_and_left_alone() {
        let parent = folder("refuse");
        let target = parent.join("thesis");
        std::fs::create_dir(&target).unwrap();
        std::fs::write(target.join("chapter1.tex"), "years of work").unwrap();
        assert!(matches!(ResultFolder::begin(&target), Err(Error::Occupied { .. })));
        std::fs::write(target.join("summary.json"), "{}").unwrap();
        assert!(matches!(ResultFolder::begin(&target), Err(Error::Occupied { .. })));
        assert!(matches!(ResultFolder::begin(&target.join("chapter1.tex")), Err(Error::Occupied { .. })));
        assert_eq!(std::fs::read_to_string(target.join("chapter1.tex")).unwrap(), "years of work");
        assert_eq!(std::fs::read_dir(&parent).unwrap().count(), 1);
        std::fs::remove_dir_all(&parent).unwrap();
    }

    fn names(parent: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(parent)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// A killed run is one whose lock is free; here it is made by hand.
    #[test]
    fn what_a_killed_run_left_is_removed_and_nothing_else() {
        let parent = folder("killed");
        let target = parent.join("result");
        let alive = ResultFolder::begin(&target).unwrap();
        let left = [
            ".result.varda-7-1",
            ".result.varda-7-1-earlier-0",
            ".result.varda-8-2",
            ".result.varda-8-2-earlier-0-replaced",
        ];
        let others = [
            ".other.varda-7-1",
            ".result.varda-9-3",
            ".result.varda-notes",
            ".result.varda-7-1.txt",
            ".result.varda-x-y.lock",
        ];
        for name in left.iter().chain(&others) {
            std::fs::create_dir(parent.join(name)).unwrap();
            std::fs::write(parent.join(name).join("summary.json"), SUMMARY).unwrap();
        }
        for lock in [".result.varda-7-1.lock", ".result.varda-8-2.lock", ".other.varda-7-1.lock"] {
            std::fs::write(parent.join(lock), "").unwrap();
        }
        let out = ResultFolder::begin(&target).unwrap();
        let removed = [left[0], left[2], left[3]].map(|name| parent.join(name));
        assert_eq!(out.found(), &Found { removed: removed.to_vec(), put_back: true });
        assert!(target.join("summary.json").is_file(), "the earlier result is back in its place");
        drop(out);
        alive.write("summary.json", SUMMARY).unwrap();
        alive.publish().unwrap();
        let mut expected = others.to_vec();
        expected.extend([".other.varda-7-1.lock", "result"]);
        expected.sort_unstable();
        assert_eq!(names(&parent), expected);
        std::fs::remove_dir_all(&parent).unwrap();
    }

    #[test]
    fn a_failure_leaves_nothing() {
        let parent = folder("failure");
        let out = ResultFolder::begin(&parent.join("result")).unwrap();
        out.write("analysis.csv", "1").unwrap();
        drop(out);
        assert_eq!(std::fs::read_dir(&parent).unwrap().count(), 0);
        std::fs::remove_dir_all(&parent).unwrap();
    }
}
