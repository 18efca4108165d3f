//! What a check of a user's own type found, as data and as a table; vectors to check with.
//!
//! `varda_implicit::check` (models, right-hand sides, observation operators), `varda_covariance::check` and
//! `varda_rod::check` return this [`Report`].

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

    /// The same finding, named as one of the part `what`.
    #[must_use]
    pub fn of(mut self, what: &str) -> Self {
        self.what = format!("{what}: {}", self.what);
        self
    }
}

/// All findings of a check. Printed, it is a table with a line for each.
///
/// ```
/// use varda_linalg::check::{Finding, Report};
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

/// Number of values of two vectors that differ in a bit.
///
/// ```
/// assert_eq!(varda_linalg::check::differing(&[1.0, 0.0], &[1.0, -0.0]), 1.0);
/// ```
pub fn differing(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).filter(|(a, b)| a.to_bits() != b.to_bits()).count() as f64
}

/// Random numbers for test vectors, the same for the same seed: SplitMix64 (Steele, Lea and Flood 2014). Not
/// for statistics.
///
/// ```
/// use varda_linalg::check::Random;
///
/// assert_eq!(Random(7).draw(), Random(7).draw());
/// ```
#[derive(Debug, Clone)]
pub struct Random(pub u64);

impl Random {
    /// A number in [−1, 1).
    pub fn draw(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// `n` numbers in [−1, 1).
    pub fn vector(&mut self, n: usize) -> Vec<f64> {
        (0..n).map(|_| self.draw()).collect()
    }
}
