//! One test per suite, on the rows that `cargo xtask verify --quick` prints.

use tests::{Options, Row, SUITES, run, table};

/// Every row passes, there are rows, and every bound that is not zero has its reason.
fn check(suite: &str) {
    let report = run(suite, &Options { quick: true, ..Options::default() });
    assert!(!report.rows.is_empty(), "{suite} has no rows");
    let failed: Vec<Row> = report.rows.iter().filter(|row| !row.pass).cloned().collect();
    assert!(failed.is_empty(), "{} rows failed:\n{}", failed.len(), table(&failed));
    let without = |r: &Row| r.bound != 0.0 && r.bound.is_finite() && r.reason.is_empty();
    let without: Vec<Row> = report.rows.into_iter().filter(without).collect();
    assert!(without.is_empty(), "bounds without a reason:\n{}", table(&without));
}

/// A test of each suite, and their names.
macro_rules! suites {
    ($($name:ident),* $(,)?) => {
        $(#[test] fn $name() { check(stringify!($name)); })*
        const TESTED: &[&str] = &[$(stringify!($name)),*];
    };
}

suites!(linalg, adjoint, taylor, hessian, golden, counts, order, equivalence, paper, stiff, field);

#[test]
fn every_suite_has_a_test() {
    let names: Vec<&str> = SUITES.iter().map(|s| s.name).collect();
    assert_eq!(names, TESTED);
}
