//! Time integration: error against seconds.

use super::clock::timed;
use super::{Options, Page, Result, Table};
use crate::cells;
use problems::rods::DrivenRod;
use std::cell::RefCell;
use std::f64::consts::TAU;
use std::rc::Rc;
use varda::report::chart::{Corner, Panel, Series, Style};
use varda_implicit::lorenz::Lorenz63;
use varda_implicit::{
    Adaptive, Counts, Equations, ImplicitModel, ImplicitStep, Interval, Log, Model, OneLeg, Rhs, Rk4, Scheme,
    accepted_times,
};
use varda_rod::{Clamp, ClampAt, Damping, RodStep, Supports, equilibrium, straight_guess};

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut benchmark = Benchmark {
        options: *options,
        table: Table::new("methods", "Every method and step", &COLUMNS),
        panels: Vec::new(),
        wanted: Table::new(
            "wanted",
            "Seconds to an error of 1 % and 0.1 % of L: the largest step tried that stays below",
            &["problem", "method", "1 %: Δt [s]", "1 %: s (least)", "0.1 %: Δt [s]", "0.1 %: s (least)"],
        ),
        divided: Table::new(
            "divided",
            "Steps chosen by their estimated error",
            &[
                "problem",
                "method",
                "tolerance",
                "steps",
                "shortest [s]",
                "longest [s]",
                "error",
                "s to choose (least)",
                "s to run (least)",
            ],
        ),
        remarks: Vec::new(),
    };
    benchmark.driven("driven rod, 1 MPa", DrivenRod::SOFT, 2e-4)?;
    benchmark.driven("driven rod, 1 GPa", DrivenRod { modulus: 1e9, ..DrivenRod::SOFT }, 4e-5)?;
    benchmark.mode()?;
    benchmark.lorenz63()?;
    benchmark.stiff()?;
    let Benchmark { table, panels, wanted, divided, remarks, .. } = benchmark;
    Ok(Page {
        title: "Time integration: error against seconds",
        text: TEXT.into(),
        tables: vec![wanted, divided, table],
        panels,
        remarks: remarks.join("\n\n"),
    })
}

const TEXT: &str = "\
[Driven rod](../reference-problems.md#driven-rod), two seconds from rest. *Error*: distance to the \
reference at 2 s, root mean square over the free vertices, divided by L. *Reference*: the same discrete \
rod by explicit RK4, self-converged; its order and error stand below. It shares the forces with the \
other methods and nothing of their time stepping. Errors of the discretization in space are not in these \
numbers.

*Adaptive steps*: `accepted_times` with a tolerance on the error of one step (root mean square over the \
positions, divided by L), at most 0.1 s. Choosing them takes three solves for each step tried, running \
them one: an assimilation chooses once and runs many times.

*Rod in its first mode*: the same rod with its clamp at rest, released 0.02 mm out of equilibrium in the \
shape of its slowest sideways mode, for 2⅛ periods. The exact solution is a cos ωt of the linearized \
discrete rod, from its Hessian, independent of any time stepping. *Error*: root mean square, divided by \
that of the mode.

*Lorenz-63* from (1, 1, 20) for one unit of time, against RK4 at Δt = 10⁻⁵; error ‖x − \
x_ref‖/‖x_ref‖. *Prothero–Robinson (1974)*: ẋ = −10⁴ (x − cos t) − sin t from x = 1.5 \
for ten units of time; exact solution cos t + ½ exp(−10⁴ t); error |x − cos t|.";

const COLUMNS: [&str; 9] = [
    "problem",
    "method",
    "Δt [s]",
    "steps",
    "error",
    "s",
    "s (least)",
    "Newton iterations",
    "factorizations",
];

const SCHEMES: [Scheme; 3] = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];

/// A model and its state at time 0.
type Start = (Box<dyn Model>, Vec<f64>);
/// Makes one for a step Δt.
type Make<'a> = &'a dyn Fn(f64) -> Result<Start>;

struct Benchmark {
    options: Options,
    table: Table,
    panels: Vec<Panel>,
    wanted: Table,
    divided: Table,
    remarks: Vec<String>,
}

/// One method on one problem.
struct Method<'a> {
    name: &'static str,
    make: Make<'a>,
    /// Steps tried.
    steps: Vec<usize>,
}

impl Benchmark {
    fn driven(&mut self, name: &str, rod: DrivenRod, reference_step: f64) -> Result<()> {
        let duration = 2.0;
        let positions = 3 * (rod.segments - 1);
        let explicit = |dt: f64| -> Result<Start> {
            let (model, x) = rod.model(dt)?;
            Ok((Box::new(Rk4::new(RodMotion::new(model.into_inner()), 0, dt)), x))
        };
        let end = |dt: f64| -> Result<Vec<f64>> {
            let steps = (duration / dt).round() as usize;
            Ok(run_to_end(&explicit, duration, steps)?.0[..positions].to_vec())
        };
        let distance = |a: &[f64], b: &[f64]| {
            let sum: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
            (sum / (positions / 3) as f64).sqrt()
        };
        let [coarse, middle, fine] = [1.0, 2.0, 4.0].map(|k| end(reference_step / k));
        let (coarse, middle, fine) = (coarse?, middle?, fine?);
        let (first, second) = (distance(&coarse, &middle), distance(&middle, &fine));
        self.remarks.push(format!(
            "Reference of \"{name}\": RK4 at Δt = {:.0e} s; halving the step twice, to that, changes the \
             end by {first:.1e} and {second:.1e} of L: order {:.2}, error left (Richardson) {:.1e}.",
            reference_step / 4.0,
            (first / second).log2(),
            second / 15.0
        ));
        let error = |x: &[f64]| distance(&x[..positions], &fine);
        let implicit = |scheme| {
            move |dt: f64| -> Result<Start> {
                let (model, x) = DrivenRod { scheme, ..rod }.model(dt)?;
                Ok((Box::new(model), x))
            }
        };
        let [euler, midpoint, bdf2] = SCHEMES.map(implicit);
        let halved = |first: usize, times: u32| (0..=times).map(|i| first << i).collect();
        let stable = (duration / reference_step).round() as usize / 8;
        let methods = [
            Method { name: "backward Euler", make: &euler, steps: halved(50, 10) },
            Method { name: "midpoint", make: &midpoint, steps: halved(50, 7) },
            Method { name: "BDF2", make: &bdf2, steps: halved(50, 7) },
            Method { name: "RK4, explicit", make: &explicit, steps: halved(stable, 3) },
        ];
        self.problem(name, duration, &methods, &error)?;
        for method in &methods {
            let rows = self.table.rows.iter().filter(|r| r[0] == name.into() && r[1] == method.name.into());
            let numbers = |r: &Vec<super::Cell>| {
                [&r[2], &r[4], &r[6]].map(|c| match c {
                    super::Cell::Number(x) => *x,
                    _ => f64::NAN,
                })
            };
            let rows: Vec<[f64; 3]> = rows.map(numbers).collect();
            let first = |bound: f64| rows.iter().find(|r| r[1] <= bound).map(|r| (r[0], r[2]));
            let (percent, permille) = (first(1e-2), first(1e-3));
            self.wanted.push(cells![
                name,
                method.name,
                percent.map(|r| r.0),
                percent.map(|r| r.1),
                permille.map(|r| r.0),
                permille.map(|r| r.1)
            ]);
        }
        for (scheme, method) in SCHEMES.iter().zip(&methods) {
            self.divided(name, method.name, DrivenRod { scheme: *scheme, ..rod }, duration, &error)?;
        }
        Ok(())
    }

    /// The same by steps of every length: chosen once, which takes three solves a step tried, then run as
    /// they are.
    fn divided(
        &mut self,
        name: &str,
        method: &str,
        rod: DrivenRod,
        duration: f64,
        error: &dyn Fn(&[f64]) -> f64,
    ) -> Result<()> {
        let samples = self.options.samples();
        let tolerances: &[f64] = if self.options.quick { &[1e-3] } else { &[1e-3, 1e-4, 1e-5, 1e-6] };
        for &tolerance in tolerances {
            let (model, x0) = rod.model(1e-3)?;
            let (mut step, mut scale) = (model.into_inner(), vec![f64::INFINITY; x0.len()]);
            // L = 1 m, as in the errors
            scale[..3 * (rod.segments - 1)].fill(1.0);
            let options = Adaptive { tolerance, first: 1e-3, shortest: 1e-7, longest: 0.1 };
            let mut times = Vec::new();
            let choosing = timed(samples, || {
                times = accepted_times(&mut step, rod.scheme, &x0, &scale, &[0.0, duration], &options)?;
                Ok::<(), varda_implicit::Error>(())
            })?;
            let mut x = x0.clone();
            let running = timed(samples, || {
                let mut model = ImplicitModel::on_times(rod.model(1e-3)?.0.into_inner(), times.clone());
                x = along(&mut model, &x0, times.len() - 1)?.0;
                Ok::<(), Box<dyn std::error::Error>>(())
            })?;
            let lengths = || times.windows(2).map(|t| t[1] - t[0]);
            self.divided.push(cells![
                name,
                method,
                tolerance,
                times.len() - 1,
                lengths().fold(f64::INFINITY, f64::min),
                lengths().fold(0.0, f64::max),
                error(&x),
                choosing.least,
                running.least
            ]);
        }
        Ok(())
    }

    /// A rod swinging in its slowest mode.
    fn mode(&mut self) -> Result<()> {
        let mode = Mode::new()?;
        let duration = 2.125 * TAU / mode.omega;
        let error = |x: &[f64]| {
            let exact = mode.at(duration);
            let squares = |of: &mut dyn Iterator<Item = f64>| of.map(|d| d * d).sum::<f64>().sqrt();
            let off = squares(&mut x.iter().zip(&exact).map(|(a, b)| a - b));
            off / squares(&mut mode.shape.iter().copied())
        };
        self.remarks.push(format!(
            "First mode: {:.6} Hz for 25 segments; the continuous rod has 0.619921 Hz ([closed \
                forms](../reference-problems.md#closed-forms-of-rods)).",
            mode.omega / TAU
        ));
        let implicit = |scheme| {
            let mode = &mode;
            move |dt: f64| -> Result<Start> {
                let (model, x) = mode.start(scheme, dt)?;
                Ok((Box::new(model), x))
            }
        };
        let [euler, midpoint, bdf2] = SCHEMES.map(implicit);
        let explicit = |dt: f64| -> Result<Start> {
            let (model, x) = mode.start(Scheme::BackwardEuler, dt)?;
            Ok((Box::new(Rk4::new(RodMotion::new(model.into_inner()), 0, dt)), x))
        };
        let steps = |times: u32| (0..times).map(|i| 64 << i).collect();
        let methods = [
            Method { name: "backward Euler", make: &euler, steps: steps(8) },
            Method { name: "midpoint", make: &midpoint, steps: steps(7) },
            Method { name: "BDF2", make: &bdf2, steps: steps(7) },
            Method { name: "RK4, explicit", make: &explicit, steps: (0..3).map(|i| 2048 << i).collect() },
        ];
        self.problem("rod in its first mode", duration, &methods, &error)
    }

    fn lorenz63(&mut self) -> Result<()> {
        let x0 = [1.0, 1.0, 20.0];
        let rk4 =
            |dt: f64| -> Result<Start> { Ok((Box::new(Rk4::new(Lorenz63::default(), 0, dt)), x0.to_vec())) };
        let implicit = |scheme| {
            move |dt: f64| -> Result<Start> {
                started(OneLeg::new(Lorenz63::default(), scheme, 1e-12), &x0, dt)
            }
        };
        let [euler, midpoint, bdf2] = SCHEMES.map(implicit);
        let (exact, _) = run_to_end(&rk4, 1.0, 100_000)?;
        let error = |x: &[f64]| {
            let squares = |a: &[f64]| a.iter().map(|a| a * a).sum::<f64>().sqrt();
            squares(&x.iter().zip(&exact).map(|(a, b)| a - b).collect::<Vec<_>>()) / squares(&exact)
        };
        let steps: Vec<usize> = (0..8).map(|i| 50 << i).collect();
        let methods = [
            Method { name: "implicit Euler", make: &euler, steps: steps.clone() },
            Method { name: "implicit midpoint", make: &midpoint, steps: steps.clone() },
            Method { name: "BDF2", make: &bdf2, steps: steps.clone() },
            Method { name: "RK4, explicit", make: &rk4, steps },
        ];
        self.problem("Lorenz-63", 1.0, &methods, &error)
    }

    fn stiff(&mut self) -> Result<()> {
        let rk4 = |dt: f64| -> Result<Start> { Ok((Box::new(Rk4::new(ProtheroRobinson, 0, dt)), vec![1.5])) };
        let implicit = |scheme| {
            move |dt: f64| -> Result<Start> {
                started(OneLeg::new(ProtheroRobinson, scheme, 1e-13), &[1.5], dt)
            }
        };
        let [euler, midpoint, bdf2] = SCHEMES.map(implicit);
        let error = |x: &[f64]| (x[0] - 10f64.cos()).abs();
        let steps: Vec<usize> = (0..6).map(|i| 40 * 5usize.pow(i)).collect();
        let methods = [
            Method { name: "implicit Euler", make: &euler, steps: steps.clone() },
            Method { name: "implicit midpoint", make: &midpoint, steps: steps.clone() },
            Method { name: "BDF2", make: &bdf2, steps: steps.clone() },
            Method { name: "RK4, explicit", make: &rk4, steps },
        ];
        self.problem("Prothero–Robinson", 10.0, &methods, &error)
    }

    /// Runs every method with every step.
    fn problem(
        &mut self,
        name: &str,
        duration: f64,
        methods: &[Method],
        error: &dyn Fn(&[f64]) -> f64,
    ) -> Result<()> {
        let mut series = Vec::new();
        for (i, method) in methods.iter().enumerate() {
            let mut points = Vec::new();
            let tried = if self.options.quick { &method.steps[..2] } else { &method.steps[..] };
            for &steps in tried {
                let dt = duration / steps as f64;
                // A step too large for the method is a row with its failure.
                let Ok((x, counts)) = run_to_end(method.make, duration, steps) else {
                    self.table.push(cells![
                        name,
                        method.name,
                        dt,
                        steps,
                        "diverges",
                        None,
                        None,
                        0usize,
                        0usize
                    ]);
                    continue;
                };
                let timing =
                    timed(self.options.samples(), || run_to_end(method.make, duration, steps).map(drop))?;
                let error = error(&x);
                self.table.push(cells![
                    name,
                    method.name,
                    dt,
                    steps,
                    error,
                    timing.median,
                    timing.least,
                    counts.newton_iterations,
                    counts.factorizations
                ]);
                points.push((timing.least, error));
            }
            series.push(Series { label: method.name.into(), style: Style::Marked(i), points });
        }
        self.panels.push(Panel {
            title: name.into(),
            x_label: "seconds".into(),
            y_label: "error".into(),
            log_x: true,
            log_y: true,
            legend: Some(Corner::Top),
            series,
            ..Panel::default()
        });
        Ok(())
    }
}

/// A step with the initial state of a control.
fn started<S: ImplicitStep + 'static>(step: S, z: &[f64], dt: f64) -> Result<Start> {
    let mut model = ImplicitModel::new(step, 0, dt);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(z, &mut x)?;
    Ok((Box::new(model), x))
}

/// The state after `steps` equal steps.
fn run_to_end(make: Make, duration: f64, steps: usize) -> Result<(Vec<f64>, Counts)> {
    let (mut model, x) = make(duration / steps as f64)?;
    along(model.as_mut(), &x, steps)
}

/// The state after so many steps of a model from x₀.
fn along(model: &mut dyn Model, x0: &[f64], steps: usize) -> Result<(Vec<f64>, Counts)> {
    let (mut x, mut next) = (x0.to_vec(), x0.to_vec());
    let mut log = Log::default();
    for k in 0..steps {
        log.step(k, model.step(k, &x, &mut next)?);
        std::mem::swap(&mut x, &mut next);
    }
    Ok((x, log.counts))
}

/// M Ẍ = F(t, X) of an undamped rod without angles, as a system of first order in [X, V].
#[derive(Clone)]
struct RodMotion {
    step: Rc<RefCell<RodStep>>,
    masses: Vec<f64>,
    at_rest: Vec<f64>,
    u: Vec<f64>,
    gradient: Vec<f64>,
}

impl RodMotion {
    fn new(step: RodStep) -> RodMotion {
        let masses = step.free_vertices().iter().map(|&v| step.rod().masses[v]).collect();
        let (n, unknowns) = (step.dim(), step.unknowns());
        RodMotion {
            step: Rc::new(RefCell::new(step)),
            masses,
            at_rest: vec![0.0; n],
            u: vec![0.0; unknowns],
            gradient: vec![0.0; unknowns],
        }
    }
}

impl Rhs for RodMotion {
    fn dim(&self) -> usize {
        self.at_rest.len()
    }

    /// The potential of backward Euler's step from (X, 0) to X has no inertia left: its gradient is −F.
    /// Forces are those at the end.
    fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
        let n = x.len() / 2;
        self.at_rest[..n].copy_from_slice(&x[..n]);
        let at = Interval { index: 0, start: t - 1.0, length: 1.0, previous: None };
        let mut step = self.step.borrow_mut();
        step.recover(&at, &self.at_rest, &self.at_rest, &mut self.u);
        let assembled = step
            .equations(&at, &self.at_rest)
            .and_then(|mut equations| equations.assemble(&self.u, &mut self.gradient, None));
        match assembled {
            Ok(_) => {
                f[..n].copy_from_slice(&x[n..]);
                for (f, g) in f[n..]
                    .chunks_exact_mut(3)
                    .zip(self.gradient.chunks_exact(3))
                    .zip(&self.masses)
                    .map(|((f, g), m)| (f, (g, m)))
                {
                    (0..3).for_each(|c| f[c] = -g.0[c] / g.1);
                }
            }
            // A step that is too large ends in an error of the model.
            Err(_) => f.fill(f64::NAN),
        }
    }

    fn tangent(&mut self, _t: f64, _x: &[f64], _dx: &[f64], _df: &mut [f64]) {
        unreachable!("runs forward only")
    }

    fn adjoint_add(&mut self, _t: f64, _x: &[f64], _lambda: &[f64], _dx: &mut [f64]) {
        unreachable!("runs forward only")
    }
}

/// ẋ = −10⁴ (x − cos t) − sin t.
#[derive(Clone, Copy)]
struct ProtheroRobinson;

const STIFFNESS: f64 = 1e4;

impl Rhs for ProtheroRobinson {
    fn dim(&self) -> usize {
        1
    }
    fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
        f[0] = -STIFFNESS * (x[0] - t.cos()) - t.sin();
    }
    fn tangent(&mut self, _t: f64, _x: &[f64], dx: &[f64], df: &mut [f64]) {
        df[0] = -STIFFNESS * dx[0];
    }
    fn adjoint_add(&mut self, _t: f64, _x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        dx[0] -= STIFFNESS * lambda[0];
    }
}

/// The slowest sideways motion of the soft rod about its equilibrium, a · shape · cos ωt.
struct Mode {
    omega: f64,
    /// Equilibrium, and displacements \[m\]: positions of the free vertices.
    rest: Vec<f64>,
    shape: Vec<f64>,
}

impl Mode {
    fn new() -> Result<Mode> {
        let (rod, loads, held) = (DrivenRod::SOFT.rod()?, DrivenRod::SOFT.loads(), Mode::held());
        let guess = straight_guess(&rod, &held, 0.0, [0.0, 0.0, -1.0])?;
        let (shape, _) = equilibrium(&rod, &held, &loads, 0.0, &guess)?;
        let mut step = RodStep::new(rod, held, loads, Damping::default())?;
        let mut rest = step.control_at_rest(&shape);
        rest.truncate(step.control_len() / 2);
        let masses: Vec<f64> = step.free_vertices().iter().map(|&v| step.rod().masses[v]).collect();

        // ∂G/∂u = M/Δt² + K with Δt = 1 s.
        let at = Interval { index: 0, start: -1.0, length: 1.0, previous: None };
        let mut x = rest.clone();
        x.resize(step.dim(), 0.0);
        let (n, width) = (step.unknowns(), step.half_bandwidth() + 1);
        let (mut u, mut g, mut values) = (vec![0.0; n], vec![0.0; n], vec![0.0; n * width]);
        step.recover(&at, &x, &x, &mut u);
        step.equations(&at, &x)
            .and_then(|mut equations| equations.assemble(&u, &mut g, Some(&mut values)))
            .map_err(|e| format!("{e:?}"))?;
        // Sideways motion in x stays apart: M^{-1/2} K_xx M^{-1/2}.
        let f = masses.len();
        let mut a = vec![0.0; f * f];
        for i in 0..f {
            for j in 0..=i {
                let (row, column) = (3 * i, 3 * j);
                if row - column < width {
                    let inertia = if i == j { masses[i] } else { 0.0 };
                    let k = values[row * width + column + width - 1 - row] - inertia;
                    a[i + j * f] = k / (masses[i] * masses[j]).sqrt();
                    a[j + i * f] = a[i + j * f];
                }
            }
        }
        let eigen = varda_linalg::Eigen::new(f, &a)?;
        let mode: Vec<f64> = (0..f).map(|i| eigen.vectors[i] / masses[i].sqrt()).collect();
        let largest = mode.iter().fold(0.0, |m: f64, x| m.max(x.abs()));
        let amplitude = 2e-5;
        let shape = mode.iter().flat_map(|m| [amplitude * m / largest, 0.0, 0.0]).collect();
        Ok(Mode { omega: eigen.values[0].sqrt(), rest, shape })
    }

    fn held() -> Supports {
        Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]))
    }

    fn at(&self, t: f64) -> Vec<f64> {
        self.rest.iter().zip(&self.shape).map(|(x, d)| x + d * (self.omega * t).cos()).collect()
    }

    fn start(&self, scheme: Scheme, dt: f64) -> Result<(ImplicitModel<RodStep>, Vec<f64>)> {
        let (rod, loads) = (DrivenRod::SOFT.rod()?, DrivenRod::SOFT.loads());
        let step = RodStep::new(rod, Mode::held(), loads, Damping::default())?.with_scheme(scheme);
        let mut model = ImplicitModel::new(step, 0, dt);
        let mut z = self.at(0.0);
        z.resize(model.control_dim(), 0.0);
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&z, &mut x)?;
        Ok((model, x))
    }
}
