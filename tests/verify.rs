//! One test per suite, on the rows that `cargo xtask verify --quick` prints.

use std::collections::BTreeSet;
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

suites!(
    linalg,
    adjoint,
    taylor,
    hessian,
    golden,
    counts,
    order,
    equivalence,
    paper,
    stiff,
    field,
    scaling,
    user,
    parameters,
    coverage
);

#[test]
fn every_suite_has_a_test() {
    let names: Vec<&str> = SUITES.iter().map(|s| s.name).collect();
    assert_eq!(names, TESTED);
}

/// A quick run of suite stiff: a tenth of every grid, rounded up, always the same; and every other case.
#[test]
fn a_quick_run_is_a_tenth_of_every_grid_of_suite_stiff() {
    let of = |quick| run("stiff", &Options { quick, names_only: true, ..Options::default() });
    let (quick, whole) = (of(true), of(false));
    assert!(quick.rows.is_empty() && whole.grids.len() > 20, "{} grids", whole.grids.len());
    assert_eq!(quick.grids.len(), whole.grids.len());
    for (q, w) in quick.grids.iter().zip(&whole.grids) {
        assert_eq!((&q.name, q.values, w.taken), (&w.name, w.values, w.values));
        assert_eq!(q.taken, q.values.div_ceil(10), "{}", q.name);
    }
    let names: BTreeSet<&String> = whole.grids.iter().map(|grid| &grid.name).collect();
    assert_eq!(names.len(), whole.grids.len(), "two grids have one name");
    // what is left out is left out by a grid: nothing else is missing
    let (some, all): (BTreeSet<_>, BTreeSet<_>) =
        (quick.cases.iter().collect(), whole.cases.iter().collect());
    assert_eq!((some.len(), all.len()), (quick.cases.len(), whole.cases.len()), "two cases have one name");
    assert!(some.is_subset(&all), "{:?}", some.difference(&all));
    let left_out: usize = quick.grids.iter().map(|grid| grid.values - grid.taken).sum();
    assert_eq!(all.len() - some.len(), left_out);
    assert_eq!(quick.cases, of(true).cases);
}
