//! Runs suites and prints their rows: `cargo xtask verify [SUITE…] [--quick | --full] [--json FILE] [--stability FILE] [--fixtures DIR]`.
#![allow(clippy::print_stdout, clippy::print_stderr)]

use std::path::PathBuf;
use std::process::ExitCode;
use tests::{Options, SUITES, row, run, stability, table};

fn main() -> ExitCode {
    match verify(std::env::args().skip(1)) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::from(2)
        }
    }
}

/// Whether every row passes.
fn verify(mut arguments: impl Iterator<Item = String>) -> Result<bool, String> {
    let mut options = Options::default();
    let (mut json, mut document) = (None, None);
    let mut names = Vec::new();
    while let Some(argument) = arguments.next() {
        let mut file =
            |what: &str| arguments.next().map(PathBuf::from).ok_or(format!("{argument} needs {what}"));
        match argument.as_str() {
            "--quick" => options.quick = true,
            "--full" => options.full = true,
            "--json" => json = Some(file("a file")?),
            "--stability" => document = Some(file("a file")?),
            "--fixtures" => options.fixtures = Some(file("a folder")?),
            name => names.push(SUITES.iter().map(|s| s.name).find(|s| *s == name).ok_or_else(|| {
                let known: Vec<&str> = SUITES.iter().map(|s| s.name).collect();
                format!(
                    "no suite or option {name:?} (suites: {}; options: --quick, --full, --json FILE, --stability FILE, --fixtures DIR)",
                    known.join(", ")
                )
            })?),
        }
    }
    if let Some(folder) = options.fixtures.as_ref().filter(|f| !f.is_dir()) {
        return Err(format!("{}: no such folder", folder.display()));
    }
    if names.is_empty() {
        names = SUITES.iter().map(|s| s.name).collect();
    }

    let mut rows = Vec::new();
    for name in names {
        let report = run(name, &options);
        println!("{}", table(&report.rows));
        if !report.text.is_empty() {
            println!("{}", report.text);
        }
        rows.extend(report.rows);
    }
    if let Some(file) = json {
        std::fs::write(&file, row::json(&rows)).map_err(|e| format!("{}: {e}", file.display()))?;
    }
    if let Some(file) = document {
        std::fs::write(&file, stability(&rows)).map_err(|e| format!("{}: {e}", file.display()))?;
    }
    let failed = rows.iter().filter(|r| !r.pass).count();
    println!("{} checks, {} failed", rows.len(), failed);
    Ok(failed == 0 && !rows.is_empty())
}
