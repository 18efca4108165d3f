//! Implicit steps of any ẋ = f(t, x).

use crate::rhs::Jacobian;
use crate::{
    Equations, ImplicitStep, Interval, Multipliers, ParametricRhs, ParametricStep, Refusal, Rhs, Scheme,
    SolvedStep, Stage, StepEquations, Structure,
};

/// A one-leg step of ẋ = f(t, x) by one of the schemes of [`Scheme`]: f is taken once, at the stage y.
///
/// ```text
/// G(x_k, u) = u − x* − η f(t*, u),   x_{k+1} = b₀ u + b₁ x_k
/// ```
///
/// The state of BDF2 is [x_k, x_{k−1}], its control x₀.
///
/// The first Jacobian that is assembled is held against `tangent` along one direction: a [`Rhs::jacobian`]
/// that disagrees, or a [`Rhs::structure`] that leaves out an entry, is an error before the first step is
/// taken ([`Error::JacobianDisagrees`](crate::Error::JacobianDisagrees)).
///
/// ```
/// use varda_implicit::{ImplicitModel, Model, OneLeg, Scheme, lorenz::Lorenz63};
///
/// for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
///     let mut model = ImplicitModel::new(OneLeg::new(Lorenz63::default(), scheme, 1e-11), 0, 0.01);
///     let mut x = vec![0.0; model.dim()]; // BDF2: with the state before
///     model.initial_state(&[1.0, 3.0, 20.0], &mut x)?;
///     let mut next = x.clone();
///     let work = model.step(0, &x, &mut next)?;
///     assert!(work.newton_iterations <= 5, "{scheme:?}");
/// }
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct OneLeg<R> {
    rhs: R,
    scheme: Scheme,
    tolerance: f64,
    jacobian: Jacobian,
    /// Work space of second derivatives.
    product: Vec<f64>,
}

impl<R: Rhs> OneLeg<R> {
    /// Implicit Euler, x_{k+1} = x_k + Δt f(t_{k+1}, x_{k+1}). Newton's method ends when an update is below
    /// `tolerance` in its largest component.
    ///
    /// # Panics
    /// If the tolerance is not positive, or a sparse pattern of ∂f/∂x is not one of `dim` columns or
    /// leaves out the diagonal.
    pub fn implicit_euler(rhs: R, tolerance: f64) -> Self {
        Self::new(rhs, Scheme::BackwardEuler, tolerance)
    }

    /// The implicit midpoint rule, x_{k+1} = x_k + Δt f(t_{k+½}, ½(x_k + x_{k+1})). `tolerance` as for
    /// implicit Euler.
    ///
    /// # Panics
    /// If the tolerance is not positive, or a sparse pattern of ∂f/∂x is not one of `dim` columns or
    /// leaves out the diagonal.
    pub fn implicit_midpoint(rhs: R, tolerance: f64) -> Self {
        Self::new(rhs, Scheme::Midpoint, tolerance)
    }

    /// BDF2, (3 x_{k+1} − 4 x_k + x_{k−1})/(2Δt) = f(t_{k+1}, x_{k+1}), after one midpoint step.
    /// `tolerance` as for implicit Euler.
    ///
    /// # Panics
    /// If the tolerance is not positive, or a sparse pattern of ∂f/∂x is not one of `dim` columns or
    /// leaves out the diagonal.
    pub fn bdf2(rhs: R, tolerance: f64) -> Self {
        Self::new(rhs, Scheme::Bdf2, tolerance)
    }

    /// Any of the three.
    ///
    /// # Panics
    /// If the tolerance is not positive, or a sparse pattern of ∂f/∂x is not one of `dim` columns or
    /// leaves out the diagonal.
    pub fn new(rhs: R, scheme: Scheme, tolerance: f64) -> Self {
        let n = rhs.dim();
        let structure = rhs.structure();
        assert!(tolerance > 0.0 && tolerance.is_finite(), "a tolerance must be positive, not {tolerance}");
        if let Err(error) = structure.check(n) {
            panic!("the structure of ∂f/∂x: {error}");
        }
        let on_diagonal = (0..n).all(|i| structure.diagonal(n, i).is_some());
        assert!(on_diagonal, "the pattern of ∂f/∂x must contain its diagonal");
        Self { rhs, scheme, tolerance, jacobian: Jacobian::new(n, structure), product: vec![0.0; n] }
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

impl<R: ParametricRhs> ParametricStep for OneLeg<R> {
    fn parameters(&self) -> usize {
        self.rhs.parameters()
    }

    fn set_parameters(&mut self, p: &[f64]) -> Result<(), Refusal> {
        self.rhs.set_parameters(p);
        Ok(())
    }

    /// ∂G/∂p = −η ∂f/∂p(t*, u).
    fn parameter_jacobian(&mut self, of: &SolvedStep<'_>, columns: &mut [f64]) {
        let stage = self.scheme.stage(of.at);
        self.rhs.parameter_jacobian(stage.time, of.u, columns);
        columns.iter_mut().for_each(|c| *c *= -stage.length);
    }

    fn has_second_parameters(&self) -> bool {
        self.rhs.has_second_parameters()
    }

    /// Those of −η μᵀf(t*, u).
    fn keep_second_parameters(
        &mut self,
        of: &SolvedStep<'_>,
        _lambda: &[f64],
        mu: &[f64],
        [by_x, by_u]: [&mut [f64]; 2],
        square: &mut [f64],
    ) {
        let stage = self.scheme.stage(of.at);
        by_x.fill(0.0);
        self.rhs.second_parameters(stage.time, of.u, mu, by_u, square);
        by_u.iter_mut().chain(square).for_each(|c| *c *= -stage.length);
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

    fn previous(&mut self, of: &SolvedStep<'_>, dx: &[f64], dg: &mut [f64]) {
        let [a0, a1] = self.scheme.stage(of.at).from;
        dg.iter_mut().zip(dx).for_each(|(g, d)| *g = -a0 * d);
        if a1 != 0.0 {
            let before = &dx[dg.len()..];
            dg.iter_mut().zip(before).for_each(|(g, d)| *g -= a1 * d);
        }
    }

    fn previous_transpose_add(&mut self, of: &SolvedStep<'_>, mu: &[f64], dx: &mut [f64]) {
        let [a0, a1] = self.scheme.stage(of.at).from;
        dx.iter_mut().zip(mu).for_each(|(d, m)| *d -= a0 * m);
        if a1 != 0.0 {
            dx[mu.len()..].iter_mut().zip(mu).for_each(|(d, m)| *d -= a1 * m);
        }
    }

    fn advance_tangent(&mut self, of: &SolvedStep<'_>, dx: &[f64], du: &[f64], dx_next: &mut [f64]) {
        let [b0, b1] = self.scheme.stage(of.at).to;
        for ((next, du), dx) in dx_next.iter_mut().zip(du).zip(dx) {
            *next = b0 * du + b1 * dx;
        }
    }

    fn second_kept(&self) -> Option<usize> {
        // f is asked itself
        self.rhs.has_second_derivatives().then_some(0)
    }

    /// ∂²L/∂u² = −η Σ_i μ_i ∂²f_i/∂x²; the rest of G and S is linear.
    fn second_add(
        &mut self,
        of: &SolvedStep<'_>,
        at: &Multipliers<'_>,
        [_, du]: [&[f64]; 2],
        [_, ru]: [&mut [f64]; 2],
    ) {
        let stage = self.scheme.stage(of.at);
        self.product.fill(0.0);
        self.rhs.second_adjoint_add(stage.time, of.u, du, at.mu, &mut self.product);
        ru.iter_mut().zip(&self.product).for_each(|(r, p)| *r -= stage.length * p);
    }

    fn advance_adjoint(&mut self, of: &SolvedStep<'_>, lambda: &[f64], dx: &mut [f64], du: &mut [f64]) {
        let [b0, b1] = self.scheme.stage(of.at).to;
        dx.fill(0.0);
        for ((l, du), dx) in lambda.iter().zip(du).zip(dx) {
            *du = b0 * l;
            *dx = b1 * l;
        }
    }
}
