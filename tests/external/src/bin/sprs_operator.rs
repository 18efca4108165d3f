//! Means over four neighbours of a ring, as a sparse matrix of the sprs crate: H of a 3D-Var.

use std::ops::ControlFlow;

use sprs::TriMat;
use varda_assimilation::{
    ControlTransform, LinearObservation, Minimizer, Observation, ObservationSet, Status, StrongConstraint,
};
use varda_covariance::{CovarianceFunction, Dense, Kernel, Taper};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (n, m) = (40, 10);
    let mut entries = TriMat::new((m, n));
    for row in 0..m {
        (0..4).for_each(|c| entries.add_triplet(row, 4 * row + c, 0.25));
    }
    let h = LinearObservation::from_csmat(&entries.to_csr::<usize>())?;

    // A wave, seen through its means with σ = 0.01; before, it is only known to be smooth.
    let truth = |i: usize| (0.3 * i as f64).sin();
    let values = (0..m).map(|row| (0..4).map(|c| 0.25 * truth(4 * row + c)).sum()).collect();
    let seen = Observation::new(0, (0..m).collect(), values, 0.01);
    let mut observations = ObservationSet::new(0, vec![Box::new(h)], vec![seen])?;

    let places: Vec<f64> = (0..n).map(|i| i as f64).collect();
    let smooth =
        CovarianceFunction { sigma: 1.0, kernel: Kernel::Matern52 { length: 6.0 }, taper: Taper::None };
    let b = Dense::new(n, &smooth.matrix(&places)?)?;
    let background = ControlTransform::new(vec![0.0; n], &b)?;

    let mut cost = StrongConstraint::without_model(background.clone(), &mut observations)?;
    let mut v = vec![0.0; n];
    let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    assert_eq!(minimum.status, Status::Converged);
    let mut x = vec![0.0; n];
    background.control(&v, &mut x);
    // At the two ends the wave is only seen from one side.
    let worst = (2..n - 2).map(|i| (x[i] - truth(i)).abs()).fold(0.0, f64::max);
    println!("largest error {worst:.3} between the ends of a wave of height 1");
    assert!(worst < 0.1, "{worst}");
    Ok(())
}
