//! Weak-constraint 4D-Var over all states.

use super::least_squares::direct_by_columns;
use super::model_error::{ModelErrorTerm, WeakControl};
use super::{CostFunction, CostTerms, Counts, Forcing, LeastSquares, StrongConstraint};
use crate::{ControlTransform, Error, ObservationSet};
use varda_covariance::Precision;
use varda_implicit::Model;

/// Weak-constraint 4D-Var over all states (paper 4.1 with squares; Trémolet 2006; preconditioned as in
/// Fisher and Gürol 2017):
///
/// ```text
///     J(z, ξ_1 … ξ_N) = ½‖z − z_b‖²_{B⁻¹}
///                       + ½ Σ_j ‖ξ_j − Eᵀ M(x_{j−1})‖²_{Q⁻¹}
///                       + ½ Σ_k ‖y_k − H_k(x_k)‖²_{R_k⁻¹}
/// ```
///
/// The control is z and ξ_j, the forced components of the state at the end of every sub-window, in their own
/// units; components that are not forced follow the model. Both B⁻¹ and Q⁻¹ are needed ([`Precision`]).
///
/// The Hessian in the states is badly conditioned (a discrete second derivative in time, over Q), so
/// increments are solved for in p = D^{-1/2} L δx, D = diag(B, Q, Q …), L the model's tangent as a
/// bidiagonal matrix: there it is I + GᵀG, the same as in [`WeakForcing`](super::WeakForcing), and δx =
/// L⁻¹ D^{1/2} p is one tangent sweep. Minimize with [`outer_loop`](crate::outer_loop), which works in p
/// (`InnerSolver::Direct` is a block-tridiagonal solve, as a reference for small problems, or a dense one
/// where errors of observations are tied along chains). The gradient of
/// [`CostFunction::evaluate`] is that in the states, for other minimizers.
///
/// When to use: long windows, where a start from states near the observations avoids the minima that a
/// chaotic model puts into the forcing form; linear problems give the same analysis by both. When not: Q →
/// 0 (then Q⁻¹ blows up), singular B or Q.
///
/// Cost: as [`WeakForcing`](super::WeakForcing), and a tangent sweep for the increment of an outer iteration;
/// the direct solve n tangent sweeps and N Cholesky factors of size n. Memory: N n for the control, three
/// times that for the trajectories.
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
/// let mut observations = ObservationSet::new(20, vec![Box::new(Selection::new(vec![0, 1, 2], 3)?)], seen)?;
/// // B, and an error of 0.2 in every component after each ten steps
/// let (b, q) = (Diagonal::uniform(3, 1.0)?, Diagonal::uniform(3, 0.2)?);
/// let forcing = Forcing { steps: 10, ..Forcing::every_step(3) };
/// let background = vec![1.5, 1.7, 20.0];
/// let mut cost = WeakState::new(&mut model, background, &b, &q, forcing, &mut observations)?;
/// let mut v = cost.background()?; // x₀ and the states at steps 10 and 20
/// let options = OuterLoopOptions::default();
/// let minimum = outer_loop(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(()))?;
/// assert_eq!(minimum.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct WeakState<'a> {
    window: StrongConstraint<'a>,
    b: &'a dyn Precision,
    q: &'a dyn Precision,
    /// The gradient in p.
    p: Vec<f64>,
    physical: Vec<f64>,
}

impl<'a> WeakState<'a> {
    /// The cost of the window of `observations` with background z_b, its covariance B, and model errors of
    /// covariance `q`, entering at the ends of sub-windows.
    ///
    /// # Errors
    /// As for [`WeakForcing::new`](super::WeakForcing::new); a held forcing, which states do not determine.
    pub fn new(
        model: &'a mut (dyn Model + 'a),
        background: Vec<f64>,
        b: &'a dyn Precision,
        q: &'a dyn Precision,
        forcing: Forcing,
        observations: &'a mut ObservationSet,
    ) -> Result<Self, Error> {
        if forcing.held && forcing.steps > 1 {
            return Err(Error::Setting {
                what: "the steps of a held forcing over states",
                value: forcing.steps as f64,
            });
        }
        for (what, c) in [("the square root of B", b), ("the square root of Q", q)] {
            if c.root_dim() != c.dim() {
                return Err(Error::Length { what, expected: c.dim(), found: c.root_dim() });
            }
        }
        let last = observations.last_step().unwrap_or(0);
        let errors = ModelErrorTerm::new(forcing, WeakControl::States { b, q }, model.dim(), last)?;
        let transform = ControlTransform::new(background, b)?;
        let window = StrongConstraint::weak(model, transform, observations, errors)?;
        let physical = vec![0.0; b.dim().max(q.dim())];
        Ok(Self { p: vec![0.0; window.dim()], window, b, q, physical })
    }

    /// The control of the background: z_b and the states it leads to.
    ///
    /// # Errors
    /// A step that fails.
    pub fn background(&mut self) -> Result<Vec<f64>, Error> {
        let mut v = self.window.transform.background().to_vec();
        let Some(model) = &mut self.window.model else { unreachable!() };
        let Some(errors) = &self.window.errors else { unreachable!() };
        let (mut x, mut x_next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        self.window.base.initial = false;
        self.window.trial.initial = false;
        model.initial_state(&v, &mut x)?;
        for k in 0..self.window.last {
            self.window.log.step(k, model.step(k, &x, &mut x_next)?);
            std::mem::swap(&mut x, &mut x_next);
            if errors.index(k).is_some() {
                v.extend(errors.forcing().components.iter().map(|&c| x[c]));
            }
        }
        Ok(v)
    }

    /// The control of a first guess: z, and the forced components of what `state(k, x)` fills in for step k
    /// at every end of a sub-window.
    ///
    /// # Panics
    /// If z has the wrong length.
    pub fn control(&self, z: &[f64], state: &mut dyn FnMut(usize, &mut [f64])) -> Vec<f64> {
        assert_eq!(z.len(), self.window.transform.control_dim(), "length of z");
        let Some(errors) = &self.window.errors else { unreachable!() };
        let (mut v, mut x) = (z.to_vec(), vec![0.0; self.window.state_dim]);
        for k in (0..self.window.last).filter(|&k| errors.index(k).is_some()) {
            state(k + 1, &mut x);
            v.extend(errors.forcing().components.iter().map(|&c| x[c]));
        }
        v
    }

    /// State x_k of the point of the last gradient, k = 0 … the last observed step.
    ///
    /// # Panics
    /// If no gradient has been evaluated, or that step was not run.
    pub fn state(&self, k: usize) -> &[f64] {
        self.window.state(k)
    }

    /// Predictions H(x) at the point of the last gradient, stacked.
    ///
    /// # Panics
    /// If no gradient has been evaluated.
    pub fn predicted(&self) -> &[f64] {
        self.window.predicted()
    }

    /// What the model did for this cost, and what its steps went through.
    pub fn log(&self) -> varda_implicit::Log {
        self.window.log()
    }

    /// From a gradient in p to one in the states: (D^{-1/2} L)ᵀ, one adjoint sweep without observations.
    fn state_gradient(&mut self, gradient: &mut [f64]) -> Result<(), Error> {
        self.window.return_to_base()?;
        self.window.counts.adjoint_sweeps += 1;
        let Self { window, b, q, p, physical } = self;
        let StrongConstraint {
            model: Some(model),
            errors: Some(errors),
            base,
            lambda,
            dz,
            last,
            transform,
            ..
        } = window
        else {
            unreachable!()
        };
        let (head, n) = (transform.dim(), q.dim());
        lambda.fill(0.0);
        for k in (0..*last).rev() {
            if let Some(j) = errors.index(k) {
                let range = head + j * n..head + (j + 1) * n;
                // s = Q^{-1/2}ᵀ p_j = Q⁻¹ Q^{1/2} p_j.
                q.root(&p[range.clone()], &mut physical[..n]);
                let out = &mut gradient[range];
                q.solve(&physical[..n], out);
                for (out, &c) in out.iter_mut().zip(&errors.forcing().components) {
                    let s = *out;
                    *out += lambda[c];
                    lambda[c] = -s;
                }
            }
            base.trajectory.adjoint_of_step(&mut **model, k, lambda);
        }
        model.initial_adjoint(lambda, dz);
        b.root(&p[..head], &mut physical[..head]);
        b.solve(&physical[..head], &mut gradient[..head]);
        gradient[..head].iter_mut().zip(dz).for_each(|(g, dz)| *g += *dz);
        Ok(())
    }
}

impl CostFunction for WeakState<'_> {
    fn dim(&self) -> usize {
        self.window.dim()
    }

    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        let Some(gradient) = gradient else { return self.window.evaluate(v, None) };
        assert_eq!(gradient.len(), self.dim(), "length of the gradient");
        let value = self.window.evaluate(v, Some(&mut self.p))?;
        self.state_gradient(gradient)?;
        if !gradient.iter().all(|g| g.is_finite()) {
            return Err(Error::NonFinite { what: "the gradient", step: 0 });
        }
        Ok(value)
    }

    fn terms(&self) -> CostTerms {
        self.window.terms()
    }

    fn set_observation_scale(&mut self, scale: f64) {
        self.window.set_observation_scale(scale);
    }

    fn counts(&self) -> Counts {
        self.window.counts()
    }

    /// v is made of states.
    fn is_whitened(&self) -> bool {
        false
    }
}

impl LeastSquares for WeakState<'_> {
    fn linearize(&mut self, v: &[f64], gradient: &mut [f64]) -> Result<f64, Error> {
        self.window.evaluate(v, Some(gradient))
    }

    fn observation_dim(&self) -> usize {
        self.window.observation_dim()
    }

    fn background_dim(&self) -> usize {
        self.window.background_dim()
    }

    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        self.window.departures(b, d);
    }

    fn jacobian(&mut self, p: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.window.jacobian(p, dy)
    }

    fn jacobian_transpose(&mut self, dy: &[f64], p: &mut [f64]) -> Result<(), Error> {
        self.window.jacobian_transpose(dy, p)
    }

    fn hessian_apply(&mut self, p: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.window.hessian_apply(p, out)
    }

    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        self.window.hessian(out)
    }

    /// δx = L⁻¹ D^{1/2} p: one tangent sweep without observations.
    fn increment(&mut self, p: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        self.window.return_to_base()?;
        self.window.counts.tangent_sweeps += 1;
        let StrongConstraint {
            model: Some(model), errors: Some(errors), base, lambda, last, transform, ..
        } = &mut self.window
        else {
            unreachable!()
        };
        let (first, rest) = p.split_at(transform.dim());
        let (dz, states) = dv.split_at_mut(transform.dim());
        transform.tangent(first, dz);
        model.initial_tangent(dz, lambda);
        for k in 0..*last {
            base.trajectory.tangent_of_step(&mut **model, k, lambda);
            errors.tangent_add(k, rest, lambda);
            if let Some(j) = errors.index(k) {
                let n = errors.block();
                for (dv, &c) in states[j * n..(j + 1) * n].iter_mut().zip(&errors.forcing().components) {
                    *dv = lambda[c];
                }
            }
        }
        Ok(())
    }

    /// By block-tridiagonal Cholesky, where every component of the state must be forced; from the columns of
    /// G where errors of observations are tied from one time to another.
    fn direct(&mut self, gradient: &[f64], p: &mut [f64]) -> Result<(), Error> {
        if self.window.observations.observations().iter().any(|o| o.chain.is_some()) {
            let (n, m) = (self.dim(), self.observation_dim());
            let window = &mut self.window;
            return direct_by_columns(n, m, &mut |unit, column| window.jacobian(unit, column), gradient, p);
        }
        super::tridiagonal::solve(&mut self.window, self.q, gradient, p)
    }
}
