//! Times the flagship window and the sweeps along it, rod kernels, and Lorenz 1996, as ratios taken in one run.
#![allow(clippy::print_stdout)]

use std::error::Error;
use std::sync::Arc;
use std::time::Instant;

use tests::problems::HangingRod;
use varda_assimilation::{
    ControlTransform, CostFunction, GaussNewton, Observation, ObservationSet, Selection, StrongConstraint,
};
use varda_covariance::Diagonal;
use varda_implicit::{
    ImplicitModel, Keep, Linearization, Model, OneLeg, Rk4, Storage, Trajectory, lorenz::Lorenz96,
};
use varda_rod::{Clamp, Damping, Loads, Material, Motion, Rod, RodStep, Section, Supports, TwistUnknowns};

/// CPU seconds of this thread.
fn now() -> f64 {
    // the kernel brings its account up to date when the thread gives way
    std::thread::yield_now();
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux");
    text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()).expect("nanoseconds") * 1e-9
}

/// Median of the CPU seconds of 31 calls after two.
fn median(call: &mut dyn FnMut()) -> f64 {
    (0..2).for_each(|_| call());
    let mut seconds: Vec<f64> = (0..31)
        .map(|_| {
            let since = now();
            call();
            now() - since
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    seconds[15]
}

fn main() -> Result<(), Box<dyn Error>> {
    let only = std::env::args().nth(1).unwrap_or_default();
    if only.is_empty() || only == "flagship" {
        flagship()?;
    }
    if only.is_empty() || only == "workers" {
        workers()?;
    }
    if only.is_empty() || only == "kernels" {
        kernels()?;
    }
    Ok(())
}

fn flagship() -> Result<(), Box<dyn Error>> {
    let (rod, truth) = HangingRod::flagship(1, true)?;
    let mut model = rod.model(rod.first_step)?;
    let mut x0 = vec![0.0; model.dim()];
    model.initial_state(&truth, &mut x0)?;
    let mut run = Trajectory::with_storage(Storage::States);
    let before = model.counts().newton_iterations;
    run.run(&mut model, &x0, rod.steps, Keep::States)?;
    println!("Newton iterations of the window: {}", model.counts().newton_iterations - before);
    let forward = median(&mut || run.run(&mut model, &x0, rod.steps, Keep::States).expect("ran before"));
    println!("forward {:.3} ms", 1e3 * forward);
    let n = x0.len();
    let mut lambda = vec![0.0; n];
    let mut add = |k: usize, _: &[f64], l: &mut [f64]| l[k % n] += 1.0;
    for storage in [Storage::KeepAll, Storage::States, Storage::Checkpoints { states: 10 }] {
        let mut kept = Trajectory::with_storage(storage);
        kept.run(&mut model, &x0, rod.steps, Keep::Linearizations)?;
        let sweep = median(&mut || kept.adjoint(&mut model, &mut lambda, &mut add).expect("ran before"));
        let bytes = kept.bytes() + model.bytes_kept();
        println!("adjoint sweep, {storage:?}: {:.3} forward runs, {bytes} bytes", sweep / forward);
    }
    let observations = rod.observe(&truth, &mut || 0.5)?;
    let b = rod.background_covariance()?;
    for linearization in [Linearization::Accepted, Linearization::LastFactor] {
        let mut model = rod.model(rod.first_step)?.with_linearization(linearization);
        let mut set = rod.observation_set(model.dim(), observations.clone())?;
        let mut cost =
            StrongConstraint::new(&mut model, ControlTransform::new(truth.clone(), &b)?, &mut set)?;
        let n = cost.dim();
        let mut g = vec![0.0; n];
        let mut v = vec![0.0; n];
        let mut count = 0.0;
        let mut plain = Vec::new();
        for with in [false, true] {
            plain.push(median(&mut || {
                // never a point that is still known
                count += 1.0;
                v.fill(1e-6 * count);
                cost.evaluate(&v, with.then_some(g.as_mut_slice())).expect("near the truth");
            }));
        }
        println!("{linearization:?}: gradient {:.3} forward runs", plain[1] / plain[0]);
        let mut hessian = vec![0.0; n * n];
        let dense = median(&mut || cost.hessian(&mut hessian).expect("linearized"));
        println!("dense Hessian {:.3} ms, {:.3} forward runs", 1e3 * dense, dense / plain[0]);
        if std::env::args().nth(2).is_some() {
            (0..2000).for_each(|_| cost.hessian(&mut hessian).expect("linearized"));
        }
        let product = median(&mut || cost.hessian_apply(&v, &mut g).expect("linearized"));
        println!("Hessian product {:.3} forward runs", product / plain[0]);
    }
    Ok(())
}

/// Dense Hessians alone and with one further model, in seconds on the clock on the wall.
fn workers() -> Result<(), Box<dyn Error>> {
    let (rod, truth) = HangingRod::flagship(1, true)?;
    let make_rod =
        move || -> Box<dyn Model + Send> { Box::new(rod.model(rod.first_step).expect("made before")) };
    let (rod, _) = HangingRod::flagship(1, true)?;
    let b = rod.background_covariance()?;
    let mut set = rod.observation_set(make_rod().dim(), rod.observe(&truth, &mut || 0.5)?)?;
    shared("flagship, by rows", &make_rod, ControlTransform::new(truth, &b)?, &mut set)?;
    for n in [40, 200] {
        let b = Diagonal::uniform(n, 0.5)?;
        let background: Vec<f64> = (0..n).map(|i| 3.0 + (1.7 * i as f64).sin()).collect();
        let make_rk4 = || -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz96::new(n, 8.0), 0, 0.01)) };
        let make_midpoint = || -> Box<dyn Model + Send> {
            Box::new(ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(n, 8.0), 1e-11), 0, 0.01))
        };
        let makes: [(&str, MakeModel); 2] = [("RK4", &make_rk4), ("midpoint", &make_midpoint)];
        for ((name, make), half) in makes.into_iter().flat_map(|m| [(m, true), (m, false)]) {
            let (rows, steps) =
                if half { ((0..n / 2).collect(), 2..=20) } else { ((0..n / 8).collect(), 20..=20) };
            let rows: Vec<usize> = rows;
            let seen = steps.step_by(2).map(|step| Observation {
                operator: 0,
                values: vec![3.0; rows.len()],
                sigma: vec![0.5; rows.len()],
                rows: rows.clone(),
                step,
                weight: 0.0,
                label: String::new(),
            });
            let seen = seen.collect();
            let all = Box::new(Selection::new((0..n).collect(), n)?);
            let mut set = ObservationSet::new(20, vec![all], seen)?;
            let by = if half { "columns" } else { "rows" };
            let transform = ControlTransform::new(background.clone(), &b)?;
            shared(&format!("Lorenz-96, {name}, n = {n}, by {by}"), make, transform, &mut set)?;
        }
    }
    Ok(())
}

type MakeModel<'a> = &'a dyn Fn() -> Box<dyn Model + Send>;

fn shared(
    name: &str,
    make: MakeModel,
    transform: ControlTransform,
    set: &mut ObservationSet,
) -> Result<(), Box<dyn Error>> {
    let mut model = make();
    let mut cost = StrongConstraint::new(&mut *model, transform, set)?;
    let n = cost.dim();
    let mut hessian = vec![0.0; n * n];
    cost.evaluate(&vec![0.0; n], Some(&mut vec![0.0; n]))?;
    let mut least = [f64::INFINITY; 2];
    // Left out: sparse solves before the first product of dense matrices take less time than all that follow.
    cost.hessian(&mut hessian)?;
    // the least of many: other processes are about
    let begun = Instant::now();
    while begun.elapsed().as_secs_f64() < 1.0 {
        for (count, least) in least.iter_mut().enumerate() {
            cost.set_workers(make, count)?;
            let since = Instant::now();
            cost.hessian(&mut hessian)?;
            *least = least.min(since.elapsed().as_secs_f64());
        }
    }
    let [alone, with] = least;
    println!("dense Hessian, {name}: {:.3} ms, with a worker {:.3} of that", 1e3 * alone, with / alone);
    Ok(())
}

fn kernels() -> Result<(), Box<dyn Error>> {
    let still: Arc<dyn Motion> = Arc::new([0.0; 3]);
    let material = Material::new(1e6, 0.5, 1100.0);
    for (name, section) in
        [("twist-free", Section::circle(&material, 0.01)), ("with twist", Section::circle(&material, 0.01))]
    {
        for segments in [25, 100, 1000, 100_000] {
            let rod = Rod::uniform(segments as f64 / 25.0, segments, &section)?;
            let lengths = rod.arc_lengths();
            let clamp = Clamp {
                position: still.clone(),
                tangent: Arc::new([0.0, 0.0, -1.0]),
                director: Arc::new([1.0, 0.0, 0.0]),
            };
            let loads = Loads { gravity: [0.0, 0.0, -9.81], ..Loads::default() };
            let twist = if name == "with twist" { TwistUnknowns::Always } else { TwistUnknowns::WhereNeeded };
            let supports = Supports::clamped_start(clamp);
            let step = RodStep::with_twist(rod, supports, loads, Damping::default(), twist)?;
            // at rest in a helix of one turn in 2.5 m
            let mut z = Vec::new();
            for &v in step.free_vertices() {
                let s = lengths[v];
                let phase = std::f64::consts::TAU * s / 2.5;
                z.extend([0.1 * phase.sin(), 0.1 * (1.0 - phase.cos()), -0.97 * s]);
            }
            z.resize(step.control_len(), 0.0);
            let mut model = ImplicitModel::new(step, 0, 0.01);
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&z, &mut x)?;
            let mut next = x.clone();
            let mut seconds = Vec::new();
            for k in 0..if segments > 10_000 { 9 } else { 60 } {
                let before = model.counts().newton_iterations;
                let since = now();
                model.step(k, &x, &mut next)?;
                let iterations = model.counts().newton_iterations - before;
                seconds.push((now() - since) / (segments * iterations) as f64);
                std::mem::swap(&mut x, &mut next);
            }
            seconds.sort_by(f64::total_cmp);
            println!(
                "{name}, {segments} segments: {:.3} µs per segment and Newton iteration (least {:.3}), {} bytes of state and factor per segment",
                1e6 * seconds[seconds.len() / 2],
                1e6 * seconds[0],
                (model.bytes_per_step() + 16 * x.len()) / segments
            );
        }
    }
    Ok(())
}
