//! What a suite is given and what it returns.

use crate::Row;
use crate::row::Grid;
use std::path::PathBuf;

/// How a run is done.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Every kind of check on a fixed part of its grid.
    pub quick: bool,
    /// The names of the cases and the grids of suite stiff alone: nothing is computed.
    pub names_only: bool,
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
    /// The names of its cases, of suite stiff.
    pub cases: Vec<String>,
    /// Its grids, of suite stiff.
    pub grids: Vec<Grid>,
}

impl From<Vec<Row>> for Report {
    fn from(rows: Vec<Row>) -> Report {
        Report { rows, ..Report::default() }
    }
}
