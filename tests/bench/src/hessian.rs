//! The exact Hessian beside Gauss–Newton's: what a product costs, and what minimizers and posteriors gain.

use super::clock::{seconds_of, timed};
use super::{Options, Page, Result, Table};
use crate::cells;
use problems::rods::{HangingRod, wave};
use problems::small_problems::lorenz96_window;
use std::ops::ControlFlow;
use varda::run::{Listener, assimilate};
use varda::scene::{STARTER, SceneFile};
use varda::setup::Problem;
use varda_assimilation::{
    ControlTransform, CostFunction, Hessian, Iteration, LeastSquares, Posterior, Status, StrongConstraint,
    TrustRegionOptions, trust_region,
};
use varda_covariance::Diagonal;
use varda_implicit::{Model, Rk4, lorenz::Lorenz96};
use varda_rod::TwistUnknowns;

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut products = Table::new("products", "A product with either Hessian", PRODUCTS);
    let kinds = [("without angles", TwistUnknowns::WhereNeeded), ("with angles", TwistUnknowns::Always)];
    for (name, twist) in kinds {
        let (rod, truth) = HangingRod::flagship(1, true)?;
        let observations = rod.observe_with_waves(&truth)?;
        let mut model = rod.model_with(rod.first_step, twist)?;
        let mut set = rod.observation_set(model.dim(), observations)?;
        let b = rod.background_covariance()?;
        let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(truth, &b)?, &mut set)?;
        products.push(product(&format!("flagship, case 1, {name}"), &mut cost, options)?);
    }
    let (background, mut set, v) = lorenz96_window(40)?;
    let b = Diagonal::uniform(40, 0.5)?;
    let mut model = Rk4::new(Lorenz96::new(40, 8.0), 0, 0.01);
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(background, &b)?, &mut set)?;
    cost.evaluate(&v, None)?;
    products.push(product("Lorenz-96, N = 40, RK4", &mut cost, options)?);

    for (name, scene, sets) in [("tether in a current: drag", "tether-in-current", &[][..]), UNKNOWN[0]] {
        let problem = twin(scene, sets, &[])?;
        let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
        let (mut model, mut set) = (problem.model(), problem.observations()?);
        let mut cost = StrongConstraint::new(model.as_mut(), transform, &mut set)?;
        products.push(product(name, &mut cost, options)?);
    }

    let mut minima = Table::new("minima", "The trust region with either Hessian", MINIMA);
    let seeds = if options.quick { 2 } else { 20 };
    for scene in SCENES {
        for way in [Way::GaussNewton, Way::Secant, Way::Exact] {
            minima.push(minimize(scene, way, if options.quick { 2 } else { 100 })?);
        }
    }
    let mut estimates = Table::new("estimates", "Estimates of constants with either Hessian", ESTIMATES);
    for (name, scene, sets) in UNKNOWN {
        for hessian in ["gauss-newton", "exact"] {
            estimates.push(estimate((name, scene, sets), hessian, seeds)?);
        }
    }
    Ok(Page {
        title: "Exact Hessian",
        text: TEXT.into(),
        tables: vec![products, minima, estimates],
        remarks: String::new(),
        ..Page::default()
    })
}

const TEXT: &str = "\
**Products.** Milliseconds of the thread, least of the samples, at one point: a gradient with its forward \
run; a product with A = I + GᵀG; one with ∇²J; and what the first one at a point takes beside, the \
matrices Σ λ·∂²G of all steps, in linearizations of the window.

**Minima.** To ‖∇J‖ ≤ 1e-9 of the first, from the background, at most 200 iterations: outer \
iterations (median and most over the seeds), how many converged, stalled (J jumps, or its rounding is \
reached) or ended otherwise, the share of steps made with the exact Hessian, and seconds of the thread \
(median). *Posterior*: the largest difference of a standard deviation by the exact Hessian from that of \
Gauss and Newton, at the minimum (median over seeds whose exact Hessian is positive definite; their number).

**Estimates.** Twins whose constants are unknown, estimated with their state, posterior and all: iterations \
and seconds of the thread (medians over the seeds), the root mean square of value − truth over σ of all \
constants (1 where σ is right), the share of them within their 95 % intervals, and the largest change of \
a σ by second derivatives (median).";

const ESTIMATES: &[&str] = &[
    "twin",
    "Hessian",
    "seeds",
    "iterations, median",
    "seconds, median",
    "(value − truth)/σ, rms",
    "in 95 % intervals (%)",
    "σ, exact against Gauss–Newton (%)",
];

/// A twin whose constants are unknown: its name, scene and settings.
type Unknown = (&'static str, &'static str, &'static [&'static str]);

const UNKNOWN: [Unknown; 2] = [
    (
        "starter: modulus, damping, curvature",
        "starter",
        &[
            "model.damping.stiffness=0.01",
            "model.damping.mass=0.5",
            "estimate.youngs_modulus={sigma=\"15%\"}",
            "estimate.damping_stiffness={sigma=\"30%\"}",
            "estimate.natural_curvature={sigma=0.2}",
        ],
    ),
    (
        "Lorenz-96: forcing",
        "lorenz96",
        &["estimate.forcing={sigma=\"5%\"}", "background.covariance.sigma=0.1"],
    ),
];

const PRODUCTS: &[&str] = &[
    "problem",
    "gradient (ms)",
    "A p (ms)",
    "∇²J p (ms)",
    "ratio",
    "first ∇²J p at a point (ms)",
    "of that, matrices, in linearizations",
    "dropped share of ∇²J p",
];

const MINIMA: &[&str] = &[
    "scene",
    "Hessian",
    "seeds",
    "iterations, median",
    "most",
    "converged",
    "stalled",
    "other",
    "exact steps (%)",
    "seconds, median",
    "σ, exact against Gauss–Newton (%)",
    "definite",
];

const SCENES: &[&str] = &[
    "hanging-rod-case1",
    "hanging-rod-case2",
    "hanging-rod-case3",
    "hanging-rod-case4",
    "hanging-rod-case4-plain",
];

#[derive(Clone, Copy, PartialEq)]
enum Way {
    GaussNewton,
    Secant,
    Exact,
}

impl Way {
    fn name(self) -> &'static str {
        match self {
            Way::GaussNewton => "Gauss–Newton",
            Way::Secant => "Gauss–Newton and what updates learn",
            Way::Exact => "exact where better",
        }
    }

    fn options(self) -> TrustRegionOptions {
        let options = TrustRegionOptions::default().with_gradient_tolerance(1e-9);
        match self {
            Way::GaussNewton => options.with_secant_terms(0),
            Way::Secant => options,
            Way::Exact => options.with_hessian(Hessian::Exact),
        }
    }
}

fn product(name: &str, cost: &mut dyn LeastSquares, options: &Options) -> Result<Vec<super::Cell>> {
    let n = cost.dim();
    let v: Vec<f64> = (0..n).map(|i| 0.2 * wave(i, 71)).collect();
    let p: Vec<f64> = (0..n).map(|i| wave(i, 72)).collect();
    let [mut g, mut out, mut exact] = std::array::from_fn(|_| vec![0.0; n]);
    let mut shift = 0.0;
    let gradient = timed(options.samples(), || {
        // another point each time
        shift += 1e-9;
        let there: Vec<f64> = v.iter().map(|v| v + shift).collect();
        cost.evaluate(&there, Some(&mut g)).map(|_| ())
    })?;
    let gauss_newton = timed(options.samples(), || cost.hessian_apply(&p, &mut out))?;
    let second = timed(options.samples(), || cost.exact_hessian_apply(&p, &mut exact))?;
    let (mut firsts, mut linearized) = (Vec::new(), Vec::new());
    for _ in 0..options.samples() {
        shift += 1e-9;
        let there: Vec<f64> = v.iter().map(|v| v + shift).collect();
        cost.evaluate(&there, None)?;
        // the run is known: a linearization of every step, and the adjoint sweep
        linearized.push(seconds_of(|| cost.evaluate(&there, Some(&mut g)).map(|_| ()))?);
        firsts.push(seconds_of(|| cost.exact_hessian_apply(&p, &mut exact))?);
    }
    let least = |seconds: Vec<f64>| seconds.into_iter().fold(f64::INFINITY, f64::min);
    let (first, linearization) = (least(firsts), least(linearized) - 0.5 * gauss_newton.least);
    cost.hessian_apply(&p, &mut out)?;
    let dropped = norm(&exact.iter().zip(&out).map(|(e, o)| e - o).collect::<Vec<_>>()) / norm(&exact);
    let ms = 1e3;
    Ok(cells![
        name,
        ms * gradient.least,
        ms * gauss_newton.least,
        ms * second.least,
        second.least / gauss_newton.least,
        ms * first,
        (first - second.least) / linearization,
        dropped
    ])
}

fn minimize(scene: &str, way: Way, seeds: usize) -> Result<Vec<super::Cell>> {
    let (mut iterations, mut seconds, mut changes) = (Vec::new(), Vec::new(), Vec::new());
    let [mut converged, mut stalled, mut other, mut exact_steps, mut steps] = [0_usize; 5];
    for seed in 0..seeds {
        let file = SceneFile::open(scene, &[format!("seed={seed}")])?;
        let problem = Problem::from_scene(&file)?;
        let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
        let (mut model, mut observations) = (problem.model(), problem.observations()?);
        let mut cost = StrongConstraint::new(model.as_mut(), transform.clone(), &mut observations)?;
        let mut v = vec![0.0; transform.dim()];
        let mut note = |i: &Iteration| {
            if i.step_norm > 0.0 {
                steps += 1;
                exact_steps += usize::from(i.hessian == Some(Hessian::Exact));
            }
            ControlFlow::Continue(())
        };
        let mut minimum = None;
        seconds.push(seconds_of(|| {
            minimum = Some(trust_region(&mut cost, &mut v, &way.options(), &mut note)?);
            Ok::<(), varda_assimilation::Error>(())
        })?);
        let minimum = minimum.ok_or("a minimum")?;
        iterations.push(minimum.outer_iterations);
        match minimum.status {
            Status::Converged => converged += 1,
            Status::Stalled => stalled += 1,
            _ => other += 1,
        }
        if way == Way::Exact && minimum.status == Status::Converged {
            cost.evaluate(&v, Some(&mut vec![0.0; v.len()]))?;
            let gauss_newton = Posterior::new(&mut cost)?.variance(&transform);
            if let Ok(posterior) = Posterior::exact(&mut cost) {
                let pairs = posterior.variance(&transform).into_iter().zip(gauss_newton);
                let change = |(exact, gn): (f64, f64)| ((exact / gn).sqrt() - 1.0).abs();
                changes.push(pairs.filter(|(_, gn)| *gn > 0.0).map(change).fold(0.0, f64::max));
            }
        }
    }
    iterations.sort_unstable();
    let definite = changes.len();
    Ok(cells![
        scene,
        way.name(),
        seeds,
        iterations[iterations.len() / 2],
        iterations[iterations.len() - 1],
        converged,
        stalled,
        other,
        100.0 * exact_steps as f64 / steps.max(1) as f64,
        median(seconds),
        median(changes).map(|c| 100.0 * c),
        if way == Way::Exact { definite.to_string() } else { "–".into() }
    ])
}

fn estimate((name, scene, sets): Unknown, hessian: &str, seeds: usize) -> Result<Vec<super::Cell>> {
    let (mut iterations, mut seconds, mut changes) = (Vec::new(), Vec::new(), Vec::new());
    let (mut squares, mut inside, mut count) = (0.0, 0_usize, 0_usize);
    for seed in 0..seeds {
        let own = [format!("seed={seed}"), format!("algorithm.hessian=\"{hessian}\"")];
        let problem = twin(scene, sets, &own)?;
        let mut outcome = None;
        seconds.push(seconds_of(|| {
            outcome = Some(assimilate(&problem, &mut Listener::silent())?);
            Ok::<(), varda::Error>(())
        })?);
        let outcome = outcome.ok_or("an outcome")?;
        iterations.push(outcome.iterations[0]);
        changes.extend(outcome.exact_hessian.and_then(|e| e.sigma_change));
        for e in &outcome.estimates {
            let (truth, sigma, interval) = (e.truth, e.sigma, e.interval);
            let (Some(truth), Some(sigma), Some([low, high])) = (truth, sigma, interval) else { continue };
            squares += ((e.value - truth) / sigma).powi(2);
            inside += usize::from(low <= truth && truth <= high);
            count += 1;
        }
    }
    iterations.sort_unstable();
    Ok(cells![
        name,
        if hessian == "exact" { "exact where better" } else { "Gauss–Newton" },
        seeds,
        iterations[iterations.len() / 2],
        median(seconds),
        (squares / count as f64).sqrt(),
        100.0 * inside as f64 / count as f64,
        median(changes).map(|c| 100.0 * c)
    ])
}

fn twin(scene: &str, sets: &[&str], more: &[String]) -> Result<Problem> {
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).chain(more.iter().cloned()).collect();
    let file = match scene {
        "starter" => SceneFile::parse(scene, "starter.toml", STARTER, None, &sets)?,
        shipped => SceneFile::open(shipped, &sets)?,
    };
    Ok(Problem::from_scene(&file)?)
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

fn norm(a: &[f64]) -> f64 {
    a.iter().map(|a| a * a).sum::<f64>().sqrt()
}
