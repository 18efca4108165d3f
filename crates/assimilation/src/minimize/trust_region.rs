//! The default minimizer: a trust region in the control space, on the true J.

use super::hessian::Hessian;
use super::method::{Method, method};
use super::minimum::{Iteration, Minimum, Progress, Start, forcing};
use super::secant::Secant;
use super::spectral::Spectral;
use super::stopping::{NOISE, Status, Stopping, at_least_one, setters};
use crate::cost::norm;
use crate::{Error, LeastSquares};
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use std::ops::ControlFlow;
use varda_linalg::krylov::{Lanczos, LanczosLimits};

/// A convex J that rises along a step rises at half of it by half as much at most: more than this share of
/// the rise before is a jump.
const JUMP: f64 = 0.75;
/// So is, where ‖∇J‖ has fallen to 10⁻³ of the first and the model holds, a rise of this many times
/// the predicted decrease.
const FAR_OFF: f64 = 10.0;
/// A first step whose decrease is the predicted one to this share shows J to be quadratic: the whole step is
/// tried.
const QUADRATIC: f64 = 1e-6;
/// A rise below this share of J is no jump.
const RESOLVED: f64 = 1e-9;
/// Steps in a row that J does not show and that do not halve the gradient: it is at its own rounding.
const MOST_UNSEEN: usize = 8;

/// Settings of [`trust_region`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct TrustRegionOptions {
    /// When it ends.
    pub stopping: Stopping,
    /// First radius, in standard deviations of the prior (the norm of v is the B⁻¹ norm).
    pub initial_radius: f64,
    /// Problems up to this size use the dense Hessian, larger ones Lanczos iterations.
    pub dense_limit: usize,
    /// Lanczos iterations of one outer iteration at most: products with the Hessian, and vectors kept.
    pub max_inner: usize,
    /// Rank-one terms kept of the learnt second-order part; 0 leaves plain Gauss–Newton.
    pub secant_terms: usize,
    /// Maximum number of perturbed retries after a step is rejected at a discontinuity of J; 0 disables them.
    pub jump_retries: usize,
    /// Which second derivatives the quadratic model has.
    pub hessian: Hessian,
}

impl Default for TrustRegionOptions {
    fn default() -> Self {
        Self {
            stopping: Stopping::within(200),
            initial_radius: 1.0,
            dense_limit: 100,
            max_inner: 100,
            secant_terms: 60,
            jump_retries: 0,
            hessian: Hessian::GaussNewton,
        }
    }
}

setters!(TrustRegionOptions, stopping, {
    with_initial_radius: initial_radius: f64,
    with_dense_limit: dense_limit: usize,
    with_max_inner: max_inner: usize,
    with_secant_terms: secant_terms: usize,
    with_jump_retries: jump_retries: usize,
    with_hessian: hessian: Hessian,
});

/// Levenberg–Marquardt in trust-region form:
///
/// ```text
///     p = argmin  ∇Jᵀp + ½ pᵀ(A + S)p    over    ‖p‖ ≤ Δ    ⇔
///     (A + S + λI) p = −∇J,   λ ≥ 0
/// ```
///
/// with A the Gauss–Newton Hessian and S what symmetric rank-one updates have learnt of the second
/// derivatives it drops, used only while it predicts gradients better than A alone. ‖p‖ is the B⁻¹
/// norm of the increment; the first radius is one prior standard deviation.
///
/// A step is taken when the true J falls by 10⁻⁴ of the predicted decrease. A model failure at a trial
/// point is J = ∞: refused, and the radius shrinks. Where the predicted decrease is below what J resolves
/// (10⁻¹¹ J), a step is taken when it lowers ‖∇J‖; where no such step exists the run has
/// converged to rounding if the whole step of the model promises no more either, else it has stalled.
///
/// **A linear problem** takes one iteration: where the first decrease is that of the model to 10⁻⁶, J is
/// quadratic, and the whole step is tried at once, whatever the radius.
///
/// **Exact Hessian.** With [`Hessian::Exact`] the model has ∇²J in place of A + S once that predicted the
/// change of the gradient over the last step better than A, and the end is quadratic. It may be indefinite:
/// the step is then the one of least model value on the sphere ‖p‖ = Δ. The price is one product with
/// each an iteration to choose by, and what the second-order adjoint builds at every point where it is asked
/// for (docs/results/hessian.md).
///
/// **Jumps of J.** An implicit step from a wild state may have several solutions, and which one is found may
/// change from one point to the next without pattern: J then jumps between smooth sheets. Where
/// `jump_retries` is not 0, a step refused by a jump (a rise that does not shrink with the step, or late in
/// the run one ten times the predicted decrease) is followed by that many others, each the step for a
/// gradient changed at random by 40, 10, 2.5 and 0.6 per cent of its norm (a fixed seed), until one falls on
/// the lower sheet.
///
/// J never rises by more than its rounding. The minimum found is the one whose basin the path leads into; for
/// costs with several see [`continuation`](crate::continuation).
///
/// When to use: the default. When not: no tangent model ([`lbfgs`](crate::lbfgs)); several minima
/// ([`auto`](crate::auto), [`window_growth`](crate::window_growth)).
///
/// Cost of an outer iteration: one gradient, one forward run for each refused trial point, and n tangent
/// sweeps with an eigenvalue decomposition (n ≤ `dense_limit`), or about as many products as there are
/// degrees of freedom for signal. Memory: 3n² or so, or a vector for each inner iteration; and one for each
/// secant term.
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
/// let options = TrustRegionOptions::default();
/// let minimum = trust_region(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn trust_region(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &TrustRegionOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    options.run(cost, v, &Start::default(), on_iteration)
}

method!(TrustRegionOptions, stopping, Products, run);

pub(super) fn run(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &TrustRegionOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    options.stopping.check()?;
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
    let exact = options.hessian == Hessian::Exact;
    if exact && !cost.has_exact_hessian() {
        return Err(Error::NoSecondDerivatives);
    }
    let mut secant = Secant::new(if exact { 0 } else { options.secant_terms });
    // which Hessian the next step is made with
    let mut hessian = Hessian::GaussNewton;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut ritz = Vec::new();
    let mut failure = None;
    let mut progress = Progress::start(cost, v, &mut g, start)?;
    let mut first = progress.index == 0;
    // steps in a row whose decrease J does not show, and the gradient that they have to halve
    let (mut unseen, mut to_halve) = (0, f64::INFINITY);
    loop {
        if let Some(status) = progress.report(cost, v, &g, &options.stopping, on_iteration) {
            return Ok(progress.end(status, None, ritz));
        }
        if unseen == MOST_UNSEEN {
            let (now, first) = (progress.gradient_norm, progress.gradient_norm_first);
            let status = Status::without_step(0.0, progress.value, now, first);
            return Ok(progress.end(status, None, ritz));
        }
        if progress.step_norm > 0.0 && exact {
            hessian = better(cost, &p, &g, &g_trial)?;
        }
        inner.refresh(cost, hessian)?;
        if progress.step_norm > 0.0 && options.secant_terms > 0 && !exact {
            // p and g_trial hold the last step and, after the swap, the gradient before it.
            let mut dropped = vec![0.0; n];
            inner.gauss_newton(cost, &p, &mut dropped)?;
            for i in 0..n {
                dropped[i] = g[i] - g_trial[i] - dropped[i];
            }
            secant.update(&p, &dropped);
        }
        let mut spectral = inner.model(
            cost,
            (hessian, &secant),
            &g,
            solved_to(&progress, hessian),
            radius,
            &mut progress.inner,
        )?;
        progress.inner_total += progress.inner;
        progress.rejected = 0;

        let widest = radius;
        let mut rise = f64::INFINITY;
        // steps tried beside the one refused
        let mut beside = 0;
        loop {
            let step = if beside == 0 {
                spectral.step(radius, &mut p)
            } else {
                let share = 0.4 * 0.25f64.powi((beside % 4) as i32);
                let length = widest * 0.5f64.powi((beside / 8) as i32);
                spectral.perturbed_step(share, &mut rng, length, &mut p)
            };
            trial.iter_mut().zip(v.iter().zip(&p)).for_each(|(t, (v, p))| *t = v + p);
            let by_gradient = step.decrease <= NOISE * progress.value;
            let value = match cost.evaluate(&trial, by_gradient.then_some(&mut g_trial[..])) {
                Ok(value) => value,
                Err(error) => {
                    failure = Some(error);
                    f64::INFINITY
                }
            };
            let ratio = if !by_gradient || !value.is_finite() {
                (progress.value - value) / step.decrease
            } else if norm(&g_trial) < progress.gradient_norm {
                1.0
            } else {
                -1.0
            };
            let is_part = step.damping > 0.0 || matches!(inner, Inner::Krylov { .. });
            if first && is_part && !by_gradient && (ratio - 1.0).abs() <= QUADRATIC {
                (first, radius) = (false, f64::INFINITY);
                if matches!(inner, Inner::Krylov { .. }) {
                    // as far as a minimum is asked for
                    let residual = 0.1 * options.stopping.gradient_tolerance;
                    let mut more = 0;
                    spectral = inner.model(cost, (hessian, &secant), &g, residual, radius, &mut more)?;
                    progress.inner += more;
                    progress.inner_total += more;
                }
                continue;
            }
            if ratio > 1e-4 {
                match cost.evaluate(&trial, Some(&mut g_trial)) {
                    Ok(_) => {
                        if ratio < 0.25 {
                            radius = 0.5 * step.norm;
                        } else if ratio > 0.75 {
                            radius = radius.max(3.0 * step.norm);
                        }
                        let as_predicted = by_gradient || (ratio - 1.0).abs() <= QUADRATIC;
                        let from_first = progress.index == 0 || progress.quadratic;
                        progress.quadratic = from_first && as_predicted;
                        v.copy_from_slice(&trial);
                        std::mem::swap(&mut g, &mut g_trial);
                        progress.advance(cost, &g, step.norm, step.damping);
                        progress.hessian = Some(hessian);
                        let halved = progress.gradient_norm <= 0.5 * to_halve;
                        if !by_gradient || halved {
                            (unseen, to_halve) = (0, progress.gradient_norm);
                        } else {
                            unseen += 1;
                        }
                        break;
                    }
                    Err(error) => failure = Some(error),
                }
            }
            progress.rejected += 1;
            cost.evaluate(v, Some(&mut g))?;
            let last_rise = std::mem::replace(&mut rise, value - progress.value);
            let late = progress.gradient_norm <= 1e-3 * progress.gradient_norm_first;
            let jump = rise.is_finite()
                && (rise > JUMP * last_rise || (last_rise == f64::INFINITY && late && ratio < -FAR_OFF))
                && rise > RESOLVED * progress.value;
            if beside == 0 {
                radius =
                    step.norm * if ratio.is_finite() { (0.5 / (1.0 - ratio)).clamp(0.1, 0.5) } else { 0.25 };
            }
            beside = if (jump || beside > 0) && beside < options.jump_retries { beside + 1 } else { 0 };
            if beside > 0 {
                continue;
            }
            if !(radius > 1e-13 * (1.0 + norm(v)))
                || (by_gradient && progress.rejected >= 8 + options.jump_retries)
            {
                let promised = spectral.step(f64::INFINITY, &mut p).decrease;
                let (now, first) = (progress.gradient_norm, progress.gradient_norm_first);
                let status = Status::without_step(promised, progress.value, now, first);
                let failure = failure.filter(|_| status == Status::Stalled);
                return Ok(progress.end(status, failure, ritz));
            }
            if secant.trusted() {
                secant.distrust();
                let mut more = 0;
                spectral = inner.model(
                    cost,
                    (hessian, &secant),
                    &g,
                    solved_to(&progress, hessian),
                    radius,
                    &mut more,
                )?;
                progress.inner += more;
                progress.inner_total += more;
            }
        }
        first = false;
        ritz = spectral.pairs();
    }
}

/// How far the inner problem is solved, relative to its gradient: with the exact Hessian so far that the end
/// is quadratic.
fn solved_to(progress: &Progress, hessian: Hessian) -> f64 {
    let superlinear = forcing(progress);
    if hessian == Hessian::Exact { superlinear.min(superlinear * superlinear).min(0.1) } else { superlinear }
}

/// The Hessian that predicts better how the gradient changed over the last step p, from `before` to g: both
/// at the point of g.
fn better(cost: &mut dyn LeastSquares, p: &[f64], g: &[f64], before: &[f64]) -> Result<Hessian, Error> {
    let mut product = vec![0.0; p.len()];
    let missed = |product: &[f64]| {
        let differences = g.iter().zip(before).zip(product).map(|((g, b), hp)| g - b - hp);
        differences.fold(0.0, |sum, d| sum + d * d)
    };
    cost.hessian_apply(p, &mut product)?;
    let by_gauss_newton = missed(&product);
    cost.exact_hessian_apply(p, &mut product)?;
    Ok(if missed(&product) < by_gauss_newton { Hessian::Exact } else { Hessian::GaussNewton })
}

/// Where the quadratic model comes from.
enum Inner {
    /// A and A + S, by columns.
    Dense { hessian: Vec<f64>, sum: Vec<f64> },
    /// Products with A.
    Krylov { lanczos: Lanczos, iterations: usize },
}

impl Inner {
    /// Fetches the Hessian at the point of the last gradient.
    fn refresh(&mut self, cost: &mut dyn LeastSquares, which: Hessian) -> Result<(), Error> {
        match (self, which) {
            (Self::Dense { hessian, .. }, Hessian::GaussNewton) => cost.hessian(hessian),
            (Self::Dense { hessian, .. }, Hessian::Exact) => cost.exact_hessian(hessian),
            (Self::Krylov { .. }, _) => Ok(()),
        }
    }

    /// out = A p.
    fn gauss_newton(&self, cost: &mut dyn LeastSquares, p: &[f64], out: &mut [f64]) -> Result<(), Error> {
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
        cost: &mut dyn LeastSquares,
        (which, secant): (Hessian, &Secant),
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
                    match which {
                        Hessian::GaussNewton => cost.hessian_apply(p, out)?,
                        Hessian::Exact => cost.exact_hessian_apply(p, out)?,
                    }
                    if secant.trusted() {
                        secant.apply_add(p, out);
                    }
                    Ok::<(), Error>(())
                };
                let limits = LanczosLimits { residual, radius, iterations: *iterations };
                lanczos.run(&mut product, g, &limits)?;
                *inner_iterations = lanczos.iterations();
                Ok(Spectral::of(lanczos.ritz()?, g))
            }
        }
    }
}
