//! The gradient of the cost of a scene, as several tests look at it.

use varda::setup::Problem;
use varda_assimilation::{ControlTransform, CostFunction, LeastSquares, StrongConstraint};

/// ∇J beside differences of J, and Gᵀ beside G, at two controls one after the other.
pub(crate) fn is_that_of_differences(problem: &Problem) {
    let mut observations = problem.observations().unwrap();
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref()).unwrap();
    let mut model = problem.model();
    let mut cost = StrongConstraint::new(model.as_mut(), transform, &mut observations).unwrap();
    let n = cost.dim();
    let wave = |a: f64, b: f64| (0..n).map(|i| a * (b + 1.7 * i as f64).sin()).collect::<Vec<f64>>();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    for v in [wave(0.2, 1.0), wave(0.3, -2.0)] {
        let mut gradient = vec![0.0; n];
        cost.linearize(&v, &mut gradient).unwrap();
        let (along, rows) = (wave(1.0, 0.4), cost.observation_dim());
        let weights: Vec<f64> = (0..rows).map(|i| (0.3 * i as f64).cos()).collect();
        let (mut forward, mut back) = (vec![0.0; rows], vec![0.0; n]);
        cost.jacobian(&along, &mut forward).unwrap();
        cost.jacobian_transpose(&weights, &mut back).unwrap();
        let (left, right) = (dot(&weights, &forward), dot(&along, &back));
        // a few hundred roundings of each number through 40 steps
        let size = dot(&forward, &forward).sqrt() * dot(&weights, &weights).sqrt();
        assert!((left - right).abs() < 1e-12 * size, "{left} {right}");
        let mut at = |h: f64| {
            let moved: Vec<f64> = v.iter().zip(&along).map(|(v, a)| v + h * a).collect();
            cost.evaluate(&moved, None).unwrap()
        };
        let mut central = |h: f64| (at(h) - at(-h)) / (2.0 * h);
        let derivative = dot(&gradient, &along);
        let mut errors = Vec::new();
        for h in [1e-4, 3e-4, 1e-3, 3e-3] {
            let difference = (4.0 * central(h) - central(2.0 * h)) / 3.0;
            errors.push((derivative - difference).abs() / derivative.abs());
        }
        // a step ends at updates of 1e-11 m, which are 1e-7 N of EA: 1e-5 σ of a reading, over h; and h⁴
        // of the fifth derivative beyond
        let best = errors.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(best < 1e-6, "{derivative}: {errors:?}");
    }
}
