//! CSV files of users: observations of a rod, a background, the motion of a support.
//!
//! Every error names file and line. An empty cell means "not observed"; NaN and infinities are errors.
//! Columns are parted by commas, semicolons or tabs, whichever the header has; with the latter two a decimal
//! comma is read. A column may be in another unit, by its name: `x_mm`, `x_cm` for `x_m`, `time_ms` for
//! `time_s`.

use crate::Error;

/// One row of an observation file, in the recording's own time and axes.
#[derive(Debug, Clone, PartialEq)]
pub struct ObservedRow {
    /// Line of the file, from 1.
    pub line: usize,
    /// Time \[s\].
    pub time: f64,
    /// Half a unit of the last digit that the file's times are written with \[s\].
    pub time_rounding: f64,
    /// What was seen.
    pub subject: Subject,
    /// Arc length of a named marker, where the file has that too \[m\].
    pub arc_length: Option<f64>,
    /// Its coordinates \[m\]; `None` was not observed.
    pub position: [Option<f64>; 3],
    /// Standard deviation of a coordinate \[m\], if the file has it.
    pub sigma: Option<f64>,
}

/// The place that a row observes.
#[derive(Debug, Clone, PartialEq)]
pub enum Subject {
    /// The point of the centreline at an arc length \[m\].
    ArcLength(f64),
    /// A named marker.
    Marker(String),
}

/// Reads observations: header `time_s,s_m,x_m,y_m,z_m` or `time_s,marker,x_m,y_m,z_m`, optionally `sigma_m`,
/// and with names `s_m` too; columns in any order. `file` is its name in messages.
///
/// # Errors
/// [`Error::Data`] naming file and line.
pub fn observations(file: &str, text: &str) -> Result<Vec<ObservedRow>, Error> {
    let expected = "time_s,s_m,x_m,y_m,z_m or time_s,marker,x_m,y_m,z_m, optionally sigma_m";
    let table =
        Table::open(file, text, &["time_s", "s_m", "marker", "x_m", "y_m", "z_m", "sigma_m"], expected)?;
    if !table.has("time_s") && table.has("x_m") {
        let message = format!(
            "the header has no `time_s`; expected {expected}. A shape without times is for method \
             \"static\": `varda show wire`"
        );
        return Err(table.bad(1, message));
    }
    table.require("time_s", expected)?;
    observed(table, expected)
}

/// Reads a shape without times, its rows at time 0: header `s_m,x_m,y_m,z_m` or `marker,x_m,y_m,z_m`,
/// optionally `sigma_m`.
///
/// # Errors
/// [`Error::Data`] naming file and line.
pub fn shape(file: &str, text: &str) -> Result<Vec<ObservedRow>, Error> {
    let expected = "s_m,x_m,y_m,z_m or marker,x_m,y_m,z_m, optionally sigma_m";
    let names = ["time_s", "s_m", "marker", "x_m", "y_m", "z_m", "sigma_m"];
    let table = Table::open(file, text, &names, expected)?;
    if table.has("time_s") {
        let message = "has `time_s`, and method \"static\" takes one shape without times: average the frames \
                       in which the rod is at rest";
        return Err(table.bad(1, message));
    }
    observed(table, expected)
}

fn observed(mut table: Table, expected: &str) -> Result<Vec<ObservedRow>, Error> {
    for name in ["x_m", "y_m", "z_m"] {
        table.require(name, expected)?;
    }
    let timed = table.has("time_s");
    let by_marker = table.has("marker");
    if !(by_marker || table.has("s_m")) {
        return Err(table.bad(1, format!("the header has neither `s_m` nor `marker`; expected {expected}")));
    }
    let mut rows: Vec<ObservedRow> = Vec::new();
    let mut finest = f64::INFINITY;
    while table.next()? {
        if timed {
            finest = finest.min(table.last_digit("time_s"));
        }
        let subject = if by_marker {
            let name = table.cell("marker");
            if name.is_empty() {
                return Err(table.bad(table.line, "`marker` is empty"));
            }
            Subject::Marker(name.to_string())
        } else {
            Subject::ArcLength(table.needed("s_m")?)
        };
        let sigma = table.number("sigma_m")?;
        if let Some(sigma) = sigma.filter(|s| !(*s > 0.0)) {
            return Err(table.bad(table.line, format!("`sigma_m` = {sigma} must be greater than 0")));
        }
        rows.push(ObservedRow {
            line: table.line,
            time: if timed { table.needed("time_s")? } else { 0.0 },
            time_rounding: 0.0,
            subject,
            arc_length: if by_marker { table.number("s_m")? } else { None },
            position: [table.number("x_m")?, table.number("y_m")?, table.number("z_m")?],
            sigma,
        });
    }
    if rows.is_empty() {
        return Err(table.bad(1, "holds no observations"));
    }
    if timed {
        rows.iter_mut().for_each(|row| row.time_rounding = 0.5 * finest);
    }
    Ok(rows)
}

/// Reads columns of numbers, every cell of them filled; `columns` are the header's names, in any order.
///
/// # Errors
/// [`Error::Data`] naming file and line.
pub fn numbers<const N: usize>(file: &str, text: &str, columns: [&str; N]) -> Result<Vec<[f64; N]>, Error> {
    let rows = filled(file, text, columns, false)?;
    Ok(rows.into_iter().map(|(_, row)| row).collect())
}

/// The same with the line of each row, for a recording: rows that have nothing but the first column were not
/// recorded.
///
/// # Errors
/// [`Error::Data`] naming file and line.
pub fn recorded<const N: usize>(
    file: &str,
    text: &str,
    columns: [&str; N],
) -> Result<Vec<(usize, [f64; N])>, Error> {
    filled(file, text, columns, true)
}

/// The same, where cells may be empty.
///
/// # Errors
/// [`Error::Data`] naming file and line.
pub fn with_gaps(file: &str, text: &str, columns: &[&str]) -> Result<Vec<Vec<Option<f64>>>, Error> {
    let expected = columns.join(",");
    let mut table = Table::open(file, text, columns, &expected)?;
    for name in columns {
        table.require(name, &expected)?;
    }
    let mut rows = Vec::new();
    while table.next()? {
        rows.push(columns.iter().map(|name| table.number(name)).collect::<Result<_, _>>()?);
    }
    Ok(rows)
}

/// Whether the header has a column of this name.
pub fn has_column(text: &str, name: &str) -> bool {
    let (header, delimiter) = header(text);
    header.split(delimiter).any(|column| column.trim_start_matches('\u{feff}').trim() == name)
}

/// Whether the header has places and no times, in whatever units.
pub fn is_shape(text: &str) -> bool {
    let (header, delimiter) = header(text);
    let mut columns = header.split(delimiter).map(|column| column.trim_start_matches('\u{feff}').trim());
    columns.clone().any(|column| column.starts_with("x_")) && !columns.any(|c| c.starts_with("time"))
}

/// The line of the header, and what parts its columns.
fn header(text: &str) -> (&str, char) {
    let line = text.lines().find(|l| !l.is_empty() && !l.starts_with('#')).unwrap_or("");
    (line, [';', '\t'].into_iter().find(|d| line.contains(*d)).unwrap_or(','))
}

fn filled<const N: usize>(
    file: &str,
    text: &str,
    columns: [&str; N],
    gaps: bool,
) -> Result<Vec<(usize, [f64; N])>, Error> {
    let expected = columns.join(",");
    let mut table = Table::open(file, text, &columns, &expected)?;
    for name in columns {
        table.require(name, &expected)?;
    }
    let mut rows = Vec::new();
    while table.next()? {
        if gaps && columns[1..].iter().all(|name| table.cell(name).is_empty()) {
            continue;
        }
        let mut row = [0.0; N];
        for (value, name) in row.iter_mut().zip(columns) {
            *value = table.needed(name)?;
        }
        rows.push((table.line, row));
    }
    Ok(rows)
}

/// Larger numbers overflow when they are squared and summed.
const LARGEST: f64 = 1e50;

/// A CSV file being read row by row.
pub(super) struct Table<'a> {
    file: &'a str,
    text: &'a str,
    reader: csv::Reader<&'a [u8]>,
    columns: Vec<String>,
    /// What the numbers of a column are multiplied by.
    factors: Vec<f64>,
    decimal_comma: bool,
    record: csv::StringRecord,
    line: usize,
}

impl<'a> Table<'a> {
    pub(super) fn open(file: &'a str, text: &'a str, known: &[&str], expected: &str) -> Result<Self, Error> {
        let (_, delimiter) = header(text);
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .comment(Some(b'#'))
            .delimiter(delimiter as u8)
            .from_reader(text.as_bytes());
        let (columns, factors) = match reader.headers() {
            Ok(header) => {
                header.iter().map(|c| in_known_unit(c.trim_start_matches('\u{feff}'), known)).unzip()
            }
            Err(e) => return Err(Error::Data { place: format!("{file}:1"), message: e.to_string() }),
        };
        let decimal_comma = delimiter != ',';
        let record = csv::StringRecord::new();
        let table = Table { file, text, reader, columns, factors, decimal_comma, record, line: 1 };
        for (i, name) in table.columns.iter().enumerate() {
            if !known.contains(&name.as_str()) {
                return Err(table.bad(1, format!("unknown column {name:?}; expected the header {expected}")));
            }
            if table.columns[..i].contains(name) {
                return Err(table.bad(1, format!("the column {name:?} is there twice")));
            }
        }
        Ok(table)
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.column(name).is_some()
    }

    pub(super) fn require(&self, name: &str, expected: &str) -> Result<(), Error> {
        if self.has(name) {
            Ok(())
        } else {
            let aside = match name {
                "x_m" | "y_m" | "z_m" => ". A coordinate that was not seen is a column of empty cells",
                _ => "",
            };
            Err(self.bad(1, format!("no column {name:?}; expected the header {expected}{aside}")))
        }
    }

    /// Reads the next row; whether there is one.
    ///
    /// # Errors
    /// A row of another length than the header.
    pub(super) fn next(&mut self) -> Result<bool, Error> {
        match self.reader.read_record(&mut self.record) {
            Ok(more) => {
                if let Some(at) = self.record.position() {
                    // The reader's position is before any empty lines and comments that it skips.
                    let rest = &self.text[(at.byte() as usize).min(self.text.len())..];
                    let skipped = rest.lines().take_while(|l| l.is_empty() || l.starts_with('#')).count();
                    self.line = at.line() as usize + skipped;
                }
                Ok(more)
            }
            Err(e) => {
                let line = e.position().map_or(self.line, |p| p.line() as usize);
                Err(self.bad(
                    line,
                    format!("a row of another length than the header ({} columns)", self.columns.len()),
                ))
            }
        }
    }

    pub(super) fn cell(&self, name: &str) -> &str {
        self.column(name).and_then(|i| self.record.get(i)).unwrap_or("")
    }

    fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|c| c == name)
    }

    /// The number in a cell; `None` where the cell is empty or there is no such column.
    pub(super) fn number(&self, name: &str) -> Result<Option<f64>, Error> {
        let cell = self.cell(name);
        if cell.is_empty() {
            return Ok(None);
        }
        let point = if self.decimal_comma { cell.replacen(',', ".", 1) } else { cell.to_string() };
        let factor = self.column(name).map_or(1.0, |i| self.factors[i]);
        match point.parse::<f64>().map(|value| value * factor) {
            Ok(value) if value.abs() <= LARGEST => Ok(Some(value)),
            Ok(value) if value.is_finite() => {
                Err(self.bad(self.line, format!("`{name}` = {value:e} is larger than {LARGEST:e}")))
            }
            Ok(value) => Err(self.bad(
                self.line,
                format!("`{name}` is {value}: leave the cell empty where nothing was observed"),
            )),
            Err(_) => Err(self.bad(self.line, format!("`{name}` = {cell:?} is not a number"))),
        }
    }

    /// One unit of the last digit of the number in a cell, in the unit of the known column.
    pub(super) fn last_digit(&self, name: &str) -> f64 {
        let cell = self.cell(name);
        let (digits, exponent) = cell.split_once(['e', 'E']).unwrap_or((cell, "0"));
        let decimals = digits.split_once(['.', ',']).map_or(0, |(_, decimals)| decimals.len());
        let exponent = exponent.parse::<i32>().unwrap_or(0).saturating_sub(decimals as i32);
        self.column(name).map_or(1.0, |i| self.factors[i]) * 10f64.powi(exponent)
    }

    pub(super) fn needed(&self, name: &str) -> Result<f64, Error> {
        self.number(name)?.ok_or_else(|| self.bad(self.line, format!("`{name}` is empty")))
    }

    /// The line of the row that was read.
    pub(super) fn line(&self) -> usize {
        self.line
    }

    pub(super) fn bad(&self, line: usize, message: impl Into<String>) -> Error {
        Error::Data { place: format!("{}:{line}", self.file), message: message.into() }
    }
}

/// The known column that this one is, perhaps in another unit, and the factor of that.
fn in_known_unit(name: &str, known: &[&str]) -> (String, f64) {
    let units = [("_m", "_mm", 1e-3), ("_m", "_cm", 1e-2), ("time_s", "time_ms", 1e-3)];
    let found = known.iter().find_map(|known| {
        let (_, _, factor) = units.iter().find(|(own, other, _)| {
            (known.ends_with(own) || known.contains(&format!("{own}_")))
                && known.replacen(own, other, 1) == name
        })?;
        Some((known.to_string(), *factor))
    });
    found.unwrap_or_else(|| (name.to_string(), 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        observations("obs.csv", text).unwrap_err().to_string()
    }

    #[test]
    fn empty_cells_are_not_observed() {
        let rows =
            observations("o", "time_s,s_m,x_m,y_m,z_m,sigma_m\n0.5,1.0,1,,3,0.1\n0.6,0.5,,,,\n").unwrap();
        assert_eq!(rows[0].position, [Some(1.0), None, Some(3.0)]);
        assert_eq!(rows[0].sigma, Some(0.1));
        assert_eq!((rows[1].line, rows[1].position), (3, [None; 3]));
        assert_eq!(rows[1].subject, Subject::ArcLength(0.5));
    }

    #[test]
    fn markers_are_names_and_columns_may_be_in_any_order() {
        let rows = observations("o", "marker,time_s,z_m,y_m,x_m\ntip,0.25,3,2,1\n").unwrap();
        assert_eq!(rows[0].subject, Subject::Marker("tip".into()));
        assert_eq!(rows[0].position, [Some(1.0), Some(2.0), Some(3.0)]);
    }

    #[test]
    fn times_are_known_to_the_digits_of_the_file() {
        let rounding = |text: &str| observations("o", text).unwrap()[0].time_rounding;
        let close = |a: f64, b: f64| (a - b).abs() <= 1e-12 * b;
        assert!(close(rounding("time_s,s_m,x_m,y_m,z_m\n0,1,0,0,0\n0.0042,1,0,0,0\n"), 5e-5));
        assert!(close(rounding("time_ms,s_m,x_m,y_m,z_m\n0,1,0,0,0\n4.17,1,0,0,0\n"), 5e-6));
        assert!(close(rounding("time_s;s_m;x_m;y_m;z_m\n0,25;1;0;0;0\n1e-3;1;0;0;0\n"), 5e-4));
        assert!(close(rounding("time_s,s_m,x_m,y_m,z_m\n2,1,0,0,0\n"), 0.5));
    }

    #[test]
    fn other_units_separators_and_decimal_commas_are_read() {
        let rows = observations("o", "time_s,s_m,x_m,y_m,z_m,sigma_m\n0.5,1,0.0015,,-2,0.001\n").unwrap();
        for text in [
            "\u{feff}time_ms,s_m,x_mm,y_mm,z_m,sigma_mm\n500,1,1.5,,-2,1\n",
            "time_s;s_m;x_cm;y_m;z_cm;sigma_m\n0,5;1,0;0,15;;-200;1e-3\n",
            "time_s\ts_cm\tx_m\ty_m\tz_m\tsigma_m\r\n0.5\t100\t0.0015\t\t-2\t0,001\r\n",
        ] {
            let read = observations("o", text).unwrap();
            let close = |a: f64, b: f64| (a - b).abs() <= 1e-15 * b.abs();
            assert!(close(read[0].time, rows[0].time) && close(read[0].sigma.unwrap(), 0.001), "{text}");
            let [x, y, z] = read[0].position;
            assert!(close(x.unwrap(), 0.0015) && y.is_none() && close(z.unwrap(), -2.0), "{text}");
            assert_eq!(read[0].subject, rows[0].subject);
        }
        assert!(message("time_s,s_m,x_m,x_mm,y_m,z_m\n").contains("\"x_m\" is there twice"));
        let rows = numbers("v", "vertex,vx_mm_s\n3,25\n", ["vertex", "vx_m_s"]).unwrap();
        assert!((rows[0][1] - 0.025).abs() < 1e-17);
    }

    #[test]
    fn refusals_name_file_and_line() {
        let header = "time_s,s_m,x_m,y_m,z_m\n";
        let all = [
            (format!("{header}0,1,0,0,0\n0.1,1,0,NaN,0\n"), "obs.csv:3", "`y_m` is NaN"),
            (format!("{header}0,1,0,0,0\n\n0.1,1,0,abc,0\n"), "obs.csv:4", "not a number"),
            (format!("{header}0,1,0,0\n"), "obs.csv:2", "5 columns"),
            (format!("{header},1,0,0,0\n"), "obs.csv:2", "`time_s` is empty"),
            ("time_s,s_m,x,y_m,z_m\n".into(), "obs.csv:1", "unknown column \"x\""),
            ("time_s,x_m,y_m,z_m\n".into(), "obs.csv:1", "neither `s_m` nor `marker`"),
            ("time_s,s_m,x_m,y_m,z_m,sigma_m\n0,1,0,0,0,-1\n".into(), "obs.csv:2", "greater than 0"),
            (header.into(), "obs.csv:1", "no observations"),
        ];
        for (text, place, what) in all {
            let message = message(&text);
            assert!(message.starts_with(place) && message.contains(what), "{message}");
        }
    }
}
