//! Chaotic windows: how far a gradient can be trusted, how many minima J has, and growing the window.

use crate::row::{Case, Outcome, Rows, Work};
use crate::suites::Options;
use problems::small_problems::{all_of, difference, normals, observation, states};
use std::ops::ControlFlow;
use varda_assimilation::{
    ControlTransform, CostFunction, Error, Minimizer, ObservationSet, StrongConstraint, window_growth,
};
use varda_covariance::Diagonal;
use varda_implicit::lorenz::{Lorenz63, Lorenz96};
use varda_implicit::{Keep, Model, Rhs, Rk4, Trajectory, check};
use varda_linalg::check::Random;

pub(super) fn run(rows: &mut Rows, options: &Options) {
    for length in rows.grid("windows of Lorenz-63", [5.0, 10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0]) {
        rows.case(&format!("gradient of Lorenz-63 over T = {length}"), |case| {
            let start = states(&mut Rk4::new(Lorenz63::default(), 0, 0.01), &[1.0, 3.0, 20.0], 1000)?;
            accuracy(case, &Lorenz63::default(), &start[1000], 0.01, length)
        });
    }
    for length in rows.grid("windows of Lorenz-96", [4.0, 8.0, 12.0, 16.0, 20.0, 24.0]) {
        rows.case(&format!("gradient of Lorenz-96 over T = {length}"), |case| {
            let model = Lorenz96::new(40, 8.0);
            let begin: Vec<f64> = normals(9, 40).iter().map(|x| 2.0 + 3.0 * x).collect();
            let start = states(&mut Rk4::new(model, 0, 0.025), &begin, 400)?;
            accuracy(case, &model, &start[400], 0.025, length)
        });
    }
    for seed in rows.grid("seeds of local minima", [1, 2, 3]) {
        rows.case(&format!("local minima of Lorenz-63, seed {seed}"), |case| {
            minima(case, seed, options.quick)
        });
    }
}

/// Measures the relative error of the gradient of ½‖x_N‖² and holds it against the estimate ε‖M‖.
///
/// The reference is the same gradient in variables three times as large: the same numbers with other
/// roundings.
fn accuracy<R: Rhs + Clone + 'static>(case: &mut Case, rhs: &R, x0: &[f64], dt: f64, length: f64) -> Outcome {
    let steps = (length / dt).round() as usize;
    let mut plain = Rk4::new(rhs.clone(), 0, dt);
    let gradient = end_gradient(&mut plain, x0, steps)?;
    let run = states(&mut plain, x0, steps)?.concat();
    let mut random = Random(1);
    let sign = &mut || random.draw().signum();
    let amplification = check::amplification(&mut plain, x0, &vec![1.0; x0.len()], &run, sign)?;
    let mut tripled = Rk4::new(Tripled(rhs.clone(), vec![0.0; x0.len()]), 0, dt);
    let start: Vec<f64> = x0.iter().map(|x| 3.0 * x).collect();
    // J = ½‖X‖² with X = 3x is nine times as large, its gradient with respect to X three times
    let three = end_gradient(&mut tripled, &start, steps)?;
    let other: Vec<f64> = three.iter().map(|g| g / 3.0).collect();
    let measured = difference(&other, &gradient);
    let note = format!(
        "estimate ε‖M‖ = {:.1e}, measured {measured:.1e}{}",
        amplification.gradient_error,
        if amplification.reliable { "" } else { ", flagged" }
    );
    case.at_most("measured error over its estimate", measured / amplification.gradient_error, 1e3, "-")
        .because(
            "states are ten to fifty times the unit perturbation that ‖M‖ speaks of, and some hundred \
                roundings add up",
        )
        .work(Work { condition: Some(amplification.norm), ..Work::default() })
        .computed(measured)
        .note(note);
    let says = amplification.warning().is_some();
    let beyond = amplification.gradient_error > 1e-4;
    case.at_most(
        "flagged where the estimate exceeds 1e-4, and only there",
        f64::from(u8::from(says != beyond)),
        0.0,
        "-",
    );
    Ok(())
}

/// The gradient of ½‖x_N‖².
fn end_gradient(model: &mut dyn Model, x0: &[f64], steps: usize) -> Result<Vec<f64>, varda_implicit::Error> {
    let mut trajectory = Trajectory::new();
    trajectory.run(model, x0, steps, Keep::Linearizations)?;
    let mut lambda = vec![0.0; x0.len()];
    trajectory.adjoint(model, &mut lambda, &mut |k, x, lambda| {
        if k == steps {
            lambda.iter_mut().zip(x).for_each(|(l, x)| *l += x);
        }
    })?;
    Ok(lambda)
}

/// The same equations for X = 3x.
#[derive(Clone)]
struct Tripled<R>(R, Vec<f64>);

impl<R: Rhs> Tripled<R> {
    fn third(&mut self, x: &[f64]) {
        self.1.iter_mut().zip(x).for_each(|(t, x)| *t = x / 3.0);
    }
}

impl<R: Rhs> Rhs for Tripled<R> {
    fn dim(&self) -> usize {
        self.0.dim()
    }
    fn eval(&mut self, t: f64, x: &[f64], f: &mut [f64]) {
        self.third(x);
        self.0.eval(t, &self.1, f);
        f.iter_mut().for_each(|f| *f *= 3.0);
    }
    fn tangent(&mut self, t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        self.third(x);
        self.0.tangent(t, &self.1, dx, df);
    }
    fn adjoint_add(&mut self, t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        self.third(x);
        self.0.adjoint_add(t, &self.1, lambda, dx);
    }
}

const DT: f64 = 0.01;
/// σ of all three components, seen every 0.1.
const SIGMA: f64 = 0.5;

/// Local minima of J along the line truth + s (1, 1, 1)/√3, |s| ≤ 5, as the window grows; growth of the
/// window against a direct minimization from s = 3.
fn minima(case: &mut Case, seed: u64, quick: bool) -> Outcome {
    let whole = 800;
    let mut model = Rk4::new(Lorenz63::default(), 0, DT);
    let begin: Vec<f64> = normals(1000 + seed, 3).iter().map(|x| 5.0 * x).collect();
    let truth = states(&mut model, &begin, 900)?.swap_remove(900);
    let run = states(&mut model, &truth, whole)?;
    let noise = normals(3000 + seed, 3 * whole);
    let seen: Vec<_> = (1..=whole / 10)
        .map(|j| {
            let y: Vec<f64> = run[10 * j].iter().zip(&noise[3 * j..]).map(|(x, e)| x + SIGMA * e).collect();
            observation(&[0, 1, 2], 10 * j, 0.0, &y, SIGMA)
        })
        .collect();
    let along = |s: f64| -> Vec<f64> { truth.iter().map(|t| t + s / 3.0_f64.sqrt()).collect() };
    let background = along(3.0);
    let b = Diagonal::uniform(3, 3.0)?;
    let set = |steps: usize| {
        ObservationSet::new(
            steps,
            vec![all_of(3)?],
            seen.iter().filter(|o| o.step <= steps).cloned().collect(),
        )
        .map_err(Box::<dyn std::error::Error>::from)
    };

    let points = if quick { 201 } else { 2001 };
    let mut counts = Vec::new();
    for length in [2, 4, 6, 8] {
        let mut observations = set(100 * length)?;
        let transform = ControlTransform::new(background.clone(), &b)?;
        let mut cost = StrongConstraint::new(&mut model, transform, &mut observations)?;
        let mut j = Vec::new();
        for i in 0..points {
            let s = -5.0 + 10.0 * i as f64 / (points - 1) as f64;
            let v: Vec<f64> = along(s).iter().zip(&background).map(|(x, b)| (x - b) / 3.0_f64).collect();
            j.push(cost.evaluate(&v, None)?);
        }
        let count = j.windows(3).filter(|w| w[1] < w[0] && w[1] < w[2]).count();
        case.inform(&format!("local minima along the line, T = {length}"), count as f64, "-");
        counts.push(count);
    }
    case.at_most(
        "minima at T = 2 over those at T = \
        8",
        counts[0] as f64 / counts[3] as f64,
        0.5,
        "-",
    )
    .because(
        "errors grow by e^0.9 per unit of time, so that J folds e^5.4 times as often: a half is a weak bound",
    );

    let minimize = |model: &mut Rk4<Lorenz63>, windows: &[usize]| -> Result<(f64, Vec<f64>), Error> {
        let mut v = vec![0.0; 3];
        let observations =
            set(whole).map_err(|_| Error::Setting { what: "observations", value: f64::NAN })?;
        let (_, minima) = window_growth(observations, windows, &mut v, &mut |seen, v| {
            let transform = ControlTransform::new(background.clone(), &b)?;
            let mut cost = StrongConstraint::new(model, transform, seen)?;
            Minimizer::default().minimize(&mut cost, v, &mut |_| ControlFlow::Continue(()))
        })?;
        let x: Vec<f64> = background.iter().zip(&v).map(|(b, v)| b + 3.0 * v).collect();
        Ok((minima.last().map_or(f64::NAN, |m| m.value), x))
    };
    let (direct, _) = minimize(&mut model, &[whole])?;
    let stages: Vec<usize> = (1..=whole / 20).map(|i| 20 * i).collect();
    let (grown, analysis) = minimize(&mut model, &stages)?;
    let mut observations = set(whole)?;
    let transform = ControlTransform::new(background.clone(), &b)?;
    let mut cost = StrongConstraint::new(&mut model, transform, &mut observations)?;
    let v: Vec<f64> = truth.iter().zip(&background).map(|(x, b)| (x - b) / 3.0).collect();
    let at_truth = cost.evaluate(&v, None)?;
    case.at_most("J after growth over J at the truth", grown / at_truth, 1.0, "-")
        .because("the right minimum lies below J at the truth, which is not a minimum")
        .note(format!("directly from the background: J = {direct:.1}, at the truth {at_truth:.1}"));
    drop(cost);
    // The start is little known along the direction that contracts (e^-1.5 before the first observation); the
    // end is known well.
    let end = states(&mut model, &analysis, whole)?.swap_remove(whole);
    let error = end.iter().zip(&run[whole]).fold(0.0_f64, |m, (a, t)| m.max((a - t).abs()));
    case.at_most("error of the grown analysis at the end of the window", error, SIGMA, "-")
        .because("80 observations of this σ")
        .computed(error);
    Ok(())
}
