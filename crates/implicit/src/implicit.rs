//! A [`Model`] made from any [`ImplicitStep`].

use crate::newton::{self, NewtonFailure, NewtonOptions, NewtonWork};
use crate::substeps::{Linearized, Products, add, substep_bytes};
use crate::{ControlMap, Equations, Error, ImplicitStep, Interval, Model, SecondOrder, StepEquations, Work};
use crate::{Rate, VelocityRate};

/// Steps on a grid of time, each solved by Newton's method, with tangent and adjoint from kept factors
/// (paper 2.24, 2.25).
///
/// On a uniform grid step k runs from (first + k) Δt to (first + k + 1) Δt, both computed as products, so
/// that long runs do not drift; on a grid of one's own from `times[k]` to `times[k + 1]`.
///
/// ```text
/// G(x_k, u) = 0,   x_{k+1} = S(x_k, u)
/// tangent:  du = −(∂G/∂u)⁻¹ ∂G/∂x_k dx
///           dx ← ∂S/∂x_k dx + ∂S/∂u du
/// adjoint:  μ = −(∂G/∂u)⁻ᵀ (∂S/∂u)ᵀ λ
///           λ ← (∂S/∂x_k)ᵀ λ + (∂G/∂x_k)ᵀ μ
/// ```
///
/// **Halving.** Where Newton's method fails on a step, the step is taken in two halves, each of which may be
/// halved again, down to 1/64 of Δt; the substeps end in full states of the model, a warning tells of them,
/// and tangent and adjoint go through every one. M_k is discontinuous where that pattern changes.
///
/// **Two-step schemes** ([`ImplicitStep::history`]). x₀ has itself for a history, which step 0 does not
/// read (`Interval::previous` is `None` there). After a step in substeps the history is that of the whole
/// step again, so that M_k stays a function of k and x_k.
///
/// **Linearization** is a function of the pair (x_k, x_{k+1}) alone: u is recovered from x_{k+1}, assembled
/// and factored. A pair that does not satisfy the equations of the whole step comes from a step in substeps,
/// which is then run again to find them (unless it was the last one taken). Memory is allocated the first
/// time a step is linearized, and reused. [`Linearization::LastFactor`] saves assembly and factorization at
/// the price of a less exact derivative.
///
/// ```
/// use varda_implicit::{ImplicitModel, Model, OneLeg, lorenz::Lorenz63};
///
/// let mut model = ImplicitModel::new(OneLeg::implicit_euler(Lorenz63::default(), 1e-11), 0, 0.01);
/// let (x, mut next) = ([1.0, 3.0, 20.0], [0.0; 3]);
/// model.step(0, &x, &mut next)?;
/// let work = model.linearize(0, 0, &x, &next)?;
/// assert_eq!(work.factorizations, 1);
/// let mut lambda = [0.0, 0.0, 1.0];
/// model.adjoint(0, &mut lambda); // ∂z₁/∂x₀
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug)]
pub struct ImplicitModel<S> {
    step: S,
    grid: Grid,
    options: NewtonOptions,
    linearization: Linearization,
    work: NewtonWork,
    last: Substeps,
    /// Whether `work` still holds the last factor of the last step.
    last_factor: bool,
    slots: Vec<Linearized>,
    u: Vec<f64>,
    /// λ of the initial state without the history.
    sum: Vec<f64>,
    products: Products,
}

/// Where the steps are in time.
#[derive(Debug, Clone)]
enum Grid {
    Uniform { first: usize, length: f64 },
    Times(Vec<f64>),
}

impl Grid {
    fn time(&self, k: usize) -> f64 {
        match self {
            Grid::Uniform { first, length } => (first + k) as f64 * length,
            Grid::Times(times) => times[k],
        }
    }

    fn length(&self, k: usize) -> f64 {
        match self {
            Grid::Uniform { length, .. } => *length,
            Grid::Times(times) => times[k + 1] - times[k],
        }
    }

    fn step(&self, k: usize) -> Interval {
        if let Grid::Times(times) = self {
            assert!(k + 1 < times.len(), "step {k} of a grid of {} steps", times.len() - 1);
        }
        let previous = k.checked_sub(1).map(|before| self.length(before));
        Interval { index: k, start: self.time(k), length: self.length(k), previous }
    }
}

/// The substeps of one step: where they are in time, and the states between them (one more than substeps).
#[derive(Debug, Default)]
struct Substeps {
    step: Option<usize>,
    at: Vec<Interval>,
    states: Vec<f64>,
}

/// At which point ∂G/∂u of a linearization is taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Linearization {
    /// At the accepted (x_k, x_{k+1}): exact, and the same bits under every [`Storage`](crate::Storage). One
    /// assembly and one factorization more per step.
    #[default]
    Accepted,
    /// Where a step is linearized right after it was taken (in one piece): at the last iterate but one of
    /// Newton's method, whose factor is taken over for nothing. The gradient is then wrong by the size of the
    /// last accepted update, which no dot-product test sees, and which may be far above
    /// [`converged_below`](crate::Equations::converged_below) where the next one was foretold. Other
    /// linearizations are exact: [`Counts::reused`](crate::Counts::reused) tells how many were not.
    LastFactor,
}

/// A step may be halved this many times.
pub const MAX_HALVINGS: u32 = 6;
/// A pair of states solves the whole step if Newton's method asks for no more than this many times its
/// threshold.
const SOLVED: f64 = 100.0;
/// Substeps of the shortest length in a step.
const SHORTEST: usize = 1 << MAX_HALVINGS;

impl<S: ImplicitStep> ImplicitModel<S> {
    /// A model whose step k starts at (first_index + k) · length seconds.
    ///
    /// # Panics
    /// If the length is not positive and finite, or the history is longer than the rest of the state.
    pub fn new(step: S, first_index: usize, length: f64) -> Self {
        assert!(length > 0.0 && length.is_finite(), "a step needs a positive length, not {length}");
        Self::on(Grid::Uniform { first: first_index, length }, step)
    }

    /// A model whose step k runs from `times[k]` to `times[k + 1]` (s); it has no steps beyond the last time.
    ///
    /// # Panics
    /// If there are fewer than two times or they do not ascend, or the history is longer than the rest of the
    /// state.
    pub fn on_times(step: S, times: Vec<f64>) -> Self {
        let ascending = times.windows(2).all(|t| t[0] < t[1] && t[1].is_finite());
        assert!(times.len() > 1 && ascending, "a grid of time needs two or more ascending times");
        Self::on(Grid::Times(times), step)
    }

    fn on(grid: Grid, step: S) -> Self {
        let (n, unknowns, history) = (step.dim(), step.unknowns(), step.history());
        assert!(
            2 * history <= n,
            "a history of {history} values repeats more than the rest of a state of \
            {n}"
        );
        Self {
            work: NewtonWork::new(unknowns, &step.structure()),
            step,
            grid,
            options: NewtonOptions::default(),
            linearization: Linearization::default(),
            last: Substeps::default(),
            last_factor: false,
            slots: Vec::new(),
            u: vec![0.0; unknowns],
            sum: vec![0.0; n],
            products: Products::new(n, unknowns, history),
        }
    }

    /// The same model with other limits for Newton's method.
    pub fn with_options(mut self, options: NewtonOptions) -> Self {
        self.options = options;
        self
    }

    /// The same model with another choice of where steps are linearized.
    pub fn with_linearization(mut self, linearization: Linearization) -> Self {
        self.linearization = linearization;
        self
    }

    /// Where steps are linearized.
    pub fn linearization(&self) -> Linearization {
        self.linearization
    }

    /// The step.
    pub fn step_ref(&self) -> &S {
        &self.step
    }

    /// The step, to change what it may change between runs.
    pub fn step_mut(&mut self) -> &mut S {
        self.last.step = None;
        &mut self.step
    }

    /// The step, taken out of the model.
    pub fn into_inner(self) -> S {
        self.step
    }

    /// Time at the start of step k (s).
    ///
    /// # Panics
    /// If a grid of times does not reach so far.
    pub fn time(&self, k: usize) -> f64 {
        self.grid.time(k)
    }

    /// Allocates now what the linearizations in slots 0 … slots−1 need, one substep each.
    pub fn reserve(&mut self, slots: usize) {
        for slot in 0..slots {
            self.slot(slot);
        }
    }

    /// The slot, with room for one substep at least.
    fn slot(&mut self, slot: usize) -> &mut Linearized {
        if self.slots.len() <= slot {
            self.slots.resize_with(slot + 1, Linearized::default);
        }
        self.slots[slot].place(0, self.sum.len(), self.u.len(), self.step.kept(), &self.work.solver);
        &mut self.slots[slot]
    }

    /// Runs step k into `self.last`.
    fn run(&mut self, k: usize, x: &[f64], did: &mut Work) -> Result<(), Error> {
        let n = x.len();
        self.last_factor = false;
        let own = n - self.step.history();
        let Self { step, grid, options, work, last, u, .. } = self;
        let Substeps { step: last_step, at: substeps, states } = last;
        *last_step = None;
        substeps.clear();
        states.clear();
        states.extend_from_slice(x);
        let whole = grid.step(k);
        // in units of the shortest substep: where the next one begins, and how long it is to be
        let (mut position, mut size) = (0, SHORTEST);
        while position < SHORTEST {
            let at = Interval {
                index: k,
                start: whole.start + whole.length * position as f64 / SHORTEST as f64,
                length: whole.length * size as f64 / SHORTEST as f64,
                previous: substeps.last().map_or(whole.previous, |before| Some(before.length)),
            };
            let from = substeps.len() * n;
            states.resize(from + 2 * n, 0.0);
            let (x, x_next) = states[from..].split_at_mut(n);
            let warning = match solve_substep(step, &at, size < SHORTEST, x, u, work, options, did) {
                Ok(warning) => warning,
                Err(Unsolved::Newton(_)) if size > 1 => {
                    size /= 2;
                    continue;
                }
                Err(Unsolved::Newton(error) | Unsolved::Refused(error)) => return Err(error),
            };
            step.advance(&at, x, u, &mut x_next[..own]);
            x_next[own..].copy_from_slice(&x[..n - own]);
            if !x_next.iter().all(|v| v.is_finite()) {
                return Err(Error::NonFinite { step: k, what: "x_{k+1}" });
            }
            did.warnings.extend(warning);
            substeps.push(at);
            position += size;
            // after the second half of an interval comes the next whole one
            while position < SHORTEST && position.is_multiple_of(2 * size) {
                size *= 2;
            }
        }
        // to the next step, the step before it is the whole of this one
        let end = states.len() - n;
        states.copy_within(..n - own, end + own);
        *last_step = Some(k);
        self.last_factor = true;
        Ok(())
    }

    /// Whether the last step run was k from x to x_next.
    fn is_last(&self, k: usize, x: &[f64], x_next: &[f64]) -> bool {
        let states = &self.last.states;
        self.last.step == Some(k) && states.starts_with(x) && states.ends_with(x_next)
    }

    /// Takes over the last factor of Newton's method for a step just taken in one piece.
    fn take_last_factor(
        &mut self,
        slot: usize,
        x: &[f64],
        x_next: &[f64],
        did: &mut Work,
    ) -> Result<(), Error> {
        let Self { step, work, slots, last, .. } = self;
        let substep = &mut slots[slot].substeps[0];
        substep.at = last.at[0];
        substep.x.copy_from_slice(x);
        step.recover(&substep.at, x, &x_next[..x.len() - step.history()], &mut substep.u);
        std::mem::swap(&mut substep.factor, &mut work.factor);
        self.last_factor = false;
        did.reused += 1;
        let refused = |reason| Error::refused(substep.at.index, reason);
        let mut equations = step.equations(&substep.at, x).map_err(refused)?;
        did.warnings.extend(equations.accepted(&substep.u).map_err(refused)?);
        drop(equations);
        step.keep(&substep.at, x, &substep.u, &mut substep.kept);
        Ok(())
    }

    /// Linearizes substep p in a slot. Returns whether x_next solves its equations: the Newton update that
    /// they still ask for is small. A `known` substep was run before and is a solution.
    fn linearize_substep(
        &mut self,
        slot: usize,
        p: usize,
        known: bool,
        at: Interval,
        x: &[f64],
        x_next: &[f64],
        did: &mut Work,
    ) -> Result<bool, Error> {
        let k = at.index;
        let refused = |reason| Error::refused(k, reason);
        let Self { step, work, slots, .. } = self;
        let substep = slots[slot].place(p, x.len(), self.u.len(), step.kept(), &work.solver);
        substep.at = at;
        substep.x.copy_from_slice(x);
        let own = x.len() - step.history();
        step.recover(&at, x, &x_next[..own], &mut substep.u);
        let mut equations = step.equations(&at, x).map_err(refused)?;
        equations.assemble(&substep.u, &mut work.g, Some(&mut work.values)).map_err(refused)?;
        did.factorizations += 1;
        work.solver
            .factor(&work.values, &mut substep.factor)
            .map_err(|bad| Error::SingularJacobian { step: k, row: bad.row })?;
        work.solver.solve(&substep.factor, &mut work.g);
        let solved = equations.size(&work.g) <= SOLVED * equations.converged_below();
        if solved || known {
            did.warnings.extend(equations.accepted(&substep.u).map_err(refused)?);
            drop(equations);
            step.keep(&at, x, &substep.u, &mut substep.kept);
        }
        Ok(solved)
    }
}

/// Why a substep was not taken.
enum Unsolved {
    /// Newton's method found no solution: half the interval may have one.
    Newton(Error),
    /// The solution was refused.
    Refused(Error),
}

/// Solves the equations of one substep for u, `part` of a whole on which both first guesses failed; returns
/// the step's warning.
fn solve_substep<S: ImplicitStep>(
    step: &mut S,
    at: &Interval,
    part: bool,
    x: &[f64],
    u: &mut [f64],
    work: &mut NewtonWork,
    options: &NewtonOptions,
    did: &mut Work,
) -> Result<Option<String>, Unsolved> {
    let refused = |reason| Error::refused(at.index, reason);
    let mut equations = step.equations(at, x).map_err(|reason| Unsolved::Newton(refused(reason)))?;
    let took = |work: &NewtonWork| [work.report().iterations, work.report().factorizations];
    let mut solved = Err(NewtonFailure::NonFinite { what: "the guess" });
    // the cautious guess first, where the bold one has failed already
    for cautious in [part, !part] {
        let guess =
            if cautious { equations.predict_again(u) } else { equations.predict(u).map(|()| Some([0, 0])) };
        let Some(spent) = guess.map_err(|reason| Unsolved::Newton(refused(reason)))? else { continue };
        solved = newton::solve(&mut equations, u, work, options);
        for [iterations, factorizations] in [spent, took(work)] {
            did.newton_iterations += iterations;
            did.factorizations += factorizations;
        }
        if solved.is_ok() {
            break;
        }
    }
    solved.map_err(|failure| Unsolved::Newton(failure.in_step(at)))?;
    equations.accepted(u).map_err(|reason| Unsolved::Refused(refused(reason)))
}

impl<S: ImplicitStep> Model for ImplicitModel<S> {
    fn dim(&self) -> usize {
        self.sum.len()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        assert!(x.len() == self.dim() && x_next.len() == self.dim(), "a state has {} values", self.dim());
        let mut did = Work::default();
        self.run(k, x, &mut did)?;
        let substeps = self.last.at.len();
        if substeps > 1 {
            did.substeps += substeps - 1;
            did.warnings.push(format!("taken in {substeps} parts: Newton's method failed on the whole"));
        }
        let n = x.len();
        x_next.copy_from_slice(&self.last.states[substeps * n..]);
        Ok(did)
    }

    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error> {
        assert!(x.len() == self.dim() && x_next.len() == self.dim(), "a state has {} values", self.dim());
        let mut did = Work::default();
        self.slot(slot).forget();
        if self.linearization == Linearization::LastFactor
            && self.last_factor
            && self.last.at.len() == 1
            && self.is_last(k, x, x_next)
        {
            self.take_last_factor(slot, x, x_next, &mut did)?;
            self.slots[slot].used = 1;
            return Ok(did);
        }
        let whole = self.grid.step(k);
        let solved = self.linearize_substep(slot, 0, false, whole, x, x_next, &mut did);
        if let Ok(true) = solved {
            self.slots[slot].used = 1;
            return Ok(did);
        }
        // not a solution over the whole step: it was taken in substeps
        if !self.is_last(k, x, x_next) {
            self.run(k, x, &mut did)?;
            if !self.is_last(k, x, x_next) {
                return solved.and(Err(Error::NotAStep { step: k }));
            }
        }
        let last = std::mem::take(&mut self.last);
        let n = x.len();
        for (p, at) in last.at.iter().enumerate() {
            let (x, x_next) = last.states[p * n..(p + 2) * n].split_at(n);
            self.linearize_substep(slot, p, true, *at, x, x_next, &mut did)?;
        }
        self.slots[slot].used = last.at.len();
        self.last = last;
        Ok(did)
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        let n = self.dim();
        assert!(dx.len().is_multiple_of(n), "a column has {n} values");
        let Self { step, work, slots, products, .. } = self;
        let substeps = linearized(slots, slot);
        if dx.len() == n {
            products.tangent(step, &mut work.solver, substeps, dx);
        } else {
            products.tangent_of_many(step, &mut work.solver, substeps, n, dx);
        }
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        let n = self.dim();
        assert!(lambda.len().is_multiple_of(n), "a column has {n} values");
        let Self { step, work, slots, products, .. } = self;
        let substeps = linearized(slots, slot);
        if lambda.len() == n {
            products.adjoint(step, &mut work.solver, substeps, lambda);
        } else {
            products.adjoint_of_many(step, &mut work.solver, substeps, n, lambda);
        }
    }

    fn release(&mut self, from_slot: usize) {
        self.slots.truncate(from_slot);
        self.slots.shrink_to(from_slot);
    }

    fn slot_bytes(&self) -> usize {
        size_of::<Linearized>()
            + substep_bytes(self.dim() + self.u.len() + self.step.kept(), &self.work.factor)
    }

    fn bytes(&self) -> usize {
        self.slots.iter().map(Linearized::bytes).sum()
    }

    fn rate(&self) -> Option<Box<dyn Rate>> {
        let (positions, first) = self.step.velocities()?;
        let grid = self.grid.clone();
        Some(Box::new(VelocityRate::new(positions, first, move |k| grid.step(k).length)))
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        Some(self)
    }

    fn second_order(&mut self) -> Option<&mut dyn SecondOrder> {
        if self.step.second_kept().is_some() { Some(self) } else { None }
    }
}

impl<S: ImplicitStep> SecondOrder for ImplicitModel<S> {
    fn tangent_kept(&mut self, slot: usize, dx: &mut [f64]) {
        assert_eq!(dx.len(), self.dim(), "a column has {} values", self.dim());
        let Self { step, work, slots, products, .. } = self;
        linearized(slots, slot);
        products.tangent_kept(step, &mut work.solver, &mut slots[slot], dx);
    }

    fn adjoint_derivative(
        &mut self,
        slot: usize,
        dx: &[f64],
        lambda: &[f64],
        derivative: &mut [f64],
    ) -> Result<(), Error> {
        let n = self.dim();
        assert!([dx.len(), lambda.len(), derivative.len()] == [n; 3], "a state has {n} values");
        let Self { step, work, slots, products, .. } = self;
        let k = linearized(slots, slot)[0].at.index;
        products.adjoint_derivative(step, &mut work.solver, &mut slots[slot], [dx, lambda], derivative);
        if derivative.iter().all(|d| d.is_finite()) {
            Ok(())
        } else {
            Err(Error::NonFinite { step: k, what: "the second derivative of x_{k+1}" })
        }
    }

    fn initial_adjoint_derivative(&mut self, delta: &[f64], lambda: &[f64], dz: &mut [f64]) {
        let t = self.time(0);
        let (own, history) = lambda.split_at(lambda.len() - self.step.history());
        let sum = &mut self.sum[..own.len()];
        sum.copy_from_slice(own);
        add(&mut sum[..history.len()], history);
        self.step.initial_second_add(t, delta, sum, dz);
    }
}

impl<S: ImplicitStep> ControlMap for ImplicitModel<S> {
    fn control_len(&self) -> usize {
        self.step.control_dim()
    }

    fn to_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        let t = self.time(0);
        let (own, history) = x.split_at_mut(x.len() - self.step.history());
        self.step.initial_state(t, z, own).map_err(|reason| Error::refused(0, reason))?;
        history.copy_from_slice(&own[..history.len()]);
        if !x.iter().all(|v| v.is_finite()) {
            return Err(Error::NonFinite { step: 0, what: "the initial state" });
        }
        Ok(())
    }

    fn to_state_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        let t = self.time(0);
        let (own, history) = dx.split_at_mut(dx.len() - self.step.history());
        self.step.initial_tangent(t, dz, own);
        history.copy_from_slice(&own[..history.len()]);
    }

    fn to_state_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        let t = self.time(0);
        let (own, history) = lambda.split_at(lambda.len() - self.step.history());
        let sum = &mut self.sum[..own.len()];
        sum.copy_from_slice(own);
        add(&mut sum[..history.len()], history);
        self.step.initial_adjoint(t, sum, dz);
    }
}

fn linearized(slots: &[Linearized], slot: usize) -> &[crate::substeps::Substep] {
    let kept = slots.get(slot).filter(|kept| kept.used > 0);
    let kept = kept.unwrap_or_else(|| panic!("slot {slot} holds no linearization"));
    &kept.substeps[..kept.used]
}
