//! What a check found, as data and as a table.

use std::fmt;

/// One line of a report: a number, what it must not exceed, and the verdict.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// What was checked.
    pub what: String,
    /// The number found.
    pub value: f64,
    /// The most it may be.
    pub bound: f64,
    /// Whether `value` ≤ `bound` (false for NaN).
    pub pass: bool,
}

impl Finding {
    /// A number that must not exceed a bound.
    pub fn at_most(what: impl Into<String>, value: f64, bound: f64) -> Self {
        Self { what: what.into(), value, bound, pass: value <= bound }
    }

    /// The same finding, said to belong to something.
    pub(crate) fn of(mut self, what: &str) -> Self {
        self.what = format!("{what}: {}", self.what);
        self
    }
}

/// All findings of a check. Printed, it is a table with a line for each.
///
/// ```
/// use varda_implicit::check::{Finding, Report};
///
/// let report = Report { findings: vec![Finding::at_most("adjoint: dot product", 2e-3, 1e-14)] };
/// assert!(!report.passed());
/// assert!(report.to_string().contains("FAILED"));
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Report {
    /// The findings, in the order of the checks.
    pub findings: Vec<Finding>,
}

impl Report {
    /// Whether every finding passes. False for a report of nothing.
    pub fn passed(&self) -> bool {
        !self.findings.is_empty() && self.findings.iter().all(|f| f.pass)
    }

    /// The findings that do not pass.
    pub fn failed(&self) -> impl Iterator<Item = &Finding> {
        self.findings.iter().filter(|f| !f.pass)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.findings.iter().map(|f| f.what.chars().count()).max().unwrap_or(0);
        for Finding { what, value, bound, pass } in &self.findings {
            let verdict = if *pass { "ok" } else { "FAILED" };
            writeln!(f, "{what:width$}  {value:9.2e}  at most {bound:8.1e}  {verdict}")?;
        }
        Ok(())
    }
}
