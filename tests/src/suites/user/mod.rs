//! What users get wrong: refused, named, or read right.

mod components;
mod inputs;

use super::{Options, folder};
use crate::row::{Row, Rows};

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("user").of(options);
    inputs::run(&mut rows);
    components::run(&mut rows);
    rows.finish()
}
