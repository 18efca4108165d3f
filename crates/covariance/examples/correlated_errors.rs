//! What does a prior on a rod of 25 segments say once its top is known exactly? Prints the standard deviation
//! along the rod with and without the two clamped vertices, how well conditioned each covariance is, and one
//! draw.
//!
//! `cargo run -p varda-covariance --example correlated_errors`
#![allow(clippy::print_stdout)]

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda_covariance::{
    Covariance, CovarianceFunction, Dense, Error, Kernel, Spectrum, Taper, Truncated, sample,
};

fn main() -> Result<(), Error> {
    let place = |i: usize| i as f64 / 25.0;
    let free: Vec<f64> = (2..26).map(place).collect();
    let n = free.len();

    let localized = CovarianceFunction {
        sigma: 0.05, // m
        kernel: Kernel::Gaussian { length: 0.5 },
        taper: Taper::Triangle { support: 1.0 },
    };
    let plain = Dense::new(n, &localized.matrix(&free)?)?;
    let conditioned = Dense::new(n, &localized.conditioned_matrix(&free, &[place(0), place(1)])?)?;

    // Without its taper the kernel is singular: no Cholesky root, but one of truncated rank to draw from.
    let smooth = CovarianceFunction { taper: Taper::None, ..localized }
        .conditioned_matrix(&free, &[place(0), place(1)])?;
    if let Err(error) = Dense::new(n, &smooth) {
        println!("kernel without taper: {error}\n");
    }
    let root = Truncated::eigen(n, &smooth, 1e-10)?;
    let draw = sample(&root, &mut ChaCha8Rng::seed_from_u64(1));

    let sigma = |b: &Dense| {
        let mut variance = vec![0.0; n];
        b.variance(&mut variance);
        variance.into_iter().map(f64::sqrt).collect::<Vec<_>>()
    };
    println!("  s [m]   σ plain [m]   σ clamped [m]   a draw [m]");
    for (((s, a), b), x) in free.iter().zip(sigma(&plain)).zip(sigma(&conditioned)).zip(&draw) {
        println!("{s:7.2} {a:13.5} {b:15.5} {x:12.5}");
    }
    for (name, spectrum) in [("plain", Spectrum::of(&plain)?), ("clamped", Spectrum::of(&conditioned)?)] {
        println!(
            "{name}: condition number {:.3e}, effective rank {:.2} of {n}",
            spectrum.condition_number(),
            spectrum.effective_rank()
        );
    }
    println!("kernel without taper: rank {} at 1e-10", root.root_dim());
    Ok(())
}
