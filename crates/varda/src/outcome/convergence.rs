//! How a minimization went, row by row, and how it ended.

use std::ops::Add;

use serde::{Deserialize, Serialize};
use varda_assimilation::{AttemptFrom, Counts};

/// One row of the convergence table.
#[derive(Debug, Clone, Serialize)]
pub struct ConvergenceRow {
    /// Outer iterations done.
    pub iteration: usize,
    /// Seconds since the minimization began.
    pub seconds: f64,
    /// J.
    pub j: f64,
    /// J_b.
    pub j_b: f64,
    /// J_o.
    pub j_o: f64,
    /// J_q.
    pub j_q: f64,
    /// ‖∇J‖ in the control variable.
    pub gradient_norm: f64,
    /// ‖∇J‖ at which this run has converged; 0 for a method that ends otherwise.
    pub gradient_goal: f64,
    /// Which start of the minimizer it belongs to, counted from 1.
    pub attempt: usize,
    /// Starts at most.
    pub attempts: usize,
    /// RMSE of the initial state for each group of the state; empty where the truth is not known.
    pub rmse: Vec<f64>,
    /// The numbers of the control that stand for estimated constants.
    pub constants: Vec<f64>,
    /// The factor on σ of the observations at this stage.
    pub sigma_factor: f64,
    /// Steps of the sub-window; J is that of its observations.
    pub window: usize,
    /// The Hessian of the step that led here, where the minimizer has one; see `algorithm.hessian`.
    pub hessian: Option<&'static str>,
    /// Work of the model so far.
    pub counts: WorkCounts,
}

/// Work of the model.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct WorkCounts {
    /// Steps taken.
    pub model_steps: usize,
    /// Products with M_k.
    pub tangent_steps: usize,
    /// Products with M_kᵀ, and with their derivative where the exact Hessian is asked for.
    pub adjoint_steps: usize,
    /// Numerical factorizations.
    pub factorizations: usize,
    /// Newton iterations of the steps.
    pub newton_iterations: usize,
}

impl From<&Counts> for WorkCounts {
    fn from(counts: &Counts) -> Self {
        WorkCounts::of(counts.model)
    }
}

impl WorkCounts {
    /// The work that a model counted.
    pub fn of(model: varda_implicit::Counts) -> Self {
        WorkCounts {
            model_steps: model.model_steps,
            tangent_steps: model.tangent_steps,
            adjoint_steps: model.adjoint_steps + model.adjoint_derivatives,
            factorizations: model.factorizations,
            newton_iterations: model.newton_iterations,
        }
    }
}

impl Add for WorkCounts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        WorkCounts {
            model_steps: self.model_steps + other.model_steps,
            tangent_steps: self.tangent_steps + other.tangent_steps,
            adjoint_steps: self.adjoint_steps + other.adjoint_steps,
            factorizations: self.factorizations + other.factorizations,
            newton_iterations: self.newton_iterations + other.newton_iterations,
        }
    }
}

/// One start of minimizer `auto`: what it came to and what it gained.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Attempt {
    /// From where: "background" or "draw 3 of the prior".
    pub start: String,
    /// What σ of the observations was multiplied by in turn.
    pub sigma_stages: Vec<f64>,
    /// J at its end.
    pub j: f64,
    /// How it ended.
    pub status: &'static str,
    /// Outer iterations.
    pub iterations: usize,
    /// By how much it lowered the lowest J of the starts before it.
    pub gain: f64,
}

impl From<&varda_assimilation::Attempt> for Attempt {
    fn from(of: &varda_assimilation::Attempt) -> Self {
        Attempt {
            start: match of.from {
                AttemptFrom::Given => "background".into(),
                AttemptFrom::Draw(number) => format!("draw {number} of the prior"),
            },
            sigma_stages: of.scales.clone(),
            j: of.value,
            status: Status::from(of.status).name(),
            iterations: of.iterations,
            gain: of.gain,
        }
    }
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// At a stationary point of J.
    Converged,
    /// Out of iterations.
    MaxIterations,
    /// An ensemble was linearized once, as the method says, and J is not the quadratic it was taken for.
    LinearizedOnce,
    /// No step decreases J any more.
    Stalled,
    /// The caller asked to stop, or the time that the scene allows is over.
    Interrupted,
    /// The model failed and the minimizer had no safeguard against that.
    Failed,
}

impl Status {
    /// Its name in summary.json.
    pub fn name(self) -> &'static str {
        match self {
            Status::Converged => "converged",
            Status::MaxIterations => "max_iterations",
            Status::LinearizedOnce => "linearized_once",
            Status::Stalled => "stalled",
            Status::Interrupted => "interrupted",
            Status::Failed => "failed",
        }
    }

    /// Whether the minimization came to an end of its own.
    pub fn is_settled(self) -> bool {
        matches!(self, Status::Converged | Status::Stalled)
    }
}

impl From<varda_assimilation::Status> for Status {
    fn from(status: varda_assimilation::Status) -> Self {
        use varda_assimilation::Status as S;
        match status {
            S::Converged => Status::Converged,
            S::MaxIterations => Status::MaxIterations,
            S::LinearizedOnce => Status::LinearizedOnce,
            S::Stalled => Status::Stalled,
            S::Interrupted => Status::Interrupted,
            S::Failed => Status::Failed,
        }
    }
}
