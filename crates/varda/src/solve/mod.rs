//! The member of the variational family that a scene names: from its cost to a minimum, the analysed control,
//! its spread and, where the analysis is not a run of the model, the analysed trajectory.

mod ensemble;
mod exact_hessian;
mod intervals;
pub(crate) mod joint;
pub mod minimizer;
mod strong;
mod task;
pub mod timed;
mod weak;

use varda_assimilation::{
    ControlTransform, CostFunction, Error, Minimum, ObservationSet, Rejection, StrongConstraint, WeakForcing,
    window_growth,
};

use crate::outcome::WorkCounts;
use crate::scene::Method;
use crate::setup::ensemble::anchors;
pub(crate) use task::{
    AT_THE_MINIMUM, Iterate, OnIterate, PosteriorSpread, Solution, Task, deviations, forcing,
};
use task::{SubWindow, SubWindowEnd};

/// Checks the observations against the background if the scene asks for that, and minimises: the whole window
/// at once, or growing sub-windows.
///
/// # Errors
/// A cost that cannot be built, or cannot be evaluated at the background. How a minimization ended is part of
/// the solution.
pub(crate) fn solve(
    task: &mut Task,
    mut observations: ObservationSet,
    on_iterate: &mut OnIterate,
) -> Result<(Solution, ObservationSet), crate::Error> {
    let mut spent = WorkCounts::default();
    let mut rejected = Vec::new();
    if let Some(limit) = task.algorithm.background_check {
        let (refused, counts) = task.background_check(&mut observations, limit)?;
        observations = observations.without(&refused.iter().map(|r| r.row).collect::<Vec<_>>())?;
        (rejected, spent) = (refused, counts);
    }
    let (whole, most) = (observations.steps(), task.algorithm.max_iterations);
    let growth = task.algorithm.window_growth.clone();
    let windows = if growth.is_empty() { vec![whole] } else { growth };
    let (mut states, mut done, mut ended, mut stages) = (Vec::new(), [0, 0], None, Vec::new());
    let mut attempts = Vec::new();
    let (observations, mut minima) =
        window_growth(observations, &windows, &mut Vec::new(), &mut |seen, v| {
            let window = seen.steps();
            task.algorithm.max_iterations = most.saturating_sub(done[0]);
            let stage = SubWindow {
                observations: seen,
                v,
                states: &mut states,
                whole: window == whole,
                posterior: task.posterior && window == whole,
                before: (done[0], spent),
                on_iterate,
            };
            let (mut minimum, end) = task.stage(stage)?;
            done[0] += minimum.outer_iterations;
            done[1] += minimum.inner_iterations;
            spent = spent + end.counts;
            stages.push((window, minimum.status));
            attempts.append(&mut minimum.attempts);
            ended = Some(end);
            Ok(minimum)
        })?;
    stages.pop();
    let (Some(last), Some(end)) = (minima.pop(), ended) else {
        return Err(Error::Setting { what: "a window of no sub-windows", value: 0.0 }.into());
    };
    let minimum = Minimum { outer_iterations: done[0], inner_iterations: done[1], ..last };
    let solved = Solution {
        minimum,
        control: end.control,
        sigma_background: end.sigma_background,
        spread: end.spread,
        no_spread: end.no_spread,
        exact_hessian: end.exact_hessian,
        model_errors: end.model_errors,
        states,
        counts: spent,
        rejected,
        stages,
        attempts,
        storage: end.storage,
    };
    Ok((solved, observations))
}
impl Task<'_> {
    fn stage(&mut self, stage: SubWindow) -> Result<(Minimum, SubWindowEnd), Error> {
        match self.algorithm.method {
            Method::WeakForcing => self.weak_forcing(stage),
            Method::WeakState => self.weak_state(stage),
            Method::FourDEnVar | Method::HybridFourDEnVar => self.ensemble(stage),
            _ => self.strong(stage),
        }
    }

    /// The observed values that are too far from the background, judged by the covariances of the method.
    fn background_check(
        &mut self,
        observations: &mut ObservationSet,
        limit: f64,
    ) -> Result<(Vec<Rejection>, WorkCounts), Error> {
        if self.algorithm.method.is_ensemble() {
            let members = self.members()?;
            let anchors = anchors(observations, self.anchors);
            let mut cost = members.cost(self.make_model, self.background, observations, &anchors)?;
            return Ok((cost.background_check(limit)?, WorkCounts::from(&cost.counts())));
        }
        let forcing = self.forcing();
        let transform = ControlTransform::new(self.background.to_vec(), self.covariance.as_ref())?;
        match self.model_error {
            Some(q) => {
                let q = q.as_ref();
                let mut cost = WeakForcing::new(&mut *self.model, transform, q, forcing, observations)?;
                Ok((cost.background_check(limit)?, WorkCounts::from(&cost.counts())))
            }
            None => {
                let mut cost = StrongConstraint::new(&mut *self.model, transform, observations)?;
                Ok((cost.background_check(limit)?, WorkCounts::from(&cost.counts())))
            }
        }
    }
}
