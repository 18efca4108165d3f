//! How methods are run and compared here.

use std::ops::ControlFlow;
use varda_assimilation::{
    Error, InnerSolver, Iteration, LeastSquares, Minimum, OuterLoopOptions, outer_loop,
};

pub(super) fn go_on(_: &Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// The outer loop, tightly: a gradient of 1e-11 of the first.
pub(super) fn tight(
    problem: &mut dyn LeastSquares,
    v: &mut [f64],
    inner: InnerSolver,
) -> Result<Minimum, Error> {
    let options = OuterLoopOptions::default()
        .with_inner(inner)
        .with_gradient_tolerance(1e-11)
        .with_inner_tolerance(1e-12)
        .with_max_inner(1000)
        .with_max_iterations(500);
    outer_loop(problem, v, &options, &mut go_on)
}

/// |a − b| / |b|.
pub(super) fn gap(a: f64, b: f64) -> f64 {
    (a - b).abs() / b.abs()
}
