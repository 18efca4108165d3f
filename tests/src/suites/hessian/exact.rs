//! Products with the exact Hessian of assembled costs: the second-order adjoint.

use super::times;
use crate::row::{Case, Outcome, Rows};
use problems::rods::wave;
use varda_assimilation::{
    ControlTransform, CostFunction, LeastSquares, Observation, ObservationSet, Selection, StrongConstraint,
};
use varda_covariance::Diagonal;
use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{Keep, Model, Rk4, Storage, Trajectory};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

/// ∇²J p against extrapolated differences of the gradient, its symmetry, and the matrix of its columns.
pub(in crate::suites) fn product(case: &mut Case, cost: &mut dyn LeastSquares, v: &[f64]) -> Outcome {
    let n = cost.dim();
    let a: Vec<f64> = (0..n).map(|i| wave(i, 72)).collect();
    let b: Vec<f64> = (0..n).map(|i| wave(i, 73)).collect();
    let mut difference = |h: f64| -> Result<Vec<f64>> {
        let mut sides = [vec![0.0; n], vec![0.0; n]];
        for (g, sign) in sides.iter_mut().zip([1.0, -1.0]) {
            let there: Vec<f64> = v.iter().zip(&a).map(|(v, a)| v + sign * h * a).collect();
            cost.evaluate(&there, Some(g))?;
        }
        Ok(sides[0].iter().zip(&sides[1]).map(|(p, m)| (p - m) / (2.0 * h)).collect())
    };
    let h = 2e-3 / norm(&a);
    let steps = [difference(4.0 * h)?, difference(2.0 * h)?, difference(h)?];
    // two extrapolations: errors of h² and h⁴ are gone
    let once = |coarse: &[f64], fine: &[f64], k: f64| -> Vec<f64> {
        coarse.iter().zip(fine).map(|(c, f)| f + (f - c) / (k - 1.0)).collect()
    };
    let better = [once(&steps[0], &steps[1], 4.0), once(&steps[1], &steps[2], 4.0)];
    let best = once(&better[0], &better[1], 16.0);

    cost.evaluate(v, Some(&mut vec![0.0; n]))?;
    let [mut product_a, mut product_b, mut gauss_newton] = std::array::from_fn(|_| vec![0.0; n]);
    cost.exact_hessian_apply(&a, &mut product_a)?;
    cost.exact_hessian_apply(&b, &mut product_b)?;
    cost.hessian_apply(&a, &mut gauss_newton)?;
    let away = |x: &[f64]| norm(&x.iter().zip(&product_a).map(|(x, p)| x - p).collect::<Vec<_>>());
    let size = norm(&product_a);
    let dropped = away(&gauss_newton) / size;
    case.at_most("exact product against differences of ∇J", away(&best) / size, 1e-7, "-")
        .computed(dropped)
        .because(
            "gradients good to 1e-12 over steps of 2e-3; computed: the share that Gauss and Newton leave out",
        );
    let [coarse, fine] = [away(&steps[0]), away(&steps[1])];
    if coarse > 1e-6 * size {
        let slope = (coarse / fine).log2();
        case.at_most("slope of the differences", (slope - 2.0).abs(), 0.2, "-").computed(slope);
    }
    let asymmetry = (dot(&b, &product_a) - dot(&a, &product_b)).abs() / (norm(&b) * size);
    case.at_most("symmetry of the exact product", asymmetry, 1e-12, "-");
    if n <= 60 {
        let mut dense = vec![0.0; n * n];
        cost.exact_hessian(&mut dense)?;
        let columns = away(&times(&dense, &a)) / size;
        case.at_most("exact product against columns", columns, 1e-11, "-");
    }
    Ok(())
}

/// vᵀ∇²J v of the problem "Lorenz-96 values" (docs/reference-problems.md), v_i = cos i, in another
/// program; and the same bits whatever is kept.
pub(super) fn reference(rows: &mut Rows) {
    rows.case("lorenz96 reference problem", |case| {
        let n = 40;
        let truth0: Vec<f64> = (0..n).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
        let background: Vec<f64> =
            truth0.iter().enumerate().map(|(i, x)| x + 0.5 * (2.3 * i as f64 + 1.0).cos()).collect();
        let mut model = Rk4::new(Lorenz96::new(n, 8.0), 0, 0.01);
        let mut truth = Trajectory::new();
        truth.run(&mut model, &truth0, 100, Keep::States)?;
        let seen = (1..=10).map(|i| {
            let k = 10 * i;
            let y = |j: usize| truth.state(k)[2 * j] + (12.9898 * (k * n + j) as f64).sin();
            Observation::new(k, (0..n / 2).collect(), (0..n / 2).map(y).collect(), 1.0)
        });
        let even = Selection::new((0..n / 2).map(|j| 2 * j).collect(), n)?;
        let mut set = ObservationSet::new(100, vec![Box::new(even)], seen.collect())?;
        let b = Diagonal::uniform(n, 0.5)?;
        let transform = ControlTransform::new(background, &b)?;
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set)?;
        // z = z_b + 0.5 v
        let v: Vec<f64> = (0..n).map(|i| 0.2 * (i as f64).sin()).collect();
        let p: Vec<f64> = (0..n).map(|i| 2.0 * (i as f64).cos()).collect();
        let mut products = Vec::new();
        for storage in [Storage::KeepAll, Storage::States, Storage::Checkpoints { states: 7 }] {
            cost.set_storage(storage);
            cost.evaluate(&v, Some(&mut vec![0.0; n]))?;
            let mut product = vec![0.0; n];
            cost.exact_hessian_apply(&p, &mut product)?;
            // a second time: λ is then known where all is kept
            cost.exact_hessian_apply(&p, &mut product)?;
            products.push(product);
        }
        let value = dot(&p, &products[0]);
        case.at_most("vᵀ∇²J v", (value / 18792.368674046 - 1.0).abs(), 1e-10, "-")
            .computed(value)
            .because("another program, another order of summation over 100 steps of a chaotic model");
        let differ = products[1..].iter().filter(|p| **p != products[0]).count();
        case.at_most("storage policies with other bits", differ as f64, 0.0, "policies");
        let swept = cost.counts();
        case.at_most("sweeps of the second order", (swept.exact_sweeps as f64 - 6.0).abs(), 0.0, "sweeps");
        Ok(())
    });
    rows.case("no second derivatives", |case| {
        let mut model = Rk4::new(problems::small_problems::Linear::ring(3), 0, 0.1);
        let mut set = ObservationSet::new(
            1,
            vec![Box::new(Selection::new(vec![0], 3)?)],
            vec![Observation::new(1, vec![0], vec![1.0], 0.5)],
        )?;
        let b = Diagonal::uniform(3, 1.0)?;
        let refused = model.second_order().is_none();
        let mut cost = StrongConstraint::new(&mut model, ControlTransform::new(vec![0.0; 3], &b)?, &mut set)?;
        cost.evaluate(&[0.0; 3], Some(&mut [0.0; 3]))?;
        let error = cost.exact_hessian_apply(&[1.0; 3], &mut [0.0; 3]);
        let named = error.err().is_some_and(|e| e.to_string().contains("no exact Hessian"));
        case.at_most("not refused", f64::from(!(named && refused)), 0.0, "-");
        Ok(())
    });
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}
