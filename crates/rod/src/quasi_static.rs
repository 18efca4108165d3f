//! A rod that is at rest at every step: the equilibrium under its loads where its supports are.

use varda_implicit::{
    Equations, ImplicitStep, Interval, Multipliers, NewtonOptions, ParametricStep, Refusal, Scheme,
    SolvedStep, StepEquations, solve,
};
use varda_linalg::dot;

use crate::Error;
use crate::at_rest::{AtRest, SecondAtRest};
use crate::dynamics::RodStep;
use crate::statics::at_rest;
use crate::support::Damping;

/// A time in which nothing moves \[s\].
const INSTANT: f64 = 1e-9;

impl RodStep {
    /// The same rod at rest at every step, the supports where they are at its time: shapes without times, and
    /// motions so slow that inertia and damping do not show.
    ///
    /// ```text
    /// ∂E/∂u(Y, θ; p) − F_ext(t_{k+1}) = 0,   V_{k+1} = (X_{k+1} − X_k)/Δt
    /// ```
    ///
    /// The first state x₀ is such an equilibrium as well, the one that Newton's method finds downhill from
    /// the places of the control: it depends on parameters alone, ∂x₀/∂p = −(∂G/∂u)⁻¹
    /// ∂G/∂p, and not on the control, whose places only choose between equilibria. V₀ = 0. By backward
    /// Euler, the damping given is left out, loads see no velocity.
    ///
    /// ```
    /// use varda_implicit::{ImplicitModel, Model, WithParameters};
    /// use varda_rod::{Change, Clamp, ClampAt, Damping, Law, Loads, Material, Parameter, Rod, RodStep};
    /// use varda_rod::{Section, Supports, Vector3, straight_guess};
    ///
    /// // A cantilever of unknown stiffness: its tip sinks by w L⁴/(8 EI).
    /// let section = Section::circle(&Material::new(1e7, 0.5, 1100.0), 0.005);
    /// let rod = Rod::uniform_between(0.1, 40, &section, [true, false])?;
    /// let clamp = Clamp::new(ClampAt::Face, [0.0; 3], Vector3::x(), Vector3::z());
    /// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    /// let stiffness = Change { ei: rod.ei.clone(), ..Change::default() };
    /// let unknown = vec![Parameter { change: stiffness, law: Law::Exponential }];
    /// let supports = Supports::clamped_start(clamp);
    /// let step = RodStep::with_parameters(rod, supports, loads, Damping::default(), unknown)?.at_rest()?;
    /// let guess = straight_guess(step.rod(), step.supports(), 0.0, Vector3::x())?;
    /// let mut control = step.control_at_rest(&guess);
    /// let (n, tip) = (control.len(), 3 * step.free_vertices().len() - 1);
    /// control.push(0.0);
    /// let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, 1.0);
    /// let mut x = vec![0.0; model.dim()];
    /// model.initial_state(&control, &mut x)?;
    /// let sinks = 9.81 * section.mass_per_length * 0.1_f64.powi(4) / (8.0 * section.ei1);
    /// assert!((-x[tip] / sinks - 1.0).abs() < 0.015); // it is not quite linear any more
    ///
    /// // 1 % stiffer, it sinks 1 % less
    /// let (mut dz, mut dx) = (vec![0.0; n + 1], vec![0.0; model.dim()]);
    /// dz[n] = 0.01;
    /// model.initial_tangent(&dz, &mut dx);
    /// assert!((dx[tip] / (-0.01 * x[tip]) - 1.0).abs() < 0.03);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Value`] where sections have inertia against twist: nothing spins at rest; where neither a
    /// clamp nor two prescribed vertices hold the rod, which may then turn as it likes.
    pub fn at_rest(mut self) -> Result<RodStep, Error> {
        if let Some(&value) = self.rod().spin_inertia.first() {
            let expected = "none: nothing spins at rest";
            return Err(Error::Value { field: "spin_inertia", value, expected });
        }
        let supports = self.supports();
        let held = supports.prescribed.len();
        if supports.start.is_none() && supports.end.is_none() && held < 2 {
            let expected =
                "a clamp or two prescribed vertices: what turns about a point has no one equilibrium";
            return Err(Error::Value {
                field: "number of prescribed vertices",
                value: held as f64,
                expected,
            });
        }
        self = self.with_scheme(Scheme::BackwardEuler);
        self.damping = Damping::default();
        self.viscous = None;
        self.is_at_rest = true;
        let (unknowns, state) = (self.unknowns(), self.system.layout.state());
        let space = AtRest::new(&self.structure(), [unknowns, state, self.kept(), self.parameters()]);
        self.at_rest = Some(Box::new(space));
        Ok(self)
    }

    /// Replaces the first state by the equilibrium downhill from it.
    pub(crate) fn come_to_rest(&mut self, t: f64, x: &mut [f64]) -> Result<(), Refusal> {
        let Some(mut rest) = self.at_rest.take() else { return Ok(()) };
        rest.t = t;
        rest.second.lambda.clear();
        rest.from.clear();
        rest.from.extend_from_slice(x);
        let found = self.find_equilibrium(&mut rest, x);
        self.at_rest = Some(rest);
        found
    }

    /// The equilibrium downhill from `rest.from`, into x, and the factor of ∂G/∂u there.
    fn find_equilibrium(&mut self, rest: &mut AtRest, x: &mut [f64]) -> Result<(), Refusal> {
        let AtRest { t, from, u, kept, work, solver, factor, values, g, .. } = rest;
        let at = at_rest(*t);
        self.prepare(&at, from)?;
        self.system.scatter_state(from);
        self.system.gather(u);
        let mut equations = self.equations(&at, from)?;
        // as `equilibrium` has it
        let options = NewtonOptions::default().with_max_iterations(2000);
        solve(&mut equations, u, work, &options).map_err(|failure| failure.in_step(&at))?;
        equations.assemble(u, g, Some(values))?;
        equations.accepted(u)?;
        solver.factor(values, factor)?;
        self.keep(&at, from, u, kept);
        self.advance(&at, from, u, x);
        self.stand_still(x);
        Ok(())
    }

    /// No velocities: a step of no length has differences over zero there.
    fn stand_still(&self, x: &mut [f64]) {
        let places = 3 * self.system.layout.free_vertices.len();
        x[places..2 * places].fill(0.0);
    }

    /// The columns of ∂x₀/∂p at the equilibrium last found.
    pub(crate) fn rest_by_parameters(&mut self, into: &mut [f64]) {
        let Some(mut rest) = self.at_rest.take() else { return };
        let at = at_rest(rest.t);
        let AtRest { from, u, kept, solver, factor, columns, none, dp, .. } = &mut *rest;
        let of = SolvedStep { at: &at, x: from, u, kept };
        self.prepare(&at, from).expect("the equilibrium was found before");
        self.parameter_jacobian(&of, columns);
        let own = self.system.layout.state();
        let columns = columns.chunks_exact_mut(u.len().max(1));
        for (p, (column, into)) in columns.zip(into.chunks_exact_mut(own)).enumerate() {
            solver.solve(factor, column);
            column.iter_mut().for_each(|du| *du = -*du);
            self.advance_tangent(&of, none, column, into);
            dp.fill(0.0);
            dp[p] = 1.0;
            self.advance_parameters_tangent(&of, dp, into);
            self.stand_still(into);
        }
        self.at_rest = Some(rest);
    }

    /// Adds ∂²(λ·x₀)/∂p² dp at the equilibrium last found. With x₀ = S(u; p), G(u; p) = 0,
    /// L = λ·S + μ·G and μ = −(∂G/∂u)⁻ᵀ (∂S/∂u)ᵀ λ it is that of L along
    ///
    /// ```text
    /// δu = −(∂G/∂u)⁻¹ ∂G/∂p dp:
    /// L_pp dp + L_pu δu − (∂G/∂p)ᵀ (∂G/∂u)⁻ᵀ (L_uu δu + L_up dp)
    /// ```
    pub(crate) fn second_of_rest(&mut self, dp: &[f64], lambda: &[f64], out: &mut [f64]) {
        let Some(mut rest) = self.at_rest.take() else { return };
        let at = instant(rest.t);
        self.prepare(&at, &rest.from).expect("the equilibrium was found before");
        if rest.second.lambda != lambda {
            self.keep_second_of_rest(&mut rest, &at, lambda, dp.len());
        }
        let AtRest { from, u, kept, solver, factor, none, second, .. } = &mut *rest;
        let (n, m) = (u.len(), dp.len());
        let of = SolvedStep { at: &at, x: from, u, kept };
        let (mut du, mut on_u, mut on_x) = (vec![0.0; n], vec![0.0; n], vec![0.0; none.len()]);
        for (column, dp) in second.columns.chunks_exact(n.max(1)).zip(dp) {
            du.iter_mut().zip(column).for_each(|(du, column)| *du -= column * dp);
        }
        solver.solve(factor, &mut du);
        let multipliers = Multipliers { lambda: &second.lambda, mu: &second.mu, kept: &second.kept };
        self.second_add(&of, &multipliers, [none, &du], [&mut on_x, &mut on_u]);
        for (p, column) in second.by_u.chunks_exact(n.max(1)).enumerate() {
            on_u.iter_mut().zip(column).for_each(|(on, column)| *on += column * dp[p]);
            out[p] += dot(column, &du) + dot(&second.square[p * m..(p + 1) * m], dp);
        }
        solver.solve_transpose(factor, &mut on_u);
        for (out, column) in out.iter_mut().zip(second.columns.chunks_exact(n.max(1))) {
            *out -= dot(column, &on_u);
        }
        self.at_rest = Some(rest);
    }

    /// Those of L that do not depend on the increment, right after it was prepared.
    fn keep_second_of_rest(&mut self, rest: &mut AtRest, at: &Interval, lambda: &[f64], m: usize) {
        let AtRest { from, u, kept, solver, factor, none, second, .. } = rest;
        let (n, states) = (u.len(), none.len());
        let of = SolvedStep { at, x: from, u, kept };
        let zeros = |length: usize| vec![0.0; length];
        let mut placed = lambda.to_vec();
        self.stand_still(&mut placed);
        let (mut mu, mut columns) = (zeros(n), zeros(n * m));
        self.parameter_jacobian(&of, &mut columns);
        self.advance_adjoint(&of, &placed, &mut zeros(states), &mut mu);
        solver.solve_transpose(factor, &mut mu);
        mu.iter_mut().for_each(|mu| *mu = -*mu);
        let mut bands = zeros(self.second_kept().expect("asked before"));
        let (mut by_u, mut square) = (zeros(n * m), zeros(m * m));
        self.keep_second(&of, &placed, &mu, &mut bands);
        let both = [&mut zeros(states * m)[..], &mut by_u];
        self.keep_second_parameters(&of, &placed, &mu, both, &mut square);
        *second = SecondAtRest { lambda: lambda.to_vec(), mu, kept: bands, columns, by_u, square };
    }
}

/// A short interval that ends at t: velocities, which are left out of λ, are differences over it.
fn instant(t: f64) -> Interval {
    Interval { start: t - INSTANT, length: INSTANT, ..at_rest(t) }
}
