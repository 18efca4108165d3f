//! `run` and `check` of several recordings.

use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use super::progress::ProgressDisplay;
use super::{RunOptions, Shown, exit, preview, style};
use crate::Error;
use crate::outcome::{JointOutcome, Status, in_words};
use crate::preview::Preview;
use crate::report::{JointSummary, write_recordings};
use crate::run::{Listener, assimilate_recordings};
use crate::scene::SceneFile;
use crate::setup::{Problem, Recordings};

/// Most notes in a table; the report has all of them.
const MOST_NOTES: usize = 6;

pub(super) fn run(
    file: &SceneFile,
    folder: &Path,
    progress: &mut ProgressDisplay,
    interrupted: &dyn Fn() -> bool,
    options: RunOptions,
    started: Instant,
) -> Result<ExitCode, Error> {
    let (mut problems, mut said) = (Vec::new(), String::new());
    for inputs in Recordings::inputs(file)? {
        for line in preview::in_short(&inputs).lines() {
            let _ = writeln!(said, "{}: {line}", inputs.file.name);
        }
        problems.push(Problem::new(inputs)?);
    }
    let all = Recordings::of(file.clone(), problems)?;
    if options.shown != Shown::Nothing {
        eprint!("{said}");
    }
    let values =
        all.problems.iter().map(|problem| Ok(problem.observations()?.dim())).sum::<Result<_, Error>>()?;
    let steps = all.problems.iter().map(|problem| problem.experiment.grid.steps).max().unwrap_or(0);
    progress.expect(values, steps);
    let mut listener = Listener {
        on_iteration: Box::new(|row| progress.row(row)),
        interrupted: Box::new(interrupted),
        ends: None,
        started,
    };
    let outcome = assimilate_recordings(&all, &mut listener)?;
    drop(listener);
    progress.finish();
    let folder = write_recordings(&outcome, folder)?;
    match options.shown {
        Shown::Nothing => {}
        Shown::Table => style::table(
            outcome.judgement.verdict,
            &table(&outcome, &folder, started.elapsed().as_secs_f64()),
        ),
        Shown::Json => style::print(&JointSummary::new(&outcome).to_json()),
    }
    if outcome.status == Status::Failed {
        style::message(outcome.warnings.first().map_or("the minimizer failed", String::as_str));
        return Ok(ExitCode::FAILURE);
    }
    let warned =
        !outcome.warnings.is_empty() || outcome.recordings.iter().any(|one| !one.warnings.is_empty());
    Ok(exit::code(&outcome.judgement, outcome.status, outcome.late, options.strict && warned))
}

pub(super) fn check(file: &SceneFile) -> Result<ExitCode, Error> {
    let mut wrong = false;
    for inputs in Recordings::inputs(file)? {
        let preview = Preview::of(inputs)?;
        style::print(&preview::table(&preview));
        wrong |= preview.has_errors();
    }
    // what they share must be the same
    Recordings::from_scene(file)?;
    Ok(if wrong { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn table(o: &JointOutcome, folder: &Path, seconds: f64) -> String {
    let mut out = String::new();
    let mut line = |name: &str, text: String| {
        let _ = writeln!(out, "{name:<14} {text}");
    };
    let algorithm = &o.scene.algorithm;
    line(o.judgement.verdict.heading(), o.judgement.text.clone());
    line("scene", format!("{} (seed {})", o.name, o.scene.seed));
    line("method", format!("{}, {}: {}", algorithm.method.name(), algorithm.solver_name(), o.status.name()));
    line(
        "sizes",
        format!(
            "{}, {} unknowns, {} observed values",
            in_words(o.recordings.len()),
            o.unknowns,
            o.observations
        ),
    );
    line("J", format!("{:.6} -> {:.6}  (2J/m = {:.3})", o.j_background, o.j, o.chi2));
    line(
        "gradient",
        format!(
            "{:.2e} -> {:.2e} in {} outer iterations",
            o.gradient_norms[0], o.gradient_norms[1], o.iterations[0]
        ),
    );
    for one in &o.recordings {
        let a = &one.analysis;
        let text = format!("J {:.4}, 2J/m = {:.3} of {} values", a.value, a.chi2, a.observations);
        line(&one.experiment.name, text);
        for w in &one.withheld {
            let [b, a] = [w.rms_background, w.rms_analysis].map(|m| 1e3 * m);
            line("  withheld", format!("{}: {b:.2} mm -> {a:.2} mm", w.label));
        }
        for f in &one.forecast {
            line("  forecast", format!("{}: {:.2} mm rms", f.label, 1e3 * f.analysis));
        }
    }
    // a field has a value at every vertex: estimates.csv has all
    for e in o.estimates.iter().filter(|e| !e.is_of_field()) {
        line(&e.name, e.in_words());
    }
    let s = &o.seconds;
    line(
        "time",
        format!(
            "{seconds:.2} s: set-up {:.2}, minimization {:.2}, posterior {:.2}, diagnostics {:.2}{}",
            s.set_up,
            s.minimizer,
            s.posterior,
            s.diagnostics,
            if s.mesh > 0.0 { format!(", finer mesh {:.2}", s.mesh) } else { String::new() }
        ),
    );
    let notes = o.notes();
    notes.iter().take(MOST_NOTES).for_each(|note| line("note", note.clone()));
    if notes.len() > MOST_NOTES {
        line("note", format!("{} more in summary.json", notes.len() - MOST_NOTES));
    }
    line("report", folder.join("report.html").display().to_string());
    out
}
