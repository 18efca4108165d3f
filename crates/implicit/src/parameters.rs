//! Parameters of a step as part of its state.

use std::ops::Range;

use varda_linalg::dot;

use crate::{ImplicitStep, Interval, Multipliers, Refusal, SolvedStep, Structure};

/// A step whose equations G(x_k, u; p) = 0 depend on parameters p that do not change in time.
///
/// Each parameter is a number whose prior is about normal: a stiffness that must stay positive is the
/// exponential of one. The map S(x_k, u) does not depend on p, unless a step says how
/// ([`advance_parameters_tangent`](Self::advance_parameters_tangent)).
/// [`WithParameters`] makes of such a step one whose state has p in it.
pub trait ParametricStep: ImplicitStep {
    /// How many parameters there are.
    fn parameters(&self) -> usize;

    /// Takes these values from now on.
    ///
    /// # Errors
    /// Values at which there are no equations.
    fn set_parameters(&mut self, p: &[f64]) -> Result<(), Refusal>;

    /// The columns of ∂G/∂p at a solved step, one after the other. Called right after the equations of
    /// the step were prepared with these parameters, u accepted and [`ImplicitStep::keep`] called.
    fn parameter_jacobian(&mut self, of: &SolvedStep<'_>, columns: &mut [f64]);

    /// The columns of ∂x₀/∂p, one after the other and without a history, right after
    /// [`ImplicitStep::initial_state`]; zero where the first state follows from the control alone.
    fn initial_parameter_jacobian(&mut self, columns: &mut [f64]) {
        columns.fill(0.0);
    }

    /// dx_next (without a history) += ∂S/∂p dp; nothing where S(x_k, u) does not depend on p, as above.
    fn advance_parameters_tangent(&mut self, _of: &SolvedStep<'_>, _dp: &[f64], _dx_next: &mut [f64]) {}

    /// dp += (∂S/∂p)ᵀ λ.
    fn advance_parameters_adjoint(&mut self, _of: &SolvedStep<'_>, _lambda: &[f64], _dp: &mut [f64]) {}

    /// Whether the second derivatives with parameters below are given, for exact Hessians; false by default.
    fn has_second_parameters(&self) -> bool {
        false
    }

    /// The second derivatives of L = λᵀ S(x_k, u; p) + μᵀ G(x_k, u; p) with parameters, in the
    /// increments that products are given: the columns of ∂²L/∂x∂p (each as long as the step's state,
    /// history included), those of ∂²L/∂u∂p, and ∂²L/∂p² row by row, all overwritten. Called
    /// once for every λ and μ, right after [`ImplicitStep::keep_second`] with the same.
    fn keep_second_parameters(
        &mut self,
        _of: &SolvedStep<'_>,
        _lambda: &[f64],
        _mu: &[f64],
        _columns: [&mut [f64]; 2],
        _square: &mut [f64],
    ) {
    }

    /// Adds Σ_i λ_i ∂²x_{0,i}/∂(z, p)² times (dz, dp) to (out_z, out_p), at the control of the last
    /// `initial_state`. A step that gives `initial_parameter_jacobian` gives this, too.
    fn initial_second_parameters_add(
        &mut self,
        t: f64,
        [dz, _dp]: [&[f64]; 2],
        lambda: &[f64],
        [out_z, _out_p]: [&mut [f64]; 2],
    ) {
        self.initial_second_add(t, dz, lambda, out_z);
    }
}

/// A step with its parameters in the state: p_{k+1} = p_k (Evensen 2009, chapter 7, calls it the augmented
/// state). Tangent, adjoint, ensembles, covariances and posteriors of such a step see a state that is longer
/// by p, and nothing else changes.
///
/// ```text
/// x = [z, p, what follows from z]                     z: the control of the step, first in its state
/// tangent:  du = −(∂G/∂u)⁻¹ (∂G/∂x dx + ∂G/∂p dp),    dp ← dp
/// adjoint:  μ = −(∂G/∂u)⁻ᵀ (∂S/∂u)ᵀ λ,                λ_p ← λ_p + (∂G/∂p)ᵀ μ
/// ```
///
/// `carried` numbers stand behind the parameters and are kept constant likewise: what observations depend on
/// and the step does not, as the offset of a clock.
///
/// ∂G/∂p is kept with each linearization: a product takes one vector operation a parameter more, and no
/// further solve. So are, for exact Hessians, the columns of ∂²L/∂(x, u)∂p with L = λᵀS + μᵀG,
/// and ∂²L/∂p². Where x_{k−1} is part of the state, so is its p, on which nothing depends.
///
/// # Examples
///
/// Decay at an unknown rate, G = u − x + Δt p u, by backward Euler:
///
/// ```
/// use varda_implicit::{
///     Equations, ImplicitModel, ImplicitStep, Interval, Model, ParametricStep, Refusal, SolvedStep,
///     StepEquations, Structure, WithParameters, check,
/// };
///
/// struct Decay {
///     rate: f64,
/// }
///
/// /// (x, Δt p)
/// struct Next(f64, f64);
///
/// impl Equations for Next {
///     fn assemble(
///         &mut self,
///         u: &[f64],
///         g: &mut [f64],
///         jacobian: Option<&mut [f64]>,
///     ) -> Result<Option<f64>, Refusal> {
///         g[0] = u[0] * (1.0 + self.1) - self.0;
///         if let Some(values) = jacobian {
///             values[0] = 1.0 + self.1;
///         }
///         Ok(None)
///     }
///     fn converged_below(&self) -> f64 {
///         1e-14
///     }
/// }
///
/// impl StepEquations for Next {
///     fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
///         u[0] = self.0;
///         Ok(())
///     }
/// }
///
/// impl ImplicitStep for Decay {
///     type Equations<'a> = Next;
///
///     fn dim(&self) -> usize {
///         1
///     }
///     fn structure(&self) -> Structure {
///         Structure::Dense
///     }
///     fn equations(&mut self, at: &Interval, x: &[f64]) -> Result<Next, Refusal> {
///         Ok(Next(x[0], at.length * self.rate))
///     }
///     fn previous(&mut self, _: &SolvedStep, dx: &[f64], dg: &mut [f64]) {
///         dg[0] = -dx[0];
///     }
///     fn previous_transpose_add(&mut self, _: &SolvedStep, mu: &[f64], dx: &mut [f64]) {
///         dx[0] -= mu[0];
///     }
/// }
///
/// impl ParametricStep for Decay {
///     fn parameters(&self) -> usize {
///         1
///     }
///     fn set_parameters(&mut self, p: &[f64]) -> Result<(), Refusal> {
///         self.rate = p[0];
///         Ok(())
///     }
///     fn parameter_jacobian(&mut self, of: &SolvedStep, columns: &mut [f64]) {
///         columns[0] = of.at.length * of.u[0];
///     }
/// }
///
/// let mut model = ImplicitModel::new(WithParameters::new(Decay { rate: 0.0 }, 0), 0, 0.1);
/// let report = check::model(&mut model, &[1.0, 0.5], 3, &[0.1; 2], 1)?;
/// assert!(report.passed(), "{report}");
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug)]
pub struct WithParameters<S> {
    step: S,
    places: ParameterPlaces,
    /// Parameters of the equations; those behind are only carried along.
    active: usize,
    present: Vec<f64>,
    x: Vec<f64>,
    next: Vec<f64>,
    increment: Vec<f64>,
    /// The columns of ∂x₀/∂p.
    initial: Vec<f64>,
    /// λ of the step's own state: nothing until second derivatives are asked for.
    lambda: Vec<f64>,
}

/// Where the numbers of a step's own state stand in the longer one of [`WithParameters`].
///
/// ```
/// use varda_implicit::ParameterPlaces;
///
/// // [x₀, x₁, p, y], and the first two of the state before with its p
/// let places = ParameterPlaces::of_state(2, 1, 3, 2);
/// let mut own = [0.0; 5];
/// places.gather(&[1.0, 2.0, 7.0, 3.0, 4.0, 5.0], &mut own);
/// assert_eq!((own, places.parameters()), ([1.0, 2.0, 3.0, 4.0, 5.0], 2..3));
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParameterPlaces {
    /// Length of the step's control, after which p stands.
    control: usize,
    parameters: usize,
    /// Length of the step's own state and of its history.
    own: usize,
    history: usize,
}

impl ParameterPlaces {
    /// Those of a step with so many parameters.
    ///
    /// # Panics
    /// If the control of the step is longer than its state without history.
    pub fn of<S: ImplicitStep>(step: &S, parameters: usize) -> Self {
        let own = step.dim() - step.history();
        Self::of_state(step.control_dim(), parameters, own, step.history())
    }

    /// Those of a state that is led by `control` numbers, after which the parameters stand, and is `own` long
    /// without them and without `history` first numbers of the state before.
    ///
    /// # Panics
    /// If the control is longer than the state.
    pub fn of_state(control: usize, parameters: usize, own: usize, history: usize) -> Self {
        assert!(control <= own, "a control of {control} numbers does not lead a state of {own}");
        Self { control, parameters, own, history }
    }

    /// Length of the longer state.
    pub fn dim(&self) -> usize {
        self.own + self.parameters + self.history()
    }

    /// Length of the step's own state, history included.
    pub fn own_dim(&self) -> usize {
        self.own + self.history
    }

    /// Ranges of the longer state, own part first, then the history, that make up the step's state in order.
    fn ranges(&self) -> [Range<usize>; 4] {
        let &Self { control, parameters, own, history } = self;
        let start = own + parameters;
        let first = history.min(control);
        let after = start + control + parameters;
        [0..control, control + parameters..start, start..start + first, after..after + (history - first)]
    }

    fn history(&self) -> usize {
        self.history + if self.history > self.control { self.parameters } else { 0 }
    }

    /// Where the parameters stand, in the state as in the control.
    pub fn parameters(&self) -> Range<usize> {
        self.control..self.control + self.parameters
    }

    /// The step's state, or the part of it without history, out of the longer one.
    ///
    /// # Panics
    /// If a slice is too short.
    pub fn gather(&self, long: &[f64], x: &mut [f64]) {
        let mut to = x;
        for range in self.ranges().into_iter().filter(|r| r.end <= long.len()) {
            let (now, rest) = to.split_at_mut(range.len());
            now.copy_from_slice(&long[range]);
            to = rest;
        }
    }

    /// Puts the step's state into the longer one, whose p (and that of the history) it leaves.
    ///
    /// # Panics
    /// If a slice is too short.
    pub fn scatter(&self, x: &[f64], long: &mut [f64]) {
        let (mut from, length) = (x, long.len());
        for range in self.ranges().into_iter().filter(|r| r.end <= length) {
            let (now, rest) = from.split_at(range.len());
            long[range].copy_from_slice(now);
            from = rest;
        }
    }
}

impl<S: ParametricStep> WithParameters<S> {
    /// The step with all its parameters in the state, and `carried` constants behind them.
    ///
    /// # Panics
    /// If the control of the step is longer than its state without history.
    pub fn new(step: S, carried: usize) -> Self {
        let (own, active) = (step.dim() - step.history(), step.parameters());
        Self {
            places: ParameterPlaces::of(&step, active + carried),
            active,
            present: vec![f64::NAN; active],
            x: vec![0.0; step.dim()],
            next: vec![0.0; step.dim()],
            increment: vec![0.0; step.dim()],
            initial: vec![0.0; active * own],
            lambda: Vec::new(),
            step,
        }
    }

    /// Where the parameters and carried numbers stand in the state.
    pub fn places(&self) -> &ParameterPlaces {
        &self.places
    }

    /// The step itself, taken out.
    pub fn into_step(self) -> S {
        self.step
    }

    /// The step without its parameters, at their values in `long`, and its part of that state.
    ///
    /// # Errors
    /// Values at which there are no equations.
    pub fn at(&mut self, long: &[f64]) -> Result<(&mut S, &[f64]), Refusal> {
        self.take(long)?;
        Ok((&mut self.step, &self.x))
    }

    /// Takes the parameters of a state, and its other numbers into `x`.
    fn take(&mut self, long: &[f64]) -> Result<(), Refusal> {
        self.places.gather(long, &mut self.x);
        self.set(long)
    }

    fn set(&mut self, long: &[f64]) -> Result<(), Refusal> {
        let p = &long[self.places.control..][..self.active];
        let same = |(a, b): (&f64, &f64)| a.to_bits() == b.to_bits();
        if !p.iter().zip(&self.present).all(same) {
            // not these values, should they be refused
            self.present.fill(f64::NAN);
            self.step.set_parameters(p)?;
            self.present.copy_from_slice(p);
        }
        Ok(())
    }

    /// The step as its own products see it.
    fn own<'a>(&'a mut self, of: &SolvedStep<'a>) -> (&'a mut S, SolvedStep<'a>, &'a mut [f64]) {
        self.take(of.x).expect("the step was accepted with these parameters");
        let kept = &of.kept[..self.step.kept()];
        (&mut self.step, SolvedStep { at: of.at, x: &self.x, u: of.u, kept }, &mut self.next)
    }

    /// What second derivatives keep: the step's own, the columns of ∂²L/∂x∂p and ∂²L/∂u∂p,
    /// ∂²L/∂p², and whether a parameter has any that is not zero.
    fn second_lengths(&self) -> [usize; 5] {
        let (own, active) = (self.step.second_kept().unwrap_or(0), self.active);
        [own, active * self.step.dim(), active * self.step.unknowns(), active * active, active]
    }

    /// λ of the step's own state.
    fn own_lambda(&mut self, lambda: &[f64]) -> Vec<f64> {
        let mut own = std::mem::take(&mut self.lambda);
        own.resize(self.places.own, 0.0);
        self.places.gather(lambda, &mut own);
        own
    }

    /// The columns of ∂G/∂p that are not zero, with the parameter of each: errors in time of what moves a
    /// support act on few steps.
    fn columns<'a>(&self, of: &SolvedStep<'a>) -> impl Iterator<Item = (usize, &'a [f64])> + use<'a, S> {
        let (columns, acts) = of.kept[self.step.kept()..].split_at(self.active * of.u.len());
        let columns = columns.chunks_exact(of.u.len().max(1)).zip(acts).enumerate();
        columns.filter(|(_, (_, acts))| **acts != 0.0).map(|(p, (column, _))| (p, column))
    }
}

impl<S: ParametricStep> ImplicitStep for WithParameters<S> {
    type Equations<'a>
        = S::Equations<'a>
    where
        S: 'a;

    fn dim(&self) -> usize {
        self.places.dim()
    }

    fn history(&self) -> usize {
        self.places.history()
    }

    fn unknowns(&self) -> usize {
        self.step.unknowns()
    }

    fn structure(&self) -> Structure {
        self.step.structure()
    }

    fn equations<'a>(&'a mut self, at: &Interval, x: &'a [f64]) -> Result<S::Equations<'a>, Refusal> {
        self.take(x)?;
        self.step.equations(at, &self.x)
    }

    fn advance(&mut self, at: &Interval, x: &[f64], u: &[f64], x_next: &mut [f64]) {
        self.take(x).expect("the equations were solved with these parameters");
        let next = &mut self.next[..self.places.own];
        self.step.advance(at, &self.x, u, next);
        self.places.scatter(next, x_next);
        let p = self.places.parameters();
        x_next[p.clone()].copy_from_slice(&x[p]);
    }

    fn recover(&mut self, at: &Interval, x: &[f64], x_next: &[f64], u: &mut [f64]) {
        // parameters that are refused are so again where the equations are prepared
        let _ = self.take(x);
        let next = &mut self.next[..self.places.own];
        self.places.gather(x_next, next);
        self.step.recover(at, &self.x, next, u);
    }

    fn kept(&self) -> usize {
        self.step.kept() + self.active * (self.step.unknowns() + 1)
    }

    fn keep(&mut self, at: &Interval, x: &[f64], u: &[f64], kept: &mut [f64]) {
        self.take(x).expect("the equations were solved with these parameters");
        let (own, columns) = kept.split_at_mut(self.step.kept());
        self.step.keep(at, &self.x, u, own);
        let (columns, acts) = columns.split_at_mut(self.active * u.len());
        self.step.parameter_jacobian(&SolvedStep { at, x: &self.x, u, kept: own }, columns);
        for (acts, column) in acts.iter_mut().zip(columns.chunks_exact(u.len().max(1))) {
            *acts = f64::from(u8::from(column.iter().any(|c| *c != 0.0)));
        }
    }

    fn previous(&mut self, of: &SolvedStep<'_>, dx: &[f64], dg: &mut [f64]) {
        let places = self.places.clone();
        let columns = self.columns(of);
        let (step, own, inner) = self.own(of);
        places.gather(dx, inner);
        step.previous(&own, inner, dg);
        let dp = &dx[places.parameters()];
        for (p, column) in columns {
            dg.iter_mut().zip(column).for_each(|(dg, c)| *dg += c * dp[p]);
        }
    }

    fn previous_transpose_add(&mut self, of: &SolvedStep<'_>, mu: &[f64], dx: &mut [f64]) {
        let places = self.places.clone();
        let columns = self.columns(of);
        let (step, own, inner) = self.own(of);
        places.gather(dx, inner);
        step.previous_transpose_add(&own, mu, inner);
        places.scatter(inner, dx);
        let dp = &mut dx[places.parameters()];
        for (p, column) in columns {
            dp[p] += column.iter().zip(mu).map(|(c, m)| c * m).sum::<f64>();
        }
    }

    fn advance_tangent(&mut self, of: &SolvedStep<'_>, dx: &[f64], du: &[f64], dx_next: &mut [f64]) {
        let places = self.places.clone();
        let mut increment = std::mem::take(&mut self.increment);
        places.gather(dx, &mut increment);
        let active = self.active;
        let (step, own, next) = self.own(of);
        let next = &mut next[..places.own];
        step.advance_tangent(&own, &increment, du, next);
        step.advance_parameters_tangent(&own, &dx[places.parameters()][..active], next);
        places.scatter(next, dx_next);
        dx_next[places.parameters()].copy_from_slice(&dx[places.parameters()]);
        self.increment = increment;
    }

    fn advance_adjoint(&mut self, of: &SolvedStep<'_>, lambda: &[f64], dx: &mut [f64], du: &mut [f64]) {
        let places = self.places.clone();
        let mut increment = std::mem::take(&mut self.increment);
        let own_lambda = &mut increment[..places.own];
        places.gather(lambda, own_lambda);
        let active = self.active;
        let (step, own, back) = self.own(of);
        step.advance_adjoint(&own, own_lambda, back, du);
        dx.fill(0.0);
        places.scatter(back, dx);
        dx[places.parameters()].copy_from_slice(&lambda[places.parameters()]);
        step.advance_parameters_adjoint(&own, own_lambda, &mut dx[places.parameters()][..active]);
        self.increment = increment;
    }

    fn second_kept(&self) -> Option<usize> {
        let given = self.active == 0 || self.step.has_second_parameters();
        (given && self.step.second_kept().is_some()).then(|| self.second_lengths().iter().sum())
    }

    fn keep_second(&mut self, of: &SolvedStep<'_>, lambda: &[f64], mu: &[f64], kept: &mut [f64]) {
        let [own_kept, x, u, square, _] = self.second_lengths();
        let lambda = self.own_lambda(lambda);
        let (own_kept, rest) = kept.split_at_mut(own_kept);
        let (by_x, rest) = rest.split_at_mut(x);
        let (by_u, rest) = rest.split_at_mut(u);
        let (square, acts) = rest.split_at_mut(square);
        let active = self.active;
        let (step, own, next) = self.own(of);
        step.keep_second(&own, &lambda, mu, own_kept);
        if active > 0 {
            step.keep_second_parameters(&own, &lambda, mu, [&mut *by_x, &mut *by_u], square);
        }
        // errors in time of what moves a support act on few steps
        let columns = by_x.chunks_exact(next.len().max(1)).zip(by_u.chunks_exact(of.u.len().max(1)));
        for ((acts, (by_x, by_u)), row) in
            acts.iter_mut().zip(columns).zip(square.chunks_exact(active.max(1)))
        {
            let any = by_x.iter().chain(by_u).chain(row).any(|second| *second != 0.0);
            *acts = f64::from(u8::from(any));
        }
        self.lambda = lambda;
    }

    fn second_add(
        &mut self,
        of: &SolvedStep<'_>,
        at: &Multipliers<'_>,
        [dx, du]: [&[f64]; 2],
        [rx, ru]: [&mut [f64]; 2],
    ) {
        let places = self.places.clone();
        let [own_kept, x, u, square, _] = self.second_lengths();
        let (own_kept, rest) = at.kept.split_at(own_kept);
        let (by_x, rest) = rest.split_at(x);
        let (by_u, rest) = rest.split_at(u);
        let (square, acts) = rest.split_at(square);
        let lambda = self.own_lambda(at.lambda);
        let mut increment = std::mem::take(&mut self.increment);
        places.gather(dx, &mut increment);
        let active = self.active;
        let (step, own, back) = self.own(of);
        places.gather(rx, back);
        let multipliers = Multipliers { lambda: &lambda, mu: at.mu, kept: own_kept };
        step.second_add(&own, &multipliers, [&increment, du], [&mut *back, &mut *ru]);
        let p = places.control..places.control + active;
        let columns = by_x.chunks_exact(back.len().max(1)).zip(by_u.chunks_exact(du.len().max(1)));
        let all = columns.zip(square.chunks_exact(active.max(1))).zip(p.clone()).zip(acts);
        for ((((by_x, by_u), row), i), _) in all.filter(|(_, acts)| **acts != 0.0) {
            let dp = dx[i];
            back.iter_mut().zip(by_x).for_each(|(r, c)| *r += c * dp);
            ru.iter_mut().zip(by_u).for_each(|(r, c)| *r += c * dp);
            rx[i] += dot(by_x, &increment) + dot(by_u, du) + dot(row, &dx[p.clone()]);
        }
        places.scatter(back, rx);
        (self.increment, self.lambda) = (increment, lambda);
    }

    fn velocities(&self) -> Option<(Range<usize>, usize)> {
        self.step.velocities()
    }

    fn control_dim(&self) -> usize {
        self.places.control + self.places.parameters
    }

    fn initial_state(&mut self, t: f64, z: &[f64], x: &mut [f64]) -> Result<(), Refusal> {
        let p = self.places.parameters();
        self.set(z)?;
        let own = &mut self.next[..self.places.own];
        self.step.initial_state(t, &z[..p.start], own)?;
        self.places.scatter(own, x);
        x[p.clone()].copy_from_slice(&z[p]);
        self.step.initial_parameter_jacobian(&mut self.initial);
        Ok(())
    }

    fn initial_tangent(&mut self, t: f64, dz: &[f64], dx: &mut [f64]) {
        let p = self.places.parameters();
        let own = &mut self.next[..self.places.own];
        self.step.initial_tangent(t, &dz[..p.start], own);
        for (column, dp) in self.initial.chunks_exact(own.len()).zip(&dz[p.clone()]) {
            own.iter_mut().zip(column).for_each(|(dx, c)| *dx += c * dp);
        }
        self.places.scatter(own, dx);
        dx[p.clone()].copy_from_slice(&dz[p]);
    }

    fn initial_adjoint(&mut self, t: f64, lambda: &[f64], dz: &mut [f64]) {
        let p = self.places.parameters();
        let own = &mut self.next[..self.places.own];
        self.places.gather(lambda, own);
        self.step.initial_adjoint(t, own, &mut dz[..p.start]);
        dz[p.clone()].copy_from_slice(&lambda[p.clone()]);
        for (column, dp) in self.initial.chunks_exact(own.len()).zip(&mut dz[p]) {
            *dp += column.iter().zip(own.iter()).map(|(c, l)| c * l).sum::<f64>();
        }
    }

    fn initial_second_add(&mut self, t: f64, dz: &[f64], lambda: &[f64], out: &mut [f64]) {
        let (first, active) = (self.places.control, self.active);
        let lambda = self.own_lambda(lambda);
        let ((dz, dp), (out, out_p)) = (dz.split_at(first), out.split_at_mut(first));
        let (dp, out_p) = (&dp[..active], &mut out_p[..active]);
        self.step.initial_second_parameters_add(t, [dz, dp], &lambda, [out, out_p]);
        self.lambda = lambda;
    }
}
