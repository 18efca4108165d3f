//! Methods that must agree, on problems where they must.

mod common;
mod ensemble;
mod linear;
mod minima;
mod posterior;
mod weak;

pub(super) use linear::{closed_form, linear_3dvar};

use super::Options;
use crate::row::{Row, Rows};

pub(super) fn run(_options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("equivalence");
    linear::rows(&mut rows);
    weak::rows(&mut rows);
    ensemble::rows(&mut rows);
    posterior::rows(&mut rows);
    minima::rows(&mut rows);
    rows.finish()
}
