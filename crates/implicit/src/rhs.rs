//! Ordinary differential equations ẋ = f(t, x), and the values of their Jacobian.

use crate::{Error, Structure};

/// The right-hand side f of ẋ = f(t, x) (paper 2.21), with its derivative as products: those of the
/// sensitivity equation d(δx)/dt = ∂f/∂x δx (paper 2.22) and of its transpose.
///
/// `&mut self` is for work space: every result is a function of the arguments alone.
///
/// ```
/// use varda_implicit::{Rhs, check};
///
/// /// A pendulum: φ̇ = ω, ω̇ = −sin φ.
/// struct Pendulum;
///
/// impl Rhs for Pendulum {
///     fn dim(&self) -> usize {
///         2
///     }
///     fn eval(&mut self, _: f64, x: &[f64], f: &mut [f64]) {
///         f.copy_from_slice(&[x[1], -x[0].sin()]);
///     }
///     fn tangent(&mut self, _: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
///         df.copy_from_slice(&[dx[1], -x[0].cos() * dx[0]]);
///     }
///     fn adjoint_add(&mut self, _: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
///         dx[0] -= x[0].cos() * lambda[1];
///         dx[1] += lambda[0];
///     }
/// }
///
/// let report = check::rhs(&mut Pendulum, 0.0, &[0.7, 0.4], &[1.0; 2], 3)?;
/// assert!(report.passed(), "{report}");
/// # Ok::<(), varda_implicit::Error>(())
/// ```
pub trait Rhs {
    /// Length of the state x.
    fn dim(&self) -> usize;

    /// f = f(t, x).
    fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]);

    /// df = ∂f/∂x(t, x) dx.
    fn tangent(&mut self, t: f64, x: &[f64], dx: &[f64], df: &mut [f64]);

    /// dx += (∂f/∂x(t, x))ᵀ λ.
    fn adjoint_add(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]);

    /// dx = (∂f/∂x(t, x))ᵀ λ. A right-hand side of many variables may save passes over memory by a
    /// definition of its own.
    fn adjoint(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx.fill(0.0);
        self.adjoint_add(t, x, lambda, dx);
    }

    /// Layout of ∂f/∂x for implicit steps; a sparse one must contain the diagonal. Helpers make the usual
    /// ones: [`Structure::tridiagonal`], [`Structure::periodic_band`], [`Structure::from_pairs`].
    fn structure(&self) -> Structure {
        Structure::Dense
    }

    /// Fills in all values of ∂f/∂x in the layout of `structure`, and returns true. By default it returns
    /// false: the values are then made from `tangent`, one product for every colour of the structure
    /// ([`Structure::colouring`]: three for a tridiagonal one, n for a dense one).
    fn jacobian(&mut self, _t: f64, _x: &[f64], _values: &mut [f64]) -> bool {
        false
    }

    /// Whether `second_adjoint_add` is given, for exact Hessians.
    fn has_second_derivatives(&self) -> bool {
        false
    }

    /// out += Σ_i λ_i ∂²f_i/∂x²(t, x) dx. Called only where `has_second_derivatives` says so.
    fn second_adjoint_add(&mut self, _t: f64, _x: &[f64], _dx: &[f64], _lambda: &[f64], _out: &mut [f64]) {}
}

/// How the values of ∂f/∂x come about.
#[cfg_attr(not(feature = "implicit"), allow(dead_code))]
#[derive(Debug, Clone)]
pub(crate) struct Jacobian {
    pub(crate) structure: Structure,
    /// Columns that share no row.
    groups: Vec<Vec<usize>>,
    /// Whether the values have been held against the tangent.
    checked: bool,
    direction: Vec<f64>,
    product: Vec<f64>,
}

/// Share of the size of its terms by which an entry of ∂f/∂x dx may differ between Jacobian and tangent:
/// rounding of two formulas for one thing, and far below the effect of a wrong entry.
const SAME_DERIVATIVE: f64 = 1e-8;

#[cfg_attr(not(feature = "implicit"), allow(dead_code))]
impl Jacobian {
    pub(crate) fn new(n: usize, structure: Structure) -> Self {
        let groups = structure.colouring(n);
        Self { structure, groups, checked: false, direction: vec![0.0; n], product: vec![0.0; n] }
    }

    /// All values of ∂f/∂x at (t, x).
    pub(crate) fn fill<R: Rhs>(
        &mut self,
        rhs: &mut R,
        step: usize,
        t: f64,
        x: &[f64],
        values: &mut [f64],
    ) -> Result<(), Error> {
        if !rhs.jacobian(t, x, values) {
            self.by_tangents(rhs, t, x, values);
        }
        if self.checked { Ok(()) } else { self.check(rhs, step, t, x, values) }
    }

    /// One tangent product for every group of columns that share no row (Curtis, Powell and Reid 1974).
    fn by_tangents<R: Rhs>(&mut self, rhs: &mut R, t: f64, x: &[f64], values: &mut [f64]) {
        values.fill(0.0);
        for group in &self.groups {
            self.direction.fill(0.0);
            group.iter().for_each(|&j| self.direction[j] = 1.0);
            rhs.tangent(t, x, &self.direction, &mut self.product);
            for &j in group {
                self.structure.column(x.len(), j).for_each(|(i, place)| values[place] = self.product[i]);
            }
        }
    }

    /// Holds the values against the tangent, once, as soon as both are finite.
    fn check<R: Rhs>(
        &mut self,
        rhs: &mut R,
        step: usize,
        t: f64,
        x: &[f64],
        values: &[f64],
    ) -> Result<(), Error> {
        let Some(rows) = self.rows(rhs, t, x, values) else { return Ok(()) };
        for (row, [jacobian, tangent, size]) in rows.into_iter().enumerate() {
            if !((tangent - jacobian).abs() <= SAME_DERIVATIVE * size) {
                return Err(Error::JacobianDisagrees { step, row, jacobian, tangent });
            }
        }
        self.checked = true;
        Ok(())
    }

    /// Of every row of ∂f/∂x dx along one direction: its value by the Jacobian, by the tangent, and the
    /// size of its terms. `None` where a value is not finite.
    fn rows<R: Rhs>(&mut self, rhs: &mut R, t: f64, x: &[f64], values: &[f64]) -> Option<Vec<[f64; 3]>> {
        let n = x.len();
        for (j, d) in self.direction.iter_mut().enumerate() {
            *d = 1.0 + 0.5 * (1.0 + 1.7 * j as f64).sin();
        }
        rhs.tangent(t, x, &self.direction, &mut self.product);
        let (mut sums, mut sizes) = (vec![0.0; n], vec![0.0; n]);
        self.structure.product(values, &self.direction, &mut sums);
        let absolute: Vec<f64> = values.iter().map(|v| v.abs()).collect();
        self.structure.product(&absolute, &self.direction, &mut sizes);
        let rows = self.product.iter().zip(&sums).zip(&sizes);
        let rows: Vec<[f64; 3]> =
            rows.map(|((tangent, sum), size)| [*sum, *tangent, size + tangent.abs()]).collect();
        rows.iter().flatten().all(|v| v.is_finite()).then_some(rows)
    }
}

/// The largest share of the size of its terms by which an entry of ∂f/∂x dx differs between the Jacobian,
/// given or made from tangents, and the tangent; NaN where one is not finite.
pub(crate) fn largest_disagreement<R: Rhs>(rhs: &mut R, t: f64, x: &[f64], structure: &Structure) -> f64 {
    let n = x.len();
    let mut jacobian = Jacobian::new(n, structure.clone());
    let mut values = vec![0.0; structure.values_len(n)];
    if !rhs.jacobian(t, x, &mut values) {
        jacobian.by_tangents(rhs, t, x, &mut values);
    }
    let Some(rows) = jacobian.rows(rhs, t, x, &values) else { return f64::NAN };
    let share = |[sum, tangent, size]: [f64; 3]| {
        if sum == tangent { 0.0 } else { (sum - tangent).abs() / size }
    };
    rows.into_iter().map(share).fold(0.0, |worst: f64, d| if d <= worst { worst } else { d })
}
