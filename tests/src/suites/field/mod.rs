//! What people bring: rods held anywhere, recorded supports, files as they come.

mod bases;
mod buckling;
mod common;
mod endings;
mod faces;
mod files;
mod forces;
mod free_turn;
mod gripped;
mod loads;
mod rest;
mod twist_inertia;
mod two_ended;

use super::{Options, folder};
use crate::row::{Row, Rows};

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("field").of(options);
    rest::run(options, &mut rows);
    two_ended::run(&mut rows);
    bases::run(options, &mut rows);
    buckling::run(&mut rows);
    files::run(options, &mut rows);
    gripped::run(options, &mut rows);
    faces::run(&mut rows, options.quick);
    endings::run(&mut rows);
    forces::run(options, &mut rows);
    free_turn::run(options, &mut rows);
    loads::run(options, &mut rows);
    twist_inertia::run(&mut rows, options.quick);
    rows.finish()
}
