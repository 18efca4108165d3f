//! The paper's minimizer: Newton's method with the dense Hessian (2.18) and full steps.

use super::method::{Method, method};
use super::minimum::{Iteration, Minimum, Progress, Start};
use super::stopping::{Status, Stopping, setters};
use crate::cost::norm;
use crate::{Error, LeastSquares};
use std::ops::ControlFlow;
use varda_linalg::dense::Cholesky;

/// Settings of [`newton`].
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct NewtonOptions {
    /// When it ends.
    pub stopping: Stopping,
}

impl Default for NewtonOptions {
    fn default() -> Self {
        Self { stopping: Stopping::within(50) }
    }
}

setters!(NewtonOptions, stopping, {});

/// The paper's Newton method: v ← v − A⁻¹∇J with the dense Gauss–Newton Hessian A (paper 2.18) by
/// Cholesky, full steps, no safeguard.
///
/// Exact in one step where model and observations are linear. Elsewhere J may rise and the model may be
/// driven to a state it cannot step from (`Status::Failed` with the reason); where the dropped second
/// derivatives exceed A, it is repelled from the minimum. The lowest point seen is returned unless it
/// converged.
///
/// When to use: linear problems, and to compare with the paper. When not: otherwise;
/// [`trust_region`](crate::trust_region) is the same near the minimum and safe far from it. Cost of a step:
/// one gradient, n tangent sweeps, n³/3. Memory: 2n².
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
/// let minimum = newton(&mut cost, &mut v, &NewtonOptions::default(), &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As for [`Minimizer::minimize`](crate::Minimizer::minimize).
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn newton(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &NewtonOptions,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    options.run(cost, v, &Start::default(), on_iteration)
}

method!(NewtonOptions, stopping, DenseHessian, run);

fn run(
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    options: &NewtonOptions,
    start: &Start,
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    options.stopping.check()?;
    let n = cost.dim();
    let mut g = vec![0.0; n];
    let mut p = vec![0.0; n];
    let mut hessian = vec![0.0; n * n];
    let mut progress = Progress::start(cost, v, &mut g, start)?;
    let mut best = (progress.value, v.to_vec());
    let (status, failure) = loop {
        let status = progress.report(cost, v, &g, &options.stopping, on_iteration);
        if progress.value < best.0 {
            best = (progress.value, v.to_vec());
        }
        if let Some(status) = status {
            break (status, None);
        }
        cost.hessian(&mut hessian)?;
        let Ok(factor) = Cholesky::new(n, &hessian) else {
            break (Status::Failed, Some(Error::NotPositiveDefinite { smallest: f64::NAN }));
        };
        p.copy_from_slice(&g);
        factor.solve_columns(&mut p);
        v.iter_mut().zip(&p).for_each(|(v, p)| *v -= p);
        if let Err(error) = cost.evaluate(v, Some(&mut g)) {
            break (Status::Failed, Some(error));
        }
        progress.advance(cost, &g, norm(&p), 0.0);
    };
    if status != Status::Converged {
        v.copy_from_slice(&best.1);
        progress.here(cost, v, &mut g)?;
    }
    Ok(progress.end(status, failure, Vec::new()))
}
