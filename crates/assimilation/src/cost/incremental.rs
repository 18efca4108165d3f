//! Incremental forms: a cost around an outer iterate, and its quadratic inner cost.

use super::{CostFunction, CostTerms, Counts, GaussNewton, dot};
use crate::Error;
use varda_linalg::dense::{Cholesky, View, product};

/// A cost that can be linearized around an outer iterate v, where it becomes a quadratic of an increment p:
///
/// ```text
///     q(p) = ½‖b + p‖² + ½‖G p − d‖²,    ∇q(0) = b − Gᵀd,    ∇²q = A = I + GᵀG
/// ```
///
/// b is the whitened departure of v from what is known before it was observed (v itself where v = B^{-1/2}(z
/// − z_b): the background term is about z_b, not about the iterate), d = R^{-1/2}(y − H(x)), and G =
/// R^{-1/2} H M B^{1/2} (paper 2.10, 2.19 with the sign of 2.10). What incremental, dual and closed-form
/// methods have in common: they see a problem through this trait only.
///
/// p is whitened (its norm is that of the prior); the increment of v that belongs to it is `increment(p)`,
/// which is p itself unless the cost is over states.
pub trait Incremental: CostFunction {
    /// Makes v the outer iterate: returns J(v) and ∇q(0), from one forward run and one adjoint sweep.
    ///
    /// # Errors
    /// As for [`CostFunction::evaluate`].
    ///
    /// # Panics
    /// If a slice is not of length `dim`.
    fn linearize(&mut self, v: &[f64], gradient: &mut [f64]) -> Result<f64, Error>;

    /// m, the length of d.
    fn departure_dim(&self) -> usize;

    /// How many leading entries of b belong to the background; the rest is model error.
    fn background_dim(&self) -> usize {
        self.dim()
    }

    /// b and d at the outer iterate.
    ///
    /// # Panics
    /// If nothing has been linearized, or a slice has the wrong length.
    fn departures(&self, b: &mut [f64], d: &mut [f64]);

    /// dy = G p: one tangent sweep.
    ///
    /// # Errors
    /// A model that cannot return to the outer iterate.
    ///
    /// # Panics
    /// If nothing has been linearized, or a slice has the wrong length.
    fn tangent(&mut self, p: &[f64], dy: &mut [f64]) -> Result<(), Error>;

    /// p = Gᵀ dy: one adjoint sweep.
    ///
    /// # Errors
    /// As for `tangent`.
    ///
    /// # Panics
    /// As for `tangent`.
    fn adjoint(&mut self, dy: &[f64], p: &mut [f64]) -> Result<(), Error>;

    /// dv, the increment of v that belongs to p.
    ///
    /// # Errors
    /// As for `tangent`.
    ///
    /// # Panics
    /// As for `tangent`.
    fn increment(&mut self, p: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        dv.copy_from_slice(p);
        Ok(())
    }

    /// p = −A⁻¹ ∇q(0) by a direct method, for small problems and as a reference: A formed by n tangent
    /// sweeps, then Cholesky.
    ///
    /// # Errors
    /// As for `tangent`; [`Error::NotPositiveDefinite`] where the factorization fails.
    ///
    /// # Panics
    /// As for `tangent`.
    fn direct(&mut self, gradient: &[f64], p: &mut [f64]) -> Result<(), Error> {
        let (n, m) = (self.dim(), self.departure_dim());
        let mut g = vec![0.0; m * n];
        columns(n, &mut g, &mut |unit, column| self.tangent(unit, column))?;
        p.iter_mut().zip(gradient).for_each(|(p, g)| *p = -g);
        solve_identity_plus(View::new(&g, m, n), p)
    }
}

/// y = a linear map of x.
pub(crate) type Map<'a> = dyn FnMut(&[f64], &mut [f64]) -> Result<(), Error> + 'a;

/// The matrix of a linear map of `inputs` numbers, column by column.
pub(crate) fn columns(inputs: usize, matrix: &mut [f64], map: &mut Map) -> Result<(), Error> {
    let outputs = matrix.len() / inputs.max(1);
    let mut unit = vec![0.0; inputs];
    for (j, column) in matrix.chunks_exact_mut(outputs.max(1)).enumerate() {
        unit[j] = 1.0;
        map(&unit, column)?;
        unit[j] = 0.0;
    }
    Ok(())
}

/// x ← (I + WᵀW)⁻¹ x for columns x one after the other, of length n for W with n columns: Cholesky.
pub(crate) fn solve_identity_plus(w: View, x: &mut [f64]) -> Result<(), Error> {
    let n = w.columns();
    if x.is_empty() {
        return Ok(());
    }
    let mut a = vec![0.0; n * n];
    product(w.transpose(), w, &mut a);
    for i in 0..n {
        a[i + i * n] += 1.0;
    }
    let failed = || Error::NotPositiveDefinite { smallest: f64::NAN };
    Cholesky::new(n, &a).map_err(|_| failed())?.solve_columns(x);
    if x.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(failed()) }
}

/// The quadratic inner cost q(p) of [`Incremental`] around the outer iterate last linearized, as a cost
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
    outer: &'a mut (dyn Incremental + 'a),
    b: Vec<f64>,
    d: Vec<f64>,
    dy: Vec<f64>,
    terms: CostTerms,
}

impl<'a> InnerCost<'a> {
    /// Around the outer iterate of `outer`.
    ///
    /// # Panics
    /// If nothing has been linearized.
    pub fn new(outer: &'a mut (dyn Incremental + 'a)) -> Self {
        let (mut b, mut d) = (vec![0.0; outer.dim()], vec![0.0; outer.departure_dim()]);
        outer.departures(&mut b, &mut d);
        Self { dy: vec![0.0; d.len()], outer, b, d, terms: CostTerms::default() }
    }
}

impl CostFunction for InnerCost<'_> {
    fn dim(&self) -> usize {
        self.b.len()
    }

    fn evaluate(&mut self, p: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        self.outer.tangent(p, &mut self.dy)?;
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
            self.outer.adjoint(&self.dy, gradient)?;
            gradient.iter_mut().zip(self.b.iter().zip(p)).for_each(|(g, (b, p))| *g += b + p);
        }
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

impl GaussNewton for InnerCost<'_> {
    fn observation_dim(&self) -> usize {
        self.d.len()
    }

    fn observation_jacobian(&mut self, dv: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.outer.tangent(dv, dy)
    }

    fn observation_jacobian_transpose(&mut self, dy: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        self.outer.adjoint(dy, dv)
    }

    fn hessian_apply(&mut self, dv: &[f64], out: &mut [f64]) -> Result<(), Error> {
        self.outer.tangent(dv, &mut self.dy)?;
        self.outer.adjoint(&self.dy, out)?;
        out.iter_mut().zip(dv).for_each(|(out, dv)| *out += dv);
        Ok(())
    }
}
