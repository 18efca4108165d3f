//! `sweep`: a study by processes.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::Instant;

use clap::Args;
use varda_assimilation::ranks::{self, Ranks};

use super::exit::INTERRUPTED;
use super::progress::ProgressDisplay;
use super::{Shown, stop_on_signals, style};
use crate::Error;
use crate::report::{summary_of_sweep, write_sweep};
use crate::sweep::grid::{Part, Plan};
use crate::sweep::runs::{Progress, Study, begin, merge, records};
use crate::sweep::table::{Mean, Table};

/// Most combinations in a table; sweep-means.csv has all.
const MOST_ROWS: usize = 40;

#[derive(Args)]
pub(super) struct SweepArguments {
    /// A scene file, or the name of a shipped scene
    #[arg(required_unless_present = "merge")]
    scene: Option<String>,
    /// Values of a key; commas within quotes, brackets or braces divide nothing
    #[arg(long = "set", value_name = "key=a,b,c")]
    sets: Vec<String>,
    /// Seeds of each combination: 0..99 (99 included), 3, or 0,3,7 [default: the scene's]
    #[arg(long, value_name = "A..B")]
    seeds: Option<String>,
    /// Processes at a time [default: one for each core]
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Folder of the study [default: out/<scene name>-sweep; of a merge the first DIR]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Do this job's share only, as 3/20: the third of twenty; --merge then makes the table
    #[arg(long, value_name = "K/N")]
    part: Option<String>,
    /// Run again what has been run
    #[arg(long)]
    fresh: bool,
    /// Make one table of the parts in these folders
    #[arg(
        long, value_name = "DIR", num_args = 1..,
        conflicts_with_all = ["scene", "sets", "seeds", "jobs", "part", "fresh"]
    )]
    merge: Vec<PathBuf>,
    /// Print nothing but errors
    #[arg(long)]
    quiet: bool,
    /// Print summary.json instead of the table
    #[arg(long, conflicts_with = "quiet")]
    json: bool,
}

pub(super) fn run(arguments: &SweepArguments, started: Instant) -> Result<ExitCode, Error> {
    let shown = Shown::of(arguments.quiet, arguments.json);
    let Some(scene) = &arguments.scene else {
        let out = arguments.out.as_ref().unwrap_or(&arguments.merge[0]);
        if !ranks::is_first() {
            return Ok(ExitCode::SUCCESS);
        }
        let plan = merge(&arguments.merge, out)?;
        return finish(&plan, out, shown);
    };
    let part = arguments.part.as_deref().map_or(Ok(Part::WHOLE), Part::parse)?;
    let plan = Plan::new(scene, &arguments.sets, arguments.seeds.as_deref())?;
    let default = || Path::new("out").join(format!("{}-sweep", plan.scene));
    let folder = arguments.out.clone().unwrap_or_else(default);
    let program = std::env::current_exe().map_err(|reason| Error::Read {
        place: "sweep".into(),
        path: "varda".into(),
        reason,
    })?;
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    let mut study = Study {
        program: &program,
        leading: &[],
        scene,
        plan: &plan,
        part,
        folder: &folder,
        jobs: arguments.jobs.unwrap_or_else(cores),
        fresh: arguments.fresh,
    };
    let ranks = ranks::current();
    if let Some(ranks) = &ranks {
        divide(&mut study, &**ranks, arguments.jobs)?;
    }
    let stop = stop_on_signals();
    let mut display = ProgressDisplay::new(shown == Shown::Nothing, started, None);
    let ended = study.run(&mut |now| display.sweep(&now), &|| stop.load(Ordering::SeqCst))?;
    display.finish();
    let ended = ranks.map_or(ended, |ranks| of_all(&*ranks, ended));
    if ended.done < ended.count {
        if shown != Shown::Nothing {
            eprintln!(
                "interrupted after {} of {} runs; the same command does the others",
                ended.done, ended.count
            );
        }
        return Ok(ExitCode::from(INTERRUPTED));
    }
    if !ranks::is_first() {
        return Ok(ExitCode::SUCCESS);
    }
    if part != Part::WHOLE {
        if shown == Shown::Table {
            style::line(format_args!(
                "part {}/{}: {} of {} runs, {} failed; when all parts have ended: varda sweep --merge {}",
                part.which,
                part.of,
                ended.count,
                plan.count(),
                ended.failures,
                folder.display()
            ));
        }
        return Ok(ExitCode::SUCCESS);
    }
    finish(&plan, &folder, shown)
}

/// Gives a process its part of a study, and one run at a time: a rank is a place for a run. The first makes
/// the folder, before another looks for it.
fn divide(study: &mut Study, ranks: &dyn Ranks, jobs: Option<usize>) -> Result<(), Error> {
    if study.part != Part::WHOLE {
        let message = "several processes divide the whole sweep among themselves".into();
        return Err(Error::Scene { place: "--part".into(), message, excerpt: String::new() });
    }
    if ranks.rank() == 0 {
        begin(study.folder, study.plan, Part::WHOLE, study.fresh)?;
    }
    ranks.all_gather(&[], &[]);
    study.part = Part { which: ranks.rank() + 1, of: ranks.count() };
    study.fresh = false;
    study.jobs = jobs.unwrap_or(1);
    study.leading = &["alone"];
    Ok(())
}

/// How far all processes have come.
fn of_all(ranks: &dyn Ranks, of_this: Progress) -> Progress {
    let Progress { done, before, count, failures } = of_this;
    let all = ranks.all_gather(&[], &[done, before, count, failures].map(|n| n as f64));
    let sum = |i: usize| all.iter().skip(i).step_by(4).sum::<f64>() as usize;
    Progress { done: sum(0), before: sum(1), count: sum(2), failures: sum(3) }
}

/// Writes and prints the tables of a study whose runs have all ended.
fn finish(plan: &Plan, folder: &Path, shown: Shown) -> Result<ExitCode, Error> {
    let table = Table::new(plan, &records(folder, plan)?);
    write_sweep(plan, &table, folder)?;
    match shown {
        Shown::Nothing => {}
        Shown::Table => style::print(&in_words(&table, folder)),
        Shown::Json => style::line(format_args!("{:#}", summary_of_sweep(plan, &table))),
    }
    Ok(ExitCode::SUCCESS)
}

/// A line for each combination: how many runs, failures and fits, 2J/m, errors, seconds.
fn in_words(table: &Table, folder: &Path) -> String {
    let mean = |m: &Mean| match (m.mean, m.standard_error) {
        (Some(mean), Some(error)) => format!("{mean:.3e} ± {error:.0e}"),
        (Some(mean), None) => format!("{mean:.3e}"),
        (None, _) => "-".into(),
    };
    let mut headings = table.keys.clone();
    headings.extend(["runs", "failed", "fit", "2J/m"].map(String::from));
    headings.extend(table.rmse.iter().map(|name| format!("RMSE {name}")));
    headings.extend(table.constants.iter().cloned());
    headings.push("seconds".into());
    let mut lines = vec![headings];
    for c in table.combinations.iter().take(MOST_ROWS) {
        let mut line = c.values.clone();
        line.extend([c.runs, c.failures, c.fits].map(|n| n.to_string()));
        line.push(mean(&c.chi2));
        line.extend(c.rmse.iter().map(mean));
        line.extend(c.constants.iter().map(|constant| mean(&constant.value)));
        line.push(c.seconds_median.map_or("-".into(), |s| format!("{s:.2}")));
        lines.push(line);
    }
    let width = |i: usize| lines.iter().map(|line| line[i].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..lines[0].len()).map(width).collect();
    let mut out = String::new();
    for line in &lines {
        let cells: Vec<String> = line.iter().zip(&widths).map(|(cell, w)| format!("{cell:>w$}")).collect();
        let _ = writeln!(out, "{}", cells.join("  "));
    }
    let more = table.combinations.len().saturating_sub(MOST_ROWS);
    if more > 0 {
        let _ = writeln!(out, "{more} more in sweep-means.csv");
    }
    let errors = table.rows.iter().filter_map(|row| Some((row.index, row.error.as_ref()?)));
    if let Some((index, error)) = errors.clone().next() {
        let _ = writeln!(out, "{} failed, the first is run {index}: {error}", errors.count());
    }
    let _ = writeln!(
        out,
        "means ± standard errors, median of seconds; report {}",
        folder.join("report.html").display()
    );
    out
}
