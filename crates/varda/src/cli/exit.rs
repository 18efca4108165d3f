//! Exit codes.

use std::process::ExitCode;

use crate::outcome::{Judgement, Status, Verdict};

/// An error, or nothing was observed.
const ERROR: u8 = 1;
/// Arguments that make no sense.
pub(super) const USAGE: u8 = 2;
/// The analysis does not explain the observations.
const DOES_NOT_FIT: u8 = 3;
/// The minimization did not come to its minimum.
const NOT_CONVERGED: u8 = 4;
/// What a shell reports for a program ended by Ctrl-C.
pub(super) const INTERRUPTED: u8 = 130;

/// How the program ends after a run whose minimization did not fail.
pub(super) fn code(judgement: &Judgement, status: Status, late: bool, warned: bool) -> ExitCode {
    if status == Status::Interrupted && !late {
        return ExitCode::from(INTERRUPTED);
    }
    match judgement.verdict {
        Verdict::NothingObserved => ExitCode::from(ERROR),
        Verdict::NotConverged => ExitCode::from(NOT_CONVERGED),
        Verdict::DoesNotFit => ExitCode::from(DOES_NOT_FIT),
        Verdict::Fits if warned => ExitCode::from(DOES_NOT_FIT),
        Verdict::Fits => ExitCode::SUCCESS,
    }
}
