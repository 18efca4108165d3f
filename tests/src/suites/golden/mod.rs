//! Fixtures made elsewhere: rods with 50-digit derivatives, assimilation windows and twins with known minima.

mod der;
mod hanging_rod;
mod section9;
pub(super) mod twin;

use super::Options;
use crate::row::{Case, Outcome, Row, Rows};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use varda_assimilation::{
    Error, GaussNewton, Iteration, Minimizer, Minimum, Status, TrustRegionOptions, continuation,
};

/// Our own copies.
fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures")
}

pub(super) fn run(options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("golden");
    let folder = options.fixtures.clone().unwrap_or_else(shipped);
    let found = fixtures(&mut rows, &folder);
    if found == 0 {
        let reason = format!("{}: no fixtures in der, hanging-rod or twin", folder.display());
        rows.case("fixtures", |_| Err(reason.into()));
    }
    section9::run(&mut rows);
    rows.finish()
}

/// Checks every fixture in a folder. Returns how many there were.
fn fixtures(rows: &mut Rows, folder: &Path) -> usize {
    type Check = fn(&mut Case, &Path) -> Outcome;
    let kinds: [(&str, bool, Check); 3] =
        [("der", false, der::check), ("hanging-rod", true, hanging_rod::check), ("twin", false, twin::check)];
    let mut found = 0;
    for (kind, is_folder, check) in kinds {
        let Ok(entries) = std::fs::read_dir(folder.join(kind)) else { continue };
        let mut paths: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
        paths.retain(|p| if is_folder { p.is_dir() } else { p.extension().is_some_and(|e| e == "json") });
        paths.sort();
        found += paths.len();
        for path in paths {
            // a folder's name may have dots in it
            let name = if is_folder { path.file_name() } else { path.file_stem() };
            let name = name.unwrap_or_default().to_string_lossy().into_owned();
            rows.case(&name, |case| check(case, &path));
        }
    }
    found
}

/// A cost may have several minima. Minimizes it twice, straight from `v` and through larger observation errors (σ × 10, 3, 1), and keeps
/// the lower end in `v`; says which that was.
fn minimize(cost: &mut dyn GaussNewton, v: &mut [f64]) -> Result<(Minimum, String), Error> {
    // Tighter than the default: reference minima are compared to eight digits.
    let tight = TrustRegionOptions { gradient_tolerance: 1e-9, ..TrustRegionOptions::default() };
    let minimizer = Minimizer::TrustRegion(tight);
    let go_on = &mut |_: &Iteration| ControlFlow::Continue(());
    let mut staged = v.to_vec();
    let mut best = minimizer.minimize(cost, v, go_on)?;
    let mut how = "from the background";
    let found = continuation(&minimizer, cost, &mut staged, &[10.0, 3.0, 1.0], go_on)?;
    // Two ends of one minimum differ by rounding; an end that is not a minimum is worth less than one that is.
    let lower = found.value < best.value * (1.0 - 1e-9);
    if lower || (best.status != Status::Converged && found.status == Status::Converged) {
        (best, how) = (found, "through larger observation errors");
        v.copy_from_slice(&staged);
    }
    let how = describe(&best, how);
    Ok((best, how))
}

fn describe(minimum: &Minimum, how: &str) -> String {
    let reduction = minimum.gradient_norm / minimum.gradient_norm_first;
    let Minimum { status, outer_iterations, .. } = minimum;
    format!("{status:?}, {outer_iterations} iterations, |g|/|g₀| {reduction:.1e}, {how}")
}

/// A file as a value; errors name the file.
fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, String> {
    let named = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
    let text = std::fs::read_to_string(path).map_err(|e| named(&e))?;
    serde_json::from_str(&text).map_err(|e| named(&e))
}

/// An error unless a list has the length it should have.
fn expect_length(what: &str, found: usize, expected: usize) -> Result<(), String> {
    if found == expected { Ok(()) } else { Err(format!("{what} has {found} entries, expected {expected}")) }
}

/// max |a_i − b_i|, NaN if any is.
fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "lengths of the vectors compared");
    a.iter().zip(b).fold(0.0, |m: f64, (a, b)| greater(m, (a - b).abs()))
}

/// max |a_i|, NaN if any is.
fn largest(a: &[f64]) -> f64 {
    a.iter().fold(0.0, |m: f64, a| greater(m, a.abs()))
}

/// The greater of two; NaN stays (`f64::max` would drop it).
fn greater(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

fn norm(a: &[f64]) -> f64 {
    a.iter().map(|a| a * a).sum::<f64>().sqrt()
}
