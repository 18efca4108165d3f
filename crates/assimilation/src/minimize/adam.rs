//! Adam, the paper's baseline without a Hessian.

use super::method::method;
use super::minimum::{Iteration, Minimum, Progress, Start};
use super::stationary::run_from;
use super::stopping::{Status, Stopping, setters};
use crate::{CostFunction, Error};
use std::ops::ControlFlow;

/// Settings of [`adam`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct AdamOptions {
    /// When it ends.
    pub stopping: Stopping,
    /// α, the size of the first steps per component, in the unit of the variable: prior standard deviations
    /// for a control variable.
    pub learning_rate: f64,
    /// β₁, the memory of the mean gradient.
    pub beta1: f64,
    /// β₂, the memory of the mean square.
    pub beta2: f64,
    /// ε, added to √s.
    pub epsilon: f64,
}

impl Default for AdamOptions {
    fn default() -> Self {
        Self {
            stopping: Stopping::within(2000),
            learning_rate: 0.05,
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-8,
        }
    }
}

setters!(AdamOptions, stopping, {
    with_learning_rate: learning_rate: f64,
    with_beta1: beta1: f64,
    with_beta2: beta2: f64,
    with_epsilon: epsilon: f64,
});

/// Adam (Kingma and Ba 2014, Algorithm 1; the paper's first minimizer):
///
/// ```text
///     m ← β₁ m + (1 − β₁) g,    s ← β₂ s + (1 − β₂) g²,
///     v ← v − α (m / (1 − β₁ᵗ)) / (√(s / (1 − β₂ᵗ)) + ε)    (by components)
/// ```
///
/// When to use: as the baseline the paper compares with. When not: for an answer. It is blind to couplings
/// between components, has no line search, J may rise, and the number of steps is in the hundreds to
/// thousands. A control variable does for it what a Hessian does for others; in the raw variables of the
/// model ([`RawVariables`](crate::RawVariables)) a stiff cost is out of its reach.
///
/// A model failure ends it (`Status::Failed`). Unless it converged, the lowest point seen is returned.
///
/// Cost of a step: one gradient. Memory: six vectors.
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
/// let options = AdamOptions::default().with_max_iterations(50);
/// let minimum = adam(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::MaxIterations); // thousands, as a rule
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn adam(
    cost: &mut dyn CostFunction,
    v: &mut [f64],
    options: &AdamOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    run_from(cost, v, &Start::default(), on_iteration, &mut |cost, v, start, tell| {
        run(cost, v, options, start, tell)
    })
}

method!(AdamOptions, stopping, Gradients, run);

fn run(
    cost: &mut dyn CostFunction,
    v: &mut [f64],
    options: &AdamOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    let &AdamOptions { learning_rate, beta1, beta2, epsilon, .. } = options;
    options.stopping.check()?;
    for (what, value, fine) in [
        ("learning_rate", learning_rate, learning_rate > 0.0 && learning_rate.is_finite()),
        ("beta1", beta1, (0.0..1.0).contains(&beta1)),
        ("beta2", beta2, (0.0..1.0).contains(&beta2)),
        ("epsilon", epsilon, epsilon > 0.0 && epsilon.is_finite()),
    ] {
        if !fine {
            return Err(Error::Setting { what, value });
        }
    }
    let n = cost.dim();
    let [mut g, mut mean, mut square] = std::array::from_fn(|_| vec![0.0; n]);
    let mut progress = Progress::start(cost, v, &mut g, start)?;
    let mut best = v.to_vec();
    let mut lowest = progress.value;
    let (mut power1, mut power2) = (1.0, 1.0);
    let (status, failure) = loop {
        let status = progress.report(cost, v, &g, &options.stopping, on_iteration);
        if progress.value < lowest {
            lowest = progress.value;
            best.copy_from_slice(v);
        }
        if let Some(status) = status {
            break (status, None);
        }
        power1 *= beta1;
        power2 *= beta2;
        let mut length = 0.0;
        for i in 0..n {
            mean[i] = beta1 * mean[i] + (1.0 - beta1) * g[i];
            square[i] = beta2 * square[i] + (1.0 - beta2) * g[i] * g[i];
            let step =
                learning_rate * (mean[i] / (1.0 - power1)) / ((square[i] / (1.0 - power2)).sqrt() + epsilon);
            v[i] -= step;
            length += step * step;
        }
        if let Err(error) = cost.evaluate(v, Some(&mut g)) {
            break (Status::Failed, Some(error));
        }
        progress.advance(cost, &g, f64::sqrt(length), 0.0);
    };
    if status != Status::Converged {
        v.copy_from_slice(&best);
        progress.here(cost, v, &mut g)?;
    }
    Ok(progress.end(status, failure, Vec::new()))
}
