//! `cargo xtask compare OLD NEW`: the shipped scenes by two binaries, number by number.

use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// What `cargo xtask compare --help` prints.
pub(crate) const HELP: &str = "\
cargo xtask compare OLD NEW [SCENE…] [--recording FILE] [-v]
    Runs shipped scenes, all of them unless some are named, with two binaries of varda into temporary
    folders and prints what differs. Where both take the same iterations, all numbers must agree to six
    digits and all counts exactly. Where the path differs, J must agree to 1e-6 and the iterations within
    2. Case 4 of the paper is held to its minimum alone.
    --recording: the observations of scenes that ship without (beam-release). -v: every number, not the
    worst of each file.
";

/// Numbers agree to six digits.
const DIGITS: f64 = 5e-7;
/// What two ends of one minimization may differ by in J.
const MINIMUM: f64 = 1e-6;
/// Iterations that a minimization may take more or less.
const ITERATIONS: i64 = 2;

/// Runs the command.
pub(crate) fn run(arguments: &[&str]) -> Result<(), String> {
    let (mut paths, mut recording, mut verbose) = (Vec::new(), None, false);
    let mut arguments = arguments.iter();
    while let Some(&argument) = arguments.next() {
        match argument {
            "--help" => {
                print!("{HELP}");
                return Ok(());
            }
            "-v" => verbose = true,
            "--recording" => recording = Some(*arguments.next().ok_or("--recording needs a file")?),
            word if word.starts_with('-') => return Err(format!("no option {word}\n\n{HELP}")),
            word => paths.push(word),
        }
    }
    let [old, new, named @ ..] = paths.as_slice() else { return Err(format!("two binaries\n\n{HELP}")) };
    let recording =
        recording.map(std::fs::canonicalize).transpose().map_err(|e| format!("--recording: {e}"))?;
    let binary = |path: &str| std::fs::canonicalize(path).map_err(|e| format!("{path}: {e}"));
    let (old, new) = (binary(old)?, binary(new)?);
    let shipped = scenes(&old)?;
    let chosen: Vec<String> = match named {
        [] => shipped,
        named => named.iter().map(|s| s.to_string()).collect(),
    };
    let folder = std::env::temp_dir().join(format!("varda-compare-{}", std::process::id()));
    let mut bad = Vec::new();
    let head = ["scene", "what", "old", "new", "relative", "iterations", "counts old | new"];
    println!("{}", aligned(&head, "verdict"));
    for scene in &chosen {
        let ran = [(&old, "old"), (&new, "new")].map(|(binary, kind)| {
            let out = folder.join(kind).join(scene);
            result(binary, scene, recording.as_deref(), &out)
        });
        let lines = match ran {
            [Ok(old), Ok(new)] => compared(scene, &old, &new, verbose),
            [Err(old), Err(_)] => {
                println!("{scene:<26} skipped: neither binary runs it ({old})");
                continue;
            }
            [Err(e), _] => vec![Line::failed(scene, format!("the old binary fails: {e}"))],
            [_, Err(e)] => vec![Line::failed(scene, format!("the new binary fails: {e}"))],
        };
        lines.iter().for_each(|line| println!("{}", line.join_cells()));
        if lines.iter().any(|line| line.bad) {
            bad.push(scene.as_str());
        }
    }
    let _ = std::fs::remove_dir_all(&folder);
    println!("{} scenes compared, {} beyond their bounds", chosen.len(), bad.len());
    if bad.is_empty() { Ok(()) } else { Err(format!("beyond their bounds: {}", bad.join(", "))) }
}

/// The names that `varda scenes` lists.
fn scenes(binary: &Path) -> Result<Vec<String>, String> {
    let output =
        Command::new(binary).arg("scenes").output().map_err(|e| format!("{}: {e}", binary.display()))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let names = text.lines().take_while(|line| !line.trim().is_empty());
    Ok(names.filter_map(|line| line.split_whitespace().next()).map(String::from).collect())
}

/// What a run left.
struct Outcome {
    summary: BTreeMap<String, Value>,
    tables: BTreeMap<String, Csv>,
}

/// Runs a scene and reads what it left; an error is the last line that the program said.
fn result(binary: &Path, scene: &str, recording: Option<&Path>, out: &Path) -> Result<Outcome, String> {
    let mut command = Command::new(binary);
    command.args(["run", scene, "--quiet", "--out"]).arg(out);
    if let (Some(recording), "beam-release") = (recording, scene) {
        command.arg("--set").arg(format!("observations.file={}", recording.display()));
    }
    let output = command.output().map_err(|e| format!("{}: {e}", binary.display()))?;
    // A run that does not fit or did not converge ends with a code of its own and leaves its folder all the
    // same.
    let file = out.join("summary.json");
    let Ok(text) = std::fs::read_to_string(&file) else {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(said.lines().last().unwrap_or("it leaves no summary.json").to_string());
    };
    let value: Value = serde_json::from_str(&text).map_err(|e| format!("{}: {e}", file.display()))?;
    let mut summary = BTreeMap::new();
    flatten(&value, String::new(), &mut summary);
    let mut tables = BTreeMap::new();
    for name in ["analysis.csv", "trajectory.csv", "cycles.csv"] {
        if let Ok(text) = std::fs::read_to_string(out.join(name)) {
            tables.insert(name.to_string(), Csv::read(&text));
        }
    }
    Ok(Outcome { summary, tables })
}

/// Leaves of a tree by their path; the errors of a state have one name, whatever the model.
fn flatten(value: &Value, path: String, leaves: &mut BTreeMap<String, Value>) {
    let join = |key: &str| if path.is_empty() { key.to_string() } else { format!("{path}.{key}") };
    match value {
        Value::Object(map) => map.iter().for_each(|(key, value)| flatten(value, join(key), leaves)),
        Value::Array(list) => {
            list.iter().enumerate().for_each(|(i, value)| flatten(value, join(&i.to_string()), leaves));
        }
        leaf => {
            leaves.insert(path.replace("rmse.state_", "rmse.position_"), leaf.clone());
        }
    }
}

/// Paths whose numbers are run times, memory, or what rounding leaves of a quantity that vanishes.
fn incomparable(path: &str) -> bool {
    let last = path.rsplit('.').next().unwrap_or(path);
    path.starts_with("seconds")
        || last.starts_with("mean_")
        || is_work(path)
        || ["peak_bytes", "seconds_each", "gradient_norm_last", "gradient_error", "seed"].contains(&last)
}

/// Paths that count work.
fn is_work(path: &str) -> bool {
    path.starts_with("counts.") || path == "outer_iterations" || path == "inner_iterations"
}

/// A table of numbers, column by column; cells that are no numbers are NaN.
struct Csv {
    columns: Vec<(String, Vec<f64>)>,
}

impl Csv {
    fn read(text: &str) -> Csv {
        let mut lines = text.lines();
        let names = lines.next().unwrap_or("").split(',');
        let mut columns: Vec<(String, Vec<f64>)> = names.map(|n| (n.to_string(), Vec::new())).collect();
        for line in lines {
            for (column, cell) in columns.iter_mut().zip(line.split(',')) {
                column.1.push(cell.parse().unwrap_or(f64::NAN));
            }
        }
        Csv { columns }
    }

    fn sum(&self, name: &str) -> f64 {
        self.columns.iter().filter(|c| c.0 == name).flat_map(|c| &c.1).sum()
    }

    /// The largest difference of each column that both have, relative to its largest value. Infinite where
    /// rows are missing or a number stands for none.
    fn differences(&self, other: &Csv) -> Vec<(String, f64)> {
        let mut found = Vec::new();
        for (name, ours) in self.columns.iter().filter(|c| !c.0.contains("seconds") && !is_count_column(&c.0))
        {
            let Some((_, theirs)) = other.columns.iter().find(|c| c.0 == *name) else {
                found.push((format!("{name} (missing)"), f64::INFINITY));
                continue;
            };
            let scale =
                ours.iter().chain(theirs).filter(|v| !v.is_nan()).fold(0.0, |m: f64, v| m.max(v.abs()));
            let mut worst = if ours.len() == theirs.len() { 0.0 } else { f64::INFINITY };
            for (a, b) in ours.iter().zip(theirs) {
                let apart =
                    if a.is_nan() && b.is_nan() { 0.0 } else { (a - b).abs() / scale.max(f64::MIN_POSITIVE) };
                worst = if apart <= worst { worst } else { apart };
            }
            found.push((name.clone(), if worst.is_nan() { f64::INFINITY } else { worst }));
        }
        found
    }
}

/// Columns of tables that count work.
fn is_count_column(name: &str) -> bool {
    name.ends_with("_iterations") || name.ends_with("_steps") || name == "factorizations"
}

/// The work of a run: iterations, and all counts one after the other.
#[derive(PartialEq)]
struct Taken {
    iterations: i64,
    counts: String,
}

fn taken(outcome: &Outcome) -> Taken {
    let number = |path: &str| outcome.summary.get(path).and_then(Value::as_i64);
    let counts = outcome.summary.iter().filter(|(path, _)| path.starts_with("counts."));
    let iterations = number("outer_iterations")
        .or(outcome.tables.get("cycles.csv").map(|t| t.sum("outer_iterations") as i64));
    Taken {
        iterations: iterations.unwrap_or(0),
        counts: counts.map(|(_, n)| n.to_string()).collect::<Vec<_>>().join("/"),
    }
}

/// One line of the table.
struct Line {
    cells: [String; 7],
    verdict: String,
    bad: bool,
}

impl Line {
    fn failed(scene: &str, verdict: String) -> Line {
        let mut cells = [const { String::new() }; 7];
        cells[0] = scene.to_string();
        Line { cells, verdict, bad: true }
    }

    fn join_cells(&self) -> String {
        aligned(&self.cells.each_ref().map(String::as_str), &self.verdict)
    }
}

fn aligned(cells: &[&str; 7], verdict: &str) -> String {
    let [scene, what, old, new, difference, iterations, counts] = cells;
    format!(
        "{scene:<25} {what:<38} {old:>14} {new:>14} {difference:>9} {iterations:>10}  {verdict:<28} {counts}"
    )
    .trim_end()
    .to_string()
}

/// The lines of one scene.
fn compared(scene: &str, old: &Outcome, new: &Outcome, verbose: bool) -> Vec<Line> {
    let (before, after) = (taken(old), taken(new));
    let only_minimum = scene.contains("case4");
    let same_path = before.iterations == after.iterations;
    let iterations = format!("{}/{}", before.iterations, after.iterations);
    let counts = format!("{} | {}", before.counts, after.counts);
    let line = |what: &str, [old, new]: [String; 2], difference: f64, verdict: String, bad: bool| {
        let cells =
            [scene, what, &old, &new, &format!("{difference:.1e}"), &iterations, ""].map(str::to_string);
        Line { cells, verdict, bad }
    };
    let judge = |difference: f64| match () {
        _ if difference <= DIGITS => ("6 digits".to_string(), false),
        _ if only_minimum => ("path not compared".to_string(), false),
        _ if !same_path => ("path differs".to_string(), false),
        _ => ("DIFFERS".to_string(), true),
    };

    // The path, and the counts along it.
    let (mut verdict, mut bad) = (String::from("same path"), false);
    if !same_path {
        bad = !only_minimum && (before.iterations - after.iterations).abs() > ITERATIONS;
        verdict = String::from(if bad { "PATH DIFFERS BY MORE THAN 2" } else { "path differs" });
    } else if before.counts != after.counts {
        (verdict, bad) = (String::from("COUNTS DIFFER"), !only_minimum);
    }
    let text = |o: &Outcome| o.summary.get("status").and_then(Value::as_str).unwrap_or("none").to_string();
    if text(old) != text(new) {
        (verdict, bad) = (String::from("STATUS DIFFERS"), true);
    }
    let mut path = line("path and status", [text(old), text(new)], 0.0, verdict, bad);
    path.cells[6] = counts;
    let mut lines = vec![path];

    let mut worst: Option<(String, f64, [String; 2])> = None;
    for (name, a) in &old.summary {
        let (Some(a), false) = (a.as_f64(), incomparable(name)) else { continue };
        let Some(b) = new.summary.get(name).and_then(Value::as_f64) else {
            lines.push(line(name, [short(a), "none".into()], f64::INFINITY, "MISSING".into(), true));
            continue;
        };
        let difference = relative(a, b);
        if name == "j_analysis" && (only_minimum || !same_path) {
            // The minimum, or a lower one where there are several.
            let good = difference <= MINIMUM || (only_minimum && b < a);
            let verdict = if good { "same minimum" } else { "ANOTHER MINIMUM" };
            let verdict = if b < a && difference > MINIMUM { "lower minimum" } else { verdict };
            lines.push(line(name, [short(a), short(b)], difference, verdict.into(), !good));
        } else if verbose || ["j_background", "j_analysis", "cycles.rmse_end"].contains(&name.as_str()) {
            let (verdict, bad) = judge(difference);
            lines.push(line(name, [short(a), short(b)], difference, verdict, bad));
        } else if worst.as_ref().is_none_or(|w| !(difference <= w.1)) {
            worst = Some((name.clone(), difference, [short(a), short(b)]));
        }
    }
    if let Some((name, difference, values)) = worst {
        let (verdict, bad) = judge(difference);
        lines.push(line(&format!("others: {name}"), values, difference, verdict, bad));
    }
    for (file, table) in &old.tables {
        let Some(other) = new.tables.get(file) else {
            lines.push(Line::failed(scene, format!("{file} IS MISSING")));
            continue;
        };
        let mut columns = table.differences(other);
        columns.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (column, difference) in columns.iter().take(if verbose { columns.len() } else { 1 }) {
            let (verdict, bad) = judge(*difference);
            lines.push(line(&format!("{file}: {column}"), Default::default(), *difference, verdict, bad));
        }
    }
    lines
}

fn short(value: f64) -> String {
    if value != 0.0 && !(1e-4..1e7).contains(&value.abs()) {
        format!("{value:.6e}")
    } else {
        format!("{value:.7}")
    }
}

/// |a − b| in units of the larger.
fn relative(a: f64, b: f64) -> f64 {
    if a == b { 0.0 } else { (a - b).abs() / a.abs().max(b.abs()) }
}

#[cfg(test)]
mod tests;
