//! A twin experiment: Lorenz-63 is observed with noise, and 4D-Var finds its initial state again.
#![allow(clippy::print_stdout)]

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Diagonal, sample};
use varda_implicit::{Keep, Rk4, Trajectory, lorenz::Lorenz63};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (steps, sigma) = (50, 0.5);
    let (b, r) = (Diagonal::uniform(3, 1.0)?, Diagonal::uniform(3, sigma)?);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);

    // The truth, and what was seen of it every fifth step.
    let truth = [1.5, 1.7, 20.0];
    let mut trajectory = Trajectory::new();
    trajectory.run(&mut model, &truth, steps, Keep::States)?;
    let seen = (1..=steps / 5).map(|j| {
        let errors = sample(&r, &mut rng);
        let values = trajectory.state(5 * j).iter().zip(errors).map(|(x, e)| x + e).collect();
        Observation::new(5 * j, vec![0, 1, 2], values, sigma)
    });
    let all = Box::new(Selection::new(vec![0, 1, 2], 3)?);
    let mut observations = ObservationSet::new(steps, vec![all], seen.collect())?;
    let m = observations.dim();

    // The background: the truth with an error drawn from N(0, B).
    let background: Vec<f64> = truth.iter().zip(sample(&b, &mut rng)).map(|(x, e)| x + e).collect();
    let transform = ControlTransform::new(background, &b)?;
    let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut observations)?;
    let mut v = vec![0.0; 3];
    let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |i| {
        println!(
            "{:3}  J = {:12.6}  |g| = {:9.3e}  model steps {}",
            i.index, i.value, i.gradient_norm, i.counts.model.model_steps
        );
        ControlFlow::Continue(())
    })?;
    let posterior = Posterior::new(&mut cost)?;
    let a = Analysis::new(&transform, &v, &minimum, &posterior, m);
    println!(
        "{:?}: chi2 = {:.2}, {:.2} degrees of freedom for signal",
        minimum.status, a.chi2, a.degrees_of_freedom
    );
    for i in 0..3 {
        println!(
            "x{i}: truth {:7.3}  background {:7.3} ± {:.3}  analysis {:7.3} ± {:.3}",
            truth[i], a.background[i], a.sigma_background[i], a.analysis[i], a.sigma_analysis[i]
        );
    }
    Ok(())
}
