//! Limited-memory BFGS: for costs that have a gradient and nothing else.

use super::inverse_hessian::InverseHessian;
use super::line_search::{Conditions, LineSearch, Ray};
use super::method::method;
use super::minimum::{Iteration, Minimum, Progress, Start};
use super::stationary::run_from;
use super::stopping::{Status, Stopping, at_least_one, setters};
use crate::cost::{dot, norm};
use crate::{CostFunction, Error};
use std::ops::ControlFlow;

/// Settings of [`lbfgs`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LbfgsOptions {
    /// When it ends.
    pub stopping: Stopping,
    /// Pairs kept. As many as there are degrees of freedom for signal suffice.
    pub memory: usize,
}

impl Default for LbfgsOptions {
    fn default() -> Self {
        Self { stopping: Stopping::within(1000), memory: 30 }
    }
}

setters!(LbfgsOptions, stopping, {
    with_memory: memory: usize,
});

/// Limited-memory BFGS (Liu and Nocedal 1989; Nocedal and Wright 2006, Algorithms 7.4 and 7.5):
///
/// ```text
///     v ← v − α H ∇J,    H ← (I − ρ s yᵀ) H (I − ρ y sᵀ) + ρ s sᵀ,
///     s = Δv,  y = Δ∇J,  ρ = 1 / sᵀy
/// ```
///
/// H is rebuilt from the last pairs and γI, γ = sᵀy / yᵀy. α satisfies the strong Wolfe conditions
/// with c₁ = 10⁻⁴ and c₂ = 0.9, every trial giving value and gradient at once; where a decrease is
/// too small to be seen in J (10⁻¹¹ J) the slopes decide (Hager and Zhang 2005, approximate Wolfe). A
/// model failure at a trial is J = ∞: the step shrinks. A pair is stored where sᵀy > 10⁻⁸
/// ‖s‖‖y‖, so that H stays positive definite where J is not convex (a step cut short by a failing
/// model may show negative curvature).
///
/// When to use: where there is no tangent model, or one gradient is all that fits. When not: where products
/// with the Hessian can be had, [`newton_cg`](crate::newton_cg) and [`trust_region`](crate::trust_region)
/// need fewer sweeps.
///
/// Cost of an iteration: one forward run and one adjoint sweep, rarely more. Memory: 2 `memory` + 5 vectors.
/// Leaves the pairs in [`Minimum::inverse_hessian`].
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
/// let minimum = lbfgs(&mut cost, &mut v, &LbfgsOptions::default(), &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn lbfgs(
    cost: &mut dyn CostFunction,
    v: &mut [f64],
    options: &LbfgsOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    run_from(cost, v, &Start::default(), on_iteration, &mut |cost, v, start, tell| {
        run(cost, v, options, start, tell)
    })
}

method!(LbfgsOptions, stopping, Gradients, run);

fn run(
    cost: &mut dyn CostFunction,
    v: &mut [f64],
    options: &LbfgsOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    options.stopping.check()?;
    at_least_one("memory", options.memory)?;
    let n = cost.dim();
    let [mut g, mut p] = std::array::from_fn(|_| vec![0.0; n]);
    let mut search = LineSearch::new(n);
    let mut memory = InverseHessian::new(n, options.memory);
    let mut progress = Progress::start(cost, v, &mut g, start)?;
    let (status, failure) = loop {
        if let Some(status) = progress.report(cost, v, &g, &options.stopping, on_iteration) {
            break (status, None);
        }
        search.refused = 0;
        let mut found = None;
        // From the identity once more where what was learnt leads nowhere.
        for attempt in 0..2 {
            if attempt == 1 {
                if found.is_some() || memory.pairs() == 0 {
                    break;
                }
                memory.clear();
            }
            memory.direction(&g, &mut p);
            let ray = Ray {
                v,
                direction: &p,
                value: progress.value,
                slope: dot(&g, &p),
                gradient_norm: progress.gradient_norm,
                first: memory.first_step(&g),
            };
            found = search.run(Conditions::Wolfe, &mut |v, g| cost.evaluate(v, g), &ray);
        }
        let Some(length) = found else {
            // The point of the last gradient is the one returned.
            cost.evaluate(v, Some(&mut g))?;
            break (Status::Stalled, search.failure.take());
        };
        p.iter_mut().for_each(|p| *p *= length);
        let change: Vec<f64> = search.gradient.iter().zip(&g).map(|(new, old)| new - old).collect();
        memory.store(&p, &change);
        v.copy_from_slice(&search.trial);
        std::mem::swap(&mut g, &mut search.gradient);
        progress.rejected = search.refused;
        progress.advance(cost, &g, norm(&p), 0.0);
    };
    Ok(Minimum { inverse_hessian: Some(memory), ..progress.end(status, failure, Vec::new()) })
}
