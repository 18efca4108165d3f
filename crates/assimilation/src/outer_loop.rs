//! The outer loop of incremental methods: linearize, minimize the quadratic, move, repeat.

use crate::cost::{dot, norm};
use crate::inner::{InnerLimits, conjugate_gradients, restricted_conjugate_gradients};
use crate::minimize::{Conditions, LineSearch, Progress, Ray, Start, at_least_one, check_tolerance, setters};
use crate::{Error, Iteration, LeastSquares, Minimum, Status, Stopping};
use std::ops::ControlFlow;

/// How the inner problem is solved.
///
/// ```
/// # use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// # use varda_covariance::Diagonal;
/// # use varda_implicit::{Rk4, lorenz::Lorenz63};
/// # let (mut model, b) = (Rk4::new(Lorenz63::default(), 0, 0.01), Diagonal::uniform(3, 1.0)?);
/// # let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// # let all = Box::new(Selection::new(vec![0, 1, 2], 3)?);
/// # let mut observations = ObservationSet::new(20, vec![all], seen)?;
/// # let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// # let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut observations)?;
/// // x₀ and x₂ of Lorenz-63 seen at step 20: `cost` is its strong constraint.
/// let mut v = vec![0.0; 3];
/// let options = OuterLoopOptions::default().with_inner(InnerSolver::Dual);
/// let minimum = outer_loop(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InnerSolver {
    /// Conjugate gradients in the control space: incremental 3D-Var and 4D-Var.
    #[default]
    Primal,
    /// Restricted conjugate gradients in observation space: PSAS and 4D-PSAS. The same iterates.
    Dual,
    /// A direct solve, for small problems: dense Cholesky, block-tridiagonal for a cost over states.
    Direct,
}

/// Settings of [`outer_loop`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct OuterLoopOptions {
    /// When it ends, by the gradient of the true J.
    pub stopping: Stopping,
    /// How the inner problem is solved.
    pub inner: InnerSolver,
    /// Inner iterations of one outer iteration at most.
    pub max_inner: usize,
    /// How far an inner problem is solved at least, relative to its gradient; the forcing term
    /// √(‖∇J‖/‖∇J₀‖) asks for more as the outer loop converges. On a linear problem 1e-12
    /// makes the first outer iteration the last.
    pub inner_tolerance: f64,
    /// Halve steps until J falls by 10⁻⁴ of what the slope promises. Without it every step is full, as in
    /// operations.
    pub step_control: bool,
}

impl Default for OuterLoopOptions {
    fn default() -> Self {
        Self {
            stopping: Stopping::within(100),
            inner: InnerSolver::Primal,
            max_inner: 200,
            inner_tolerance: 0.5,
            step_control: true,
        }
    }
}

setters!(OuterLoopOptions, stopping, {
    with_inner: inner: InnerSolver,
    with_max_inner: max_inner: usize,
    with_inner_tolerance: inner_tolerance: f64,
    with_step_control: step_control: bool,
});

/// Incremental minimization (paper, sections 2.2 and 2.5; Courtier, Thépaut and Hollingsworth 1994;
/// Gauss–Newton: Lawless et al. 2005):
///
/// ```text
///     repeat:  x = trajectory of v,  d = y − H(x),  G around x
///              p ≈ argmin ½‖b + p‖² + ½‖G p − d‖²       (inner loop, to a forcing tolerance)
///              v ← v + α increment(p)                   (α = 1, ½, ¼, … with step control)
/// until the gradient of the true J is small
/// ```
///
/// The background term stays about x_b: b = v, not zero, at every outer iterate but the first. With a
/// [`StrongConstraint`](crate::StrongConstraint) this is incremental 4D-Var, without a model incremental
/// 3D-Var; with [`InnerSolver::Dual`] 4D-PSAS and PSAS; with a [`WeakState`](crate::WeakState) or a
/// [`WeakForcing`](crate::WeakForcing) weak-constraint 4D-Var.
///
/// When to use: inner iterations much cheaper than model runs, mildly nonlinear problems. Convergence is
/// linear, at the rate by which the dropped second derivatives are smaller than A; with step control J never
/// rises and the loop ends at a stationary point or says that it did not. Without it, it may cycle or diverge
/// (`MaxIterations`, or `Failed` where the model refuses). When not: large residuals, where
/// [`trust_region`](crate::trust_region) is faster.
///
/// Cost of an outer iteration: one forward run and adjoint sweep, a forward run for each refused step, and a
/// tangent and an adjoint sweep for each inner iteration. Memory: six vectors and that of the inner solver.
/// `gradient_norm` and `step_norm` reported are those of p, the norm of the prior; `observation_scale` is
/// reported as 1, whatever was set.
///
/// PSAS, where the square of a state of 50 is seen at two points:
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// use varda_covariance::{CovarianceFunction, Dense, Kernel, Taper};
/// # struct Square;
/// # impl ObservationOperator for Square {
/// #     fn dim(&self) -> usize { 50 }
/// #     fn state_dim(&self) -> usize { 50 }
/// #     fn observe(&mut self, _: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
/// #         y.iter_mut().zip(x).for_each(|(y, x)| *y = x * x);
/// #         Ok(())
/// #     }
/// #     fn tangent(&mut self, _: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
/// #         (0..50).for_each(|i| dy[i] = 2.0 * x[i] * dx[i]);
/// #     }
/// #     fn adjoint_add(&mut self, _: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
/// #         (0..50).for_each(|i| dx[i] += 2.0 * x[i] * dy[i]);
/// #     }
/// # }
///
/// let places: Vec<f64> = (0..50).map(|i| 0.02 * i as f64).collect();
/// let kernel = Kernel::Gaussian { length: 0.2 };
/// let b = CovarianceFunction { sigma: 0.3, kernel, taper: Taper::Triangle { support: 1.0 } };
/// let b = Dense::new(50, &b.matrix(&places)?)?;
/// let transform = ControlTransform::new(vec![1.0; 50], &b)?;
/// let seen = Observation::new(0, vec![10, 30], vec![1.44, 0.81], 0.01);
/// let mut observations = ObservationSet::new(0, vec![Box::new(Square)], vec![seen])?;
/// let mut cost = StrongConstraint::without_model(transform, &mut observations)?;
/// let options = OuterLoopOptions::default().with_inner(InnerSolver::Dual);
/// let mut v = vec![0.0; 50];
/// let minimum = outer_loop(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// assert!((cost.state(0)[10] - 1.2).abs() < 0.01 && (cost.state(0)[30] - 0.9).abs() < 0.01);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A cost that cannot be evaluated at the first point, a setting out of range, or products that fail.
/// Everything that happens once under way is a [`Status`].
///
/// # Panics
/// If `v` is not of length `problem.dim()`.
pub fn outer_loop(
    problem: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &OuterLoopOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    options.stopping.check()?;
    check_tolerance("inner_tolerance", options.inner_tolerance)?;
    at_least_one("max_inner", options.max_inner)?;
    let conditions = if options.step_control { Conditions::Armijo } else { Conditions::FullStep };
    let n = problem.dim();
    let [mut g, mut p, mut dv, mut b] = std::array::from_fn(|_| vec![0.0; n]);
    let mut d = vec![0.0; problem.observation_dim()];
    let mut search = LineSearch::new(n);
    let value = problem.linearize(v, &mut g)?;
    let mut progress = Progress::at(problem, value, &g, &Start::default())?;
    loop {
        let flow = progress.tell(problem, v, &options.stopping, on_iteration);
        problem.departures(&mut b, &mut d);
        if let Some(status) = progress.ended(&b, &g, &options.stopping, flow) {
            return Ok(progress.end(status, None, Vec::new()));
        }

        let forcing = (progress.gradient_norm / progress.gradient_norm_first).sqrt();
        let limits =
            InnerLimits { residual: options.inner_tolerance.min(forcing), iterations: options.max_inner };
        progress.inner = match options.inner {
            InnerSolver::Primal => conjugate_gradients(problem, &g, &limits, &mut p)?.iterations,
            InnerSolver::Dual => restricted_conjugate_gradients(problem, &limits, &mut p)?.iterations,
            InnerSolver::Direct => {
                problem.direct(&g, &mut p)?;
                0
            }
        };
        progress.inner_total += progress.inner;
        problem.increment(&p, &mut dv)?;

        let ray = Ray {
            v,
            direction: &dv,
            value: progress.value,
            slope: dot(&g, &p),
            gradient_norm: progress.gradient_norm,
            first: 1.0,
        };
        search.refused = 0;
        let mut at = |v: &[f64], gradient: Option<&mut [f64]>| match gradient {
            None => problem.evaluate(v, None),
            Some(gradient) => problem.linearize(v, gradient),
        };
        let found = search.run(conditions, &mut at, &ray);
        progress.rejected = search.refused;
        let Some(length) = found else {
            // The products of the point that is returned.
            problem.linearize(v, &mut g)?;
            let status = if options.step_control { Status::Stalled } else { Status::Failed };
            return Ok(progress.end(status, search.failure, Vec::new()));
        };
        v.copy_from_slice(&search.trial);
        std::mem::swap(&mut g, &mut search.gradient);
        progress.advance(problem, &g, length * norm(&p), 0.0);
    }
}
