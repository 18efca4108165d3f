//! What a suite is given.

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
