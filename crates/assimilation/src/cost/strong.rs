//! Strong-constraint 4D-Var; with a window of zero steps, 3D-Var.

use super::dense_work::Dense;
use super::exact_work::Exact;
use super::least_squares::symmetrize;
use super::model_error::{ModelErrorTerm, WeakControl};
use super::{CostFunction, CostTerms, Counts, LeastSquares, dot};
use crate::{ControlTransform, Error, ObservationSet, Prediction};
use varda_implicit::{Footprint, Keep, Log, Model, Storage, Trajectory};

/// Strong-constraint 4D-Var in the control variable (paper 2.15, with z = z_b + B^{1/2} v; Courtier, Thépaut
/// and Hollingsworth 1994):
///
/// ```text
///     J(v)  = ½‖v‖² + ½ Σ_k ‖y_k − H_k(x_k)‖²_{R_k⁻¹},    x₀ = x₀(z),
///     x_{k+1} = M_k(x_k)
///     ∇J(v) = v − Gᵀ R^{-1/2} d,    A = I + GᵀG,    G = R^{-1/2} H M B^{1/2}
/// ```
///
/// The gradient is one forward run, one linearization of every step, and one adjoint sweep in Horner's form
/// (paper 2.17, 2.26, 2.27):
/// λ ← H_kᵀ R_k⁻¹ d_k + M_kᵀ λ from the last observed step down to the first. Steps after the last
/// observation are not run. Where the last observation is at step 0, or there is no model at all, this is
/// 3D-Var and no step is called (paper 2.5, 2.6, 2.9).
///
/// When to use: the default, where the model has a tangent and an adjoint. When not: a model in error
/// ([`WeakForcing`](super::WeakForcing)), no adjoint ([`EnVar`](super::EnVar)), chaos over a window of many
/// e-foldings ([`window_growth`](crate::window_growth)).
///
/// Cost: a gradient is one forward run, one linearization of every step and one adjoint sweep; a product with
/// A one sweep each way; A itself n tangent or m adjoint sweeps, whichever takes fewer steps. Memory: two
/// trajectories, (last + 1) × n each, beside what the model keeps of its linearizations, m n for A; less,
/// for more work and the same bits, by [`set_storage`](Self::set_storage).
///
/// ```
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// let mut observations = ObservationSet::new(20, vec![Box::new(Selection::new(vec![0, 1, 2], 3)?)], seen)?;
/// let b = Diagonal::uniform(3, 1.0)?;
/// let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// let mut cost = StrongConstraint::new(&mut model, transform, &mut observations)?;
/// let (v, mut gradient) = (vec![0.0; 3], vec![0.0; 3]);
/// let at_background = cost.evaluate(&v, Some(&mut gradient))?;
/// let downhill: Vec<f64> = gradient.iter().map(|g| -1e-6 * g).collect();
/// assert!(cost.evaluate(&downhill, None)? < at_background);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct StrongConstraint<'a> {
    pub(super) model: Option<&'a mut (dyn Model + 'a)>,
    pub(super) transform: ControlTransform<'a>,
    pub(super) observations: &'a mut ObservationSet,
    /// With model error: the engine of the weak-constraint costs.
    pub(super) errors: Option<ModelErrorTerm<'a>>,
    /// R^{-1/2} of independent rows, 1 of correlated ones, with the scale of σ in force: R^{-1/2} is this
    /// after the whitening of the correlated blocks.
    pub(super) root_precision: Vec<f64>,
    /// δ of the Huber norm; infinite for squares.
    pub(super) huber: f64,
    /// √ρ'' of every row at the point of the last gradient.
    pub(super) root_weight: Vec<f64>,
    /// The last step that is run to.
    pub(super) last: usize,
    /// Length of the state.
    pub(super) state_dim: usize,
    /// The point of the last gradient.
    pub(super) base: Point,
    /// Whether `base` is the point of a gradient.
    based: bool,
    /// The last point evaluated without one.
    pub(super) trial: Point,
    terms: CostTerms,
    pub(super) counts: Counts,
    /// Work of the model outside the present trajectories: of those before a change of storage, and of single
    /// steps.
    pub(super) log: Log,
    pub(super) lambda: Vec<f64>,
    pub(super) dz: Vec<f64>,
    pub(super) dy: Vec<f64>,
    /// Work space of the dense Hessian, allocated by the first.
    pub(super) dense: Dense,
    /// Of exact products, the same.
    pub(super) exact: Exact,
}

/// A forward run: everything that follows from v without derivatives.
pub(super) struct Point {
    valid: bool,
    /// Whether the model's `initial_state` was last called here.
    pub(super) initial: bool,
    pub(super) v: Vec<f64>,
    z: Vec<f64>,
    /// b, the whitened departures from what is known before: v itself, unless v is states.
    prior: Vec<f64>,
    pub(super) trajectory: Trajectory,
    /// M_k(x_k) of the steps after which the model's error enters.
    landings: Vec<f64>,
    pub(super) predicted: Prediction,
}

impl<'a> StrongConstraint<'a> {
    /// The cost of a window of `observations.steps()` steps of a model whose control is that of `transform`.
    ///
    /// # Errors
    /// A model whose control has another length than B, or whose state has another length than that which the
    /// observation operators read ([`Error::StateLength`]).
    pub fn new(
        model: &'a mut (dyn Model + 'a),
        transform: ControlTransform<'a>,
        observations: &'a mut ObservationSet,
    ) -> Result<Self, Error> {
        if model.control_dim() != transform.control_dim() {
            return Err(Error::Length {
                what: "the background",
                expected: model.control_dim(),
                found: transform.control_dim(),
            });
        }
        let state_dim = model.dim();
        observations.check_state(state_dim)?;
        observations.follow(model.rate());
        Ok(Self::with(Some(model), state_dim, transform, observations, None))
    }

    /// 3D-Var: no model, the control is the state.
    ///
    /// # Errors
    /// Observations after step 0; operators that read a state of another length.
    pub fn without_model(
        transform: ControlTransform<'a>,
        observations: &'a mut ObservationSet,
    ) -> Result<Self, Error> {
        if let Some(step @ 1..) = observations.last_step() {
            return Err(Error::Length { what: "a window without a model", expected: 0, found: step });
        }
        let state_dim = transform.control_dim();
        observations.check_state(state_dim)?;
        Ok(Self::with(None, state_dim, transform, observations, None))
    }

    /// The cost with errors of the model.
    pub(super) fn weak(
        model: &'a mut (dyn Model + 'a),
        transform: ControlTransform<'a>,
        observations: &'a mut ObservationSet,
        errors: ModelErrorTerm<'a>,
    ) -> Result<Self, Error> {
        let Self { model, transform, observations, state_dim, .. } =
            Self::new(model, transform, observations)?;
        Ok(Self::with(model, state_dim, transform, observations, Some(errors)))
    }

    fn with(
        model: Option<&'a mut (dyn Model + 'a)>,
        state_dim: usize,
        transform: ControlTransform<'a>,
        observations: &'a mut ObservationSet,
        errors: Option<ModelErrorTerm<'a>>,
    ) -> Self {
        let (n_z, m) = (transform.control_dim(), observations.dim());
        let n = transform.dim() + errors.as_ref().map_or(0, ModelErrorTerm::dim);
        let landings = errors.as_ref().map_or(0, ModelErrorTerm::slots) * state_dim;
        let last = observations.last_step().unwrap_or(0);
        let point = || Point {
            valid: false,
            initial: false,
            v: vec![0.0; n],
            z: vec![0.0; n_z],
            prior: vec![0.0; n],
            trajectory: room(Storage::KeepAll, state_dim, last),
            landings: vec![0.0; landings],
            predicted: observations.prediction(),
        };
        Self {
            model,
            log: Log::default(),
            root_precision: observations.row_scale().iter().map(|sigma| 1.0 / sigma).collect(),
            huber: f64::INFINITY,
            root_weight: vec![1.0; m],
            last,
            state_dim,
            base: point(),
            based: false,
            trial: point(),
            terms: CostTerms::default(),
            counts: Counts::default(),
            lambda: vec![0.0; state_dim],
            dz: vec![0.0; n_z],
            dy: vec![0.0; m],
            dense: Dense::default(),
            exact: Exact::default(),
            transform,
            observations,
            errors,
        }
    }

    /// Measures departures by the Huber norm from now on: J_o = Σ ρ_δ(d/σ), see [`huber`](crate::huber).
    /// δ is in units of σ; infinity (the default) is the sum of squares.
    ///
    /// # Errors
    /// δ that is not positive.
    pub fn set_huber(&mut self, delta: f64) -> Result<(), Error> {
        if !(delta > 0.0) {
            return Err(Error::Setting { what: "the threshold of the Huber norm", value: delta });
        }
        self.huber = delta;
        Ok(())
    }

    /// δ of the Huber norm in force.
    pub fn huber_threshold(&self) -> f64 {
        self.huber
    }

    /// What is kept between a forward run and the sweeps along it: the same bits for less memory and more
    /// work. Nothing is known of any point afterwards.
    ///
    /// # Panics
    /// If not even one state is to be kept.
    pub fn set_storage(&mut self, storage: Storage) {
        for point in [&mut self.base, &mut self.trial] {
            point.valid = false;
            self.log.add(point.trajectory.log());
            point.trajectory = room(storage, self.state_dim, self.last);
        }
        self.based = false;
    }

    /// The storage of least work whose states and linearizations take no more than so many bytes
    /// ([`bytes`](Self::bytes)); sets and returns it. A model that does not say what it keeps is counted with
    /// its states alone; a dense Hessian is not counted.
    ///
    /// # Errors
    /// [`varda_implicit::Error::Memory`] where the sparest storage takes more.
    pub fn set_memory(&mut self, bytes: usize) -> Result<Storage, Error> {
        let footprint = Footprint {
            steps: self.last,
            runs: 2,
            state: self.state_dim * size_of::<f64>(),
            linearization: self.model.as_ref().map_or(0, |m| m.slot_bytes()),
            always: self.base.predicted.bytes() + self.trial.predicted.bytes(),
        };
        let storage = footprint.within(bytes)?;
        self.set_storage(storage);
        Ok(storage)
    }

    /// What is kept.
    pub fn storage(&self) -> Storage {
        self.base.trajectory.storage()
    }

    /// Bytes held at present: the states of two runs, at steps and observed between them, and the
    /// linearizations in the model.
    pub fn bytes(&self) -> usize {
        let model = self.model.as_ref().map_or(0, |m| m.bytes());
        let between = self.base.predicted.bytes() + self.trial.predicted.bytes();
        self.base.trajectory.bytes() + self.trial.trajectory.bytes() + between + model
    }

    /// What the model did for this cost, and what its steps went through.
    pub fn log(&self) -> Log {
        let mut log = self.log.clone();
        log.add(self.base.trajectory.log());
        log.add(self.trial.trajectory.log());
        log
    }

    /// The control variable transform.
    pub fn transform(&self) -> &ControlTransform<'a> {
        &self.transform
    }

    /// The observations.
    pub fn observations(&self) -> &ObservationSet {
        self.observations
    }

    /// State x_k of the point of the last gradient, k = 0 … the last observed step.
    ///
    /// # Panics
    /// If no gradient has been evaluated, that step was not run, or its state is not kept (checkpoints).
    pub fn state(&self, k: usize) -> &[f64] {
        assert!(self.based, "evaluate a gradient first");
        self.base.trajectory.state(k)
    }

    /// Predictions H(x) at the point of the last gradient, stacked.
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn predicted(&self) -> &[f64] {
        assert!(self.based, "evaluate a gradient first");
        self.base.predicted.values()
    }

    /// Runs the window from v into the trial point.
    fn forward(&mut self, v: &[f64], keep: Keep) -> Result<(), Error> {
        self.base.initial = false;
        self.trial.initial = false;
        self.trial.valid = false;
        if keep == Keep::Linearizations {
            self.base.trajectory.forget_linearizations();
        }
        if !v.iter().all(|v| v.is_finite()) {
            return Err(Error::NonFinite { what: "the control variable", step: 0 });
        }
        self.counts.forward_runs += 1;
        let Point { v: kept, z, prior, trajectory, landings, predicted, .. } = &mut self.trial;
        kept.copy_from_slice(v);
        let head = self.transform.dim();
        match self.errors.as_ref().map(|e| e.over) {
            Some(WeakControl::States { b, .. }) => {
                z.copy_from_slice(&v[..head]);
                for ((dz, z), background) in self.dz.iter_mut().zip(&*z).zip(self.transform.background()) {
                    *dz = z - background;
                }
                b.whiten(&self.dz, &mut prior[..head]);
            }
            _ => {
                self.transform.control(&v[..head], z);
                prior.copy_from_slice(v);
            }
        }
        predicted.clear();
        let x0 = trajectory.start(self.state_dim, self.last);
        match &mut self.model {
            Some(model) => {
                model.initial_state(z, x0)?;
                trajectory.forward(&mut **model, keep, &mut |k, x| {
                    if let (Some(errors), Some(before)) = (&mut self.errors, k.checked_sub(1)) {
                        errors.enter(before, &v[head..], x, landings, &mut prior[head..]);
                    }
                    self.observations.observe_add(k, x, predicted)
                })?;
            }
            None => {
                x0.copy_from_slice(z);
                self.observations.observe_add(0, x0, predicted)?;
            }
        }
        self.trial.initial = true;
        self.trial.valid = true;
        Ok(())
    }

    /// Linearizes every step at the base point, where the storage keeps that and the model does not hold it
    /// already.
    fn linearize(&mut self) -> Result<(), Error> {
        let Some(model) = &mut self.model else { return Ok(()) };
        self.trial.trajectory.forget_linearizations();
        let (n, errors, landings) = (self.state_dim, &self.errors, &self.base.landings);
        // The pair the model stepped between: its error enters after.
        let landing = |k: usize| {
            let slot = errors.as_ref().and_then(|e| e.slot(k))?;
            Some(&landings[slot * n..(slot + 1) * n])
        };
        Ok(self.base.trajectory.linearize_landing(&mut **model, &landing)?)
    }

    /// Brings the model back to the base point after a trial run: its linearizations, and its map from
    /// control to initial state.
    pub(super) fn return_to_base(&mut self) -> Result<(), Error> {
        assert!(self.based, "evaluate a gradient first");
        self.linearize()?;
        if !self.base.initial {
            if let Some(model) = &mut self.model {
                model.initial_state(&self.base.z, &mut self.lambda)?;
            }
            self.base.initial = true;
            self.trial.initial = false;
        }
        Ok(())
    }

    /// out = (H M U)ᵀ dy, at the base point.
    fn adjoint_sweep(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.counts.adjoint_sweeps += 1;
        let Self { model, transform, observations, errors, base, lambda, dz, dy, .. } = self;
        let (out, forcing) = out.split_at_mut(transform.dim());
        let predicted = &base.predicted;
        forcing.fill(0.0);
        let mut add = |k: usize, x: &[f64], lambda: &mut [f64]| {
            observations.adjoint_add(k, x, dy, predicted, lambda);
            if let (Some(errors), Some(before)) = (&mut *errors, k.checked_sub(1)) {
                errors.adjoint_add(before, lambda, forcing);
            }
        };
        match model {
            Some(model) => {
                base.trajectory.adjoint(&mut **model, lambda, &mut add)?;
                model.initial_adjoint(lambda, dz);
            }
            None => {
                lambda.fill(0.0);
                add(0, base.trajectory.state(0), lambda);
                dz.copy_from_slice(lambda);
            }
        }
        transform.adjoint(dz, out);
        Ok(())
    }

    /// dy = R^{-1/2} H M U dv, at the base point.
    fn tangent_sweep(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.counts.tangent_sweeps += 1;
        let Self { model, transform, observations, errors, base, lambda: dx, dz, .. } = self;
        let (dv, forcing) = dv.split_at(transform.dim());
        transform.tangent(dv, dz);
        dy.fill(0.0);
        let predicted = &base.predicted;
        let mut see = |k: usize, x: &[f64], dx: &mut [f64]| {
            if let (Some(errors), Some(before)) = (&mut *errors, k.checked_sub(1)) {
                errors.tangent_add(before, forcing, dx);
            }
            observations.tangent_add(k, x, dx, predicted, dy);
        };
        match model {
            Some(model) => {
                model.initial_tangent(dz, dx);
                base.trajectory.tangent(&mut **model, dx, &mut see)?;
            }
            None => {
                dx.copy_from_slice(dz);
                see(0, base.trajectory.state(0), dx);
            }
        }
        self.whiten(dy);
        Ok(())
    }
}

impl CostFunction for StrongConstraint<'_> {
    fn dim(&self) -> usize {
        self.base.v.len()
    }

    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        assert_eq!(v.len(), self.dim(), "length of v");
        let at_base = self.base.valid && self.base.v == v;
        let at_trial = self.trial.valid && self.trial.v == v;
        if !at_base && !at_trial {
            self.forward(v, if gradient.is_some() { Keep::Linearizations } else { Keep::States })?;
        }
        let observation = self.observation_term(at_base, gradient.is_some());
        let point = if at_base { &self.base } else { &self.trial };
        let (background, errors) = point.prior.split_at(self.transform.dim());
        let terms = CostTerms {
            background: 0.5 * dot(background, background),
            observation,
            model_error: errors.iter().fold(0.0, |sum, e| sum + 0.5 * e * e),
        };
        if !terms.total().is_finite() {
            return Err(Error::NonFinite { what: "the cost", step: self.last });
        }

        if let Some(gradient) = gradient {
            assert_eq!(gradient.len(), self.dim(), "length of the gradient");
            if !at_base {
                std::mem::swap(&mut self.base, &mut self.trial);
            }
            self.based = false;
            self.linearize()?;
            self.based = true;
            self.return_to_base()?;
            self.counts.gradients += 1;
            self.exact.start(&self.dy);
            if self.observations.dim() == 0 {
                gradient.fill(0.0);
            } else {
                self.adjoint_sweep(gradient)?;
            }
            for (g, b) in gradient.iter_mut().zip(&self.base.prior) {
                *g += b;
            }
            if !gradient.iter().all(|g| g.is_finite()) {
                return Err(Error::NonFinite { what: "the gradient", step: 0 });
            }
        }
        self.terms = terms;
        Ok(terms.total())
    }

    fn terms(&self) -> CostTerms {
        self.terms
    }

    fn set_observation_scale(&mut self, scale: f64) {
        assert!(scale > 0.0 && scale.is_finite(), "observation scale {scale}");
        for (root, sigma) in self.root_precision.iter_mut().zip(self.observations.row_scale()) {
            *root = 1.0 / (scale * sigma);
        }
    }

    fn counts(&self) -> Counts {
        let runs = self.base.trajectory.log().counts + self.trial.trajectory.log().counts;
        Counts { model: self.log.counts + runs, ..self.counts }
    }
}

impl LeastSquares for StrongConstraint<'_> {
    fn observation_dim(&self) -> usize {
        self.observations.dim()
    }

    fn linearize(&mut self, v: &[f64], gradient: &mut [f64]) -> Result<f64, Error> {
        // The inner problem is one of least squares; Huber's norm is not.
        if self.huber.is_finite() {
            return Err(Error::Setting {
                what: "a Huber threshold in an incremental or dual form",
                value: self.huber,
            });
        }
        self.evaluate(v, Some(gradient))
    }

    fn background_dim(&self) -> usize {
        self.transform.dim()
    }

    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        assert!(self.based, "evaluate a gradient first");
        b.copy_from_slice(&self.base.prior);
        self.observations.innovations(self.base.predicted.values(), d);
        self.observations.whiten_blocks(d);
        d.iter_mut().zip(&self.root_precision).for_each(|(d, root)| *d *= root);
    }

    fn jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.return_to_base()?;
        self.tangent_sweep(dv, dy)
    }

    fn jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        assert_eq!(dy.len(), self.observations.dim(), "length of dy");
        self.return_to_base()?;
        let mut whitened = std::mem::take(&mut self.dy);
        whitened.copy_from_slice(dy);
        self.whiten_transpose(&mut whitened);
        self.dy = whitened;
        self.adjoint_sweep(dv)
    }

    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.return_to_base()?;
        let mut dy = std::mem::take(&mut self.dy);
        let swept = self.tangent_sweep(dv, &mut dy);
        self.whiten_transpose(&mut dy);
        self.dy = dy;
        swept?;
        self.adjoint_sweep(out)?;
        for (out, dv) in out.iter_mut().zip(dv) {
            *out += dv;
        }
        Ok(())
    }

    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.return_to_base()?;
        self.dense_hessian(out)
    }

    fn dense_jacobian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.return_to_base()?;
        self.dense_g(out)
    }

    fn has_exact_hessian(&mut self) -> bool {
        self.has_second_derivatives()
    }

    fn exact_hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.exact_product(dv, out)
    }

    fn exact_hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        assert_eq!(out.len(), self.dim() * self.dim(), "length of the Hessian");
        self.exact_columns(out)?;
        symmetrize(self.dim(), out);
        Ok(())
    }
}

/// Room for a run.
fn room(storage: Storage, dim: usize, steps: usize) -> Trajectory {
    let mut trajectory = Trajectory::with_storage(storage);
    trajectory.start(dim, steps);
    trajectory
}
