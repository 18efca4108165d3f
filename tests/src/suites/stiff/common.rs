//! What the stiff cases share: intervals, work, condition numbers, errors that name what failed.

use crate::row::{Case, Work};
use problems::counted::Counted;
use varda_implicit::{Interval, LinearSolver, NewtonReport, Structure};

/// An interval of time that stands alone.
pub(super) fn interval(index: usize, start: f64, length: f64) -> Interval {
    Interval { index, start, length, previous: None }
}

/// The work of a model since it was made; a condition that is NaN is not told.
pub(super) fn work<M>(model: &Counted<M>, condition: f64) -> Work {
    let counts = model.counts();
    Work {
        condition: (!condition.is_nan()).then_some(condition),
        iterations: Some(counts.newton_iterations),
        extra_parts: Some(counts.substeps),
    }
}

/// The work of a static solution, and a note on how its Hessian was.
pub(super) fn statics(report: &NewtonReport) -> (Work, String) {
    let neutral = if report.neutral { ", the minimum is not isolated" } else { "" };
    let work = Work { iterations: Some(report.iterations), ..Work::default() };
    (work, format!("{} shifts, {} halvings of an update{neutral}", report.shifts, report.backtracks))
}

/// An estimate of the condition number ‖A‖₁ ‖A⁻¹‖₁ of a matrix that was given by its values:
/// Hager's estimator (Higham 2002, algorithm 15.1), right within a small factor nearly always. Infinite for a
/// singular matrix.
pub(super) fn condition(n: usize, structure: &Structure, values: &[f64]) -> f64 {
    let mut solver = LinearSolver::new(n, structure);
    let mut factor = solver.empty_factor();
    if solver.factor(values, &mut factor).is_err() {
        return f64::INFINITY;
    }
    // row sums of |A|: its ∞-norm, and for a symmetric matrix its 1-norm
    let mut sums = vec![0.0; n];
    solver.absolute_product(values, &vec![1.0; n], &mut sums);
    let norm = sums.iter().fold(0.0_f64, |m, s| m.max(*s));
    let mut x = vec![1.0 / n as f64; n];
    let mut estimate = 0.0;
    for _ in 0..5 {
        solver.solve_transpose(&factor, &mut x);
        estimate = x.iter().map(|x| x.abs()).sum::<f64>();
        let mut z: Vec<f64> = x.iter().map(|x| x.signum()).collect();
        solver.solve(&factor, &mut z);
        let (largest, _) = z
            .iter()
            .enumerate()
            .fold((0, 0.0_f64), |best, (i, z)| if z.abs() > best.1 { (i, z.abs()) } else { best });
        if x[largest].abs() == 1.0 {
            break;
        }
        x.fill(0.0);
        x[largest] = 1.0;
    }
    norm * estimate
}

/// The error an attempt ends in is the one expected: its text names what failed. Passes at 0.
pub(super) fn refused<T>(
    case: &mut Case,
    what: &str,
    attempt: Result<T, impl std::fmt::Display>,
    names: &str,
) {
    let (value, note) = match attempt {
        Ok(_) => (f64::NAN, "no error".to_string()),
        Err(error) => (if error.to_string().contains(names) { 0.0 } else { 1.0 }, error.to_string()),
    };
    case.at_most(what, value, 0.0, "-").note(note);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::row::Rows;

    /// An error that names something else, and none at all, are failed rows.
    #[test]
    fn errors_must_name_what_they_should() {
        let mut rows = Rows::new("stiff");
        rows.case("errors", |case| {
            refused(case, "right", Err::<(), _>("step 7: edge 3"), "step 7");
            refused(case, "another step", Err::<(), _>("step 8: edge 3"), "step 7");
            refused(case, "no error", Ok::<(), &str>(()), "step 7");
            Ok(())
        });
        let pass: Vec<bool> = rows.finish().iter().map(|row| row.pass).collect();
        assert_eq!(pass, [true, false, false]);
    }

    #[test]
    fn the_condition_estimate_is_right_for_known_matrices() {
        // diag(1, 1e-6) as a dense and as a band matrix; a singular one
        let dense = condition(2, &Structure::Dense, &[1.0, 0.0, 0.0, 1e-6]);
        let band = condition(2, &Structure::SymmetricBand { half_bandwidth: 1 }, &[0.0, 1.0, 0.0, 1e-6]);
        assert!((dense / 1e6 - 1.0).abs() < 1e-12 && (band / 1e6 - 1.0).abs() < 1e-12, "{dense} {band}");
        assert_eq!(condition(2, &Structure::Dense, &[1.0, 1.0, 1.0, 1.0]), f64::INFINITY);
    }
}
