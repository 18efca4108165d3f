//! A rod hangs from a hand that moves, its tip is seen five times: where was the rod at the start?

use rand::{SeedableRng, rngs::ChaCha8Rng};
use std::ops::ControlFlow;
use varda_assimilation::{
    ControlTransform, Minimizer, Observation, ObservationSet, Posterior, Status, StrongConstraint,
};
use varda_covariance::{BlockDiagonal, CovarianceFunction, Dense, Interleaved, Kernel, Taper, sample};
use varda_implicit::{ImplicitModel, Keep, Model, Trajectory};
use varda_rod::{
    Clamp, ClampAt, Damping, Loads, Marker, Markers, Material, Rod, RodStep, Section, Supports, Vector3,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.008);
    let rod = Rod::uniform_between(0.8, 16, &section, [true, false])?;
    let along = rod.arc_lengths();
    let hand = |t: f64| [0.05 * (1.0 - (5.0 * t).cos()), 0.0, 0.0];
    let supports = Supports::clamped_start(Clamp::new(ClampAt::Face, hand, -Vector3::z(), Vector3::x()));
    let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    let step = RodStep::new(rod, supports, loads, Damping::default())?;

    // Before: straight down, at rest; σ = 2 cm and 0.3 m/s, correlated along the rod.
    let free = step.free_vertices().to_vec();
    let mut z = vec![0.0; step.control_len()];
    let s: Vec<f64> = free.iter().map(|&v| along[v]).collect();
    (0..free.len()).for_each(|i| z[3 * i + 2] = -s[i]);
    let block = |sigma| -> Result<_, varda_covariance::Error> {
        let kernel = Kernel::Matern52 { length: 0.4 };
        let smooth = CovarianceFunction { sigma, kernel, taper: Taper::None };
        Ok(Interleaved::new(Dense::new(s.len(), &smooth.matrix(&s)?)?, 3))
    };
    let b = BlockDiagonal::new(vec![block(0.02)?, block(0.3)?]);
    let background = ControlTransform::new(z.clone(), &b)?;

    // A truth drawn from B, and its run; x and z of the tip are seen with σ = 5 mm.
    let operator = Markers::new(&step, &[Marker { s: 0.8, offset: Vector3::zeros() }])?;
    let mut model = ImplicitModel::new(step, 0, 0.02);
    let (tip, mut x) = (3 * free.len() - 3, vec![0.0; model.dim()]);
    let error = sample(&b, &mut ChaCha8Rng::seed_from_u64(1));
    let truth: Vec<f64> = z.iter().zip(error).map(|(z, e)| z + e).collect();
    model.initial_state(&truth, &mut x)?;
    let mut run = Trajectory::new();
    run.run(&mut model, &x, 50, Keep::States)?;
    let places = |k: usize| vec![run.state(k)[tip], run.state(k)[tip + 2]];
    let seen = (1..=5).map(|k| Observation::new(10 * k, vec![0, 2], places(10 * k), 0.005)).collect();
    let times = (0..=50).map(|k| 0.02 * k as f64).collect();
    let mut observations = ObservationSet::on_times(times, vec![Box::new(operator)], seen)?;

    let mut cost = StrongConstraint::new(&mut model, background.clone(), &mut observations)?;
    let mut v = vec![0.0; background.dim()];
    let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    assert_eq!(minimum.status, Status::Converged);
    let sigma = Posterior::new(&mut cost)?.variance(&background)[tip].sqrt();
    background.control(&v, &mut x[..truth.len()]);
    println!("tip: {:.1} mm off, σ = {:.1} mm instead of 20", 1e3 * (x[tip] - truth[tip]), 1e3 * sigma);
    assert!(sigma < 0.02 && (x[tip] - truth[tip]).abs() < 4.0 * sigma);
    Ok(())
}
