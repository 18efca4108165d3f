//! `cargo xtask docs`: the documentation of all crates, guides and pages with formulas, and an index page;
//! `--check` judges it.
//!
//! Pages are modules of the package `guide`, so that rustdoc renders them and `cargo test` runs their code.
//! Afterwards links between .md files are turned into links between pages, and formulas (`` $`…`$ `` and
//! blocks marked `math`, as GitHub writes them) are marked for KaTeX, which stands beside the pages.

mod front;
pub(crate) mod html;
mod links;
mod pages;

use crate::browser::{self, Report};
use crate::{cargo, root, run};
use std::path::{Path, PathBuf};

/// Libraries that are documented, each after those that it links to.
const CRATES: [&str; 7] = [
    "varda-linalg",
    "varda-covariance",
    "varda-implicit",
    "varda-rod",
    "varda-assimilation",
    "varda",
    "guide",
];

/// `cargo xtask docs [--check]`.
pub(crate) fn command(arguments: &[&str]) -> Result<(), String> {
    match arguments {
        [] => build().map(|_| ()),
        ["--check"] => check(),
        other => Err(format!("unknown arguments of docs: {}", other.join(" "))),
    }
}

/// Builds everything, warnings denied; the folder of the pages.
fn build() -> Result<PathBuf, String> {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
    let site = target.join("doc");
    if site.exists() {
        // Pages of items that are no more.
        std::fs::remove_dir_all(&site).map_err(|e| format!("{}: {e}", site.display()))?;
    }
    // One after the other: rustdoc links to another crate only where that crate's folder stands, and cargo
    // empties a folder before its crate is written.
    for name in CRATES {
        let mut command = cargo();
        command.args(["doc", "--quiet", "--no-deps", "--lib", "--all-features", "-p", name]);
        run(command.env("RUSTDOCFLAGS", "--deny warnings").current_dir(root()))?;
    }
    pages::finish(&site)?;
    front::write_index(&site)?;
    println!("{}", site.join("index.html").display());
    Ok(site)
}

/// Builds, then looks for broken links and formulas that are not rendered.
fn check() -> Result<(), String> {
    let site = build()?;
    let mut faults = links::check(&site)?;
    let pages = browser_pages(&site)?;
    if let Some(report) = browser::look(&site, &pages, include_str!("docs/harness.js"))? {
        let Report { faults: found, seen, counts } = report;
        if counts.len() != 2 || counts[0] != 2 * pages.len() || counts[1] == 0 {
            return Err(format!("the browser looked at {seen} of {} pages in two widths", pages.len()));
        }
        faults.extend(found);
    }
    faults.iter().for_each(|fault| println!("{fault}"));
    if faults.is_empty() { Ok(()) } else { Err(format!("{} faults in the documentation", faults.len())) }
}

/// Pages that the browser opens: the index, all of the guide, the front page of every crate.
fn browser_pages(site: &Path) -> Result<Vec<String>, String> {
    let mut found = vec!["index.html".to_string()];
    found.extend(pages::list()?.into_iter().map(|page| page.html));
    found.extend(
        CRATES.iter().filter(|c| **c != "guide").map(|c| format!("{}/index.html", c.replace('-', "_"))),
    );
    match found.iter().find(|page| !site.join(page).is_file()) {
        Some(page) => Err(format!("{}: no page {page}", site.display())),
        None => Ok(found),
    }
}

fn read(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))
}

fn write(path: &Path, text: &str) -> Result<(), String> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    }
    std::fs::write(path, text).map_err(|e| format!("{}: {e}", path.display()))
}

fn copy(from: &Path, to: &Path) -> Result<(), String> {
    if let Some(folder) = to.parent() {
        std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    }
    std::fs::copy(from, to).map(|_| ()).map_err(|e| format!("{}: {e}", from.display()))
}
