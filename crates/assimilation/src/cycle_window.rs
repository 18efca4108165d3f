//! Windows of a sequence: what they are made of, what they give, what they hand on.

use crate::cycle_members::mean;
use crate::{
    CostTerms, Counts, Departures, Error, ErrorColumns, Forcing, Iteration, LeastSquares, Minimizer, Minimum,
    ObservationSet, OuterLoopOptions, Status, outer_loop,
};
use std::ops::ControlFlow;
use varda_covariance::{Covariance, Precision};
use varda_implicit::Model;

/// A sequence of windows. Window c covers the steps first + c S … first + c S + K of a long run.
///
/// Every observation is used once: a window after the first takes those later than step K − S, the ones no
/// window before has seen (the single data assimilation of Bocquet and Sakov 2014). So windows overlap (S <
/// K), share the step at which one ends and the next begins (S = K), or tile the time (S = K + 1: the
/// background is a forecast to the first observed step). A window of K = 0 is 3D-Var, or an ensemble Kalman
/// filter: one time is analysed, then S steps are forecast.
#[derive(Clone, Copy)]
pub struct Cycling<'a> {
    /// The first step of the first window.
    pub first: usize,
    /// K, the length of a window in steps.
    pub window: usize,
    /// S, the steps from one window to the next; at most K + 1, any for K = 0.
    pub shift: usize,
    /// How many windows.
    pub cycles: usize,
    /// A model whose step 0 is the given step of the long run.
    pub make_model: &'a dyn Fn(usize) -> Box<dyn Model + Send>,
    /// The observations of the window that starts at the given step, with steps counted from there; also
    /// those already seen.
    pub observations: &'a dyn Fn(usize) -> Result<ObservationSet, Error>,
    /// The true state at a step, where it is known.
    pub truth: Option<&'a dyn Fn(usize) -> Vec<f64>>,
    /// Errors of the model; `None` takes it to be right.
    pub model_error: Option<CycledErrors<'a>>,
    /// Whether `on_cycle` is given the posterior of every window whose minimization ended by itself
    /// ([`Cycle::posterior`]). A static B costs a dense posterior a window then; of a propagated B and of an
    /// ensemble it is there anyway.
    pub posterior: bool,
}

/// Q, and what a sequence does with it.
#[derive(Clone, Copy)]
pub struct CycledErrors<'a> {
    /// The covariance of one η.
    pub q: &'a dyn Covariance,
    /// Where and how often errors enter.
    pub forcing: &'a Forcing,
    /// Whether and how η is estimated in every window.
    pub estimated: CycledEstimate<'a>,
    /// Makes the source of standard normals of the window of an index, for the draws of members.
    pub normals: &'a dyn Fn(usize) -> Normals,
}

/// How the errors of a model are estimated in the windows of a sequence.
#[derive(Clone, Copy)]
pub enum CycledEstimate<'a> {
    /// They are not: the window is strong, and Q widens what it hands on: a propagated B by every error on
    /// the way to the next window, carried to its start by the tangent; members by draws at the start of the
    /// next window, of the covariance of the errors on the way as if all had entered at its end.
    No,
    /// Weak-constraint 4D-Var over the forcing ([`WeakForcing`](crate::WeakForcing)).
    Forcing,
    /// Weak-constraint 4D-Var over states ([`WeakState`](crate::WeakState)), by an outer loop or L-BFGS. A
    /// propagated B must keep its full rank, of which it takes the inverse window by window.
    States {
        /// The B of every window if it is static, else that of the first.
        b: &'a dyn Precision,
        /// Q.
        q: &'a dyn Precision,
    },
}

/// How the windows of a sequence are minimized.
#[derive(Clone, Copy)]
pub enum CycledMinimizer<'a> {
    /// In the control variable.
    Minimizer(&'a Minimizer),
    /// By quadratic inner problems, in the control's space (incremental 4D-Var) or in that of the
    /// observations (4D-PSAS).
    OuterLoop(&'a OuterLoopOptions),
}

impl<'a> From<&'a Minimizer> for CycledMinimizer<'a> {
    fn from(minimizer: &'a Minimizer) -> Self {
        CycledMinimizer::Minimizer(minimizer)
    }
}

impl<'a> From<&'a OuterLoopOptions> for CycledMinimizer<'a> {
    fn from(options: &'a OuterLoopOptions) -> Self {
        CycledMinimizer::OuterLoop(options)
    }
}

impl CycledMinimizer<'_> {
    /// The minimum of a window, from `v`.
    pub(crate) fn minimize(&self, cost: &mut dyn LeastSquares, v: &mut [f64]) -> Result<Minimum, Error> {
        let go_on = &mut |_: &Iteration| ControlFlow::Continue(());
        match self {
            CycledMinimizer::Minimizer(minimizer) => minimizer.minimize(cost, v, go_on),
            CycledMinimizer::OuterLoop(options) => outer_loop(cost, v, options, go_on),
        }
    }
}

/// What one window hands to the next, as plain data: everything the windows to come depend on besides their
/// settings. Stored after a window and given back to [`cycle`](crate::cycle), the sequence goes on with the
/// same bits.
#[derive(Debug, Clone, PartialEq)]
pub struct CycleState {
    /// Index of the next window.
    pub next: usize,
    /// z_b at its start.
    pub background: Vec<f64>,
    /// Vectors of the control's length, one after the other: the members of an ensemble about z_b, not yet
    /// inflated; W of a propagated posterior, B = W Wᵀ; nothing for static B and before the first window of
    /// a propagated one.
    pub columns: Vec<f64>,
}

impl CycleState {
    /// Before the first window, from its background z_b.
    pub fn new(background: Vec<f64>) -> Self {
        Self { next: 0, background, columns: Vec::new() }
    }

    /// Before the first window, from the members of its background in the control, one after the other, each
    /// of length `n`; z_b is their mean.
    ///
    /// # Panics
    /// If there is no member, or a broken one.
    pub fn from_members(members: Vec<f64>, n: usize) -> Self {
        assert!(n > 0 && !members.is_empty() && members.len().is_multiple_of(n), "members of length {n}");
        Self { next: 0, background: mean(&members, n), columns: members }
    }
}

/// A source of independent standard normals.
pub type Normals = Box<dyn FnMut() -> f64>;

/// What one window gave.
#[derive(Debug, Clone, PartialEq)]
pub struct Cycle {
    /// Index c.
    pub index: usize,
    /// The first step of the window.
    pub first_step: usize,
    /// z_b at the start of the window.
    pub background: Vec<f64>,
    /// z_a at the start of the window.
    pub analysis: Vec<f64>,
    /// The analysed state at the window's end: of the run from z_a, or the mean of the members' runs.
    pub end: Vec<f64>,
    /// J at the analysis.
    pub value: f64,
    /// Its parts.
    pub terms: CostTerms,
    /// m, the number of observed values used.
    pub observations: usize,
    /// χ² = 2J/m; 0 where nothing is observed.
    pub chi2: f64,
    /// How the minimization ended.
    pub status: Status,
    /// Why, where a failing model ended it.
    pub failure: Option<String>,
    /// Its outer iterations.
    pub outer_iterations: usize,
    /// Work of the minimization; the forecast to the next window comes on top.
    pub counts: Counts,
    /// Standard deviation expected of every component of the control: of the analysis at the window's end, by
    /// the ensemble; of the background of the next window, for a propagated posterior; `None` for static B.
    pub sigma: Option<Vec<f64>>,
    /// Root mean square errors, where the truth is known.
    pub errors: Option<CycleErrors>,
    /// Departures in units of σ_o, against what B and R say of them; `None` where nothing was observed or
    /// the minimization failed. What B says is estimated by random vectors for strong 4D-Var (an
    /// adjoint sweep a window, 32 in all at least), exact for an ensemble.
    pub departures: Option<Departures>,
    /// α that the perturbations of the background were multiplied by; 1 for static B.
    pub inflation: f64,
    /// Members that failed on the way to the next window and were drawn again from the others.
    pub drawn_again: usize,
    /// Columns of what is handed on: members, or directions of a propagated posterior.
    pub columns: usize,
    /// The largest share of the variance of a component that a propagated posterior was cut by.
    pub dropped: f64,
    /// η_j that were estimated, on the forced components, one after the other; empty where none were.
    pub model_errors: Vec<f64>,
    /// The posterior, for `on_cycle` alone: the windows that [`cycle`](crate::cycle) gives back are without.
    /// `None` where it was not asked for, or the minimization was interrupted or failed.
    pub posterior: Option<CyclePosterior>,
}

/// The posterior of a window, as what is carried along it.
#[derive(Debug, Clone, PartialEq)]
pub enum CyclePosterior {
    /// A root of P_a, by columns of the length of the control: for
    /// [`propagate_root`](crate::propagate_root).
    Root(Vec<f64>),
    /// Of the initial state and the errors of the model: for
    /// [`propagate_errors`](crate::propagate_errors). Errors that were not estimated enter with their Q.
    WithErrors(ErrorColumns),
    /// The members' runs from the analysis on, to the end of the window or the start of the next, whichever
    /// is later: the states of one, then those of the next.
    Members(Vec<f64>),
    /// It cannot be computed, and why: its Hessian is indefinite by rounding.
    Indefinite(String),
}

impl CyclePosterior {
    /// What a posterior that may be indefinite by rounding is; other errors are errors.
    pub(crate) fn of<T>(found: Result<T, Error>, is: impl FnOnce(T) -> Self) -> Result<Self, Error> {
        match found {
            Ok(found) => Ok(is(found)),
            Err(reason @ Error::NotPositiveDefinite { .. }) => {
                Ok(CyclePosterior::Indefinite(reason.to_string()))
            }
            Err(error) => Err(error),
        }
    }
}

impl Cycle {
    /// Root mean square of `sigma`.
    pub fn spread(&self) -> Option<f64> {
        let sigma = self.sigma.as_ref()?;
        Some((sigma.iter().map(|s| s * s).sum::<f64>() / sigma.len() as f64).sqrt())
    }
}

/// Root mean square errors over the state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CycleErrors {
    /// Of the background at the window's start.
    pub background: f64,
    /// Of the analysis at the window's start.
    pub start: f64,
    /// Of the analysis at the window's end: of the run from z_a, or of the mean of the members' runs.
    pub end: f64,
}

impl Cycling<'_> {
    /// The observations of window c that no window before has used.
    pub(crate) fn unseen(&self, c: usize) -> Result<ObservationSet, Error> {
        let set = (self.observations)(self.first_step(c))?;
        if c == 0 || self.shift > self.window {
            return Ok(set);
        }
        let (times, seen) = (set.times().clone(), (self.window - self.shift) as f64);
        let (operators, observations) = set.into_parts();
        let unseen = observations.into_iter().filter(|o| o.step as f64 + o.weight > seen).collect();
        ObservationSet::of(times, operators, unseen)
    }

    /// Steps to run from the analysis: to the end of this window and the start of the next.
    pub(crate) fn steps(&self) -> usize {
        self.window.max(self.shift)
    }

    pub(crate) fn first_step(&self, c: usize) -> usize {
        self.first + c * self.shift
    }

    pub(crate) fn errors(&self, c: usize, [background, start, end]: [&[f64]; 3]) -> Option<CycleErrors> {
        let truth = self.truth?;
        let (at_start, at_end) = (truth(self.first_step(c)), truth(self.first_step(c) + self.window));
        Some(CycleErrors {
            background: rms(background, &at_start),
            start: rms(start, &at_start),
            end: rms(end, &at_end),
        })
    }

    pub(crate) fn cycle(
        &self,
        state: &CycleState,
        analysis: Vec<f64>,
        end: Vec<f64>,
        observations: usize,
        from: Ended,
    ) -> Cycle {
        let Ended { minimum, counts, .. } = from;
        Cycle {
            index: state.next,
            first_step: self.first_step(state.next),
            background: state.background.clone(),
            analysis,
            end,
            value: minimum.value,
            terms: minimum.terms,
            observations,
            chi2: if observations == 0 { 0.0 } else { 2.0 * minimum.value / observations as f64 },
            status: minimum.status,
            failure: minimum.failure.map(|e| e.to_string()),
            outer_iterations: minimum.outer_iterations,
            counts,
            sigma: from.sigma,
            errors: from.errors,
            departures: from.departures,
            inflation: from.inflation,
            drawn_again: from.drawn_again,
            columns: from.columns,
            dropped: from.dropped,
            model_errors: from.model_errors,
            posterior: from.posterior,
        }
    }
}

/// Whether a minimization ended by itself, so that its end has a posterior.
pub(crate) fn is_whole(status: Status) -> bool {
    !matches!(status, Status::Interrupted | Status::Failed)
}

/// How the posterior of a window becomes B of the next: α² M P_a Mᵀ + β² B_s.
#[derive(Clone, Copy)]
pub(crate) struct Carry<'a> {
    pub(crate) inflation: f64,
    pub(crate) static_part: Option<(&'a dyn Covariance, f64)>,
    pub(crate) dropped: f64,
}

impl Carry<'_> {
    /// σ of the background of the next window: of the columns, and of the static part.
    pub(crate) fn sigma(&self, n: usize, columns: &[f64]) -> Vec<f64> {
        let mut variance = vec![0.0; n];
        if let Some((b, weight)) = self.static_part {
            b.variance(&mut variance);
            variance.iter_mut().for_each(|v| *v *= weight * weight);
        }
        for column in columns.chunks_exact(n) {
            variance.iter_mut().zip(column).for_each(|(v, w)| *v += w * w);
        }
        variance.into_iter().map(f64::sqrt).collect()
    }
}

/// What the two kinds of window have in common at their end.
pub(crate) struct Ended {
    pub(crate) minimum: Minimum,
    pub(crate) counts: Counts,
    pub(crate) sigma: Option<Vec<f64>>,
    pub(crate) errors: Option<CycleErrors>,
    pub(crate) departures: Option<Departures>,
    pub(crate) inflation: f64,
    pub(crate) drawn_again: usize,
    pub(crate) columns: usize,
    pub(crate) dropped: f64,
    /// η_j, one after the other.
    pub(crate) model_errors: Vec<f64>,
    /// Where it was asked for.
    pub(crate) posterior: Option<CyclePosterior>,
}

/// √(mean (a − b)²).
fn rms(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "length of the true state");
    (a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len() as f64).sqrt()
}
