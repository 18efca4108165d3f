//! One checked number, and how many of them are printed.

use crate::suites::Options;
use serde::Serialize;
use std::fmt::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Instant;

/// What a check may end with instead of rows: a reason, shown in a failed row.
pub type Outcome = Result<(), Box<dyn std::error::Error>>;

/// One checked number. It passes where `value ≤ bound`; a NaN does not. A row that only informs has an
/// infinite bound (null in JSON) and says so in its note.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The suite it belongs to.
    pub suite: &'static str,
    /// What was checked: a fixture, a model.
    pub case: String,
    /// Which quantity.
    pub what: String,
    /// The number compared: mostly an error, normalized as its tolerance is stated.
    pub value: f64,
    /// What it may be at most.
    pub bound: f64,
    /// Unit of value and bound; `-` for none.
    pub unit: &'static str,
    /// Seconds since the row before it in the same case.
    pub seconds: f64,
    /// value ≤ bound.
    pub pass: bool,
    /// Our own number, where there is one: an energy, a cost, a trace, the norm of a vector.
    pub computed: Option<f64>,
    /// Why the bound is what it is. Rows that only inform have none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// What it took, where that was counted.
    #[serde(flatten)]
    pub work: Work,
    /// A remark, or the reason of a failure.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// What a number took. JSON has the columns that were counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Work {
    /// Estimate of a condition number: of ∂G/∂u, of B, of a Hessian.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub condition: Option<f64>,
    /// Newton iterations of all steps together; outer iterations of a minimizer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<usize>,
    /// Extra parts that steps were cut into when Newton's method failed on the whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extra_parts: Option<usize>,
}

impl Row {
    /// Adds why the bound is what it is.
    pub fn because(&mut self, reason: impl Into<String>) -> &mut Row {
        self.reason = reason.into();
        self
    }

    /// Adds what it took.
    pub fn work(&mut self, work: Work) -> &mut Row {
        self.work = work;
        self
    }

    /// Adds our own number.
    pub fn computed(&mut self, computed: f64) -> &mut Row {
        self.computed = Some(computed);
        self
    }

    /// Adds a remark.
    pub fn note(&mut self, note: impl Into<String>) -> &mut Row {
        self.note = note.into();
        self
    }
}

/// A list of values that a suite goes through, with a case for each.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Its name, different from that of every other grid of the suite.
    pub name: String,
    /// How many values it has.
    pub values: usize,
    /// How many of them a run takes: all, or of a quick run a tenth, at least one.
    pub taken: usize,
}

/// What a suite gives.
#[derive(Debug, Default)]
pub struct Report {
    /// Its rows.
    pub rows: Vec<Row>,
    /// Something to read beside them: a table, remarks.
    pub text: String,
    /// The names of its cases, of suite stiff.
    pub cases: Vec<String>,
    /// Its grids, of suite stiff.
    pub grids: Vec<Grid>,
}

impl From<Vec<Row>> for Report {
    fn from(rows: Vec<Row>) -> Report {
        Report { rows, ..Report::default() }
    }
}

/// The rows of one suite while they are collected.
pub struct Rows {
    suite: &'static str,
    area: &'static str,
    reason: &'static str,
    rows: Vec<Row>,
    quick: bool,
    names_only: bool,
    cases: Vec<String>,
    grids: Vec<Grid>,
}

impl Rows {
    /// No rows yet.
    pub fn new(suite: &'static str) -> Rows {
        let (cases, grids) = (Vec::new(), Vec::new());
        Rows { suite, area: "", reason: "", rows: Vec::new(), quick: false, names_only: false, cases, grids }
    }

    /// With the extent of a run.
    pub fn of(mut self, options: &Options) -> Rows {
        (self.quick, self.names_only) = (options.quick, options.names_only);
        self
    }

    /// The values of a grid that this run takes: all, or of a quick run a tenth (rounded up), spread evenly
    /// and always the same.
    pub fn grid<T>(&mut self, name: &str, values: impl IntoIterator<Item = T>) -> Vec<T> {
        let values: Vec<T> = values.into_iter().collect();
        let all = values.len();
        let taken = if self.quick { all.div_ceil(10) } else { all };
        self.grids.push(Grid { name: self.full_name(name), values: all, taken });
        let mut wanted = (0..taken).map(|k| (2 * k + 1) * all / (2 * taken)).peekable();
        values
            .into_iter()
            .enumerate()
            .filter(|(i, _)| wanted.next_if_eq(i).is_some())
            .map(|(_, v)| v)
            .collect()
    }

    fn full_name(&self, name: &str) -> String {
        if self.area.is_empty() { name.to_string() } else { format!("{}: {name}", self.area) }
    }

    /// The names of cases from here on begin with `area` and a colon.
    pub fn area(&mut self, area: &'static str) {
        self.area = area;
    }

    /// The reason of the bounds of all cases from here on, where a row gives none of its own.
    pub fn reason(&mut self, reason: &'static str) {
        self.reason = reason;
    }

    /// Runs the checks of one case. An error or a panic in there is a failed row, not the end of the run.
    pub fn case(&mut self, name: &str, checks: impl FnOnce(&mut Case) -> Outcome) {
        self.cases.push(self.full_name(name));
        if self.names_only {
            return;
        }
        let mut case = self.open(name);
        let reason = match catch_unwind(AssertUnwindSafe(|| checks(&mut case))) {
            Ok(Ok(())) => return,
            Ok(Err(error)) => error.to_string(),
            Err(panic) => {
                let text = panic.downcast_ref::<String>().map(String::as_str);
                format!("panicked: {}", text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("?"))
            }
        };
        case.at_most("completed", f64::NAN, 0.0, "-").note(reason).because("a case must come to its end");
    }

    /// A case that is not guarded: a panic in there is one.
    pub fn open(&mut self, name: &str) -> Case<'_> {
        let name = self.full_name(name);
        let reason = self.reason.to_string();
        Case { suite: self.suite, name, reason, rows: &mut self.rows, since: Instant::now() }
    }

    /// The rows, with the names of cases and the grids.
    pub fn report(self) -> Report {
        Report { rows: self.rows, text: String::new(), cases: self.cases, grids: self.grids }
    }

    /// The rows.
    pub fn finish(self) -> Vec<Row> {
        self.rows
    }
}

/// The rows of one case while they are collected.
pub struct Case<'a> {
    suite: &'static str,
    name: String,
    reason: String,
    rows: &'a mut Vec<Row>,
    since: Instant,
}

impl Case<'_> {
    /// The reason of the bounds of all rows from here on, where a row gives none of its own.
    pub fn reason(&mut self, reason: impl Into<String>) {
        self.reason = reason.into();
    }

    /// A row that passes where value ≤ bound.
    #[allow(clippy::missing_panics_doc)] // a row was just pushed
    pub fn at_most(&mut self, what: &str, value: f64, bound: f64, unit: &'static str) -> &mut Row {
        let seconds = self.since.elapsed().as_secs_f64();
        self.since = Instant::now();
        self.rows.push(Row {
            suite: self.suite,
            case: self.name.clone(),
            what: what.to_string(),
            value,
            bound,
            unit,
            seconds,
            pass: value <= bound,
            computed: None,
            reason: if bound == f64::INFINITY { String::new() } else { self.reason.clone() },
            work: Work::default(),
            note: String::new(),
        });
        self.rows.last_mut().expect("just pushed")
    }

    /// A row that passes where a count is what it should be: value = |count − expected|, bound 0.
    pub fn count(&mut self, what: &str, count: usize, expected: usize) -> &mut Row {
        let row = self.at_most(what, count.abs_diff(expected) as f64, 0.0, "-");
        row.computed(count as f64).note(format!("{count}, expected {expected}")).because("an exact count")
    }

    /// A row that only informs.
    pub fn inform(&mut self, what: &str, value: f64, unit: &'static str) -> &mut Row {
        self.at_most(what, value, f64::INFINITY, unit).computed(value).note("informative")
    }
}

/// Columns of the table; those from `condition` on only where some row has them.
const HEAD: [&str; 13] = [
    "suite",
    "case",
    "what",
    "value",
    "bound",
    "unit",
    "seconds",
    "pass",
    "condition",
    "iterations",
    "parts",
    "note",
    "reason of the bound",
];
const ALWAYS: usize = 8;

/// The rows as text, aligned.
pub fn table(rows: &[Row]) -> String {
    let cells: Vec<[String; 13]> = rows.iter().map(cells).collect();
    let shown: Vec<usize> =
        (0..HEAD.len()).filter(|&i| i < ALWAYS || cells.iter().any(|row| !row[i].is_empty())).collect();
    let head = HEAD.map(str::to_string);
    let mut width = [0; 13];
    for row in cells.iter().chain([&head]) {
        for (w, cell) in width.iter_mut().zip(row) {
            *w = (*w).max(cell.chars().count());
        }
    }
    let mut text = String::new();
    for row in [&head].into_iter().chain(&cells) {
        let mut line = String::new();
        for &i in &shown {
            let (cell, w) = (&row[i], width[i]);
            // numbers to the right, words to the left
            let numeric = matches!(i, 3 | 4 | 6 | 8 | 9 | 10);
            let _ = if numeric { write!(line, "{cell:>w$}  ") } else { write!(line, "{cell:<w$}  ") };
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

fn cells(row: &Row) -> [String; 13] {
    let number = |v: f64| if v == f64::INFINITY { "-".to_string() } else { format!("{v:.3e}") };
    let count = |n: Option<usize>| n.map_or(String::new(), |n| n.to_string());
    let pass = if row.pass { "yes" } else { "NO" };
    [
        row.suite.to_string(),
        row.case.clone(),
        row.what.clone(),
        number(row.value),
        number(row.bound),
        row.unit.to_string(),
        format!("{:.3}", row.seconds),
        pass.to_string(),
        row.work.condition.map_or(String::new(), |c| format!("{c:.0e}")),
        count(row.work.iterations),
        count(row.work.extra_parts),
        row.note.clone(),
        row.reason.clone(),
    ]
}

/// One line on the rows of a suite: checks, failures, seconds, the share of its bound that the closest row
/// uses.
pub fn summary(rows: &[Row]) -> Summary {
    let closest = rows.iter().filter(|r| r.bound.is_finite() && r.bound > 0.0).map(|r| r.value / r.bound);
    Summary {
        checks: rows.iter().filter(|r| r.bound != f64::INFINITY).count(),
        failed: rows.iter().filter(|r| !r.pass).count(),
        seconds: rows.iter().map(|r| r.seconds).sum(),
        closest: closest.fold(f64::NAN, f64::max),
    }
}

/// What [`summary()`] counts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summary {
    /// Rows with a bound.
    pub checks: usize,
    /// Rows that do not pass.
    pub failed: usize,
    /// Seconds of all rows.
    pub seconds: f64,
    /// Largest value / bound; NaN where no bound is above zero.
    pub closest: f64,
}

/// The rows as one JSON array; numbers that are not finite are null.
#[allow(clippy::missing_panics_doc)] // rows are plain data
pub fn json(rows: &[Row]) -> String {
    serde_json::to_string_pretty(rows).expect("rows are plain data") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Vec<Row> {
        let mut rows = Rows::new("golden");
        rows.case("a", |case| {
            case.at_most("exact", 1.0, 1.0, "m").computed(2.5);
            case.at_most("beyond", 1.5, 1.0, "m");
            case.at_most("nan", f64::NAN, f64::INFINITY, "-");
            case.count("steps", 3, 4);
            case.inform("time", 0.1, "s");
            Err("no such file".into())
        });
        rows.case("b", |_| panic!("index {}", 7));
        rows.finish()
    }

    #[test]
    fn only_numbers_within_their_bound_pass() {
        let pass: Vec<bool> = sample().iter().map(|r| r.pass).collect();
        assert_eq!(pass, [true, false, false, false, true, false, false]);
        assert_eq!(sample()[5].note, "no such file");
        assert_eq!(sample()[6].note, "panicked: index 7");
    }

    #[test]
    fn json_has_no_nan_and_all_columns() {
        let rows: serde_json::Value = serde_json::from_str(&json(&sample())).unwrap();
        let text = json(&sample());
        assert!(!text.contains("condition"), "a column nobody filled");
        let columns = ["suite", "case", "what", "value", "bound", "unit", "seconds", "pass", "computed"];
        for row in rows.as_array().unwrap() {
            assert!(columns.iter().all(|c| row.get(c).is_some()), "{row}");
        }
        assert_eq!(rows[0]["computed"], 2.5);
        assert!(rows[2]["value"].is_null() && rows[4]["bound"].is_null() && rows[1]["computed"].is_null());
    }

    #[test]
    fn a_row_has_its_own_reason_or_that_of_its_case_or_suite() {
        let mut rows = Rows::new("golden");
        rows.reason("of the suite");
        rows.case("a", |case| {
            case.at_most("inherited", 1.0, 2.0, "m");
            case.reason("of the case");
            case.at_most("of the case", 1.0, 2.0, "m");
            case.at_most("own", 1.0, 2.0, "m").because("own");
            case.inform("time", 0.1, "s");
            Ok(())
        });
        rows.case("b", |case| {
            case.at_most("inherited", 4.0, 2.0, "m");
            Ok(())
        });
        let rows = rows.finish();
        let reasons: Vec<&str> = rows.iter().map(|r| r.reason.as_str()).collect();
        assert_eq!(reasons, ["of the suite", "of the case", "own", "", "of the suite"]);
        let Summary { checks, failed, closest, .. } = summary(&rows);
        assert_eq!((checks, failed, closest), (4, 1, 2.0));
    }

    #[test]
    fn columns_are_aligned() {
        let text = table(&sample());
        let at: Vec<usize> = text.lines().map(|l| l.chars().take_while(|c| *c != ' ').count()).collect();
        assert_eq!(text.lines().count(), 8);
        assert!(!text.contains("condition"), "{text}");
        assert!(at.iter().all(|a| *a <= 6), "{text}");
        assert!(text.contains("NO"));
    }
}
