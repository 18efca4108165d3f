//! One step of a discrete model, given by the equations it satisfies.

use crate::{Equations, Refusal, Structure};
use std::ops::Range;

/// The time interval of one step, or of a substep: from `start` to `start + length`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Index k of the step the interval belongs to.
    pub index: usize,
    /// Time at its start (s).
    pub start: f64,
    /// Its length Δt (s).
    pub length: f64,
    /// Length of the step (or substep) before it (s), whose start the history of x_k belongs to; `None` where
    /// the window starts and x_k has no history yet.
    pub previous: Option<f64>,
}

impl Interval {
    /// Time at its end (s).
    pub fn end(&self) -> f64 {
        self.start + self.length
    }
}

/// A step that was solved, as its products see it.
#[derive(Debug, Clone, Copy)]
pub struct SolvedStep<'a> {
    /// Its time interval.
    pub at: &'a Interval,
    /// x_k.
    pub x: &'a [f64],
    /// u, the solution of G(x_k, u) = 0.
    pub u: &'a [f64],
    /// What [`ImplicitStep::keep`] wrote.
    pub kept: &'a [f64],
}

/// The multipliers of the adjoint at a solved step, as its second derivatives see them.
#[derive(Debug, Clone, Copy)]
pub struct Multipliers<'a> {
    /// λ of x_{k+1}, without the history.
    pub lambda: &'a [f64],
    /// μ = −(∂G/∂u)⁻ᵀ (∂S/∂u)ᵀ λ.
    pub mu: &'a [f64],
    /// What [`ImplicitStep::keep_second`] wrote.
    pub kept: &'a [f64],
}

/// A step x_{k+1} = M_k(x_k) given by equations G(x_k, u) = 0 in unknowns u, from which x_{k+1} = S(x_k, u)
/// follows without a solve.
///
/// The unknowns are what must be solved for and nothing else: backward Euler of ẍ = f needs the new
/// positions only, the velocities being (X_{k+1} − X_k)/Δt. Where u = x_{k+1} (the default of the mapping
/// methods) G is the paper's G(x_k, x_{k+1}) (paper 2.23). A step is a pure function of the interval and x_k:
/// no memory of earlier calls may show.
///
/// **Two-step schemes** need the state before: their x_k is [its own components, `history` of the first ones
/// of x_{k−1}]. Every method is given the whole x_k, dx or (∂G/∂x_k)ᵀμ; what they write or read of
/// the *next* state (`advance`, `recover`, `advance_tangent`, `advance_adjoint`) and of the initial one is
/// without the history, which [`ImplicitModel`](crate::ImplicitModel) hands on.
///
/// # Examples
///
/// Backward Euler of ẍ = −sin x, the state [x, ẋ], only the new x unknown:
///
/// ```
/// use varda_implicit::{
///     Equations, ImplicitModel, ImplicitStep, Interval, Refusal, SolvedStep, StepEquations, Structure,
///     check,
/// };
///
/// struct Swing;
///
/// /// G(u) = u − x − Δt ẋ + Δt² sin u
/// struct Next {
///     length: f64,
///     x: [f64; 2],
/// }
///
/// impl Equations for Next {
///     fn assemble(
///         &mut self,
///         u: &[f64],
///         g: &mut [f64],
///         jacobian: Option<&mut [f64]>,
///     ) -> Result<Option<f64>, Refusal> {
///         let Next { length: h, x } = *self;
///         g[0] = u[0] - x[0] - h * x[1] + h * h * u[0].sin();
///         if let Some(values) = jacobian {
///             values[0] = 1.0 + h * h * u[0].cos();
///         }
///         Ok(None)
///     }
///     fn converged_below(&self) -> f64 {
///         1e-13
///     }
/// }
///
/// impl StepEquations for Next {
///     fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
///         u[0] = self.x[0];
///         Ok(())
///     }
/// }
///
/// impl ImplicitStep for Swing {
///     type Equations<'a> = Next;
///
///     fn dim(&self) -> usize {
///         2
///     }
///     fn unknowns(&self) -> usize {
///         1
///     }
///     fn structure(&self) -> Structure {
///         Structure::Dense
///     }
///     fn equations(&mut self, at: &Interval, x: &[f64]) -> Result<Next, Refusal> {
///         Ok(Next { length: at.length, x: [x[0], x[1]] })
///     }
///     fn advance(&mut self, at: &Interval, x: &[f64], u: &[f64], next: &mut [f64]) {
///         (next[0], next[1]) = (u[0], (u[0] - x[0]) / at.length);
///     }
///     fn recover(&mut self, _: &Interval, _: &[f64], next: &[f64], u: &mut [f64]) {
///         u[0] = next[0];
///     }
///     fn previous(&mut self, of: &SolvedStep, dx: &[f64], dg: &mut [f64]) {
///         dg[0] = -dx[0] - of.at.length * dx[1];
///     }
///     fn previous_transpose_add(&mut self, of: &SolvedStep, mu: &[f64], dx: &mut [f64]) {
///         dx[0] -= mu[0];
///         dx[1] -= of.at.length * mu[0];
///     }
///     fn advance_tangent(&mut self, of: &SolvedStep, dx: &[f64], du: &[f64], next: &mut [f64]) {
///         (next[0], next[1]) = (du[0], (du[0] - dx[0]) / of.at.length);
///     }
///     fn advance_adjoint(
///         &mut self,
///         of: &SolvedStep,
///         lambda: &[f64],
///         dx: &mut [f64],
///         du: &mut [f64],
///     ) {
///         (dx[0], dx[1]) = (-lambda[1] / of.at.length, 0.0);
///         du[0] = lambda[0] + lambda[1] / of.at.length;
///     }
/// }
///
/// let mut model = ImplicitModel::new(Swing, 0, 0.1);
/// let report = check::model(&mut model, &[1.0, 0.5], 3, &[0.1; 2], 1)?;
/// assert!(report.passed(), "{report}");
/// # Ok::<(), varda_implicit::Error>(())
/// ```
pub trait ImplicitStep {
    /// The step's equations, prepared for an interval and a state.
    type Equations<'a>: StepEquations
    where
        Self: 'a;

    /// Length of the state x, history included.
    fn dim(&self) -> usize;

    /// How many components at the end of the state repeat the first ones of the state before.
    fn history(&self) -> usize {
        0
    }

    /// Length of the unknowns u.
    fn unknowns(&self) -> usize {
        self.dim() - self.history()
    }

    /// Layout of ∂G/∂u.
    fn structure(&self) -> Structure;

    /// Prepares everything of G(x_k, ·) that does not depend on u.
    ///
    /// # Errors
    /// A state or a time for which the step has no equations.
    fn equations<'a>(&'a mut self, at: &Interval, x: &'a [f64]) -> Result<Self::Equations<'a>, Refusal>;

    /// x_{k+1} = S(x_k, u), without the history.
    fn advance(&mut self, _at: &Interval, _x: &[f64], u: &[f64], x_next: &mut [f64]) {
        x_next.copy_from_slice(u);
    }

    /// u back from an accepted x_{k+1}: the point at which a step is linearized.
    fn recover(&mut self, _at: &Interval, _x: &[f64], x_next: &[f64], u: &mut [f64]) {
        u.copy_from_slice(x_next);
    }

    /// How many numbers the products below need of a solved step beside (x_k, u).
    fn kept(&self) -> usize {
        0
    }

    /// Writes them, once for every linearization, right after the equations of x_k were prepared and u
    /// accepted.
    fn keep(&mut self, _at: &Interval, _x: &[f64], _u: &[f64], _kept: &mut [f64]) {}

    /// dg = ∂G/∂x_k dx.
    fn previous(&mut self, of: &SolvedStep<'_>, dx: &[f64], dg: &mut [f64]);

    /// dx += (∂G/∂x_k)ᵀ μ.
    fn previous_transpose_add(&mut self, of: &SolvedStep<'_>, mu: &[f64], dx: &mut [f64]);

    /// dx_next = ∂S/∂x_k dx + ∂S/∂u du.
    fn advance_tangent(&mut self, _of: &SolvedStep<'_>, _dx: &[f64], du: &[f64], dx_next: &mut [f64]) {
        dx_next.copy_from_slice(du);
    }

    /// du = (∂S/∂u)ᵀ λ; dx = (∂S/∂x_k)ᵀ λ. Both are overwritten.
    fn advance_adjoint(&mut self, _of: &SolvedStep<'_>, lambda: &[f64], dx: &mut [f64], du: &mut [f64]) {
        dx.fill(0.0);
        du.copy_from_slice(lambda);
    }

    /// How many numbers the second derivatives of a solved step keep; `None` (the default) where the step has
    /// none, and Hessians are those of Gauss and Newton.
    fn second_kept(&self) -> Option<usize> {
        None
    }

    /// Writes them, once for every λ and μ: what `second_add` needs of L = λᵀ S(x_k, u) + μᵀ G(x_k,
    /// u) beside the two vectors.
    fn keep_second(&mut self, _of: &SolvedStep<'_>, _lambda: &[f64], _mu: &[f64], _kept: &mut [f64]) {}

    /// Adds the second derivatives of L = λᵀ S(x_k, u) + μᵀ G(x_k, u), in the increments that the
    /// products above are given:
    ///
    /// ```text
    /// rx += ∂²L/∂x² dx + ∂²L/∂x∂u du,    ru += ∂²L/∂u∂x dx + ∂²L/∂u² du
    /// ```
    ///
    /// Called only where `second_kept` is not `None`.
    fn second_add(
        &mut self,
        _of: &SolvedStep<'_>,
        _at: &Multipliers<'_>,
        _by: [&[f64]; 2],
        _to: [&mut [f64]; 2],
    ) {
    }

    /// Components of the state, and the first of as many whose values are their rates: for
    /// [`Model::rate`](crate::Model::rate). Not where rates ring or jump within a step, as midpoint's do.
    fn velocities(&self) -> Option<(Range<usize>, usize)> {
        None
    }

    /// Length of the control z, what is estimated.
    fn control_dim(&self) -> usize {
        self.dim() - self.history()
    }

    /// x₀, without a history, from the control z, at the time t of the start (s). Keeps what the two
    /// derivatives below need.
    ///
    /// # Errors
    /// If no step can start from this control; the step's own typed error.
    fn initial_state(&mut self, _t: f64, z: &[f64], x: &mut [f64]) -> Result<(), Refusal> {
        x.copy_from_slice(z);
        Ok(())
    }

    /// dx₀ = ∂x₀/∂z dz at the control of the last `initial_state`.
    fn initial_tangent(&mut self, _t: f64, dz: &[f64], dx: &mut [f64]) {
        dx.copy_from_slice(dz);
    }

    /// dz = (∂x₀/∂z)ᵀ λ₀ at the control of the last `initial_state`.
    fn initial_adjoint(&mut self, _t: f64, lambda: &[f64], dz: &mut [f64]) {
        dz.copy_from_slice(lambda);
    }

    /// out += Σ_i λ_i ∂²x_{0,i}/∂z² dz at the control of the last `initial_state`. Nothing (the
    /// default) where the map is linear.
    fn initial_second_add(&mut self, _t: f64, _dz: &[f64], _lambda: &[f64], _out: &mut [f64]) {}
}

/// The equations G(x_k, u) = 0 of one interval and one x_k: what only holds once a step has been prepared.
pub trait StepEquations: Equations {
    /// First guess of u.
    ///
    /// # Errors
    /// Where there is none.
    fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal>;

    /// Another first guess of u, more cautious: asked for where Newton's method failed from the first, and
    /// before the first in parts of a step that failed as a whole. Returns the Newton iterations and
    /// factorizations it took; `None` where there is no other.
    ///
    /// # Errors
    /// Where the equations cannot be assembled.
    fn predict_again(&mut self, _u: &mut [f64]) -> Result<Option<[usize; 2]>, Refusal> {
        Ok(None)
    }

    /// Asked once when u was accepted, and again when the step is linearized there: a step may watch a pivot
    /// here, and return a warning or refuse the state.
    ///
    /// # Errors
    /// A state at which the step has no derivative.
    fn accepted(&mut self, _u: &[f64]) -> Result<Option<String>, Refusal> {
        Ok(None)
    }
}
