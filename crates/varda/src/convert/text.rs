//! Cells of text tables.

use super::recording::{at, data};
use crate::Error;

/// The text of a file: UTF-8 with or without a byte-order mark.
///
/// # Errors
/// [`Error::Data`] that names the encoding.
pub(super) fn decoded(file: &str, bytes: &[u8]) -> Result<String, Error> {
    if bytes.is_empty() {
        return Err(data(file, "the file is empty"));
    }
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(data(file, "UTF-16 text: save it as UTF-8"));
    }
    let bytes = bytes.strip_prefix(&[0xef, 0xbb, 0xbf]).unwrap_or(bytes);
    match std::str::from_utf8(bytes) {
        Ok(text) => Ok(text.to_string()),
        Err(e) => {
            let line = 1 + bytes[..e.valid_up_to()].iter().filter(|b| **b == b'\n').count();
            Err(at(file, line, "neither a C3D file nor UTF-8 text"))
        }
    }
}

/// A table of text with its line numbers.
pub(super) struct Lines<'a> {
    pub(super) file: &'a str,
    pub(super) separator: char,
    lines: Vec<&'a str>,
}

impl<'a> Lines<'a> {
    pub(super) fn new(file: &'a str, text: &'a str, separator: char) -> Self {
        Lines { file, separator, lines: text.lines().collect() }
    }

    pub(super) fn len(&self) -> usize {
        self.lines.len()
    }

    /// The line with this number from 0, `None` after the last.
    pub(super) fn line(&self, index: usize) -> Option<&'a str> {
        self.lines.get(index).copied()
    }

    /// Its cells, without blanks and quotes around them.
    ///
    /// # Errors
    /// [`Error::Data`] where the file has ended.
    pub(super) fn cells(&self, index: usize, what: &str) -> Result<Vec<&'a str>, Error> {
        let Some(line) = self.line(index) else {
            return Err(at(self.file, index + 1, format!("the file ends where {what} should be")));
        };
        Ok(line.split(self.separator).map(|c| c.trim().trim_matches('"').trim()).collect())
    }

    pub(super) fn is_blank(&self, index: usize) -> bool {
        self.line(index).is_none_or(|l| l.chars().all(|c| c.is_whitespace() || c == self.separator))
    }

    pub(super) fn bad(&self, index: usize, message: impl Into<String>) -> Error {
        at(self.file, index + 1, message)
    }

    /// The number of a cell; `None` where it is empty or a spelling of "not a number".
    ///
    /// # Errors
    /// [`Error::Data`] for anything else.
    pub(super) fn number(&self, index: usize, cell: &str, what: &str) -> Result<Option<f64>, Error> {
        if cell.is_empty() || cell.eq_ignore_ascii_case("nan") {
            return Ok(None);
        }
        match cell.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            _ => Err(self.bad(index, format!("{what} = {cell:?} is not a number"))),
        }
    }

    /// Three coordinates from a column on; `None` where none of them was seen.
    ///
    /// # Errors
    /// [`Error::Data`] where one or two of them are missing.
    pub(super) fn place(
        &self,
        index: usize,
        cells: &[&str],
        column: usize,
        marker: &str,
    ) -> Result<Option<[f64; 3]>, Error> {
        let mut place = [None; 3];
        for (c, value) in place.iter_mut().enumerate() {
            let what = format!("{} of marker {marker}", ["x", "y", "z"][c]);
            *value = self.number(index, cells.get(column + c).copied().unwrap_or(""), &what)?;
        }
        match place {
            [Some(x), Some(y), Some(z)] => Ok(Some([x, y, z])),
            [None, None, None] => Ok(None),
            _ => Err(self.bad(index, format!("marker {marker} has not all of its three coordinates"))),
        }
    }
}
