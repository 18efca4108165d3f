//! A sequence of windows.

use serde::{Deserialize, Serialize};
use varda_assimilation::Departures;
use varda_implicit::check::Amplification;

use super::{Experiment, Judgement, Members, ObservedValue, Shapes, Status, Trajectories, WorkCounts};

/// The result of one window: a row of cycles.csv, and the start of the window. RMSE and spread have a number
/// for each group of the state; they are empty where the truth, or the spread, is not known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CycleRow {
    /// Index from 0.
    pub cycle: usize,
    /// First step of the window, counted from the start of the sequence.
    pub first_step: usize,
    /// Model time at the first step \[s\].
    pub time: f64,
    /// J at the analysis.
    pub j: f64,
    /// J_b.
    pub j_b: f64,
    /// J_o.
    pub j_o: f64,
    /// J_q; 0 where no error of the model is estimated.
    #[serde(default)]
    pub j_q: f64,
    /// m, the number of observed values.
    pub observations: usize,
    /// 2J/m; 0 where nothing was observed.
    pub chi2: f64,
    /// How the minimization ended.
    pub status: Status,
    /// The failure of the model that ended it, if one did.
    pub failure: Option<String>,
    /// Outer iterations.
    pub outer_iterations: usize,
    /// Work of the minimization.
    pub counts: WorkCounts,
    /// Standard deviation expected of the analysis at the window's end (of the next background, for a
    /// propagated posterior).
    pub spread: Vec<f64>,
    /// Root mean square of x_a − x_b at the window's start: by how much the trajectory jumps there.
    #[serde(default)]
    pub increment: Vec<f64>,
    /// RMSE of the background at the window's start.
    pub rmse_background: Vec<f64>,
    /// RMSE of the analysis at the window's start.
    pub rmse_start: Vec<f64>,
    /// RMSE of the analysis at the window's end.
    pub rmse_end: Vec<f64>,
    /// Departures of the window in units of σ_o; `None` where nothing was observed.
    pub departures: Option<CycleDepartures>,
    /// Factor on the deviations or standard deviations of the background.
    pub inflation: f64,
    /// Members that failed and were drawn again.
    pub drawn_again: usize,
    /// Columns handed on: members, or directions of a propagated posterior; 0 for static B.
    #[serde(default)]
    pub columns: usize,
    /// The largest share of a component's variance that a propagated posterior was cut by.
    #[serde(default)]
    pub dropped: f64,
    /// Seconds the window took.
    pub seconds: f64,
    /// x_b at the window's start.
    pub background: Vec<f64>,
    /// x_a at the window's start.
    pub analysis: Vec<f64>,
    /// Errors η_j of the model that were estimated, one after the other.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub model_errors: Vec<f64>,
    /// Angle of the end clamp \[rad\], whole turns included, at the start of the next window, where it is
    /// part of the state.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_end_angle: Option<f64>,
    /// σ along the window, where the scene asks for a posterior.
    #[serde(default)]
    pub sigma: CycleSigma,
}

/// σ along a window, of its posterior or of the spread of its members.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CycleSigma {
    /// Of the components of the states that the sequence shows of this window, one state after the other.
    pub states: Vec<f64>,
    /// Of H of the analysis: for each of what was seen from the window's start on, in the order of time, the
    /// rows of its site.
    pub seen: Vec<Vec<f64>>,
    /// Why it is not known.
    pub missing: Option<String>,
}

/// Sums over the observed values of a window, whitened: see [`varda_assimilation::Departures`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct CycleDepartures {
    /// Values m.
    pub count: usize,
    /// Σ d_ob².
    pub background: f64,
    /// Σ d_oa d_ob.
    pub analysis: f64,
    /// Σ d_ab d_ob.
    pub increment: f64,
    /// What B says of Σ d_ab d_ob.
    pub predicted: f64,
}

impl From<Departures> for CycleDepartures {
    fn from(of: Departures) -> Self {
        let Departures { count, background, analysis, increment, predicted } = of;
        CycleDepartures { count, background, analysis, increment, predicted }
    }
}

impl From<CycleDepartures> for Departures {
    fn from(of: CycleDepartures) -> Self {
        let CycleDepartures { count, background, analysis, increment, predicted } = of;
        Departures { count, background, analysis, increment, predicted }
    }
}

/// The result of a sequence.
#[derive(Debug)]
pub struct CyclesOutcome {
    /// What was run; its grid ends with the last window that was done.
    pub experiment: Experiment,
    /// Failed or interrupted before its last window; else the worst end of a minimization.
    pub status: Status,
    /// Whether the analyses explain the observations, and why.
    pub judgement: Judgement,
    /// Whether it was interrupted because the time that the scene allows was over (`limits.seconds`).
    pub late: bool,
    /// Why it failed.
    pub failure: Option<String>,
    /// The windows that were done.
    pub cycles: Vec<CycleRow>,
    /// Number of windows that were asked for.
    pub asked_for: usize,
    /// Steps of a window.
    pub window: usize,
    /// Steps from one window to the next.
    pub shift: usize,
    /// Where the covariance of a window comes from, as in a scene.
    pub covariance: &'static str,
    /// Windows at the start that do not count in the means.
    pub spin_up: usize,
    /// Analysis and truth over all steps of these windows; every window's analysis from its start to that of
    /// the next.
    pub trajectories: Trajectories,
    /// The vertices of these runs, for models in space.
    pub shapes: Option<Shapes>,
    /// σ of every component of the states of the analysis, one state after the other; NaN in windows of
    /// which it is not known, empty where it is known of none.
    pub sigma_states: Vec<f64>,
    /// Members of the analysis of the last window, where a format asks for them.
    pub members: Option<Members>,
    /// Everything that was seen, with background, analysis and σ beside it: in each window up to the start
    /// of the next.
    pub observed: Vec<ObservedValue>,
    /// Means over the windows after `spin_up`.
    pub means: Means,
    /// Seconds since the run began.
    pub seconds: f64,
    /// How much the last window amplifies about its analysis; `None` for methods without a gradient along a
    /// run.
    pub amplification: Option<Amplification>,
    /// Remarks for the user.
    pub warnings: Vec<String>,
}

impl CyclesOutcome {
    /// The truth at the first step of a window, where it is known.
    pub fn truth_at(&self, row: &CycleRow) -> Option<&[f64]> {
        self.trajectories.state(&self.trajectories.truth, row.first_step)
    }

    /// Observed values in all windows.
    pub fn observed_values(&self) -> usize {
        self.cycles.iter().map(|r| r.observations).sum()
    }

    /// Work of all windows.
    pub fn counts(&self) -> WorkCounts {
        self.cycles.iter().fold(WorkCounts::default(), |sum, r| sum + r.counts)
    }
}

/// Means over the windows that count; RMSE and spread have a number for each group of the state, where known.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Means {
    /// Number of these windows.
    pub count: usize,
    /// RMSE of the background at the start of a window.
    pub rmse_background: Vec<Option<f64>>,
    /// RMSE of the analysis at the start of a window.
    pub rmse_start: Vec<Option<f64>>,
    /// RMSE of the analysis at the end of a window.
    pub rmse_end: Vec<Option<f64>>,
    /// Spread.
    pub spread: Vec<Option<f64>>,
    /// 2J/m, over the windows in which something was observed.
    pub chi2: Option<f64>,
    /// Σ 2J / Σ m.
    pub chi2_of_all: Option<f64>,
    /// Departures, summed.
    pub departures: CycleDepartures,
    /// Inflation.
    pub inflation: Option<f64>,
    /// Seconds.
    pub seconds: Option<f64>,
}
