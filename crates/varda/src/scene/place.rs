//! Where a key or value of a scene was written.

/// Where something was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// In the scene's text; both counted from 1.
    Text {
        /// Line.
        line: usize,
        /// Column, in characters.
        column: usize,
    },
    /// On the command line: `key=value`.
    Set(String),
}

/// Longer lines are not shown.
const WIDEST: usize = 160;

impl Place {
    /// The line of a text and a mark below this place; empty where there is no such line.
    pub(super) fn excerpt(&self, text: &str) -> String {
        let Place::Text { line, column } = self else { return String::new() };
        let Some(shown) = text.lines().nth(line - 1).filter(|shown| shown.chars().count() <= WIDEST) else {
            return String::new();
        };
        // a tab is as wide above the mark as below
        let shown: String = shown.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        format!("{line:>5} | {shown}\n      | {:>column$}\n", "^")
    }
}

impl std::fmt::Display for Place {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Place::Text { line, column } => write!(f, "{line}:{column}"),
            Place::Set(assignment) => write!(f, "--set {assignment}"),
        }
    }
}
