//! `varda run` of a scene with `[algorithm.cycles]`.

use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use varda_assimilation::{CycleState, Departures, ranks};

use crate::Error;
use crate::outcome::{CycleRow, CyclesOutcome, Status};
use crate::report;
use crate::report::checkpoint::{self, Checkpoint, Resumed};
use crate::run::cycles::{CycleListener, Sequence};
use crate::scene::SceneFile;
use crate::setup::files::InputFile;

use super::progress::ProgressDisplay;
use super::{RunOptions, Shown, exit, style};

/// Where a sequence starts and where its result goes.
pub(super) struct SequenceStart<'a> {
    pub(super) file: &'a SceneFile,
    /// The files that the scene names.
    pub(super) files: &'a [InputFile],
    /// Folder of the result.
    pub(super) folder: &'a Path,
    /// An unfinished run that is continued.
    pub(super) resumed: Option<Resumed>,
}

pub(super) fn run(
    sequence: &Sequence,
    start: SequenceStart,
    progress: &mut ProgressDisplay,
    interrupted: &dyn Fn() -> bool,
    options: RunOptions,
    started: Instant,
) -> Result<ExitCode, Error> {
    let folder = start.folder;
    let RunOptions { shown, strict, resume } = options;
    let (mut checkpoint, state, done) = begin(start, resume)?;
    let resumed = done.len();
    let count = sequence.cycles.count;
    let start = sequence.start();
    let state = state.unwrap_or_else(|| start.clone());
    let fits = state.next <= count
        && state.background.len() == start.background.len()
        && (start.columns.is_empty() || state.columns.len() == start.columns.len());
    if !fits {
        let reason = "state.json is not a state of this scene".to_string();
        return Err(Error::Resume { path: Checkpoint::folder(folder), reason });
    }
    let mut listener = CycleListener {
        on_cycle: Box::new(|row, after| {
            progress.cycle(row, resumed, count);
            checkpoint.as_mut().map_or(Ok(()), |checkpoint| checkpoint.store(row, after))
        }),
        interrupted: Box::new(interrupted),
        started,
    };
    let outcome = sequence.run(state, done, &mut listener);
    drop(listener);
    let outcome = match outcome {
        Ok(outcome) => outcome,
        Err(error) => {
            // No window was done: there is nothing to resume.
            if !matches!(error, Error::Write { .. }) {
                checkpoint.map_or(Ok(()), Checkpoint::remove)?;
            }
            return Err(error);
        }
    };
    progress.finish();
    let folder = match ranks::is_first() {
        true => report::write_cycles(&outcome, folder)?,
        false => folder.to_path_buf(),
    };
    if outcome.cycles.len() == count || outcome.status == Status::Failed {
        checkpoint.map_or(Ok(()), Checkpoint::remove)?;
    }
    match shown {
        Shown::Nothing => {}
        Shown::Table => style::table(
            outcome.judgement.verdict,
            &table(&outcome, &folder, started.elapsed().as_secs_f64()),
        ),
        Shown::Json => style::line(format_args!("{:#}", report::summary_of_cycles(&outcome))),
    }
    if outcome.status == Status::Failed {
        if ranks::is_first() {
            style::message(outcome.failure.as_deref().unwrap_or("a minimization failed"));
        }
        return Ok(ExitCode::FAILURE);
    }
    if outcome.status == Status::Interrupted && shown == Shown::Table {
        style::line(format_args!("{:<14} add --resume to the same command", "to continue"));
    }
    let warned = strict && !outcome.warnings.is_empty();
    Ok(exit::code(&outcome.judgement, outcome.status, outcome.late, warned))
}

/// The checkpoint, which the first of several processes keeps, and where the sequence starts.
fn begin(
    start: SequenceStart,
    resume: bool,
) -> Result<(Option<Checkpoint>, Option<CycleState>, Vec<CycleRow>), Error> {
    let SequenceStart { file, files, folder, resumed } = start;
    let (checkpoint, state, done) = match resumed {
        Some(Resumed { checkpoint, state, done }) => (Some(checkpoint), state, done),
        None if ranks::is_first() => (Some(Checkpoint::begin(folder, file, files)?), None, Vec::new()),
        None => (None, None, Vec::new()),
    };
    if !resume || ranks::current().is_none() {
        return Ok((checkpoint, state, done));
    }
    let said = ranks::said_by_first(checkpoint::to_text(state.as_ref(), &done));
    let (state, done) = checkpoint::from_text(&said).map_err(|e| {
        let reason = format!("what the first process has read cannot be read: {e}");
        Error::Resume { path: Checkpoint::folder(folder), reason }
    })?;
    Ok((checkpoint, state, done))
}

fn table(o: &CyclesOutcome, folder: &Path, seconds: f64) -> String {
    let (experiment, means) = (&o.experiment, &o.means);
    let algorithm = &experiment.scene.algorithm;
    let mut out = String::new();
    let mut line = |name: &str, text: String| {
        let _ = writeln!(out, "{name:<14} {text}");
    };
    line(o.judgement.verdict.heading(), o.judgement.text.clone());
    line("scene", format!("{} (seed {})", experiment.name, experiment.scene.seed));
    line("method", format!("{}, {}: {}", algorithm.method.name(), algorithm.solver_name(), o.status.name()));
    line(
        "cycles",
        format!(
            "{} windows of {} steps, {} apart, B {}; {} in the means",
            o.cycles.len(),
            o.window,
            o.shift,
            o.covariance,
            means.count
        ),
    );
    line(
        "sizes",
        format!("{} unknowns, {} observed values in all", experiment.n_control(), o.observed_values()),
    );
    for (i, group) in experiment.state.groups.iter().enumerate() {
        if let (Some(b), Some(s), Some(e)) =
            (means.rmse_background[i], means.rmse_start[i], means.rmse_end[i])
        {
            let unit = group.unit_after();
            let spread = means.spread[i].map_or(String::new(), |s| format!("; spread {s:.4}{unit}"));
            line(
                &group.labelled("RMSE"),
                format!("background {b:.4}, analysis {s:.4}, at the window's end {e:.4}{unit}{spread}"),
            );
        }
    }
    if let (Some(chi2), Some(of_all)) = (means.chi2, means.chi2_of_all) {
        line("2J/m", format!("{chi2:.3} a window, {of_all:.3} over all"));
    }
    let of = Departures::from(means.departures);
    if let (Some(innovations), Some(r)) = (of.innovation_ratio(), of.observation_ratio()) {
        let b = of.background_ratio().map_or(String::new(), |b| format!(", B {b:.2}"));
        line(
            "departures",
            format!(
                "found/assumed: innovations {innovations:.2}, R {r:.2}{b} (1 where the errors are right)"
            ),
        );
    }
    if let Some(inflation) = means.inflation.filter(|i| *i != 1.0) {
        line("inflation", format!("{inflation:.3}"));
    }
    let each = means.seconds.map_or(String::new(), |s| format!(", {:.2} ms a cycle", 1e3 * s));
    line("time", format!("{seconds:.2} s{each}"));
    for w in &o.warnings {
        line("note", w.clone());
    }
    line("report", folder.join("report.html").display().to_string());
    out
}
