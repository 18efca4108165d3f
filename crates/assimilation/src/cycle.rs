//! Cycling: consecutive windows, each starting from the analysis of the one before.

use crate::cycle_members::{mean, posterior_root, rotate, run_all_drawing_again, truncate};
use crate::cycle_window::{
    Carry, Cycle, CyclePosterior, CycleState, CycledErrors, CycledEstimate, CycledMinimizer, Cycling, Ended,
    Normals, is_whole,
};
use crate::departures::{departures_at, expected_departures};
use crate::{
    ControlTransform, CostFunction, Departures, EnVar, EnVarOptions, EnsembleUpdate, Error, ObservationSet,
    StrongConstraint,
};
use std::ops::ControlFlow;
use varda_covariance::{Covariance, Ensemble, Hybrid, Localization};
use varda_implicit::{Keep, Trajectory};

/// Where the background covariance of a window comes from.
pub enum CycledCovariance<'a> {
    /// The same B for every window: strong 4D-Var (3D-Var for K = 0).
    Static(&'a dyn Covariance),
    /// The posterior of the window before (strong 4D-Var), carried to the start of the next by the tangent: B
    /// = α² M P_a Mᵀ, plus where given β² B_s for what the model does not know (an extended Kalman
    /// smoother with iterated windows). As many tangent sweeps as its root has columns, n at most, and that
    /// many times n numbers more than static B.
    Propagated {
        /// B of the first window.
        first: &'a dyn Covariance,
        /// α, on standard deviations.
        inflation: f64,
        /// B_s and β.
        static_part: Option<(&'a dyn Covariance, f64)>,
        /// Share of the variance of every component that may be left out, so that the root has fewer columns:
        /// what a window costs goes with them. 0 leaves out nothing. [`Cycle::dropped`] says what was.
        dropped: f64,
    },
    /// An ensemble carried from window to window: 4D-EnVar, hybrid 4D-EnVar, the iterative ensemble Kalman
    /// smoother.
    Ensemble(CycledEnsemble<'a>),
}

/// How an ensemble ([`CycleState::from_members`]) is used and carried.
pub struct CycledEnsemble<'a> {
    /// α multiplies the perturbations of every background, before the window is assimilated.
    pub inflation: CycledInflation,
    /// ε: the ensemble is linearized by differences over this part of the members' deviations
    /// ([`EnVar::set_spread`]); 1 uses the members themselves.
    pub spread: f64,
    /// Turns the members about their mean at random after every window; makes the source of standard normals
    /// of the window of an index. `None` leaves them as the update has them.
    pub rotation: Option<&'a dyn Fn(usize) -> Normals>,
    /// C.
    pub localization: Localization,
    /// The component of the control at whose place each stacked row was measured; asked for where C
    /// localizes.
    pub anchors: &'a dyn Fn(&ObservationSet) -> Vec<usize>,
    /// B_s, β_s and β_e of a hybrid; `None` is β_e = 1 alone.
    pub static_part: Option<(&'a dyn Covariance, f64, f64)>,
    /// From the prior perturbations to those of the posterior.
    pub update: CycledUpdate<'a>,
    /// Outer iterations.
    pub options: EnVarOptions,
}

/// How much the perturbations of a background are inflated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CycledInflation {
    /// By the same factor α > 0 before every window.
    Fixed(f64),
    /// By what the innovations of the window and the finite number of members ask for (EnKF-N: Bocquet 2011,
    /// Bocquet and Sakov 2012); with localization by their likelihood under an inverse χ² of as many
    /// degrees of freedom as members. Costs one linearization a window more.
    FiniteSize,
}

/// [`EnsembleUpdate`], window after window.
pub enum CycledUpdate<'a> {
    /// [`EnsembleUpdate::SquareRoot`].
    SquareRoot,
    /// [`EnsembleUpdate::PerturbedObservations`]: makes the source of standard normals of the window of an
    /// index. Every window has its own, so that nothing random is carried.
    PerturbedObservations(&'a dyn Fn(usize) -> Normals),
}

/// Assimilates the windows `state.next` … `cycling.cycles` − 1, one after the other:
///
/// ```text
///     z_b, B  →  z_a = argmin J over window c  →  z_b' = M_S(z_a),  B' as `covariance` says
/// ```
///
/// | B | when to use | when not | cost of a window beyond its minimization | memory beyond a window's |
/// |---|---|---|---|---|
/// | static | errors that vary little with the flow | chaos seen sparsely | 1 forward run | – |
/// | propagated | small n, seen sparsely | alone over long cycles | 1 forward run, 2n tangent sweeps | 2n² |
/// | ensemble | no adjoint at hand | N below the growing directions | N forward runs | N trajectories |
///
/// With [`Cycling::model_error`] the windows are weak ones, or B of the next window grows by Q: see there.
/// `minimizer` is a [`Minimizer`](crate::Minimizer), or the options of an outer loop: incremental 4D-Var or
/// 4D-PSAS. Methods of ensembles have their own.
///
/// The background of a window is the run from the analysis before (the mean of the members' runs), read off
/// the leading components of the state, which are taken to be the control. A minimization that ends otherwise
/// than converged hands its best point on: see `status`. `on_cycle` hears of every window with what it hands
/// on, and may end the sequence. After an error `state` is that before the window that failed.
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Model, Rk4, lorenz::Lorenz63};
///
/// // Five windows of ten steps; the first component is seen at the end of each.
/// let lorenz = Lorenz63::default();
/// let model = |step: usize| -> Box<dyn Model + Send> { Box::new(Rk4::new(lorenz, step, 0.01)) };
/// let values = [4.2, 11.5, 16.8, 6.6, -1.2];
/// let observations = |from: usize| {
///     let seen = vec![Observation::new(10, vec![0], vec![values[from / 10]], 0.5)];
///     ObservationSet::new(10, vec![Box::new(Selection::new(vec![0], 3)?)], seen)
/// };
/// let cycling = Cycling {
///     first: 0,
///     window: 10,
///     shift: 10,
///     cycles: 5,
///     make_model: &model,
///     observations: &observations,
///     truth: None,
///     model_error: None,
///     posterior: false,
/// };
/// let b = Diagonal::uniform(3, 1.0)?;
/// let mut state = CycleState::new(vec![1.5, 1.7, 20.0]);
/// let windows = cycle(
///     &cycling,
///     &mut state,
///     &CycledCovariance::Static(&b),
///     &Minimizer::default(),
///     &mut |_, _| ControlFlow::Continue(()),
/// )?;
/// assert_eq!((windows.len(), state.next), (5, 5));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// A shift of 0 or beyond K + 1, an inflation that is not positive; a model that fails at a background or
/// between two windows, observations or covariances that cannot be built.
pub fn cycle<'m>(
    cycling: &Cycling,
    state: &mut CycleState,
    covariance: &CycledCovariance,
    minimizer: impl Into<CycledMinimizer<'m>>,
    on_cycle: &mut dyn FnMut(&Cycle, &CycleState) -> ControlFlow<()>,
) -> Result<Vec<Cycle>, Error> {
    let minimizer = minimizer.into();
    if cycling.shift == 0 || (cycling.window > 0 && cycling.shift > cycling.window + 1) {
        return Err(Error::Setting { what: "the shift between windows", value: cycling.shift as f64 });
    }
    let inflation = match covariance {
        CycledCovariance::Static(_) => 1.0,
        CycledCovariance::Propagated { inflation, .. } => *inflation,
        CycledCovariance::Ensemble(ensemble) => match ensemble.inflation {
            CycledInflation::Fixed(inflation) => inflation,
            CycledInflation::FiniteSize => 1.0,
        },
    };
    if let CycledCovariance::Ensemble(CycledEnsemble { spread, .. }) = covariance
        && !(*spread > 0.0 && spread.is_finite())
    {
        return Err(Error::Setting { what: "spread", value: *spread });
    }
    if let CycledCovariance::Propagated { dropped, .. } = covariance
        && !(0.0..1.0).contains(dropped)
    {
        return Err(Error::Setting { what: "the share of variance dropped", value: *dropped });
    }
    if !(inflation > 0.0 && inflation.is_finite()) {
        return Err(Error::Setting { what: "inflation", value: inflation });
    }
    if let Some(CycledErrors { estimated, .. }) = cycling.model_error {
        let estimated = !matches!(estimated, CycledEstimate::No);
        let what = match covariance {
            CycledCovariance::Static(_) if !estimated => "Q beside a static B, which it does not change",
            CycledCovariance::Ensemble(_) if estimated => "errors estimated over the members of an ensemble",
            _ => "",
        };
        if !what.is_empty() {
            return Err(Error::Setting { what, value: 0.0 });
        }
    }
    let mut cycles = Vec::new();
    while state.next < cycling.cycles {
        let (cycle, after) = match covariance {
            CycledCovariance::Static(b) => cycling.variational(state, *b, minimizer, None)?,
            CycledCovariance::Propagated { first, inflation, static_part, dropped } => {
                let (inflation, static_part, dropped) = (*inflation, *static_part, *dropped);
                let carry = Some(Carry { inflation, static_part, dropped });
                if state.columns.is_empty() {
                    cycling.variational(state, *first, minimizer, carry)?
                } else {
                    let whole = Localization::none(state.background.len());
                    let carried = Ensemble::from_perturbations(&state.columns, whole)?;
                    match static_part {
                        Some((b, weight)) => {
                            let hybrid = Hybrid::new(b, weight, carried, 1.0)?;
                            cycling.variational(state, &hybrid, minimizer, carry)?
                        }
                        None => cycling.variational(state, &carried, minimizer, carry)?,
                    }
                }
            }
            CycledCovariance::Ensemble(ensemble) => cycling.ensemble(state, ensemble)?,
        };
        *state = after;
        let flow = on_cycle(&cycle, state);
        cycles.push(Cycle { posterior: None, ..cycle });
        if flow.is_break() {
            break;
        }
    }
    Ok(cycles)
}

impl Cycling<'_> {
    /// One window of strong 4D-Var; `carry` is how its posterior becomes B of the next, if it does.
    fn variational(
        &self,
        state: &CycleState,
        b: &dyn Covariance,
        minimizer: CycledMinimizer,
        carry: Option<Carry>,
    ) -> Result<(Cycle, CycleState), Error> {
        if let Some(errors) = &self.model_error {
            return self.erring(state, b, minimizer, carry, errors);
        }
        let mut observations = self.unseen(state.next)?;
        let m = observations.dim();
        let mut model = (self.make_model)(self.first_step(state.next));
        let transform = ControlTransform::new(state.background.clone(), b)?;
        let n_z = transform.control_dim();
        let mut cost = StrongConstraint::new(&mut *model, transform.clone(), &mut observations)?;
        let mut v = vec![0.0; cost.dim()];
        let (background, predicted) = expected_departures(&mut cost, &v, state.next, self.cycles)?;
        let minimum = minimizer.minimize(&mut cost, &mut v)?;
        let departures = departures_at(&mut cost, &v, &background, predicted);
        let mut columns = match carry {
            Some(_) => posterior_root(&mut cost, &transform, &v)?,
            None => Vec::new(),
        };
        let counts = cost.counts();
        let posterior = match (self.posterior && is_whole(minimum.status), carry) {
            (false, _) => None,
            (true, Some(_)) => Some(CyclePosterior::Root(columns.clone())),
            (true, None) => {
                Some(CyclePosterior::of(posterior_root(&mut cost, &transform, &v), CyclePosterior::Root)?)
            }
        };

        let mut z = vec![0.0; n_z];
        transform.control(&v, &mut z);
        let (mut x_b, mut x_a) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        model.initial_state(&state.background, &mut x_b)?;
        model.initial_state(&z, &mut x_a)?;
        let keep = if carry.is_some() { Keep::Linearizations } else { Keep::States };
        let mut trajectory = Trajectory::new();
        trajectory.run(&mut *model, &x_a, self.steps(), keep)?;
        let mut dropped = 0.0;
        if let Some(carry) = carry {
            let mut dx = vec![0.0; model.dim()];
            for column in columns.chunks_exact_mut(n_z) {
                model.initial_tangent(column, &mut dx);
                (0..self.shift).for_each(|k| trajectory.tangent_of_step(&mut *model, k, &mut dx));
                column.iter_mut().zip(&dx).for_each(|(w, dx)| *w = carry.inflation * dx);
            }
            (columns, dropped) = truncate(n_z, columns, carry.dropped)?;
        }
        let sigma = carry.map(|carry| carry.sigma(n_z, &columns));
        let background = trajectory.state(self.shift)[..n_z].to_vec();
        let end = trajectory.state(self.window).to_vec();
        let errors = self.errors(state.next, [&x_b, &x_a, &end]);
        let inflation = carry.map_or(1.0, |carry| carry.inflation);
        let count = columns.len() / n_z;
        let from = Ended {
            minimum,
            counts,
            sigma,
            errors,
            departures,
            inflation,
            drawn_again: 0,
            columns: count,
            dropped,
            model_errors: Vec::new(),
            posterior,
        };
        Ok((self.cycle(state, z, end, m, from), CycleState { next: state.next + 1, background, columns }))
    }

    /// One window of 4D-EnVar.
    fn ensemble(&self, state: &CycleState, settings: &CycledEnsemble) -> Result<(Cycle, CycleState), Error> {
        let mut observations = self.unseen(state.next)?;
        let m = observations.dim();
        let first = self.first_step(state.next);
        let make = || (self.make_model)(first);
        let z_b = &state.background;
        let n_z = z_b.len();
        let local = settings.localization.rank() > 1;
        let anchors = if local { (settings.anchors)(&observations) } else { Vec::new() };
        let inflation = match settings.inflation {
            CycledInflation::Fixed(inflation) => inflation,
            CycledInflation::FiniteSize => {
                let plain = Ensemble::new(&state.columns, settings.localization.clone())?;
                let spread = settings.spread;
                EnVar::over(&make, z_b.clone(), &plain, &mut observations, &anchors, spread)?
                    .finite_size_inflation()?
            }
        };
        let mut members = state.columns.clone();
        for x in members.chunks_exact_mut(n_z) {
            x.iter_mut().zip(z_b).for_each(|(x, m)| *x = m + inflation * (*x - m));
        }
        let ensemble = Ensemble::new(&members, settings.localization.clone())?;
        let count = ensemble.members();

        let hybrid = match settings.static_part {
            Some((b, beta_s, beta_e)) => Some(Hybrid::new(b, beta_s, ensemble.clone(), beta_e)?),
            None => None,
        };
        let mut cost = match &hybrid {
            Some(hybrid) => {
                EnVar::hybrid_over(&make, z_b.clone(), hybrid, &mut observations, &anchors, settings.spread)?
            }
            None => EnVar::over(&make, z_b.clone(), &ensemble, &mut observations, &anchors, settings.spread)?,
        };
        let mut v = vec![0.0; cost.dim()];
        let (at_background, predicted) = (cost.whitened_innovations().to_vec(), cost.predicted_trace());
        let minimum = cost.minimize(&mut v, &settings.options, &mut |_| ControlFlow::Continue(()))?;
        let counts = cost.counts();
        let departures = match cost.nonlinear_departures(&v) {
            Ok(at_analysis) if m > 0 => Some(Departures::of(&at_background, &at_analysis, predicted)),
            _ => None,
        };
        let mut z = vec![0.0; n_z];
        cost.transform().control(&v, &mut z);
        let perturbations = match settings.update {
            CycledUpdate::SquareRoot => cost.posterior_perturbations(&mut EnsembleUpdate::SquareRoot)?,
            CycledUpdate::PerturbedObservations(make) => {
                let mut normals = make(state.next);
                let mut update = EnsembleUpdate::PerturbedObservations(&mut *normals);
                cost.posterior_perturbations(&mut update)?
            }
        };
        let size = ((count - 1) as f64).sqrt();
        for (member, x) in members.chunks_exact_mut(n_z).zip(perturbations.chunks_exact(n_z)) {
            member.iter_mut().zip(x).zip(&z).for_each(|((member, x), z)| *member = z + size * x);
        }
        if let Some(normals) = settings.rotation {
            rotate(&mut members, n_z, &mut *normals(state.next));
        }

        let mut models: Vec<_> = (0..count).map(|_| make()).collect();
        let (n, steps) = (models[0].dim(), self.steps());
        let (mut x_b, mut x_a) = (vec![0.0; n], vec![0.0; n]);
        models[0].initial_state(z_b, &mut x_b)?;
        models[0].initial_state(&z, &mut x_a)?;
        let mut states = vec![0.0; count * (steps + 1) * n];
        let seed = state.next as u64;
        let drawn_again = run_all_drawing_again(&mut models, &mut members, &mut states, steps, seed)?;
        let at = |k: usize| -> Vec<f64> {
            states.chunks_exact((steps + 1) * n).flat_map(|run| &run[k * n..][..n]).copied().collect()
        };
        for (member, x) in members.chunks_exact_mut(n_z).zip(at(self.shift).chunks_exact(n)) {
            member.copy_from_slice(&x[..n_z]);
        }
        if let Some(errors) = &self.model_error {
            errors.draw(&mut members, n_z, self.shift, state.next);
        }
        let ends = at(self.window);
        let end = mean(&ends, n);
        let variance = |i: usize| {
            ends.chunks_exact(n).map(|x| (x[i] - end[i]).powi(2)).sum::<f64>() / (count - 1) as f64
        };
        let sigma = Some((0..n_z).map(|i| variance(i).sqrt()).collect());
        let errors = self.errors(state.next, [&x_b, &x_a, &end]);
        let whole = self.posterior && is_whole(minimum.status);
        let posterior = whole.then_some(CyclePosterior::Members(states));
        let from = Ended {
            minimum,
            counts,
            sigma,
            errors,
            departures,
            inflation,
            drawn_again,
            columns: count,
            dropped: 0.0,
            model_errors: Vec::new(),
            posterior,
        };
        let background = mean(&members, n_z);
        Ok((
            self.cycle(state, z, end, m, from),
            CycleState { next: state.next + 1, background, columns: members },
        ))
    }
}
