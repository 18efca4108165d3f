//! What derivatives cost, in forward runs, and how right they are.

use super::clock::timed;
use super::{Cell, Options, Page, Result, Table};
use crate::cells;
use problems::rods::{HangingRod, wave};
use problems::small_problems::lorenz96_window;
use problems::small_problems::{all_of, dot, long_lorenz63, observation};
use std::f64::consts::TAU;
use varda::report::chart::{Corner, Panel, Series, Style};
use varda_assimilation::{ControlTransform, CostFunction, LeastSquares, ObservationSet, StrongConstraint};
use varda_covariance::{Covariance, Diagonal};
use varda_implicit::line::{Ends, Line, Transport};
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{ImplicitModel, Linearization, Model, OneLeg, Rk4};
use varda_rod::TwistUnknowns;

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut benchmark = Benchmark {
        samples: options.samples(),
        costs: Table::new("costs", "Cost of derivatives, in forward runs", &COSTS),
        differences: Table::new(
            "differences",
            "The same gradients by differences of J",
            &["problem", "method", "h", "forward runs", "ms (least)", "error"],
        ),
        series: Vec::new(),
    };
    let (left_out, kept) = (TwistUnknowns::WhereNeeded, TwistUnknowns::Always);
    benchmark.flagship("without angles", left_out, Linearization::Accepted)?;
    benchmark.flagship("reuse", left_out, Linearization::LastFactor)?;
    benchmark.flagship("with angles", kept, Linearization::Accepted)?;
    let references = [(40, 2499.876979576174), (1000, 11107.61576870228)];
    for (n, reference) in &references[..if options.quick { 1 } else { 2 }] {
        let (background, mut set, v) = lorenz96_window(*n)?;
        let b = Diagonal::uniform(*n, 0.5)?;
        let mut model = Rk4::new(Lorenz96::new(*n, 8.0), 0, 0.01);
        let name = format!("Lorenz-96, N = {n}, RK4");
        let problem = Problem { name, background, b: &b, v, reference: Some(*reference) };
        benchmark.problem(&problem, &mut model, &mut set, *n == 40)?;
    }
    let (_, background, mut set) = long_lorenz63(1)?;
    let b = Diagonal::uniform(3, 1.0)?;
    let at = vec![0.1, -0.2, 0.3];
    let problem = Problem { name: "Lorenz-63, RK4".into(), background, b: &b, v: at, reference: None };
    benchmark.problem(&problem, &mut Rk4::new(Lorenz63::default(), 0, 0.01), &mut set, false)?;
    let line = Line { points: 100, length: 1.0, ends: Ends::Periodic };
    let advection = Transport::advection_diffusion(line, 1.0, 1e-3);
    benchmark.transport("advection–diffusion, 100 points, midpoint", advection)?;
    benchmark.transport("Burgers, 100 points, midpoint", Transport::burgers(line, 0.01))?;

    let Benchmark { costs, differences, series, .. } = benchmark;
    Ok(Page {
        title: "Gradients: cost and error",
        text: TEXT.into(),
        tables: vec![costs, differences],
        panels: vec![Panel {
            x_label: "seconds of one gradient".into(),
            y_label: "relative error of the gradient".into(),
            log_x: true,
            log_y: true,
            legend: Some(Corner::Top),
            series,
            ..Panel::default()
        }],
        remarks: String::new(),
    })
}

const TEXT: &str = "\
Columns, all but \"ms\" as ratios of least times to that of the forward run:

- *forward run*: the plain window, nothing kept, same tolerance;
- *adjoint sweep*: with linearizations kept; *refactoring*: with every step assembled and factored \
again;
- *gradient*: J and ∇J from a new v, its own forward run included; *reuse*: the same with the last \
Newton factor of each step, one iterate old, as its linearization;
- *product*: A v, a tangent and an adjoint sweep on the kept trajectory;
- *dense*: all of A, by columns (tangent sweeps) or rows (adjoint sweeps), whichever take fewer steps.

*Error*: |g·d − D|/|g·d| for one random direction d. D is a central difference of J of fourth order, \
at the step size (10⁻¹ … 10⁻⁵) that agrees best with the one before it; where that disagreement \
is larger, it is the error. Where a reference is known ([Lorenz-96 \
values](../reference-problems.md#lorenz-96-values)) the error is | |g| − |g|_ref |/|g|_ref. The second \
table takes all n components by differences; its error is the Euclidean distance to the adjoint's \
gradient, relative.

[Targets](../reference-problems.md#targets): adjoint ≤ 0.05 (kept) and ≤ 0.35 (refactoring), \
gradient ≤ 1.3, dense Hessian of the flagship ≤ 2, forward window ≤ 3 ms; Lorenz-96: gradient ≤ \
2.5, product ≤ 4.";

const COSTS: [&str; 14] = [
    "problem",
    "n",
    "steps",
    "m",
    "forward ms",
    "forward ms (least)",
    "adjoint sweep",
    "refactoring",
    "gradient",
    "gradient ms",
    "product",
    "dense",
    "error",
    "against",
];

struct Problem<'a> {
    name: String,
    background: Vec<f64>,
    b: &'a dyn Covariance,
    v: Vec<f64>,
    /// |∇J| in x, where B = 0.25 I.
    reference: Option<f64>,
}

struct Benchmark {
    samples: usize,
    costs: Table,
    differences: Table,
    series: Vec<Series>,
}

impl Benchmark {
    fn flagship(&mut self, what: &str, twist: TwistUnknowns, linearization: Linearization) -> Result<()> {
        let (rod, truth) = HangingRod::flagship(1, true)?;
        let observations = rod.observe_with_waves(&truth)?;
        let mut model = rod.model_with(rod.first_step, twist)?.with_linearization(linearization);
        let mut set = rod.observation_set(model.dim(), observations)?;
        let b = rod.background_covariance()?;
        let v = (0..model.control_dim()).map(|i| 0.1 * wave(i, 1)).collect();
        let name = format!("flagship, case 1, {what}");
        let problem = Problem { name, background: truth, b: &b, v, reference: None };
        self.problem(&problem, &mut model, &mut set, what == "without angles")
    }

    fn transport(&mut self, name: &str, rhs: Transport) -> Result<()> {
        let line = *rhs.line();
        let background: Vec<f64> = (0..100).map(|i| (TAU * line.position(i)).sin()).collect();
        let rows: Vec<usize> = (0..100).step_by(5).collect();
        let seen = (1..=5).map(|j| {
            let y: Vec<f64> = rows.iter().map(|r| wave(*r, j)).collect();
            observation(&rows, 10 * j, 0.0, &y, 0.3)
        });
        let mut set = ObservationSet::new(50, vec![all_of(100)?], seen.collect())?;
        let b = Diagonal::uniform(100, 0.1)?;
        let v = (0..100).map(|i| wave(i, 1)).collect();
        let mut model = ImplicitModel::new(OneLeg::implicit_midpoint(rhs, 1e-12), 0, 0.01);
        let problem = Problem { name: name.into(), background, b: &b, v, reference: None };
        self.problem(&problem, &mut model, &mut set, false)
    }

    fn problem(
        &mut self,
        problem: &Problem,
        model: &mut dyn Model,
        set: &mut ObservationSet,
        by_differences: bool,
    ) -> Result<()> {
        let (samples, steps) = (self.samples, set.last_step().unwrap_or(0));
        let transform = ControlTransform::new(problem.background.clone(), problem.b)?;
        let mut z = vec![0.0; transform.control_dim()];
        transform.control(&problem.v, &mut z);
        let dim = model.dim();
        let mut states = vec![0.0; (steps + 1) * dim];
        model.initial_state(&z, &mut states[..dim])?;
        let forward =
            timed(samples, || along(&mut states, dim, |k, x, next| model.step(k, x, next).map(drop)))?;
        let linearize = timed(samples, || {
            along(&mut states, dim, |k, x, next| model.linearize(k, k, x, next).map(drop))
        })?;
        let mut lambda = vec![0.0; dim];
        let adjoint = timed(samples, || {
            lambda.fill(1e-3);
            (0..steps).rev().for_each(|k| model.adjoint(k, &mut lambda));
            Ok::<(), varda_implicit::Error>(())
        })?;

        let mut cost = StrongConstraint::new(model, transform, set)?;
        let (n, m) = (cost.dim(), cost.observation_dim());
        let (mut v, mut g, mut out) = (problem.v.clone(), vec![0.0; n], vec![0.0; n]);
        let gradient = timed(samples, || {
            // A cost keeps what it knows of its last two points.
            v[0] += 1e-10;
            cost.evaluate(&v, Some(&mut g)).map(drop)
        })?;
        let product = timed(samples, || cost.hessian_apply(&problem.v, &mut out))?;
        let dense = match n {
            ..=200 => {
                let mut a = vec![0.0; n * n];
                Some(timed(samples, || cost.hessian(&mut a))?.least / forward.least)
            }
            _ => None,
        };
        cost.evaluate(&problem.v, Some(&mut g))?;
        let (error, against) = match problem.reference {
            // dJ/dx = 2 dJ/dv
            Some(reference) => ((2.0 * dot(&g, &g).sqrt() - reference).abs() / reference, "reference"),
            None => (directional(&mut cost, &problem.v, &g)?, "differences"),
        };
        let ratio = |seconds: f64| Cell::from(seconds / forward.least);
        self.costs.push(vec![
            problem.name.as_str().into(),
            n.into(),
            steps.into(),
            m.into(),
            (1e3 * forward.median).into(),
            (1e3 * forward.least).into(),
            ratio(adjoint.least),
            ratio(linearize.least + adjoint.least),
            ratio(gradient.least),
            (1e3 * gradient.median).into(),
            ratio(product.least),
            dense.into(),
            error.into(),
            against.into(),
        ]);
        if by_differences {
            let color = self.series.len();
            let label = format!("{}: adjoint", problem.name);
            let points = vec![(gradient.least, error.max(f64::EPSILON))];
            self.series.push(Series { label, style: Style::Marked(color), points });
            self.by_differences(problem, &mut cost, &g)?;
        }
        Ok(())
    }

    /// All components of the gradient by one-sided and by central differences.
    fn by_differences(&mut self, problem: &Problem, cost: &mut StrongConstraint, g: &[f64]) -> Result<()> {
        let n = g.len();
        for (method, runs) in [("one-sided", n + 1), ("central", 2 * n)] {
            let mut points = Vec::new();
            for h in [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7] {
                let mut v = problem.v.clone();
                let mut off = vec![0.0; n];
                let timing = timed(self.samples.min(3), || {
                    let here = cost.evaluate(&problem.v, None)?;
                    for i in 0..n {
                        v[i] = problem.v[i] + h;
                        let ahead = cost.evaluate(&v, None)?;
                        v[i] = problem.v[i] - h;
                        let slope = match method {
                            "central" => (ahead - cost.evaluate(&v, None)?) / (2.0 * h),
                            _ => (ahead - here) / h,
                        };
                        v[i] = problem.v[i];
                        off[i] = slope - g[i];
                    }
                    Ok::<(), varda_assimilation::Error>(())
                })?;
                let error = (dot(&off, &off) / dot(g, g)).sqrt();
                let name = problem.name.as_str();
                self.differences.push(cells![name, method, h, runs, 1e3 * timing.least, error]);
                points.push((timing.least, error));
            }
            let label = format!("{}: {method} differences", problem.name);
            self.series.push(Series { label, style: Style::Marked(self.series.len()), points });
        }
        Ok(())
    }
}

/// Relative error of g along one direction, against differences of fourth order.
fn directional(cost: &mut StrongConstraint, v: &[f64], g: &[f64]) -> Result<f64> {
    let d: Vec<f64> = (0..v.len()).map(|i| wave(i, 9)).collect();
    let slope = dot(g, &d);
    let mut found = Vec::new();
    for exponent in 2..=10 {
        let h = 10f64.powf(-0.5 * f64::from(exponent));
        let mut j = |steps: f64| {
            let at: Vec<f64> = v.iter().zip(&d).map(|(v, d)| v + steps * h * d).collect();
            cost.evaluate(&at, None)
        };
        let difference = (8.0 * (j(1.0)? - j(-1.0)?) - (j(2.0)? - j(-2.0)?)) / (12.0 * h);
        found.push(difference);
    }
    // The step that suits best is where neighbouring steps agree best; the gradient has no say in it.
    let best = found.windows(2).min_by(|a, b| (a[0] - a[1]).abs().total_cmp(&(b[0] - b[1]).abs()));
    // An error below what the differences themselves are worth is theirs.
    Ok(best.map_or(f64::NAN, |pair| (pair[1] - slope).abs().max((pair[1] - pair[0]).abs()) / slope.abs()))
}

/// Calls `each` with (k, x_k, x_{k+1}) along states that lie one after the other.
fn along<E>(
    states: &mut [f64],
    dim: usize,
    mut each: impl FnMut(usize, &[f64], &mut [f64]) -> std::result::Result<(), E>,
) -> std::result::Result<(), E> {
    (0..states.len() / dim - 1).try_for_each(|k| {
        let (x, next) = states[k * dim..(k + 2) * dim].split_at_mut(dim);
        each(k, x, next)
    })
}
