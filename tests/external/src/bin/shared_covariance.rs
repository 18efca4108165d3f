//! One covariance, shared by reference: positions and velocities of the same points, and draws from both.

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda_covariance::{BlockDiagonal, Covariance, CovarianceFunction, Dense, Kernel, Scaled, Taper, sample};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let places: Vec<f64> = (0..30).map(|i| f64::from(i) / 29.0).collect();
    let function =
        CovarianceFunction { sigma: 1.0, kernel: Kernel::Matern32 { length: 0.2 }, taper: Taper::None };
    let shape = Dense::new(30, &function.matrix(&places)?)?;

    // Both blocks borrow the one root of `shape`, which is still ours.
    let b = BlockDiagonal::new(vec![Scaled::uniform(&shape, 0.01)?, Scaled::uniform(&shape, 0.5)?]);
    let mut variance = vec![0.0; b.dim()];
    b.variance(&mut variance);
    assert!((variance[0] - 1e-4).abs() < 1e-12 && (variance[59] - 0.25).abs() < 1e-9);

    let error = sample(&b, &mut ChaCha8Rng::seed_from_u64(1));
    let size = |x: &[f64]| (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt();
    println!("draws of size {:.3} and {:.3}", size(&error[..30]), size(&error[30..]));
    assert!(size(&error[..30]) < 0.1 * size(&error[30..]));
    assert_eq!(shape.dim(), 30);
    Ok(())
}
