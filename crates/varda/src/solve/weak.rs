//! Weak constraint: the model errs by a forcing η, which is estimated with the initial state.

use varda_assimilation::{
    ControlTransform, CostFunction, Error, InnerSolver, Posterior, Status, WeakForcing, WeakState, outer_loop,
};
use varda_covariance::Covariance;
use varda_implicit::Storage;

use super::minimizer;
use super::task::{Iterate, PosteriorSpread, SubWindow, SubWindowEnd, Task, deviations, is_whole};
use crate::outcome::WorkCounts;
use crate::setup::covariance::Factored;
use crate::setup::runs::run_on;

impl Task<'_> {
    pub(super) fn weak_forcing(&mut self, stage: SubWindow) -> Result<SubWindowEnd, Error> {
        let (algorithm, background, covariance) = (&self.algorithm, self.background, self.covariance);
        let missing =
            Error::Setting { what: "the covariance of a model error that is not there", value: 0.0 };
        let q: &dyn Covariance = self.model_error.ok_or(missing)?.as_ref();
        let forcing = self.forcing();
        let transform = ControlTransform::new(background.to_vec(), covariance.as_ref())?;
        let SubWindow { observations, v, states, posterior, before, on_iterate, .. } = stage;
        let (window, last) = (observations.steps(), observations.last_step().unwrap_or(0));
        let mut cost = WeakForcing::new(&mut *self.model, transform.clone(), q, forcing, observations)?;
        // The added part of the window starts without forcing.
        v.resize(cost.dim(), 0.0);
        let head = transform.dim();
        let mut control = background.to_vec();
        let minimum = minimizer::minimize(algorithm, &mut cost, v, &mut |iteration| {
            transform.control(&iteration.v[..head], &mut control);
            on_iterate(&Iterate { iteration, control: &control, window, before })
        })?;
        let counts = WorkCounts::from(&cost.counts());
        states.clear();
        let (mut spread, mut no_spread) = (None, None);
        if minimum.status != Status::Failed {
            cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
            (0..=last).for_each(|k| states.extend_from_slice(cost.state(k)));
            if posterior && is_whole(minimum.status) {
                (spread, no_spread) =
                    PosteriorSpread::of(Posterior::of_initial_state(&mut cost), &transform, false)?;
            }
        }
        transform.control(&v[..head], &mut control);
        Ok(SubWindowEnd {
            minimum,
            control,
            sigma_background: deviations(covariance.as_ref()),
            spread,
            no_spread,
            counts,
            storage: Storage::KeepAll,
        })
    }

    /// Starts from the run of the background; after the window has grown, from the analysed states and the
    /// model's run from the last of them.
    pub(super) fn weak_state(&mut self, stage: SubWindow) -> Result<SubWindowEnd, Error> {
        let (algorithm, background, covariance) = (&self.algorithm, self.background, self.covariance);
        let forcing = self.forcing();
        let transform = ControlTransform::new(background.to_vec(), covariance.as_ref())?;
        let singular = |what| Error::Setting { what, value: 0.0 };
        let b = covariance.precision().ok_or(singular("the inverse of a truncated B"))?;
        let q = self.model_error.and_then(Factored::precision);
        let q = q.ok_or(singular("the inverse of a truncated Q"))?;
        let SubWindow { observations, v, states, posterior, before, on_iterate, .. } = stage;
        let (window, last) = (observations.steps(), observations.last_step().unwrap_or(0));
        if states.is_empty() {
            states.resize(self.model.dim(), 0.0);
            self.model.initial_state(background, states)?;
        }
        let run = WorkCounts::of(run_on(&mut *self.model, states, last)?.counts);
        let mut cost = WeakState::new(&mut *self.model, background.to_vec(), b, q, forcing, observations)?;
        let (n_z, n) = (background.len(), states.len() / (last + 1));
        let mut control = if v.is_empty() { background.to_vec() } else { v[..n_z].to_vec() };
        *v = cost.control(&control, &mut |k, x| x.copy_from_slice(&states[k * n..(k + 1) * n]));
        let options = minimizer::outer(algorithm, InnerSolver::Primal);
        let before_this = (before.0, before.1 + run);
        let minimum = outer_loop(&mut cost, v, &options, &mut |iteration| {
            on_iterate(&Iterate { iteration, control: &iteration.v[..n_z], window, before: before_this })
        })?;
        let counts = WorkCounts::from(&cost.counts()) + run;
        states.clear();
        let (mut spread, mut no_spread) = (None, None);
        if minimum.status != Status::Failed {
            cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
            (0..=last).for_each(|k| states.extend_from_slice(cost.state(k)));
            if posterior && is_whole(minimum.status) {
                (spread, no_spread) =
                    PosteriorSpread::of(Posterior::of_initial_state(&mut cost), &transform, false)?;
            }
        }
        control.copy_from_slice(&v[..n_z]);
        Ok(SubWindowEnd {
            minimum,
            control,
            sigma_background: deviations(covariance.as_ref()),
            spread,
            no_spread,
            counts,
            storage: Storage::KeepAll,
        })
    }
}
