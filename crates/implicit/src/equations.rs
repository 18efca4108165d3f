//! What Newton's method solves.

use crate::Refusal;

/// A system of equations G(u) = 0 in unknowns u, as [`solve`](crate::solve) sees it.
///
/// The layout of ∂G/∂u is fixed and known to the work space that the equations are solved in
/// ([`NewtonWork::new`](crate::NewtonWork::new)). The equations of a time step are made by
/// [`ImplicitStep::equations`](crate::ImplicitStep::equations); an equilibrium is a type of its own.
///
/// ```
/// use varda_implicit::{Equations, NewtonOptions, NewtonWork, Refusal, Structure, solve};
///
/// /// u² = 2, from the right.
/// struct Root;
///
/// impl Equations for Root {
///     fn assemble(
///         &mut self,
///         u: &[f64],
///         g: &mut [f64],
///         jacobian: Option<&mut [f64]>,
///     ) -> Result<Option<f64>, Refusal> {
///         g[0] = u[0] * u[0] - 2.0;
///         if let Some(values) = jacobian {
///             values[0] = 2.0 * u[0];
///         }
///         Ok(None)
///     }
///     fn converged_below(&self) -> f64 {
///         1e-12
///     }
/// }
///
/// let mut u = [3.0];
/// solve(&mut Root, &mut u, &mut NewtonWork::new(1, &Structure::Dense), &NewtonOptions::default())?;
/// assert!((u[0] - 2.0_f64.sqrt()).abs() < 1e-12);
/// # Ok::<(), varda_implicit::NewtonFailure>(())
/// ```
pub trait Equations {
    /// g = G(u); where asked for, all values of ∂G/∂u in the layout of the work space (symmetric where
    /// that says so).
    ///
    /// Returns Φ(u) where G = ∂Φ/∂u (a minimum of Φ is then looked for), `None` where there is no
    /// potential.
    ///
    /// # Errors
    /// A point at which the equations have no value.
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal>;

    /// `trial` = u ⊕ α du, where du solved ∂G/∂u du = −G. A plain sum unless u lives on a curved
    /// set.
    fn retract(&mut self, u: &[f64], du: &[f64], alpha: f64, trial: &mut [f64]) {
        for ((t, u), d) in trial.iter_mut().zip(u).zip(du) {
            *t = u + alpha * d;
        }
    }

    /// Size of an update du, in the norm the two thresholds below are stated in. By default the largest
    /// component.
    fn size(&self, du: &[f64]) -> f64 {
        du.iter().fold(0.0, |m: f64, d| if d.is_nan() { f64::NAN } else { m.max(d.abs()) })
    }

    /// The largest share of an update du that is tried, at most 1: a limit for unknowns along which the
    /// equations turn round, where a long step lands on another branch. By default all of it.
    fn longest(&self, du: &[f64]) -> f64 {
        let _ = du;
        1.0
    }

    /// Newton ends when a full step was no larger than this, or the next one is expected to be
    /// ([`solve`](crate::solve)).
    fn converged_below(&self) -> f64;

    /// Full steps no larger than this are accepted without a decrease test (a test on Φ stalls at rounding).
    fn trusted_below(&self) -> f64 {
        1e5 * self.converged_below()
    }
}
