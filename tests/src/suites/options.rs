//! What a suite is given and what it returns.

use crate::Row;
use std::path::PathBuf;

/// How a run is done.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Fewer seeds, fewer cases.
    pub quick: bool,
    /// The longest cases too.
    pub full: bool,
    /// Folder with `der`, `hanging-rod`, `twin`, `statics` (any of them); our own copies where there is none.
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
