//! How a number of an analysis depends on what the analysis was made of.

use varda_linalg::dot;
use varda_linalg::krylov::{CgLimits, conjugate_gradients};

use crate::{Error, Hessian, LeastSquares};

/// ∂s/∂y of a number s = E x of an analysis, y a value that was observed as H x with error σ:
///
/// ```text
///     ∂s/∂y = E P Hᵀ/σ²,    P = W Wᵀ the posterior
/// ```
///
/// The derivative of the minimum of a linear problem, of a nonlinear one by Gauss and Newton, or exact where
/// P is that of the exact Hessian (implicit function theorem). `scalar` is E W, `row` is H W, a number for
/// each column of the root. With the row of a component of the control in place of H, and its σ_b, it is the
/// derivative by the background, where that component's error is independent of all others. Without a root,
/// or with correlated errors: [`ScalarSensitivity`].
///
/// ```
/// use varda_assimilation::sensitivity;
///
/// // one number with σ_b = 2, seen with σ = 2: σ_a² = 2, the analysis is the mean of both
/// let w = [2.0_f64.sqrt()];
/// assert!((sensitivity(&w, &w, 2.0) - 0.5).abs() < 1e-15);
/// ```
///
/// # Panics
/// If the two rows are not of one length.
pub fn sensitivity(scalar: &[f64], row: &[f64], sigma: f64) -> f64 {
    assert_eq!(scalar.len(), row.len(), "rows of one root");
    scalar.iter().zip(row).map(|(e, h)| e * h).sum::<f64>() / (sigma * sigma)
}

/// How a number s(v) of a minimum depends on values, errors and background, by one solve with the Hessian A
/// there (Le Dimet, Ngodock, Luong and Verron 1997):
///
/// ```text
///     A w = ∂s/∂v
///     ∂s/∂(R^{-1/2} y) = G w,    ∂s/∂ln σ_i = −2 d_i (G w)_i
///     ∂s/∂(U⁻¹ z_b) = w,         ∂s/∂ln σ_b,i = 2 b_i w_i
/// ```
///
/// with d and b the whitened departures of [`LeastSquares::departures`], σ_b,i the size of the i-th column
/// of U. Exact with [`Hessian::Exact`]; with A = I + GᵀG it is without second derivatives of the model,
/// which are multiplied by d. All derivatives by ln σ together are zero: a minimum does not change with
/// the unit of all errors.
///
/// ```
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
///
/// // x_b = 1 ± 2 and y = 4 ± 1: x_a = (1/4 + 4)/(1/4 + 1) = 3.4
/// let b = Diagonal::uniform(1, 2.0)?;
/// let seen = Observation::new(0, vec![0], vec![4.0], 1.0);
/// let mut set = ObservationSet::new(0, vec![Box::new(Selection::new(vec![0], 1)?)], vec![seen])?;
/// let mut cost = StrongConstraint::without_model(ControlTransform::new(vec![1.0], &b)?, &mut set)?;
/// let v = [1.2];
/// cost.linearize(&v, &mut [0.0])?;
/// let s = ScalarSensitivity::new(&mut cost, Hessian::GaussNewton, &[2.0])?; // ∂x_a/∂v = U
/// assert!((s.by_whitened_values()[0] - 0.8).abs() < 1e-15); // the gain, times σ
/// assert!((s.by_whitened_background()[0] - 0.4).abs() < 1e-15); // 1 − 0.8, times σ_b
/// assert!((s.by_log_sigma()[0] + 0.96).abs() < 1e-14 && (s.by_log_root()[0] - 0.96).abs() < 1e-14);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ScalarSensitivity {
    w: Vec<f64>,
    seen: Vec<f64>,
    b: Vec<f64>,
    d: Vec<f64>,
}

impl ScalarSensitivity {
    /// At the linearized point of a cost, a minimum; `by_v` is ∂s/∂v there. Products with A: at
    /// most one for each number of v, as a rule as many as there are degrees of freedom for signal.
    ///
    /// # Errors
    /// Those of the products; [`Error::NoSecondDerivatives`]; [`Error::NotPositiveDefinite`].
    ///
    /// # Panics
    /// If nothing has been linearized, or `by_v` has another length than v.
    pub fn new(cost: &mut dyn LeastSquares, hessian: Hessian, by_v: &[f64]) -> Result<Self, Error> {
        let (n, m) = (cost.dim(), cost.observation_dim());
        assert_eq!(by_v.len(), n, "length of ∂s/∂v");
        let mut w = vec![0.0; n];
        solve(cost, hessian, &[], by_v, &mut w)?;
        let (mut seen, mut b, mut d) = (vec![0.0; m], vec![0.0; n], vec![0.0; m]);
        cost.jacobian(&w, &mut seen)?;
        cost.departures(&mut b, &mut d);
        Ok(Self { w, seen, b, d })
    }

    /// ∂s/∂(R^{-1/2} y) = G w: of independent errors σ ∂s/∂y, a number for each observed value.
    pub fn by_whitened_values(&self) -> &[f64] {
        &self.seen
    }

    /// ∂s/∂(U⁻¹ z_b) = w: how far s moves with a background that is moved by a column of U.
    pub fn by_whitened_background(&self) -> &[f64] {
        &self.w
    }

    /// ∂s/∂ln σ of each observed value; of several that have one σ, their sum.
    pub fn by_log_sigma(&self) -> Vec<f64> {
        self.d.iter().zip(&self.seen).map(|(d, w)| -2.0 * d * w).collect()
    }

    /// ∂s by the logarithm of the size of each column of U; of a covariance with one σ, their sum.
    pub fn by_log_root(&self) -> Vec<f64> {
        self.b.iter().zip(&self.w).map(|(b, w)| 2.0 * b * w).collect()
    }
}

/// How a minimum over some numbers of v moves with others that are held (constants of a model that are
/// taken for known): with A the Hessian at the linearized point, `f` those that are free, `h` those held,
///
/// ```text
///     A_ff δv_f = −A_fh δv_h
/// ```
///
/// (implicit function theorem). `held` are (place in v, δv_h). What a number of the analysis does then
/// is its tangent with the δv returned: what follows from the held numbers themselves, and from the
/// minimum that moves. Costs as [`ScalarSensitivity::new`].
///
/// ```
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
///
/// // x and a bias p, seen as x + p = 4 ± 1, x_b = 1 ± 2: a bias of 1 takes 0.8 off x
/// let b = Diagonal::new(vec![2.0, 1.0])?;
/// let both = LinearObservation::new(1, 2, &[(0, 0, 1.0), (0, 1, 1.0)])?;
/// let seen = Observation::new(0, vec![0], vec![4.0], 1.0);
/// let mut set = ObservationSet::new(0, vec![Box::new(both)], vec![seen])?;
/// let mut cost = StrongConstraint::without_model(ControlTransform::new(vec![1.0, 0.0], &b)?, &mut set)?;
/// cost.linearize(&[1.2, 0.0], &mut [0.0; 2])?;
/// let dv = with_held(&mut cost, Hessian::GaussNewton, &[(1, 1.0)])?;
/// assert!((2.0 * dv[0] + 0.8).abs() < 1e-14 && dv[1] == 1.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As for [`ScalarSensitivity::new`].
///
/// # Panics
/// If nothing has been linearized, or a place is not one of v.
pub fn with_held(
    cost: &mut dyn LeastSquares,
    hessian: Hessian,
    held: &[(usize, f64)],
) -> Result<Vec<f64>, Error> {
    let n = cost.dim();
    let (mut moved, mut force, mut dv) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    held.iter().for_each(|(i, dv)| moved[*i] = *dv);
    product(cost, hessian, &moved, &mut force)?;
    force.iter_mut().for_each(|f| *f = -*f);
    solve(cost, hessian, held, &force, &mut dv)?;
    held.iter().for_each(|(i, value)| dv[*i] = *value);
    Ok(dv)
}

/// ‖A w − b‖ to this part of ‖b‖: rounding, with vectors that are orthogonal to it.
const RESIDUAL: f64 = 1e-13;

/// A_ff w_f = b_f and zero for the others.
fn solve(
    cost: &mut dyn LeastSquares,
    hessian: Hessian,
    held: &[(usize, f64)],
    b: &[f64],
    w: &mut [f64],
) -> Result<(), Error> {
    let fix = |v: &mut [f64]| held.iter().for_each(|(i, _)| v[*i] = 0.0);
    let mut b = b.to_vec();
    fix(&mut b);
    let mut free = |p: &[f64], out: &mut [f64]| {
        product(cost, hessian, p, out)?;
        fix(out);
        Ok::<f64, Error>(dot(p, out))
    };
    let limits = CgLimits { residual: RESIDUAL, iterations: b.len() - held.len() };
    conjugate_gradients(&mut free, &b, &limits, w)?;
    Ok(())
}

fn product(cost: &mut dyn LeastSquares, hessian: Hessian, p: &[f64], out: &mut [f64]) -> Result<(), Error> {
    match hessian {
        Hessian::GaussNewton => cost.hessian_apply(p, out),
        Hessian::Exact => cost.exact_hessian_apply(p, out),
    }
}
