//! Ordinary differential equations ẋ = f(t, x), and implicit steps for any of them.

use crate::{Equations, Error, ImplicitStep, Interval, Refusal, Scheme, Stage, StepEquations, Structure};

/// The right-hand side f of ẋ = f(t, x) (paper 2.21), with its derivative as products: those of the
/// sensitivity equation d(δx)/dt = ∂f/∂x δx (paper 2.22) and of its transpose.
///
/// `&mut self` is for work space: every result is a function of the arguments alone.
pub trait Rhs {
    /// Length of the state x.
    fn dim(&self) -> usize;

    /// f = f(t, x).
    fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]);

    /// df = ∂f/∂x(t, x) dx.
    fn tangent(&mut self, t: f64, x: &[f64], dx: &[f64], df: &mut [f64]);

    /// dx += (∂f/∂x(t, x))ᵀ λ.
    fn adjoint_add(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]);

    /// dx = (∂f/∂x(t, x))ᵀ λ. A right-hand side of many variables may save passes over memory by a definition of its own.
    fn adjoint(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx.fill(0.0);
        self.adjoint_add(t, x, lambda, dx);
    }

    /// Layout of ∂f/∂x for implicit steps; a sparse one must contain the diagonal. Helpers make the usual ones:
    /// [`Structure::tridiagonal`], [`Structure::periodic_band`], [`Structure::from_pairs`].
    fn structure(&self) -> Structure {
        Structure::Dense
    }

    /// Fills in all values of ∂f/∂x in the layout of `structure`, and returns true. By default it returns false: the
    /// values are then made from `tangent`, one product for every colour of the structure
    /// ([`Structure::colouring`]: three for a tridiagonal one, n for a dense one).
    fn jacobian(&mut self, _t: f64, _x: &[f64], _values: &mut [f64]) -> bool {
        false
    }
}

/// A one-leg step of ẋ = f(t, x) by one of the schemes of [`Scheme`]: f is taken once, at the stage y.
///
/// ```text
/// G(x_k, u) = u − x* − η f(t*, u),   x_{k+1} = b₀ u + b₁ x_k
/// ```
///
/// The state of BDF2 is [x_k, x_{k−1}], its control x₀.
///
/// The first Jacobian that is assembled is held against `tangent` along one direction: a [`Rhs::jacobian`] that disagrees, or a
/// [`Rhs::structure`] that leaves out an entry, is an error before the first step is taken
/// ([`Error::JacobianDisagrees`](crate::Error::JacobianDisagrees)).
#[derive(Debug, Clone)]
pub struct OneLeg<R> {
    rhs: R,
    scheme: Scheme,
    tolerance: f64,
    jacobian: Jacobian,
}

/// How the values of ∂f/∂x come about.
#[derive(Debug, Clone)]
struct Jacobian {
    structure: Structure,
    /// Columns that share no row.
    groups: Vec<Vec<usize>>,
    /// Whether the values have been held against the tangent.
    checked: bool,
    direction: Vec<f64>,
    product: Vec<f64>,
}

/// Share of the size of its terms by which an entry of ∂f/∂x dx may differ between Jacobian and tangent: rounding of two
/// formulas for one thing, and far below the effect of a wrong entry.
const SAME_DERIVATIVE: f64 = 1e-8;

impl Jacobian {
    fn new(n: usize, structure: Structure) -> Self {
        let groups = structure.colouring(n);
        Self { structure, groups, checked: false, direction: vec![0.0; n], product: vec![0.0; n] }
    }

    /// All values of ∂f/∂x at (t, x).
    fn fill<R: Rhs>(
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

    /// Of every row of ∂f/∂x dx along one direction: its value by the Jacobian, by the tangent, and the size of its terms.
    /// `None` where a value is not finite.
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

/// The largest share of the size of its terms by which an entry of ∂f/∂x dx differs between the Jacobian, given or made
/// from tangents, and the tangent; NaN where one is not finite.
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

impl<R: Rhs> OneLeg<R> {
    /// Implicit Euler, x_{k+1} = x_k + Δt f(t_{k+1}, x_{k+1}). Newton's method ends when an update is below `tolerance` in
    /// its largest component.
    ///
    /// # Panics
    /// If a sparse pattern of ∂f/∂x leaves out the diagonal.
    pub fn implicit_euler(rhs: R, tolerance: f64) -> Self {
        Self::new(rhs, Scheme::BackwardEuler, tolerance)
    }

    /// The implicit midpoint rule, x_{k+1} = x_k + Δt f(t_{k+½}, ½(x_k + x_{k+1})). `tolerance` as for implicit Euler.
    ///
    /// # Panics
    /// If a sparse pattern of ∂f/∂x leaves out the diagonal.
    pub fn implicit_midpoint(rhs: R, tolerance: f64) -> Self {
        Self::new(rhs, Scheme::Midpoint, tolerance)
    }

    /// BDF2, (3 x_{k+1} − 4 x_k + x_{k−1})/(2Δt) = f(t_{k+1}, x_{k+1}), after one midpoint step. `tolerance` as for implicit
    /// Euler.
    ///
    /// # Panics
    /// If a sparse pattern of ∂f/∂x leaves out the diagonal.
    pub fn bdf2(rhs: R, tolerance: f64) -> Self {
        Self::new(rhs, Scheme::Bdf2, tolerance)
    }

    /// Any of the three.
    ///
    /// # Panics
    /// If a sparse pattern of ∂f/∂x leaves out the diagonal.
    pub fn new(rhs: R, scheme: Scheme, tolerance: f64) -> Self {
        let n = rhs.dim();
        let structure = rhs.structure();
        let on_diagonal = (0..n).all(|i| structure.diagonal(n, i).is_some());
        assert!(on_diagonal, "the pattern of ∂f/∂x must contain its diagonal");
        Self { rhs, scheme, tolerance, jacobian: Jacobian::new(n, structure) }
    }

    /// The right-hand side.
    pub fn rhs(&self) -> &R {
        &self.rhs
    }

    /// The scheme.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }
}

/// The equations of one step of [`OneLeg`].
#[derive(Debug)]
pub struct OneLegEquations<'a, R> {
    step: &'a mut OneLeg<R>,
    index: usize,
    stage: Stage,
    x: &'a [f64],
}

impl<R: Rhs> Equations for OneLegEquations<'_, R> {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let Self { step, index, stage, x } = self;
        step.rhs.eval(stage.time, u, g);
        let n = u.len();
        for i in 0..n {
            g[i] = u[i] - stage.from[0] * x[i] - stage.length * g[i];
        }
        if stage.from[1] != 0.0 {
            g.iter_mut().zip(&x[n..]).for_each(|(g, x)| *g -= stage.from[1] * x);
        }
        if let Some(values) = jacobian {
            step.jacobian.fill(&mut step.rhs, *index, stage.time, u, values)?;
            values.iter_mut().for_each(|v| *v *= -stage.length);
            for i in 0..n {
                values[step.jacobian.structure.diagonal(n, i).expect("checked in new")] += 1.0;
            }
        }
        Ok(None)
    }

    fn converged_below(&self) -> f64 {
        self.step.tolerance
    }
}

impl<R: Rhs> StepEquations for OneLegEquations<'_, R> {
    /// No change: what is stiff enough for an implicit step is too stiff for an explicit guess.
    fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
        u.copy_from_slice(&self.x[..u.len()]);
        Ok(())
    }
}

impl<R: Rhs> ImplicitStep for OneLeg<R> {
    type Equations<'a>
        = OneLegEquations<'a, R>
    where
        R: 'a;

    fn dim(&self) -> usize {
        self.rhs.dim() + self.history()
    }

    fn history(&self) -> usize {
        if self.scheme == Scheme::Bdf2 { self.rhs.dim() } else { 0 }
    }

    fn structure(&self) -> Structure {
        self.jacobian.structure.clone()
    }

    fn equations<'a>(&'a mut self, at: &Interval, x: &'a [f64]) -> Result<Self::Equations<'a>, Refusal> {
        Ok(OneLegEquations { index: at.index, stage: self.scheme.stage(at), step: self, x })
    }

    fn advance(&mut self, at: &Interval, x: &[f64], u: &[f64], x_next: &mut [f64]) {
        let [b0, b1] = self.scheme.stage(at).to;
        for ((next, u), x) in x_next.iter_mut().zip(u).zip(x) {
            *next = b0 * u + b1 * x;
        }
    }

    fn recover(&mut self, at: &Interval, x: &[f64], x_next: &[f64], u: &mut [f64]) {
        let [b0, b1] = self.scheme.stage(at).to;
        for ((u, next), x) in u.iter_mut().zip(x_next).zip(x) {
            *u = (next - b1 * x) / b0;
        }
    }

    fn previous(&mut self, at: &Interval, _x: &[f64], _u: &[f64], dx: &[f64], dg: &mut [f64]) {
        let [a0, a1] = self.scheme.stage(at).from;
        dg.iter_mut().zip(dx).for_each(|(g, d)| *g = -a0 * d);
        if a1 != 0.0 {
            let before = &dx[dg.len()..];
            dg.iter_mut().zip(before).for_each(|(g, d)| *g -= a1 * d);
        }
    }

    fn previous_transpose_add(&mut self, at: &Interval, _x: &[f64], _u: &[f64], mu: &[f64], dx: &mut [f64]) {
        let [a0, a1] = self.scheme.stage(at).from;
        dx.iter_mut().zip(mu).for_each(|(d, m)| *d -= a0 * m);
        if a1 != 0.0 {
            dx[mu.len()..].iter_mut().zip(mu).for_each(|(d, m)| *d -= a1 * m);
        }
    }

    fn advance_tangent(
        &mut self,
        at: &Interval,
        _x: &[f64],
        _u: &[f64],
        dx: &[f64],
        du: &[f64],
        dx_next: &mut [f64],
    ) {
        let [b0, b1] = self.scheme.stage(at).to;
        for ((next, du), dx) in dx_next.iter_mut().zip(du).zip(dx) {
            *next = b0 * du + b1 * dx;
        }
    }

    fn advance_adjoint(
        &mut self,
        at: &Interval,
        _x: &[f64],
        _u: &[f64],
        lambda: &[f64],
        dx: &mut [f64],
        du: &mut [f64],
    ) {
        let [b0, b1] = self.scheme.stage(at).to;
        dx.fill(0.0);
        for ((l, du), dx) in lambda.iter().zip(du).zip(dx) {
            *du = b0 * l;
            *dx = b1 * l;
        }
    }
}
