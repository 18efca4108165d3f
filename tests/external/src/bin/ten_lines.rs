//! 4D-Var in ten lines: the initial state of a Lorenz system from four values seen later.

use varda_assimilation::Assimilation;
use varda_covariance::Diagonal;
use varda_implicit::{Rk4, lorenz::Lorenz63};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let result = Assimilation::new(Rk4::new(Lorenz63::default(), 0, 0.01))
        .background(vec![1.5, 1.7, 20.0], Diagonal::uniform(3, 1.0)?)
        .observe(20, [0, 2], [8.1, 14.9], 0.1)
        .observe(30, [0], [15.4], 0.1)
        .observe(40, [2], [42.0], 0.1)
        .analyse()?;
    println!("{:.2?} ± {:.2?}, converged: {}", result.state(), result.sigma(), result.converged());
    assert!(result.converged() && result.sigma().iter().all(|s| *s < 1.0));
    Ok(())
}
