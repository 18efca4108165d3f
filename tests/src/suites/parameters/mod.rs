//! Constants estimated beside the state.

mod beam;
mod filter;
mod gradients;
mod gripped;
mod joint;
mod observed;
mod recordings;
mod recovery;
mod shapes;
mod supports;

use super::Options;
use crate::row::{Row, Rows};

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("parameters").of(options);
    gradients::run(&mut rows);
    filter::run(&mut rows);
    joint::run(&mut rows);
    recordings::run(&mut rows, options.quick);
    recovery::run(&mut rows);
    observed::run(&mut rows);
    shapes::run(&mut rows, options);
    beam::run(&mut rows, options);
    supports::run(&mut rows, options.quick);
    if options.full {
        gripped::run(&mut rows);
    }
    rows.finish()
}
