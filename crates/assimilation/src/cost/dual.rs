//! The dual cost in observation space: PSAS, and 4D-PSAS with a model.

use super::{CostFunction, CostTerms, Counts, LeastSquares, dot};
use crate::Error;

/// The dual of the inner cost around an outer iterate (paper 2.12, 2.13; Courtier 1997), whitened by R:
///
/// ```text
///     J̃(w)  = ½ wᵀ (I + G Gᵀ) w − wᵀ (d + G b),    G Gᵀ = R^{-1/2} H B Hᵀ R^{-1/2}
///     ∇J̃(w) = (I + G Gᵀ) w − (d + G b),            p = Gᵀ w − b
/// ```
///
/// with the paper's w being R^{-1/2} w here. Through the same tangent and adjoint sweeps as the primal, over
/// m unknowns instead of n; B enters by its products only, and has no inverse anywhere. At the minimum J̃ =
/// −q(p), p the primal's.
///
/// When to use: far fewer observations than unknowns, solved to the end. When not: stopped early, p may have
/// raised the primal cost, since a minimizer of J̃ knows nothing of q.
/// [`restricted_conjugate_gradients`](crate::restricted_conjugate_gradients) has the dual's cost and the
/// primal's iterates, and is what [`outer_loop`](crate::outer_loop) uses.
///
/// Cost: an adjoint sweep for a value, a tangent sweep more for a gradient; one of each for a product.
/// Memory: 2m + 2n beside the problem's.
pub struct Dual<'a> {
    outer: &'a mut (dyn LeastSquares + 'a),
    b: Vec<f64>,
    /// d + G b.
    right: Vec<f64>,
    dy: Vec<f64>,
    /// The last w evaluated, and Gᵀ w.
    w: Vec<f64>,
    adjoint: Vec<f64>,
    p: Vec<f64>,
    stale: bool,
    terms: CostTerms,
}

impl<'a> Dual<'a> {
    /// Around the outer iterate of `outer`.
    ///
    /// # Errors
    /// Products that fail.
    ///
    /// # Panics
    /// If nothing has been linearized.
    pub fn new(outer: &'a mut (dyn LeastSquares + 'a)) -> Result<Self, Error> {
        let (n, m) = (outer.dim(), outer.observation_dim());
        let mut dual = Self {
            outer,
            b: vec![0.0; n],
            right: vec![0.0; m],
            dy: vec![0.0; m],
            w: vec![0.0; m],
            adjoint: vec![0.0; n],
            p: vec![0.0; n],
            stale: true,
            terms: CostTerms::default(),
        };
        dual.refresh()?;
        Ok(dual)
    }

    /// p = Gᵀ w − b, the primal increment of w.
    ///
    /// # Errors
    /// Products that fail.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn increment(&mut self, w: &[f64], p: &mut [f64]) -> Result<(), Error> {
        self.outer.jacobian_transpose(w, p)?;
        p.iter_mut().zip(&self.b).for_each(|(p, b)| *p -= b);
        Ok(())
    }

    fn refresh(&mut self) -> Result<(), Error> {
        if self.stale {
            self.outer.departures(&mut self.b, &mut self.right);
            self.outer.jacobian(&self.b, &mut self.dy)?;
            self.right.iter_mut().zip(&self.dy).for_each(|(r, dy)| *r += dy);
            self.stale = false;
        }
        Ok(())
    }
}

impl CostFunction for Dual<'_> {
    fn dim(&self) -> usize {
        self.right.len()
    }

    fn evaluate(&mut self, w: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        self.refresh()?;
        self.outer.jacobian_transpose(w, &mut self.p)?;
        let terms = CostTerms {
            background: 0.5 * dot(&self.p, &self.p),
            observation: w.iter().zip(&self.right).map(|(w, r)| w * (0.5 * w - r)).sum(),
            model_error: 0.0,
        };
        if !terms.total().is_finite() {
            return Err(Error::NonFinite { what: "the dual cost", step: 0 });
        }
        if let Some(gradient) = gradient {
            self.outer.jacobian(&self.p, gradient)?;
            gradient.iter_mut().zip(w.iter().zip(&self.right)).for_each(|(g, (w, r))| *g += w - r);
        }
        self.w.copy_from_slice(w);
        self.adjoint.copy_from_slice(&self.p);
        self.terms = terms;
        Ok(terms.total())
    }

    /// ½‖Gᵀw‖² under `background`, the rest under `observation`.
    fn terms(&self) -> CostTerms {
        self.terms
    }

    fn set_observation_scale(&mut self, scale: f64) {
        self.outer.set_observation_scale(scale);
        self.stale = true;
    }

    fn counts(&self) -> Counts {
        self.outer.counts()
    }
}

/// Primal and dual with their parts exchanged: the Hessian is I + G Gᵀ, its "Jacobian" Gᵀ.
impl LeastSquares for Dual<'_> {
    fn background_dim(&self) -> usize {
        self.dim()
    }

    fn observation_dim(&self) -> usize {
        self.b.len()
    }

    /// w − (d + G b) and −Gᵀ w: half the sum of their squares is J̃ and a constant.
    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        b.iter_mut().zip(self.w.iter().zip(&self.right)).for_each(|(b, (w, right))| *b = w - right);
        d.iter_mut().zip(&self.adjoint).for_each(|(d, p)| *d = -p);
    }

    fn jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.outer.jacobian_transpose(dv, dy)
    }

    fn jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        self.outer.jacobian(dy, dv)
    }

    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.outer.jacobian_transpose(dv, &mut self.p)?;
        self.outer.jacobian(&self.p, out)?;
        out.iter_mut().zip(dv).for_each(|(out, dv)| *out += dv);
        Ok(())
    }
}
