//! The posterior of a model that errs, and what the observations say of Q.

use crate::cost::{dot, rows};
use crate::error_scale::ErrorScale;
use crate::{Error, LeastSquares, Posterior};
use varda_covariance::Covariance;
use varda_linalg::Svd;
use varda_linalg::dense::{View, add_product};

/// The posterior of the initial state and of every model error η_j ([`WeakForcing`](crate::WeakForcing),
/// [`WeakState`](crate::WeakState)), from the singular values of G = Σ s u zᵀ:
///
/// ```text
///     P = (I + GᵀG)⁻¹ = I − Y Yᵀ,    Y = [z s (1 + s²)^{-1/2}]
///     cov(η_j) = Q^{1/2} P_jj Q^{1/2}ᵀ
///     E[2 J_b] = tr(I − P)_bb,    E[2 J_q] = tr(I − P)_qq
/// ```
///
/// The two expectations hold at the minimum of a linear problem whose B, Q and R are right (Talagrand 1999):
/// a J_q far above its own says that Q is too small. By how much: [`scale`](Self::scale).
///
/// When to use: wherever m² numbers and m times the length of the control fit into memory. Cost: m
/// adjoint sweeps, and a thin singular value decomposition of m rows.
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
/// let (b, q) = (Diagonal::uniform(3, 1.0)?, Diagonal::uniform(3, 0.2)?);
/// let forcing = Forcing { steps: 10, ..Forcing::every_step(3) };
/// let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// let mut cost = WeakForcing::new(&mut model, transform, &q, forcing, &mut observations)?;
/// let mut v = vec![0.0; cost.dim()];
/// Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
/// cost.linearize(&v, &mut vec![0.0; v.len()])?;
/// let posterior = WeakPosterior::new(&mut cost)?;
/// // Of the error at step 20, that of the component seen there is known best.
/// let variance = posterior.error_variance(&q, 1);
/// assert!(variance[0] < variance[1] && variance[1] < 0.0401);
/// assert!(2.0 * cost.terms().model_error < 9.0 && posterior.expected_model_error() < 1.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct WeakPosterior {
    initial: Posterior,
    /// Length of the control, and of its part that is the initial state.
    dims: [usize; 2],
    /// z, by columns, and s.
    directions: Vec<f64>,
    signal: Vec<f64>,
    scale: Option<ErrorScale>,
}

impl WeakPosterior {
    /// Around the last point linearized, which should be the minimum.
    ///
    /// # Errors
    /// Products that fail, a G that is not finite.
    ///
    /// # Panics
    /// If nothing has been linearized.
    pub fn new(problem: &mut dyn LeastSquares) -> Result<Self, Error> {
        let (n, m, r) = (problem.background_dim(), problem.observation_dim(), problem.dim());
        let rows = rows(problem)?;
        let initial = Posterior::of_initial_rows(problem, &rows)?;
        let Svd { values: signal, left: directions, .. } = Svd::thin(r, m, &rows)?;
        let (mut b, mut d) = (vec![0.0; r], vec![0.0; m]);
        problem.departures(&mut b, &mut d);
        // y − H of the run from the background without errors, to first order.
        for (d, row) in d.iter_mut().zip(rows.chunks_exact(r.max(1))) {
            *d += dot(row, &b);
        }
        let scale = if r > n { ErrorScale::most_likely(n, &rows, &d)? } else { None };
        Ok(Self { initial, dims: [r, n], directions, signal, scale })
    }

    /// The posterior of the initial state, errors of the model integrated out.
    pub fn initial(&self) -> &Posterior {
        &self.initial
    }

    /// Variances of η_j on the forced components, the diagonal of Q^{1/2} P_jj Q^{1/2}ᵀ; `q` is the
    /// cost's.
    ///
    /// # Panics
    /// If there is no such error.
    pub fn error_variance(&self, q: &dyn Covariance, j: usize) -> Vec<f64> {
        let ([r, n], k) = (self.dims, q.root_dim());
        let first = n + j * k;
        assert!(first + k <= r, "error {j}");
        let (mut variance, mut eta) = (vec![0.0; q.dim()], vec![0.0; q.dim()]);
        q.variance(&mut variance);
        let prior = variance.clone();
        for (z, s) in self.directions.chunks_exact(r).zip(&self.signal) {
            q.root(&z[first..first + k], &mut eta);
            let size = s / s.hypot(1.0);
            variance.iter_mut().zip(&eta).for_each(|(v, eta)| *v -= (size * eta).powi(2));
        }
        // What rounding leaves of an error that is known far better than Q says.
        variance.iter_mut().zip(prior).for_each(|(v, q)| *v = v.max(f64::EPSILON * q));
        variance
    }

    /// tr(I − P)_qq / 2, the J_q to expect where B, Q and R are right.
    pub fn expected_model_error(&self) -> f64 {
        let [r, n] = self.dims;
        let directions = self.directions.chunks_exact(r.max(1)).zip(&self.signal);
        0.5 * directions.map(|(z, s)| (s / s.hypot(1.0)).powi(2) * dot(&z[n..], &z[n..])).sum::<f64>()
    }

    /// How many times σ of the model error should be what Q says, by the innovations; `None` where nothing
    /// was observed or nothing is forced.
    pub fn scale(&self) -> Option<ErrorScale> {
        self.scale
    }

    /// A square root of P, by columns of the length of the control: I − Σ (1 − (1 + s²)^{-1/2}) z zᵀ,
    /// or the columns (1 + s²)^{-1/2} z where they are a whole basis. Needs the square of that length in
    /// memory.
    pub fn root(&self) -> Vec<f64> {
        let [r, _] = self.dims;
        let mut weighted = self.directions.clone();
        let whole = self.is_whole();
        for (z, s) in weighted.chunks_exact_mut(r.max(1)).zip(&self.signal) {
            let length = s.hypot(1.0);
            // 1 − (1 + s²)^{-1/2}, which keeps its digits for small s
            let size = if whole { 1.0 / length } else { s / length * (s / (length + 1.0)) };
            z.iter_mut().for_each(|z| *z *= size);
        }
        if whole {
            return weighted;
        }
        let mut root: Vec<f64> = (0..r * r).map(|i| f64::from(i % (r + 1) == 0)).collect();
        let directions = View::new(&self.directions, r, self.signal.len());
        add_product(-1.0, View::new(&weighted, r, self.signal.len()), directions.transpose(), &mut root);
        root
    }

    /// Lengths of the control and of its part that is the initial state.
    pub(crate) fn dims(&self) -> [usize; 2] {
        self.dims
    }

    /// Whether the directions that the observations see are a basis.
    pub(crate) fn is_whole(&self) -> bool {
        self.signal.len() == self.dims[0]
    }

    /// Y, by columns.
    pub(crate) fn learnt(&self) -> Vec<f64> {
        let mut y = self.directions.clone();
        for (y, s) in y.chunks_exact_mut(self.dims[0].max(1)).zip(&self.signal) {
            let size = s / s.hypot(1.0);
            y.iter_mut().for_each(|y| *y *= size);
        }
        y
    }
}
