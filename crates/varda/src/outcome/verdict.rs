//! The verdict of a run: whether the analysis is to be believed.

use serde::Serialize;

/// Whether the analysis explains the observations.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// 2J/m ≤ 1 + 3 √(2/m), and no marker, time or axis stands out by more than 4 σ.
    Fits,
    /// The minimum was found, and it does not explain the observations.
    DoesNotFit,
    /// The minimum was not found.
    NotConverged,
    /// No value was observed: the analysis is the background.
    NothingObserved,
}

impl Verdict {
    /// In capital letters, as it stands in front of a text.
    pub fn heading(self) -> &'static str {
        match self {
            Verdict::Fits => "FITS",
            Verdict::DoesNotFit => "DOES NOT FIT",
            Verdict::NotConverged => "NOT CONVERGED",
            Verdict::NothingObserved => "NOTHING OBSERVED",
        }
    }

    /// As in summary.json.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Fits => "fits",
            Verdict::DoesNotFit => "does_not_fit",
            Verdict::NotConverged => "not_converged",
            Verdict::NothingObserved => "nothing_observed",
        }
    }
}

/// A verdict and its reasons in words.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The verdict.
    pub verdict: Verdict,
    /// The numbers behind it, and what to try.
    pub text: String,
}

impl std::fmt::Display for Judgement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.verdict.heading(), self.text)
    }
}
