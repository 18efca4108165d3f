//! Strong-constraint 4D-Var; with a window of zero steps, 3D-Var.

use super::model_error::{Errors, Over};
use super::robust::huber;
use super::{CostFunction, CostTerms, Counts, GaussNewton, Incremental, dot};
use crate::{ControlTransform, Error, ObservationSet};
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use varda_implicit::Model;

/// Strong-constraint 4D-Var in the control variable (paper 2.15, with z = z_b + B^{1/2} v; Courtier, Thépaut and Hollingsworth 1994):
///
/// ```text
///     J(v)  = ½‖v‖² + ½ Σ_k ‖y_k − H_k(x_k)‖²_{R_k⁻¹},    x₀ = x₀(z),    x_{k+1} = M_k(x_k)
///     ∇J(v) = v − Gᵀ R^{-1/2} d,    A = I + GᵀG,    G = R^{-1/2} H M B^{1/2}
/// ```
///
/// The gradient is one forward run, one linearization of every step, and one adjoint sweep in Horner's form (2.26, 2.27):
/// λ ← H_kᵀ R_k⁻¹ d_k + M_kᵀ λ from the last observed step down to the first. Steps after the last observation are not run. Where the
/// last observation is at step 0, or there is no model at all, this is 3D-Var and no step is called.
///
/// When to use: the default, where the model has a tangent and an adjoint. When not: a model in error ([`WeakForcing`](super::WeakForcing)), no
/// adjoint ([`EnVar`](super::EnVar)), chaos over a window of many e-foldings ([`window_growth`](crate::window_growth)).
///
/// Cost: a gradient is one forward run, one linearization of every step and one adjoint sweep; a product with A one sweep each way; A itself n
/// tangent sweeps. Memory: two trajectories, (last + 1) × n each, beside what the model keeps of its linearizations; m n for A.
pub struct StrongConstraint<'a> {
    pub(super) model: Option<&'a mut (dyn Model + 'a)>,
    pub(super) transform: ControlTransform<'a>,
    pub(super) observations: &'a mut ObservationSet,
    /// With model error: the engine of the weak-constraint costs.
    pub(super) errors: Option<Errors<'a>>,
    pub(super) scale: f64,
    /// δ of the Huber norm; infinite for squares.
    huber: f64,
    /// √ρ'' of every row at the point of the last gradient.
    root_weight: Vec<f64>,
    /// The last step that is run to.
    pub(super) last: usize,
    /// Length of the state.
    pub(super) state_dim: usize,
    /// The point of the last gradient.
    pub(super) base: Point,
    /// Whether the model holds the linearizations at `base`.
    linearized: bool,
    /// The last point evaluated without one.
    pub(super) trial: Point,
    terms: CostTerms,
    pub(super) counts: Counts,
    model_before: varda_implicit::Counts,
    pub(super) lambda: Vec<f64>,
    pub(super) dz: Vec<f64>,
    pub(super) dy: Vec<f64>,
    unit: Vec<f64>,
    /// G, m × n by columns; allocated by the first dense Hessian.
    jacobian: Vec<f64>,
}

/// A forward run: everything that follows from v without derivatives.
pub(super) struct Point {
    valid: bool,
    /// Whether the model's `initial_state` was last called here.
    pub(super) initial: bool,
    v: Vec<f64>,
    z: Vec<f64>,
    /// b, the whitened departures from what is known before: v itself, unless v is states.
    prior: Vec<f64>,
    pub(super) states: Vec<f64>,
    /// M_k(x_k) of the steps after which the model's error enters.
    landings: Vec<f64>,
    predicted: Vec<f64>,
}

impl<'a> StrongConstraint<'a> {
    /// The cost of a window of `observations.steps()` steps of a model whose control is that of `transform`.
    ///
    /// # Errors
    /// A model whose control has another length than B.
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
        Ok(Self::with(Some(model), state_dim, transform, observations, None))
    }

    /// 3D-Var: no model, the control is the state.
    ///
    /// # Errors
    /// Observations after step 0.
    pub fn without_model(
        transform: ControlTransform<'a>,
        observations: &'a mut ObservationSet,
    ) -> Result<Self, Error> {
        if let Some(step @ 1..) = observations.last_step() {
            return Err(Error::Length { what: "a window without a model", expected: 0, found: step });
        }
        let state_dim = transform.control_dim();
        Ok(Self::with(None, state_dim, transform, observations, None))
    }

    /// The cost with errors of the model.
    pub(super) fn weak(
        model: &'a mut (dyn Model + 'a),
        transform: ControlTransform<'a>,
        observations: &'a mut ObservationSet,
        errors: Errors<'a>,
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
        errors: Option<Errors<'a>>,
    ) -> Self {
        let (n_z, m) = (transform.control_dim(), observations.dim());
        let n = transform.dim() + errors.as_ref().map_or(0, Errors::dim);
        let landings = errors.as_ref().map_or(0, Errors::slots) * state_dim;
        let last = observations.last_step().unwrap_or(0);
        let point = || Point {
            valid: false,
            initial: false,
            v: vec![0.0; n],
            z: vec![0.0; n_z],
            prior: vec![0.0; n],
            states: vec![0.0; (last + 1) * state_dim],
            landings: vec![0.0; landings],
            predicted: vec![0.0; m],
        };
        Self {
            model_before: model.as_ref().map(|m| m.counts()).unwrap_or_default(),
            model,
            scale: 1.0,
            huber: f64::INFINITY,
            root_weight: vec![1.0; m],
            last,
            state_dim,
            base: point(),
            linearized: false,
            trial: point(),
            terms: CostTerms::default(),
            counts: Counts::default(),
            lambda: vec![0.0; state_dim],
            dz: vec![0.0; n_z],
            dy: vec![0.0; m],
            unit: vec![0.0; n],
            jacobian: Vec::new(),
            transform,
            observations,
            errors,
        }
    }

    /// Measures departures by the Huber norm from now on: J_o = Σ ρ_δ(d/σ), see [`huber`](crate::huber). δ is in units of σ; infinity (the
    /// default) is the sum of squares.
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
    /// If no gradient has been evaluated, or that step was not run.
    pub fn state(&self, k: usize) -> &[f64] {
        assert!(self.linearized, "evaluate a gradient first");
        &self.base.states[k * self.state_dim..(k + 1) * self.state_dim]
    }

    /// Predictions H(x) at the point of the last gradient, stacked.
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn predicted(&self) -> &[f64] {
        assert!(self.linearized, "evaluate a gradient first");
        &self.base.predicted
    }

    /// Runs the window from v into the trial point.
    fn forward(&mut self, v: &[f64]) -> Result<(), Error> {
        self.base.initial = false;
        self.trial.initial = false;
        self.trial.valid = false;
        if !v.iter().all(|v| v.is_finite()) {
            return Err(Error::NonFinite { what: "the control variable", step: 0 });
        }
        self.counts.forward_runs += 1;
        let n = self.state_dim;
        let Point { v: kept, z, prior, states, landings, predicted, .. } = &mut self.trial;
        kept.copy_from_slice(v);
        let head = self.transform.dim();
        match self.errors.as_ref().map(|e| e.over) {
            Some(Over::States { b, .. }) => {
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
        match &mut self.model {
            Some(model) => model.initial_state(z, &mut states[..n])?,
            None => states.copy_from_slice(z),
        }
        predicted.fill(0.0);
        self.observations.observe_add(0, &states[..n], predicted)?;
        if let Some(model) = &mut self.model {
            for k in 0..self.last {
                let (x, x_next) = states[k * n..(k + 2) * n].split_at_mut(n);
                model.step(k, x, x_next)?;
                if let Some(errors) = &mut self.errors {
                    errors.enter(k, &v[head..], x_next, landings, &mut prior[head..]);
                }
                self.observations.observe_add(k + 1, x_next, predicted)?;
            }
        }
        self.trial.initial = true;
        self.trial.valid = true;
        Ok(())
    }

    /// Linearizes every step at the base point.
    fn linearize(&mut self) -> Result<(), Error> {
        self.linearized = false;
        let n = self.state_dim;
        if let Some(model) = &mut self.model {
            for k in 0..self.last {
                // The pair the model stepped between: its error enters after.
                let (x, mut x_next) = self.base.states[k * n..(k + 2) * n].split_at(n);
                if let Some(slot) = self.errors.as_ref().and_then(|e| e.slot(k)) {
                    x_next = &self.base.landings[slot * n..(slot + 1) * n];
                }
                model.linearize(k, x, x_next)?;
            }
        }
        self.linearized = true;
        Ok(())
    }

    /// Brings the model's map from control to initial state back to the base point after a trial run.
    pub(super) fn return_to_base(&mut self) -> Result<(), Error> {
        assert!(self.linearized, "evaluate a gradient first");
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
    fn adjoint_sweep(&mut self, out: &mut [f64]) {
        self.counts.adjoint_sweeps += 1;
        let n = self.state_dim;
        let (out, forcing) = out.split_at_mut(self.transform.dim());
        self.lambda.fill(0.0);
        forcing.fill(0.0);
        for k in (0..=self.last).rev() {
            if k < self.last
                && let Some(model) = &mut self.model
            {
                if let Some(errors) = &mut self.errors {
                    errors.adjoint_add(k, &self.lambda, forcing);
                }
                model.adjoint(k, &mut self.lambda);
            }
            let x = &self.base.states[k * n..(k + 1) * n];
            self.observations.adjoint_add(k, x, &self.dy, &mut self.lambda);
        }
        match &mut self.model {
            Some(model) => model.initial_adjoint(&self.lambda, &mut self.dz),
            None => self.dz.copy_from_slice(&self.lambda),
        }
        self.transform.adjoint(&self.dz, out);
    }

    /// dy = R^{-1/2} H M U dv, at the base point.
    fn tangent_sweep(&mut self, dv: &[f64], dy: &mut [f64]) {
        self.counts.tangent_sweeps += 1;
        let n = self.state_dim;
        let (dv, forcing) = dv.split_at(self.transform.dim());
        self.transform.tangent(dv, &mut self.dz);
        match &mut self.model {
            Some(model) => model.initial_tangent(&self.dz, &mut self.lambda),
            None => self.lambda.copy_from_slice(&self.dz),
        }
        dy.fill(0.0);
        for k in 0..=self.last {
            let x = &self.base.states[k * n..(k + 1) * n];
            self.observations.tangent_add(k, x, &self.lambda, dy);
            if k < self.last
                && let Some(model) = &mut self.model
            {
                model.tangent(k, &mut self.lambda);
                if let Some(errors) = &mut self.errors {
                    errors.tangent_add(k, forcing, &mut self.lambda);
                }
            }
        }
        self.whiten(dy);
    }

    /// dy ← √ρ'' R^{-1/2} dy.
    fn whiten(&self, dy: &mut [f64]) {
        for ((dy, sigma), root) in dy.iter_mut().zip(self.observations.sigma()).zip(&self.root_weight) {
            *dy *= root / (self.scale * sigma);
        }
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
            self.forward(v)?;
        }
        let point = if at_base { &self.base } else { &self.trial };
        let mut sum = 0.0;
        for i in 0..self.observations.dim() {
            let sigma = self.scale * self.observations.sigma()[i];
            let d = self.observations.values()[i] - point.predicted[i];
            sum += huber(self.huber, d / sigma).0;
        }
        let (background, errors) = point.prior.split_at(self.transform.dim());
        let terms = CostTerms {
            background: 0.5 * dot(background, background),
            observation: sum,
            model_error: errors.iter().fold(0.0, |sum, e| sum + 0.5 * e * e),
        };
        if !terms.total().is_finite() {
            return Err(Error::NonFinite { what: "the cost", step: self.last });
        }

        if let Some(gradient) = gradient {
            assert_eq!(gradient.len(), self.dim(), "length of the gradient");
            if !at_base {
                std::mem::swap(&mut self.base, &mut self.trial);
                self.linearized = false;
            }
            if !self.linearized {
                self.linearize()?;
            }
            self.return_to_base()?;
            for i in 0..self.observations.dim() {
                let sigma = self.scale * self.observations.sigma()[i];
                let d = self.observations.values()[i] - self.base.predicted[i];
                let (_, slope, curvature) = huber(self.huber, d / sigma);
                self.dy[i] = -slope / sigma;
                self.root_weight[i] = curvature.sqrt();
            }
            self.counts.gradients += 1;
            if self.observations.dim() == 0 {
                gradient.fill(0.0);
            } else {
                self.adjoint_sweep(gradient);
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
        self.scale = scale;
    }

    fn counts(&self) -> Counts {
        let model = match &self.model {
            Some(model) => difference(model.counts(), self.model_before),
            None => varda_implicit::Counts::default(),
        };
        Counts { model, ..self.counts }
    }
}

impl GaussNewton for StrongConstraint<'_> {
    fn observation_dim(&self) -> usize {
        self.observations.dim()
    }

    fn observation_jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.return_to_base()?;
        self.tangent_sweep(dv, dy);
        Ok(())
    }

    fn observation_jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        assert_eq!(dy.len(), self.observations.dim(), "length of dy");
        self.return_to_base()?;
        let mut whitened = std::mem::take(&mut self.dy);
        whitened.copy_from_slice(dy);
        self.whiten(&mut whitened);
        self.dy = whitened;
        self.adjoint_sweep(dv);
        Ok(())
    }

    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.return_to_base()?;
        let mut dy = std::mem::take(&mut self.dy);
        self.tangent_sweep(dv, &mut dy);
        self.whiten(&mut dy);
        self.dy = dy;
        self.adjoint_sweep(out);
        for (out, dv) in out.iter_mut().zip(dv) {
            *out += dv;
        }
        Ok(())
    }

    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.return_to_base()?;
        let (n, m) = (self.dim(), self.observations.dim());
        assert_eq!(out.len(), n * n, "length of the Hessian");
        let mut unit = std::mem::take(&mut self.unit);
        let mut jacobian = std::mem::take(&mut self.jacobian);
        jacobian.resize(m * n, 0.0);
        if m > 0 {
            for (j, column) in jacobian.chunks_exact_mut(m).enumerate() {
                unit[j] = 1.0;
                self.tangent_sweep(&unit, column);
                unit[j] = 0.0;
            }
        }
        let g = MatRef::from_column_major_slice(&jacobian, m, n);
        let a = MatMut::from_column_major_slice_mut(out, n, n);
        matmul(a, Accum::Replace, g.transpose(), g, 1.0, Par::Seq);
        self.unit = unit;
        self.jacobian = jacobian;
        for j in 0..n {
            out[j + j * n] += 1.0;
            for i in 0..j {
                out[j + i * n] = out[i + j * n];
            }
        }
        Ok(())
    }
}

impl Incremental for StrongConstraint<'_> {
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

    fn departure_dim(&self) -> usize {
        self.observations.dim()
    }

    fn background_dim(&self) -> usize {
        self.transform.dim()
    }

    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        assert!(self.linearized, "evaluate a gradient first");
        b.copy_from_slice(&self.base.prior);
        self.observations.innovations(&self.base.predicted, d);
        for (d, sigma) in d.iter_mut().zip(self.observations.sigma()) {
            *d /= self.scale * sigma;
        }
    }

    fn tangent(&mut self, p: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.observation_jacobian(p, dy)
    }

    fn adjoint(&mut self, dy: &[f64], p: &mut [f64]) -> Result<(), Error> {
        self.observation_jacobian_transpose(dy, p)
    }
}

fn difference(now: varda_implicit::Counts, before: varda_implicit::Counts) -> varda_implicit::Counts {
    varda_implicit::Counts {
        model_steps: now.model_steps - before.model_steps,
        substeps: now.substeps - before.substeps,
        tangent_steps: now.tangent_steps - before.tangent_steps,
        adjoint_steps: now.adjoint_steps - before.adjoint_steps,
        linearizations: now.linearizations - before.linearizations,
        factorizations: now.factorizations - before.factorizations,
        newton_iterations: now.newton_iterations - before.newton_iterations,
    }
}
