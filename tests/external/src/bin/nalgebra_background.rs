//! A background and its covariance as a vector and a matrix of nalgebra; the posterior as a matrix.

use std::ops::ControlFlow;

use nalgebra::{DMatrix, DVector};
use varda_assimilation::{
    Blue, ControlTransform, Gain, Minimizer, Observation, ObservationSet, Selection, Status, StrongConstraint,
};
use varda_covariance::Dense;
use varda_implicit::{Rk4, lorenz::Lorenz63};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let x_b = DVector::from_vec(vec![1.5, 1.7, 20.0]);
    let matrix = DMatrix::from_row_slice(3, 3, &[1.0, 0.6, 0.0, 0.6, 1.0, 0.0, 0.0, 0.0, 2.0]);
    let b = Dense::try_from(&matrix)?;
    let background = ControlTransform::from_dvector(&x_b, &b)?;

    let all = Selection::new(vec![0, 1, 2], 3)?;
    let seen = Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1);
    let mut observations = ObservationSet::new(20, vec![Box::new(all)], vec![seen])?;
    let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
    let mut cost = StrongConstraint::new(&mut model, background.clone(), &mut observations)?;
    let mut v = vec![0.0; 3];
    let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    assert_eq!(minimum.status, Status::Converged);

    // The closed form at the minimum, by the gain K: the covariance of the analysis is (I − K H) B.
    let blue = Blue::new(&mut cost, &v, Gain::Observation)?;
    let x_a = background.control_dvector(&DVector::from_vec(v));
    println!("x_a − x_b = {:.3?}", (&x_a - &x_b).as_slice());
    let p = blue.control_covariance_dmatrix(&background);
    let gained = (&matrix - &p).symmetric_eigenvalues();
    assert!(p.trace() < matrix.trace() && gained.min() > -1e-12, "{p}");
    Ok(())
}
