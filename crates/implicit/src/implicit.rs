//! A [`Model`] made from any [`ImplicitStep`].

use crate::block::Block;
use crate::newton::{self, NewtonOptions, NewtonWork};
use crate::{Counts, Error, ImplicitStep, Interval, Model, Warning};
use varda_linalg::Factor;

/// Steps on a grid of time, each solved by Newton's method, with tangent and adjoint from kept factors (paper 2.24, 2.25).
///
/// On a uniform grid step k runs from (first + k) Δt to (first + k + 1) Δt, both computed as products, so that long runs
/// do not drift; on a grid of one's own from `times[k]` to `times[k + 1]`.
///
/// ```text
/// G(x_k, u) = 0,   x_{k+1} = S(x_k, u)
/// tangent:  du = −(∂G/∂u)⁻¹ ∂G/∂x_k dx,   dx ← ∂S/∂x_k dx + ∂S/∂u du
/// adjoint:  μ = −(∂G/∂u)⁻ᵀ (∂S/∂u)ᵀ λ,     λ ← (∂S/∂x_k)ᵀ λ + (∂G/∂x_k)ᵀ μ
/// ```
///
/// **Halving.** Where Newton's method fails on a step, the step is taken in two halves, each of which may be halved again, down
/// to 1/64 of Δt; the parts are full states of the model, a [`Warning`] tells of them, and tangent and adjoint go through
/// every one. M_k is discontinuous where that pattern changes.
///
/// **Two-step schemes** ([`ImplicitStep::history`]). x₀ has itself for a history, which step 0 does not read
/// (`Interval::previous` is `None` there). After a step in parts the history is that of the whole step again, so that M_k
/// stays a function of k and x_k.
///
/// **Linearization** is a function of the pair (x_k, x_{k+1}) alone: u is recovered from x_{k+1}, assembled and factored. A
/// pair that does not satisfy the equations of the whole step comes from a step in parts, which is then run again to find
/// them (unless it was the last one taken). Memory is allocated the first time a step is linearized, and reused.
/// [`Linearization::LastFactor`] saves assembly and factorization at the price of a less exact derivative.
#[derive(Debug)]
pub struct ImplicitModel<S> {
    step: S,
    grid: Grid,
    options: NewtonOptions,
    linearization: Linearization,
    work: NewtonWork,
    last: Parts,
    /// Whether `work` still holds the last factor of the last step.
    last_factor: bool,
    kept: Vec<Kept>,
    /// Step k is kept in place k mod `places`.
    places: usize,
    u: Vec<f64>,
    dx: Vec<f64>,
    block: Block,
    /// The history that leaves a step: the first components of x_k, dx or λ.
    history: Vec<f64>,
    counts: Counts,
    warnings: Vec<Warning>,
}

/// Where the steps are in time.
#[derive(Debug)]
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

/// The parts of one step: where they are in time, and the states between them (one more than parts).
#[derive(Debug, Default)]
struct Parts {
    step: Option<usize>,
    at: Vec<Interval>,
    states: Vec<f64>,
}

/// At which point ∂G/∂u of a linearization is taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Linearization {
    /// At the accepted (x_k, x_{k+1}): exact, and the same bits under every [`Storage`](crate::Storage). One assembly and one
    /// factorization more per step.
    #[default]
    Accepted,
    /// Where a step is linearized right after it was taken (in one part): at the last iterate but one of Newton's method, whose factor
    /// is taken over for nothing. The gradient is then wrong by the size of the last accepted update, which no dot-product test
    /// sees. Other linearizations are exact: [`Counts::reused`] tells how many were not.
    LastFactor,
}

/// The place of the linearization of one step: whose it is, and how many of its parts are in use.
#[derive(Debug, Default)]
struct Kept {
    step: usize,
    used: usize,
    parts: Vec<Part>,
}

/// The linearization of a step or of a part of one.
#[derive(Debug)]
pub(crate) struct Part {
    pub(crate) at: Interval,
    pub(crate) x: Vec<f64>,
    pub(crate) u: Vec<f64>,
    pub(crate) factor: Factor,
}

/// A step may be halved this many times.
pub const MAX_HALVINGS: u32 = 6;
/// A pair of states solves the whole step if Newton's method asks for no more than this many times its threshold.
const SOLVED: f64 = 100.0;
/// Most warnings kept.
const MAX_WARNINGS: usize = 1000;
/// Parts of the shortest length in a step.
const SHORTEST: usize = 1 << MAX_HALVINGS;

impl<S: ImplicitStep> ImplicitModel<S> {
    /// A model whose step k starts at (first_index + k) · length seconds.
    ///
    /// # Panics
    /// If the length is not positive and finite.
    pub fn new(step: S, first_index: usize, length: f64) -> Self {
        assert!(length > 0.0 && length.is_finite(), "a step needs a positive length, not {length}");
        Self::on(Grid::Uniform { first: first_index, length }, step)
    }

    /// A model whose step k runs from `times[k]` to `times[k + 1]` (s); it has no steps beyond the last time.
    ///
    /// # Panics
    /// If there are fewer than two times or they do not ascend.
    pub fn on_times(step: S, times: Vec<f64>) -> Self {
        let ascending = times.windows(2).all(|t| t[0] < t[1] && t[1].is_finite());
        assert!(times.len() > 1 && ascending, "a grid of time needs two or more ascending times");
        Self::on(Grid::Times(times), step)
    }

    fn on(grid: Grid, step: S) -> Self {
        let (n, unknowns) = (step.dim(), step.unknowns());
        Self {
            work: NewtonWork::new(unknowns, &step.structure()),
            history: vec![0.0; step.history()],
            step,
            grid,
            options: NewtonOptions::default(),
            linearization: Linearization::default(),
            last: Parts::default(),
            last_factor: false,
            kept: Vec::new(),
            places: usize::MAX,
            u: vec![0.0; unknowns],
            dx: vec![0.0; n],
            block: Block::default(),
            counts: Counts::default(),
            warnings: Vec::new(),
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

    /// Allocates now what the linearizations of steps 0 … steps−1 need, one part each.
    pub fn reserve(&mut self, steps: usize) {
        for k in 0..steps.min(self.places) {
            self.part(k, 0);
        }
    }

    /// Runs step k into `self.last`.
    fn run(&mut self, k: usize, x: &[f64]) -> Result<(), Error> {
        let n = x.len();
        self.last_factor = false;
        let Parts { step, at: parts, states } = &mut self.last;
        *step = None;
        parts.clear();
        states.clear();
        states.extend_from_slice(x);
        let whole = self.grid.step(k);
        let own = n - self.history.len();
        // in units of the shortest part: where the next part begins, and how long it is to be
        let (mut position, mut size) = (0, SHORTEST);
        while position < SHORTEST {
            let at = Interval {
                index: k,
                start: whole.start + whole.length * position as f64 / SHORTEST as f64,
                length: whole.length * size as f64 / SHORTEST as f64,
                previous: parts.last().map_or(whole.previous, |before| Some(before.length)),
            };
            let from = parts.len() * n;
            states.resize(from + 2 * n, 0.0);
            let (x, x_next) = states[from..].split_at_mut(n);
            let solved =
                self.step.predict(&at, x, &mut self.u).map_err(|reason| Error::refused(k, reason)).and_then(
                    |()| {
                        let solved =
                            newton::solve(&mut self.step, &at, x, &mut self.u, &mut self.work, &self.options);
                        self.counts.newton_iterations += self.work.report().iterations;
                        self.counts.factorizations += self.work.report().factorizations;
                        solved
                    },
                );
            match solved {
                Ok(_) => {}
                Err(_) if size > 1 => {
                    size /= 2;
                    continue;
                }
                Err(error) => return Err(error),
            }
            self.step.advance(&at, x, &self.u, &mut x_next[..own]);
            x_next[own..].copy_from_slice(&x[..n - own]);
            if !x_next.iter().all(|v| v.is_finite()) {
                return Err(Error::NonFinite { step: k, what: "x_{k+1}" });
            }
            let text = self.step.accepted(&at, x, &self.u).map_err(|reason| Error::refused(k, reason))?;
            keep_warning(&mut self.warnings, k, text);
            parts.push(at);
            position += size;
            // after the second half of an interval comes the next whole one
            while position < SHORTEST && position.is_multiple_of(2 * size) {
                size *= 2;
            }
        }
        // to the next step, the step before it is the whole of this one
        let end = states.len() - n;
        states.copy_within(..n - own, end + own);
        self.last.step = Some(k);
        self.last_factor = true;
        Ok(())
    }

    /// Asks the step about the linearized part p of step k.
    fn ask_accepted(&mut self, k: usize, p: usize) -> Result<(), Error> {
        let part = &self.kept[k % self.places].parts[p];
        let text =
            self.step.accepted(&part.at, &part.x, &part.u).map_err(|reason| Error::refused(k, reason))?;
        keep_warning(&mut self.warnings, k, text);
        Ok(())
    }

    /// Whether the last step run was k from x to x_next.
    fn is_last(&self, k: usize, x: &[f64], x_next: &[f64]) -> bool {
        let states = &self.last.states;
        self.last.step == Some(k) && states.starts_with(x) && states.ends_with(x_next)
    }

    /// The place of part p of step k.
    fn part(&mut self, k: usize, p: usize) -> &mut Part {
        let place = k % self.places;
        if self.kept.len() <= place {
            self.kept.resize_with(place + 1, Kept::default);
        }
        let (n, unknowns) = (self.dx.len(), self.u.len());
        let parts = &mut self.kept[place].parts;
        if parts.len() == p {
            parts.push(Part {
                at: Interval { index: k, start: 0.0, length: 0.0, previous: None },
                x: vec![0.0; n],
                u: vec![0.0; unknowns],
                factor: self.work.solver.empty_factor(),
            });
        }
        &mut parts[p]
    }

    /// Takes over the last factor of Newton's method for a step just taken in one part.
    fn take_last_factor(&mut self, k: usize, x: &[f64], x_next: &[f64]) {
        self.part(k, 0);
        let Self { step, work, kept, places, last, .. } = self;
        let part = &mut kept[k % *places].parts[0];
        part.at = last.at[0];
        part.x.copy_from_slice(x);
        step.recover(&part.at, x, &x_next[..x.len() - step.history()], &mut part.u);
        std::mem::swap(&mut part.factor, &mut work.factor);
        self.last_factor = false;
        self.counts.reused += 1;
    }

    /// Linearizes one part. Returns the size of the Newton update that its equations still ask for.
    fn linearize_part(&mut self, p: usize, at: Interval, x: &[f64], x_next: &[f64]) -> Result<f64, Error> {
        let k = at.index;
        self.part(k, p);
        let Self { step, work, kept, places, .. } = self;
        let part = &mut kept[k % *places].parts[p];
        part.at = at;
        part.x.copy_from_slice(x);
        let own = x.len() - step.history();
        step.recover(&at, x, &x_next[..own], &mut part.u);
        step.assemble(&at, x, &part.u, &mut work.g, Some(&mut work.values))
            .map_err(|reason| Error::refused(k, reason))?;
        self.counts.factorizations += 1;
        work.solver
            .factor(&work.values, &mut part.factor)
            .map_err(|bad| Error::SingularJacobian { step: k, row: bad.row })?;
        work.solver.solve(&part.factor, &mut work.g);
        Ok(step.size(&work.g))
    }
}

impl<S: ImplicitStep> Model for ImplicitModel<S> {
    fn dim(&self) -> usize {
        self.dx.len()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<(), Error> {
        assert!(x.len() == self.dim() && x_next.len() == self.dim(), "a state has {} values", self.dim());
        self.run(k, x)?;
        self.counts.model_steps += 1;
        let parts = self.last.at.len();
        if parts > 1 {
            self.counts.substeps += parts - 1;
            keep_warning(
                &mut self.warnings,
                k,
                Some(format!("taken in {parts} parts: Newton's method failed on the whole")),
            );
        }
        let n = x.len();
        x_next.copy_from_slice(&self.last.states[parts * n..]);
        Ok(())
    }

    fn linearize(&mut self, k: usize, x: &[f64], x_next: &[f64]) -> Result<(), Error> {
        assert!(x.len() == self.dim() && x_next.len() == self.dim(), "a state has {} values", self.dim());
        self.counts.linearizations += 1;
        self.part(k, 0);
        let place = k % self.places;
        (self.kept[place].step, self.kept[place].used) = (k, 0);
        if self.linearization == Linearization::LastFactor
            && self.last_factor
            && self.last.at.len() == 1
            && self.is_last(k, x, x_next)
        {
            self.take_last_factor(k, x, x_next);
            self.kept[place].used = 1;
            return self.ask_accepted(k, 0);
        }
        let whole = self.grid.step(k);
        let left = self.linearize_part(0, whole, x, x_next);
        if left.as_ref().is_ok_and(|left| *left <= SOLVED * self.step.converged_below()) {
            self.kept[place].used = 1;
            return self.ask_accepted(k, 0);
        }
        // not a solution over the whole step: it was taken in parts
        if !self.is_last(k, x, x_next) {
            self.run(k, x)?;
            if !self.is_last(k, x, x_next) {
                return left.and(Err(Error::NotAStep { step: k }));
            }
        }
        let parts = std::mem::take(&mut self.last);
        let n = x.len();
        for (p, at) in parts.at.iter().enumerate() {
            let (x, x_next) = parts.states[p * n..(p + 2) * n].split_at(n);
            self.linearize_part(p, *at, x, x_next)?;
            self.ask_accepted(k, p)?;
        }
        self.kept[place].used = parts.at.len();
        self.last = parts;
        Ok(())
    }

    fn tangent(&mut self, k: usize, dx: &mut [f64]) {
        self.counts.tangent_steps += 1;
        let Self { step, work, kept, places, u: du, dx: dx_next, history, .. } = self;
        let (past, own) = (history.len(), dx.len() - history.len());
        history.copy_from_slice(&dx[..past]);
        for part in linearized(kept, *places, k) {
            step.previous(&part.at, &part.x, &part.u, dx, du);
            work.solver.solve(&part.factor, du);
            du.iter_mut().for_each(|d| *d = -*d);
            step.advance_tangent(&part.at, &part.x, &part.u, dx, du, &mut dx_next[..own]);
            dx_next[own..].copy_from_slice(&dx[..past]);
            dx.copy_from_slice(dx_next);
        }
        dx[own..].copy_from_slice(history);
    }

    fn adjoint(&mut self, k: usize, lambda: &mut [f64]) {
        self.counts.adjoint_steps += 1;
        let Self { step, work, kept, places, u: mu, dx, history, .. } = self;
        let (past, own) = (history.len(), lambda.len() - history.len());
        history.copy_from_slice(&lambda[own..]);
        lambda[own..].fill(0.0);
        for part in linearized(kept, *places, k).iter().rev() {
            step.advance_adjoint(&part.at, &part.x, &part.u, &lambda[..own], dx, mu);
            work.solver.solve_transpose(&part.factor, mu);
            mu.iter_mut().for_each(|m| *m = -*m);
            step.previous_transpose_add(&part.at, &part.x, &part.u, mu, dx);
            add(&mut dx[..past], &lambda[own..]);
            lambda.copy_from_slice(dx);
        }
        add(&mut lambda[..past], history);
    }

    fn tangent_block(&mut self, k: usize, dx: &mut [f64]) {
        let n = self.dim();
        assert!(dx.len().is_multiple_of(n), "a column has {n} values");
        self.counts.tangent_steps += dx.len() / n;
        let parts = linearized(&self.kept, self.places, k);
        self.block.tangent(&mut self.step, &mut self.work.solver, parts, n, dx);
    }

    fn adjoint_block(&mut self, k: usize, lambda: &mut [f64]) {
        let n = self.dim();
        assert!(lambda.len().is_multiple_of(n), "a column has {n} values");
        self.counts.adjoint_steps += lambda.len() / n;
        let parts = linearized(&self.kept, self.places, k);
        self.block.adjoint(&mut self.step, &mut self.work.solver, parts, n, lambda);
    }

    fn keep_at_most(&mut self, steps: usize) {
        assert!(steps > 0, "a step must be kept to be of use");
        if steps != self.places {
            self.places = steps;
            self.kept = Vec::new();
        }
    }

    fn bytes_per_step(&self) -> usize {
        size_of::<Kept>() + bytes(self.dim(), self.u.len(), &self.work.factor)
    }

    fn bytes_kept(&self) -> usize {
        let part = |p: &Part| bytes(p.x.len(), p.u.len(), &p.factor);
        let kept = |k: &Kept| size_of::<Kept>() + k.parts.iter().map(part).sum::<usize>();
        self.kept.iter().map(kept).sum()
    }

    fn control_dim(&self) -> usize {
        self.step.control_dim()
    }

    fn initial_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        let t = self.time(0);
        let (own, history) = x.split_at_mut(x.len() - self.history.len());
        self.step.initial_state(t, z, own).map_err(|reason| Error::refused(0, reason))?;
        history.copy_from_slice(&own[..history.len()]);
        if !x.iter().all(|v| v.is_finite()) {
            return Err(Error::NonFinite { step: 0, what: "the initial state" });
        }
        Ok(())
    }

    fn initial_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        let t = self.time(0);
        let (own, history) = dx.split_at_mut(dx.len() - self.history.len());
        self.step.initial_tangent(t, dz, own);
        history.copy_from_slice(&own[..history.len()]);
    }

    fn initial_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        let t = self.time(0);
        let (own, history) = lambda.split_at(lambda.len() - self.history.len());
        let sum = &mut self.dx[..own.len()];
        sum.copy_from_slice(own);
        add(&mut sum[..history.len()], history);
        self.step.initial_adjoint(t, sum, dz);
    }

    fn counts(&self) -> Counts {
        self.counts
    }

    fn warnings(&self) -> &[Warning] {
        &self.warnings
    }
}

pub(crate) fn add(target: &mut [f64], values: &[f64]) {
    target.iter_mut().zip(values).for_each(|(t, v)| *t += v);
}

fn linearized(kept: &[Kept], places: usize, k: usize) -> &[Part] {
    let kept = kept.get(k % places).filter(|kept| kept.step == k && kept.used > 0);
    let kept = kept.unwrap_or_else(|| panic!("step {k} has not been linearized"));
    &kept.parts[..kept.used]
}

/// Of one part, without the factor's share for a sparse Jacobian.
fn bytes(state: usize, unknowns: usize, factor: &Factor) -> usize {
    (state + unknowns) * size_of::<f64>() + factor.bytes() + size_of::<Part>()
}

fn keep_warning(warnings: &mut Vec<Warning>, step: usize, text: Option<String>) {
    if let Some(text) = text
        && warnings.len() < MAX_WARNINGS
        && !warnings.iter().any(|w| w.step == step && w.text == text)
    {
        warnings.push(Warning { step, text });
    }
}
