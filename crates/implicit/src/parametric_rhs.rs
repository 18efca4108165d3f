//! Parameters of a right-hand side.

use varda_linalg::dot;

use crate::Rhs;

/// A right-hand side f(t, x; p) with parameters p that do not change in time.
///
/// [`RhsWithParameters`] has them in its state, for explicit steps; [`OneLeg`](crate::OneLeg) of such a
/// right-hand side is a [`ParametricStep`](crate::ParametricStep), for implicit ones.
pub trait ParametricRhs: Rhs {
    /// How many parameters there are.
    fn parameters(&self) -> usize;

    /// Takes these values from now on.
    fn set_parameters(&mut self, p: &[f64]);

    /// The columns of ∂f/∂p(t, x), one after the other.
    fn parameter_jacobian(&mut self, t: f64, x: &[f64], columns: &mut [f64]);

    /// Whether `second_parameters` is given, for exact Hessians; false by default.
    fn has_second_parameters(&self) -> bool {
        false
    }

    /// The columns of ∂²(λᵀf)/∂x∂p(t, x), one after the other, and ∂²(λᵀf)/∂p² row by row,
    /// both overwritten. Called only where `has_second_parameters` says so.
    fn second_parameters(
        &mut self,
        _t: f64,
        _x: &[f64],
        _lambda: &[f64],
        _columns: &mut [f64],
        _square: &mut [f64],
    ) {
    }
}

/// How a constant depends on a number p of the control whose prior is N(0, σ²).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Law {
    /// The constant is c₀ + p: g = p.
    Linear,
    /// The constant is c₀ eᵖ, and keeps its sign: g = eᵖ − 1 in units of c₀.
    Exponential,
}

impl Law {
    /// g(p).
    ///
    /// ```
    /// use varda_implicit::Law;
    ///
    /// assert_eq!((Law::Linear.value(0.1), Law::Exponential.slope(0.0)), (0.1, 1.0));
    /// ```
    pub fn value(self, p: f64) -> f64 {
        match self {
            Law::Linear => p,
            Law::Exponential => p.exp_m1(),
        }
    }

    /// g′(p).
    pub fn slope(self, p: f64) -> f64 {
        match self {
            Law::Linear => 1.0,
            Law::Exponential => p.exp(),
        }
    }

    /// g″(p).
    pub fn curvature(self, p: f64) -> f64 {
        match self {
            Law::Linear => 0.0,
            Law::Exponential => p.exp(),
        }
    }
}

/// Some parameters of a right-hand side as numbers that are zero at known values; the others keep theirs.
///
/// ```
/// use varda_implicit::{ChosenParameters, Law, ParametricRhs, Rhs, lorenz::Lorenz63};
///
/// // ρ = 28 eᵖ; σ and β are known
/// let known = [10.0, 28.0, 8.0 / 3.0];
/// let mut rhs = ChosenParameters::new(Lorenz63::default(), &known, vec![(1, Law::Exponential)]);
/// rhs.set_parameters(&[0.1]);
/// let mut f = [0.0; 3];
/// rhs.eval(0.0, &[1.0, 0.0, 0.0], &mut f);
/// assert!((f[1] - 28.0 * 0.1_f64.exp()).abs() < 1e-12);
/// ```
#[derive(Debug, Clone)]
pub struct ChosenParameters<R> {
    rhs: R,
    known: Vec<f64>,
    chosen: Vec<(usize, Law)>,
    slopes: Vec<f64>,
    /// g″ of each chosen one.
    curvatures: Vec<f64>,
    values: Vec<f64>,
    columns: Vec<f64>,
    /// Those of second derivatives, and ∂²(λᵀf)/∂p²: nothing until they are asked for.
    second: [Vec<f64>; 2],
}

impl<R: ParametricRhs> ChosenParameters<R> {
    /// Parameters by their number, with the `known` values of all.
    ///
    /// # Panics
    /// If there is not one known value for each parameter, or none of a chosen number.
    pub fn new(rhs: R, known: &[f64], chosen: Vec<(usize, Law)>) -> Self {
        assert_eq!(known.len(), rhs.parameters(), "a known value for each parameter");
        assert!(chosen.iter().all(|(i, _)| *i < known.len()), "a parameter that is not there was chosen");
        let columns = vec![0.0; rhs.dim() * known.len()];
        let (slopes, curvatures) = (vec![1.0; chosen.len()], vec![0.0; chosen.len()]);
        let (values, second) = (known.to_vec(), [Vec::new(), Vec::new()]);
        Self { rhs, known: known.to_vec(), values, slopes, curvatures, chosen, columns, second }
    }
}

impl<R: Rhs> Rhs for ChosenParameters<R> {
    fn dim(&self) -> usize {
        self.rhs.dim()
    }
    fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
        self.rhs.eval(t, x, f);
    }
    fn tangent(&mut self, t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        self.rhs.tangent(t, x, dx, df);
    }
    fn adjoint_add(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        self.rhs.adjoint_add(t, x, lambda, dx);
    }
    fn adjoint(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        self.rhs.adjoint(t, x, lambda, dx);
    }
    fn structure(&self) -> crate::Structure {
        self.rhs.structure()
    }
    fn jacobian(&mut self, t: f64, x: &[f64], values: &mut [f64]) -> bool {
        self.rhs.jacobian(t, x, values)
    }
    fn has_second_derivatives(&self) -> bool {
        self.rhs.has_second_derivatives()
    }
    fn second_adjoint_add(&mut self, t: f64, x: &[f64], dx: &[f64], lambda: &[f64], out: &mut [f64]) {
        self.rhs.second_adjoint_add(t, x, dx, lambda, out);
    }
}

impl<R: ParametricRhs> ParametricRhs for ChosenParameters<R> {
    fn parameters(&self) -> usize {
        self.chosen.len()
    }

    fn set_parameters(&mut self, p: &[f64]) {
        self.values.copy_from_slice(&self.known);
        let derivatives = self.slopes.iter_mut().zip(&mut self.curvatures);
        for ((&(i, law), (slope, curvature)), &p) in self.chosen.iter().zip(derivatives).zip(p) {
            let unit = if law == Law::Exponential { self.known[i] } else { 1.0 };
            self.values[i] += unit * law.value(p);
            *slope = unit * law.slope(p);
            *curvature = unit * law.curvature(p);
        }
        self.rhs.set_parameters(&self.values);
    }

    fn parameter_jacobian(&mut self, t: f64, x: &[f64], columns: &mut [f64]) {
        let n = x.len();
        self.rhs.parameter_jacobian(t, x, &mut self.columns);
        for ((&(i, _), slope), to) in
            self.chosen.iter().zip(&self.slopes).zip(columns.chunks_exact_mut(n.max(1)))
        {
            let from = &self.columns[i * n..(i + 1) * n];
            to.iter_mut().zip(from).for_each(|(to, from)| *to = slope * from);
        }
    }

    fn has_second_parameters(&self) -> bool {
        self.rhs.has_second_parameters()
    }

    fn second_parameters(
        &mut self,
        t: f64,
        x: &[f64],
        lambda: &[f64],
        columns: &mut [f64],
        square: &mut [f64],
    ) {
        let (n, all, m) = (x.len(), self.known.len(), self.chosen.len());
        let [of_all, square_of_all] = &mut self.second;
        of_all.resize(n * all, 0.0);
        square_of_all.resize(all * all, 0.0);
        self.rhs.second_parameters(t, x, lambda, of_all, square_of_all);
        self.rhs.parameter_jacobian(t, x, &mut self.columns);
        for (a, (&(i, _), slope)) in self.chosen.iter().zip(&self.slopes).enumerate() {
            let from = &of_all[i * n..(i + 1) * n];
            columns[a * n..(a + 1) * n].iter_mut().zip(from).for_each(|(to, from)| *to = slope * from);
            for (b, (&(j, _), other)) in self.chosen.iter().zip(&self.slopes).enumerate() {
                square[a * m + b] = slope * other * square_of_all[i * all + j];
            }
            square[a * m + a] += self.curvatures[a] * dot(&self.columns[i * n..(i + 1) * n], lambda);
        }
    }
}

/// A right-hand side with its parameters in the state, ẋ = f(t, x; p), ṗ = 0, and `carried` constants
/// behind them that f does not depend on.
///
/// ```
/// use varda_implicit::{RhsWithParameters, Rk4, check, lorenz::Lorenz63};
///
/// // state [x, y, z, σ, ρ, β]
/// let mut model = Rk4::new(RhsWithParameters::new(Lorenz63::default(), 0), 0, 0.01);
/// let report = check::model(&mut model, &[1.0, 3.0, 20.0, 10.0, 28.0, 2.6], 5, &[1.0; 6], 1)?;
/// assert!(report.passed(), "{report}");
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct RhsWithParameters<R> {
    rhs: R,
    carried: usize,
    columns: Vec<f64>,
    /// ∂²(λᵀf)/∂p²: nothing until it is asked for.
    square: Vec<f64>,
}

impl<R: ParametricRhs> RhsWithParameters<R> {
    /// The right-hand side with all its parameters in the state.
    pub fn new(rhs: R, carried: usize) -> Self {
        Self { columns: vec![0.0; rhs.dim() * rhs.parameters()], square: Vec::new(), carried, rhs }
    }

    /// Takes the parameters of a state, and splits it.
    fn take<'x>(&mut self, long: &'x [f64]) -> &'x [f64] {
        let (x, p) = long.split_at(self.rhs.dim());
        self.rhs.set_parameters(&p[..self.rhs.parameters()]);
        x
    }
}

impl<R: ParametricRhs> Rhs for RhsWithParameters<R> {
    fn dim(&self) -> usize {
        self.rhs.dim() + self.rhs.parameters() + self.carried
    }

    fn eval(&mut self, t: f64, long: &[f64], f: &mut [f64]) {
        let x = self.take(long);
        let (f, rest) = f.split_at_mut(x.len());
        self.rhs.eval(t, x, f);
        rest.fill(0.0);
    }

    fn tangent(&mut self, t: f64, long: &[f64], dlong: &[f64], df: &mut [f64]) {
        let x = self.take(long);
        let ((dx, dp), (df, rest)) = (dlong.split_at(x.len()), df.split_at_mut(x.len()));
        self.rhs.tangent(t, x, dx, df);
        self.rhs.parameter_jacobian(t, x, &mut self.columns);
        for (column, dp) in self.columns.chunks_exact(x.len().max(1)).zip(dp) {
            df.iter_mut().zip(column).for_each(|(df, c)| *df += c * dp);
        }
        rest.fill(0.0);
    }

    fn adjoint_add(&mut self, t: f64, long: &[f64], lambda: &[f64], dlong: &mut [f64]) {
        let x = self.take(long);
        let ((dx, dp), lambda) = (dlong.split_at_mut(x.len()), &lambda[..x.len()]);
        self.rhs.adjoint_add(t, x, lambda, dx);
        self.rhs.parameter_jacobian(t, x, &mut self.columns);
        for (column, dp) in self.columns.chunks_exact(x.len().max(1)).zip(dp) {
            *dp += column.iter().zip(lambda).map(|(c, l)| c * l).sum::<f64>();
        }
    }

    fn has_second_derivatives(&self) -> bool {
        let given = self.rhs.parameters() == 0 || self.rhs.has_second_parameters();
        given && self.rhs.has_second_derivatives()
    }

    fn second_adjoint_add(&mut self, t: f64, long: &[f64], dlong: &[f64], lambda: &[f64], out: &mut [f64]) {
        let x = self.take(long);
        let m = self.rhs.parameters();
        let ((dx, dp), (out, out_p)) = (dlong.split_at(x.len()), out.split_at_mut(x.len()));
        let (lambda, dp) = (&lambda[..x.len()], &dp[..m]);
        self.rhs.second_adjoint_add(t, x, dx, lambda, out);
        if m == 0 {
            return;
        }
        self.square.resize(m * m, 0.0);
        self.rhs.second_parameters(t, x, lambda, &mut self.columns, &mut self.square);
        let columns = self.columns.chunks_exact(x.len().max(1)).zip(self.square.chunks_exact(m));
        for (((column, row), dp_i), out_p) in columns.zip(dp).zip(out_p) {
            out.iter_mut().zip(column).for_each(|(out, c)| *out += c * dp_i);
            *out_p += dot(column, dx) + dot(row, dp);
        }
    }
}
