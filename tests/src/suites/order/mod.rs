//! Orders of convergence in time and in space, and closed forms that a rod converges to.

mod closed;
mod ordinary;
mod rods;

use super::Options;
use crate::row::{Case, Row, Rows};

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("order");
    ordinary::run(&mut rows);
    rods::run(&mut rows, options.quick);
    closed::run(&mut rows, options.quick);
    rows.finish()
}

/// Fitted over halvings, terms of the next order move a slope by less: they are a tenth of the error at the first point
/// and half of that at every further one.
const SLOPE: f64 = 0.1;

/// |slope − order| of errors at steps h, h/2, h/4, …; they must fall in earnest to be judged.
fn slope_row(case: &mut Case, what: &str, errors: &[f64], order: f64) {
    let slope = slope(errors);
    let list: Vec<String> = errors.iter().map(|e| format!("{e:.2e}")).collect();
    case.at_most(what, (slope - order).abs(), SLOPE, "-")
        .computed(slope)
        .note(format!("slope {slope:.3} of {}", list.join(" ")));
}

/// Least-squares slope of ln error over ln h, h halving.
fn slope(errors: &[f64]) -> f64 {
    let middle = 0.5 * (errors.len() as f64 - 1.0);
    let (mut above, mut below) = (0.0, 0.0);
    for (i, e) in errors.iter().enumerate() {
        let h = middle - i as f64;
        above += h * e.log2();
        below += h * h;
    }
    above / below
}

/// What two values at h and h/2 with an error of second order point to.
fn extrapolated(coarse: f64, fine: f64) -> f64 {
    fine + (fine - coarse) / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_fitted_and_a_wrong_order_fails() {
        let errors = [0.8, 0.2, 0.05];
        assert!((slope(&errors) - 2.0).abs() < 1e-15);
        let mut rows = Rows::new("order");
        rows.case("parabola", |case| {
            slope_row(case, "right", &errors, 2.0);
            slope_row(case, "wrong", &errors, 1.0);
            slope_row(case, "nothing falls", &[0.0, 0.0], 2.0);
            Ok(())
        });
        let pass: Vec<bool> = rows.finish().iter().map(|r| r.pass).collect();
        assert_eq!(pass, [true, false, false]);
    }
}
