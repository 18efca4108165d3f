//! Solvers of the argmin crate behind our costs: to compare with, and to check ours against.

use super::method::method;
use super::minimum::{Iteration, Minimum, Progress, Start};
use super::stopping::{Status, Stopping, at_least_one, setters};
use crate::cost::norm;
use crate::{CostFunction, Error, LeastSquares};
use ::argmin::core::{self as core, IterState, Problem, Solver, State};
use ::argmin::solver::linesearch::MoreThuenteLineSearch;
use ::argmin::solver::quasinewton::LBFGS;
use ::argmin::solver::trustregion::{Steihaug, TrustRegion};
use argmin_math::ArgminDot;
use std::cell::RefCell;
use std::ops::ControlFlow;
use std::rc::Rc;

/// Settings of [`argmin_lbfgs`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ArgminLbfgsOptions {
    /// When it ends: our rule, asked between argmin's iterations.
    pub stopping: Stopping,
    /// Evaluations at most: argmin's line search has no limit of its own.
    pub max_evaluations: usize,
    /// Pairs kept.
    pub memory: usize,
}

impl Default for ArgminLbfgsOptions {
    fn default() -> Self {
        Self { stopping: Stopping::within(1000), max_evaluations: 20_000, memory: 30 }
    }
}

setters!(ArgminLbfgsOptions, stopping, {
    with_max_evaluations: max_evaluations: usize,
    with_memory: memory: usize,
});

/// Settings of [`argmin_trust_region`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct ArgminTrustRegionOptions {
    /// When it ends: our rule, asked between argmin's iterations.
    pub stopping: Stopping,
    /// Evaluations and products at most: argmin's inner loops have no limit of their own.
    pub max_evaluations: usize,
    /// Steihaug iterations of one step at most.
    pub max_inner: usize,
}

impl Default for ArgminTrustRegionOptions {
    fn default() -> Self {
        Self { stopping: Stopping::within(1000), max_evaluations: 20_000, max_inner: 100 }
    }
}

setters!(ArgminTrustRegionOptions, stopping, {
    with_max_evaluations: max_evaluations: usize,
    with_max_inner: max_inner: usize,
});

/// argmin's L-BFGS with its Moré–Thuente line search.
///
/// When to use: to check [`lbfgs`](crate::lbfgs). When not: otherwise; it stores pairs without a curvature
/// test, and ends (`Status::Failed`) where the model fails at a trial point, (`Status::Stalled`) where its
/// line search gives up.
///
/// Cost of an iteration: one forward run and one adjoint sweep, or more; the last point is kept, so that
/// argmin's separate calls for a value and its gradient cost one run. Memory: 2 `memory` vectors and argmin's
/// copies.
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn argmin_lbfgs(
    cost: &mut dyn CostFunction,
    v: &mut [f64],
    options: &ArgminLbfgsOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    run_lbfgs(cost, v, options, &Start::default(), on_iteration)
}

/// argmin's trust region with Steihaug's conjugate gradients on the Gauss–Newton Hessian.
///
/// When to use: to check [`trust_region`](crate::trust_region). When not: otherwise; it solves every inner
/// problem to a fixed number of iterations, stalls where the decrease of J is rounding, and ends
/// (`Status::Failed`) where the model fails at a trial point.
///
/// Cost of an iteration: one forward run, one adjoint sweep, up to `max_inner` products with the Hessian.
/// Memory: some ten vectors.
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn argmin_trust_region(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &ArgminTrustRegionOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    run_trust_region(cost, v, options, &Start::default(), on_iteration)
}

method!(ArgminLbfgsOptions, stopping, Gradients, run_lbfgs);

method!(ArgminTrustRegionOptions, stopping, Products, run_trust_region);

fn run_lbfgs(
    cost: &mut dyn CostFunction,
    v: &mut [f64],
    options: &ArgminLbfgsOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    at_least_one("memory", options.memory)?;
    let search = MoreThuenteLineSearch::<Vec<f64>, Vec<f64>, f64>::new();
    let solver: LBFGS<_, Vec<f64>, Vec<f64>, f64> = LBFGS::new(search, options.memory);
    let limits = Limits { stopping: options.stopping, evaluations: options.max_evaluations };
    drive::<_, _, ()>(solver, cost, v, &limits, start, on_iteration)
}

fn run_trust_region(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &ArgminTrustRegionOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    let inner = Steihaug::<Vec<f64>, f64>::new().with_max_iters(options.max_inner as u64);
    let limits = Limits { stopping: options.stopping, evaluations: options.max_evaluations };
    drive(TrustRegion::<_, f64>::new(inner), cost, v, &limits, start, on_iteration)
}

/// What ends a run of argmin's solvers.
struct Limits {
    stopping: Stopping,
    evaluations: usize,
}

/// Runs argmin's solver one iteration at a time, with our stopping rule and our rows.
fn drive<'a, C, S, H>(
    mut solver: S,
    cost: &'a mut C,
    v: &mut [f64],
    limits: &Limits,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error>
where
    C: AsCost + ?Sized,
    S: Solver<Adapter<'a, C>, IterState<Vec<f64>, Vec<f64>, (), H, (), f64>>,
{
    limits.stopping.check()?;
    let mut g = vec![0.0; v.len()];
    let mut progress = Progress::start(cost.as_cost(), v, &mut g, start)?;
    let scale = 1.0 / progress.gradient_norm.max(1.0);
    let shared = Rc::new(RefCell::new(Shared {
        cost,
        v: v.to_vec(),
        value: progress.value,
        gradient: Some(g.clone()),
        scale,
        calls: 0,
        limit: limits.evaluations,
        failure: None,
    }));
    let mut problem = Problem::new(Adapter(Rc::clone(&shared)));
    let mut state = solver.init(&mut problem, IterState::new().param(v.to_vec())).map(|(state, _)| state);
    let status = 'run: loop {
        let status = {
            let cost = &mut *shared.borrow_mut();
            progress.report(cost.cost.as_cost(), v, &g, &limits.stopping, on_iteration)
        };
        if let Some(status) = status {
            break status;
        }
        progress.rejected = 0;
        let step = loop {
            let Ok(before) = state else { break 'run Status::Stalled };
            state = solver.next_iter(&mut problem, before).map(|(state, _)| state);
            let Ok(after) = &mut state else { break 'run Status::Stalled };
            after.update();
            after.increment_iter();
            let Some(point) = after.get_param() else { break 'run Status::Stalled };
            let step = norm(&point.iter().zip(&*v).map(|(t, v)| t - v).collect::<Vec<f64>>());
            if shared.borrow().failure.is_some() {
                break 'run Status::Failed;
            }
            if step > 0.0 {
                v.copy_from_slice(point);
                break step;
            }
            // 50 quarterings: nothing is left of the radius.
            progress.rejected += 1;
            if progress.rejected > 50 {
                break 'run Status::Stalled;
            }
        };
        let mut here = shared.borrow_mut();
        if here.gradient(v).is_err() {
            break Status::Stalled;
        }
        g.iter_mut().zip(here.gradient.iter().flatten()).for_each(|(g, new)| *g = *new);
        progress.advance(here.cost.as_cost(), &g, step, 0.0);
    };
    let mut shared = shared.borrow_mut();
    let failure = shared.failure.take();
    let status = match (status, &failure) {
        (Status::Stalled, _) if shared.calls > shared.limit => Status::MaxIterations,
        (Status::Stalled, Some(_)) => Status::Failed,
        (status, _) => status,
    };
    progress.here(shared.cost.as_cost(), v, &mut g)?;
    Ok(progress.end(status, failure, Vec::new()))
}

/// What both kinds of cost are.
trait AsCost {
    fn as_cost(&mut self) -> &mut dyn CostFunction;
}

impl AsCost for dyn CostFunction + '_ {
    fn as_cost(&mut self) -> &mut dyn CostFunction {
        self
    }
}

impl AsCost for dyn LeastSquares + '_ {
    fn as_cost(&mut self) -> &mut dyn CostFunction {
        self
    }
}

/// A cost, and what is known at the last point: argmin asks for values and gradients one by one.
struct Shared<'a, C: ?Sized> {
    cost: &'a mut C,
    v: Vec<f64>,
    value: f64,
    gradient: Option<Vec<f64>>,
    /// argmin sees J times this: 1 / ‖∇J‖ at the first point if that is above 1, so that its first
    /// step, along −∇J, is of length 1.
    scale: f64,
    calls: usize,
    limit: usize,
    failure: Option<Error>,
}

impl<C: AsCost + ?Sized> Shared<'_, C> {
    fn value(&mut self, v: &[f64]) -> Result<f64, core::Error> {
        if self.v != v {
            self.call(v, false)?;
        }
        Ok(self.scale * self.value)
    }

    fn gradient(&mut self, v: &[f64]) -> Result<Vec<f64>, core::Error> {
        if self.v != v || self.gradient.is_none() {
            self.call(v, true)?;
        }
        Ok(self.gradient.iter().flatten().map(|g| self.scale * g).collect())
    }

    fn call(&mut self, v: &[f64], with_gradient: bool) -> Result<(), core::Error> {
        self.count()?;
        let mut gradient = with_gradient.then(|| vec![0.0; v.len()]);
        let value = self.cost.as_cost().evaluate(v, gradient.as_deref_mut()).and_then(|value| {
            let fine = value.is_finite() && gradient.iter().flatten().all(|g| g.is_finite());
            if fine { Ok(value) } else { Err(Error::NonFinite { what: "the cost", step: 0 }) }
        });
        match value {
            Ok(value) => {
                self.v = v.to_vec();
                self.value = value;
                self.gradient = gradient;
                Ok(())
            }
            Err(error) => {
                self.failure = Some(error);
                Err(core::Error::msg("the cost cannot be evaluated"))
            }
        }
    }

    fn count(&mut self) -> Result<(), core::Error> {
        self.calls += 1;
        if self.calls > self.limit { Err(core::Error::msg("out of evaluations")) } else { Ok(()) }
    }
}

struct Adapter<'a, C: ?Sized>(Rc<RefCell<Shared<'a, C>>>);

impl<C: AsCost + ?Sized> core::CostFunction for Adapter<'_, C> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, v: &Vec<f64>) -> Result<f64, core::Error> {
        self.0.borrow_mut().value(v)
    }
}

impl<C: AsCost + ?Sized> core::Gradient for Adapter<'_, C> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, v: &Vec<f64>) -> Result<Vec<f64>, core::Error> {
        self.0.borrow_mut().gradient(v)
    }
}

impl<'a, 'b> core::Hessian for Adapter<'a, dyn LeastSquares + 'b> {
    type Param = Vec<f64>;
    type Hessian = Hessian<'a, 'b>;

    /// Called after the gradient of the same point, around which the products then are.
    fn hessian(&self, v: &Vec<f64>) -> Result<Self::Hessian, core::Error> {
        self.0.borrow_mut().gradient(v)?;
        Ok(Hessian { shared: Rc::clone(&self.0) })
    }
}

/// Products with A around the point of the last gradient.
struct Hessian<'a, 'b> {
    shared: Rc<RefCell<Shared<'a, dyn LeastSquares + 'b>>>,
}

impl Clone for Hessian<'_, '_> {
    fn clone(&self) -> Self {
        Self { shared: Rc::clone(&self.shared) }
    }
}

impl ArgminDot<Vec<f64>, Vec<f64>> for Hessian<'_, '_> {
    fn dot(&self, dv: &Vec<f64>) -> Vec<f64> {
        let mut shared = self.shared.borrow_mut();
        let mut out = vec![0.0; dv.len()];
        // No way to fail here: zero curvature sends Steihaug to the boundary and out of its loop, where a NaN
        // would keep it forever.
        if shared.count().is_err() {
            return out;
        }
        let product = shared.cost.hessian_apply(dv, &mut out);
        if product.is_err() || !out.iter().all(|x| x.is_finite()) {
            shared.failure =
                product.err().or(Some(Error::NonFinite { what: "a product with the Hessian", step: 0 }));
            out.fill(0.0);
        }
        out.iter_mut().for_each(|x| *x *= shared.scale);
        out
    }
}
