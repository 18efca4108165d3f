//! Times the flagship window and the sweeps along it, rod kernels, and Lorenz 1996, as ratios taken in one run.
#![allow(clippy::print_stdout)]

use std::error::Error;
use std::sync::Arc;

use tests::problems::HangingRod;
use varda_assimilation::{ControlTransform, CostFunction, GaussNewton, StrongConstraint};
use varda_implicit::{ImplicitModel, Keep, Linearization, Model, Storage, Trajectory};
use varda_rod::{Clamp, Damping, Loads, Material, Motion, Rod, RodStep, Section, Supports};

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
        let product = median(&mut || cost.hessian_apply(&v, &mut g).expect("linearized"));
        println!("Hessian product {:.3} forward runs", product / plain[0]);
    }
    Ok(())
}

fn kernels() -> Result<(), Box<dyn Error>> {
    let still: Arc<dyn Motion> = Arc::new([0.0; 3]);
    let material = Material::new(1e6, 0.5, 1100.0);
    for (name, section) in [
        ("twist-free", Section::circle(&material, 0.01)),
        ("with twist", Section::ellipse(&material, 0.01, 0.009)),
    ] {
        for segments in [25, 100, 1000, 100_000] {
            let rod = Rod::uniform(segments as f64 / 25.0, segments, &section)?;
            let lengths = rod.arc_lengths();
            let clamp = Clamp {
                position: still.clone(),
                tangent: Arc::new([0.0, 0.0, -1.0]),
                director: Arc::new([1.0, 0.0, 0.0]),
            };
            let loads = Loads { gravity: [0.0, 0.0, -9.81], ..Loads::default() };
            let step = RodStep::new(rod, Supports::clamped_start(clamp), loads, Damping::default())?;
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
