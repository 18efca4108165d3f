//! Weak constraint: the model errs by a forcing η, which is estimated with the initial state.

use varda_assimilation::{
    ControlTransform, CostFunction, Error, Forcing, LeastSquares, Minimum, Status, WeakForcing,
    WeakPosterior, WeakState, outer_loop,
};
use varda_covariance::Covariance;
use varda_implicit::Storage;

use super::minimizer;
use super::task::{Iterate, PosteriorSpread, SubWindow, SubWindowEnd, Task, deviations, is_whole, roots};
use crate::outcome::{ModelErrors, WorkCounts};
use crate::setup::covariance::Factored;
use crate::setup::memory::{MOST_ROOT_COLUMNS, carries_errors};
use crate::setup::runs::run_on;

impl Task<'_> {
    pub(super) fn weak_forcing(&mut self, stage: SubWindow) -> Result<(Minimum, SubWindowEnd), Error> {
        let (algorithm, background, covariance) = (&self.algorithm, self.background, self.covariance);
        let missing =
            Error::Setting { what: "the covariance of a model error that is not there", value: 0.0 };
        let q: &dyn Covariance = self.model_error.ok_or(missing)?.as_ref();
        let forcing = self.forcing();
        let transform = ControlTransform::new(background.to_vec(), covariance.as_ref())?;
        let SubWindow { observations, v, states, posterior, before, on_iterate, .. } = stage;
        let (window, last) = (observations.steps(), observations.last_step().unwrap_or(0));
        let mut cost =
            WeakForcing::new(&mut *self.model, transform.clone(), q, forcing.clone(), observations)?;
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
        let mut found = Found::default();
        if minimum.status != Status::Failed {
            cost.linearize(v, &mut vec![0.0; v.len()])?;
            (0..=last).for_each(|k| states.extend_from_slice(cost.state(k)));
            let posterior = posterior && is_whole(minimum.status);
            found = Found::of(&mut cost, q, &transform, &forcing, last, posterior)?;
        }
        transform.control(&v[..head], &mut control);
        let end = SubWindowEnd {
            control,
            sigma_background: deviations(covariance.as_ref()),
            spread: found.spread,
            no_spread: found.no_spread,
            exact_hessian: None,
            model_errors: found.model_errors,
            counts,
            storage: Storage::KeepAll,
        };
        Ok((minimum, end))
    }

    /// Starts from the run of the background; after the window has grown, from the analysed states and the
    /// model's run from the last of them.
    pub(super) fn weak_state(&mut self, stage: SubWindow) -> Result<(Minimum, SubWindowEnd), Error> {
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
        let mut cost =
            WeakState::new(&mut *self.model, background.to_vec(), b, q, forcing.clone(), observations)?;
        let (n_z, n) = (background.len(), states.len() / (last + 1));
        let mut control = if v.is_empty() { background.to_vec() } else { v[..n_z].to_vec() };
        *v = cost.control(&control, &mut |k, x| x.copy_from_slice(&states[k * n..(k + 1) * n]));
        let options = minimizer::outer_of(algorithm).unwrap_or_default();
        let before_this = (before.0, before.1 + run);
        let minimum = outer_loop(&mut cost, v, &options, &mut |iteration| {
            on_iterate(&Iterate { iteration, control: &iteration.v[..n_z], window, before: before_this })
        })?;
        let counts = WorkCounts::from(&cost.counts()) + run;
        states.clear();
        let mut found = Found::default();
        if minimum.status != Status::Failed {
            cost.linearize(v, &mut vec![0.0; v.len()])?;
            (0..=last).for_each(|k| states.extend_from_slice(cost.state(k)));
            let posterior = posterior && is_whole(minimum.status);
            found = Found::of(&mut cost, q, &transform, &forcing, last, posterior)?;
        }
        control.copy_from_slice(&v[..n_z]);
        let end = SubWindowEnd {
            control,
            sigma_background: deviations(covariance.as_ref()),
            spread: found.spread,
            no_spread: found.no_spread,
            exact_hessian: None,
            model_errors: found.model_errors,
            counts,
            storage: Storage::KeepAll,
        };
        Ok((minimum, end))
    }
}

/// What the end of a minimization says of the initial state and of the model.
#[derive(Default)]
struct Found {
    spread: Option<PosteriorSpread>,
    no_spread: Option<Error>,
    model_errors: Option<ModelErrors>,
}

impl Found {
    /// Around the point that `cost` is linearized about.
    fn of(
        cost: &mut dyn LeastSquares,
        q: &dyn Covariance,
        transform: &ControlTransform,
        forcing: &Forcing,
        last: usize,
        posterior: bool,
    ) -> Result<Self, Error> {
        let mut found = Found::default();
        let mut errors = errors_at(cost, q, forcing, last);
        if posterior {
            match WeakPosterior::new(cost) {
                Ok(posterior) => {
                    found.spread = Some(PosteriorSpread {
                        with_errors: carries_errors(transform.control_dim())
                            .then(|| posterior.with_errors(transform, q, MOST_ROOT_COLUMNS)),
                        ..PosteriorSpread::around(posterior.initial(), transform, false)
                    });
                    let sigma = |j: usize| roots(posterior.error_variance(q, j));
                    errors.sigma = (0..errors.steps.len()).flat_map(sigma).collect();
                    errors.expected_j_q = Some(posterior.expected_model_error());
                    errors.scale = posterior.scale();
                }
                Err(reason @ Error::NotPositiveDefinite { .. }) => found.no_spread = Some(reason),
                Err(error) => return Err(error),
            }
        }
        found.model_errors = Some(errors);
        Ok(found)
    }
}

/// η_j = Q^{1/2} p_j of the point that `cost` is linearized about, and when each is added.
fn errors_at(cost: &dyn LeastSquares, q: &dyn Covariance, forcing: &Forcing, last: usize) -> ModelErrors {
    let (mut b, mut d) = (vec![0.0; cost.dim()], vec![0.0; cost.observation_dim()]);
    cost.departures(&mut b, &mut d);
    let whitened = &b[cost.background_dim()..];
    let count = whitened.len() / q.root_dim().max(1);
    let mut values = vec![0.0; count * q.dim()];
    for (p, eta) in whitened.chunks_exact(q.root_dim().max(1)).zip(values.chunks_exact_mut(q.dim())) {
        q.root(p, eta);
    }
    let steps = |j: usize| {
        let end = (j + 1) * forcing.steps;
        if forcing.held { [j * forcing.steps + 1, end.min(last)] } else { [end, end] }
    };
    ModelErrors {
        steps: (0..count).map(steps).collect(),
        values,
        sigma_prior: deviations(q),
        ..ModelErrors::default()
    }
}
