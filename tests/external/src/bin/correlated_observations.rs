//! Three sensors on one mount: their errors share what the mount does. Told so, the analysis is another one.

use std::sync::Arc;

use varda_assimilation::{Assimilation, Observation};
use varda_covariance::{Covariance, Dense, Diagonal};
use varda_implicit::{Rk4, lorenz::Lorenz96};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // σ = 0.1 of each sensor alone, and 0.3 of the mount that all of them sit on.
    let (alone, mount) = (0.01, 0.09);
    let entry = |i: usize| if i % 4 == 0 { alone + mount } else { mount };
    let r = Arc::new(Dense::new(3, &(0..9).map(entry).collect::<Vec<f64>>())?);
    let mut variance = [0.0; 3];
    r.variance(&mut variance);
    assert!((variance[2] - 0.1).abs() < 1e-12);

    let x_b: Vec<f64> = (0..12).map(|i| 8.0 + (0.9 * f64::from(i)).sin()).collect();
    let analysed = |correlated: bool| -> Result<_, Box<dyn std::error::Error>> {
        let seen = Observation::new(4, vec![0, 1, 2], vec![8.4, 9.1, 9.4], 0.1_f64.sqrt());
        let seen = if correlated { seen.correlated(r.clone()) } else { seen };
        let result = Assimilation::new(Rk4::new(Lorenz96::new(12, 8.0), 0, 0.01))
            .background(x_b.clone(), Diagonal::uniform(12, 1.0)?)
            .observation(seen)
            .analyse()?;
        Ok(result)
    };
    let (told, untold) = (analysed(true)?, analysed(false)?);
    assert!(told.converged() && untold.converged());
    // The mean of the three is known less well, their differences better.
    let mean = |sigma: &[f64]| sigma[..3].iter().sum::<f64>() / 3.0;
    println!("σ of x₀ … x₂: {:.3} told, {:.3} untold", mean(told.sigma()), mean(untold.sigma()));
    let apart = (0..12).map(|i| (told.state()[i] - untold.state()[i]).abs()).fold(0.0, f64::max);
    assert!(apart > 0.01, "a correlation changes the analysis: {apart}");
    Ok(())
}
