//! Ensemble methods: forward runs of the members take the place of tangent and adjoint.

use varda_assimilation::{
    CostFunction, EnVar, EnVarOptions, EnsembleUpdate, Error, Iteration, Minimum, ObservationSet, Status,
};
use varda_covariance::{Covariance, Ensemble, Hybrid};
use varda_implicit::{Model, Storage};

use super::task::{Iterate, PosteriorSpread, SubWindow, SubWindowEnd, Task, deviations, is_whole, roots};
use crate::outcome::WorkCounts;
use crate::scene::Method;
use crate::setup::ensemble::anchors;

/// The first linearization of an ensemble uses the members themselves (4D-EnVar proper); later ones use
/// differences about the iterate, of this fraction of their spread (the iterative ensemble smoother): with a
/// large fraction the iteration would end where the secants vanish instead of the gradient.
const SPREAD: f64 = 1e-3;

/// The ensemble alone, or with a static part of B.
pub(super) enum Members<'a> {
    Pure(&'a Ensemble),
    Hybrid(Box<Hybrid<'a>>),
}

impl Task<'_> {
    /// The members of the scene's ensemble, alone or with a static part of B.
    pub(super) fn members(&self) -> Result<Members<'_>, Error> {
        let what = "an ensemble of no members";
        let ensemble = self.ensemble.ok_or(Error::Setting { what, value: 0.0 })?;
        if self.algorithm.method == Method::FourDEnVar {
            return Ok(Members::Pure(ensemble));
        }
        let [of_static, of_ensemble] = self.algorithm.members().unwrap_or_default().weights();
        let b: &dyn Covariance = self.covariance.as_ref();
        Ok(Members::Hybrid(Box::new(Hybrid::new(b, of_static, ensemble.clone(), of_ensemble)?)))
    }

    pub(super) fn ensemble(&mut self, stage: SubWindow) -> Result<(Minimum, SubWindowEnd), Error> {
        let members = self.members()?;
        let SubWindow { observations, v, posterior, before, on_iterate, .. } = stage;
        let window = observations.steps();
        let anchors = anchors(observations, self.anchors);
        let mut cost = members.cost(self.make_model, self.background, observations, &anchors)?;
        cost.set_spread(SPREAD);
        v.resize(cost.dim(), 0.0);
        let transform = cost.transform().clone();
        let mut control = self.background.to_vec();
        let mut on_iteration = |iteration: &Iteration| {
            transform.control(iteration.v, &mut control);
            on_iterate(&Iterate { iteration, control: &control, window, before })
        };
        // The increment of a hybrid's static part is constant through the window: with relinearization the
        // iteration would have no minimum to converge to.
        let max_outer = match self.algorithm.method {
            Method::HybridFourDEnVar => 1,
            _ => self.algorithm.max_iterations.max(1),
        };
        let options = EnVarOptions::default().with_max_outer(max_outer);
        let minimum = cost.minimize(v, &options, &mut on_iteration)?;
        let counts = WorkCounts::from(&cost.counts());
        // Reports the last step, after which the control alone is run; it is too late to interrupt.
        if !matches!(minimum.status, Status::Interrupted | Status::Stalled) {
            let _ = on_iteration(&minimum.iteration(0.0, cost.counts(), v));
        }
        transform.control(v, &mut control);
        let spread = if posterior && is_whole(minimum.status) {
            let (variance, degrees_of_freedom) = cost.posterior_variance()?;
            let members = match self.members {
                true => members_of(&control, cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot)?),
                false => Vec::new(),
            };
            Some(PosteriorSpread {
                sigma: roots(variance),
                root: Vec::new(),
                with_errors: None,
                members,
                degrees_of_freedom,
                error_bound: None,
                intervals: Vec::new(),
            })
        } else {
            None
        };
        let sigma_background = deviations(transform.covariance());
        let end = SubWindowEnd {
            control,
            sigma_background,
            spread,
            no_spread: None,
            exact_hessian: None,
            model_errors: None,
            counts,
            storage: Storage::KeepAll,
        };
        Ok((minimum, end))
    }
}

/// z + √(N − 1) x_i, in place of the N perturbations x_i.
fn members_of(z: &[f64], mut perturbations: Vec<f64>) -> Vec<f64> {
    let size = ((perturbations.len() / z.len()) as f64 - 1.0).sqrt();
    for x in perturbations.chunks_exact_mut(z.len()) {
        x.iter_mut().zip(z).for_each(|(x, z)| *x = z + size * *x);
    }
    perturbations
}

impl Members<'_> {
    /// The cost of some observations.
    pub(super) fn cost<'c>(
        &'c self,
        make: &dyn Fn() -> Box<dyn Model + Send>,
        background: &[f64],
        observations: &'c mut ObservationSet,
        anchors: &[usize],
    ) -> Result<EnVar<'c>, Error> {
        let background = background.to_vec();
        match self {
            Members::Pure(ensemble) => EnVar::new(make, background, ensemble, observations, anchors),
            Members::Hybrid(hybrid) => EnVar::hybrid(make, background, hybrid, observations, anchors),
        }
    }
}
