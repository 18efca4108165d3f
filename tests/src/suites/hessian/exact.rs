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

/// What a cost is good to.
#[derive(Clone, Copy)]
pub(in crate::suites) struct Accuracy {
    /// Length of the shortest step of differences.
    pub(in crate::suites) reach: f64,
    /// Error of gradients, relative to their size, where it shows in differences.
    pub(in crate::suites) rounding: f64,
    /// Asymmetry of products, relative to their size.
    pub(in crate::suites) symmetry: f64,
}

impl Accuracy {
    /// That of small problems.
    pub(in crate::suites) const GOOD: Accuracy = Accuracy { reach: 2e-3, rounding: 0.0, symmetry: 1e-12 };
}

/// ∇²J p against extrapolated differences of the gradient, its symmetry, and the matrix of its columns.
pub(in crate::suites) fn product(
    case: &mut Case,
    cost: &mut dyn LeastSquares,
    v: &[f64],
    accuracy: Accuracy,
) -> Outcome {
    let n = cost.dim();
    let a: Vec<f64> = (0..n).map(|i| wave(i, 72)).collect();
    let b: Vec<f64> = (0..n).map(|i| wave(i, 73)).collect();
    let product_a = along(case, "", cost, [v, &a], accuracy)?;
    let (size, mut product_b) = (norm(&product_a), vec![0.0; n]);
    cost.exact_hessian_apply(&b, &mut product_b)?;
    let asymmetry = (dot(&b, &product_a) - dot(&a, &product_b)).abs() / (norm(&b) * size);
    case.at_most("symmetry of the exact product", asymmetry, accuracy.symmetry, "-")
        .because("rounding of two sweeps over the window, times the condition of its steps");
    if n <= 60 {
        let mut dense = vec![0.0; n * n];
        cost.exact_hessian(&mut dense)?;
        let columns = away(&times(&dense, &a), &product_a) / size;
        case.at_most("exact product against columns", columns, 1e-11, "-")
            .because("the same sweeps in another order");
    }
    Ok(())
}

/// ∇²J a, against extrapolated differences of the gradient; `of` says what a is. The point of the last
/// gradient is v afterwards.
pub(in crate::suites) fn along(
    case: &mut Case,
    of: &str,
    cost: &mut dyn LeastSquares,
    [v, a]: [&[f64]; 2],
    Accuracy { reach, rounding, .. }: Accuracy,
) -> Result<Vec<f64>> {
    let n = cost.dim();
    let mut difference = |h: f64| -> Result<Vec<f64>> {
        let mut sides = [vec![0.0; n], vec![0.0; n]];
        for (g, sign) in sides.iter_mut().zip([1.0, -1.0]) {
            let there: Vec<f64> = v.iter().zip(a).map(|(v, a)| v + sign * h * a).collect();
            cost.evaluate(&there, Some(g))?;
        }
        Ok(sides[0].iter().zip(&sides[1]).map(|(p, m)| (p - m) / (2.0 * h)).collect())
    };
    let h = reach / norm(a);
    let steps = [difference(4.0 * h)?, difference(2.0 * h)?, difference(h)?];
    // two extrapolations: errors of h² and h⁴ are gone
    let once = |coarse: &[f64], fine: &[f64], k: f64| -> Vec<f64> {
        coarse.iter().zip(fine).map(|(c, f)| f + (f - c) / (k - 1.0)).collect()
    };
    let better = [once(&steps[0], &steps[1], 4.0), once(&steps[1], &steps[2], 4.0)];
    let best = once(&better[0], &better[1], 16.0);

    let mut gradient = vec![0.0; n];
    cost.evaluate(v, Some(&mut gradient))?;
    let (mut product, mut gauss_newton) = (vec![0.0; n], vec![0.0; n]);
    cost.exact_hessian_apply(a, &mut product)?;
    cost.hessian_apply(a, &mut gauss_newton)?;
    let size = norm(&product);
    let dropped = away(&gauss_newton, &product) / size;
    case.at_most(
        &format!("exact product against differences of ∇J{of}"),
        away(&best, &product) / size,
        1e-7 + rounding * norm(&gradient) / (reach * size),
        "-",
    )
    .computed(dropped)
    .because(
        "gradients good to 1e-12 over steps of 2e-3; computed: the share that Gauss and Newton leave out",
    );
    let [coarse, fine] = [away(&steps[0], &product), away(&steps[1], &product)];
    if coarse > 1e-6 * size {
        let slope = (coarse / fine).log2();
        case.at_most(&format!("slope of the differences{of}"), (slope - 2.0).abs(), 0.2, "-")
            .computed(slope)
            .because("errors of central differences fall like h²; the next term is within a tenth");
    }
    Ok(product)
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

fn away(a: &[f64], b: &[f64]) -> f64 {
    norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>())
}

fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}
