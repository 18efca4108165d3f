//! Limited-memory BFGS: for costs that have a gradient and nothing else.

use super::inverse_hessian::InverseHessian;
use super::minimum::{Iteration, Minimum, Progress, Start, Status, at_least_one, check_tolerance};
use super::trust_region::NOISE;
use crate::cost::{dot, norm};
use crate::{CostFunction, Error};
use std::ops::ControlFlow;

/// Settings of [`lbfgs`].
#[derive(Debug, Clone, PartialEq)]
pub struct LbfgsOptions {
    /// Converged when ‖∇J‖ has fallen to this part of the first.
    pub gradient_tolerance: f64,
    /// Iterations at most.
    pub max_iterations: usize,
    /// Pairs kept. As many as there are degrees of freedom for signal suffice.
    pub memory: usize,
}

impl Default for LbfgsOptions {
    fn default() -> Self {
        Self { gradient_tolerance: 1e-8, max_iterations: 1000, memory: 30 }
    }
}

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
    run(cost, v, options, &Start::default(), on_iteration)
}

pub(super) fn run(
    cost: &mut dyn CostFunction,
    v: &mut [f64],
    options: &LbfgsOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    check_tolerance("gradient_tolerance", options.gradient_tolerance)?;
    at_least_one("memory", options.memory)?;
    let n = cost.dim();
    let [mut g, mut p] = std::array::from_fn(|_| vec![0.0; n]);
    let mut search = Search { trial: vec![0.0; n], gradient: vec![0.0; n], refused: 0, failure: None };
    let mut memory = InverseHessian::new(n, options.memory);
    let mut progress = Progress::start(cost, v, &mut g, start)?;
    let last = start.index + options.max_iterations;
    let (status, failure) = loop {
        if let Some(status) = progress.report(cost, v, &g, options.gradient_tolerance, last, on_iteration) {
            break (status, None);
        }
        search.refused = 0;
        memory.direction(&g, &mut p);
        let mut found = search.run(cost, v, &p, progress.value, dot(&g, &p), memory.first_step(&g))?;
        if found.is_none() && memory.pairs() > 0 {
            memory.clear();
            memory.direction(&g, &mut p);
            found = search.run(cost, v, &p, progress.value, dot(&g, &p), memory.first_step(&g))?;
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

/// A line search and what it leaves behind: the point taken and its gradient.
struct Search {
    trial: Vec<f64>,
    gradient: Vec<f64>,
    refused: usize,
    failure: Option<Error>,
}

/// φ(α) = J(v + αp) and its slope.
#[derive(Clone, Copy)]
struct Sample {
    length: f64,
    value: f64,
    slope: f64,
}

/// φ(α) ≤ φ(0) + 10⁻⁴ α φ'(0).
const DECREASE: f64 = 1e-4;
/// |φ'(α)| ≤ 0.9 |φ'(0)|.
const CURVATURE: f64 = 0.9;

impl Search {
    /// A length that satisfies the strong Wolfe conditions, or at least lowers J.
    ///
    /// The bracket [low, high] always has a solution in it: low has decreased J enough and still falls
    /// steeply, high has not, or rises, or cannot be evaluated.
    fn run(
        &mut self,
        cost: &mut dyn CostFunction,
        v: &[f64],
        p: &[f64],
        value: f64,
        slope: f64,
        first: f64,
    ) -> Result<Option<f64>, Error> {
        if !(slope < 0.0) {
            return Ok(None);
        }
        let noise = NOISE * value.abs();
        let mut low = Sample { length: 0.0, value, slope };
        let mut high: Option<(f64, Option<Sample>)> = None;
        let mut length = first;
        // The bracket halves at least every third trial: 60 reach 1e-6 of it and more than 1e18 beyond it.
        for trial in 0..60 {
            match self.sample(cost, v, p, length) {
                Err(error) => {
                    self.failure = Some(error);
                    high = Some((length, None));
                }
                Ok(here) => {
                    let lower = here.value <= value + DECREASE * length * slope
                        || (here.value <= value + noise && here.slope <= -(1.0 - 2.0 * DECREASE) * slope);
                    if lower && here.slope.abs() <= -CURVATURE * slope {
                        return Ok(Some(length));
                    }
                    if lower && here.slope < 0.0 {
                        low = here;
                    } else {
                        high = Some((length, Some(here)));
                    }
                }
            }
            self.refused += 1;
            length = match high {
                // Where the slope vanishes if it goes on as it does.
                None => (length * slope / (slope - low.slope)).clamp(2.0 * length, 10.0 * length),
                Some((end, None)) => low.length + 0.25 * (end - low.length),
                Some((end, Some(_))) if trial % 3 == 2 => 0.5 * (low.length + end),
                Some((_, Some(end))) => between(&low, &end, noise),
            };
            if let Some((end, _)) = high
                && !(end - low.length > 1e-12 * end)
            {
                break;
            }
        }
        // A step that is rounding of v is none.
        if low.length * norm(p) > 1e-12 * (1.0 + norm(v)) && self.sample(cost, v, p, low.length).is_ok() {
            return Ok(Some(low.length));
        }
        Ok(None)
    }

    fn sample(
        &mut self,
        cost: &mut dyn CostFunction,
        v: &[f64],
        p: &[f64],
        length: f64,
    ) -> Result<Sample, Error> {
        self.trial.iter_mut().zip(v.iter().zip(p)).for_each(|(t, (v, p))| *t = v + length * p);
        let value = cost.evaluate(&self.trial, Some(&mut self.gradient))?;
        Ok(Sample { length, value, slope: dot(&self.gradient, p) })
    }
}

/// The minimizer of the cubic through both ends (of the parabola through the slopes where the values are
/// rounding), kept away from them.
fn between(low: &Sample, high: &Sample, noise: f64) -> f64 {
    let width = high.length - low.length;
    let share = if (high.value - low.value).abs() <= noise {
        -low.slope / (high.slope - low.slope)
    } else {
        let d1 = low.slope + high.slope - 3.0 * (high.value - low.value) / width;
        let d2 = (d1 * d1 - low.slope * high.slope).max(0.0).sqrt();
        1.0 - (high.slope + d2 - d1) / (high.slope - low.slope + 2.0 * d2)
    };
    low.length + width * if share.is_finite() { share.clamp(0.1, 0.9) } else { 0.5 }
}
