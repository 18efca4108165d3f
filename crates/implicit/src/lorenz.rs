//! Standard test models: the Lorenz equations of 1963 and 1996.

use crate::{Model, ParametricRhs, Rhs, Rk4};

/// Lorenz 1963, three variables, chaotic for the classical parameters.
///
/// ```text
/// ẋ = σ (y − x),  ẏ = x (ρ − z) − y,  ż = x y − β z
/// ```
///
/// ```
/// use varda_implicit::{Rhs, lorenz::Lorenz63};
///
/// let mut f = [0.0; 3];
/// // one of the two equilibria beside the origin: x = y = √(β(ρ − 1)), z = ρ − 1
/// let x = 72.0_f64.sqrt();
/// Lorenz63::default().eval(0.0, &[x, x, 27.0], &mut f);
/// assert!(f.iter().all(|f| f.abs() < 1e-13));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lorenz63 {
    /// σ, Prandtl number.
    pub sigma: f64,
    /// ρ, relative Rayleigh number.
    pub rho: f64,
    /// β, aspect ratio of the rolls.
    pub beta: f64,
}

impl Default for Lorenz63 {
    /// σ = 10, ρ = 28, β = 8/3.
    fn default() -> Self {
        Self { sigma: 10.0, rho: 28.0, beta: 8.0 / 3.0 }
    }
}

impl Lorenz63 {
    /// The model of this system by [`Rk4`], compiled in this crate.
    ///
    /// # Panics
    /// As [`Rk4::new`].
    pub fn rk4(self, first_index: usize, length: f64) -> Box<dyn Model + Send> {
        Box::new(Rk4::new(self, first_index, length))
    }
}

impl Rhs for Lorenz63 {
    fn dim(&self) -> usize {
        3
    }

    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        f[0] = self.sigma * (x[1] - x[0]);
        f[1] = x[0] * (self.rho - x[2]) - x[1];
        f[2] = x[0] * x[1] - self.beta * x[2];
    }

    fn tangent(&mut self, _t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        df[0] = self.sigma * (dx[1] - dx[0]);
        df[1] = dx[0] * (self.rho - x[2]) - x[0] * dx[2] - dx[1];
        df[2] = dx[0] * x[1] + x[0] * dx[1] - self.beta * dx[2];
    }

    fn adjoint_add(&mut self, _t: f64, x: &[f64], l: &[f64], dx: &mut [f64]) {
        dx[0] += -self.sigma * l[0] + (self.rho - x[2]) * l[1] + x[1] * l[2];
        dx[1] += self.sigma * l[0] - l[1] + x[0] * l[2];
        dx[2] += -x[0] * l[1] - self.beta * l[2];
    }

    fn has_second_derivatives(&self) -> bool {
        true
    }

    fn second_adjoint_add(&mut self, _t: f64, _x: &[f64], dx: &[f64], l: &[f64], out: &mut [f64]) {
        out[0] += dx[1] * l[2] - dx[2] * l[1];
        out[1] += dx[0] * l[2];
        out[2] -= dx[0] * l[1];
    }
}

/// Lorenz 1996, N ≥ 4 variables on a circle.
///
/// ```text
/// ẋ_i = (x_{i+1} − x_{i−2}) x_{i−1} − x_i + F
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lorenz96 {
    n: usize,
    forcing: f64,
}

impl Lorenz96 {
    /// N variables, forcing F (8 is chaotic).
    ///
    /// # Panics
    /// If N < 4.
    pub fn new(n: usize, forcing: f64) -> Self {
        assert!(n >= 4, "the stencil of Lorenz 96 needs 4 variables, not {n}");
        Self { n, forcing }
    }

    /// The model of this system by [`Rk4`], compiled in this crate.
    ///
    /// # Panics
    /// As [`Rk4::new`].
    pub fn rk4(self, first_index: usize, length: f64) -> Box<dyn Model + Send> {
        Box::new(Rk4::new(self, first_index, length))
    }
}

/// σ, ρ, β.
impl ParametricRhs for Lorenz63 {
    fn parameters(&self) -> usize {
        3
    }

    fn set_parameters(&mut self, p: &[f64]) {
        (self.sigma, self.rho, self.beta) = (p[0], p[1], p[2]);
    }

    fn parameter_jacobian(&mut self, _t: f64, x: &[f64], columns: &mut [f64]) {
        columns.fill(0.0);
        (columns[0], columns[4], columns[8]) = (x[1] - x[0], x[0], -x[2]);
    }

    fn has_second_parameters(&self) -> bool {
        true
    }

    fn second_parameters(&mut self, _t: f64, _x: &[f64], l: &[f64], columns: &mut [f64], square: &mut [f64]) {
        columns.fill(0.0);
        square.fill(0.0);
        (columns[0], columns[1], columns[3], columns[8]) = (-l[0], l[0], l[1], -l[2]);
    }
}

/// The forcing F.
impl ParametricRhs for Lorenz96 {
    fn parameters(&self) -> usize {
        1
    }

    fn set_parameters(&mut self, p: &[f64]) {
        self.forcing = p[0];
    }

    fn parameter_jacobian(&mut self, _t: f64, _x: &[f64], columns: &mut [f64]) {
        columns.fill(1.0);
    }

    fn has_second_parameters(&self) -> bool {
        true
    }

    fn second_parameters(
        &mut self,
        _t: f64,
        _x: &[f64],
        _lambda: &[f64],
        columns: &mut [f64],
        square: &mut [f64],
    ) {
        columns.fill(0.0);
        square.fill(0.0);
    }
}

impl Rhs for Lorenz96 {
    fn dim(&self) -> usize {
        self.n
    }

    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        let (n, forcing) = (self.n, self.forcing);
        let at = |back2: f64, back: f64, here: f64, ahead: f64| (ahead - back2) * back - here + forcing;
        f[0] = at(x[n - 2], x[n - 1], x[0], x[1]);
        f[1] = at(x[n - 1], x[0], x[1], x[2]);
        for (f, x) in f[2..n - 1].iter_mut().zip(x.windows(4)) {
            *f = at(x[0], x[1], x[2], x[3]);
        }
        f[n - 1] = at(x[n - 3], x[n - 2], x[n - 1], x[0]);
    }

    fn tangent(&mut self, _t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        let n = self.n;
        let at = |i: [usize; 4]| (dx[i[3]] - dx[i[0]]) * x[i[1]] + (x[i[3]] - x[i[0]]) * dx[i[1]] - dx[i[2]];
        df[0] = at([n - 2, n - 1, 0, 1]);
        df[1] = at([n - 1, 0, 1, 2]);
        for ((df, x), dx) in df[2..n - 1].iter_mut().zip(x.windows(4)).zip(dx.windows(4)) {
            *df = (dx[3] - dx[0]) * x[1] + (x[3] - x[0]) * dx[1] - dx[2];
        }
        df[n - 1] = at([n - 3, n - 2, n - 1, 0]);
    }

    fn adjoint_add(&mut self, _t: f64, x: &[f64], l: &[f64], dx: &mut [f64]) {
        self.columns(x, l, dx, |dx, column| *dx += column);
    }

    fn adjoint(&mut self, _t: f64, x: &[f64], l: &[f64], dx: &mut [f64]) {
        self.columns(x, l, dx, |dx, column| *dx = column);
    }

    fn has_second_derivatives(&self) -> bool {
        true
    }

    fn second_adjoint_add(&mut self, _t: f64, _x: &[f64], dx: &[f64], l: &[f64], out: &mut [f64]) {
        // f is quadratic: its second derivative is the Jacobian's linear part at dx
        let n = self.n;
        for i in 0..n {
            let (back2, back, ahead) = ((i + n - 2) % n, (i + n - 1) % n, (i + 1) % n);
            out[ahead] += l[i] * dx[back];
            out[back2] -= l[i] * dx[back];
            out[back] += l[i] * (dx[ahead] - dx[back2]);
        }
    }
}

impl Lorenz96 {
    /// (∂f/∂x)ᵀ λ, given to `put` place by place.
    fn columns(&self, x: &[f64], l: &[f64], dx: &mut [f64], put: impl Fn(&mut f64, f64)) {
        // Column i gathers what it gives to rows i−1, i, i+1 and i+2: five neighbours, from i−2 on.
        let n = self.n;
        let column = |x: [f64; 5], l: [f64; 5]| x[0] * l[1] - l[2] + (x[4] - x[1]) * l[3] - x[3] * l[4];
        // Where the circle closes: columns n−2, n−1, 0 and 1 with their neighbours lie in a row of eight.
        let seam = |v: &[f64]| [v[n - 4], v[n - 3], v[n - 2], v[n - 1], v[0], v[1], v[2], v[3]];
        let five = |v: [f64; 8], i: usize| [v[i], v[i + 1], v[i + 2], v[i + 3], v[i + 4]];
        let (x_seam, l_seam) = (seam(x), seam(l));
        for (first, i) in [n - 2, n - 1, 0, 1].into_iter().enumerate() {
            put(&mut dx[i], column(five(x_seam, first), five(l_seam, first)));
        }
        // Neighbours as shifted slices of one length: the compiler then needs no bounds checks and takes
        // several columns at once.
        let m = n - 4;
        let ([x0, x1, x2, x3, x4], [l0, l1, l2, l3, l4]) = (shifted(x, m), shifted(l, m));
        let dx = &mut dx[2..2 + m];
        for i in 0..m {
            put(&mut dx[i], column([x0[i], x1[i], x2[i], x3[i], x4[i]], [l0[i], l1[i], l2[i], l3[i], l4[i]]));
        }
    }
}

/// v from places 0 … 4 on, `m` values each.
fn shifted(v: &[f64], m: usize) -> [&[f64]; 5] {
    std::array::from_fn(|j| &v[j..j + m])
}
