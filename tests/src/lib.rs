//! Verification suites.
