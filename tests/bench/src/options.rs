//! What a benchmark is given and what it ends with.

use std::error::Error;

/// How a run is done.
#[derive(Debug, Clone, Copy, Default)]
pub struct Options {
    /// Fewer cases, fewer samples: to see that it runs.
    pub quick: bool,
}

impl Options {
    /// Samples of every clock time.
    pub fn samples(&self) -> usize {
        if self.quick { 1 } else { 9 }
    }
}

/// What a benchmark ends with.
pub type Result<T> = std::result::Result<T, Box<dyn Error>>;
