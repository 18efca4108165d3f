//! The command line of the suites: `cargo xtask verify`.

use crate::{Options, Row, SUITES, Summary, row, run, stability, suites::Suite, summary, table};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What `--help` prints.
pub const HELP: &str = "\
cargo xtask verify [SUITE…] [OPTION…]
    Runs the verification suites in a release build, all of them unless some are named. Prints one line a
    suite and every row that failed. Ends with 0 if every row passes, with 1 if one fails, with 2 for a
    mistake in the arguments.

    --list            the suites, with a sentence on what each proves
    --quick           every kind of check on a fixed part of its grid, as `cargo test` runs it
    --full            everything; with all suites also writes docs/results/verification.md
    -v, --verbose     every row, with its bound and the reason of the bound
    --json FILE       the rows as one JSON array
    --fixtures DIR    suite golden checks DIR/der, /hanging-rod, /twin, /statics, not tests/fixtures
    --stability FILE  the rows of suite stiff as a document (docs/results/stability.md)
    --help            this text";

/// What the arguments ask for.
#[derive(Default)]
struct Wanted {
    options: Options,
    suites: Vec<&'static Suite>,
    verbose: bool,
    json: Option<PathBuf>,
    stability: Option<PathBuf>,
}

/// Runs the command and hands every line of its output to `print`. Whether every row passed.
///
/// # Errors
/// A mistake in the arguments, or a file that cannot be written.
pub fn run_command(arguments: &[String], print: &mut dyn FnMut(&str)) -> Result<bool, String> {
    if arguments.iter().any(|a| a == "--help" || a == "-h") {
        print(HELP);
        return Ok(true);
    }
    if arguments.iter().any(|a| a == "--list") {
        SUITES.iter().for_each(|s| print(&format!("{:<12} {}", s.name, s.proves)));
        return Ok(true);
    }
    let wanted = parse(arguments)?;
    let start = Instant::now();
    print(&format!("{:<12} {:>6} {:>6} {:>8}  what it proves", "suite", "checks", "failed", "seconds"));
    let mut rows = Vec::new();
    let mut lines = Vec::new();
    for suite in &wanted.suites {
        let clock = Instant::now();
        let report = run(suite.name, &wanted.options);
        let Summary { checks, failed, closest, .. } = summary(&report.rows);
        let seconds = clock.elapsed().as_secs_f64();
        let line = format!("{:<12} {checks:>6} {failed:>6} {seconds:>8.1}  {}", suite.name, suite.proves);
        print(&line);
        let shown: Vec<Row> = report.rows.iter().filter(|r| wanted.verbose || !r.pass).cloned().collect();
        if !shown.is_empty() {
            print(&format!("\n{}", table(&shown)));
        }
        if wanted.verbose && !report.text.is_empty() {
            print(&report.text);
        }
        lines.push((*suite, checks, failed, closest, seconds));
        rows.extend(report.rows);
    }
    let Summary { checks, failed, .. } = summary(&rows);
    let minutes = start.elapsed().as_secs_f64() / 60.0;
    print(&format!("{checks} checks, {failed} failed, {minutes:.1} minutes"));
    let write = |file: &Path, text: String| {
        std::fs::write(file, text).map_err(|e| format!("{}: {e}", file.display()))
    };
    if let Some(file) = &wanted.json {
        write(file, row::json(&rows))?;
    }
    if let Some(file) = &wanted.stability {
        write(file, stability(&rows))?;
    }
    if wanted.options.full && wanted.options.fixtures.is_none() && wanted.suites.len() == SUITES.len() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/results/verification.md");
        write(&file, document(&lines, minutes))?;
    }
    Ok(failed == 0 && checks > 0)
}

fn parse(arguments: &[String]) -> Result<Wanted, String> {
    let mut wanted = Wanted::default();
    let mut arguments = arguments.iter();
    while let Some(argument) = arguments.next() {
        let mut file =
            |what: &str| arguments.next().map(PathBuf::from).ok_or(format!("{argument} needs {what}"));
        match argument.as_str() {
            "--quick" => wanted.options.quick = true,
            "--full" => wanted.options.full = true,
            "-v" | "--verbose" => wanted.verbose = true,
            "--json" => wanted.json = Some(file("a file")?),
            "--stability" => wanted.stability = Some(file("a file")?),
            "--fixtures" => wanted.options.fixtures = Some(file("a folder")?),
            name => wanted.suites.push(SUITES.iter().find(|s| s.name == name).ok_or_else(|| {
                let known: Vec<&str> = SUITES.iter().map(|s| s.name).collect();
                format!("no suite or option {name:?} (suites: {}; options: see --help)", known.join(", "))
            })?),
        }
    }
    if wanted.options.quick && wanted.options.full {
        return Err("--quick and --full exclude each other".into());
    }
    if let Some(folder) = wanted.options.fixtures.as_ref().filter(|f| !f.is_dir()) {
        return Err(format!("{}: no such folder", folder.display()));
    }
    if wanted.suites.is_empty() {
        wanted.suites = SUITES.iter().collect();
    }
    Ok(wanted)
}

/// A suite, its checks, its failures, the share of its bound that its closest row uses, and its seconds.
type Line = (&'static Suite, usize, usize, f64, f64);

/// The last full run as a page.
fn document(lines: &[Line], minutes: f64) -> String {
    let total: usize = lines.iter().map(|l| l.1).sum();
    let failed: usize = lines.iter().map(|l| l.2).sum();
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut text = format!(
        "# The last full verification\n\n\
         Written by `cargo xtask verify --full`: {total} checks, {failed} failed, {minutes:.1} minutes on a \
         machine with\n{threads} processors, one suite after the other. Rows with their bounds and the \
         reasons of the bounds: `-v`.\n\n*Closest*: the largest share of its bound that a row of the suite \
         uses.\n\n| suite | what it proves | checks | failed | closest | seconds \
         |\n|---|---|--:|--:|--:|--:|\n"
    );
    for (suite, checks, failed, closest, seconds) in lines {
        let Suite { name, proves, .. } = suite;
        let closest = if closest.is_nan() { "–".to_string() } else { format!("{closest:.2}") };
        let _ = writeln!(text, "| {name} | {proves} | {checks} | {failed} | {closest} | {seconds:.1} |");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(arguments: &[&str]) -> (Result<bool, String>, String) {
        let arguments: Vec<String> = arguments.iter().map(|a| a.to_string()).collect();
        let mut text = String::new();
        let outcome = run_command(&arguments, &mut |line| text.push_str(&format!("{line}\n")));
        (outcome, text)
    }

    #[test]
    fn the_list_has_a_sentence_on_every_suite() {
        let (outcome, text) = said(&["--list"]);
        assert_eq!((outcome, text.lines().count()), (Ok(true), SUITES.len()));
        for suite in SUITES {
            assert!(suite.proves.ends_with('.') && text.contains(suite.proves), "{}", suite.name);
        }
    }

    #[test]
    fn help_names_every_option_that_is_understood() {
        let (_, text) = said(&["--help"]);
        let options = ["--list", "--quick", "--full", "-v", "--json", "--fixtures", "--stability"];
        assert!(options.iter().all(|o| text.contains(o)));
    }

    #[test]
    fn mistakes_are_refused() {
        for arguments in
            [&["gold"][..], &["--jsn"], &["--json"], &["--quick", "--full"], &["--fixtures", "no/such"]]
        {
            assert!(said(arguments).0.is_err(), "{arguments:?}");
        }
    }

    #[test]
    fn the_page_of_a_full_run_counts_failures() {
        let text = document(&[(&SUITES[0], 10, 1, 0.5, 2.0), (&SUITES[1], 5, 0, f64::NAN, 1.0)], 3.25);
        assert!(text.contains("15 checks, 1 failed, 3.2 minutes"), "{text}");
        assert!(text.contains("| 10 | 1 | 0.50 | 2.0 |") && text.contains("| 5 | 0 | – | 1.0 |"), "{text}");
    }
}
