//! One test per suite, on the rows that `cargo xtask verify` prints.

use tests::{Options, run, table};

/// Every row passes, and there are rows.
fn check(suite: &str) {
    let report = run(suite, &Options { quick: true, ..Options::default() });
    assert!(!report.rows.is_empty(), "{suite} has no rows");
    let failed: Vec<_> = report.rows.into_iter().filter(|row| !row.pass).collect();
    assert!(failed.is_empty(), "{} rows failed:\n{}", failed.len(), table(&failed));
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
    check("stiff");
}
