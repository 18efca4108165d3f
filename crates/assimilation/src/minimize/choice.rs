//! A minimizer as a choice that can be made from data.

use super::adam::{self, AdamOptions};
#[cfg(feature = "argmin")]
use super::argmin::{self, ArgminOptions};
use super::auto::{self, AutoOptions};
use super::continuation::{Stage, WAY, stages};
use super::lbfgs::{self, LbfgsOptions};
use super::minimum::{Iteration, Minimum, Start};
use super::newton::{self, NewtonOptions};
use super::newton_cg::{self, NewtonCgOptions};
use super::trust_region::{self, TrustRegionOptions};
use crate::{Error, LeastSquares};
use std::ops::ControlFlow;

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
#[derive(Debug, Clone, PartialEq)]
pub enum Minimizer {
    /// Trust region on the true J, and where the background is far from the observations also through
    /// inflated errors and from draws of the prior, until two runs agree on the lowest end.
    Auto(AutoOptions),
    /// Trust region on the true J: the default.
    TrustRegion(TrustRegionOptions),
    /// Gauss–Newton with truncated conjugate gradients and a line search.
    NewtonCg(NewtonCgOptions),
    /// The paper's: dense Hessian (2.18), full steps, no safeguard.
    Newton(NewtonOptions),
    /// Limited-memory BFGS: gradients only.
    Lbfgs(LbfgsOptions),
    /// The paper's other one: fixed steps along smoothed gradients.
    Adam(AdamOptions),
    /// L-BFGS of the argmin crate, to compare with.
    #[cfg(feature = "argmin")]
    ArgminLbfgs(ArgminOptions),
    /// Trust region of the argmin crate, to compare with.
    #[cfg(feature = "argmin")]
    ArgminTrustRegion(ArgminOptions),
}

impl Default for Minimizer {
    fn default() -> Self {
        Self::TrustRegion(TrustRegionOptions::default())
    }
}

impl Minimizer {
    /// The names [`Minimizer::named`] knows.
    pub const NAMES: &[&str] = &[
        "auto",
        "trust-region",
        "gauss-newton-cg",
        "newton",
        "lbfgs",
        "adam",
        #[cfg(feature = "argmin")]
        "argmin-lbfgs",
        #[cfg(feature = "argmin")]
        "argmin-trust-region",
    ];

    /// The minimizer of that name, with its default settings.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "auto" => Self::Auto(AutoOptions::default()),
            "trust-region" => Self::TrustRegion(TrustRegionOptions::default()),
            "gauss-newton-cg" => Self::NewtonCg(NewtonCgOptions::default()),
            "newton" => Self::Newton(NewtonOptions::default()),
            "lbfgs" => Self::Lbfgs(LbfgsOptions::default()),
            "adam" => Self::Adam(AdamOptions::default()),
            #[cfg(feature = "argmin")]
            "argmin-lbfgs" => Self::ArgminLbfgs(ArgminOptions::default()),
            #[cfg(feature = "argmin")]
            "argmin-trust-region" => Self::ArgminTrustRegion(ArgminOptions::default()),
            _ => return None,
        })
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Auto(_) => "auto",
            Self::TrustRegion(_) => "trust-region",
            Self::NewtonCg(_) => "gauss-newton-cg",
            Self::Newton(_) => "newton",
            Self::Lbfgs(_) => "lbfgs",
            Self::Adam(_) => "adam",
            #[cfg(feature = "argmin")]
            Self::ArgminLbfgs(_) => "argmin-lbfgs",
            #[cfg(feature = "argmin")]
            Self::ArgminTrustRegion(_) => "argmin-trust-region",
        }
    }

    /// The relative gradient tolerance, which every minimizer has.
    pub fn gradient_tolerance_mut(&mut self) -> &mut f64 {
        match self {
            Self::Auto(options) => &mut options.trust_region.gradient_tolerance,
            Self::TrustRegion(options) => &mut options.gradient_tolerance,
            Self::NewtonCg(options) => &mut options.gradient_tolerance,
            Self::Newton(options) => &mut options.gradient_tolerance,
            Self::Lbfgs(options) => &mut options.gradient_tolerance,
            Self::Adam(options) => &mut options.gradient_tolerance,
            #[cfg(feature = "argmin")]
            Self::ArgminLbfgs(options) | Self::ArgminTrustRegion(options) => &mut options.gradient_tolerance,
        }
    }

    /// The limit on outer iterations, which every minimizer has.
    pub fn max_iterations_mut(&mut self) -> &mut usize {
        match self {
            Self::Auto(options) => &mut options.trust_region.max_iterations,
            Self::TrustRegion(options) => &mut options.max_iterations,
            Self::NewtonCg(options) => &mut options.max_iterations,
            Self::Newton(options) => &mut options.max_iterations,
            Self::Lbfgs(options) => &mut options.max_iterations,
            Self::Adam(options) => &mut options.max_iterations,
            #[cfg(feature = "argmin")]
            Self::ArgminLbfgs(options) | Self::ArgminTrustRegion(options) => &mut options.max_iterations,
        }
    }

    /// Minimizes J from `v`, and leaves the best point in it.
    ///
    /// # Errors
    /// A cost that cannot be evaluated at the first point, a setting out of range, or products that fail.
    /// Everything that happens to a minimization once under way is a [`Status`](crate::Status).
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
        let first_order = matches!(self, Self::Lbfgs(_) | Self::Adam(_));
        if !cost.is_whitened() && !first_order {
            return Err(Error::NotWhitened { minimizer: self.name() });
        }
        match self {
            Self::Auto(options) => auto::run(cost, v, options, start, on_iteration),
            Self::TrustRegion(options) => trust_region::run(cost, v, options, start, on_iteration),
            Self::NewtonCg(options) => newton_cg::run(cost, v, options, start, on_iteration),
            Self::Newton(options) => newton::run(cost, v, options, start, on_iteration),
            Self::Lbfgs(options) => lbfgs::run(cost, v, options, start, on_iteration),
            Self::Adam(options) => adam::run(cost, v, options, start, on_iteration),
            #[cfg(feature = "argmin")]
            Self::ArgminLbfgs(options) => argmin::run_lbfgs(cost, v, options, start, on_iteration),
            #[cfg(feature = "argmin")]
            Self::ArgminTrustRegion(options) => {
                argmin::run_trust_region(cost, v, options, start, on_iteration)
            }
        }
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
    let mut early = last.clone();
    let tolerance = early.gradient_tolerance_mut();
    *tolerance = tolerance.max(WAY);
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
