//! `cargo xtask lint`: rules about the text of the sources that no other tool checks.

use crate::root;
use std::path::{Path, PathBuf};

/// Most columns (bytes) of a line, and lines of a file of Rust.
const COLUMNS: usize = 110;
const LINES: usize = 600;

/// Folders whose files are looked at.
const FOLDERS: [&str; 5] = ["crates", "tests", "xtask", "docs", ".ci"];

/// Kinds of file that are text of ours.
const TEXT: [&str; 9] = ["rs", "md", "toml", "html", "css", "js", "py", "sh", "csv"];

/// Documents that a reader does not have.
const PRIVATE: [&str; 7] = [
    concat!("design", ".md"),
    concat!("house", ".md"),
    concat!("style", ".md"),
    concat!("stack", ".md"),
    concat!("section", " 9"),
    concat!("/work", "/"),
    concat!("/ro", "ot/"),
];

/// Folders outside of the workspace that a test may look for.
const OUTSIDE: [&str; 2] = ["shared/data", "shared/fixtures"];

/// The package that other crates reach through varda-linalg only.
const DENSE: &str = concat!("fa", "er");

/// Looks at all files; an error counts what was found, which is printed.
pub(crate) fn check() -> Result<(), String> {
    let mut files = Vec::new();
    for folder in FOLDERS {
        walk(&root().join(folder), &mut files)?;
    }
    for name in ["README.md", "Cargo.toml"] {
        files.push(root().join(name));
    }
    let mut found = Vec::new();
    for file in &files {
        let text = std::fs::read_to_string(file).map_err(|e| format!("{}: {e}", file.display()))?;
        let path = file.strip_prefix(root()).unwrap_or(file);
        found.extend(faults(path, &text));
    }
    found.iter().for_each(|fault| println!("{fault}"));
    if !found.is_empty() {
        return Err(format!("{} faults in {} files", found.len(), files.len()));
    }
    println!(
        "{} files: no line above {COLUMNS} columns, no file above {LINES} lines, no private reference",
        files.len()
    );
    Ok(())
}

/// All text files below a folder, without what is built.
fn walk(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), String> {
    let entries = std::fs::read_dir(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    paths.sort();
    for path in paths {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let kind = path.extension().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() {
            if name != "target" && name != "vendor" {
                walk(&path, files)?;
            }
        } else if TEXT.contains(&kind.as_str())
            || path.parent().and_then(Path::file_name).is_some_and(|name| name == ".ci")
        {
            files.push(path);
        }
    }
    Ok(())
}

/// What is wrong with a file, one line for each fault.
fn faults(path: &Path, text: &str) -> Vec<String> {
    let shown = path.display();
    let rust = path.extension().is_some_and(|e| e == "rs");
    let mut found = Vec::new();
    let count = text.lines().count();
    if rust && count > LINES {
        found.push(format!("{shown}: {count} lines, at most {LINES}"));
    }
    for (i, line) in text.lines().enumerate() {
        let mut fault = |what: String| found.push(format!("{shown}:{}: {what}", i + 1));
        if rust && line.len() > COLUMNS {
            fault(format!("{} columns, at most {COLUMNS}", line.len()));
        }
        if let Some(private) = PRIVATE.iter().find(|p| line.contains(**p)) {
            fault(format!("refers to {private:?}, which a reader does not have"));
        }
        if numbered_issue(line) {
            fault("refers to an issue by its number".into());
        }
        if line.contains(concat!("../", "shared")) && !OUTSIDE.iter().any(|o| line.contains(o)) {
            fault("refers to a folder that a reader does not have".into());
        }
        if names_dense(path, line) {
            fault(format!("names {DENSE}: only crates/linalg may"));
        }
    }
    found
}

/// Whether a line says "issue" and a number.
fn numbered_issue(line: &str) -> bool {
    let lower = line.to_lowercase();
    lower.match_indices("issue ").any(|(at, word)| {
        let whole_word = !lower[..at].ends_with(|c: char| c.is_alphabetic());
        whole_word && lower[at + word.len()..].starts_with(|c: char| c.is_ascii_digit())
    })
}

/// Whether a file outside of linalg uses the dense package, in code or as a dependency.
fn names_dense(path: &Path, line: &str) -> bool {
    if path.starts_with("crates/linalg") || path == Path::new("Cargo.toml") {
        return false;
    }
    let line = line.trim_start();
    match path.extension().and_then(|e| e.to_str()) {
        Some("rs") => !line.starts_with("//") && line.contains(&format!("{DENSE}::")),
        Some("toml") => [".", " ", "="].iter().any(|end| line.starts_with(&format!("{DENSE}{end}"))),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lint(path: &str, text: &str) -> Vec<String> {
        faults(Path::new(path), text)
    }

    #[test]
    fn wide_lines_and_long_files_are_found() {
        assert_eq!(lint("crates/a.rs", &"x".repeat(110)).len(), 0);
        assert_eq!(lint("crates/a.rs", &"x".repeat(111)), ["crates/a.rs:1: 111 columns, at most 110"]);
        // Columns are bytes: 56 of two bytes each.
        assert_eq!(lint("crates/a.rs", &"ε".repeat(56)).len(), 1);
        assert_eq!(lint("docs/a.md", &"x".repeat(500)).len(), 0);
        assert_eq!(lint("crates/a.rs", &"\n".repeat(600)).len(), 0);
        assert_eq!(lint("crates/a.rs", &"\n".repeat(601)), ["crates/a.rs: 601 lines, at most 600"]);
    }

    #[test]
    fn private_documents_are_found() {
        for text in PRIVATE {
            assert_eq!(lint("docs/a.md", &format!("see {text} here")).len(), 1, "{text}");
        }
        assert_eq!(lint("docs/a.md", &format!("targets of {} 4", concat!("is", "sue"))).len(), 1);
        assert_eq!(lint("docs/a.md", concat!("a tis", "sue 4, and an is", "sue of its own")).len(), 0);
        assert_eq!(lint("tests/a.rs", concat!("\"../", "shared/data\"")).len(), 0);
        assert_eq!(lint("tests/a.rs", concat!("\"../", "shared/paper\"")).len(), 1);
    }

    #[test]
    fn the_dense_package_is_named_in_linalg_alone() {
        let code = concat!("use fa", "er::Mat;");
        assert_eq!(lint("crates/linalg/src/a.rs", code).len(), 0);
        assert_eq!(lint("tests/src/a.rs", code).len(), 1);
        assert_eq!(lint("tests/src/a.rs", &format!("// {code}")).len(), 0);
        let dependency = concat!("fa", "er.workspace = true");
        assert_eq!(lint("crates/linalg/Cargo.toml", dependency).len(), 0);
        assert_eq!(lint("crates/rod/Cargo.toml", dependency).len(), 1);
    }
}
