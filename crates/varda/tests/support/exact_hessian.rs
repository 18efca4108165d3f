//! The exact Hessian of the cost of a scene, as several tests look at it.

use varda::setup::Problem;
use varda_assimilation::{ControlTransform, CostFunction, LeastSquares, StrongConstraint};

/// ∇²J p beside differences of ∇J, extrapolated three times, of the last `constants` entries and of
/// those before; and qᵀ∇²J p = pᵀ∇²J q. Returns by how much Gauss and Newton's product is off,
/// relative.
pub(crate) fn is_that_of_differences(problem: &Problem, constants: usize, bound: f64) -> f64 {
    let mut observations = problem.observations().unwrap();
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref()).unwrap();
    let mut model = problem.model();
    let mut cost = StrongConstraint::new(model.as_mut(), transform, &mut observations).unwrap();
    let n = cost.dim();
    let wave = |a: f64, b: f64| (0..n).map(|i| a * (b + 1.7 * i as f64).sin()).collect::<Vec<f64>>();
    let (v, p, q) = (wave(0.2, 1.0), wave(1.0, 0.4), wave(1.0, -0.7));
    let mut gradient = |h: f64| -> Vec<f64> {
        let moved: Vec<f64> = v.iter().zip(&p).map(|(v, p)| v + h * p).collect();
        let mut gradient = vec![0.0; n];
        cost.linearize(&moved, &mut gradient).unwrap();
        gradient
    };
    let plain = [0.64, 0.32, 0.16, 0.08].map(|h| -> Vec<f64> {
        gradient(h).iter().zip(gradient(-h)).map(|(a, b)| (a - b) / (2.0 * h)).collect()
    });
    let mut best = plain.to_vec();
    for power in [4.0, 16.0, 64.0] {
        let better = |coarse: &[f64], fine: &[f64]| -> Vec<f64> {
            coarse.iter().zip(fine).map(|(c, f)| f + (f - c) / (power - 1.0)).collect()
        };
        best = best.windows(2).map(|steps| better(&steps[0], &steps[1])).collect();
    }
    gradient(0.0);
    let [mut of_p, mut of_q, mut gauss_newton] = [(); 3].map(|()| vec![0.0; n]);
    cost.exact_hessian_apply(&p, &mut of_p).unwrap();
    cost.exact_hessian_apply(&q, &mut of_q).unwrap();
    cost.hessian_apply(&p, &mut gauss_newton).unwrap();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let norm = |a: &[f64]| dot(a, a).sqrt();
    let off = |a: &[f64], b: &[f64]| norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>()) / norm(b);
    for (name, of) in [("state", 0..n - constants), ("constants", n - constants..n)] {
        let product = &of_p[of.clone()];
        let error = off(&best[0][of.clone()], product);
        let [coarse, fine] = [2, 3].map(|i: usize| off(&plain[i][of.clone()], product));
        let slope = (coarse / fine).log2();
        assert!(error <= bound, "{name}: off by {error:e}, slope {slope}");
        assert!((slope - 2.0).abs() <= 0.1, "{name}: slope {slope}");
    }
    let gap = (dot(&of_p, &q) - dot(&of_q, &p)).abs() / (norm(&of_p) * norm(&q));
    assert!(gap <= 1e-12, "symmetric to {gap:e}");
    let largest = (0..n).max_by(|i, j| of_p[*i].abs().total_cmp(&of_p[*j].abs())).unwrap();
    let left_out = off(&gauss_newton, &of_p);
    of_p[largest] *= 1.0 + 10.0 * bound;
    assert!(off(&best[0], &of_p) > bound, "a wrong entry is not seen");
    left_out
}
