//! One test per suite, on the rows that `cargo xtask verify` prints.

use tests::{Options, Row, run, table};

/// Every row passes, and there are rows.
fn check(suite: &str) -> Vec<Row> {
    let report = run(suite, &Options { quick: true, ..Options::default() });
    assert!(!report.rows.is_empty(), "{suite} has no rows");
    let failed: Vec<Row> = report.rows.iter().filter(|row| !row.pass).cloned().collect();
    assert!(failed.is_empty(), "{} rows failed:\n{}", failed.len(), table(&failed));
    report.rows
}

#[test]
fn adjoint() {
    check("adjoint");
}

#[test]
fn taylor() {
    check("taylor");
}

#[test]
fn hessian() {
    check("hessian");
}

#[test]
fn golden() {
    check("golden");
}

#[test]
fn counts() {
    check("counts");
}

#[test]
fn order() {
    check("order");
}

#[test]
fn equivalence() {
    check("equivalence");
}

#[test]
fn paper() {
    check("paper");
}

#[test]
fn stiff() {
    let rows = check("stiff");
    let without: Vec<_> =
        rows.into_iter().filter(|r| r.bound != 0.0 && r.bound.is_finite() && r.reason.is_empty()).collect();
    assert!(without.is_empty(), "bounds without a reason:\n{}", table(&without));
}
