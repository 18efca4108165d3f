//! The generic layer: singular Jacobians, overflow, forced failures of Newton's method, Robertson's kinetics,
//! long decay.

use super::common::{condition, interval, refused, work};
use crate::row::{Case, Outcome, Rows};
use num_dual::{Dual64, DualNum};
use problems::counted::Counted;
use varda_implicit::{
    Equations, ImplicitModel, ImplicitStep, Interval, Model, NewtonOptions, OneLeg, Refusal, Rhs, SolvedStep,
    StepEquations, Structure, check,
};

pub(super) fn run(rows: &mut Rows) {
    singular(rows);
    overflow(rows);
    forced_failure(rows);
    for mass in [1.0, 0.0] {
        rows.case(
            if mass == 1.0 { "Robertson to t = 4e6, ODE" } else { "Robertson to t = 4e6, singular mass" },
            |case| robertson(case, mass),
        );
    }
    decay(rows, 100_000);
}

/// A step given by closures: u' = G for two unknowns, dense. ∂G/∂x_k is minus the identity.
struct Plain<G: FnMut(&[f64], &mut [f64], &mut [f64])> {
    /// (u, g without −x, Jacobian by columns).
    equations: G,
}

/// The equations of one step.
struct PlainEquations<'a, G: FnMut(&[f64], &mut [f64], &mut [f64])> {
    step: &'a mut Plain<G>,
    x: &'a [f64],
}

impl<G: FnMut(&[f64], &mut [f64], &mut [f64])> Equations for PlainEquations<'_, G> {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let x = self.x;
        let mut own = [0.0; 4];
        (self.step.equations)(u, g, jacobian.unwrap_or(&mut own));
        g.iter_mut().zip(x).for_each(|(g, x)| *g -= x);
        Ok(None)
    }
    fn converged_below(&self) -> f64 {
        1e-13
    }
}

impl<G: FnMut(&[f64], &mut [f64], &mut [f64])> StepEquations for PlainEquations<'_, G> {
    fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
        let x = self.x;
        u.copy_from_slice(x);
        Ok(())
    }
}

impl<G: FnMut(&[f64], &mut [f64], &mut [f64])> ImplicitStep for Plain<G> {
    type Equations<'a>
        = PlainEquations<'a, G>
    where
        Self: 'a;

    fn dim(&self) -> usize {
        2
    }
    fn structure(&self) -> Structure {
        Structure::Dense
    }
    fn previous(&mut self, _of: &SolvedStep<'_>, dx: &[f64], dg: &mut [f64]) {
        dg.iter_mut().zip(dx).for_each(|(g, d)| *g = -d);
    }
    fn previous_transpose_add(&mut self, _of: &SolvedStep<'_>, mu: &[f64], dx: &mut [f64]) {
        dx.iter_mut().zip(mu).for_each(|(d, m)| *d -= m);
    }
    fn equations<'a>(&'a mut self, _at: &Interval, x: &'a [f64]) -> Result<Self::Equations<'a>, Refusal> {
        Ok(PlainEquations { step: self, x })
    }
}

/// G = A u − x with A = [[1, 1], [1, 1 + η]]: exactly singular, and so nearly that rounding decides.
fn singular(rows: &mut Rows) {
    for eta in rows.grid("determinants of ∂G/∂u", [0.0, 1e-4, 1e-8, 1e-12, 1e-15]) {
        rows.case(&format!("∂G/∂u with determinant {eta:e}"), |case| {
            let a = [1.0, 1.0, 1.0, 1.0 + eta];
            let equations = move |u: &[f64], g: &mut [f64], j: &mut [f64]| {
                (g[0], g[1]) = (a[0] * u[0] + a[2] * u[1], a[1] * u[0] + a[3] * u[1]);
                j.copy_from_slice(&a);
            };
            let mut model = Counted::new(ImplicitModel::new(Plain { equations }, 0, 1.0));
            let (x, mut next) = ([1.0, 2.0], [0.0; 2]);
            if eta == 0.0 {
                refused(
                    case,
                    "refused, naming step and row",
                    model.step(7, &x, &mut next),
                    "step 7: the Jacobian ∂G/∂u is singular at row",
                );
                return Ok(());
            }
            // as stored, 1 + η is off by rounding: what it really is
            let exact = (1.0 + eta) - 1.0;
            let answer = [1.0 - 1.0 / exact, 1.0 / exact];
            let cond = condition(2, &Structure::Dense, &a);
            match model.step(7, &x, &mut next) {
                Ok(_) => {
                    let error = (0..2).map(|i| (next[i] / answer[i] - 1.0).abs()).fold(0.0, f64::max);
                    // what is left of G, over what its terms are: right whatever the condition
                    let left = (0..2).map(|i| (a[i] * next[0] + a[2 + i] * next[1] - x[i]).abs());
                    let size = a[3] * next[0].abs().max(next[1].abs());
                    case.at_most(
                        "residual over its terms",
                        left.fold(0.0, f64::max) / size,
                        4.0 * f64::EPSILON,
                        "-",
                    )
                    .because("a solve with pivoting is backward stable: some ε, whatever the condition")
                    .work(work(&model, cond));
                    case.at_most("relative error of the step", error, 4.0 * f64::EPSILON * cond, "-")
                        .because(
                            "ε times the condition: all that the stored matrix determines (nothing at \
                                1e-15)",
                        );
                    model.linearize(7, 7, &x, &next)?;
                    let dot = check::dot_product(&mut model, 7..8, &[1.0; 2], 1)?;
                    case.at_most("dot product", dot.value, dot.bound, "-")
                        .because("50 ε times ‖M‖ ‖δx‖/‖M δx‖");
                }
                // a solution of 1/η cannot meet an absolute tolerance of 1e-13: refused rather than trusted
                Err(error) => refused(case, "refused, naming the step", Err::<(), _>(error), "step 7"),
            }
            Ok(())
        });
    }
}

/// A residual that overflows: at the first full update, which must be halved until it is finite; at the
/// guess; everywhere.
fn overflow(rows: &mut Rows) {
    // exp(u) − 15 = x from u = x
    let steep = |u: &[f64], g: &mut [f64], j: &mut [f64]| {
        j.fill(0.0);
        for i in 0..2 {
            g[i] = u[i].exp() - 15.0;
            j[3 * i] = u[i].exp();
        }
    };
    rows.case("residual that overflows at the first update", |case| {
        let mut model = Counted::new(ImplicitModel::new(Plain { equations: steep }, 0, 1.0));
        // the first update is 5 e^10 = 1e5 long, and exp(1e5) is beyond all numbers
        let (x, mut next) = ([-10.0, -12.0], [0.0; 2]);
        model.step(3, &x, &mut next)?;
        let error = (0..2).map(|i| (next[i] - (x[i] + 15.0_f64).ln()).abs()).fold(0.0, f64::max);
        case.at_most("error of the step", error, 1e-13, "-")
            .because("an update below 1e-13 ends the step, convergence being quadratic")
            .work(work(&model, f64::NAN));
        Ok(())
    });
    rows.case("residual that overflows at the guess", |case| {
        let mut model = Counted::new(ImplicitModel::new(Plain { equations: steep }, 0, 1.0));
        let attempt = model.step(3, &[800.0, 20.0], &mut [0.0; 2]);
        refused(case, "refused, naming the step", attempt, "step 3: the residual of the guess is not finite");
        Ok(())
    });
    rows.case("residual that is never finite", |case| {
        let equations = |_: &[f64], g: &mut [f64], j: &mut [f64]| {
            g.fill(f64::INFINITY);
            j.copy_from_slice(&[1.0, 0.0, 0.0, 1.0]);
        };
        let mut model = Counted::new(ImplicitModel::new(Plain { equations }, 0, 1.0));
        refused(case, "refused, naming the step", model.step(3, &[1.0; 2], &mut [0.0; 2]), "step 3");
        Ok(())
    });
}

/// ẋ = −20 x³ by implicit Euler with too few Newton iterations for a whole step: taken in parts, the
/// gradient through them right.
fn forced_failure(rows: &mut Rows) {
    rows.case("forced Newton failure in one step", |case| {
        let options = NewtonOptions::default().with_max_iterations(7);
        let start = [4.0, 1.5, 0.1];
        let mut model = Counted::new(
            ImplicitModel::new(OneLeg::implicit_euler(Cubic, 1e-12), 0, 0.5).with_options(options),
        );
        let steps = 4;
        let (mut states, mut next) = (vec![start.to_vec()], vec![0.0; 3]);
        for k in 0..steps {
            model.step(k, &states[k], &mut next)?;
            model.linearize(k, k, &states[k], &next)?;
            states.push(next.clone());
        }
        let work = work(&model, f64::NAN);
        let split = model.counts().substeps;
        case.at_most("steps taken in parts, at least one", if split > 0 { 0.0 } else { f64::NAN }, 0.0, "-")
            .work(work);
        // J = Σ x_N; the gradient by the adjoint, and by differences of fourth order of the very same steps
        let mut lambda = vec![1.0; 3];
        (0..steps).rev().for_each(|k| model.adjoint(k, &mut lambda));
        let mut cost = |x: &[f64]| -> Result<f64, varda_implicit::Error> {
            let (mut x, mut next) = (x.to_vec(), vec![0.0; 3]);
            for k in 0..steps {
                model.step(k, &x, &mut next)?;
                std::mem::swap(&mut x, &mut next);
            }
            Ok(x.iter().sum())
        };
        let mut worst = 0.0_f64;
        for i in 0..3 {
            let h = 1e-3 * start[i];
            let mut at = |m: f64| {
                let mut x = start.to_vec();
                x[i] += m * h;
                cost(&x)
            };
            let difference = (8.0 * (at(1.0)? - at(-1.0)?) - (at(2.0)? - at(-2.0)?)) / (12.0 * h);
            worst = worst.max((lambda[i] / difference - 1.0).abs());
        }
        case.at_most("gradient through the parts, relative error", worst, 1e-8, "-")
            .because("the differences it is held against err by h⁴ = 1e-12 and ε/h = 1e-13");
        Ok(())
    });
}

struct Cubic;

impl Rhs for Cubic {
    fn dim(&self) -> usize {
        3
    }
    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        f.iter_mut().zip(x).for_each(|(f, x)| *f = -20.0 * x * x * x);
    }
    fn tangent(&mut self, _t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        (0..3).for_each(|i| df[i] = -60.0 * x[i] * x[i] * dx[i]);
    }
    fn adjoint_add(&mut self, _t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        (0..3).for_each(|i| dx[i] -= 60.0 * x[i] * x[i] * lambda[i]);
    }
}

/// Robertson's kinetics (1966) by implicit Euler on steps that grow: M ẏ = f(y), y scaled (1, 1e-4, 1).
///
/// ```text
/// f = (−0.04 y₁ + 1e4 y₂ y₃,  0.04 y₁ − 1e4 y₂ y₃ − 3e7 y₂²,  3e7 y₂²)   M = I
/// third equation y₁ + y₂ + y₃ = total     M = diag(1, 1, 0), total kept in the state
/// ```
///
/// Steps of a model are of equal length: here the length is a part of the step, h_k = h₀ qᵏ, in a time
/// s = k.
struct Robertson {
    /// Last entry of M.
    mass: f64,
    first: f64,
    growth: f64,
}

const SCALE: [f64; 3] = [1.0, 1e-4, 1.0];

impl Robertson {
    /// h of an interval; a part of a step is as long as its share of it.
    fn length(&self, at: &Interval) -> f64 {
        at.length * self.first * self.growth.powi(at.index as i32)
    }

    /// G(x, u), for any kind of number.
    fn residual<T: DualNum<Primitive = f64> + Copy>(&self, h: f64, x: [T; 3], u: [T; 3]) -> [T; 3] {
        let ([a, b, c], [p, q, r]) = (u, x);
        let slow = a * 0.04 - b * c * 1e4;
        let fast = b * b * 3e7;
        let third = if self.mass == 0.0 { (a - p) + (b - q) + (c - r) } else { c - r - fast * h };
        [a - p + slow * h, b - q - (slow - fast) * h, third]
    }
}

/// The equations of one step.
struct RobertsonEquations<'a> {
    step: &'a mut Robertson,
    at: Interval,
    x: &'a [f64],
}

impl Equations for RobertsonEquations<'_> {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let at = &self.at;
        let x = self.x;
        g.copy_from_slice(&self.step.residual(self.step.length(at), [x[0], x[1], x[2]], [u[0], u[1], u[2]]));
        if let Some(j) = jacobian {
            let h = self.step.length(at);
            let (slow, fast) = ([0.04 * h, -1e4 * u[2] * h, -1e4 * u[1] * h], 6e7 * u[1] * h);
            let third = if self.step.mass == 0.0 { [1.0; 3] } else { [0.0, -fast, 1.0] };
            let rows = [[1.0 + slow[0], slow[1], slow[2]], [-slow[0], 1.0 - slow[1] + fast, -slow[2]], third];
            (0..9).for_each(|p| j[p] = rows[p % 3][p / 3]);
        }
        Ok(None)
    }
    fn size(&self, du: &[f64]) -> f64 {
        du.iter()
            .zip(SCALE)
            .fold(0.0, |m: f64, (d, s)| if d.is_nan() { f64::NAN } else { m.max((d / s).abs()) })
    }
    fn converged_below(&self) -> f64 {
        1e-13
    }
}

impl StepEquations for RobertsonEquations<'_> {
    fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
        let x = self.x;
        u.copy_from_slice(x);
        Ok(())
    }
}

impl ImplicitStep for Robertson {
    type Equations<'a> = RobertsonEquations<'a>;

    fn dim(&self) -> usize {
        3
    }
    fn structure(&self) -> Structure {
        Structure::Dense
    }
    fn previous(&mut self, _of: &SolvedStep<'_>, dx: &[f64], dg: &mut [f64]) {
        (0..3).for_each(|i| dg[i] = -dx[i]);
        if self.mass == 0.0 {
            dg[2] = -(dx[0] + dx[1] + dx[2]);
        }
    }
    fn previous_transpose_add(&mut self, _of: &SolvedStep<'_>, mu: &[f64], dx: &mut [f64]) {
        let all = if self.mass == 0.0 { [mu[2]; 3] } else { [0.0, 0.0, mu[2]] };
        dx[0] -= mu[0] + all[0];
        dx[1] -= mu[1] + all[1];
        dx[2] -= all[2];
    }
    fn equations<'a>(&'a mut self, at: &Interval, x: &'a [f64]) -> Result<Self::Equations<'a>, Refusal> {
        Ok(RobertsonEquations { step: self, at: *at, x })
    }
}

/// Robertson to t = 4e6: y against a reference, and the discrete adjoint against a complex step of length
/// zero through the same steps.
fn robertson(case: &mut Case, mass: f64) -> Outcome {
    // 1600 steps from 1e-6 s, growing by 1.6 %: their sum is 4e6 s
    let (first, steps) = (1e-6, 1600);
    let growth = growth_to(4e6, first, steps);
    let step = || Robertson { mass, first, growth };
    let mut model = Counted::new(ImplicitModel::new(step(), 0, 1.0));
    let mut states = vec![[1.0, 0.0, 0.0]];
    for k in 0..steps {
        let mut next = [0.0; 3];
        model.step(k, &states[k], &mut next)?;
        model.linearize(k, k, &states[k], &next)?;
        states.push(next);
    }
    let last = states[steps];
    let at = interval(steps - 1, 0.0, 1.0);
    let mut jacobian = [0.0; 9];
    step()
        .equations(&at, &states[steps - 1])
        .and_then(|mut equations| equations.assemble(&last, &mut [0.0; 3], Some(&mut jacobian)))
        .map_err(|e| e.to_string())?;
    let work = work(&model, condition(3, &Structure::Dense, &jacobian));
    case.at_most("total, departure from 1", (last.iter().sum::<f64>() - 1.0).abs(), 4e-13, "-")
        .because("y₁ + y₂ + y₃ = 1 is kept by every step: 1600 roundings")
        .work(work);
    // In quasi-steady state 0.04 y₁ = 1e4 y₂ y₃ + 3e7 y₂², but for what flows on: d y₃/dt over the
    // fluxes, about y₂/t.
    let (y2, y3) = (last[1], last[2]);
    let balance = 0.04 * last[0] - 1e4 * y2 * y3 - 3e7 * y2 * y2;
    case.at_most(
        "quasi-steady balance over 0.04 \
        y₁",
        (balance / (0.04 * last[0])).abs(),
        1e-4,
        "-",
    )
    .because(
        "y₂ lags behind its balance by its own 1/(1e4 y₃) s, 1e-4 s of 4e6 s, and what y₂/t \
            adds",
    );
    case.at_most("y₁(4e6), relative error", (last[0] / 5.168e-4 - 1.0).abs(), 0.05, "-")
        .because(
            "against CVODE's 5.168e-4 (cvRoberts_dns, Hindmarsh et al. 2005): implicit Euler errs by about \
                what t grows by in a step, 1.6 %",
        )
        .computed(last[0]);

    // J = y₁(T) + 1e4 y₂(T) with respect to y(0)
    let mut lambda = [1.0, 1e4, 0.0];
    (0..steps).rev().for_each(|k| model.adjoint(k, &mut lambda));
    let mut worst = 0.0_f64;
    for i in 0..3 {
        let reference = complex_step(&step(), steps, i);
        worst = worst.max((lambda[i] - reference).abs());
    }
    let size = lambda.iter().fold(0.0_f64, |m, l| m.max(l.abs()));
    case.at_most("adjoint against complex step, relative", worst / size, 1e-12, "-")
        .because("1600 solves backward stable row by row, so that conditions of 1e9 do not enter")
        .computed(size);
    Ok(())
}

/// q with first (1 + q + … + q^(steps−1)) = total.
fn growth_to(total: f64, first: f64, steps: usize) -> f64 {
    let (mut low, mut high) = (1.0_f64, 2.0_f64);
    for _ in 0..200 {
        let q = 0.5 * (low + high);
        let sum = first * (q.powi(steps as i32) - 1.0) / (q - 1.0);
        if sum < total { low = q } else { high = q }
    }
    low
}

/// ∂J/∂y_i(0) by dual numbers through all steps: a complex step of length zero. Newton's method on duals;
/// the dual part is right one iteration after the real one.
fn complex_step(step: &Robertson, steps: usize, i: usize) -> f64 {
    let zero = Dual64::from(0.0);
    let mut x = [Dual64::from(1.0), zero, zero];
    x[i].eps = 1.0;
    for k in 0..steps {
        let h = step.length(&interval(k, 0.0, 1.0));
        let (mut u, mut after) = (x, 0);
        for _ in 0..100 {
            let du = solve3(jacobian_of_duals(step, h, u), step.residual(h, x, u));
            (0..3).for_each(|c| u[c] -= du[c]);
            after += usize::from((0..3).all(|c| (du[c].re / SCALE[c]).abs() < 1e-14));
            if after == 3 {
                break;
            }
        }
        x = u;
    }
    x[0].eps + 1e4 * x[1].eps
}

/// ∂G/∂u of dual numbers.
fn jacobian_of_duals(step: &Robertson, h: f64, u: [Dual64; 3]) -> [[Dual64; 3]; 3] {
    let one = Dual64::from(1.0);
    let slow = [Dual64::from(0.04 * h), u[2] * (-1e4 * h), u[1] * (-1e4 * h)];
    let fast = u[1] * (6e7 * h);
    let third = if step.mass == 0.0 { [one; 3] } else { [Dual64::from(0.0), -fast, one] };
    [[one + slow[0], slow[1], slow[2]], [-slow[0], one - slow[1] + fast, -slow[2]], third]
}

/// Gaussian elimination with partial pivoting of a 3 × 3 system of dual numbers.
fn solve3(mut a: [[Dual64; 3]; 3], mut b: [Dual64; 3]) -> [Dual64; 3] {
    for k in 0..3 {
        let pivot = (k..3).fold(k, |best, i| if a[i][k].re.abs() > a[best][k].re.abs() { i } else { best });
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in k + 1..3 {
            let factor = a[i][k] / a[k][k];
            for j in k..3 {
                let change = factor * a[k][j];
                a[i][j] -= change;
            }
            let change = factor * b[k];
            b[i] -= change;
        }
    }
    for k in (0..3).rev() {
        for j in k + 1..3 {
            let change = a[k][j] * b[j];
            b[k] -= change;
        }
        b[k] /= a[k][k];
    }
    b
}

/// ẋ_i = −λ_i x_i, λ = 1 … 1e6, over many steps: adjoints decay to nothing, without overflow, NaN or
/// a slow crawl among denormals.
fn decay(rows: &mut Rows, steps: usize) {
    rows.case(&format!("adjoint of decay over {steps} steps"), |case| {
        let mut model = Counted::new(ImplicitModel::new(OneLeg::implicit_euler(Decay, 1e-13), 0, 0.01));
        let (mut x, mut next) = (vec![1.0; 7], vec![0.0; 7]);
        let mut trajectory = vec![x.clone()];
        for k in 0..steps {
            model.step(k, &x, &mut next)?;
            std::mem::swap(&mut x, &mut next);
            trajectory.push(x.clone());
        }
        for k in 0..steps {
            model.linearize(k, k, &trajectory[k], &trajectory[k + 1])?;
        }
        let clock = std::time::Instant::now();
        let mut lambda = vec![1.0; 7];
        (steps / 2..steps).rev().for_each(|k| model.adjoint(k, &mut lambda));
        let first = clock.elapsed().as_secs_f64();
        let clock = std::time::Instant::now();
        (0..steps / 2).rev().for_each(|k| model.adjoint(k, &mut lambda));
        let second = clock.elapsed().as_secs_f64();
        // the slowest decays by 1/(1 + 0.01) a step: (1/1.01)^steps, below the smallest number from 75 000
        // steps on
        let expected = (-(steps as f64) * 1.01_f64.ln()).exp();
        let error = if expected > 1e-300 { (lambda[0] / expected - 1.0).abs() } else { lambda[0].abs() };
        case.at_most("error of the slowest", error, 2.0 * f64::EPSILON * steps as f64, "-")
            .because("one rounding a step; absolute where the answer is below 1e-300")
            .work(work(&model, f64::NAN))
            .computed(lambda[0]);
        let wild = lambda.iter().filter(|l| !l.is_finite()).count();
        case.count("adjoints that are not finite", wild, 0);
        let subnormal = lambda.iter().filter(|l| l.is_subnormal()).count();
        case.inform(
            "time of an adjoint step, second half of the steps over the \
            first",
            second / first,
            "-",
        )
        .note(format!(
            "{subnormal} of 7 adjoints end subnormal, where λ/1.01 rounds to λ again; clocks \
                inform, they never gate: 1 says that such numbers cost nothing, a trap would cost 100"
        ));
        Ok(())
    });
}

struct Decay;

impl Decay {
    fn rate(i: usize) -> f64 {
        10.0_f64.powi(i as i32)
    }
}

impl Rhs for Decay {
    fn dim(&self) -> usize {
        7
    }
    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        f.iter_mut().enumerate().for_each(|(i, f)| *f = -Decay::rate(i) * x[i]);
    }
    fn tangent(&mut self, t: f64, _x: &[f64], dx: &[f64], df: &mut [f64]) {
        self.eval(t, dx, df);
    }
    fn adjoint_add(&mut self, _t: f64, _x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx.iter_mut().enumerate().for_each(|(i, d)| *d -= Decay::rate(i) * lambda[i]);
    }
}
