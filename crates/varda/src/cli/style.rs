//! Colours: of errors and verdicts, on a terminal, unless NO_COLOR is set.

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

/// Prints a table whose first word is a verdict.
pub(super) fn table(verdict: Verdict, table: &str) {
    let style = colour(match verdict {
        Verdict::Fits => AnsiColor::Green,
        Verdict::DoesNotFit | Verdict::NotConverged => AnsiColor::Yellow,
        Verdict::NothingObserved => AnsiColor::Red,
    });
    match table.strip_prefix(verdict.heading()) {
        Some(rest) => anstream::print!("{style}{}{style:#}{rest}", verdict.heading()),
        None => anstream::print!("{table}"),
    }
}

fn colour(of: AnsiColor) -> Style {
    of.on_default().bold()
}
