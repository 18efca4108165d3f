//! A fit far too bad over a window that amplifies: another minimum is likelier than a wrong σ, and growing
//! the window finds it.

use std::cell::Cell;

use varda_assimilation::{ObservationSet, Status, highest_j_of_a_fit};

use super::amplification;
use crate::Error;
use crate::outcome::WorkCounts;
use crate::setup::Problem;
use crate::setup::runs::run_on;
use crate::solve::{self, Iterate, OnIterate, Solution, Task};

/// J is far too high beyond this many times that of the worst fit.
const FAR: f64 = 2.0;
/// ‖M‖ from which a window may have several minima: two e-foldings or so.
const AMPLIFIES: f64 = 10.0;
/// Errors that grow all the time grow by as much in the second half of the window; of those that only move
/// between places and velocities, as a rod's do, ‖M‖ is as large over half of it.
const GROWS: f64 = 3.0;
/// Iterations of the second try at most.
const MOST: usize = 100;
/// Sub-windows.
const PARTS: usize = 10;

/// What was found out about another minimum.
pub(super) struct Second {
    /// In words.
    pub text: String,
    /// Whether another minimum explains the misfit: growth found a lower one, or could not be tried.
    pub explains: bool,
}

/// Ends a first minimization that is about to use up its iterations far above m/2 over a window that
/// amplifies, so that growth has some.
pub(super) struct Reserve<'a> {
    problem: &'a Problem,
    /// Values and last step of the observations.
    observed: [usize; 2],
    /// By how much the window amplifies where the minimization was ended.
    taken: Cell<Option<f64>>,
}

/// Iterations from one look of [`Reserve`] to the next.
const LOOK_EVERY: usize = 10;

impl<'a> Reserve<'a> {
    pub(super) fn of(problem: &'a Problem, observations: &ObservationSet) -> Reserve<'a> {
        let observed = [observations.dim(), observations.last_step().unwrap_or(0)];
        Reserve { problem, observed, taken: Cell::new(None) }
    }

    /// Whether the minimization ends here, after `used` iterations at z with J. Asked of every iterate, it
    /// looks at some of the last ones: in between a start may be at a stage of enlarged σ, or where nothing
    /// amplifies.
    pub(super) fn ends(&self, used: usize, j: f64, control: &[f64]) -> bool {
        let [m, last] = self.observed;
        let most = self.problem.experiment.scene.algorithm.max_iterations;
        let looks = self.taken.get().is_none()
            && used + MOST >= most
            && used < most
            && (most - used).is_multiple_of(LOOK_EVERY)
            && self.problem.experiment.scene.algorithm.window_growth.is_empty()
            && may_grow(self.problem)
            && j > FAR * highest_j_of_a_fit(m);
        let found = if looks { amplifies(self.problem, control, last) } else { None };
        self.taken.set(self.taken.get().or(found));
        found.is_some()
    }
}

/// Whether the method of a scene can grow its window.
fn may_grow(problem: &Problem) -> bool {
    let method = problem.experiment.scene.algorithm.method;
    method.is_strong() && method.takes_window_growth() && problem.adaptive_steps.is_none()
}

/// Where a minimization ended far above m/2 over a window that amplifies, tries again through growing
/// sub-windows, and gives the lower end with a remark. Everywhere else the solution as it is.
///
/// # Errors
/// As for [`solve::solve`].
pub(super) fn look(
    problem: &Problem,
    task: &mut Task,
    mut solution: Solution,
    observations: ObservationSet,
    reserve: &Reserve,
    on_iterate: &mut OnIterate,
) -> Result<(Solution, ObservationSet, Option<Second>), Error> {
    let algorithm = &problem.experiment.scene.algorithm;
    let (steps, m) = (observations.steps(), observations.dim());
    let minimum = &solution.minimum;
    let (j, used) = (minimum.value, minimum.outer_iterations);
    let ended = match minimum.status {
        Status::Converged | Status::Stalled => true,
        Status::Interrupted => reserve.taken.get().is_some(),
        _ => false,
    };
    // nobody interrupted it
    if minimum.status == Status::Interrupted && ended {
        solution.minimum.status = Status::MaxIterations;
    }
    let applies =
        ended && may_grow(problem) && used < algorithm.max_iterations && j > FAR * highest_j_of_a_fit(m);
    let first = observations.observations().iter().map(|o| o.step + 1).min().unwrap_or(steps);
    let growth: Vec<usize> = (1..PARTS).map(|i| steps * i / PARTS).filter(|w| *w >= first).collect();
    if !applies {
        return Ok((solution, observations, None));
    }
    let here = || amplifies(problem, &solution.control, reserve.observed[1]);
    let Some(norm) = reserve.taken.get().or_else(here) else {
        return Ok((solution, observations, None));
    };
    let start = format!(
        "J = {j:.4} is far above m/2 = {:.1}, and the window amplifies errors {norm:.0} times",
        0.5 * m as f64
    );
    if growth.is_empty() || !algorithm.window_growth.is_empty() {
        let text = format!("{start}: it may be another minimum; a shorter window would tell");
        return Ok((solution, observations, Some(Second { text, explains: true })));
    }
    let mut windows = growth;
    windows.dedup();
    windows.push(steps);
    task.algorithm.window_growth = windows;
    task.algorithm.sigma_stages.clear();
    task.algorithm.background_check = None;
    task.algorithm.max_iterations = (algorithm.max_iterations - used).min(MOST);
    let before = solution.counts;
    let again = solve::solve(task, observations, &mut |r: &Iterate| {
        let so_far: (usize, WorkCounts) = (used + r.before.0, before + r.before.1);
        on_iterate(&Iterate { before: so_far, ..*r })
    });
    task.algorithm = algorithm.clone();
    let (mut grown, observations) = again?;
    let lower = grown.minimum.value < j * (1.0 - 1e-3);
    let remark = if lower {
        format!(
            "{start}: that was another minimum; through growing sub-windows the run came to J = {:.4} \
             (algorithm.window_growth does so from the start)",
            grown.minimum.value
        )
    } else {
        format!(
            "{start}: it may be another minimum, though growing the window found none lower (J = {:.4}); a \
             shorter window would tell",
            grown.minimum.value
        )
    };
    let mut best = solution;
    let iterations = [used, best.minimum.inner_iterations];
    let (counts, status) = (best.counts + grown.counts, grown.minimum.status);
    let ended = [grown.minimum.outer_iterations, grown.minimum.inner_iterations];
    if lower {
        grown.minimum.gradient_norm_first = best.minimum.gradient_norm_first;
        grown.rejected = std::mem::take(&mut best.rejected);
        grown.attempts.splice(0..0, std::mem::take(&mut best.attempts));
        best = grown;
    }
    if status == Status::Interrupted {
        best.minimum.status = status;
    }
    best.counts = counts;
    best.minimum.outer_iterations = iterations[0] + ended[0];
    best.minimum.inner_iterations = iterations[1] + ended[1];
    Ok((best, observations, Some(Second { text: remark, explains: lower })))
}

/// ‖M‖ over so many steps from a control, where that is much and grew to the end.
fn amplifies(problem: &Problem, control: &[f64], steps: usize) -> Option<f64> {
    if steps < 2 {
        return None;
    }
    let mut model = problem.model();
    let n = model.dim();
    let mut states = vec![0.0; n];
    model.initial_state(control, &mut states).ok()?;
    run_on(model.as_mut(), &mut states, steps).ok()?;
    let mut sigma = vec![0.0; control.len()];
    problem.covariance.as_ref().variance(&mut sigma);
    sigma.iter_mut().for_each(|s| *s = s.sqrt());
    let mut norm = |last: usize| {
        let states = &states[..(last + 1) * n];
        let seed = problem.experiment.scene.seed;
        Some(amplification::estimate(model.as_mut(), control, &sigma, states, seed)?.norm)
    };
    let whole = norm(steps).filter(|norm| *norm >= AMPLIFIES)?;
    (whole >= GROWS * norm(steps / 2)?).then_some(whole)
}
