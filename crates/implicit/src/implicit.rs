//! A [`Model`] made from any [`ImplicitStep`].

use crate::factor::Factor;
use crate::newton::{self, NewtonOptions, NewtonWork};
use crate::{Counts, Error, ImplicitStep, Interval, Model, Warning};

/// Steps on a uniform grid of time, each solved by Newton's method, with tangent and adjoint from kept factors
/// (paper 2.24, 2.25).
///
/// Step k runs from (first + k) Δt to (first + k + 1) Δt, both computed as products, so that long runs do not drift.
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
/// **Linearization** is a function of the pair (x_k, x_{k+1}) alone: u is recovered from x_{k+1}, assembled and factored. A
/// pair that does not satisfy the equations of the whole step comes from a step in parts, which is then run again to find
/// them (unless it was the last one taken). Memory is allocated the first time a step is linearized, and reused.
#[derive(Debug)]
pub struct ImplicitModel<S> {
    step: S,
    first: usize,
    length: f64,
    options: NewtonOptions,
    work: NewtonWork,
    last: Parts,
    kept: Vec<Vec<Part>>,
    used: Vec<usize>,
    u: Vec<f64>,
    dx: Vec<f64>,
    counts: Counts,
    warnings: Vec<Warning>,
}

/// The parts of one step: where they are in time, and the states between them (one more than parts).
#[derive(Debug, Default)]
struct Parts {
    step: Option<usize>,
    at: Vec<Interval>,
    states: Vec<f64>,
}

/// The linearization of a step or of a part of one.
#[derive(Debug)]
struct Part {
    at: Interval,
    x: Vec<f64>,
    u: Vec<f64>,
    factor: Factor,
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
        let (n, unknowns) = (step.dim(), step.unknowns());
        Self {
            work: NewtonWork::new(unknowns, &step.structure()),
            step,
            first: first_index,
            length,
            options: NewtonOptions::default(),
            last: Parts::default(),
            kept: Vec::new(),
            used: Vec::new(),
            u: vec![0.0; unknowns],
            dx: vec![0.0; n],
            counts: Counts::default(),
            warnings: Vec::new(),
        }
    }

    /// The same model with other limits for Newton's method.
    pub fn with_options(mut self, options: NewtonOptions) -> Self {
        self.options = options;
        self
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
    pub fn time(&self, k: usize) -> f64 {
        (self.first + k) as f64 * self.length
    }

    /// Allocates now what the linearizations of steps 0 … steps−1 need, one part each.
    pub fn reserve(&mut self, steps: usize) {
        for k in 0..steps {
            self.part(k, 0);
        }
    }

    /// Heap memory of the kept linearizations, in bytes (without faer's share for a sparse Jacobian).
    pub fn bytes_kept(&self) -> usize {
        let part = |p: &Part| {
            size_of_val(p.x.as_slice()) + size_of_val(p.u.as_slice()) + p.factor.bytes() + size_of::<Part>()
        };
        self.kept.iter().flatten().map(part).sum()
    }

    /// Runs step k into `self.last`.
    fn run(&mut self, k: usize, x: &[f64]) -> Result<(), Error> {
        let n = x.len();
        let Parts { step, at: parts, states } = &mut self.last;
        *step = None;
        parts.clear();
        states.clear();
        states.extend_from_slice(x);
        let start = (self.first + k) as f64 * self.length;
        // in units of the shortest part: where the next part begins, and how long it is to be
        let (mut position, mut size) = (0, SHORTEST);
        while position < SHORTEST {
            let at = Interval {
                index: k,
                start: start + self.length * position as f64 / SHORTEST as f64,
                length: self.length * size as f64 / SHORTEST as f64,
            };
            let from = parts.len() * n;
            states.resize(from + 2 * n, 0.0);
            let (x, x_next) = states[from..].split_at_mut(n);
            let solved = self
                .step
                .predict(&at, x, &mut self.u)
                .map_err(|reason| Error::Refused { step: k, reason })
                .and_then(|()| {
                    let solved =
                        newton::solve(&mut self.step, &at, x, &mut self.u, &mut self.work, &self.options);
                    self.counts.newton_iterations += self.work.report().iterations;
                    self.counts.factorizations += self.work.report().factorizations;
                    solved
                });
            match solved {
                Ok(_) => {}
                Err(_) if size > 1 => {
                    size /= 2;
                    continue;
                }
                Err(error) => return Err(error),
            }
            self.step.advance(&at, x, &self.u, x_next);
            if !x_next.iter().all(|v| v.is_finite()) {
                return Err(Error::NonFinite { step: k, what: "x_{k+1}" });
            }
            let text =
                self.step.accepted(&at, x, &self.u).map_err(|reason| Error::Refused { step: k, reason })?;
            keep_warning(&mut self.warnings, k, text);
            parts.push(at);
            position += size;
            // after the second half of an interval comes the next whole one
            while position < SHORTEST && position.is_multiple_of(2 * size) {
                size *= 2;
            }
        }
        self.last.step = Some(k);
        Ok(())
    }

    /// Asks the step about the linearized part p of step k.
    fn ask_accepted(&mut self, k: usize, p: usize) -> Result<(), Error> {
        let part = &self.kept[k][p];
        let text = self
            .step
            .accepted(&part.at, &part.x, &part.u)
            .map_err(|reason| Error::Refused { step: k, reason })?;
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
        if self.kept.len() <= k {
            self.kept.resize_with(k + 1, Vec::new);
            self.used.resize(k + 1, 0);
        }
        let (n, unknowns) = (self.dx.len(), self.u.len());
        let slot = &mut self.kept[k];
        if slot.len() == p {
            slot.push(Part {
                at: Interval { index: k, start: 0.0, length: 0.0 },
                x: vec![0.0; n],
                u: vec![0.0; unknowns],
                factor: self.work.solver.empty_factor(),
            });
        }
        &mut slot[p]
    }

    /// Linearizes one part. Returns the size of the Newton update that its equations still ask for.
    fn linearize_part(&mut self, p: usize, at: Interval, x: &[f64], x_next: &[f64]) -> Result<f64, Error> {
        let k = at.index;
        self.part(k, p);
        let Self { step, work, kept, .. } = self;
        let part = &mut kept[k][p];
        part.at = at;
        part.x.copy_from_slice(x);
        step.recover(&at, x, x_next, &mut part.u);
        step.assemble(&at, x, &part.u, &mut work.g, Some(&mut work.values))
            .map_err(|reason| Error::Refused { step: k, reason })?;
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
        if let Some(used) = self.used.get_mut(k) {
            *used = 0;
        }
        let whole = Interval { index: k, start: self.time(k), length: self.length };
        if !(self.is_last(k, x, x_next) && self.last.at.len() > 1) {
            let left = self.linearize_part(0, whole, x, x_next);
            if left.as_ref().is_ok_and(|left| *left <= SOLVED * self.step.converged_below()) {
                self.used[k] = 1;
                return self.ask_accepted(k, 0);
            }
            // not a solution over the whole step: it was taken in parts
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
        self.used[k] = parts.at.len();
        self.last = parts;
        Ok(())
    }

    fn tangent(&mut self, k: usize, dx: &mut [f64]) {
        self.counts.tangent_steps += 1;
        let Self { step, work, kept, used, u: du, dx: dx_next, .. } = self;
        for part in linearized(kept, used, k) {
            step.previous(&part.at, &part.x, &part.u, dx, du);
            work.solver.solve(&part.factor, du);
            du.iter_mut().for_each(|d| *d = -*d);
            step.advance_tangent(&part.at, &part.x, &part.u, dx, du, dx_next);
            dx.copy_from_slice(dx_next);
        }
    }

    fn adjoint(&mut self, k: usize, lambda: &mut [f64]) {
        self.counts.adjoint_steps += 1;
        let Self { step, work, kept, used, u: mu, dx, .. } = self;
        for part in linearized(kept, used, k).iter().rev() {
            step.advance_adjoint(&part.at, &part.x, &part.u, lambda, dx, mu);
            work.solver.solve_transpose(&part.factor, mu);
            mu.iter_mut().for_each(|m| *m = -*m);
            step.previous_transpose_add(&part.at, &part.x, &part.u, mu, dx);
            lambda.copy_from_slice(dx);
        }
    }

    fn control_dim(&self) -> usize {
        self.step.control_dim()
    }

    fn initial_state(&mut self, z: &[f64], x: &mut [f64]) -> Result<(), Error> {
        let t = self.time(0);
        self.step.initial_state(t, z, x).map_err(|reason| Error::Refused { step: 0, reason })?;
        if !x.iter().all(|v| v.is_finite()) {
            return Err(Error::NonFinite { step: 0, what: "the initial state" });
        }
        Ok(())
    }

    fn initial_tangent(&mut self, dz: &[f64], dx: &mut [f64]) {
        let t = self.time(0);
        self.step.initial_tangent(t, dz, dx);
    }

    fn initial_adjoint(&mut self, lambda: &[f64], dz: &mut [f64]) {
        let t = self.time(0);
        self.step.initial_adjoint(t, lambda, dz);
    }

    fn counts(&self) -> Counts {
        self.counts
    }

    fn warnings(&self) -> &[Warning] {
        &self.warnings
    }
}

fn linearized<'a>(kept: &'a [Vec<Part>], used: &[usize], k: usize) -> &'a [Part] {
    let used = used.get(k).copied().unwrap_or(0);
    assert!(used > 0, "step {k} has not been linearized");
    &kept[k][..used]
}

fn keep_warning(warnings: &mut Vec<Warning>, step: usize, text: Option<String>) {
    if let Some(text) = text
        && warnings.len() < MAX_WARNINGS
        && !warnings.iter().any(|w| w.step == step && w.text == text)
    {
        warnings.push(Warning { step, text });
    }
}
