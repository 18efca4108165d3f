//! The runs that a sequence of windows shows: from every window's analysis to the start of the next, with σ
//! and what was seen beside them.

use std::cell::RefCell;
use std::rc::Rc;

use varda_assimilation::{
    Carried, CyclePosterior, Error as AssimilationError, Observation, propagate_errors, propagate_root,
};

use super::fit::predicted;
use super::seen_spread::SeenSpread;
use super::sequence::{Sequence, SharedOperator, at};
use super::spread::values_of;
use crate::Error;
use crate::outcome::{CycleRow, CycleSigma, ObservedValue, Trajectories};
use crate::setup::Problem;
use crate::setup::memory::has_root;
use crate::setup::runs::run_states;

/// What a sequence shows.
pub(super) struct Runs {
    pub(super) trajectories: Trajectories,
    /// As in [`CyclesOutcome`](crate::outcome::CyclesOutcome).
    pub(super) sigma_states: Vec<f64>,
    pub(super) observed: Vec<ObservedValue>,
}

/// Everything that was seen in a sequence, also what is kept back, in the order of time.
pub(super) struct Everything {
    operators: Vec<SharedOperator>,
    /// Without values; steps counted from the start of the sequence.
    observations: Vec<Observation>,
    /// For each of them the number of what was seen.
    order: Vec<usize>,
}

impl Everything {
    pub(super) fn of(problem: &Problem) -> Result<Everything, Error> {
        let (set, order) = problem.observed.everything(&problem.experiment.grid)?;
        let (operators, observations) = set.into_parts();
        let operators = operators.into_iter().map(|o| Rc::new(RefCell::new(o))).collect();
        Ok(Everything { operators, observations, order })
    }

    /// Index of the first observation from a step on.
    fn first_at(&self, first: usize) -> usize {
        self.observations.partition_point(|o| o.step < first)
    }
}

impl Sequence {
    /// Whether σ along the windows is computed: as of a single window.
    pub(super) fn has_sigma(&self) -> bool {
        let scene = &self.problem.experiment.scene;
        scene.report.posterior && has_root(scene.algorithm.method, self.problem.background.len())
    }

    /// Steps of a window that the sequence shows, or may show: to its end, and to the start of the next.
    pub(super) fn steps(&self) -> usize {
        self.window.max(self.shift)
    }

    /// σ along a window that was done, of its posterior. What it lacks is said in the result.
    pub(super) fn sigma_along(
        &self,
        row: &CycleRow,
        posterior: Option<&CyclePosterior>,
        before: Option<f64>,
        everything: &Everything,
    ) -> CycleSigma {
        let missing = |reason: String| CycleSigma { missing: Some(reason), ..CycleSigma::default() };
        let posterior = match posterior {
            None => return missing(format!("the minimization ended as {}", row.status.name())),
            Some(CyclePosterior::Indefinite(reason)) => return missing(reason.clone()),
            Some(posterior) => posterior,
        };
        match self.carried(row, posterior, before, everything) {
            Ok(sigma) if sigma.states.iter().all(|s| s.is_finite()) => sigma,
            Ok(_) => missing("it is not finite".into()),
            Err(error) => missing(error.to_string()),
        }
    }

    fn carried(
        &self,
        row: &CycleRow,
        posterior: &CyclePosterior,
        before: Option<f64>,
        everything: &Everything,
    ) -> Result<CycleSigma, Error> {
        let (steps, n) = (self.steps(), self.problem.experiment.n_state);
        let states = self.states_of(row, before, steps)?;
        let mut model = self.model_of(row.first_step, before);
        let last = (row.first_step + steps) as f64;
        let seen = everything.observations[everything.first_at(row.first_step)..].iter();
        let seen = seen.take_while(|o| at(o) <= last);
        let mut set = self.set_from(&everything.operators, row.first_step, steps, seen)?;
        set.follow(model.rate());
        let mut seen = SeenSpread::new(set, &states, n)?;
        // The start of the next window is shown as that window has it, unless there is none.
        let shown = (self.window + 1).max(self.shift);
        let mut sigma = Vec::with_capacity(shown * n);
        let mut see = |at: &Carried| {
            if at.step < shown {
                sigma.extend(at.variance().into_iter().map(f64::sqrt));
            }
            seen.see(at, &mut |_, _, _, _| {});
        };
        match posterior {
            CyclePosterior::Root(root) => {
                let mut before = Vec::new();
                propagate_root(model.as_mut(), &row.analysis, root, &states, &mut |step, now| {
                    see(&Carried { step, dim: n, before: &before, now, less: 0 });
                    before.clear();
                    before.extend_from_slice(now);
                    Ok(())
                })?;
            }
            CyclePosterior::WithErrors(columns) => {
                let forcing = self.forcing();
                let q = self.problem.model_error.as_ref().ok_or(AssimilationError::Setting {
                    what: "the covariance of a model error that is not there",
                    value: 0.0,
                })?;
                let errors = (&forcing, q.as_ref());
                propagate_errors(model.as_mut(), columns, errors, &states, &mut |at| {
                    see(at);
                    Ok(())
                })?;
            }
            CyclePosterior::Members(runs) => {
                let (mut before, mut now) = (Vec::new(), Vec::new());
                for step in 0..=steps {
                    deviations(runs, n, steps, step, &mut now);
                    see(&Carried { step, dim: n, before: &before, now: &now, less: 0 });
                    std::mem::swap(&mut before, &mut now);
                }
            }
            CyclePosterior::Indefinite(_) => {}
        }
        Ok(CycleSigma { states: sigma, seen: seen.sigma, missing: None })
    }

    /// Runs from every window's analysis to the next one's start, the last to its end; the truth over the
    /// same steps; σ, and what was seen. A step that two windows share has the later one's value, which has
    /// seen more.
    ///
    /// # Errors
    /// [`Error::Assimilation`] where a state cannot be observed.
    pub(super) fn runs(
        &self,
        rows: &[CycleRow],
        everything: &Everything,
        warnings: &mut Vec<String>,
    ) -> Result<Runs, Error> {
        let dim = self.problem.experiment.n_state;
        let (mut analysis, mut sigma_states, mut observed) = (Vec::new(), Vec::new(), Vec::new());
        for (i, row) in rows.iter().enumerate() {
            let last = i + 1 == rows.len();
            let before = i.checked_sub(1).and_then(|before| rows[before].next_end_angle);
            let steps = if last { self.window } else { self.shift };
            let states = match self.states_of(row, before, steps) {
                Ok(states) => states,
                Err(e) => {
                    warnings.push(format!("the run of the analysis ends early, in cycle {}: {e}", row.cycle));
                    break;
                }
            };
            let shown = dim * if last { steps + 1 } else { steps };
            let sigma = row.sigma.states.get(..shown).unwrap_or(&[]);
            sigma_states.extend_from_slice(sigma);
            sigma_states.extend(std::iter::repeat_n(f64::NAN, shown - sigma.len()));
            self.observe(row, before, (&states, steps, last), everything, &mut observed)?;
            analysis.extend_from_slice(&states[..shown]);
        }
        if sigma_states.iter().all(|s| s.is_nan()) {
            sigma_states.clear();
        }
        warnings.extend(without_sigma(rows));
        let steps = rows.last().map_or(0, |r| r.first_step + self.window);
        let truth = self.truth.get(..(steps + 1) * dim).unwrap_or(&[]).to_vec();
        let trajectories = Trajectories { dim, background: Vec::new(), analysis, truth };
        Ok(Runs { trajectories, sigma_states, observed })
    }

    /// What was seen in the part of a window that the sequence shows, beside the run from its background and
    /// that of its analysis.
    fn observe(
        &self,
        row: &CycleRow,
        before: Option<f64>,
        (analysis, steps, last): (&[f64], usize, bool),
        everything: &Everything,
        out: &mut Vec<ObservedValue>,
    ) -> Result<(), Error> {
        let (first, from) = (row.first_step, everything.first_at(row.first_step));
        let end = (first + steps) as f64;
        let seen = everything.observations[from..].iter();
        let seen = seen.take_while(|o| if last { at(o) <= end } else { at(o) < end });
        let mut set = self.set_from(&everything.operators, first, steps, seen)?;
        let mut model = self.model_of(first, before);
        set.follow(model.rate());
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&row.background, &mut x)?;
        // a run that ends early has no values
        let background = run_states(model.as_mut(), &x, steps).unwrap_or_default();
        let runs = Trajectories { dim: x.len(), ..Trajectories::default() };
        let at_background = predicted(&mut set, &runs, &background)?;
        let at_analysis = predicted(&mut set, &runs, analysis)?;
        for (place, o) in set.observations().iter().enumerate() {
            let one = &self.problem.observed.seen[everything.order[from + place]];
            let reason = match () {
                () if self.problem.observed.sites[one.site].withheld => "withheld",
                () if at(o) > self.window as f64 => "between two windows",
                () => "",
            };
            let rows = set.rows(place);
            let runs = [&at_background[rows.clone()], &at_analysis[rows]];
            let sigma = row.sigma.seen.get(place).map_or(&[][..], Vec::as_slice);
            out.extend(values_of(&self.problem, one, runs, sigma, reason));
        }
        Ok(())
    }
}

/// (x_i − x̄)/√(N − 1) of the members at a step, by columns.
fn deviations(runs: &[f64], n: usize, steps: usize, step: usize, columns: &mut Vec<f64>) {
    columns.clear();
    let at = |run: &[f64]| run[step * n..(step + 1) * n].to_vec();
    runs.chunks_exact((steps + 1) * n).for_each(|run| columns.extend(at(run)));
    let count = (columns.len() / n) as f64;
    let mut mean = vec![0.0; n];
    for x in columns.chunks_exact(n) {
        mean.iter_mut().zip(x).for_each(|(mean, x)| *mean += x / count);
    }
    let size = (count - 1.0).sqrt();
    for x in columns.chunks_exact_mut(n) {
        x.iter_mut().zip(&mean).for_each(|(x, mean)| *x = (*x - mean) / size);
    }
}

/// The windows of which σ is not known, and why of the first.
fn without_sigma(rows: &[CycleRow]) -> Option<String> {
    let missing = || rows.iter().filter_map(|row| Some((row.cycle, row.sigma.missing.as_ref()?)));
    let (first, reason) = missing().next()?;
    let count = missing().count();
    Some(format!(
        "σ is left out in {count} of {} cycles, the first of them cycle {first}: {reason}",
        rows.len()
    ))
}
