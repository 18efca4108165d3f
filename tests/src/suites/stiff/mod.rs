//! Stiff and extreme cases: the right answer, or an error that names step, vertex or field.
//!
//! Every case gives a measured error with its bound; condition, Newton iterations and extra parts of steps stand in the note,
//! the run time in its own column. `docs/results/stability.md` is made of these rows.

mod assimilation;
mod chaos;
mod covariance;
mod document;
mod implicit;
mod rod;
mod rod_shapes;
mod rod_statics;

use super::{Options, Report};
use crate::row::{Case, Row, Rows};
use varda_implicit::{Counts, Interval, LinearSolver, Model, Structure};

pub(super) fn run(options: &Options) -> Report {
    let mut rows = Rows::new("stiff");
    rod::run(&mut rows, options);
    rod_shapes::run(&mut rows, options);
    rod_statics::run(&mut rows);
    implicit::run(&mut rows, options);
    chaos::run(&mut rows, options);
    covariance::run(&mut rows, options);
    assimilation::run(&mut rows, options);

    rows.finish().into()
}

/// The rows of this suite as a document to read.
pub(super) fn document(rows: &[Row]) -> String {
    let own: Vec<Row> = rows.iter().filter(|r| r.suite == "stiff").cloned().collect();
    document::document(&own)
}

/// An interval of time that stands alone.
fn interval(index: usize, start: f64, length: f64) -> Interval {
    Interval { index, start, length, previous: None }
}

/// "condition 1e5, 34 Newton iterations, 0 extra parts" since `before`; a condition that is NaN is not told.
fn work(model: &dyn Model, before: &Counts, condition: f64) -> String {
    let now = model.counts();
    let condition = if condition.is_nan() { String::new() } else { format!("condition {condition:.0e}, ") };
    format!(
        "{condition}{} Newton iterations, {} extra parts",
        now.newton_iterations - before.newton_iterations,
        now.substeps - before.substeps
    )
}

/// An estimate of the condition number ‖A‖₁ ‖A⁻¹‖₁ of a matrix that was given by its values: Hager's estimator (Higham 2002,
/// algorithm 15.1), right within a small factor nearly always. Infinite for a singular matrix.
fn condition(n: usize, structure: &Structure, values: &[f64]) -> f64 {
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
fn refused<T>(case: &mut Case, what: &str, attempt: Result<T, impl std::fmt::Display>, names: &str) {
    let (value, note) = match attempt {
        Ok(_) => (f64::NAN, "no error".to_string()),
        Err(error) => (if error.to_string().contains(names) { 0.0 } else { 1.0 }, error.to_string()),
    };
    case.at_most(what, value, 0.0, "-").note(note);
}
