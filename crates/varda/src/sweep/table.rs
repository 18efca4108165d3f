//! The table of a study: a row for every run, and means over the seeds of every combination.

use serde::Serialize;
use serde_json::Value;

use super::grid::Plan;
use super::runs::Record;
use crate::outcome::is_of_input;

/// All rows, with what their columns are.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Table {
    /// The keys.
    pub keys: Vec<String>,
    /// Names of errors against the truth: `state_background`, `state_analysis`, …
    pub rmse: Vec<String>,
    /// Names of the constants that were estimated; without those that are fields.
    pub constants: Vec<String>,
    /// The runs in the order of the grid.
    #[serde(skip)]
    pub rows: Vec<Row>,
    /// The combinations in the order of the grid.
    pub combinations: Vec<Combination>,
}

/// A run.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Its place in the grid, from 0.
    pub index: usize,
    /// The values of the keys.
    pub values: Vec<String>,
    /// Its seed.
    pub seed: u64,
    /// Whether the analysis fits; empty without a result.
    pub verdict: String,
    /// How the minimization ended; empty without a result.
    pub status: String,
    /// 2J/m.
    pub chi2: Option<f64>,
    /// RMSE by the names of [`Table::rmse`].
    pub rmse: Vec<Option<f64>>,
    /// Constants by the names of [`Table::constants`].
    pub constants: Vec<Option<Constant>>,
    /// Root mean square error of the forecast by background and analysis \[m\].
    pub forecast: [Option<f64>; 2],
    /// As in [`Record`].
    pub state_within: Option<[usize; 2]>,
    /// As in [`Record`].
    pub exit_code: Option<i32>,
    /// As in [`Record`].
    pub error: Option<String>,
    /// As in [`Record`].
    pub seconds: f64,
}

/// A constant that was estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Constant {
    /// Its estimate.
    pub value: f64,
    /// σ of it.
    pub sigma: Option<f64>,
    /// Its value in the truth.
    pub truth: Option<f64>,
    /// Whether the truth is within the 95 % interval: that of the run, else ±1.96 σ.
    pub within: Option<bool>,
}

/// The runs of one combination.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Combination {
    /// The values of the keys.
    pub values: Vec<String>,
    /// How many runs.
    pub runs: usize,
    /// How many of them have no result.
    pub failures: usize,
    /// How many fit.
    pub fits: usize,
    /// 2J/m.
    pub chi2: Mean,
    /// RMSE by the names of [`Table::rmse`].
    pub rmse: Vec<Mean>,
    /// Estimates by the names of [`Table::constants`].
    pub constants: Vec<ConstantMean>,
    /// Error of the forecast by background and analysis \[m\].
    pub forecast: [Mean; 2],
    /// Share of components of the state whose truth is within 1.96 σ.
    pub state_coverage: Option<f64>,
    /// Median of the seconds of runs with a result.
    pub seconds_median: Option<f64>,
}

/// Estimates of a constant over seeds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ConstantMean {
    /// Of the estimate.
    pub value: Mean,
    /// Of estimate − truth.
    pub error: Mean,
    /// Share of runs whose 95 % interval has the truth.
    pub coverage: Option<f64>,
}

/// A mean over runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Mean {
    /// How many have the number.
    pub count: usize,
    /// Their mean x̄.
    pub mean: Option<f64>,
    /// √(Σ(x − x̄)² / (n(n − 1))); of two runs at least.
    pub standard_error: Option<f64>,
}

impl Mean {
    /// Of these numbers.
    ///
    /// ```
    /// let mean = varda::sweep::table::Mean::of([1.0, 3.0]);
    /// assert_eq!((mean.count, mean.mean, mean.standard_error), (2, Some(2.0), Some(1.0)));
    /// ```
    pub fn of(numbers: impl IntoIterator<Item = f64>) -> Mean {
        let numbers: Vec<f64> = numbers.into_iter().collect();
        let n = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / n;
        let squares: f64 = numbers.iter().map(|x| (x - mean).powi(2)).sum();
        Mean {
            count: numbers.len(),
            mean: (n > 0.0).then_some(mean),
            standard_error: (n > 1.0).then(|| (squares / (n * (n - 1.0))).sqrt()),
        }
    }
}

impl Table {
    /// Of the records of a study, all of them in their order.
    pub fn new(plan: &Plan, records: &[Record]) -> Table {
        let (mut rmse, mut constants) = (Vec::new(), Vec::new());
        for summary in records.iter().filter_map(result) {
            let errors = summary["rmse"].as_object().into_iter().flatten();
            errors.for_each(|(name, _)| add(&mut rmse, name));
            constants_of(summary).for_each(|(name, _)| add(&mut constants, name));
        }
        // before its analysis comes the background of a group
        rmse.sort_by_key(|name| {
            let (group, of) = name.rsplit_once('_').unwrap_or((name, ""));
            let place = ["background", "analysis"].iter().position(|o| *o == of).unwrap_or(2);
            (group.to_string(), place, name.clone())
        });
        let rows = records.iter().map(|record| {
            let combination = record.index / plan.seeds.len();
            let values = plan.values(combination).into_iter().map(String::from).collect();
            Row::new(values, record, &rmse, &constants)
        });
        let rows: Vec<Row> = rows.collect();
        let combinations = rows.chunks(plan.seeds.len()).map(Combination::new).collect();
        let keys = plan.swept.iter().map(|s| s.key.clone()).collect();
        Table { keys, rmse, constants, rows, combinations }
    }

    /// How many runs have no result.
    pub fn failures(&self) -> usize {
        self.rows.iter().filter(|row| row.error.is_some()).count()
    }
}

fn add(names: &mut Vec<String>, name: &str) {
    if !names.iter().any(|known| known == name) {
        names.push(name.to_string());
    }
}

/// The summary of a run that has a result.
fn result(record: &Record) -> Option<&Value> {
    record.summary.as_ref().filter(|_| !record.has_failed())
}

/// Names and entries of the constants of a run that are one number: no field along a rod, no error in time.
fn constants_of(summary: &Value) -> impl Iterator<Item = (&str, &Value)> {
    let all = summary["estimates"].as_array().into_iter().flatten();
    let named = all.filter(|e| e["arc_length"].is_null()).filter_map(|e| Some((e["name"].as_str()?, e)));
    named.filter(|(name, _)| !is_of_input(name))
}

impl Row {
    fn new(values: Vec<String>, record: &Record, rmse: &[String], constants: &[String]) -> Row {
        let summary = result(record).unwrap_or(&Value::Null);
        let text = |key: &str| summary[key].as_str().unwrap_or("").to_string();
        let constant = |name: &String| {
            let found = constants_of(summary).find(|(known, _)| known == name);
            found.and_then(|(_, entry)| Constant::new(entry))
        };
        Row {
            index: record.index,
            values,
            seed: record.seed,
            verdict: text("verdict"),
            status: text("status"),
            chi2: summary["chi2"].as_f64(),
            rmse: rmse.iter().map(|name| summary["rmse"][name].as_f64()).collect(),
            constants: constants.iter().map(constant).collect(),
            forecast: ["background", "analysis"].map(|of| forecast(summary, of)),
            state_within: record.state_within.filter(|_| !record.has_failed()),
            exit_code: record.exit_code,
            error: record.error.clone(),
            seconds: record.seconds,
        }
    }
}

/// Root mean square error of a forecast over markers and times.
fn forecast(summary: &Value, of: &str) -> Option<f64> {
    let one = std::slice::from_ref(summary);
    let parts = summary["recordings"].as_array().map_or(one, Vec::as_slice);
    let (mut squares, mut count) = (0.0, 0.0);
    for marker in parts.iter().flat_map(|part| part["forecast"].as_array().into_iter().flatten()) {
        let n = marker["count"].as_f64()?;
        squares += n * marker[of].as_f64()?.powi(2);
        count += n;
    }
    (count > 0.0).then(|| f64::sqrt(squares / count))
}

impl Constant {
    fn new(entry: &Value) -> Option<Constant> {
        let value = entry["value"].as_f64()?;
        let [sigma, truth] = ["sigma", "truth"].map(|key| entry[key].as_f64());
        let ends = entry["interval"][0].as_f64().zip(entry["interval"][1].as_f64());
        let ends = ends.or_else(|| sigma.map(|s| (value - 1.96 * s, value + 1.96 * s)));
        let within = truth.zip(ends).map(|(truth, (low, high))| low <= truth && truth <= high);
        Some(Constant { value, sigma, truth, within })
    }

    /// Estimate − truth.
    pub fn error(&self) -> Option<f64> {
        self.truth.map(|truth| self.value - truth)
    }
}

impl Combination {
    /// Of its rows, one at least.
    fn new(rows: &[Row]) -> Combination {
        let mean = |of: &dyn Fn(&Row) -> Option<f64>| Mean::of(rows.iter().filter_map(of));
        let constant = |i: usize| {
            let known = |row: &Row| row.constants[i].and_then(|c| c.within);
            let within = rows.iter().filter_map(known).map(|within| f64::from(u8::from(within)));
            ConstantMean {
                value: mean(&|row| row.constants[i].map(|c| c.value)),
                error: mean(&|row| row.constants[i].and_then(|c| c.error())),
                coverage: Mean::of(within).mean,
            }
        };
        let counts = rows.iter().filter_map(|row| row.state_within);
        let [within, all] = counts.fold([0, 0], |sum, n| [sum[0] + n[0], sum[1] + n[1]]);
        let with_result = rows.iter().filter(|row| row.error.is_none());
        Combination {
            values: rows[0].values.clone(),
            runs: rows.len(),
            failures: rows.iter().filter(|row| row.error.is_some()).count(),
            fits: rows.iter().filter(|row| row.verdict == "fits").count(),
            chi2: mean(&|row| row.chi2),
            rmse: (0..rows[0].rmse.len()).map(|i| mean(&|row| row.rmse[i])).collect(),
            constants: (0..rows[0].constants.len()).map(constant).collect(),
            forecast: [0, 1].map(|i| mean(&|row| row.forecast[i])),
            state_coverage: (all > 0).then(|| within as f64 / all as f64),
            seconds_median: median(with_result.map(|row| row.seconds).collect()),
        }
    }
}

fn median(mut numbers: Vec<f64>) -> Option<f64> {
    numbers.sort_by(f64::total_cmp);
    let n = numbers.len();
    (n > 0).then(|| 0.5 * (numbers[(n - 1) / 2] + numbers[n / 2]))
}
