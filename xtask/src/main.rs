//! Developer commands: `cargo xtask --help` lists them.
#![forbid(unsafe_code)]
#![allow(clippy::print_stdout, clippy::print_stderr)]

mod browser;
mod compare;
mod deps;
mod docs;
mod gallery;
mod lint;
mod package;
mod reports;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

const HELP: &str = "\
cargo xtask verify [SUITE…] [--quick | --full] [-v] [--json FILE] [--fixtures DIR] [--list] [--help]
    Runs the verification suites in a release build and prints one line a suite and every row that failed.
    --list: what each suite proves. --help: all options.
cargo xtask bench [NAME…] [--quick] [--out DIR]
    Error against run time (time, gradient, assimilation, scaling, statics, leftout, instructions, memory,
    interrupts, build) in a release build: prints tables and writes docs/results/NAME.md, .csv and .svg.
    --quick: few cases and samples, nothing written. --out: another folder.
cargo xtask bench case4 [OPTION…]
    The study of minimizers on case 4 of the paper, 100 seeds of two priors: docs/results/case4.md.
    --help: its options.
cargo xtask bench lorenz96-cycling [SEEDS [PART OF A NAME]]
    The table of cycling methods on Lorenz-96, docs/results/lorenz96-cycling.md.
cargo xtask docs [--check]
    Documentation of all crates with guides, theory, results and an index page, in target/doc. --check: no
    broken link, and in a browser, where one is installed, no formula that is not rendered and no page
    wider than a telephone.
cargo xtask figures
    Figures 1 to 4 of the paper from the shipped scenes, into docs/figures, and docs/results/figures.md.
cargo xtask gallery [VARDA]
    Pages about shipped scenes with pictures and numbers of their runs: docs/guide/gallery.
cargo xtask reports [VARDA]
    Pages of results, made by a binary of varda (default: a release build), in a browser where one is
    installed: everything drawn, turning, playing, with names and keyboard, at two widths.
cargo xtask compare OLD NEW [SCENE…]
    The shipped scenes by two binaries of varda, number by number. --help: the rules and options.
cargo xtask lint
    Rules about the text of the sources: columns, lines of a file, references that a reader cannot open,
    packages that only one crate may use.
cargo xtask deps
    What each crate does without; cargo-deny and cargo-semver-checks where they are installed.
cargo xtask package
    The crates as crates.io would get them, each with its licences and README.
cargo xtask external
    The programs of tests/external, built and run with the packaged crates.
cargo xtask ci
    Everything that gates a change: .ci/run.
";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let done = match words.as_slice() {
        ["verify", rest @ ..] => release("tests", rest),
        ["bench", rest @ ..] => release("bench", rest),
        ["docs", rest @ ..] => docs::command(rest),
        ["gallery", rest @ ..] => gallery::write(rest),
        ["figures"] => release("bench", &["figures"]),
        ["reports", rest @ ..] => reports::check(rest),
        ["compare", rest @ ..] => compare::run(rest),
        ["lint"] => lint::check(),
        ["deps"] => deps::check(),
        ["package"] => package::package().map(|_| ()),
        ["external"] => package::external(),
        ["ci"] => run(Command::new("bash").arg(root().join(".ci/run"))),
        [] | ["help" | "--help" | "-h"] => {
            print!("{HELP}");
            Ok(())
        }
        other => Err(format!("unknown command: {}\n\n{HELP}", other.join(" "))),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

/// Builds the binary of a package, named like the package, with optimization and cargo's own progress, and
/// runs it. Paths are those of the caller's folder.
fn release(package: &str, arguments: &[&str]) -> Result<(), String> {
    let manifest = root().join("Cargo.toml");
    let target = ["--release", "--package", package, "--bin", package, "--manifest-path"];
    run(cargo().arg("build").args(target).arg(&manifest))?;
    run(cargo().args(["run", "--quiet"]).args(target).arg(&manifest).arg("--").args(arguments))
}

/// A release build of a package's binary.
fn release_binary(package: &str) -> Result<PathBuf, String> {
    let manifest = root().join("Cargo.toml");
    run(cargo().args(["build", "--release", "--package", package, "--manifest-path"]).arg(&manifest))?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
    Ok(target.join("release").join(package))
}

/// The workspace's top folder.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("xtask lies in the workspace").to_path_buf()
}

/// The cargo that runs this.
fn cargo() -> Command {
    Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// Whether a subcommand of cargo is installed; where not, prints what goes without.
fn installed(subcommand: &str, without: &str) -> bool {
    let found = cargo().args([subcommand, "--version"]).output().is_ok_and(|o| o.status.success());
    if !found {
        println!("skipped: cargo-{subcommand} is not installed; {without}");
    }
    found
}

fn run(command: &mut Command) -> Result<(), String> {
    let status = command.status().map_err(|e| format!("{command:?}: {e}"))?;
    if status.success() { Ok(()) } else { Err(format!("failed: {command:?}")) }
}
