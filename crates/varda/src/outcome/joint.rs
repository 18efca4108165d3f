//! The assimilation of several recordings of one system.

use super::convergence::{ConvergenceRow, Status, WorkCounts};
use super::estimates::Estimated;
use super::shares::Share;
use super::verdict::Judgement;
use super::window::{Outcome, Seconds};
use crate::scene::Scene;

/// The result of several recordings in one estimate.
#[derive(Debug)]
pub struct JointOutcome {
    /// Name of the scene.
    pub name: String,
    /// The scene, overrides and defaults included.
    pub scene: Scene,
    /// How the minimization ended.
    pub status: Status,
    /// Whether the analyses explain the observations, and why.
    pub judgement: Judgement,
    /// Whether it was ended because the time that the scene allows was over (`limits.seconds`).
    pub late: bool,
    /// What came of each recording, as of a window of its own: J is that of its own unknowns and its
    /// observations, σ counts what all recordings say of the constants.
    pub recordings: Vec<Outcome>,
    /// J at the backgrounds.
    pub j_background: f64,
    /// J: the sum of those of the recordings and of the prior of what they share.
    pub j: f64,
    /// Number of unknowns.
    pub unknowns: usize,
    /// Number of observed values m.
    pub observations: usize,
    /// 2J/m.
    pub chi2: f64,
    /// Degrees of freedom for signal; `None` without a posterior.
    pub degrees_of_freedom: Option<f64>,
    /// What J is made of.
    pub shares: Vec<Share>,
    /// The constants of all recordings, then those of each, which have the recording's name behind theirs.
    pub estimates: Vec<Estimated>,
    /// ‖∇J‖ at the first point and at the last.
    pub gradient_norms: [f64; 2],
    /// Outer and inner iterations.
    pub iterations: [usize; 2],
    /// The convergence table.
    pub convergence: Vec<ConvergenceRow>,
    /// Work of the minimization, of all models.
    pub counts: WorkCounts,
    /// Where the time went.
    pub seconds: Seconds,
    /// Remarks for the user that are of no recording alone.
    pub warnings: Vec<String>,
}

impl JointOutcome {
    /// All remarks, each once, with the names of the recordings that it is of.
    pub fn notes(&self) -> Vec<String> {
        let mut notes: Vec<(&str, Vec<&str>)> = Vec::new();
        for one in &self.recordings {
            for warning in one.warnings.iter().filter(|warning| !self.warnings.contains(warning)) {
                let name = one.experiment.name.as_str();
                match notes.iter_mut().find(|(text, _)| text == warning) {
                    Some((_, names)) => names.push(name),
                    None => notes.push((warning, vec![name])),
                }
            }
        }
        let of_each = notes.into_iter().map(|(text, names)| match names.len() == self.recordings.len() {
            true if names.len() > 1 => format!("each recording: {text}"),
            _ => format!("{}: {text}", names.join(", ")),
        });
        self.warnings.iter().cloned().chain(of_each).collect()
    }
}

/// So many recordings.
pub(crate) fn in_words(recordings: usize) -> String {
    match recordings {
        1 => "one recording".to_string(),
        n => format!("{n} recordings"),
    }
}
