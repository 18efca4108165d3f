//! Work counted exactly: what is not needed is not done.

use super::Options;
use super::equivalence::{closed_form, linear_3dvar};
use crate::row::{Case, Outcome, Row, Rows};
use problems::allocations::allocations;
use problems::costs::for_each_cost;
use problems::methods::{Assembled, for_each_method};
use problems::rods::{HangingRod, rods, wave};
use problems::small_problems::{Thin, all_of, coupled, difference, localized, normals, observation, ring};
use std::cell::Cell;
use std::ops::ControlFlow;
use std::time::Instant;
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;
use varda_assimilation::{
    ControlTransform, CostFunction, EnVar, EnVarOptions, InnerSolver, Iteration, LeastSquares, Minimizer,
    Observation, ObservationSet, OuterLoopOptions, Posterior, Selection, StrongConstraint, outer_loop,
};
use varda_covariance::{Covariance, Diagonal, Hybrid};
use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{Counts, Model, Rk4, Storage};

pub(super) fn run(_options: &Options) -> Vec<Row> {
    let mut rows = Rows::new("counts");
    rows.case("flagship", flagship);
    rows.case("flagship storage", storage);
    rows.case("window without steps", no_steps);
    rows.case("early last observation", early);
    rows.case("flagship timing", timing);
    match rods() {
        Ok(rods) => {
            for mut rod in rods {
                rows.case(rod.name, |case| model_allocations(case, &mut rod.model, &rod.control));
            }
        }
        Err(error) => rows.case("rods", |_| Err(error)),
    }
    rows.case("4denvar", no_derivatives);
    for scene in ["lorenz96-4denvar", "hanging-rod-case2"] {
        rows.case(&format!("scene {scene} by 4denvar"), |case| no_derivatives_in_a_scene(case, scene));
    }
    rows.case("3dvar, incremental, psas", no_model);
    rows.case("4d-psas", no_inverse);
    rows.case("lorenz96 rk4", |case| {
        let x: Vec<f64> = (0..40).map(|i| 8.0 + 4.0 * wave(i, 0)).collect();
        model_allocations(case, &mut Rk4::new(Lorenz96::new(40, 8.0), 0, 0.0125), &x)
    });
    let outcome = for_each_cost(&mut |name, cost| {
        rows.case(name, |case| cost_allocations(case, cost));
        Ok(())
    });
    if let Err(error) = outcome {
        rows.case("assembled costs", |_| Err(error));
    }
    let outcome = for_each_method(&mut |name, origin, cost| {
        rows.case(name, |case| match cost {
            Assembled::Products(cost) => cost_allocations(case, cost),
            Assembled::Increments(cost) => increment_allocations(case, origin, cost),
        });
        Ok(())
    });
    if let Err(error) = outcome {
        rows.case("methods", |_| Err(error));
    }
    rows.finish()
}

fn flagship(case: &mut Case) -> Outcome {
    let (rod, truth) = HangingRod::flagship(1, true)?;
    let mut model = rod.model(rod.first_step)?;
    case.count("length of the state", model.dim(), 6 * 24);
    case.count("twist unknowns", model.step_ref().free_angles().len(), 0);
    let named = model.step_ref().left_out().iter().any(|l| l.contains("twist"));
    case.count("twist named as left out", usize::from(named), 1);

    let observations = rod.observe(&truth, &mut || 0.5)?;
    let mut set = rod.observation_set(model.dim(), observations)?;
    let b = rod.background_covariance()?;
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(truth, &b)?, &mut set)?;
    let n = cost.dim();
    let v: Vec<f64> = (0..n).map(|i| 0.1 * wave(i, 1)).collect();
    let mut g = vec![0.0; n];

    cost.evaluate(&v, None)?;
    let trial = cost.counts();
    case.count("steps of a trial run", trial.model.model_steps, 100);
    case.count("linearizations of a trial run", trial.model.linearizations, 0);
    case.count("steps in parts", trial.model.substeps, 0);
    // Newton factors once an iteration where no pivot is negative.
    case.count("factorizations of a trial run", trial.model.factorizations, trial.model.newton_iterations);

    cost.evaluate(&v, Some(&mut g))?;
    let gradient = cost.counts();
    case.count("forward runs after the gradient there", gradient.forward_runs, 1);
    let of = |f: fn(&Counts) -> usize| f(&gradient.model) - f(&trial.model);
    case.count("steps of the gradient", of(|c| c.model_steps), 0);
    case.count("linearizations of the gradient", of(|c| c.linearizations), 100);
    case.count("factorizations of the gradient", of(|c| c.factorizations), 100);
    case.count("adjoint steps of the gradient", of(|c| c.adjoint_steps), 100);
    case.count("tangent steps of the gradient", of(|c| c.tangent_steps), 0);

    cost.evaluate(&v, Some(&mut g))?;
    let again = cost.counts();
    case.count("forward runs after asking again", again.forward_runs, 1);
    case.count("linearizations after asking again", again.model.linearizations, 100);

    cost.hessian_apply(&v, &mut g)?;
    let product = cost.counts();
    let of = |f: fn(&Counts) -> usize| f(&product.model) - f(&again.model);
    case.count("tangent steps of a product", of(|c| c.tangent_steps), 100);
    case.count("adjoint steps of a product", of(|c| c.adjoint_steps), 100);
    case.count("steps of a product", of(|c| c.model_steps), 0);
    case.count("factorizations of a product", of(|c| c.factorizations), 0);

    let mut hessian = vec![0.0; n * n];
    cost.hessian(&mut hessian)?;
    let dense = cost.counts();
    let of = |f: fn(&Counts) -> usize| f(&dense.model) - f(&product.model);
    case.count("tangent steps of the dense Hessian", of(|c| c.tangent_steps), 0);
    // Twelve rows at each of the steps 10, 20 … 100; columns would take 144 tangent products a step.
    case.count("adjoint steps of the dense Hessian", of(|c| c.adjoint_steps), 12 * 550);

    Ok(())
}

/// The flagship's gradient and a Hessian product under every storage policy: bits, steps run, bytes held,
/// requests for memory.
fn storage(case: &mut Case) -> Outcome {
    let (rod, truth) = HangingRod::flagship(1, true)?;
    let b = rod.background_covariance()?;
    let mut reference: Vec<Vec<f64>> = Vec::new();
    let mut all = 0;
    for (name, policy, steps) in [
        ("all", Storage::KeepAll, 100),
        ("states", Storage::States, 100),
        // r = 2: C(20, 18) = 190 ≥ 100 > 19; 100 + 2·100 − C(20, 19)
        ("18 checkpoints", Storage::Checkpoints { states: 18 }, 280),
        // r = 4: C(9, 5) = 126 ≥ 100 > 56; 100 + 4·100 − C(9, 6)
        ("5 checkpoints", Storage::Checkpoints { states: 5 }, 416),
    ] {
        let mut model = rod.model(rod.first_step)?;
        let observations = rod.observe(&truth, &mut || 0.5)?;
        let mut set = rod.observation_set(model.dim(), observations)?;
        let transform = ControlTransform::new(truth.clone(), &b)?;
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set)?;
        cost.set_storage(policy);
        let n = cost.dim();
        let mut found = Vec::new();
        let mut requests = 0;
        for s in 1..3 {
            let v: Vec<f64> = (0..n).map(|i| 0.1 * wave(i, s)).collect();
            let (mut g, mut product) = (vec![0.0; n], vec![0.0; n]);
            let before = cost.counts().model.model_steps;
            let (asked, outcome) = allocations(|| {
                cost.evaluate(&v, Some(&mut g))?;
                cost.hessian_apply(&v, &mut product)
            });
            outcome?;
            requests = asked;
            // a product is a sweep forward and one back
            let product_steps = if steps > 100 { steps } else { 0 };
            let ran = cost.counts().model.model_steps - before;
            case.count(
                &format!("{name}: steps of a gradient and a product, control {s}"),
                ran,
                steps + product_steps,
            );
            found.extend([g, product]);
        }
        case.count(&format!("{name}: allocations at the second control"), requests, 0);
        let differ =
            |a: &[f64], b: &[f64]| a.iter().zip(b).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
        if reference.is_empty() {
            (all, reference) = (cost.bytes(), found.clone());
        }
        let different: usize = reference.iter().zip(&found).map(|(a, b)| differ(a, b)).sum();
        case.count(&format!("{name}: numbers that differ in a bit"), different, 0);
        case.at_most(
            &format!("{name}: bytes held, of those of all"),
            cost.bytes() as f64 / all as f64,
            match name {
                "all" => 1.0,
                // three quarters of all are linearizations
                "states" => 0.26,
                "18 checkpoints" => 0.06,
                _ => 0.03,
            },
            "-",
        )
        .because(
            "states are a quarter of what linearizations and states take; s checkpoints are s % of 100 \
            states, and two linearizations",
        );
    }
    Ok(())
}

/// Lorenz 1996, all components seen with σ = 1 at one step.
fn lorenz_counts(last: usize, steps: usize) -> Result<Counts, Box<dyn std::error::Error>> {
    let mut model = Rk4::new(Lorenz96::new(40, 8.0), 0, 0.0125);
    let x: Vec<f64> = (0..40).map(|i| 8.0 + 4.0 * wave(i, 0)).collect();
    let seen = Observation::new(last, (0..40).collect(), x.clone(), 1.0);
    let all = Selection::new((0..40).collect(), 40)?;
    let mut set = ObservationSet::new(steps, vec![Box::new(all)], vec![seen])?;
    let b = Diagonal::uniform(40, 0.5)?;
    let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(x, &b)?, &mut set)?;
    let v = vec![0.3; 40];
    let mut g = vec![0.0; 40];
    cost.evaluate(&v, Some(&mut g))?;
    cost.hessian_apply(&v, &mut g)?;
    Ok(cost.counts().model)
}

fn no_steps(case: &mut Case) -> Outcome {
    let Counts { model_steps, tangent_steps, adjoint_steps, linearizations, .. } = lorenz_counts(0, 20)?;
    case.count("model calls", model_steps + tangent_steps + adjoint_steps + linearizations, 0);
    Ok(())
}

fn early(case: &mut Case) -> Outcome {
    let counts = lorenz_counts(12, 20)?;
    case.count("steps run", counts.model_steps, 12);
    case.count("steps linearized", counts.linearizations, 12);
    case.count("adjoint steps of gradient and product", counts.adjoint_steps, 24);
    Ok(())
}

/// 4D-EnVar and its hybrid, through outer loops to the minimum and to the posterior: forward runs only.
/// A whole run of a scene, background check and posterior included.
fn no_derivatives_in_a_scene(case: &mut Case, scene: &str) -> Outcome {
    let sets =
        ["algorithm.method=4denvar", "algorithm.ensemble.members=10", "algorithm.background_check=9.0"];
    let file = SceneFile::open(scene, &sets.map(String::from))?;
    let problem = Problem::from_scene(&file)?;
    let outcome = assimilate(&problem, &mut Listener::silent())?;
    case.count("tangent steps", outcome.counts.tangent_steps, 0);
    case.count("adjoint steps", outcome.counts.adjoint_steps, 0);
    let model = outcome.model_counts;
    let after = model.tangent_steps + model.adjoint_steps + model.linearizations;
    case.count("tangent and adjoint steps and linearizations of the reported runs", after, 0);
    case.count("σ of the analysis is there all the same", usize::from(outcome.has_posterior), 1);
    let last = problem.observations()?.last_step().unwrap_or(0);
    let ran = outcome.counts.model_steps >= 2 * 11 * last;
    case.count("members were run for the check and for the analysis", usize::from(ran), 1);
    Ok(())
}

fn no_derivatives(case: &mut Case) -> Outcome {
    let b = coupled(6, 0.4)?;
    let hybrid = Hybrid::new(&b, 0.6, localized()?, 0.8)?;
    let make = || -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz96::new(6, 8.0), 0, 0.03)) };
    let (background, anchors) = (normals(5, 6), [0, 2, 5].repeat(4));
    let (mut set, mut again) = (ring(&normals(6, 12))?, ring(&normals(6, 12))?);
    let ensemble = hybrid.ensemble();
    let pure = EnVar::new(&make, background.clone(), ensemble, &mut set, &anchors)?;
    let mixed = EnVar::hybrid(&make, background, &hybrid, &mut again, &anchors)?;
    for (name, mut cost) in [("4denvar", pure), ("hybrid", mixed)] {
        let options = EnVarOptions::default().with_max_outer(3).with_step_tolerance(1e-12);
        let mut v = vec![0.0; cost.dim()];
        let minimum = cost.minimize(&mut v, &options, &mut |_| ControlFlow::Continue(()))?;
        Posterior::new(&mut cost)?;
        let counts = cost.counts();
        case.count(&format!("{name}: outer loops"), minimum.outer_iterations, 3);
        case.count(&format!("{name}: linearizations"), counts.model.linearizations, 0);
        case.count(&format!("{name}: tangent steps"), counts.model.tangent_steps, 0);
        case.count(&format!("{name}: adjoint steps"), counts.model.adjoint_steps, 0);
        let sweeps = counts.tangent_sweeps + counts.adjoint_sweeps;
        case.count(&format!("{name}: tangent and adjoint sweeps"), sweeps, 0);
        // The last observation is at step 10.
        case.count(&format!("{name}: steps"), counts.model.model_steps, 10 * counts.forward_runs);
        let ran = usize::from(counts.forward_runs >= 4 * 5);
        case.count(&format!("{name}: members were run in every loop"), ran, 1);
    }
    Ok(())
}

/// Nothing observed after step 0: a model that is there is not called.
fn no_model(case: &mut Case) -> Outcome {
    let seen = observation(&[0, 2], 0, 0.0, &[1.0, 2.0], 0.3);
    let mut set = ObservationSet::new(20, vec![all_of(6)?], vec![seen])?;
    let b = coupled(6, 0.5)?;
    let mut model = Rk4::new(Lorenz96::new(6, 8.0), 0, 0.03);
    let transform = ControlTransform::new(normals(5, 6), &b)?;
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set)?;
    let go_on = &mut |_: &Iteration| ControlFlow::Continue(());
    Minimizer::default().minimize(&mut cost, &mut [0.0; 6], go_on)?;
    for inner in [InnerSolver::Primal, InnerSolver::Dual, InnerSolver::Direct] {
        outer_loop(&mut cost, &mut [0.0; 6], &OuterLoopOptions::default().with_inner(inner), go_on)?;
    }
    Posterior::new(&mut cost)?;
    let Counts { model_steps, substeps, tangent_steps, adjoint_steps, linearizations, .. } =
        cost.counts().model;
    let calls = model_steps + substeps + tangent_steps + adjoint_steps + linearizations;
    case.count("model calls", calls, 0);
    case.count("gradients were asked for", usize::from(cost.counts().gradients > 0), 1);
    Ok(())
}

/// B is known by its root alone and has no `Precision`: with its products the dual still ends at the analysis
/// of (2.2).
fn no_inverse(case: &mut Case) -> Outcome {
    let (expected, _) = closed_form(&Thin)?;
    let (background, mut set) = linear_3dvar()?;
    let b = Counted { products: Cell::new(0) };
    let transform = ControlTransform::new(background, &b)?;
    let mut cost = StrongConstraint::without_model(transform.clone(), &mut set)?;
    let mut v = vec![0.0; transform.dim()];
    let options = OuterLoopOptions::default().with_inner(InnerSolver::Dual).with_inner_tolerance(1e-14);
    outer_loop(&mut cost, &mut v, &options, &mut |_| ControlFlow::Continue(()))?;
    let mut z = vec![0.0; 5];
    transform.control(&v, &mut z);
    case.at_most("analysis by a B without inverse", difference(&z, &expected), 1e-10, "-")
        .because("closed form by LU: rounding times a condition of up to 1e4");
    let products = b.products.get();
    case.count("products with a root of B were made", usize::from(products > 0), 1);
    let counts = cost.counts();
    // One for every control that is run or swept, none for anything else, and ours above.
    let sweeps = counts.forward_runs + counts.tangent_sweeps + counts.adjoint_sweeps + 1;
    case.count("products with a root of B", products, sweeps);
    Ok(())
}

/// [`Thin`], counting.
struct Counted {
    products: Cell<usize>,
}

impl Covariance for Counted {
    fn dim(&self) -> usize {
        Thin.dim()
    }
    fn root_dim(&self) -> usize {
        Thin.root_dim()
    }
    fn apply(&self, x: &[f64], y: &mut [f64]) {
        self.products.set(self.products.get() + 1);
        Thin.apply(x, y);
    }
    fn root(&self, v: &[f64], x: &mut [f64]) {
        self.products.set(self.products.get() + 1);
        Thin.root(v, x);
    }
    fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
        self.products.set(self.products.get() + 1);
        Thin.root_transpose(x, v);
    }
    fn variance(&self, variance: &mut [f64]) {
        Thin.variance(variance);
    }
}

/// Requests for memory in a model's calls, after each was made once.
fn model_allocations(case: &mut Case, model: &mut dyn Model, z: &[f64]) -> Outcome {
    let mut x = vec![0.0; model.dim()];
    model.initial_state(z, &mut x)?;
    let mut next = x.clone();
    let mut dz = z.to_vec();
    let mut lambda = x.clone();
    let mut total = [0; 5];
    for round in 0..2 {
        let names = ["initial state", "step", "linearize", "tangent", "adjoint"];
        let (initial, outcome) = allocations(|| {
            model.initial_state(z, &mut x)?;
            model.initial_tangent(z, &mut lambda);
            model.initial_adjoint(&lambda, &mut dz);
            Ok::<_, varda_implicit::Error>(())
        });
        outcome?;
        total[0] = initial;
        let mut current = x.clone();
        total[1..].fill(0);
        for k in 0..5 {
            let (step, outcome) = allocations(|| model.step(k, &current, &mut next));
            outcome?;
            let (linearize, outcome) = allocations(|| model.linearize(k, k, &current, &next));
            outcome?;
            let (tangent, ()) = allocations(|| model.tangent(k, &mut lambda));
            let (adjoint, ()) = allocations(|| model.adjoint(k, &mut lambda));
            for (t, a) in total[1..].iter_mut().zip([step, linearize, tangent, adjoint]) {
                *t += a;
            }
            current.copy_from_slice(&next);
        }
        if round == 1 {
            for (name, found) in names.iter().zip(total) {
                case.count(&format!("allocations: {name}"), found, 0);
            }
        }
    }
    Ok(())
}

/// Requests for memory in a cost's calls, after each was made once.
fn cost_allocations(case: &mut Case, cost: &mut dyn LeastSquares) -> Outcome {
    let n = cost.dim();
    let mut g = vec![0.0; n];
    let mut product = vec![0.0; n];
    let points: Vec<Vec<f64>> = (0..4).map(|s| (0..n).map(|i| 0.1 * wave(i, 80 + s)).collect()).collect();
    for (round, pair) in points.chunks_exact(2).enumerate() {
        let (trial, outcome) = allocations(|| cost.evaluate(&pair[0], None));
        outcome?;
        let (gradient, outcome) = allocations(|| cost.evaluate(&pair[1], Some(&mut g)));
        outcome?;
        let (apply, outcome) = allocations(|| cost.hessian_apply(&g, &mut product));
        outcome?;
        let exact = match cost.has_exact_hessian() {
            true => {
                let (exact, outcome) = allocations(|| cost.exact_hessian_apply(&g, &mut product));
                outcome?;
                Some(exact)
            }
            false => None,
        };
        if round == 1 {
            if let Some(exact) = exact {
                case.count("allocations: exact_hessian_apply", exact, 0);
            }
            case.count("allocations: evaluate", trial, 0);
            case.count("allocations: evaluate with gradient", gradient, 0);
            case.count("allocations: hessian_apply", apply, 0);
        }
    }
    Ok(())
}

/// The same for a cost whose products are in its increments.
fn increment_allocations(case: &mut Case, origin: &[f64], cost: &mut dyn LeastSquares) -> Outcome {
    let (mut g, mut dy) = (vec![0.0; cost.dim()], vec![0.0; cost.observation_dim()]);
    let at = |s: usize| origin.iter().enumerate().map(|(i, o)| o + 0.1 * wave(i, 80 + s)).collect();
    let points: Vec<Vec<f64>> = (0..4).map(at).collect();
    for (round, pair) in points.chunks_exact(2).enumerate() {
        let (trial, outcome) = allocations(|| cost.evaluate(&pair[0], None));
        outcome?;
        let (gradient, outcome) = allocations(|| cost.linearize(&pair[1], &mut g));
        outcome?;
        let p = g.clone();
        let (apply, outcome) = allocations(|| {
            cost.jacobian(&p, &mut dy)?;
            cost.jacobian_transpose(&dy, &mut g)
        });
        outcome?;
        if round == 1 {
            case.count("allocations: evaluate", trial, 0);
            case.count("allocations: linearize", gradient, 0);
            case.count("allocations: tangent and adjoint", apply, 0);
        }
    }
    Ok(())
}

/// Seconds of an adjoint sweep over those of a plain forward run: informative, time never fails a check.
fn timing(case: &mut Case) -> Outcome {
    let (rod, truth) = HangingRod::flagship(1, true)?;
    let mut model = rod.model(rod.first_step)?;
    let n = model.dim();
    let steps = rod.steps;
    let mut states = vec![0.0; (steps + 1) * n];
    model.initial_state(&truth, &mut states[..n])?;
    let (mut forward, mut backward) = (Vec::new(), Vec::new());
    for _ in 0..9 {
        let since = Instant::now();
        for k in 0..steps {
            let (x, next) = states[k * n..(k + 2) * n].split_at_mut(n);
            model.step(k, x, next)?;
        }
        forward.push(since.elapsed().as_secs_f64());
        for k in 0..steps {
            let (x, next) = states[k * n..(k + 2) * n].split_at(n);
            model.linearize(k, k, x, next)?;
        }
        let mut lambda = vec![1.0; n];
        let since = Instant::now();
        for k in (0..steps).rev() {
            model.adjoint(k, &mut lambda);
        }
        backward.push(since.elapsed().as_secs_f64());
    }
    let fastest = |times: &[f64]| times.iter().copied().fold(f64::INFINITY, f64::min);
    let (forward, backward) = (fastest(&forward), fastest(&backward));
    case.inform("forward run", forward, "s");
    case.inform("adjoint sweep", backward, "s");
    case.inform("adjoint sweep / forward run", backward / forward, "-")
        .note("informative; wanted below 0.10");
    Ok(())
}
