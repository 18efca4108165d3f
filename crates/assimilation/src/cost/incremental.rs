//! Incremental forms: a cost around an outer iterate, and its quadratic inner cost.

use super::{CostFunction, CostTerms, Counts, LeastSquares, dot};
use crate::Error;

/// The quadratic inner cost q(p) of [`LeastSquares`] around the outer iterate last linearized, as a cost
/// function of its own (paper 2.10, 2.19 with d = y − H(x_b); gradient: paper 2.20; Courtier, Thépaut and
/// Hollingsworth 1994): any minimizer can be run on it.
///
/// q(0) = J at the outer iterate, ∇q(0) = ∇J there, and where model and observations are linear q(p) =
/// J(v + p) everywhere.
///
/// When to use: to give the inner problem to a minimizer of one's own. When not:
/// [`outer_loop`](crate::outer_loop) solves it by conjugate gradients already. Cost: a tangent sweep for a
/// value, an adjoint sweep more for a gradient, no model step. Memory: n + 2m beside the problem's.
pub struct InnerCost<'a> {
    outer: &'a mut (dyn LeastSquares + 'a),
    b: Vec<f64>,
    d: Vec<f64>,
    /// The last increment evaluated, and G p − d there.
    p: Vec<f64>,
    misfit: Vec<f64>,
    dy: Vec<f64>,
    terms: CostTerms,
}

impl<'a> InnerCost<'a> {
    /// Around the outer iterate of `outer`.
    ///
    /// # Panics
    /// If nothing has been linearized.
    pub fn new(outer: &'a mut (dyn LeastSquares + 'a)) -> Self {
        let (mut b, mut d) = (vec![0.0; outer.dim()], vec![0.0; outer.observation_dim()]);
        outer.departures(&mut b, &mut d);
        let (p, misfit) = (vec![0.0; b.len()], d.iter().map(|d| -d).collect());
        Self { p, misfit, dy: vec![0.0; d.len()], outer, b, d, terms: CostTerms::default() }
    }
}

impl CostFunction for InnerCost<'_> {
    fn dim(&self) -> usize {
        self.b.len()
    }

    fn evaluate(&mut self, p: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        self.outer.jacobian(p, &mut self.dy)?;
        self.dy.iter_mut().zip(&self.d).for_each(|(dy, d)| *dy -= d);
        let half = |range: std::ops::Range<usize>| {
            range.fold(0.0, |sum, i| sum + 0.5 * (self.b[i] + p[i]) * (self.b[i] + p[i]))
        };
        let split = self.outer.background_dim();
        let terms = CostTerms {
            background: half(0..split),
            observation: 0.5 * dot(&self.dy, &self.dy),
            model_error: half(split..p.len()),
        };
        if !terms.total().is_finite() {
            return Err(Error::NonFinite { what: "the inner cost", step: 0 });
        }
        if let Some(gradient) = gradient {
            self.outer.jacobian_transpose(&self.dy, gradient)?;
            gradient.iter_mut().zip(self.b.iter().zip(p)).for_each(|(g, (b, p))| *g += b + p);
        }
        self.p.copy_from_slice(p);
        self.misfit.copy_from_slice(&self.dy);
        self.terms = terms;
        Ok(terms.total())
    }

    fn terms(&self) -> CostTerms {
        self.terms
    }

    fn set_observation_scale(&mut self, scale: f64) {
        self.outer.set_observation_scale(scale);
        self.outer.departures(&mut self.b, &mut self.d);
    }

    fn counts(&self) -> Counts {
        self.outer.counts()
    }
}

impl LeastSquares for InnerCost<'_> {
    fn observation_dim(&self) -> usize {
        self.d.len()
    }

    /// Of q around p, with the same G: b + p and d − G p.
    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        b.iter_mut().zip(self.b.iter().zip(&self.p)).for_each(|(out, (b, p))| *out = b + p);
        d.iter_mut().zip(&self.misfit).for_each(|(d, misfit)| *d = -misfit);
    }

    fn background_dim(&self) -> usize {
        self.outer.background_dim()
    }

    fn jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.outer.jacobian(dv, dy)
    }

    fn jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        self.outer.jacobian_transpose(dy, dv)
    }

    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.outer.jacobian(dv, &mut self.dy)?;
        self.outer.jacobian_transpose(&self.dy, out)?;
        out.iter_mut().zip(dv).for_each(|(out, dv)| *out += dv);
        Ok(())
    }
}
