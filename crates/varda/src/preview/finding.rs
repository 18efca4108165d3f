//! What looks wrong, as plain data.

use std::fmt;

use serde::Serialize;

/// Something that looks wrong before anything is minimized.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Whether a run makes no sense with it.
    pub severity: Severity,
    /// The key, file or part of the scene that it is about.
    pub place: String,
    /// What is wrong, with its value and what was probably meant.
    pub text: String,
}

/// How bad a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// It may be meant.
    Warning,
    /// It cannot be.
    Error,
}

impl Finding {
    pub(super) fn warning(place: impl Into<String>, text: impl Into<String>) -> Finding {
        Finding { severity: Severity::Warning, place: place.into(), text: text.into() }
    }

    pub(super) fn error(place: impl Into<String>, text: impl Into<String>) -> Finding {
        Finding { severity: Severity::Error, ..Finding::warning(place, text) }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.text)
    }
}
