//! Rows of an observation file of a model that is not a rod.

use super::csv::Table;
use crate::Error;

/// One row, in the recording's own time.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ComponentRow {
    /// Line of the file, from 1.
    pub(super) line: usize,
    /// Time \[s\].
    pub(super) time: f64,
    /// Half a unit of the last digit that the file's times are written with \[s\].
    pub(super) time_rounding: f64,
    /// What was seen.
    pub(super) subject: Subject,
    /// Its value; `None` was not observed.
    pub(super) value: Option<f64>,
    /// Its standard deviation, if the file has it.
    pub(super) sigma: Option<f64>,
}

/// What a row observes.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Subject {
    /// A component by its name or number, as written.
    Component(String),
    /// The place on the line \[m\].
    Place(f64),
}

/// Reads rows: header `time_s,component,value` or `time_s,s_m,value`, optionally `sigma`; columns in any
/// order. `file` is its name in messages.
///
/// # Errors
/// [`Error::Data`] naming file and line.
pub(super) fn rows(file: &str, text: &str) -> Result<Vec<ComponentRow>, Error> {
    let expected = "time_s,component,value or, of a field along a line, time_s,s_m,value; optionally sigma";
    let mut table = Table::open(file, text, &["time_s", "component", "s_m", "value", "sigma"], expected)?;
    for name in ["time_s", "value"] {
        table.require(name, expected)?;
    }
    let by_place = match (table.has("s_m"), table.has("component")) {
        (true, true) => {
            return Err(table.bad(1, "has both `component` and `s_m`: a row is about one or the other"));
        }
        (false, false) => {
            let message = format!("the header has neither `component` nor `s_m`; expected {expected}");
            return Err(table.bad(1, message));
        }
        (by_place, _) => by_place,
    };
    let mut rows: Vec<ComponentRow> = Vec::new();
    let mut finest = f64::INFINITY;
    while table.next()? {
        finest = finest.min(table.last_digit("time_s"));
        let subject = match by_place {
            true => Subject::Place(table.needed("s_m")?),
            false if table.cell("component").is_empty() => {
                return Err(table.bad(table.line(), "`component` is empty"));
            }
            false => Subject::Component(table.cell("component").to_string()),
        };
        let sigma = table.number("sigma")?;
        if let Some(sigma) = sigma.filter(|s| !(*s > 0.0)) {
            return Err(table.bad(table.line(), format!("`sigma` = {sigma} must be greater than 0")));
        }
        rows.push(ComponentRow {
            line: table.line(),
            time: table.needed("time_s")?,
            time_rounding: 0.0,
            subject,
            value: table.number("value")?,
            sigma,
        });
    }
    if rows.is_empty() {
        return Err(table.bad(1, "holds no observations"));
    }
    rows.iter_mut().for_each(|row| row.time_rounding = 0.5 * finest);
    Ok(rows)
}
