//! A rod hangs from a hand that moves; its tip is seen five times; where was the rod at the start, and how fast?

use std::ops::ControlFlow;
use std::sync::Arc;

use varda_assimilation::{
    ControlTransform, Minimizer, Observation, ObservationSet, Posterior, Selection, Status, StrongConstraint,
};
use varda_covariance::{BlockDiagonal, CovarianceFunction, Dense, Interleaved, Kernel, Taper};
use varda_implicit::{ImplicitModel, Model};
use varda_rod::{Clamp, Damping, Loads, Material, Rod, RodStep, Section, Supports};

const SEGMENTS: usize = 16;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let rod = Rod::uniform(0.8, SEGMENTS, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.008))?;
    let supports = Supports::clamped_start(Clamp {
        position: Arc::new(|t: f64| [0.05 * (1.0 - (5.0 * t).cos()), 0.0, 0.0]),
        tangent: Arc::new([0.0, 0.0, -1.0]),
        director: Arc::new([1.0, 0.0, 0.0]),
    });
    let loads = Loads { gravity: [0.0, 0.0, -9.81], ..Loads::default() };
    let step = RodStep::new(rod, supports, loads, Damping::default())?;

    // Before: straight down, at rest; σ = 2 cm and 0.3 m/s, correlated along the rod.
    let free = step.free_vertices().to_vec();
    let mut z = vec![0.0; step.control_len()];
    let s: Vec<f64> = free.iter().map(|&v| 0.8 * v as f64 / SEGMENTS as f64).collect();
    (0..free.len()).for_each(|i| z[3 * i + 2] = -s[i]);
    let block = |sigma| -> Result<_, varda_covariance::Error> {
        let smooth = CovarianceFunction { sigma, kernel: Kernel::Matern52 { length: 0.4 }, taper: Taper::None };
        Ok(Interleaved::new(Dense::new(s.len(), &smooth.matrix(&s)?)?, 3))
    };
    let b = BlockDiagonal::new(vec![block(0.02)?, block(0.3)?]);
    let background = ControlTransform::new(z, &b)?;

    // x and z of the tip, with σ = 5 mm.
    let mut model = ImplicitModel::new(step, 0, 0.02);
    let tip = 3 * free.len() - 3;
    let operator = Selection::new(vec![tip, tip + 2], model.dim())?;
    let see = |(step, x): (usize, f64)| Observation::new(step, vec![0, 1], vec![x, -0.80], 0.005);
    let seen = [(10, 0.03), (20, 0.07), (30, 0.06), (40, 0.10), (50, 0.12)].map(see).to_vec();
    let mut observations = ObservationSet::new(50, vec![Box::new(operator)], seen)?;

    let mut cost = StrongConstraint::new(&mut model, background.clone(), &mut observations)?;
    let mut v = vec![0.0; background.dim()];
    let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    assert_eq!(minimum.status, Status::Converged);
    let sigma = Posterior::new(&mut cost)?.variance(&background)[tip].sqrt();
    println!("tip at the start: σ = {:.1} mm instead of 20", 1e3 * sigma);
    assert!(sigma < 0.02);
    Ok(())
}
