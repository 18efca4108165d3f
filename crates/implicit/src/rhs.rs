//! Ordinary differential equations ẋ = f(t, x), and implicit steps for any of them.

use crate::{ImplicitStep, Interval, Refusal, Structure};

/// The right-hand side f of ẋ = f(t, x), with its derivative as products.
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

    /// Layout of ∂f/∂x for implicit steps; a sparse one must contain the diagonal.
    fn structure(&self) -> Structure {
        Structure::Dense
    }

    /// All values of ∂f/∂x in the layout of `structure`. By default column by column from `tangent`, which is right for
    /// a dense matrix; `unit` is work space of length `dim`.
    fn jacobian(&mut self, t: f64, x: &[f64], unit: &mut [f64], values: &mut [f64]) {
        for (j, column) in values.chunks_exact_mut(x.len()).enumerate() {
            unit.fill(0.0);
            unit[j] = 1.0;
            self.tangent(t, x, unit, column);
        }
    }
}

/// A one-leg step of ẋ = f(t, x): f is taken once, a share θ of the way through the step (Dahlquist 1975).
///
/// ```text
/// G(x_k, u) = u − x_k − Δt f(t_k + θ Δt, (1 − θ) x_k + θ u),   x_{k+1} = u
/// ```
///
/// θ = 1 is implicit Euler (first order, damps), θ = ½ the implicit midpoint rule (second order, keeps quadratic invariants).
#[derive(Debug, Clone)]
pub struct OneLeg<R> {
    rhs: R,
    structure: Structure,
    theta: f64,
    tolerance: f64,
    middle: Vec<f64>,
    product: Vec<f64>,
}

impl<R: Rhs> OneLeg<R> {
    /// Implicit Euler, x_{k+1} = x_k + Δt f(t_{k+1}, x_{k+1}). Newton's method ends when an update is below `tolerance` in
    /// its largest component.
    ///
    /// # Panics
    /// If a sparse pattern of ∂f/∂x leaves out the diagonal.
    pub fn implicit_euler(rhs: R, tolerance: f64) -> Self {
        Self::new(rhs, 1.0, tolerance)
    }

    /// The implicit midpoint rule, x_{k+1} = x_k + Δt f(t_{k+½}, ½(x_k + x_{k+1})). `tolerance` as for implicit Euler.
    ///
    /// # Panics
    /// If a sparse pattern of ∂f/∂x leaves out the diagonal.
    pub fn implicit_midpoint(rhs: R, tolerance: f64) -> Self {
        Self::new(rhs, 0.5, tolerance)
    }

    fn new(rhs: R, theta: f64, tolerance: f64) -> Self {
        let n = rhs.dim();
        let structure = rhs.structure();
        let on_diagonal = (0..n).all(|i| structure.diagonal(n, i).is_some());
        assert!(on_diagonal, "the pattern of ∂f/∂x must contain its diagonal");
        Self { rhs, structure, theta, tolerance, middle: vec![0.0; n], product: vec![0.0; n] }
    }

    /// The right-hand side.
    pub fn rhs(&self) -> &R {
        &self.rhs
    }

    /// Puts the point where f is taken into `self.middle`; returns its time.
    fn leg(&mut self, at: &Interval, x: &[f64], u: &[f64]) -> f64 {
        for ((m, x), u) in self.middle.iter_mut().zip(x).zip(u) {
            *m = (1.0 - self.theta) * x + self.theta * u;
        }
        at.start + self.theta * at.length
    }
}

impl<R: Rhs> ImplicitStep for OneLeg<R> {
    fn dim(&self) -> usize {
        self.rhs.dim()
    }

    fn structure(&self) -> Structure {
        self.structure.clone()
    }

    /// No change: what is stiff enough for an implicit step is too stiff for an explicit guess.
    fn predict(&mut self, _at: &Interval, x: &[f64], u: &mut [f64]) -> Result<(), Refusal> {
        u.copy_from_slice(x);
        Ok(())
    }

    fn assemble(
        &mut self,
        at: &Interval,
        x: &[f64],
        u: &[f64],
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let t = self.leg(at, x, u);
        self.rhs.eval(t, &self.middle, g);
        for ((g, x), u) in g.iter_mut().zip(x).zip(u) {
            *g = u - x - at.length * *g;
        }
        if let Some(values) = jacobian {
            self.rhs.jacobian(t, &self.middle, &mut self.product, values);
            values.iter_mut().for_each(|v| *v *= -self.theta * at.length);
            for i in 0..x.len() {
                values[self.structure.diagonal(x.len(), i).expect("checked in new")] += 1.0;
            }
        }
        Ok(None)
    }

    fn converged_below(&self) -> f64 {
        self.tolerance
    }

    fn previous(&mut self, at: &Interval, x: &[f64], u: &[f64], dx: &[f64], dg: &mut [f64]) {
        let t = self.leg(at, x, u);
        let share = (1.0 - self.theta) * at.length;
        self.rhs.tangent(t, &self.middle, dx, dg);
        dg.iter_mut().zip(dx).for_each(|(g, d)| *g = -d - share * *g);
    }

    fn previous_transpose_add(&mut self, at: &Interval, x: &[f64], u: &[f64], mu: &[f64], dx: &mut [f64]) {
        let t = self.leg(at, x, u);
        let share = (1.0 - self.theta) * at.length;
        self.product.fill(0.0);
        self.rhs.adjoint_add(t, &self.middle, mu, &mut self.product);
        for ((dx, mu), p) in dx.iter_mut().zip(mu).zip(&self.product) {
            *dx -= mu + share * p;
        }
    }
}
