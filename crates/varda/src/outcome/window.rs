//! The assimilation of one window.

use std::fmt;

use serde::Serialize;
use serde::ser::SerializeMap;
use varda_assimilation::Analysis;
use varda_implicit::check::Amplification;

use super::considered::Considered;
use super::convergence::{Attempt, ConvergenceRow, Status, WorkCounts};
use super::covariances::CovarianceBlock;
use super::estimates::Estimated;
use super::evidence::Evidence;
use super::exact_hessian::ExactHessian;
use super::fit::{Fit, Forecast, Rejected, Withheld};
use super::model_errors::ModelErrors;
use super::next_observation::NextObservation;
use super::shares::{KnownConstants, Share};
use super::sources::{Sensitivity, Sources};
use super::space::Shapes;
use super::spread::ObservedValue;
use super::verdict::Judgement;
use crate::scene::{Scene, TimeGrid};
use crate::state::StateLayout;

/// What is run: the scene, its grid of time, and the meaning of the numbers of a state.
#[derive(Debug, Clone, PartialEq)]
pub struct Experiment {
    /// Name of the scene.
    pub name: String,
    /// The scene, overrides and defaults included.
    pub scene: Scene,
    /// The window and its steps.
    pub grid: TimeGrid,
    /// The meaning of the numbers of the control.
    pub state: StateLayout,
    /// Length of a state.
    pub n_state: usize,
    /// What the scene does not need and the run does not compute.
    pub left_out: Vec<String>,
}

impl Experiment {
    /// Length of the control.
    pub fn n_control(&self) -> usize {
        self.state.len()
    }

    /// How many numbers of the control are unknown.
    pub fn n_unknown(&self) -> usize {
        match self.scene.background.covariance.is_of_known_state() {
            true => self.state.constants.len(),
            false => self.state.len(),
        }
    }
}

/// The result of a run.
#[derive(Debug)]
pub struct Outcome {
    /// What was run.
    pub experiment: Experiment,
    /// How the minimization ended.
    pub status: Status,
    /// Whether the analysis explains the observations, and why.
    pub judgement: Judgement,
    /// Whether it was interrupted because the time that the scene allows was over (`limits.seconds`).
    pub late: bool,
    /// The starts of minimizer `auto`, in turn; empty for the others.
    pub attempts: Vec<Attempt>,
    /// What the model refused during the minimization, if it did.
    pub failure: Option<Failure>,
    /// x_b and x_a, their σ, J and what follows from it.
    pub analysis: Analysis,
    /// Whether σ_a was computed.
    pub has_posterior: bool,
    /// Blocks of B and P_a to be looked at; empty without a posterior, or where they would take long.
    pub covariances: Vec<CovarianceBlock>,
    /// Members of the analysis of an ensemble, where a format asks for them.
    pub members: Option<Members>,
    /// Where one more observation would help most; `None` without a posterior, or where it would take long.
    pub next_observation: Option<NextObservation>,
    /// What the uncertainty of some numbers of the run comes from.
    pub sources: Vec<Sources>,
    /// How these depend on the observed values.
    pub sensitivities: Vec<Sensitivity>,
    /// What constants that are taken for known do to the result.
    pub considered: Vec<Considered>,
    /// What second derivatives of the model do to it, where the scene asks for the exact Hessian.
    pub exact_hessian: Option<ExactHessian>,
    /// The truth, in the control.
    pub truth: Option<Vec<f64>>,
    /// J at the background.
    pub j_background: f64,
    /// ‖∇J‖ at the first point and at the last.
    pub gradient_norms: [f64; 2],
    /// Outer and inner iterations.
    pub iterations: [usize; 2],
    /// The convergence table.
    pub convergence: Vec<ConvergenceRow>,
    /// Work of the minimization.
    pub counts: WorkCounts,
    /// Work of one model of the window: its share of the minimization, and the runs that are reported.
    pub model_counts: varda_implicit::Counts,
    /// Observed values that the background check refused.
    pub rejected: Vec<Rejected>,
    /// Constants that were estimated beside the state.
    pub estimates: Vec<Estimated>,
    /// What J is made of.
    pub shares: Vec<Share>,
    /// σ at the start and at the end of the window, and what it would be with these constants known; empty
    /// without such or without a dense posterior.
    pub with_constants_known: Vec<KnownConstants>,
    /// RMSE of the initial state against the truth.
    pub rmse: Rmse,
    /// Where the time went.
    pub seconds: Seconds,
    /// Innovations against their assumed σ, for each marker, place or component.
    pub fit: Vec<Fit>,
    /// Why the analysis does not fit, where it does not.
    pub evidence: Option<Evidence>,
    /// Errors at the markers that were kept back.
    pub withheld: Vec<Withheld>,
    /// Errors of the forecast.
    pub forecast: Vec<Forecast>,
    /// How much the window amplifies about the analysis, up to the last observation; `None` for methods
    /// without a gradient along a run.
    pub amplification: Option<Amplification>,
    /// Errors of the model, for weak-constraint methods.
    pub model_errors: Option<ModelErrors>,
    /// The adaptive time steps; `None` for steps of the scene's own length.
    pub accepted_steps: Option<AcceptedSteps>,
    /// Runs of the window.
    pub trajectories: Trajectories,
    /// The vertices of these runs, for models in space.
    pub shapes: Option<Shapes>,
    /// σ of every component of the states of the analysis, one state after the other; empty where it was not
    /// computed.
    pub sigma_states: Vec<f64>,
    /// Everything that was seen, with background, analysis and σ beside it.
    pub observed: Vec<ObservedValue>,
    /// Observed components, for models that are not in space.
    pub seen: Vec<SeenComponent>,
    /// Remarks for the user.
    pub warnings: Vec<String>,
}

/// A failure of the model during a minimization.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Failure {
    /// The minimizer came to a point at which the model fails, and ended there.
    Ended {
        /// The model's error.
        reason: String,
    },
    /// The last trial point was refused because the model fails there; the point before it is the result.
    TrialRefused {
        /// The model's error.
        reason: String,
    },
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failure::Ended { reason } => {
                write!(f, "the minimizer came to a point at which the model fails: {reason}")
            }
            Failure::TrialRefused { reason } => write!(f, "the last trial point was refused: {reason}"),
        }
    }
}

/// RMSE of the initial state against the truth, one entry for each group of the state.
///
/// In summary.json a table with the keys `<group>_background` and `<group>_analysis`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rmse(pub Vec<GroupRmse>);

/// RMSE of a group of the state: the root of the mean squared length of the error of a vector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroupRmse {
    /// Name of the group.
    pub group: &'static str,
    /// RMSE of the background, in the group's unit; `None` where the truth is not known.
    pub background: Option<f64>,
    /// RMSE of the analysis.
    pub analysis: Option<f64>,
}

impl GroupRmse {
    /// Background and analysis, where the truth is known.
    pub fn known(&self) -> Option<[f64; 2]> {
        Some([self.background?, self.analysis?])
    }
}

impl Rmse {
    /// The entry of a group.
    pub fn of(&self, group: &str) -> Option<&GroupRmse> {
        self.0.iter().find(|g| g.group == group)
    }

    /// The entry of the first group: positions of a rod, the state of other models.
    pub fn first(&self) -> Option<&GroupRmse> {
        self.0.first()
    }
}

impl Serialize for Rmse {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(2 * self.0.len()))?;
        for g in &self.0 {
            map.serialize_entry(&format!("{}_background", g.group), &g.background)?;
            map.serialize_entry(&format!("{}_analysis", g.group), &g.analysis)?;
        }
        map.end()
    }
}

/// Where the time went \[s\].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Seconds {
    /// From the start of the run to the end of the analysis: the sum of the five that follow.
    pub total: f64,
    /// Before the minimization: reading, the rod at rest, the truth, B.
    pub set_up: f64,
    /// In the minimization.
    pub minimizer: f64,
    /// From the end of the minimization to the posterior at the start of the window.
    pub posterior: f64,
    /// After it: runs of background and analysis, σ along them, departures, forecast.
    pub diagnostics: f64,
    /// The same estimate on a finer mesh, where constants are estimated from a recording.
    pub mesh: f64,
    /// Of minimization and posterior, in steps of the model.
    pub forward: f64,
    /// In linearizations and adjoint products.
    pub adjoint: f64,
    /// In tangent products.
    pub tangent: f64,
}

/// Runs of the whole window and its forecast, states one after the other.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trajectories {
    /// Length of a state.
    pub dim: usize,
    /// From x_b.
    pub background: Vec<f64>,
    /// From x_a.
    pub analysis: Vec<f64>,
    /// The truth, or nothing.
    pub truth: Vec<f64>,
}

impl Trajectories {
    /// State k of a run; `None` where the run ended before.
    pub fn state<'a>(&self, states: &'a [f64], k: usize) -> Option<&'a [f64]> {
        states.get(k * self.dim..(k + 1) * self.dim)
    }
}

/// Members of the analysis of an ensemble, at some steps.
#[derive(Debug, Clone, PartialEq)]
pub struct Members {
    /// How many.
    pub count: usize,
    /// The steps; first and last of the window where those of all would be too many numbers.
    pub steps: Vec<usize>,
    /// States at these steps of one member, then those of the next; NaN after a run has failed.
    pub states: Vec<f64>,
}

/// Adaptive time steps.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AcceptedSteps {
    /// Number of steps, window and forecast together.
    pub accepted: usize,
    /// How often they were chosen again during the run.
    pub refreshed: usize,
    /// Largest estimated error of a step along the analysis, over the length of the rod; `null` if a step
    /// fails.
    pub largest_error: Option<f64>,
    /// The tolerance that was asked for.
    pub tolerance: f64,
    /// Model times at which steps end, the start included \[s\].
    #[serde(skip)]
    pub times: Vec<f64>,
}

/// An observed component of the state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeenComponent {
    /// Index of the component.
    pub component: usize,
    /// Model time \[s\].
    pub time: f64,
    /// The value.
    pub value: f64,
}
