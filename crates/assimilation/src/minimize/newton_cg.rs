//! Gauss–Newton with truncated conjugate gradients and a line search.

use super::line_search::{Conditions, LineSearch, Ray};
use super::method::{Method, method};
use super::minimum::{Iteration, Minimum, Progress, Start, forcing};
use super::preconditioner::Preconditioner;
use super::spectral::Spectral;
use super::stopping::{Status, Stopping, at_least_one, setters};
use crate::cost::{dot, norm};
use crate::{Error, LeastSquares};
use std::ops::ControlFlow;
use varda_linalg::krylov::{Lanczos, LanczosLimits};

/// Settings of [`newton_cg`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct NewtonCgOptions {
    /// When it ends.
    pub stopping: Stopping,
    /// Inner iterations of one outer iteration at most: products with the Hessian, and vectors kept.
    pub max_inner: usize,
    /// Ritz pairs kept as a preconditioner of the outer iterations that follow; 0 for none.
    pub preconditioner_pairs: usize,
}

impl Default for NewtonCgOptions {
    fn default() -> Self {
        Self { stopping: Stopping::within(100), max_inner: 100, preconditioner_pairs: 0 }
    }
}

setters!(NewtonCgOptions, stopping, {
    with_max_inner: max_inner: usize,
    with_preconditioner_pairs: preconditioner_pairs: usize,
});

/// Gauss–Newton with truncated conjugate gradients: A p = −∇J solved to min(½,
/// √(‖∇J‖/‖∇J₀‖)) of its right-hand side by Lanczos iteration with full re-orthogonalisation,
/// then steps of 1, ½, ¼, … until J falls by 10⁻⁴ of what the slope promises.
///
/// With `preconditioner_pairs`, every outer iteration is preconditioned by the Ritz pairs of those before it
/// (limited-memory preconditioner in its spectral form: Fisher 1998; Tshimanga et al. 2008): a third fewer
/// inner iterations on case 1 of the hanging rod, where outer ones go on near the minimum; it gains nothing
/// where few suffice. Without it the Ritz pairs of the last outer iteration are returned (with it they are
/// those of the preconditioned matrix, and are not).
///
/// When to use: large n and small residuals; a J with jumps, which hold a trust region. When not: where the
/// dropped second derivatives matter it converges linearly, and [`trust_region`](crate::trust_region) is
/// faster.
///
/// Cost of an outer iteration: one gradient, a forward run for each refused step, and about as many products
/// as there are degrees of freedom for signal. Memory: a vector for each inner iteration and each pair of the
/// preconditioner; no matrix.
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
/// let options = NewtonCgOptions::default();
/// let minimum = newton_cg(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn newton_cg(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &NewtonCgOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    options.run(cost, v, &Start::default(), on_iteration)
}

method!(NewtonCgOptions, stopping, Products, run);

fn run(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &NewtonCgOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    options.stopping.check()?;
    at_least_one("max_inner", options.max_inner)?;
    let n = cost.dim();
    let [mut g, mut p] = std::array::from_fn(|_| vec![0.0; n]);
    let mut search = LineSearch::new(n);
    let mut lanczos = Lanczos::new(n);
    let mut preconditioner = Preconditioner::new(options.preconditioner_pairs);
    let [mut rhs, mut mapped] = std::array::from_fn(|_| vec![0.0; n]);
    let mut ritz = Vec::new();
    let mut progress = Progress::start(cost, v, &mut g, start)?;
    loop {
        if let Some(status) = progress.report(cost, v, &g, &options.stopping, on_iteration) {
            return Ok(progress.end(status, None, ritz));
        }
        let limits = LanczosLimits {
            residual: forcing(&progress),
            radius: f64::INFINITY,
            iterations: options.max_inner,
        };
        rhs.copy_from_slice(&g);
        preconditioner.apply_transpose(&mut rhs);
        let mut product = |p: &[f64], out: &mut [f64]| {
            mapped.copy_from_slice(p);
            preconditioner.apply(&mut mapped);
            cost.hessian_apply(&mapped, out)?;
            preconditioner.apply_transpose(out);
            Ok::<(), Error>(())
        };
        lanczos.run(&mut product, &rhs, &limits)?;
        let spectral = Spectral::of(lanczos.ritz()?, &rhs);
        progress.inner = lanczos.iterations();
        progress.inner_total += progress.inner;
        progress.rejected = 0;
        spectral.step(f64::INFINITY, &mut p);
        preconditioner.apply(&mut p);
        if options.preconditioner_pairs > 0 {
            preconditioner.learn(spectral.pairs());
        } else {
            ritz = spectral.pairs();
        }
        let ray = Ray {
            v,
            direction: &p,
            value: progress.value,
            slope: dot(&g, &p),
            gradient_norm: progress.gradient_norm,
            first: 1.0,
        };
        (search.refused, search.failure) = (0, None);
        let found = search.run(Conditions::Armijo, &mut |v, g| cost.evaluate(v, g), &ray);
        progress.rejected = search.refused;
        let Some(length) = found else {
            // The point of the last gradient is the one returned.
            cost.evaluate(v, Some(&mut g))?;
            let (now, first) = (progress.gradient_norm, progress.gradient_norm_first);
            let promised = -0.5 * dot(&g, &p);
            let status = Status::without_step(promised, progress.value, now, first);
            let failure = search.failure.filter(|_| status == Status::Stalled);
            return Ok(progress.end(status, failure, ritz));
        };
        v.copy_from_slice(&search.trial);
        std::mem::swap(&mut g, &mut search.gradient);
        progress.advance(cost, &g, length * norm(&p), 0.0);
    }
}
