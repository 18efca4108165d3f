//! Stiff and extreme cases: the right answer, or an error that names step, vertex or field.
//!
//! Every row has a measured error, its bound and the reason of the bound; condition, Newton iterations, extra
//! parts of steps and run time have columns of their own. A bound of zero needs no reason: an exact count, or
//! an error whose text names what it should. `docs/results/stability.md` is made of these rows.

mod assimilation;
mod beyond;
mod case4;
mod chaos;
mod common;
mod covariance;
mod document;
mod implicit;
mod loads;
mod rod;
mod rod_frames;
mod rod_shapes;
mod rod_statics;
mod spins;

use super::{Options, Report};
use crate::row::{Row, Rows};

pub(super) fn run(options: &Options) -> Report {
    let mut rows = Rows::new("stiff").of(options);
    rows.area("rod");
    rod::run(&mut rows);
    rod_shapes::run(&mut rows);
    rod_frames::run(&mut rows);
    rod_statics::run(&mut rows);
    loads::run(&mut rows);
    spins::run(&mut rows);
    rows.area("implicit");
    implicit::run(&mut rows);
    rows.area("chaos");
    chaos::run(&mut rows, options);
    rows.area("covariance");
    covariance::run(&mut rows);
    rows.area("assimilation");
    assimilation::run(&mut rows);
    case4::run(&mut rows, options);
    rows.area("beyond");
    beyond::run(&mut rows);

    rows.report()
}

/// The rows of this suite as a document to read.
pub(super) fn document(rows: &[Row]) -> String {
    let own: Vec<Row> = rows.iter().filter(|r| r.suite == "stiff").cloned().collect();
    document::document(&own)
}
