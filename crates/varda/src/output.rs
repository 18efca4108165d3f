//! The output folder: whole or absent.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::Error;

/// A folder being filled beside its final place. Dropped without [`Output::publish`], it is removed.
#[derive(Debug)]
pub struct Output {
    target: PathBuf,
    temporary: PathBuf,
    published: bool,
}

/// How often [`Output::publish`] gives way to another run that puts its folder into the same place.
const ATTEMPTS: usize = 100;

impl Output {
    /// Starts a folder that will become `target`.
    ///
    /// # Errors
    /// [`Error::Occupied`] where `target` exists and is not an earlier result of Varda; [`Error::Write`].
    pub fn begin(target: &Path) -> Result<Output, Error> {
        replaceable(target)?;
        let name = target.file_name().map_or("varda".into(), |n| n.to_string_lossy());
        let parent = match target.parent() {
            Some(p) if !p.as_os_str().is_empty() => p.to_path_buf(),
            _ => PathBuf::from("."),
        };
        let temporary = parent.join(format!(".{name}.varda-{}", std::process::id()));
        let failed = |source| Error::Write { path: temporary.clone(), source };
        if temporary.exists() {
            std::fs::remove_dir_all(&temporary).map_err(failed)?;
        }
        std::fs::create_dir_all(&temporary).map_err(failed)?;
        Ok(Output { target: target.to_path_buf(), temporary, published: false })
    }

    /// Writes one file; `name` is relative to the folder.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn write(&self, name: &str, text: &str) -> Result<(), Error> {
        let path = self.temporary.join(name);
        let folder = path.parent().unwrap_or(&self.temporary);
        std::fs::create_dir_all(folder)
            .and_then(|()| std::fs::write(&path, text))
            .map_err(|source| Error::Write { path: self.target.join(name), source })
    }

    /// Puts the folder in its final place, replacing an earlier result.
    ///
    /// # Errors
    /// [`Error::Occupied`], [`Error::Write`]; nothing is left half-written, and an earlier result stays.
    pub fn publish(mut self) -> Result<PathBuf, Error> {
        let failed = |source| Error::Write { path: self.target.clone(), source };
        let mut earlier = Vec::new();
        // Another run may put its folder there between any two of these steps: then this one takes that one's place in turn.
        let last = loop {
            replaceable(&self.target)?;
            if self.target.exists() {
                let name = format!("varda-{}-earlier-{}", std::process::id(), earlier.len());
                let aside = self.temporary.with_extension(name);
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
        if let Err(source) = last {
            if let Some(aside) = earlier.last().filter(|_| !self.target.exists()) {
                std::fs::rename(aside, &self.target).map_err(failed)?;
            }
            return Err(failed(source));
        }
        self.published = true;
        for aside in earlier {
            std::fs::remove_dir_all(&aside).map_err(|source| Error::Write { path: aside.clone(), source })?;
        }
        Ok(self.target.clone())
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if !self.published {
            // Nothing more can be done about a folder that will not go away while failing already.
            let _ = std::fs::remove_dir_all(&self.temporary);
        }
    }
}

/// A result of Varda is a folder with a `summary.json` that has its keys `scene`, `version` and `status`.
fn replaceable(target: &Path) -> Result<(), Error> {
    let occupied = |reason| Err(Error::Occupied { path: target.to_path_buf(), reason });
    if !target.exists() {
        return Ok(());
    }
    if !target.is_dir() {
        return occupied("it is a file");
    }
    let empty = std::fs::read_dir(target).map(|mut d| d.next().is_none()).unwrap_or(false);
    if empty {
        return Ok(());
    }
    let summary = std::fs::read_to_string(target.join("summary.json")).unwrap_or_default();
    match serde_json::from_str::<serde_json::Value>(&summary) {
        Ok(json)
            if json["version"].is_string() && json["scene"].is_string() && json["status"].is_string() =>
        {
            Ok(())
        }
        _ => occupied("it has no summary.json of Varda's"),
    }
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
            let out = Output::begin(&target).unwrap();
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
        assert!(matches!(Output::begin(&target), Err(Error::Occupied { .. })));
        std::fs::write(target.join("summary.json"), "{}").unwrap();
        assert!(matches!(Output::begin(&target), Err(Error::Occupied { .. })));
        assert!(matches!(Output::begin(&target.join("chapter1.tex")), Err(Error::Occupied { .. })));
        assert_eq!(std::fs::read_to_string(target.join("chapter1.tex")).unwrap(), "years of work");
        assert_eq!(std::fs::read_dir(&parent).unwrap().count(), 1);
        std::fs::remove_dir_all(&parent).unwrap();
    }

    #[test]
    fn a_failure_leaves_nothing() {
        let parent = folder("failure");
        let out = Output::begin(&parent.join("result")).unwrap();
        out.write("analysis.csv", "1").unwrap();
        drop(out);
        assert_eq!(std::fs::read_dir(&parent).unwrap().count(), 0);
        std::fs::remove_dir_all(&parent).unwrap();
    }
}
