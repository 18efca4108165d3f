//! A minimizer as a choice that can be made from data.

use super::adam::AdamOptions;
#[cfg(feature = "argmin")]
use super::argmin::{ArgminLbfgsOptions, ArgminTrustRegionOptions};
use super::auto::AutoOptions;
use super::continuation::{Stage, WAY, stages};
use super::lbfgs::LbfgsOptions;
use super::method::{Method, Uses};
use super::minimum::{Iteration, Minimum, Start};
use super::newton::NewtonOptions;
use super::newton_cg::NewtonCgOptions;
use super::stopping::Stopping;
use super::trust_region::TrustRegionOptions;
use crate::{Error, LeastSquares};
use std::ops::ControlFlow;

/// The enumeration of minimizers, from a list of variants with their options and names.
macro_rules! minimizers {
    (
        $(#[doc = $about:literal])*
        pub enum Minimizer {
            $($(#[doc = $doc:literal])* $(#[cfg($($cfg:tt)*)])? $variant:ident($options:ty) = $name:literal,)*
        }
    ) => {
        $(#[doc = $about])*
        #[derive(Debug, Clone, PartialEq)]
        pub enum Minimizer {
            $($(#[doc = $doc])* $(#[cfg($($cfg)*)])? $variant($options),)*
        }

        impl Minimizer {
            /// The names [`Minimizer::named`] knows.
            pub const NAMES: &[&str] = &[$($(#[cfg($($cfg)*)])? $name,)*];

            /// The minimizer of that name, with its default settings.
            pub fn named(name: &str) -> Option<Self> {
                Some(match name {
                    $($(#[cfg($($cfg)*)])? $name => Self::$variant(<$options>::default()),)*
                    _ => return None,
                })
            }

            /// Its name.
            pub fn name(&self) -> &'static str {
                match self {
                    $($(#[cfg($($cfg)*)])? Self::$variant(_) => $name,)*
                }
            }

            fn method(&self) -> &dyn Method {
                match self {
                    $($(#[cfg($($cfg)*)])? Self::$variant(options) => options,)*
                }
            }

            fn method_mut(&mut self) -> &mut dyn Method {
                match self {
                    $($(#[cfg($($cfg)*)])? Self::$variant(options) => options,)*
                }
            }
        }
    };
}

minimizers! {
    /// A minimizer with its settings: a choice that can be made from data.
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
    /// let Some(minimizer) = Minimizer::named("gauss-newton-cg") else { unreachable!() };
    /// let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    /// assert_eq!(minimum.status, Status::Converged);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub enum Minimizer {
        /// Trust region on the true J, and where the background is far from the observations also through
        /// inflated errors and from draws of the prior, as long as further starts pay.
        Auto(AutoOptions) = "auto",
        /// Trust region on the true J: the default.
        TrustRegion(TrustRegionOptions) = "trust-region",
        /// Gauss–Newton with truncated conjugate gradients and a line search.
        NewtonCg(NewtonCgOptions) = "gauss-newton-cg",
        /// The paper's: dense Hessian (2.18), full steps, no safeguard.
        Newton(NewtonOptions) = "newton",
        /// Limited-memory BFGS: gradients only.
        Lbfgs(LbfgsOptions) = "lbfgs",
        /// The paper's other one: fixed steps along smoothed gradients.
        Adam(AdamOptions) = "adam",
        /// L-BFGS of the argmin crate, to compare with.
        #[cfg(feature = "argmin")]
        ArgminLbfgs(ArgminLbfgsOptions) = "argmin-lbfgs",
        /// Trust region of the argmin crate, to compare with.
        #[cfg(feature = "argmin")]
        ArgminTrustRegion(ArgminTrustRegionOptions) = "argmin-trust-region",
    }
}

impl Default for Minimizer {
    fn default() -> Self {
        Self::TrustRegion(TrustRegionOptions::default())
    }
}

impl Minimizer {
    /// When it ends, a rule that every minimizer has.
    pub fn stopping(&self) -> &Stopping {
        self.method().stopping()
    }

    /// When it ends, to be changed.
    pub fn stopping_mut(&mut self) -> &mut Stopping {
        self.method_mut().stopping_mut()
    }

    /// The same with another stopping rule.
    #[must_use]
    pub fn with_stopping(mut self, stopping: Stopping) -> Self {
        *self.stopping_mut() = stopping;
        self
    }

    /// Whether it keeps a dense Hessian whatever the number n of unknowns: n² numbers and n tangent or m
    /// adjoint sweeps an iteration.
    pub fn is_dense(&self) -> bool {
        self.method().uses() == Uses::DenseHessian
    }

    /// Minimizes J from `v`, and leaves the best point in it.
    ///
    /// # Errors
    /// A cost that cannot be evaluated at the first point, a setting out of range, products that fail;
    /// [`Error::NotWhitened`] for a minimizer with the Hessian and a cost whose variables are not whitened
    /// ([`WeakState`](crate::WeakState)). Everything that happens to a minimization once under way is a
    /// [`Status`](crate::Status).
    ///
    /// # Panics
    /// If `v` is not of length `cost.dim()`.
    pub fn minimize(
        &self,
        cost: &mut dyn LeastSquares,
        v: &mut [f64],
        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Result<Minimum, Error> {
        self.run(cost, v, &Start::default(), on_iteration)
    }

    fn run(
        &self,
        cost: &mut dyn LeastSquares,
        v: &mut [f64],
        start: &Start,
        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Result<Minimum, Error> {
        let method = self.method();
        if method.uses() != Uses::Gradients && !cost.is_whitened() {
            return Err(Error::NotWhitened { minimizer: self.name() });
        }
        method.run(cost, v, start, on_iteration)
    }
}

/// Minimizes J with every σ multiplied by each of `scales` in turn (say 10, 3, 1), each stage from where the
/// one before ended.
///
/// Inflated errors flatten J towards its prior part, ½‖v‖², which has one minimum: the path then
/// follows that minimum down instead of falling into the nearest one. The early stages only need to find the
/// way, and stop when their gradient has fallen to 10⁻³ of its first value; a stage that ends otherwise
/// than converged still hands its point on. The tolerance of the last stage, and the first gradient norm
/// reported, refer to the true cost at the first point. Leaves the true cost in force.
///
/// When to use: precise observations and a background far from them. When not: chaotic models, whose minima
/// come from the length of the window ([`window_growth`](crate::window_growth)). Cost: a minimization a
/// stage, the early ones short. Memory: that of the minimizer.
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
/// let scales = [10.0, 3.0, 1.0];
/// let on_iteration = &mut |_: &Iteration| ControlFlow::Continue(());
/// let minimum = continuation(&Minimizer::default(), &mut cost, &mut v, &scales, on_iteration)?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// Scales that are empty, not positive and finite, or do not end with 1; else as for
/// [`Minimizer::minimize`].
///
/// # Panics
/// If `v` is not of length `cost.dim()`.
pub fn continuation(
    minimizer: &Minimizer,
    cost: &mut dyn LeastSquares,
    v: &mut [f64],
    scales: &[f64],
    on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Minimum, Error> {
    // Its own ladder would be one too many.
    let last = match minimizer {
        Minimizer::Auto(options) => Minimizer::TrustRegion(options.trust_region.clone()),
        other => other.clone(),
    };
    let early = last.clone().with_stopping(last.stopping().loosened(WAY));
    let mut minimize = |cost: &mut dyn LeastSquares,
                        v: &mut [f64],
                        stage: Stage,
                        start: &Start,
                        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>| {
        let minimizer = if stage == Stage::Early { &early } else { &last };
        minimizer.run(cost, v, start, on_iteration)
    };
    stages(&mut minimize, cost, v, scales, &Start::default(), on_iteration)
}
