//! 4D-EnVar and its hybrid: an ensemble of forward runs in the place of the tangent and the adjoint.

mod analysis;
mod runs;

pub use analysis::{EnVarOptions, EnsembleUpdate};
use runs::run_all;
pub(crate) use runs::run_each;

use std::borrow::Cow;

use super::{CostFunction, CostTerms, Counts, LeastSquares, dot};
use crate::{ControlTransform, Error, ObservationSet, Prediction};
use varda_covariance::{Covariance, Ensemble, Hybrid};
use varda_implicit::{Log, Model};
use varda_linalg::dense::{View, product};

/// 4D-EnVar (Liu, Xiao and Wang 2008; Desroziers, Camino and Berre 2014) and hybrid 4D-EnVar (Lorenc et al.
/// 2015), linearized about a control v₀:
///
/// ```text
///     J(v)   = ½‖v‖² + ½‖d₀ − G (v − v₀)‖²,    d₀ = R^{-1/2} (y − H(M(z₀))),
///     z₀ = z_b + U v₀
///     G      = R^{-1/2} [β_s H' P U_s,  β_e Y_i ∘ ρ_j],    v = [v_s, v_e]
///     Y_i    = (H(M(z₀ + ε √(N−1) x_i)) − mean) / (ε √(N−1)),
///     ρ_j = localization root c_j at the observations
/// ```
///
/// Every member x_i of the [`Ensemble`] is one forward run about z₀; no tangent or adjoint of the model is
/// called, and the increments of the ensemble part evolve with the model through the window. U is the root of
/// the covariance, an `Ensemble` (β_e = 1) or a [`Hybrid`]; ε is `spread`: 1 uses the members themselves
/// (the transform), a small one differences about z₀ (the bundle).
///
/// **Localization** multiplies the four-dimensional cross covariances between the control and the predictions
/// in space only: C between the component of the control an observation is anchored at and the others, the
/// same at every time of the window. It is exact where an observation sees one place (and equal to the Schur
/// product in state space for a linear H at step 0), and wrong where errors travel farther than its support
/// within the window.
///
/// **The static part** of a hybrid has no model behind it: its increments persist through the window (P: x_k'
/// = x₀' for all k) as in 3D-FGAT and in Lorenc et al. 2015, and are seen through the tangent of the
/// observation operator alone. So β_e = 0 is 3D-FGAT, not strong 4D-Var; a hybrid B whose static part should
/// evolve is a [`Hybrid`] in [`StrongConstraint`](crate::StrongConstraint).
///
/// A linear problem with an ensemble that spans the range of B needs one solve and gives strong 4D-Var. For a
/// nonlinear one [`relinearize`](Self::relinearize), or let [`minimize`](Self::minimize) do it: the iterative
/// ensemble smoother of Bocquet and Sakov (2014).
///
/// When to use: no tangent or adjoint at hand, or a B that should follow the flow (in cycles). When not: N
/// far below the number of growing directions without localization; localization over windows in which errors
/// travel farther than its support.
///
/// Cost of a linearization: N + 1 forward runs, in parallel with the feature `rayon` (on by default), the
/// same bits for any number of threads. Products with G are arithmetic on what they leave, and count as no
/// sweeps; an exact solve is an eigenvalue problem of size min(m, N r + r_s), r the rank of the
/// localization's root and r_s that of the static part, and allocates its matrices. Memory: the trajectories
/// of all members up to the last observation, and twice m (N + r_s) numbers.
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// use varda_covariance::{Ensemble, Localization};
/// use varda_implicit::{Model, Rk4, lorenz::Lorenz63};
///
/// // Four members about (1.5, 1.7, 20), one after the other.
/// let members = [2.5, 1.2, 20.0, 0.5, 2.2, 20.0, 1.5, 1.2, 21.0, 1.5, 2.2, 19.0];
/// let ensemble = Ensemble::new(&members, Localization::none(3))?;
/// let make = || -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz63::default(), 0, 0.01)) };
/// let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// let mut observations = ObservationSet::new(20, vec![Box::new(Selection::new(vec![0, 1, 2], 3)?)], seen)?;
/// let background = ensemble.mean().to_vec();
/// let mut cost = EnVar::new(&make, background, &ensemble, &mut observations, &[])?;
/// let mut v = vec![0.0; cost.dim()];
/// let minimum = cost.minimize(&mut v, &EnVarOptions::default(), &mut |_| ControlFlow::Continue(()))?;
/// assert!(minimum.value < cost.nonlinear_value(&vec![0.0; v.len()])?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct EnVar<'a> {
    /// The first runs the control, the others a member each.
    models: Vec<Box<dyn Model + Send + 'a>>,
    /// Work of all models, and what their steps went through.
    log: Log,
    transform: ControlTransform<'a>,
    ensemble: &'a Ensemble,
    ensemble_weight: f64,
    static_part: Option<(&'a dyn Covariance, f64)>,
    observations: &'a mut ObservationSet,
    /// The component of the control whose localization holds for an observed row.
    anchors: Vec<usize>,
    spread: f64,
    scale: f64,
    last: usize,
    state_dim: usize,
    centred: bool,
    base: Base,
    next: Base,
    /// Controls and trajectories of all runs.
    controls: Vec<f64>,
    states: Vec<f64>,
    predicted: Prediction,
    dv: Vec<f64>,
    dy: Vec<f64>,
    terms: CostTerms,
    counts: Counts,
}

/// A linearization, at the true σ. Rows of Y and G_s with independent errors are over their σ; correlated
/// blocks of R^{-1/2} come after the localization of the rows: they mix rows of several places, and each is
/// localized about its own.
#[derive(Clone)]
struct Base {
    v: Vec<f64>,
    /// d₀, whitened.
    d: Vec<f64>,
    /// Y, m rows of N.
    y: Vec<f64>,
    /// H' P U_s without its weight, m rows of r_s.
    g_static: Vec<f64>,
}

impl<'a> EnVar<'a> {
    /// 4D-EnVar with the covariance of the ensemble, linearized about the background z_b by N + 1 forward
    /// runs of models made by `make_model`. `anchors[a]` is the component of the control at whose place the
    /// stacked row a was measured; without localization it is not asked for and may be empty. The mean of the
    /// ensemble is not used: pass it as the background.
    ///
    /// # Errors
    /// Lengths that disagree, an anchor the control does not have; the first failure of the model or of an
    /// operator, in the order control, member 1 … N.
    pub fn new<'m: 'a>(
        make_model: &dyn Fn() -> Box<dyn Model + Send + 'm>,
        background: Vec<f64>,
        ensemble: &'a Ensemble,
        observations: &'a mut ObservationSet,
        anchors: &[usize],
    ) -> Result<Self, Error> {
        Self::over(make_model, background, ensemble, observations, anchors, 1.0)
    }

    /// The same, linearized from the start by differences over a part of the members' deviations.
    pub(crate) fn over<'m: 'a>(
        make_model: &dyn Fn() -> Box<dyn Model + Send + 'm>,
        background: Vec<f64>,
        ensemble: &'a Ensemble,
        observations: &'a mut ObservationSet,
        anchors: &[usize],
        spread: f64,
    ) -> Result<Self, Error> {
        let transform = ControlTransform::new(background, ensemble)?;
        Self::with(make_model, transform, (ensemble, 1.0), None, observations, anchors, spread)
    }

    /// Hybrid 4D-EnVar, as [`new`](Self::new) otherwise.
    ///
    /// # Errors
    /// As for [`new`](Self::new).
    pub fn hybrid<'m: 'a>(
        make_model: &dyn Fn() -> Box<dyn Model + Send + 'm>,
        background: Vec<f64>,
        hybrid: &'a Hybrid<'a>,
        observations: &'a mut ObservationSet,
        anchors: &[usize],
    ) -> Result<Self, Error> {
        Self::hybrid_over(make_model, background, hybrid, observations, anchors, 1.0)
    }

    /// The same, linearized from the start by differences over a part of the members' deviations.
    pub(crate) fn hybrid_over<'m: 'a>(
        make_model: &dyn Fn() -> Box<dyn Model + Send + 'm>,
        background: Vec<f64>,
        hybrid: &'a Hybrid<'a>,
        observations: &'a mut ObservationSet,
        anchors: &[usize],
        spread: f64,
    ) -> Result<Self, Error> {
        let transform = ControlTransform::new(background, hybrid)?;
        let static_part = Some((hybrid.static_part(), hybrid.static_weight()));
        let weighted = (hybrid.ensemble(), hybrid.ensemble_weight());
        Self::with(make_model, transform, weighted, static_part, observations, anchors, spread)
    }

    fn with<'m: 'a>(
        make_model: &dyn Fn() -> Box<dyn Model + Send + 'm>,
        transform: ControlTransform<'a>,
        (ensemble, ensemble_weight): (&'a Ensemble, f64),
        static_part: Option<(&'a dyn Covariance, f64)>,
        observations: &'a mut ObservationSet,
        anchors: &[usize],
        spread: f64,
    ) -> Result<Self, Error> {
        let mut models: Vec<Box<dyn Model + Send + 'a>> = Vec::new();
        (0..=ensemble.members()).for_each(|_| models.push(make_model()));
        let (n, n_z, m) = (transform.dim(), transform.control_dim(), observations.dim());
        let (state_dim, expected) = (models[0].dim(), models[0].control_dim());
        if expected != n_z {
            return Err(Error::Length { what: "the background", expected, found: n_z });
        }
        observations.check_state(state_dim)?;
        observations.follow(models[0].rate());
        let anchors = if anchors.is_empty() && ensemble.localization().rank() == 1 {
            vec![0; m]
        } else {
            anchors.to_vec()
        };
        if anchors.len() != m {
            return Err(Error::Length { what: "the list of anchors", expected: m, found: anchors.len() });
        }
        if let Some(&anchor) = anchors.iter().find(|a| **a >= n_z) {
            return Err(Error::Setting { what: "an anchor", value: anchor as f64 });
        }
        let last = observations.last_step().unwrap_or(0);
        let (members, r_s) = (ensemble.members(), static_part.map_or(0, |(b, _)| b.root_dim()));
        let base = Base {
            v: vec![0.0; n],
            d: vec![0.0; m],
            y: vec![0.0; m * members],
            g_static: vec![0.0; m * r_s],
        };
        let predicted = observations.prediction();
        let mut cost = Self {
            controls: vec![0.0; (members + 1) * n_z],
            states: vec![0.0; (members + 1) * (last + 1) * state_dim],
            models,
            log: Log::default(),
            centred: is_centred(ensemble, n_z),
            ensemble,
            ensemble_weight,
            static_part,
            observations,
            anchors,
            spread,
            scale: 1.0,
            last,
            state_dim,
            next: base.clone(),
            base,
            predicted,
            dv: vec![0.0; n],
            dy: vec![0.0; m],
            terms: CostTerms::default(),
            counts: Counts::default(),
            transform,
        };
        cost.relinearize(&vec![0.0; n])?;
        Ok(cost)
    }

    /// Sets ε for the linearizations that follow: 1 (the default) or, for differences about the control, say
    /// 1e-4.
    ///
    /// # Panics
    /// If ε is not positive and finite.
    pub fn set_spread(&mut self, spread: f64) {
        assert!(spread > 0.0 && spread.is_finite(), "spread {spread}");
        self.spread = spread;
    }

    /// The control variable transform.
    pub fn transform(&self) -> &ControlTransform<'a> {
        &self.transform
    }

    /// The observations.
    pub fn observations(&self) -> &ObservationSet {
        self.observations
    }

    /// R^{-1/2} (y − H(M(z₀))), stacked.
    pub fn whitened_innovations(&self) -> &[f64] {
        &self.base.d
    }

    /// Runs the control and every member about v and linearizes there. After an error the cost is what it
    /// was.
    ///
    /// # Errors
    /// The first failure of the model or of an operator, in the order control, member 1 … N.
    ///
    /// # Panics
    /// If `v` is not of length `dim`.
    pub fn relinearize(&mut self, v: &[f64]) -> Result<(), Error> {
        assert_eq!(v.len(), self.dim(), "length of v");
        let (n_z, m, members) =
            (self.transform.control_dim(), self.observations.dim(), self.ensemble.members());
        self.next.v.copy_from_slice(v);
        let (z, others) = self.controls.split_at_mut(n_z);
        self.transform.control(v, z);
        let size = self.spread * ((members - 1).max(1) as f64).sqrt();
        for (i, z_i) in others.chunks_exact_mut(n_z).enumerate() {
            self.ensemble.perturbation(i, z_i);
            z_i.iter_mut().zip(&*z).for_each(|(z_i, z)| *z_i = z + size * *z_i);
        }
        self.run(members + 1)?;

        let sigma = self.observations.row_scale().to_vec();
        self.observe(0)?;
        self.observations.innovations(self.predicted.values(), &mut self.next.d);
        self.observations.whiten(&mut self.next.d);
        let control = self.predicted.clone();
        let from = control.values();
        for i in 0..members {
            self.observe(i + 1)?;
            for a in 0..m {
                self.next.y[a * members + i] = (self.predicted.values()[a] - from[a]) / (sigma[a] * size);
            }
        }
        if self.centred {
            for row in self.next.y.chunks_exact_mut(members) {
                let mean = row.iter().sum::<f64>() / members as f64;
                row.iter_mut().for_each(|y| *y -= mean);
            }
        }
        if let Some((b, weight)) = self.static_part
            && weight > 0.0
        {
            let (r_s, n) = (b.root_dim(), self.state_dim);
            let (mut unit, mut dz, mut dx) = (vec![0.0; r_s], vec![0.0; n_z], vec![0.0; n]);
            for j in 0..r_s {
                unit[j] = 1.0;
                b.root(&unit, &mut dz);
                unit[j] = 0.0;
                self.models[0].initial_tangent(&dz, &mut dx);
                self.dy.fill(0.0);
                for k in 0..=self.last {
                    let x = &self.states[k * n..(k + 1) * n];
                    self.observations.persistent_tangent_add(k, x, &dx, &control, &mut self.dy);
                }
                for a in 0..m {
                    self.next.g_static[a * r_s + j] = self.dy[a] / sigma[a];
                }
            }
        }
        let base = &self.next;
        if !base.d.iter().chain(&base.y).chain(&base.g_static).all(|x| x.is_finite()) {
            return Err(Error::NonFinite { what: "the linearized ensemble", step: self.last });
        }
        std::mem::swap(&mut self.base, &mut self.next);
        Ok(())
    }

    /// The true, nonlinear J at v: one forward run of the control.
    ///
    /// # Errors
    /// A failure of the model or of an operator.
    ///
    /// # Panics
    /// If `v` is not of length `dim`.
    pub fn nonlinear_value(&mut self, v: &[f64]) -> Result<f64, Error> {
        Ok(self.nonlinear_terms(v)?.total())
    }

    fn nonlinear_terms(&mut self, v: &[f64]) -> Result<CostTerms, Error> {
        let d = self.nonlinear_departures(v)?;
        Ok(CostTerms { background: 0.5 * dot(v, v), observation: 0.5 * dot(&d, &d), model_error: 0.0 })
    }

    /// R^{-1/2} (y − H(x)) of the run from v: one forward run of the control.
    pub(crate) fn nonlinear_departures(&mut self, v: &[f64]) -> Result<Vec<f64>, Error> {
        let n_z = self.transform.control_dim();
        self.transform.control(v, &mut self.controls[..n_z]);
        self.run(1)?;
        self.observe(0)?;
        let mut d = vec![0.0; self.observations.dim()];
        self.observations.innovations(self.predicted.values(), &mut d);
        self.observations.whiten_blocks(&mut d);
        d.iter_mut().zip(self.observations.row_scale()).for_each(|(d, s)| *d /= self.scale * s);
        Ok(d)
    }

    /// Runs the first `runs` models from their controls through the window.
    fn run(&mut self, runs: usize) -> Result<(), Error> {
        if !self.controls.iter().all(|z| z.is_finite()) {
            return Err(Error::NonFinite { what: "a control of the ensemble", step: 0 });
        }
        self.counts.forward_runs += runs;
        run_all(&mut self.models[..runs], &self.controls, &mut self.states, self.last, &mut self.log)
    }

    /// Predicts the observations of run `run`.
    fn observe(&mut self, run: usize) -> Result<(), Error> {
        let (n, last) = (self.state_dim, self.last);
        let states = &self.states[run * (last + 1) * n..][..(last + 1) * n];
        self.predicted.clear();
        for (k, x) in states.chunks_exact(n).enumerate() {
            self.observations.observe_add(k, x, &mut self.predicted)?;
        }
        Ok(())
    }

    fn static_dim(&self) -> usize {
        self.static_part.map_or(0, |(b, _)| b.root_dim())
    }

    /// dy = G dv.
    fn forward(&self, dv: &[f64], dy: &mut [f64]) {
        let localization = self.ensemble.localization();
        let (members, rank, r_s) = (self.ensemble.members(), localization.rank(), self.static_dim());
        let static_weight = self.static_part.map_or(0.0, |(_, weight)| weight);
        let (v_s, v_e) = dv.split_at(r_s);
        for (a, dy) in dy.iter_mut().enumerate() {
            let rho = localization.row(self.anchors[a]);
            let y = &self.base.y[a * members..][..members];
            let sum: f64 = y.iter().zip(v_e.chunks_exact(rank)).map(|(y, v_i)| y * dot(rho, v_i)).sum();
            let persisted = dot(&self.base.g_static[a * r_s..][..r_s], v_s);
            *dy = (static_weight * persisted + self.ensemble_weight * sum) / self.scale;
        }
        self.observations.whiten_blocks(dy);
    }

    /// dv = Gᵀ dy.
    fn transpose(&self, dy: &[f64], dv: &mut [f64]) {
        let localization = self.ensemble.localization();
        let (members, rank, r_s) = (self.ensemble.members(), localization.rank(), self.static_dim());
        let static_weight = self.static_part.map_or(0.0, |(_, weight)| weight);
        dv.fill(0.0);
        let (v_s, v_e) = dv.split_at_mut(r_s);
        let mut dy = Cow::Borrowed(dy);
        if self.observations.is_correlated() {
            self.observations.whiten_blocks_transpose(dy.to_mut());
        }
        for (a, dy) in dy.iter().enumerate() {
            let rho = localization.row(self.anchors[a]);
            let y = &self.base.y[a * members..][..members];
            let (w_s, w_e) = (static_weight * dy / self.scale, self.ensemble_weight * dy / self.scale);
            v_s.iter_mut().zip(&self.base.g_static[a * r_s..]).for_each(|(v, g)| *v += w_s * g);
            for (y, v_i) in y.iter().zip(v_e.chunks_exact_mut(rank)) {
                v_i.iter_mut().zip(rho).for_each(|(v, c)| *v += w_e * y * c);
            }
        }
    }

    /// G, dense, by columns: R^{-1/2} [β_s G_s, β_e diag(Y_i) ρ for every member i]/σ-scale, without a
    /// product.
    pub(super) fn jacobian(&self) -> Vec<f64> {
        let (n, m) = (self.dim(), self.observations.dim());
        let localization = self.ensemble.localization();
        let (members, rank, r_s) = (self.ensemble.members(), localization.rank(), self.static_dim());
        let w_s = self.static_part.map_or(0.0, |(_, weight)| weight) / self.scale;
        let w_e = self.ensemble_weight / self.scale;
        let mut jacobian = vec![0.0; m * n];
        for (j, column) in jacobian.chunks_exact_mut(m.max(1)).enumerate() {
            if j < r_s {
                column.iter_mut().enumerate().for_each(|(a, g)| *g = w_s * self.base.g_static[a * r_s + j]);
            } else {
                let (i, c) = ((j - r_s) / rank, (j - r_s) % rank);
                for (a, g) in column.iter_mut().enumerate() {
                    *g = w_e * self.base.y[a * members + i] * localization.row(self.anchors[a])[c];
                }
            }
            self.observations.whiten_blocks(column);
        }
        jacobian
    }

    /// GᵀG, dense, n × n.
    fn normal_matrix(&self, out: &mut [f64]) {
        let (n, m) = (self.dim(), self.observations.dim());
        let jacobian = self.jacobian();
        let g = View::new(&jacobian, m, n);
        product(g.transpose(), g, out);
    }
}

/// Whether the columns of X sum to zero.
fn is_centred(ensemble: &Ensemble, n: usize) -> bool {
    let (mut sum, mut size, mut column) = (vec![0.0; n], 0.0_f64, vec![0.0; n]);
    for i in 0..ensemble.members() {
        ensemble.perturbation(i, &mut column);
        sum.iter_mut().zip(&column).for_each(|(s, x)| *s += x);
        size = column.iter().fold(size, |m, x| m.max(x.abs()));
    }
    sum.iter().all(|s| s.abs() <= 1e-10 * size * ensemble.members() as f64)
}

impl CostFunction for EnVar<'_> {
    fn dim(&self) -> usize {
        self.transform.dim()
    }

    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        assert_eq!(v.len(), self.dim(), "length of v");
        let (mut dv, mut dy) = (std::mem::take(&mut self.dv), std::mem::take(&mut self.dy));
        dv.iter_mut().zip(v.iter().zip(&self.base.v)).for_each(|(dv, (v, v0))| *dv = v - v0);
        self.forward(&dv, &mut dy);
        dy.iter_mut().zip(&self.base.d).for_each(|(dy, d)| *dy -= d / self.scale);
        (self.dv, self.dy) = (dv, dy);
        let terms = CostTerms {
            background: 0.5 * dot(v, v),
            observation: 0.5 * dot(&self.dy, &self.dy),
            model_error: 0.0,
        };
        if !terms.total().is_finite() {
            return Err(Error::NonFinite { what: "the cost", step: self.last });
        }
        if let Some(gradient) = gradient {
            assert_eq!(gradient.len(), self.dim(), "length of the gradient");
            self.counts.gradients += 1;
            self.transpose(&self.dy, gradient);
            gradient.iter_mut().zip(v).for_each(|(g, v)| *g += v);
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

    /// The work of the models is summed over the control and the members.
    fn counts(&self) -> Counts {
        Counts { model: self.log.counts, ..self.counts }
    }
}

impl LeastSquares for EnVar<'_> {
    fn background_dim(&self) -> usize {
        self.dim()
    }

    fn observation_dim(&self) -> usize {
        self.observations.dim()
    }

    /// v and d₀ − G (v − v₀) of the last evaluation.
    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        b.iter_mut().zip(self.base.v.iter().zip(&self.dv)).for_each(|(b, (v, dv))| *b = v + dv);
        self.forward(&self.dv, d);
        d.iter_mut().zip(&self.base.d).for_each(|(d, d0)| *d = d0 / self.scale - *d);
    }

    fn jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        assert!(dv.len() == self.dim() && dy.len() == self.observation_dim(), "lengths of dv and dy");
        self.forward(dv, dy);
        Ok(())
    }

    fn jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        assert!(dv.len() == self.dim() && dy.len() == self.observation_dim(), "lengths of dv and dy");
        self.transpose(dy, dv);
        Ok(())
    }

    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        assert!(dv.len() == self.dim() && out.len() == self.dim(), "lengths of dv and out");
        let mut dy = std::mem::take(&mut self.dy);
        self.forward(dv, &mut dy);
        self.transpose(&dy, out);
        self.dy = dy;
        out.iter_mut().zip(dv).for_each(|(out, dv)| *out += dv);
        Ok(())
    }

    fn dense_jacobian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        out.copy_from_slice(&EnVar::jacobian(self));
        Ok(())
    }

    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let n = self.dim();
        assert_eq!(out.len(), n * n, "length of the Hessian");
        self.normal_matrix(out);
        for j in 0..n {
            out[j + j * n] += 1.0;
            for i in 0..j {
                out[j + i * n] = out[i + j * n];
            }
        }
        Ok(())
    }
}
