//! Strong constraint: the analysis is a run of the model.

use varda_assimilation::{
    ControlTransform, CostFunction, Error, Iteration, Minimum, Posterior, Status, StrongConstraint,
};
use varda_implicit::Model;

use super::task::{
    Iterate, PosteriorSpread, SubWindow, SubWindowEnd, Task, deviations, is_at_minimum, is_whole,
};
use super::{exact_hessian, intervals, minimizer};
use crate::outcome::WorkCounts;
use crate::scene::{Hessian, Method};
use crate::setup::memory::is_low_rank;

impl Task<'_> {
    /// The strong constraint. 3D-Var is 4D-Var with observations at step 0 only. If the model is replaced at
    /// the end of the minimization (adaptive time steps), the minimization continues from there, to the
    /// gradient norm that was first asked for.
    pub(super) fn strong(&mut self, stage: SubWindow) -> Result<(Minimum, SubWindowEnd), Error> {
        let (background, covariance) = (self.background, self.covariance);
        let transform = ControlTransform::new(background.to_vec(), covariance.as_ref())?;
        let SubWindow { observations, v, whole, posterior, before, on_iterate, .. } = stage;
        let window = observations.steps();
        let mut algorithm = self.algorithm.clone();
        let mut control = background.to_vec();
        let mut fresh: Option<Box<dyn Model + Send + '_>> = None;
        let mut first: Option<Minimum> = None;
        let (mut iterations, mut counts) = ([0, 0], WorkCounts::default());
        loop {
            let model: &mut dyn Model = match &mut fresh {
                Some(model) => model.as_mut(),
                None => &mut *self.model,
            };
            let mut cost = StrongConstraint::new(model, transform.clone(), &mut *observations)?;
            if let Some(delta) = algorithm.robust {
                cost.set_huber(delta)?;
            }
            cost.set_memory(self.memory)?;
            let storage = cost.storage();
            v.resize(cost.dim(), 0.0);
            if let Some(first) = &first {
                let mut gradient = vec![0.0; v.len()];
                cost.evaluate(v, Some(&mut gradient))?;
                let wanted = self.algorithm.gradient_tolerance * first.gradient_norm_first;
                // At most one half, or a start that is nearly good enough would take no iteration at all.
                algorithm.gradient_tolerance =
                    (wanted / varda_linalg::norm(&gradient)).clamp(f64::EPSILON, 0.5);
                algorithm.sigma_stages.clear();
            }
            algorithm.max_iterations = self.algorithm.max_iterations.saturating_sub(iterations[0]);
            let start = v.clone();
            let so_far = (before.0 + iterations[0], before.1 + counts);
            let mut on_iteration = |iteration: &Iteration| {
                transform.control(iteration.v, &mut control);
                on_iterate(&Iterate { iteration, control: &control, window, before: so_far })
            };
            let mut minimum = minimizer::minimum(&algorithm, &mut cost, v, &mut on_iteration)?;
            transform.control(v, &mut control);
            counts = counts + WorkCounts::from(&cost.counts());
            iterations[0] += minimum.outer_iterations;
            iterations[1] += minimum.inner_iterations;
            let settled = matches!(minimum.status, Status::Converged | Status::Stalled);
            let another = if whole && settled { (self.refresh)(&control) } else { None };
            if let Some(model) = another {
                drop(cost);
                fresh = Some(model);
                first.get_or_insert(minimum);
                continue;
            }
            let mut exact = None;
            let (spread, no_spread) = if posterior && is_whole(minimum.status) {
                // BLUE's covariance is (I + GᵀG)⁻¹ with the linearization at the background.
                let is_linear = algorithm.method == Method::Blue;
                let linearized = if is_linear { &start } else { &*v };
                let followed = !is_linear && is_at_minimum(&minimum);
                let constants = if followed { &self.constants[..] } else { &[] };
                cost.evaluate(linearized, Some(&mut vec![0.0; v.len()]))?;
                match (is_low_rank(algorithm.method, v.len()), algorithm.hessian) {
                    (true, Hessian::GaussNewton) => {
                        (Some(PosteriorSpread::of_low_rank(&mut cost, &transform)?), None)
                    }
                    (true, Hessian::Exact) => {
                        let (spread, found) = exact_hessian::low_rank(&mut cost, &transform)?;
                        exact = Some(found);
                        (Some(spread), None)
                    }
                    (false, Hessian::GaussNewton) => match Posterior::new(&mut cost) {
                        Ok(posterior) => {
                            let of = intervals::spread(&posterior, &mut cost, &transform, v, constants)?;
                            (Some(of), None)
                        }
                        Err(reason @ Error::NotPositiveDefinite { .. }) => (None, Some(reason)),
                        Err(error) => return Err(error),
                    },
                    (false, Hessian::Exact) => {
                        let (spread, no_spread, found) =
                            exact_hessian::spread(&mut cost, &transform, v, constants)?;
                        exact = Some(found);
                        (spread, no_spread)
                    }
                }
            } else {
                (None, None)
            };
            if let Some(mut first) = first {
                minimum.gradient_norm_first = first.gradient_norm_first;
                first.attempts.append(&mut minimum.attempts);
                minimum.attempts = first.attempts;
            }
            [minimum.outer_iterations, minimum.inner_iterations] = iterations;
            let sigma_background = deviations(covariance.as_ref());
            let end = SubWindowEnd {
                control,
                sigma_background,
                spread,
                no_spread,
                exact_hessian: exact,
                model_errors: None,
                counts,
                storage,
            };
            return Ok((minimum, end));
        }
    }
}
