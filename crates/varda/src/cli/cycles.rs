//! `varda run` of a scene with `[algorithm.cycles]`.

use std::fmt::Write;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use varda_assimilation::CycleState;

use crate::Error;
use crate::report;
use crate::report::checkpoint::Partial;
use crate::run::cycles::{Listener, Outcome, Row, Sequence};
use crate::run::window::Status;
use crate::scene::SceneFile;

use super::INTERRUPTED;
use super::progress::Progress;

pub(super) fn run(
    file: &SceneFile,
    sequence: &mut Sequence,
    folder: &Path,
    taken_up: Option<(Partial, Option<CycleState>, Vec<Row>)>,
    progress: &mut Progress,
    interrupted: &dyn Fn() -> bool,
    quiet: bool,
    started: Instant,
) -> Result<ExitCode, Error> {
    let (mut partial, state, done) = match taken_up {
        Some(taken_up) => taken_up,
        None => (Partial::begin(folder, file)?, None, Vec::new()),
    };
    let resumed = done.len();
    let count = sequence.cycles.count;
    let start = sequence.start();
    let state = state.unwrap_or_else(|| start.clone());
    let fits = state.next <= count
        && state.background.len() == start.background.len()
        && (start.columns.is_empty() || state.columns.len() == start.columns.len());
    if !fits {
        let reason = "state.json is not a state of this scene".to_string();
        return Err(Error::Resume { path: Partial::folder(folder), reason });
    }
    let mut listener = Listener {
        on_cycle: &mut |row, after| {
            progress.cycle(row, resumed, count);
            partial.store(row, after)
        },
        interrupted,
        started,
    };
    let outcome = match sequence.run(state, done, &mut listener) {
        Ok(outcome) => outcome,
        Err(error) => {
            // Not one window was done: nothing is worth resuming.
            if !matches!(error, Error::Write { .. }) {
                partial.remove()?;
            }
            return Err(error);
        }
    };
    progress.finish();
    let shown = report::write_cycles(sequence, &outcome, folder)?;
    if outcome.cycles.len() == count || outcome.status == Status::Failed {
        partial.remove()?;
    }
    if !quiet {
        print!("{}", table(sequence, &outcome, &shown, started.elapsed().as_secs_f64()));
    }
    Ok(match outcome.status {
        Status::Interrupted => {
            if !quiet {
                println!("{:<14} add --resume to the same command", "to go on");
            }
            ExitCode::from(INTERRUPTED)
        }
        Status::Failed => {
            let reason = outcome.warnings.first().map_or("a minimization failed", String::as_str);
            eprintln!("error: {reason}");
            ExitCode::FAILURE
        }
        Status::Converged | Status::MaxIterations | Status::Stalled => ExitCode::SUCCESS,
    })
}

fn table(sequence: &Sequence, o: &Outcome, folder: &Path, seconds: f64) -> String {
    let (problem, means) = (&sequence.problem, &o.means);
    let algorithm = &problem.scene.algorithm;
    let mut out = String::new();
    let mut line = |name: &str, text: String| {
        let _ = writeln!(out, "{name:<14} {text}");
    };
    line("scene", format!("{} (seed {})", problem.name, problem.scene.seed));
    line("method", format!("{}, {}: {}", algorithm.method.name(), algorithm.solver_name(), o.status.name()));
    line(
        "cycles",
        format!(
            "{} windows of {} steps, {} apart, B {}; {} in the means",
            o.cycles.len(),
            sequence.window,
            sequence.shift,
            sequence.cycles.covariance_of(algorithm.method).name(),
            means.count
        ),
    );
    line(
        "sizes",
        format!(
            "{} unknowns, {} observed values in all",
            problem.control_dim(),
            o.cycles.iter().map(|r| r.observations).sum::<usize>()
        ),
    );
    let names: &[(&str, &str)] = match problem.scene.model_is_rod() {
        true => &[("RMSE position", " m"), ("RMSE velocity", " m/s")],
        false => &[("RMSE", "")],
    };
    for (i, (name, unit)) in names.iter().enumerate() {
        if let (Some(b), Some(s), Some(e)) =
            (means.rmse_background[i], means.rmse_start[i], means.rmse_end[i])
        {
            let spread = means.spread[i].map_or(String::new(), |s| format!("; spread {s:.4}{unit}"));
            line(
                name,
                format!("background {b:.4}, analysis {s:.4}, at the window's end {e:.4}{unit}{spread}"),
            );
        }
    }
    if let Some(chi2) = means.chi2 {
        line("2J/m", format!("{chi2:.3}"));
    }
    let each = means.seconds.map_or(String::new(), |s| format!(", {:.2} ms a cycle", 1e3 * s));
    line("time", format!("{seconds:.2} s{each}"));
    for w in &o.warnings {
        line("note", w.clone());
    }
    line("report", folder.join("report.html").display().to_string());
    out
}
