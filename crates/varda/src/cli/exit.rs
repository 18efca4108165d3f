//! Exit codes.

/// What a shell reports for a program ended by Ctrl-C.
pub(super) const INTERRUPTED: u8 = 130;
