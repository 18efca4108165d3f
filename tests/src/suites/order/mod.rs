//! Orders of convergence in time and in space, and closed forms that a rod converges to.

mod closed;
mod ordinary;
mod rods;
mod slopes;

use super::Options;
use crate::row::{Row, Rows};

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("order");
    ordinary::run(&mut rows);
    rods::run(&mut rows, options.quick);
    closed::run(&mut rows, options.quick);
    rows.finish()
}
