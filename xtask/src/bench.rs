//! `cargo xtask bench`.

use crate::{cargo, root, run};

/// Benches: the name, and the example of package varda that is it.
const BENCHES: [(&str, &str); 1] = [("case4", "case4_study")];

/// Runs one bench in a release build, handing it the rest of the arguments.
pub(crate) fn run_one(arguments: &[&str]) -> Result<(), String> {
    let known = || BENCHES.map(|(name, _)| name).join(", ");
    let (name, rest) = arguments.split_first().ok_or_else(|| format!("bench what? ({})", known()))?;
    let (_, example) = BENCHES
        .iter()
        .find(|(known, _)| known == name)
        .ok_or_else(|| format!("no bench {name:?} ({})", known()))?;
    let mut command = cargo();
    command
        .args(["run", "--quiet", "--release", "--package", "varda", "--example", example, "--manifest-path"])
        .arg(root().join("Cargo.toml"))
        .arg("--");
    run(command.args(rest))
}
