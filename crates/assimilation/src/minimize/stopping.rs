//! The stopping rule that all minimizers share, and how a minimization may end.

use crate::Error;
use crate::cost::norm;
use std::ops::ControlFlow;

/// When a minimization ends: the one stopping rule of every minimizer and of the outer loop.
///
/// ```text
///     converged:  ‖∇J‖ ≤ gradient_tolerance · ‖∇J‖ at the first point,   or
///                 ‖∇J‖ ≤ gradient_floor,   or
///                 ‖∇J‖ ≤ 64 ε (‖v‖ + ‖∇J − v‖)  (its two parts have cancelled)
/// ```
///
/// Why an absolute floor: J is in units of the prior, and its Hessian A = I + GᵀG is at least I. The way
/// that is left, A⁻¹∇J, is then at most ‖∇J‖ standard deviations of the prior, and A^{-1/2}∇J
/// at most ‖∇J‖ of those of the analysis. At 10⁻¹⁰ nothing is left to gain, however small the
/// first gradient was: a background that already fits to rounding is a minimum.
///
/// Norms are those of the control variable, the B⁻¹ norm of an increment. A gradient whose norm is not
/// finite is never converged. A small step alone does not end a minimization.
///
/// ```
/// use varda_assimilation::{LbfgsOptions, Minimizer, Stopping};
///
/// let stopping = Stopping::new(1e-6, 500);
/// let minimizer = Minimizer::Lbfgs(LbfgsOptions::default()).with_stopping(stopping);
/// assert_eq!(minimizer.stopping().max_iterations, 500);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Stopping {
    /// Converged when ‖∇J‖ has fallen to this part of the first; in [0, 1).
    pub gradient_tolerance: f64,
    /// Converged too when ‖∇J‖ is no larger than this.
    pub gradient_floor: f64,
    /// Outer iterations at most: over all that a minimizer does, stages and further starts included.
    pub max_iterations: usize,
}

/// A decrease below this part of J cannot be seen in J (its trajectory is only as exact as the model's
/// solver); steps are then judged by the gradient.
pub(crate) const NOISE: f64 = 1e-11;

/// ‖∇J‖ at which a point where nothing decreases is a minimum to rounding, as a part of the first.
const ROUNDING: f64 = 1e-6;

/// ‖∇J‖ that moves nothing by 10⁻¹⁰ standard deviations.
const FLOOR: f64 = 1e-10;

impl Stopping {
    /// Both limits, with the usual floor of 10⁻¹⁰.
    pub const fn new(gradient_tolerance: f64, max_iterations: usize) -> Self {
        Self { gradient_tolerance, gradient_floor: FLOOR, max_iterations }
    }

    /// The same with another floor of the gradient; 0 for none.
    #[must_use]
    pub const fn with_gradient_floor(self, gradient_floor: f64) -> Self {
        Self { gradient_floor, ..self }
    }

    /// At most so many iterations, to the usual tolerance of 10⁻⁸.
    pub(crate) const fn within(max_iterations: usize) -> Self {
        Self::new(1e-8, max_iterations)
    }

    /// With a tolerance of at least `tolerance`.
    pub(super) fn loosened(self, tolerance: f64) -> Self {
        Self { gradient_tolerance: self.gradient_tolerance.max(tolerance), ..self }
    }

    /// ‖∇J‖ to come to, where it was `first` at the first point.
    pub fn gradient_goal(&self, first: f64) -> f64 {
        self.gradient_floor.max(self.gradient_tolerance * first)
    }

    /// Whether a point is converged: `b` is its whitened departure from what is known before it was observed
    /// (the control variable v itself for most costs), `gradient` is ∇J there and `first` ‖∇J‖ at the
    /// first point.
    ///
    /// # Panics
    /// If `b` and `gradient` differ in length.
    pub fn is_converged(&self, b: &[f64], gradient: &[f64], first: f64) -> bool {
        assert_eq!(b.len(), gradient.len(), "length of the gradient");
        let size = norm(gradient);
        let pull = b.iter().zip(gradient).map(|(b, g)| (g - b) * (g - b)).sum::<f64>().sqrt();
        // a norm that overflowed is no larger than another one that did
        let small = size <= self.gradient_goal(first) || size <= 64.0 * f64::EPSILON * (norm(b) + pull);
        small && size.is_finite()
    }

    /// How a minimization ends at a point, if it does: converged, then interrupted, then out of iterations,
    /// of which `iterations` were made.
    pub(crate) fn ended(
        &self,
        b: &[f64],
        gradient: &[f64],
        first: f64,
        iterations: usize,
        flow: ControlFlow<()>,
    ) -> Option<Status> {
        if self.is_converged(b, gradient, first) {
            Some(Status::Converged)
        } else if flow.is_break() {
            Some(Status::Interrupted)
        } else if iterations >= self.max_iterations {
            Some(Status::MaxIterations)
        } else {
            None
        }
    }

    /// Refuses a tolerance out of range.
    pub(crate) fn check(&self) -> Result<(), Error> {
        check_tolerance("gradient_tolerance", self.gradient_tolerance)?;
        check_tolerance("gradient_floor", self.gradient_floor)
    }
}

impl Status {
    /// How a minimization ends where no step decreases J: at a minimum, where the whole step to that of the
    /// quadratic model promises less than J resolves (10⁻¹¹ of it: a way of √(2 · 10⁻¹¹ J)
    /// standard deviations of the analysis at most) and ‖∇J‖ is below 10⁻⁶ of the first; stalled
    /// elsewhere.
    pub(crate) fn without_step(promised: f64, value: f64, gradient: f64, first: f64) -> Status {
        if promised <= NOISE * value && gradient <= ROUNDING * first {
            Status::Converged
        } else {
            Status::Stalled
        }
    }
}

impl Default for Stopping {
    /// 10⁻⁸ of the first gradient, at most 100 iterations.
    fn default() -> Self {
        Self::within(100)
    }
}

/// How a minimization ended. Only `Converged` claims a stationary point; a small step alone never does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// ‖∇J‖ has vanished as far as [`Stopping`] asks for, or to rounding: of its own parts, or of J.
    Converged,
    /// Out of iterations.
    MaxIterations,
    /// One linearization was asked for, and J is not the quadratic that it was taken for (4D-EnVar): the
    /// end of that method, but no minimum.
    LinearizedOnce,
    /// No step decreases J, nor, where the decrease is too small to be measured, the gradient.
    Stalled,
    /// The caller asked to stop.
    Interrupted,
    /// The model failed where no safeguard was asked for.
    Failed,
}

/// A relative tolerance: in [0, 1).
pub(crate) fn check_tolerance(what: &'static str, value: f64) -> Result<(), Error> {
    if (0.0..1.0).contains(&value) { Ok(()) } else { Err(Error::Setting { what, value }) }
}

/// A count that must not be zero.
pub(crate) fn at_least_one(what: &'static str, value: usize) -> Result<(), Error> {
    if value > 0 { Ok(()) } else { Err(Error::Setting { what, value: 0.0 }) }
}

/// `with_…` methods of an option struct, one for each field: its fields can then be given outside the
/// crate, where the struct cannot be written out.
macro_rules! setters {
    ($options:ty { $($with:ident: $field:ident: $value:ty,)* }) => {
        impl $options {
            $(
                #[doc = concat!(
                    "The same with another [`", stringify!($field), "`](Self::", stringify!($field), ").",
                )]
                #[must_use]
                pub fn $with(mut self, $field: $value) -> Self {
                    self.$field = $field;
                    self
                }
            )*
        }
    };
    ($options:ty, $($stopping:ident).+, { $($rest:tt)* }) => {
        impl $options {
            /// The same with another [`Stopping`](crate::Stopping).
            #[must_use]
            pub fn with_stopping(mut self, stopping: crate::Stopping) -> Self {
                self.$($stopping).+ = stopping;
                self
            }

            /// The same with another tolerance of the gradient, relative to the first.
            #[must_use]
            pub fn with_gradient_tolerance(mut self, gradient_tolerance: f64) -> Self {
                self.$($stopping).+.gradient_tolerance = gradient_tolerance;
                self
            }

            /// The same with another limit on iterations.
            #[must_use]
            pub fn with_max_iterations(mut self, max_iterations: usize) -> Self {
                self.$($stopping).+.max_iterations = max_iterations;
                self
            }
        }
        crate::minimize::setters!($options { $($rest)* });
    };
}
pub(crate) use setters;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn converged_is_relative_or_rounding_and_never_infinite() {
        let stopping = Stopping::new(1e-3, 5);
        assert!(stopping.is_converged(&[0.0], &[1e-3], 1.0));
        assert!(!stopping.is_converged(&[0.0], &[1.1e-3], 1.0));
        // v and ∇J − v have cancelled to the last digits
        assert!(stopping.is_converged(&[1e15], &[1.0], 0.0) && !stopping.is_converged(&[1.0], &[1e-3], 0.0));
        // the absolute floor, whatever the first gradient was
        assert!(stopping.is_converged(&[0.0], &[1e-10], 0.0) && !stopping.is_converged(&[0.0], &[1e-9], 0.0));
        assert!(!stopping.with_gradient_floor(0.0).is_converged(&[0.0], &[1e-10], 0.0));
        // no step decreases J: rounding near the minimum, an obstacle elsewhere
        assert_eq!(Status::without_step(1e-10, 60.0, 1e-3, 1e4), Status::Converged);
        for (promised, gradient) in [(1e-8, 1e-3), (1e-10, 1.0), (f64::NAN, 0.0), (0.0, f64::NAN)] {
            assert_eq!(Status::without_step(promised, 60.0, gradient, 1e4), Status::Stalled);
        }
        for norm in [f64::INFINITY, f64::NAN] {
            assert!(!stopping.is_converged(&[0.0], &[norm], f64::INFINITY), "{norm}");
        }
        let (go_on, stop) = (ControlFlow::Continue(()), ControlFlow::Break(()));
        let at = |gradient, iterations, flow| stopping.ended(&[0.0], &[gradient], 1.0, iterations, flow);
        assert_eq!(at(1.0, 4, go_on), None);
        assert_eq!(at(1.0, 5, go_on), Some(Status::MaxIterations));
        assert_eq!(at(1.0, 5, stop), Some(Status::Interrupted));
        assert_eq!(at(0.0, 5, stop), Some(Status::Converged));
    }
}
