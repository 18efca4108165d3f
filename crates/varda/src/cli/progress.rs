//! Progress of a run: nothing at first, then a bar, or plain lines without a terminal.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use varda_assimilation::highest_j_of_a_fit;

use crate::outcome::{ConvergenceRow, CycleRow};
use crate::sweep::runs::Progress as SweepProgress;

/// A run shorter than this shows only its table.
const PATIENCE: Duration = Duration::from_secs(2);
/// Plain lines are this far apart.
const PACE: Duration = Duration::from_secs(5);
/// From so much of the way on it tells how long the rest takes.
const TELLING: f64 = 0.2;

pub(super) struct ProgressDisplay {
    quiet: bool,
    started: Instant,
    /// Seconds that the scene allows.
    allowed: Option<f64>,
    /// Observed values, and steps of the whole window.
    expected: Option<(usize, usize)>,
    run: Option<RunningRun>,
    bar: Option<ProgressBar>,
    last_line: Option<Instant>,
}

/// One run of the minimizer: of a start, a stage of inflated errors, a sub-window.
struct RunningRun {
    /// What tells it from others.
    which: (usize, u64, usize),
    began: Instant,
    gradient: f64,
}

impl ProgressDisplay {
    pub(super) fn new(quiet: bool, started: Instant, allowed: Option<f64>) -> Self {
        ProgressDisplay { quiet, started, allowed, expected: None, run: None, bar: None, last_line: None }
    }

    /// How many values a window of so many steps has: what J is expected to come to.
    pub(super) fn expect(&mut self, values: usize, steps: usize) {
        self.expected = Some((values, steps));
    }

    pub(super) fn row(&mut self, row: &ConvergenceRow) {
        let which = (row.attempt, row.sigma_factor.to_bits(), row.window);
        if self.run.as_ref().is_none_or(|run| run.which != which) {
            self.run = Some(RunningRun { which, began: Instant::now(), gradient: row.gradient_norm });
        }
        let share = self.run.as_ref().map_or(0.0, |run| way_done(run.gradient, row));
        let left = self.run.as_ref().and_then(|run| seconds_left(run.began.elapsed(), share));
        let goal = self.expected.filter(|(_, steps)| *steps == row.window && row.sigma_factor == 1.0);
        let goal = goal.map(|(values, _)| highest_j_of_a_fit(values));
        self.show(share, line(row, goal, left));
    }

    /// A window of a sequence is done; the first `resumed` ones were done before.
    pub(super) fn cycle(&mut self, row: &CycleRow, resumed: usize, count: usize) {
        let now = row.cycle + 1;
        let rmse = row.rmse_end.first().map_or(String::new(), |e| format!("  RMSE {e:.4}"));
        let share = (now - resumed) as f64 / (count - resumed).max(1) as f64;
        let left = seconds_left(self.started.elapsed(), share);
        let left = left.map_or(String::new(), |s| format!("  about {s:.0} s left"));
        self.show(share, format!("cycle {now} of {count}  2J/m {:.3}{rmse}{left}", row.chi2));
    }

    /// A run of a sweep has ended.
    pub(super) fn sweep(&mut self, now: &SweepProgress) {
        let SweepProgress { done, before, count, failures } = *now;
        let share = (done - before) as f64 / (count - before).max(1) as f64;
        let left = seconds_left(self.started.elapsed(), share);
        let left = left.map_or(String::new(), |s| format!("  about {s:.0} s left"));
        let failed = if failures == 0 { String::new() } else { format!("  {failures} failed") };
        self.show(share, format!("run {done} of {count}{failed}{left}"));
    }

    /// Shows a message and how much is done.
    fn show(&mut self, share: f64, message: String) {
        if self.quiet || self.started.elapsed() < PATIENCE {
            return;
        }
        let most = self.allowed.map(|all| all - self.started.elapsed().as_secs_f64());
        let most = most.map_or(String::new(), |s| format!("  at most {:.0} s more", s.max(1.0)));
        let message = format!("{message}{most}");
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

/// How much of the way from the first gradient of a run to its goal is done, on a log scale, on which it
/// falls about evenly.
fn way_done(first: f64, row: &ConvergenceRow) -> f64 {
    let share = (first / row.gradient_norm).ln() / (first / row.gradient_goal).ln();
    if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 }
}

/// Seconds left at the pace so far; nothing before enough of the way is done, and nothing where the pace says
/// less than a second: what is still running then does not keep to it.
fn seconds_left(elapsed: Duration, share: f64) -> Option<f64> {
    let left = elapsed.as_secs_f64() * (1.0 - share) / share;
    (share >= TELLING && left >= 1.0).then_some(left)
}

/// Which start, J and ‖∇J‖ beside their goals, and the seconds left of this start.
fn line(row: &ConvergenceRow, fit: Option<f64>, left: Option<f64>) -> String {
    let start = match row.attempts {
        0 | 1 => String::new(),
        most => format!("start {} of at most {most}  ", row.attempt),
    };
    let stage = if row.sigma_factor == 1.0 { String::new() } else { format!("  σ × {}", row.sigma_factor) };
    let fit = fit.map_or(String::new(), |j| format!(" (a fit: below {j:.4})"));
    let goal =
        if row.gradient_goal > 0.0 { format!(" (goal {:.1e})", row.gradient_goal) } else { String::new() };
    let of = if row.attempts > 1 { "of this start" } else { "left" };
    let left = left.map_or(String::new(), |s| format!("  about {s:.0} s {of}"));
    format!(
        "{start}iteration {}{stage}  J {:.6e}{fit}  |grad| {:.2e}{goal}{left}",
        row.iteration, row.j, row.gradient_norm
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::WorkCounts;

    fn row(gradient_norm: f64, attempt: usize) -> ConvergenceRow {
        ConvergenceRow {
            iteration: 12,
            seconds: 0.0,
            j: 63.5,
            j_b: 0.0,
            j_o: 63.5,
            j_q: 0.0,
            gradient_norm,
            gradient_goal: 1e-6,
            attempt,
            attempts: 9,
            rmse: Vec::new(),
            constants: Vec::new(),
            sigma_factor: 1.0,
            hessian: None,
            window: 100,
            counts: WorkCounts::default(),
        }
    }

    #[test]
    fn a_line_names_the_start_and_both_goals() {
        let text = line(&row(1e-3, 2), Some(83.2), Some(7.0));
        assert_eq!(
            text,
            "start 2 of at most 9  iteration 12  J 6.350000e1 (a fit: below 83.2000)  \
             |grad| 1.00e-3 (goal 1.0e-6)  about 7 s of this start"
        );
    }

    #[test]
    fn no_seconds_are_told_where_the_pace_says_none() {
        // half of the way in 10 s
        assert_eq!(seconds_left(Duration::from_secs(10), way_done(1.0, &row(1e-3, 1))), Some(10.0));
        // the goal is all but met, or met, and the run goes on
        for gradient in [1.01e-6, 1e-6, 1e-9] {
            assert_eq!(seconds_left(Duration::from_secs(80), way_done(1.0, &row(gradient, 1))), None);
        }
        // it has hardly begun, or rises
        for gradient in [0.9, 1.0, 5.0, f64::NAN] {
            assert_eq!(seconds_left(Duration::from_secs(80), way_done(1.0, &row(gradient, 1))), None);
        }
    }
}
