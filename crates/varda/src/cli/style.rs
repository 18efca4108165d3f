//! Printing: texts, and errors and verdicts in colour on a terminal, unless NO_COLOR is set.

use std::io::Write;

use clap::builder::styling::{AnsiColor, Style};

use crate::Error;
use crate::outcome::Verdict;

/// Prints an error, with the line of the scene that it is about.
pub(super) fn error(error: &Error) {
    message(&error.to_string());
    if let Some(excerpt) = error.excerpt() {
        anstream::eprint!("{excerpt}");
    }
}

/// Prints what went wrong.
pub(super) fn message(text: &str) {
    let style = colour(AnsiColor::Red);
    anstream::eprintln!("{style}error:{style:#} {text}");
}

/// Prints to stdout; a reader that has gone away (`| head`) is no error.
pub(super) fn print(text: &str) {
    let _ = anstream::stdout().lock().write_all(text.as_bytes());
}

/// Prints a line to stdout.
pub(super) fn line(text: impl std::fmt::Display) {
    print(&format!("{text}\n"));
}

/// Prints a table whose first word is a verdict.
pub(super) fn table(verdict: Verdict, table: &str) {
    let style = colour(match verdict {
        Verdict::Fits => AnsiColor::Green,
        Verdict::DoesNotFit | Verdict::NotConverged => AnsiColor::Yellow,
        Verdict::NothingObserved => AnsiColor::Red,
    });
    match table.strip_prefix(verdict.heading()) {
        Some(rest) => print(&format!("{style}{}{style:#}{rest}", verdict.heading())),
        None => print(table),
    }
}

fn colour(of: AnsiColor) -> Style {
    of.on_default().bold()
}
