//! The default minimizer: a trust region in the control space, on the true J.

use super::lanczos::{Lanczos, Limits};
use super::secant::Secant;
use super::spectral::Spectral;
use super::{Iteration, Minimum, Progress, RitzPair, Start, Status, at_least_one, check_tolerance, forcing};
use crate::cost::norm;
use crate::{Error, GaussNewton};
use std::ops::ControlFlow;

/// A predicted decrease below this part of J cannot be seen in J (its trajectory is only as exact as the model's solver);
/// steps are then judged by the gradient.
pub(super) const NOISE: f64 = 1e-11;

/// Settings of [`trust_region`].
#[derive(Debug, Clone, PartialEq)]
pub struct TrustRegionOptions {
    /// Converged when ‖∇J‖ has fallen to this part of the first.
    pub gradient_tolerance: f64,
    /// Outer iterations at most.
    pub max_iterations: usize,
    /// First radius, in standard deviations of the prior (the norm of v is the B⁻¹ norm).
    pub initial_radius: f64,
    /// Problems up to this size use the dense Hessian, larger ones Lanczos iterations.
    pub dense_limit: usize,
    /// Lanczos iterations of one outer iteration at most: products with the Hessian, and vectors kept.
    pub max_inner: usize,
    /// Rank-one terms kept of the learnt second-order part; 0 leaves plain Gauss–Newton.
    pub secant_terms: usize,
}

impl Default for TrustRegionOptions {
    fn default() -> Self {
        Self {
            gradient_tolerance: 1e-8,
            max_iterations: 200,
            initial_radius: 1.0,
            dense_limit: 300,
            max_inner: 100,
            secant_terms: 60,
        }
    }
}

/// Levenberg–Marquardt in trust-region form:
///
/// ```text
///     p = argmin  ∇Jᵀp + ½ pᵀ(A + S)p    over    ‖p‖ ≤ Δ        ⇔        (A + S + λI) p = −∇J,   λ ≥ 0
/// ```
///
/// with A the Gauss–Newton Hessian and S what symmetric rank-one updates have learnt of the second derivatives it drops, used
/// only while it predicts gradients better than A alone. ‖p‖ is the B⁻¹ norm of the increment; the first radius is one prior
/// standard deviation.
///
/// A step is taken when the true J falls by 10⁻⁴ of the predicted decrease. A model failure at a trial point is J = ∞: refused, and
/// the radius shrinks. Where the predicted decrease is below what J resolves (10⁻¹¹ J), a step is taken when it lowers ‖∇J‖; where
/// no such step exists the run has stalled at the accuracy of the model, and says so.
///
/// J never rises by more than its rounding. The minimum found is the one whose basin the path leads into; for costs
/// with several see [`continuation`](crate::continuation).
///
/// When to use: the default. When not: no tangent model ([`lbfgs`](crate::lbfgs)); several minima ([`auto`](crate::auto),
/// [`window_growth`](crate::window_growth)).
///
/// Cost of an outer iteration: one gradient, one forward run for each refused trial point, and n tangent sweeps with an eigenvalue
/// decomposition (n ≤ `dense_limit`), or about as many products as there are degrees of freedom for signal. Memory: 3n² or so, or a vector
/// for each inner iteration; and one for each secant term.
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn trust_region(
    cost: &mut dyn GaussNewton,
    v: &mut [f64],
    options: &TrustRegionOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    run(cost, v, options, &Start::default(), on_iteration)
}

pub(super) fn run(
    cost: &mut dyn GaussNewton,
    v: &mut [f64],
    options: &TrustRegionOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    check_tolerance("gradient_tolerance", options.gradient_tolerance)?;
    let mut radius = options.initial_radius;
    if !(radius > 0.0 && radius.is_finite()) {
        return Err(Error::Setting { what: "initial_radius", value: radius });
    }
    at_least_one("max_inner", options.max_inner)?;
    let n = cost.dim();
    let [mut g, mut g_trial, mut p, mut trial] = std::array::from_fn(|_| vec![0.0; n]);
    let mut inner = if n <= options.dense_limit {
        Inner::Dense { hessian: vec![0.0; n * n], sum: vec![0.0; n * n] }
    } else {
        Inner::Krylov { lanczos: Lanczos::new(n), iterations: options.max_inner }
    };
    let mut secant = Secant::new(options.secant_terms);
    let mut ritz = Vec::new();
    let mut failure = None;
    let mut progress = Progress::start(cost, v, &mut g, start)?;
    let last = start.index + options.max_iterations;
    loop {
        if let Some(status) = progress.report(cost, v, &g, options.gradient_tolerance, last, on_iteration) {
            return Ok(progress.end(status, None, ritz));
        }
        inner.refresh(cost)?;
        if progress.step_norm > 0.0 && options.secant_terms > 0 {
            // p and g_trial hold the last step and, after the swap, the gradient before it.
            let mut dropped = vec![0.0; n];
            inner.gauss_newton(cost, &p, &mut dropped)?;
            for i in 0..n {
                dropped[i] = g[i] - g_trial[i] - dropped[i];
            }
            secant.update(&p, &dropped);
        }
        let mut spectral = inner.model(cost, &secant, &g, forcing(&progress), radius, &mut progress.inner)?;
        progress.inner_total += progress.inner;
        progress.rejected = 0;

        loop {
            let step = spectral.step(radius, &mut p);
            trial.iter_mut().zip(v.iter().zip(&p)).for_each(|(t, (v, p))| *t = v + p);
            let by_gradient = step.decrease <= NOISE * progress.value;
            let ratio = match cost.evaluate(&trial, by_gradient.then_some(&mut g_trial[..])) {
                Ok(_) if by_gradient => {
                    if norm(&g_trial) < progress.gradient_norm {
                        1.0
                    } else {
                        -1.0
                    }
                }
                Ok(value) => (progress.value - value) / step.decrease,
                Err(error) => {
                    failure = Some(error);
                    f64::NEG_INFINITY
                }
            };
            if ratio > 1e-4 {
                match cost.evaluate(&trial, Some(&mut g_trial)) {
                    Ok(_) => {
                        if ratio < 0.25 {
                            radius = 0.5 * step.norm;
                        } else if ratio > 0.75 {
                            radius = radius.max(3.0 * step.norm);
                        }
                        v.copy_from_slice(&trial);
                        std::mem::swap(&mut g, &mut g_trial);
                        progress.advance(cost, &g, step.norm, step.damping);
                        break;
                    }
                    Err(error) => failure = Some(error),
                }
            }
            progress.rejected += 1;
            radius = step.norm * if ratio.is_finite() { (0.5 / (1.0 - ratio)).clamp(0.1, 0.5) } else { 0.25 };
            cost.evaluate(v, Some(&mut g))?;
            if !(radius > 1e-13 * (1.0 + norm(v))) || (by_gradient && progress.rejected >= 8) {
                return Ok(progress.end(Status::Stalled, failure, ritz));
            }
            if secant.trusted() {
                secant.distrust();
                let mut more = 0;
                spectral = inner.model(cost, &secant, &g, forcing(&progress), radius, &mut more)?;
                progress.inner += more;
                progress.inner_total += more;
            }
        }
        ritz = inner.ritz(&spectral)?;
    }
}

/// Where the quadratic model comes from.
enum Inner {
    /// A and A + S, by columns.
    Dense { hessian: Vec<f64>, sum: Vec<f64> },
    /// Products with A.
    Krylov { lanczos: Lanczos, iterations: usize },
}

impl Inner {
    /// Fetches A at the point of the last gradient.
    fn refresh(&mut self, cost: &mut dyn GaussNewton) -> Result<(), Error> {
        match self {
            Self::Dense { hessian, .. } => cost.hessian(hessian),
            Self::Krylov { .. } => Ok(()),
        }
    }

    /// out = A p.
    fn gauss_newton(&self, cost: &mut dyn GaussNewton, p: &[f64], out: &mut [f64]) -> Result<(), Error> {
        match self {
            Self::Dense { hessian, .. } => {
                out.fill(0.0);
                for (column, p) in hessian.chunks_exact(p.len()).zip(p) {
                    out.iter_mut().zip(column).for_each(|(out, a)| *out += a * p);
                }
                Ok(())
            }
            Self::Krylov { .. } => cost.hessian_apply(p, out),
        }
    }

    /// The quadratic model at the point of the last gradient g, with S where it is trusted.
    fn model(
        &mut self,
        cost: &mut dyn GaussNewton,
        secant: &Secant,
        g: &[f64],
        residual: f64,
        radius: f64,
        inner_iterations: &mut usize,
    ) -> Result<Spectral, Error> {
        match self {
            Self::Dense { hessian, sum } => {
                sum.copy_from_slice(hessian);
                if secant.trusted() {
                    secant.matrix_add(sum);
                }
                Spectral::dense(sum, g)
            }
            Self::Krylov { lanczos, iterations } => {
                let mut product = |p: &[f64], out: &mut [f64]| {
                    cost.hessian_apply(p, out)?;
                    if secant.trusted() {
                        secant.apply_add(p, out);
                    }
                    Ok(())
                };
                let spectral =
                    lanczos.run(&mut product, g, &Limits { residual, radius, iterations: *iterations })?;
                *inner_iterations = lanczos.iterations();
                Ok(spectral)
            }
        }
    }

    fn ritz(&self, spectral: &Spectral) -> Result<Vec<RitzPair>, Error> {
        match self {
            Self::Dense { .. } => Ok(Vec::new()),
            Self::Krylov { lanczos, .. } => lanczos.ritz(spectral),
        }
    }
}
