//! What a minimization reports: its iterations and its end.

use super::hessian::Hessian;
use super::inverse_hessian::InverseHessian;
use super::stopping::{Status, Stopping};
use crate::cost::norm;
use crate::{CostFunction, CostTerms, Counts, Error};
use std::ops::ControlFlow;
use varda_linalg::krylov::RitzPair;

/// One line of a convergence table. The first (index 0, or the first of a stage) is the point the run starts
/// from.
#[derive(Debug, Clone, Copy)]
pub struct Iteration<'a> {
    /// Outer iterations done.
    pub index: usize,
    /// J, at the observation scale in force.
    pub value: f64,
    /// Its parts.
    pub terms: CostTerms,
    /// ‖∇J‖ in the control variable.
    pub gradient_norm: f64,
    /// ‖Δv‖ of the step that led here, the B⁻¹ norm of the increment; 0 at the start.
    pub step_norm: f64,
    /// λ of that step, (A + λI) Δv = −∇J; 0 for a full step.
    pub damping: f64,
    /// Trial points refused before that step.
    pub rejected: usize,
    /// Inner (Lanczos) iterations for that step; 0 where a dense solve was used.
    pub inner_iterations: usize,
    /// The Hessian that step was made with; `None` from others than [`trust_region`](crate::trust_region())
    /// and [`auto`](crate::auto()), and at the start.
    pub hessian: Option<Hessian>,
    /// What σ is multiplied by at this stage (1 = the true cost).
    pub observation_scale: f64,
    /// ‖∇J‖ at which this run has converged.
    pub gradient_goal: f64,
    /// Which start it belongs to, counted from 1.
    pub attempt: usize,
    /// Starts at most; 1 but for [`auto`](crate::auto()).
    pub attempts: usize,
    /// Work done so far.
    pub counts: Counts,
    /// The point.
    pub v: &'a [f64],
}

/// How a minimization ended, and where.
#[derive(Debug)]
pub struct Minimum {
    /// J at the point returned.
    pub value: f64,
    /// Its parts.
    pub terms: CostTerms,
    /// ‖∇J‖ at the first point.
    pub gradient_norm_first: f64,
    /// ‖∇J‖ at the point returned.
    pub gradient_norm: f64,
    /// Outer iterations.
    pub outer_iterations: usize,
    /// Inner (Lanczos) iterations, summed.
    pub inner_iterations: usize,
    /// How it ended.
    pub status: Status,
    /// The model failure that ended it (`Failed`) or the last one that refused a trial point (`Stalled`).
    pub failure: Option<Error>,
    /// Approximate eigenpairs of the Hessian from the last inner iteration, largest first; empty after dense
    /// solves.
    pub ritz: Vec<RitzPair>,
    /// What [`lbfgs`](crate::lbfgs()) has learnt of the Hessian; `None` from the others.
    pub inverse_hessian: Option<InverseHessian>,
    /// The gradient vanished at the first point, and that was no minimum: J is lower beside it, and the run
    /// started there.
    pub started_beside: bool,
    /// [`trust_region`](crate::trust_region()) found every decrease as its quadratic model said, to 10⁻⁶:
    /// the problem is linear, as far as it was seen, and has no other minimum. False from the others.
    pub quadratic: bool,
    /// The starts of [`auto`](crate::auto()) in turn, the first included; empty from the others.
    pub attempts: Vec<Attempt>,
}

impl Minimum {
    /// The iteration that led to this point v by a full step ‖Δv‖, after the given work: for methods
    /// that are no minimizer of this crate.
    pub fn iteration<'a>(&self, step_norm: f64, counts: Counts, v: &'a [f64]) -> Iteration<'a> {
        Iteration {
            index: self.outer_iterations,
            value: self.value,
            terms: self.terms,
            gradient_norm: self.gradient_norm,
            step_norm,
            damping: 0.0,
            rejected: 0,
            inner_iterations: 0,
            hessian: None,
            observation_scale: 1.0,
            gradient_goal: 0.0,
            attempt: 1,
            attempts: 1,
            counts,
            v,
        }
    }
}

/// One start of [`auto`](crate::auto()): from where, and what it came to.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Attempt {
    /// Where it started.
    pub from: AttemptFrom,
    /// What σ was multiplied by in turn; 1 alone for a run of the true cost.
    pub scales: Vec<f64>,
    /// J at its end.
    pub value: f64,
    /// How it ended.
    pub status: Status,
    /// Its outer iterations, those of all its stages.
    pub iterations: usize,
    /// By how much it lowered the lowest J of the starts before it; 0 for the first.
    pub gain: f64,
}

/// Where an [`Attempt`] started.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttemptFrom {
    /// The point given: the background, as a rule.
    Given,
    /// A draw of the prior, counted from 1.
    Draw(usize),
}

/// Where a run starts in the table of a longer one.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    pub(super) index: usize,
    pub(super) inner: usize,
    /// The first ‖∇J‖ where it is not that of the point given.
    pub(super) gradient_norm: Option<f64>,
    pub(super) scale: f64,
    /// Which start of how many at most.
    pub(super) attempt: [usize; 2],
}

impl Default for Start {
    fn default() -> Self {
        Self { index: 0, inner: 0, gradient_norm: None, scale: 1.0, attempt: [1, 1] }
    }
}

impl Start {
    /// After a run that ended so.
    pub(super) fn after(&self, end: &Minimum) -> Self {
        let (index, inner) = (end.outer_iterations, end.inner_iterations);
        Self { index, inner, gradient_norm: Some(end.gradient_norm_first), ..*self }
    }
}

/// What a run has come to: the point's numbers and the step that led there.
pub(crate) struct Progress {
    attempt: [usize; 2],
    pub(crate) index: usize,
    pub(crate) inner_total: usize,
    pub(crate) scale: f64,
    pub(crate) gradient_norm_first: f64,
    pub(crate) value: f64,
    pub(crate) terms: CostTerms,
    pub(crate) gradient_norm: f64,
    pub(crate) step_norm: f64,
    pub(crate) damping: f64,
    pub(crate) rejected: usize,
    pub(crate) inner: usize,
    /// That of the last step.
    pub(crate) hessian: Option<Hessian>,
    /// Every step so far lowered J as its quadratic model said.
    pub(crate) quadratic: bool,
}

impl Progress {
    /// Evaluates the first point.
    pub(crate) fn start(
        cost: &mut dyn CostFunction,
        v: &[f64],
        gradient: &mut [f64],
        start: &Start,
    ) -> Result<Self, Error> {
        let value = cost.evaluate(v, Some(gradient))?;
        Self::at(cost, value, gradient, start)
    }

    /// From the first point, whose value and gradient are the cost's last evaluation.
    pub(crate) fn at(
        cost: &dyn CostFunction,
        value: f64,
        gradient: &[f64],
        start: &Start,
    ) -> Result<Self, Error> {
        let gradient_norm = norm(gradient);
        if !gradient_norm.is_finite() {
            return Err(Error::NonFinite { what: "the norm of the gradient", step: 0 });
        }
        Ok(Self {
            attempt: start.attempt,
            index: start.index,
            inner_total: start.inner,
            scale: start.scale,
            gradient_norm_first: start.gradient_norm.unwrap_or(gradient_norm),
            value,
            terms: cost.terms(),
            gradient_norm,
            step_norm: 0.0,
            damping: 0.0,
            rejected: 0,
            inner: 0,
            hessian: None,
            quadratic: false,
        })
    }

    /// Takes note of a step to a new point, whose gradient is the cost's last evaluation.
    pub(crate) fn advance(
        &mut self,
        cost: &dyn CostFunction,
        gradient: &[f64],
        step_norm: f64,
        damping: f64,
    ) {
        self.index += 1;
        self.terms = cost.terms();
        self.value = self.terms.total();
        self.gradient_norm = norm(gradient);
        self.step_norm = step_norm;
        self.damping = damping;
    }

    /// Takes the numbers of v instead, and leaves its gradient the cost's last evaluation.
    pub(crate) fn here(
        &mut self,
        cost: &mut dyn CostFunction,
        v: &[f64],
        gradient: &mut [f64],
    ) -> Result<(), Error> {
        self.value = cost.evaluate(v, Some(gradient))?;
        self.terms = cost.terms();
        self.gradient_norm = norm(gradient);
        Ok(())
    }

    /// Reports the point to the caller.
    pub(crate) fn tell(
        &self,
        cost: &dyn CostFunction,
        v: &[f64],
        stopping: &Stopping,
        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> ControlFlow<()> {
        on_iteration(&Iteration {
            index: self.index,
            value: self.value,
            terms: self.terms,
            gradient_norm: self.gradient_norm,
            step_norm: self.step_norm,
            damping: self.damping,
            rejected: self.rejected,
            inner_iterations: self.inner,
            hessian: self.hessian,
            observation_scale: self.scale,
            gradient_goal: stopping.gradient_goal(self.gradient_norm_first),
            attempt: self.attempt[0],
            attempts: self.attempt[1],
            counts: cost.counts(),
            v,
        })
    }

    /// How the run ends at the point whose whitened departure is b, if it does.
    pub(crate) fn ended(
        &self,
        b: &[f64],
        gradient: &[f64],
        stopping: &Stopping,
        flow: ControlFlow<()>,
    ) -> Option<Status> {
        stopping.ended(b, gradient, self.gradient_norm_first, self.index, flow)
    }

    /// Reports the point, and says whether the run ends there: for costs whose departure is v.
    pub(crate) fn report(
        &self,
        cost: &dyn CostFunction,
        v: &[f64],
        gradient: &[f64],
        stopping: &Stopping,
        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Option<Status> {
        // A floor of the gradient means something in units of the prior only.
        let stopping = if cost.is_whitened() { *stopping } else { stopping.with_gradient_floor(0.0) };
        self.ended(v, gradient, &stopping, self.tell(cost, v, &stopping, on_iteration))
    }

    pub(crate) fn end(self, status: Status, failure: Option<Error>, ritz: Vec<RitzPair>) -> Minimum {
        Minimum {
            value: self.value,
            terms: self.terms,
            gradient_norm_first: self.gradient_norm_first,
            gradient_norm: self.gradient_norm,
            outer_iterations: self.index,
            inner_iterations: self.inner_total,
            status,
            failure,
            ritz,
            inverse_hessian: None,
            started_beside: false,
            quadratic: self.quadratic,
            attempts: Vec::new(),
        }
    }
}

/// How far an inner problem is solved, relative to its gradient: min(½, √(‖g‖/‖g₀‖)), so that
/// the outer iteration keeps its superlinear rate where the Hessian is exact (Dembo, Eisenstat and Steihaug
/// 1982).
pub(crate) fn forcing(progress: &Progress) -> f64 {
    (progress.gradient_norm / progress.gradient_norm_first).sqrt().min(0.5)
}
