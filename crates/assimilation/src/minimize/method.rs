//! What a minimizer is to those that choose one.

use super::minimum::{Iteration, Minimum, Start};
use super::stopping::Stopping;
use crate::{Error, LeastSquares};
use std::ops::ControlFlow;

/// A minimizer by its options: implemented in the file of each, and all that [`Minimizer`] asks of it.
pub(super) trait Method {
    /// When it ends.
    fn stopping(&self) -> &Stopping;

    /// When it ends, to be changed.
    fn stopping_mut(&mut self) -> &mut Stopping;

    /// What it asks of a cost.
    fn uses(&self) -> Uses;

    /// Minimizes J from `v`, and leaves the best point in it.
    fn run(
        &self,
        cost: &mut dyn LeastSquares,
        v: &mut [f64],
        start: &Start,
        on_iteration: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Result<Minimum, Error>;
}

/// What a minimizer asks of a cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Uses {
    /// Values and gradients.
    Gradients,
    /// The Hessian A = I + GᵀG too, by products or, of small problems, whole: for whitened variables.
    Products,
    /// All of A at any size: for whitened variables.
    DenseHessian,
}

/// Makes options a [`Method`]: where its stopping rule is, what it [`Uses`], and the function that runs it.
macro_rules! method {
    ($options:ty, $($stopping:ident).+, $uses:ident, $run:path) => {
        impl crate::minimize::method::Method for $options {
            fn stopping(&self) -> &crate::Stopping {
                &self.$($stopping).+
            }

            fn stopping_mut(&mut self) -> &mut crate::Stopping {
                &mut self.$($stopping).+
            }

            fn uses(&self) -> crate::minimize::method::Uses {
                crate::minimize::method::Uses::$uses
            }

            fn run(
                &self,
                cost: &mut dyn crate::LeastSquares,
                v: &mut [f64],
                start: &crate::minimize::minimum::Start,
                on_iteration: &mut dyn FnMut(&crate::Iteration) -> std::ops::ControlFlow<()>,
            ) -> Result<crate::Minimum, crate::Error> {
                use crate::minimize::stationary::run_from;
                run_from(cost, v, start, on_iteration, &mut |cost, v, start, tell| {
                    $run(cost, v, self, start, tell)
                })
            }
        }
    };
}
pub(super) use method;
