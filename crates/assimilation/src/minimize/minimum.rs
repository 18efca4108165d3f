//! What a minimization reports: its iterations, its end, and the stopping rule that all share.

use super::inverse_hessian::InverseHessian;
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
    /// What σ is multiplied by at this stage (1 = the true cost).
    pub observation_scale: f64,
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
            observation_scale: 1.0,
            counts,
            v,
        }
    }
}

/// How a minimization ended. Only `Converged` claims a stationary point; a small step alone never does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// ‖∇J‖ ≤ tolerance × ‖∇J‖ at the first point, or ‖∇J‖ is rounding: at most 64 ε
    /// (‖v‖ + ‖∇J − v‖), its two parts having cancelled to the last digits.
    Converged,
    /// Out of iterations.
    MaxIterations,
    /// No step decreases J, nor, where the decrease is too small to be measured, the gradient.
    Stalled,
    /// The caller asked to stop.
    Interrupted,
    /// The model failed where no safeguard was asked for.
    Failed,
}

/// Where a run starts in the table of a longer one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub(super) index: usize,
    pub(super) inner: usize,
    /// The first ‖∇J‖ where it is not that of the point given.
    pub(super) gradient_norm: Option<f64>,
    pub(super) scale: f64,
}

impl Default for Start {
    fn default() -> Self {
        Self { index: 0, inner: 0, gradient_norm: None, scale: 1.0 }
    }
}

/// What a run has come to: the point's numbers and the step that led there.
pub(super) struct Progress {
    pub(super) index: usize,
    pub(super) inner_total: usize,
    pub(super) scale: f64,
    pub(super) gradient_norm_first: f64,
    pub(super) value: f64,
    pub(super) terms: CostTerms,
    pub(super) gradient_norm: f64,
    pub(super) step_norm: f64,
    pub(super) damping: f64,
    pub(super) rejected: usize,
    pub(super) inner: usize,
}

impl Progress {
    /// Evaluates the first point.
    pub(super) fn start(
        cost: &mut dyn CostFunction,
        v: &[f64],
        gradient: &mut [f64],
        start: &Start,
    ) -> Result<Self, Error> {
        let value = cost.evaluate(v, Some(gradient))?;
        let gradient_norm = norm(gradient);
        if !gradient_norm.is_finite() {
            return Err(Error::NonFinite { what: "the norm of the gradient", step: 0 });
        }
        Ok(Self {
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
        })
    }

    /// Takes note of a step to a new point, whose gradient is the cost's last evaluation.
    pub(super) fn advance(
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
    pub(super) fn here(
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

    /// Reports the point, and says whether the run ends there.
    pub(super) fn report(
        &self,
        cost: &dyn CostFunction,
        v: &[f64],
        gradient: &[f64],
        tolerance: f64,
        last: usize,
        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Option<Status> {
        let flow = on_iteration(&Iteration {
            index: self.index,
            value: self.value,
            terms: self.terms,
            gradient_norm: self.gradient_norm,
            step_norm: self.step_norm,
            damping: self.damping,
            rejected: self.rejected,
            inner_iterations: self.inner,
            observation_scale: self.scale,
            counts: cost.counts(),
            v,
        });
        let pull = v.iter().zip(gradient).map(|(v, g)| (g - v) * (g - v)).sum::<f64>().sqrt();
        // a norm that overflowed is no larger than another one that did
        let small = self.gradient_norm <= tolerance * self.gradient_norm_first
            || self.gradient_norm <= 64.0 * f64::EPSILON * (norm(v) + pull);
        if small && self.gradient_norm.is_finite() {
            Some(Status::Converged)
        } else if flow.is_break() {
            Some(Status::Interrupted)
        } else if self.index >= last {
            Some(Status::MaxIterations)
        } else {
            None
        }
    }

    pub(super) fn end(self, status: Status, failure: Option<Error>, ritz: Vec<RitzPair>) -> Minimum {
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
        }
    }
}

/// A relative tolerance: in [0, 1).
pub(crate) fn check_tolerance(what: &'static str, value: f64) -> Result<(), Error> {
    if (0.0..1.0).contains(&value) { Ok(()) } else { Err(Error::Setting { what, value }) }
}

/// A count that must not be zero.
pub(crate) fn at_least_one(what: &'static str, value: usize) -> Result<(), Error> {
    if value > 0 { Ok(()) } else { Err(Error::Setting { what, value: 0.0 }) }
}

/// How far an inner problem is solved, relative to its gradient: min(½, √(‖g‖/‖g₀‖)), so that
/// the outer iteration keeps its superlinear rate where the Hessian is exact (Dembo, Eisenstat and Steihaug
/// 1982).
pub(super) fn forcing(progress: &Progress) -> f64 {
    (progress.gradient_norm / progress.gradient_norm_first).sqrt().min(0.5)
}
