//! Dependencies: no crate draws in what it does without; licences, sources and semantic versions by tools
//! where they are installed.

use crate::{cargo, installed, root, run};
use std::process::Command;

/// What a crate does without, built alone with its default features.
const WITHOUT: [(&str, &[&str]); 6] = [
    ("varda-linalg", &["nalgebra", "sprs", "ndarray", "rand", "serde"]),
    ("varda-covariance", &["nalgebra", "sprs", "ndarray", "serde"]),
    ("varda-implicit", &["nalgebra", "sprs", "ndarray", "rand", "serde"]),
    ("varda-rod", &["sprs", "ndarray", "rand", "serde"]),
    ("varda-assimilation", &["nalgebra", "sprs", "ndarray", "argmin", "serde", "varda-rod"]),
    ("varda", &["openssl-sys", "pyo3", "mpi", "mpi-sys"]),
];

pub(crate) fn check() -> Result<(), String> {
    for (package, without) in WITHOUT {
        let tree = ["tree", "--locked", "--prefix", "none", "-e", "normal", "--format", "{p}", "-p", package];
        let output =
            cargo().args(tree).current_dir(root()).output().map_err(|e| format!("cargo tree: {e}"))?;
        if !output.status.success() {
            return Err(format!("cargo tree: {}", String::from_utf8_lossy(&output.stderr)));
        }
        drawn(package, without, &String::from_utf8_lossy(&output.stdout))?;
    }
    println!("{} crates draw in nothing that they do without", WITHOUT.len());
    if installed("deny", "licences and sources are not checked") {
        run(cargo()
            .args(["deny", "--workspace", "check", "bans", "licenses", "sources"])
            .current_dir(root()))?;
    }
    semver()
}

/// The public interfaces against those of the last release.
fn semver() -> Result<(), String> {
    let tag = Command::new("git").args(["describe", "--tags", "--abbrev=0"]).current_dir(root()).output();
    let Some(tag) = tag.ok().filter(|t| t.status.success()) else {
        println!("skipped: no release is tagged that interfaces could be compared with");
        return Ok(());
    };
    if installed("semver-checks", "interfaces are not compared with the last release") {
        let tag = String::from_utf8_lossy(&tag.stdout).trim().to_string();
        let arguments = ["semver-checks", "--workspace", "--baseline-rev", &tag];
        run(cargo().args(arguments).current_dir(root()))?;
    }
    Ok(())
}

/// An error if a package stands in the lines of `cargo tree` that should not.
fn drawn(package: &str, without: &[&str], tree: &str) -> Result<(), String> {
    match tree.lines().filter_map(|l| l.split(' ').next()).find(|p| without.contains(p)) {
        Some(drawn) => Err(format!("{package} draws in {drawn}, which it did without")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_package_that_is_drawn_in_is_named() {
        let tree = "varda-rod v0.1.0 (/x)\nnalgebra v0.35.0\nserde v1.0.0 (*)\n";
        assert!(drawn("varda-rod", &["serde"], tree).unwrap_err().contains("serde"));
        assert_eq!(drawn("varda-rod", &["rand", "nal"], tree), Ok(()));
    }
}
