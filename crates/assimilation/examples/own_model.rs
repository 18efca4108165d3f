//! A model of one's own: an epidemic whose rates are unknown, checked, then fitted to twelve counts by strong
//! 4D-Var.
#![allow(clippy::print_stdout)]

use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::Diagonal;
use varda_implicit::{Keep, Rhs, Rk4, Trajectory, check};

/// ṡ = −β s i, i̇ = β s i − γ i (Kermack and McKendrick 1927), x = [s, i, β, γ]: shares of the
/// people and rates [1/day].
#[derive(Clone)]
struct Epidemic;

impl Rhs for Epidemic {
    fn dim(&self) -> usize {
        4
    }
    fn eval(&mut self, _t: f64, x: &[f64], f: &mut [f64]) {
        let (infections, recoveries) = (x[2] * x[0] * x[1], x[3] * x[1]);
        f.copy_from_slice(&[-infections, infections - recoveries, 0.0, 0.0]);
    }
    fn tangent(&mut self, _t: f64, x: &[f64], dx: &[f64], df: &mut [f64]) {
        let infections = dx[2] * x[0] * x[1] + x[2] * (dx[0] * x[1] + x[0] * dx[1]);
        df.copy_from_slice(&[-infections, infections - dx[3] * x[1] - x[3] * dx[1], 0.0, 0.0]);
    }
    fn adjoint_add(&mut self, _t: f64, x: &[f64], lambda: &[f64], dx: &mut [f64]) {
        let infections = lambda[1] - lambda[0];
        dx[0] += x[2] * x[1] * infections;
        dx[1] += x[2] * x[0] * infections - x[3] * lambda[1];
        dx[2] += x[0] * x[1] * infections;
        dx[3] -= x[1] * lambda[1];
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (truth, background) = ([0.99, 0.01, 0.4, 0.1], [0.98, 0.02, 0.3, 0.15]);
    let sigma = [0.01, 0.01, 0.1, 0.05];
    let (mut model, steps, mut run) = (Rk4::new(Epidemic, 0, 1.0), 60, Trajectory::new());
    let conforms = check::conformance(&mut model, 0, &truth, &sigma, 1)?.iter().all(|outcome| outcome.pass);
    println!("the model conforms: {conforms}");
    // The share i every fifth day, with errors of 0.5 %.
    run.run(&mut model, &truth, steps, Keep::States)?;
    let observe = |step: usize| {
        let value = run.state(step)[1] + 0.005 * (2.0 * step as f64).sin();
        Observation::new(step, vec![0], vec![value], 0.005)
    };
    let infected = Box::new(Selection::new(vec![1], 4)?);
    let mut set = ObservationSet::new(steps, vec![infected], (1..=12).map(|j| observe(5 * j)).collect())?;
    let b = Diagonal::new(sigma.to_vec())?;
    let transform = ControlTransform::new(background.to_vec(), &b)?;
    let (mut cost, mut v) = (StrongConstraint::new(&mut model, transform.clone(), &mut set)?, vec![0.0; 4]);
    let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    let analysis = Analysis::new(&transform, &v, &minimum, &Posterior::new(&mut cost)?, 12);
    println!("{:?} after {} iterations, J = {:.3}", minimum.status, minimum.outer_iterations, minimum.value);
    for (j, name) in ["s", "i", "β", "γ"].iter().enumerate() {
        let (before, z, error) = (background[j], analysis.analysis[j], analysis.sigma_analysis[j]);
        println!("{name}: background {before:.3}, analysis {z:.4} ± {error:.4}, truth {:.3}", truth[j]);
    }
    Ok(())
}
