//! The closed form of linear problems: the best linear unbiased estimate.

use crate::cost::{columns, dot, norm, solve_identity_plus};
use crate::{ControlTransform, Error, LeastSquares};
use varda_linalg::dense::View;
use varda_linalg::{Svd, interrupt};

/// In which space the gain is computed; both forms are equal (paper 2.2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Gain {
    /// K = B Hᵀ (H B Hᵀ + R)⁻¹: a system of m equations, m adjoint sweeps.
    Observation,
    /// K = (B⁻¹ + Hᵀ R⁻¹ H)⁻¹ Hᵀ R⁻¹: a system of n equations, n tangent sweeps.
    Information,
}

/// The best linear unbiased estimate in closed form (the Kalman update, paper 2.1, 2.2), for a window too:
///
/// ```text
///     v_a = K (d + G b),    K = Gᵀ (G Gᵀ + I)⁻¹ = (I + GᵀG)⁻¹ Gᵀ,
///     P_v = I − K G = (I + GᵀG)⁻¹
///     z_a = z_b + U v_a,    P_z = U P_v Uᵀ
/// ```
///
/// (b = 0 where the problem is linearized at the background)
/// with G = R^{-1/2} H M U, U = B^{1/2}: whitened, so that no inverse of B appears and a singular B is no
/// special case, and H M includes the tangent of the model, so that observations may lie anywhere in a
/// window.
///
/// When to use: as a reference, and for small linear problems. When not: where model or observations are not
/// linear, for it is the estimate linearized there (one full step of Gauss–Newton from the point given); n
/// or m beyond a few thousand.
///
/// Cost: n tangent or m adjoint sweeps (see [`Gain`]), a Cholesky factorization and n m min(n, m). Memory: 2
/// n m + n² (+ m² with the gain in observation space).
///
/// ```
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
///
/// // 0 ± 2, seen as 5 ± 1: the estimate is 4 ± 2/√5.
/// let seen = vec![Observation::new(0, vec![0], vec![5.0], 1.0)];
/// let mut observations = ObservationSet::new(0, vec![Box::new(Selection::new(vec![0], 1)?)], seen)?;
/// let b = Diagonal::uniform(1, 2.0)?;
/// let transform = ControlTransform::new(vec![0.0], &b)?;
/// let mut cost = StrongConstraint::without_model(transform, &mut observations)?;
/// let blue = Blue::new(&mut cost, &[0.0], Gain::Observation)?;
/// assert!((2.0 * blue.control_variable[0] - 4.0).abs() < 1e-14);
/// assert!((4.0 * blue.covariance[0] - 0.8).abs() < 1e-14);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Blue {
    /// v_a, the whitened estimate: B^{-1/2}(z_a − z_b), and with model error Q^{-1/2} η after it.
    pub control_variable: Vec<f64>,
    /// K in the control variable and whitened observations, n × m by columns.
    pub gain: Vec<f64>,
    /// P_v, n × n by columns.
    pub covariance: Vec<f64>,
    /// The minimum of the linearized cost, ½ (d + G b)ᵀ(G Gᵀ + I)⁻¹(d + G b).
    pub value: f64,
}

impl Blue {
    /// Linearized at `v` (where the problem is linear, any will do; the background is the usual one).
    ///
    /// # Errors
    /// A cost that cannot be evaluated there; [`Error::NotPositiveDefinite`] where G is not finite. Where I +
    /// GᵀG loses the identity (σ tiny against the background), G itself is factored, by its singular
    /// values.
    ///
    /// # Panics
    /// If `v` is not of length `dim`.
    pub fn new(problem: &mut dyn LeastSquares, v: &[f64], gain: Gain) -> Result<Self, Error> {
        let (n, m) = (problem.dim(), problem.observation_dim());
        let (mut b, mut d, mut gradient) = (vec![0.0; n], vec![0.0; m], vec![0.0; n]);
        problem.linearize(v, &mut gradient)?;
        problem.departures(&mut b, &mut d);
        // G, m × n by columns.
        let g = match gain {
            Gain::Information => {
                let mut g = vec![0.0; m * n];
                columns(n, &mut g, &mut |unit, column| problem.jacobian(unit, column))?;
                g
            }
            Gain::Observation => {
                let mut gt = vec![0.0; n * m];
                columns(m, &mut gt, &mut |unit, column| problem.jacobian_transpose(unit, column))?;
                transpose(n, &gt)
            }
        };
        // Beyond this the product G Gᵀ has no digit left for the identity beside it.
        let is_resolved = n.max(m) as f64 * f64::EPSILON * norm(&g).powi(2) <= 1e-6;
        let factored = if is_resolved { None } else { Some(factored(n, m, &g)?) };
        // K, n × m by columns.
        let k = match (&factored, gain) {
            (Some((k, _)), _) => k.clone(),
            (None, Gain::Information) => {
                let mut k = transpose(m, &g);
                solve_identity_plus(View::new(&g, m, n), &mut k)?;
                k
            }
            (None, Gain::Observation) => {
                // Kᵀ = (G Gᵀ + I)⁻¹ G.
                let (gt, mut kt) = (transpose(m, &g), g.clone());
                solve_identity_plus(View::new(&gt, n, m), &mut kt)?;
                transpose(m, &kt)
            }
        };
        for (column, b) in columns_of(&g, m).zip(&b) {
            d.iter_mut().zip(column).for_each(|(d, g)| *d += g * b);
        }
        let mut control_variable = vec![0.0; n];
        for (column, d) in k.chunks_exact(n.max(1)).zip(&d) {
            control_variable.iter_mut().zip(column).for_each(|(v, k)| *v += k * d);
        }
        let mut covariance = vec![0.0; n * n];
        match (factored, gain) {
            (Some((_, of_factors)), _) => covariance = of_factors,
            (None, Gain::Information) => {
                (0..n).for_each(|i| covariance[i + i * n] = 1.0);
                solve_identity_plus(View::new(&g, m, n), &mut covariance)?;
            }
            (None, Gain::Observation) => {
                for (j, column) in covariance.chunks_exact_mut(n.max(1)).enumerate() {
                    if interrupt::requested() {
                        return Err(varda_linalg::Error::Interrupted.into());
                    }
                    column[j] = 1.0;
                    for (k, g) in k.chunks_exact(n.max(1)).zip(&g[j * m..]) {
                        column.iter_mut().zip(k).for_each(|(c, k)| *c -= k * g);
                    }
                }
            }
        }
        // (G Gᵀ + I)⁻¹ d = d − G K d.
        let mut rest = d.clone();
        for (column, v) in columns_of(&g, m).zip(&control_variable) {
            rest.iter_mut().zip(column).for_each(|(r, g)| *r -= g * v);
        }
        // The first form cancels where G is large, the second where J is small.
        let value = if is_resolved {
            0.5 * dot(&d, &rest)
        } else {
            0.5 * dot(&control_variable, &control_variable) + 0.5 * dot(&rest, &rest)
        };
        Ok(Self { value, control_variable, gain: k, covariance })
    }

    /// z_a = z_b + U v_a.
    ///
    /// # Panics
    /// If v is shorter than the transform's.
    pub fn analysis(&self, transform: &ControlTransform) -> Vec<f64> {
        let mut z = vec![0.0; transform.control_dim()];
        transform.control(&self.control_variable[..transform.dim()], &mut z);
        z
    }

    /// P_z = U P_v Uᵀ, by columns. Of a cost with model error, that of the initial control.
    ///
    /// # Panics
    /// If v is shorter than the transform's.
    pub fn control_covariance(&self, transform: &ControlTransform) -> Vec<f64> {
        let (n, r, n_z) = (self.control_variable.len(), transform.dim(), transform.control_dim());
        // U P_v, n_z × r by columns, then its rows through U again.
        let mut half = vec![0.0; n_z * r];
        for (j, column) in half.chunks_exact_mut(n_z).enumerate() {
            transform.tangent(&self.covariance[j * n..][..r], column);
        }
        let rows = transpose(n_z, &half);
        let mut covariance = vec![0.0; n_z * n_z];
        for (row, column) in rows.chunks_exact(r.max(1)).zip(covariance.chunks_exact_mut(n_z)) {
            transform.tangent(row, column);
        }
        covariance
    }
}

/// K = V s/(1 + s²) Uᵀ and P_v = V 1/(1 + s²) Vᵀ, by the singular values of G: where σ is tiny, I +
/// GᵀG has lost what is not observed.
fn factored(n: usize, m: usize, g: &[f64]) -> Result<(Vec<f64>, Vec<f64>), Error> {
    let Svd { values, left, right } =
        Svd::new(m, n, g).map_err(|_| Error::NotPositiveDefinite { smallest: f64::NAN })?;
    let (mut k, mut covariance) = (vec![0.0; n * m], vec![0.0; n * n]);
    for (i, v) in right.chunks_exact(n.max(1)).enumerate() {
        if interrupt::requested() {
            return Err(varda_linalg::Error::Interrupted.into());
        }
        let s = values.get(i).copied().unwrap_or(0.0);
        // hypot: s² may overflow
        let length = s.hypot(1.0);
        if let Some(u) = left.chunks_exact(m.max(1)).nth(i) {
            add_outer(s / length / length, v, u, &mut k);
        }
        add_outer(1.0 / length / length, v, v, &mut covariance);
    }
    Ok((k, covariance))
}

/// matrix += c x yᵀ, by columns.
fn add_outer(c: f64, x: &[f64], y: &[f64], matrix: &mut [f64]) {
    for (column, y) in matrix.chunks_exact_mut(x.len()).zip(y) {
        column.iter_mut().zip(x).for_each(|(a, x)| *a += c * y * x);
    }
}

fn columns_of(matrix: &[f64], rows: usize) -> std::slice::ChunksExact<'_, f64> {
    matrix.chunks_exact(rows.max(1))
}

/// The transpose of a matrix with `rows` rows, by columns both.
fn transpose(rows: usize, matrix: &[f64]) -> Vec<f64> {
    let columns = matrix.len() / rows.max(1);
    (0..rows).flat_map(|i| (0..columns).map(move |j| matrix[i + j * rows])).collect()
}
