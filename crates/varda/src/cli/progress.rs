//! Progress of a run: nothing at first, then a bar, or plain lines without a terminal.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::outcome::{ConvergenceRow, CycleRow};

/// A run shorter than this shows only its table.
const PATIENCE: Duration = Duration::from_secs(2);
/// Plain lines are this far apart.
const PACE: Duration = Duration::from_secs(5);

pub(super) struct ProgressDisplay {
    tolerance: f64,
    max_iterations: usize,
    quiet: bool,
    started: Instant,
    first: Option<(Instant, f64)>,
    bar: Option<ProgressBar>,
    last_line: Option<Instant>,
}

impl ProgressDisplay {
    pub(super) fn new(tolerance: f64, max_iterations: usize, quiet: bool, started: Instant) -> Self {
        ProgressDisplay { tolerance, max_iterations, quiet, started, first: None, bar: None, last_line: None }
    }

    pub(super) fn row(&mut self, row: &ConvergenceRow) {
        let (began, gradient) = *self.first.get_or_insert((Instant::now(), row.gradient_norm));
        // The gradient falls about evenly on a log scale: how far along it is tells the seconds left.
        let done = (gradient / row.gradient_norm).ln() / (1.0 / self.tolerance).ln();
        let by_count = row.iteration as f64 / self.max_iterations as f64;
        let message =
            format!("iteration {}  J {:.6e}  |grad| {:.2e}", row.iteration, row.j, row.gradient_norm);
        self.show(began, done.max(by_count).clamp(0.0, 1.0), message);
    }

    /// A window of a sequence is done; the first `resumed` ones were done before.
    pub(super) fn cycle(&mut self, row: &CycleRow, resumed: usize, count: usize) {
        let now = row.cycle + 1;
        let rmse = row.rmse_end.first().map_or(String::new(), |e| format!("  RMSE {e:.4}"));
        let share = (now - resumed) as f64 / (count - resumed).max(1) as f64;
        self.show(self.started, share, format!("cycle {now} of {count}  2J/m {:.3}{rmse}", row.chi2));
    }

    /// Shows a message and the seconds left, estimated from the even progress since `began`.
    fn show(&mut self, began: Instant, share: f64, message: String) {
        if self.quiet || self.started.elapsed() < PATIENCE {
            return;
        }
        let left = (share > 0.0).then(|| began.elapsed().as_secs_f64() * (1.0 - share) / share);
        let left = left.map_or(String::from("?"), |s| format!("{s:.0}"));
        let message = format!("{message}  about {left} s left");
        if std::io::stderr().is_terminal() {
            let bar = self.bar.get_or_insert_with(|| {
                let style = ProgressStyle::with_template("[{bar:30}] {msg}")
                    .unwrap_or_else(|_| ProgressStyle::default_bar());
                ProgressBar::with_draw_target(Some(1000), ProgressDrawTarget::stderr()).with_style(style)
            });
            bar.set_position((1000.0 * share) as u64);
            bar.set_message(message);
        } else if self.last_line.is_none_or(|t| t.elapsed() >= PACE) {
            eprintln!("{message}");
            self.last_line = Some(Instant::now());
        }
    }

    pub(super) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
