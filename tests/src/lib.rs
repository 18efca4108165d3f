//! Verification suites of Varda.
//!
//! Every suite returns rows: one checked number each, with its bound. The binary prints them (`cargo xtask
//! verify`), the tests assert that every row passes.

// `!(value <= bound)` is how a NaN is made to fail.
#![allow(clippy::neg_cmp_op_on_partial_ord)]

pub mod command;
pub mod row;
pub mod suites;

pub use row::{Case, Row, Rows, Summary, Work, summary, table};
pub use suites::{Options, SUITES, read_fixture, run, stability};
