//! Rods whose base was recorded: what noise of the recording costs, against the same motion as a formula.

use super::folder::Folder;
use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, Normal};
use std::sync::Arc;
use varda::setup::Inputs;
use varda::setup::rod_model::RodParts;
use varda::setup::system::System;
use varda_rod::Vector3;

/// Steps of a run, and their length \[s\].
const STEPS: usize = 500;
const STEP: f64 = 0.002;

type Base = fn(f64) -> Vector3<f64>;

/// A motion, and how many σ it may cost at 240 Hz: the faster its fastest part, the higher the cut-off it
/// needs, and the more noise is below that.
type Motion = (&'static str, f64, Base);

const MOTIONS: [Motion; 5] = [
    ("ellipse", 2.5, |t| {
        Vector3::new(0.05 * (6.0 * t).cos(), 0.03 * (6.0 * t).sin(), 0.0)
            * ramp(6.0 * t / std::f64::consts::TAU)
    }),
    ("reach", 4.5, |t| Vector3::new(0.2, -0.05, 0.1) * ramp((t - 0.2) / 0.6)),
    ("sway", 3.0, |t| Vector3::new(0.03 * (4.0 * t).sin(), 0.0, 0.02 * (9.0 * t).sin()) * ramp(t / 0.5)),
    ("circle", 3.0, |t| Vector3::new((9.0 * t).cos(), (9.0 * t).sin(), 0.0) * (0.02 * ramp(t / 0.7))),
    ("push", 6.0, |t| Vector3::new(0.1 * (t - 0.5) * ramp(t), 0.05 * ramp(t / 0.3), 0.0)),
];

/// u³ (10 − 15u + 6u²), the quintic that is smooth at both ends.
fn ramp(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
}

pub(super) fn run(options: &Options, rows: &mut Rows) {
    rows.area("recorded base");
    let grid = [60.0, 120.0, 240.0, 480.0].into_iter().flat_map(|rate| MOTIONS.map(|m| (rate, m)));
    let every = if options.quick { 10 } else { 1 };
    // The one with 240 Hz and an ellipse is among the few.
    for (i, (rate, motion)) in grid.enumerate().filter(|(i, _)| i % every == 10 % every) {
        let sigma = [0.5e-4, 1e-4, 2e-4][i % 3];
        let name = format!("{} at {rate} Hz, {:.2} mm", motion.0, 1e3 * sigma);
        rows.case(&name, |case| base(case, rate, motion, sigma, i));
    }
}

fn base(case: &mut Case, rate: f64, motion: Motion, sigma: f64, seed: usize) -> Outcome {
    const SEEDS: usize = 15;
    let exact = simulated(&parts(rate, motion, 0.0, 0)?, Some(motion.2))?;
    let mut found = Vec::new();
    for k in 0..SEEDS {
        let noisy = simulated(&parts(rate, motion, sigma, (SEEDS * seed + k) as u64)?, None)?;
        found.push(noisy.off(&exact));
    }
    let median = |of: fn(&[f64; 2]) -> f64| {
        let mut all: Vec<f64> = found.iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        (all[SEEDS / 2], all[SEEDS - 1])
    };
    // What a filter of a few Hz leaves of white noise falls with the root of the rate.
    let share = sigma / 1e-4 * (240.0 / rate).sqrt();
    // The case that recorded bases are judged by: an ellipse at 240 Hz with 0.1 mm may cost 0.2 mm.
    let sigmas = if motion.0 == "ellipse" && rate == 240.0 { 2.0 } else { motion.1 };
    let ((place, worst), (speed, fastest)) = (median(|f| f[0]), median(|f| f[1]));
    case.at_most("farthest", place, 1e-4 * sigmas * share, "m")
        .note(format!("median of {SEEDS}; the worst {worst:.2e} m"))
        .because("some σ at 240 Hz: noise below the cut-off that the motion needs, enlarged by the rod");
    case.at_most("speed of the tip", speed, 0.03 * share, "m/s")
        .note(format!("median of {SEEDS}; the worst {fastest:.2e} m/s"))
        .because("rows that are all followed cost 0.24 m/s at 240 Hz and 0.1 mm");
    Ok(())
}

/// The rod with its base recorded from 0.3 s before the run to 0.2 s after it, by another clock.
fn parts(rate: f64, (name, _, motion): Motion, sigma: f64, seed: u64) -> Result<RodParts, varda::Error> {
    let folder = Folder::new(&format!("{name}-{rate}-{sigma}-{seed}"))
        .map_err(|reason| varda::Error::Write { path: "a folder of temporary files".into(), reason })?;
    let clock = 37.25 + 11.0 * seed as f64;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, sigma).expect("σ is finite");
    let mut rows = String::from("time_s,x_m,y_m,z_m\n");
    for k in 0..=(1.5 * rate) as usize {
        let t = k as f64 / rate - 0.3;
        let mut seen = motion(t);
        seen.iter_mut().for_each(|v| *v += normal.sample(&mut rng));
        rows += &format!("{},{},{},{}\n", t + clock, seen.x, seen.y, seen.z);
    }
    let failed = |reason| varda::Error::Write { path: "base.csv".into(), reason };
    folder.write("base.csv", rows.as_bytes()).map_err(failed)?;
    folder.write("seen.csv", b"time_s,s_m,x_m,y_m,z_m\n0,0.5,,,\n").map_err(failed)?;
    let clock = format!("model.start.motion.time_zero={clock:?}");
    let inputs = Inputs::read(&folder.scene(SCENE, &[&clock])?)?;
    match inputs.system {
        System::Rod(rod) => Ok(rod.parts),
        System::Components(_) => unreachable!("the scene has a rod"),
    }
}

/// Vertices and the tip's velocity, step by step.
struct Run {
    places: Vec<Vec<f64>>,
    tip: Vec<Vector3<f64>>,
}

impl Run {
    /// The farthest that a vertex is from where it is in another run, and the RMS difference of the tip's
    /// velocity.
    fn off(&self, other: &Run) -> [f64; 2] {
        let vertices = self.places.iter().flatten().zip(other.places.iter().flatten());
        let differences: Vec<f64> = vertices.map(|(a, b)| a - b).collect();
        let farthest = differences.chunks(3).map(|d| d.iter().map(|v| v * v).sum::<f64>().sqrt());
        let squares = self.tip.iter().zip(&other.tip).map(|(a, b)| (a - b).norm_squared());
        [farthest.fold(0.0, super::common::greatest), (squares.sum::<f64>() / self.tip.len() as f64).sqrt()]
    }
}

/// The rod from rest, with its base as read, or as a formula.
fn simulated(parts: &RodParts, base: Option<Base>) -> Result<Run, Box<dyn std::error::Error>> {
    let mut parts = parts.clone();
    if let (Some(base), Some(clamp)) = (base, &mut parts.supports.start) {
        clamp.position = Arc::new(base);
    }
    let rest = parts.at_rest(0.0)?;
    let dynamics = parts.dynamics()?;
    let control = dynamics.control_at_rest(&rest);
    let (half, mut model) = (control.len() / 2, dynamics.model(0, STEP));
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&control, &mut x)?;
    let mut run = Run { places: Vec::new(), tip: Vec::new() };
    for k in 0..=STEPS {
        run.places.push(x[..half].to_vec());
        run.tip.push(Vector3::from_column_slice(&x[2 * half - 3..2 * half]));
        let mut next = vec![0.0; x.len()];
        if k < STEPS {
            model.step(k, &x, &mut next)?;
            x = next;
        }
    }
    Ok(run)
}

const SCENE: &str = r#"
[model]
kind = "rod"
length = 0.5
segments = 20
gravity = [0.0, 0.0, -9.81]
section = { kind = "circle", radius = 0.005 }
material = { youngs_modulus = 1e6, poisson_ratio = 0.5, density = 1100.0 }
[model.start]
position = [0.0, 0.0, 0.0]
tangent = [0.0, 0.0, -1.0]
director = [1.0, 0.0, 0.0]
motion = { kind = "table", file = "base.csv" }
[time]
integrator = "midpoint"
step = 0.002
window = 500
[background]
from = "static-equilibrium"
[background.covariance]
kind = "kernel"
sigma_x = 0.01
sigma_v = 0.1
correlation_length_x = 0.3
correlation_length_v = 0.3
localization_length = 0.6
prior = "clamp"
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.01
"#;
