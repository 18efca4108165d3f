//! The suites, and what they share.

mod adjoint;
mod counts;
mod equivalence;
mod golden;
mod hessian;
mod order;
mod paper;
mod stiff;
mod taylor;

use crate::Row;
use std::path::PathBuf;

/// How a run is done.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Fewer seeds, fewer cases.
    pub quick: bool,
    /// The longest cases too.
    pub full: bool,
    /// Folder with `der`, `hanging-rod`, `twin` (any of them); our own copies where there is none.
    pub fixtures: Option<PathBuf>,
}

/// What a suite gives.
#[derive(Debug, Default)]
pub struct Report {
    /// Its rows.
    pub rows: Vec<Row>,
    /// Something to read beside them: a table, remarks.
    pub text: String,
}

impl From<Vec<Row>> for Report {
    fn from(rows: Vec<Row>) -> Report {
        Report { rows, text: String::new() }
    }
}

/// A suite.
pub struct Suite {
    /// Its name on the command line.
    pub name: &'static str,
    run: fn(&Options) -> Report,
}

/// All suites, in the order they are run.
pub const SUITES: &[Suite] = &[
    Suite { name: "adjoint", run: |options| adjoint::run(options).into() },
    Suite { name: "taylor", run: |options| taylor::run(options).into() },
    Suite { name: "hessian", run: |options| hessian::run(options).into() },
    Suite { name: "golden", run: |options| golden::run(options).into() },
    Suite { name: "counts", run: |options| counts::run(options).into() },
    Suite { name: "order", run: |options| order::run(options).into() },
    Suite { name: "equivalence", run: |options| equivalence::run(options).into() },
    Suite { name: "paper", run: paper::run },
    Suite { name: "stiff", run: stiff::run },
];

/// Runs a suite.
///
/// # Panics
/// If there is no suite of that name.
pub fn run(name: &str, options: &Options) -> Report {
    let suite = SUITES.iter().find(|s| s.name == name).expect("a suite of that name");
    (suite.run)(options)
}

/// Reads a text as every kind of file of suite golden: whatever it is, that ends in a fixture or an error, not in a panic.
pub fn read_fixture(text: &str) {
    golden::read_all(text);
}

/// The rows of suite stiff as a document: `docs/results/stability.md`.
pub fn stability(rows: &[Row]) -> String {
    stiff::document(rows)
}
