//! Files of fixtures, read with care, and how vectors are compared with theirs.

use std::io::Read;
use std::path::{Path, PathBuf};

/// Our own copies.
pub(super) fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures")
}

/// Most bytes of a fixture's file.
pub(super) const FILE_BYTES: u64 = 1 << 26;

/// What a file says, checked against itself before anything is computed with it.
pub(super) trait Fixture: serde::de::DeserializeOwned {
    /// Whether sizes are sane and lists have the lengths they must have; an error names the field.
    fn validate(&self) -> Result<(), String>;

    fn parse(text: &str) -> Result<Self, String> {
        let fixture: Self = serde_json::from_str(text).map_err(|e| e.to_string())?;
        fixture.validate()?;
        Ok(fixture)
    }

    /// Of a file, which errors name.
    fn read(path: &Path) -> Result<Self, String> {
        let named = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
        let mut text = String::new();
        let file = std::fs::File::open(path).map_err(|e| named(&e))?;
        file.take(FILE_BYTES + 1).read_to_string(&mut text).map_err(|e| named(&e))?;
        if text.len() as u64 > FILE_BYTES {
            return Err(named(&format!("more than {FILE_BYTES} bytes")));
        }
        Self::parse(&text).map_err(|e| named(&e))
    }
}

/// An error unless a size is at least 1 and at most what a fixture may have.
pub(super) fn expect_size(what: &str, found: usize, most: usize) -> Result<(), String> {
    if (1..=most).contains(&found) { Ok(()) } else { Err(format!("{what} = {found}, expected 1 to {most}")) }
}

/// An error unless a list has the length it should have.
pub(super) fn expect_length(what: &str, found: usize, expected: usize) -> Result<(), String> {
    if found == expected { Ok(()) } else { Err(format!("{what} has {found} entries, expected {expected}")) }
}

/// max |a_i − b_i|, NaN if any is.
pub(super) fn largest_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len(), "lengths of the vectors compared");
    a.iter().zip(b).fold(0.0, |m: f64, (a, b)| greater(m, (a - b).abs()))
}

/// max |a_i|, NaN if any is.
pub(super) fn largest(a: &[f64]) -> f64 {
    a.iter().fold(0.0, |m: f64, a| greater(m, a.abs()))
}

/// The greater of two; NaN stays (`f64::max` would drop it).
pub(super) fn greater(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

pub(super) fn norm(a: &[f64]) -> f64 {
    a.iter().map(|a| a * a).sum::<f64>().sqrt()
}
