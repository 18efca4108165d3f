//! The one trait of costs that are half a sum of squares.

use super::CostFunction;
use crate::Error;
use varda_linalg::dense::{Cholesky, View, product};

/// A cost that is half a sum of squares, with Jacobian products around the last linearized point v
/// (paper 2.10, 2.18, 2.19):
///
/// ```text
///     q(p) = ½‖b + p‖² + ½‖G p − d‖²,    ∇q(0) = b − Gᵀd,    ∇²q = A = I + GᵀG
/// ```
///
/// b is the whitened departure of v from what is known before it was observed (v itself where v = B^{-1/2}(z
/// − z_b)), d = R^{-1/2}(y − H(x)), and G = R^{-1/2} H M B^{1/2} the m × n Jacobian of the whitened
/// predictions. A, the Hessian without second derivatives of the model, is what the paper calls "the
/// Hessian". Minimizers with products, incremental and dual methods, closed forms and posteriors see a
/// problem through this trait only.
///
/// p is whitened: its norm is that of the prior. For a cost in the control variable p is an increment of v;
/// for a cost over states ([`WeakState`](super::WeakState)) the increment of v is `increment(p)`, and
/// [`is_whitened`](CostFunction::is_whitened) says so.
///
/// # Examples
/// A cost of one's own needs the products and departures; A and everything built on it is provided:
///
/// ```
/// use varda_assimilation::*;
///
/// /// J(v) = ½ v² + ½ (3 v − 1)².
/// struct Line(f64, CostTerms);
///
/// impl CostFunction for Line {
///     fn dim(&self) -> usize {
///         1
///     }
///     fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
///         self.0 = v[0];
///         let misfit = 3.0 * v[0] - 1.0;
///         let background = 0.5 * v[0] * v[0];
///         self.1 = CostTerms { background, observation: 0.5 * misfit * misfit, model_error: 0.0 };
///         if let Some(gradient) = gradient {
///             gradient[0] = v[0] + 3.0 * misfit;
///         }
///         Ok(self.1.total())
///     }
///     fn terms(&self) -> CostTerms {
///         self.1
///     }
///     fn set_observation_scale(&mut self, _: f64) {}
///     fn counts(&self) -> Counts {
///         Counts::default()
///     }
/// }
///
/// impl LeastSquares for Line {
///     fn background_dim(&self) -> usize {
///         1
///     }
///     fn observation_dim(&self) -> usize {
///         1
///     }
///     fn departures(&self, b: &mut [f64], d: &mut [f64]) {
///         (b[0], d[0]) = (self.0, 1.0 - 3.0 * self.0);
///     }
///     fn jacobian(&mut self, p: &[f64], dy: &mut [f64]) -> Result<(), Error> {
///         dy[0] = 3.0 * p[0];
///         Ok(())
///     }
///     fn jacobian_transpose(&mut self, dy: &[f64], p: &mut [f64]) -> Result<(), Error> {
///         p[0] = 3.0 * dy[0];
///         Ok(())
///     }
/// }
///
/// let blue = Blue::new(&mut Line(0.0, CostTerms::default()), &[0.0], Gain::Information)?;
/// assert!((blue.control_variable[0] - 0.3).abs() < 1e-15);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait LeastSquares: CostFunction {
    /// m, the length of d.
    fn observation_dim(&self) -> usize;

    /// How many leading entries of b belong to the background; the rest is model error. `dim` where the model
    /// is perfect.
    fn background_dim(&self) -> usize;

    /// Makes v the linearized point: returns J(v) and ∇q(0), from one forward run and one adjoint sweep.
    ///
    /// # Errors
    /// As for [`CostFunction::evaluate`].
    ///
    /// # Panics
    /// If a slice is not of length `dim`.
    fn linearize(&mut self, v: &[f64], gradient: &mut [f64]) -> Result<f64, Error> {
        self.evaluate(v, Some(gradient))
    }

    /// b and d at the linearized point.
    ///
    /// # Panics
    /// If nothing has been linearized, or a slice has the wrong length.
    fn departures(&self, b: &mut [f64], d: &mut [f64]);

    /// dy = G p: one tangent sweep.
    ///
    /// # Errors
    /// A model that cannot return to the linearized point.
    ///
    /// # Panics
    /// If nothing has been linearized, or a slice has the wrong length.
    fn jacobian(&mut self, p: &[f64], dy: &mut [f64]) -> Result<(), Error>;

    /// p = Gᵀ dy: one adjoint sweep.
    ///
    /// # Errors
    /// As for `jacobian`.
    ///
    /// # Panics
    /// As for `jacobian`.
    fn jacobian_transpose(&mut self, dy: &[f64], p: &mut [f64]) -> Result<(), Error>;

    /// out = A p: one tangent and one adjoint sweep.
    ///
    /// # Errors
    /// As for `jacobian`.
    ///
    /// # Panics
    /// As for `jacobian`.
    fn hessian_apply(&mut self, p: &[f64], out: &mut [f64]) -> Result<(), Error> {
        let mut dy = vec![0.0; self.observation_dim()];
        self.jacobian(p, &mut dy)?;
        self.jacobian_transpose(&dy, out)?;
        out.iter_mut().zip(p).for_each(|(out, p)| *out += p);
        Ok(())
    }

    /// A, dense, column by column (`out` has length n²): by n products, or as the costs with a model have it
    /// by n tangent or m adjoint sweeps, whichever takes fewer steps.
    ///
    /// # Errors
    /// As for `jacobian`.
    ///
    /// # Panics
    /// As for `jacobian`.
    fn hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let n = self.dim();
        assert_eq!(out.len(), n * n, "length of the Hessian");
        columns(n, out, &mut |unit, column| self.hessian_apply(unit, column))
    }

    /// Whether the exact Hessian ∇²J is given: model and observation operators have second derivatives
    /// ([`Model::second_order`](varda_implicit::Model::second_order)). False by default.
    fn has_exact_hessian(&mut self) -> bool {
        false
    }

    /// out = ∇²J p, with the second derivatives that A leaves out,
    ///
    /// ```text
    ///     ∇²J = A − Σ_i d_i ∂²(R^{-1/2} H M B^{1/2})_i
    /// ```
    ///
    /// by one tangent sweep and one sweep of the second-order adjoint. It may be indefinite.
    ///
    /// # Errors
    /// As for `jacobian`; [`Error::NoSecondDerivatives`] where `has_exact_hessian` is false.
    ///
    /// # Panics
    /// As for `jacobian`.
    fn exact_hessian_apply(&mut self, _p: &[f64], _out: &mut [f64]) -> Result<(), Error> {
        Err(Error::NoSecondDerivatives)
    }

    /// ∇²J, dense, column by column (`out` has length n²): n products, made symmetric.
    ///
    /// # Errors
    /// As for `exact_hessian_apply`.
    ///
    /// # Panics
    /// As for `jacobian`.
    fn exact_hessian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let n = self.dim();
        assert_eq!(out.len(), n * n, "length of the Hessian");
        columns(n, out, &mut |unit, column| self.exact_hessian_apply(unit, column))?;
        symmetrize(n, out);
        Ok(())
    }

    /// G, dense, m × n column by column: by n tangent or m adjoint sweeps, whichever are fewer.
    ///
    /// # Errors
    /// As for `jacobian`.
    ///
    /// # Panics
    /// As for `jacobian`.
    fn dense_jacobian(&mut self, out: &mut [f64]) -> Result<(), Error> {
        let (n, m) = (self.dim(), self.observation_dim());
        assert_eq!(out.len(), m * n, "length of G");
        if n <= m {
            return columns(n, out, &mut |unit, column| self.jacobian(unit, column));
        }
        let mut rows = vec![0.0; m * n];
        columns(m, &mut rows, &mut |unit, row| self.jacobian_transpose(unit, row))?;
        out.copy_from_slice(&View::new(&rows, n, m).transpose().to_matrix().into_columns());
        Ok(())
    }

    /// dv, the increment of v that belongs to p.
    ///
    /// # Errors
    /// As for `jacobian`.
    ///
    /// # Panics
    /// As for `jacobian`.
    fn increment(&mut self, p: &[f64], dv: &mut [f64]) -> Result<(), Error> {
        dv.copy_from_slice(p);
        Ok(())
    }

    /// p = −A⁻¹ ∇q(0) by a direct method, for small problems and as a reference: A formed by n tangent
    /// sweeps, then Cholesky.
    ///
    /// # Errors
    /// As for `jacobian`; [`Error::NotPositiveDefinite`] where the factorization fails.
    ///
    /// # Panics
    /// As for `jacobian`.
    fn direct(&mut self, gradient: &[f64], p: &mut [f64]) -> Result<(), Error> {
        let (n, m) = (self.dim(), self.observation_dim());
        direct_by_columns(n, m, &mut |unit, column| self.jacobian(unit, column), gradient, p)
    }
}

/// A ← (A + Aᵀ)/2, n × n.
pub(super) fn symmetrize(n: usize, a: &mut [f64]) {
    for j in 0..n {
        for i in 0..j {
            let mean = 0.5 * (a[i + j * n] + a[j + i * n]);
            (a[i + j * n], a[j + i * n]) = (mean, mean);
        }
    }
}

/// p = −(I + GᵀG)⁻¹ g from the columns of G, an m × n matrix.
pub(super) fn direct_by_columns(
    n: usize,
    m: usize,
    jacobian: &mut Map,
    gradient: &[f64],
    p: &mut [f64],
) -> Result<(), Error> {
    let mut g = vec![0.0; m * n];
    columns(n, &mut g, jacobian)?;
    p.iter_mut().zip(gradient).for_each(|(p, g)| *p = -g);
    solve_identity_plus(View::new(&g, m, n), p)
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

/// G, m × n by columns.
pub(crate) fn dense_jacobian(problem: &mut (impl LeastSquares + ?Sized)) -> Result<Vec<f64>, Error> {
    let mut g = vec![0.0; problem.observation_dim() * problem.dim()];
    problem.dense_jacobian(&mut g)?;
    Ok(g)
}

/// Gᵀ, by columns: m adjoint sweeps.
pub(crate) fn rows(problem: &mut (impl LeastSquares + ?Sized)) -> Result<Vec<f64>, Error> {
    let (m, r) = (problem.observation_dim(), problem.dim());
    let mut rows = vec![0.0; m * r];
    let mut unit = vec![0.0; m];
    for (a, row) in rows.chunks_exact_mut(r.max(1)).enumerate() {
        unit[a] = 1.0;
        problem.jacobian_transpose(&unit, row)?;
        unit[a] = 0.0;
    }
    Ok(rows)
}

/// The parts of G that belong to the first `n` of `r` unknowns and to the others: G_b by columns, G_qᵀ by
/// columns.
pub(crate) fn parts(n: usize, m: usize, rows: &[f64]) -> [Vec<f64>; 2] {
    let r = rows.len() / m.max(1);
    let (mut g_b, mut g_q) = (vec![0.0; m * n], vec![0.0; (r - n.min(r)) * m]);
    for (a, row) in rows.chunks_exact(r.max(1)).enumerate() {
        (0..n).for_each(|j| g_b[a + j * m] = row[j]);
        g_q[a * (r - n)..(a + 1) * (r - n)].copy_from_slice(&row[n..]);
    }
    [g_b, g_q]
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
