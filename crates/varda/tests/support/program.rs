//! The built binary, in a folder of its own.

#![allow(dead_code)]

use std::path::PathBuf;
use std::process::{Command, Output};

/// A folder of its own for every test, removed at the end.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("varda-command-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    pub(crate) fn varda(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_varda")).args(arguments).current_dir(&self.0).output().unwrap()
    }

    /// The one message of a run that must fail and leave nothing behind.
    pub(crate) fn refusal(&self, arguments: &[&str]) -> String {
        let before = self.entries();
        let output = self.varda(arguments);
        assert!(!output.status.success(), "{arguments:?} should fail");
        assert!(output.stdout.is_empty(), "an error prints to stderr only");
        let message = String::from_utf8(output.stderr).unwrap();
        let mut lines = message.lines();
        assert!(lines.next().is_some_and(|line| line.starts_with("error: ")), "one message: {message}");
        // an error of a scene shows its line, with a mark below
        let excerpt: Vec<&str> = lines.collect();
        let is_excerpt = |lines: &[&str]| {
            lines.len() == 2 && lines[0].contains(" | ") && lines[1].trim_start().starts_with("| ")
        };
        assert!(excerpt.is_empty() || is_excerpt(&excerpt), "one message: {message}");
        assert_eq!(self.entries(), before, "nothing half-written is left");
        message
    }

    fn entries(&self) -> Vec<PathBuf> {
        let mut all = Vec::new();
        let mut open = vec![self.0.clone()];
        while let Some(folder) = open.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    open.push(path.clone());
                }
                // `out` itself may appear: it is the parent of results.
                if path != self.0.join("out") {
                    all.push(path);
                }
            }
        }
        all.sort();
        all
    }

    pub(crate) fn read(&self, file: &str) -> String {
        std::fs::read_to_string(self.0.join(file)).unwrap_or_else(|e| panic!("{file}: {e}"))
    }

    pub(crate) fn summary(&self, folder: &str) -> serde_json::Value {
        serde_json::from_str(&self.read(&format!("{folder}/summary.json"))).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// What a run that must succeed prints.
pub(crate) fn text(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}
