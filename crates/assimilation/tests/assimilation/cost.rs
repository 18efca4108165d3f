//! The assembled cost: its gradient, its Gauss–Newton Hessian, what it calls and what it forgets.

use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Dense, Diagonal};

/// A covariance that couples everything, of size n.
pub(crate) fn coupled(n: usize, sigma: f64) -> Dense {
    let mut matrix = vec![0.0; n * n];
    for i in 0..n {
        for j in 0..n {
            matrix[i + j * n] = sigma * sigma * (-0.5 * (i as f64 - j as f64).abs()).exp();
        }
    }
    Dense::new(n, &matrix).unwrap()
}

/// Lorenz-96 with 6 variables: two operators, one of them curved, times between steps, missing rows, several
/// σ.
pub(crate) fn curved_problem() -> (Rk4<Lorenz96>, Vec<f64>, ObservationSet) {
    let background: Vec<f64> = normals(5, 6).iter().map(|x| 2.0 + 2.0 * x).collect();
    let values = normals(6, 40);
    let mut observations = Vec::new();
    for (j, step) in [0, 3, 3, 7, 12].into_iter().enumerate() {
        let mut o =
            observation(&[5, 1, 2], step, [0.0, 0.3, 0.7, 0.0, 0.0][j], &values[3 * j..3 * j + 3], 0.7);
        o.sigma[1] = 0.3;
        observations.push(o.clone());
        (o.operator, o.rows, o.weight) = (1, vec![1, 0, 1], 0.0);
        o.step = (step + 1).min(12);
        observations.push(o);
    }
    let set = ObservationSet::new(14, vec![all_of(6), Box::new(Products(6))], observations).unwrap();
    (Rk4::new(Lorenz96(6), 0.03), background, set)
}

/// The remainder |J(v + h p) − J(v) − h ∇J·p| falls like h²: the slope of its logarithm, fitted.
pub(crate) fn taylor_slope(cost: &mut dyn CostFunction, v: &[f64], gradient: &[f64]) -> f64 {
    let p = normals(77, v.len());
    let value = cost.evaluate(v, None).unwrap();
    let points: Vec<(f64, f64)> = (0..6)
        .map(|i| {
            let h = 1e-2 * 0.5f64.powi(i);
            let moved: Vec<f64> = v.iter().zip(&p).map(|(v, p)| v + h * p).collect();
            let rest = cost.evaluate(&moved, None).unwrap() - value - h * dot(gradient, &p);
            (h.ln(), rest.abs().ln())
        })
        .collect();
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(f).sum::<f64>() / points.len() as f64;
    let (mx, my) = (mean(&|p| p.0), mean(&|p| p.1));
    mean(&|p| (p.0 - mx) * (p.1 - my)) / mean(&|p| (p.0 - mx) * (p.0 - mx))
}

/// Central differences of J, extrapolated once: an error of order h⁴, 1e-9 or so.
pub(crate) fn difference_gradient(cost: &mut dyn CostFunction, v: &[f64]) -> Vec<f64> {
    (0..v.len())
        .map(|i| {
            let mut central = |h: f64| {
                let mut moved = v.to_vec();
                moved[i] = v[i] + h;
                let up = cost.evaluate(&moved, None).unwrap();
                moved[i] = v[i] - h;
                (up - cost.evaluate(&moved, None).unwrap()) / (2.0 * h)
            };
            (4.0 * central(5e-4) - central(1e-3)) / 3.0
        })
        .collect()
}

pub(crate) fn relative(a: &[f64], b: &[f64]) -> f64 {
    norm(&a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<_>>()) / norm(b)
}

#[test]
fn gradient_is_that_of_j_at_two_successive_controls_and_leaves_no_trace() {
    let (mut model, background, mut set) = curved_problem();
    let b = coupled(6, 0.5);
    let mut cost =
        StrongConstraint::new(&mut model, ControlTransform::new(background, &b).unwrap(), &mut set).unwrap();
    let (v1, v2) = (normals(7, 6), normals(8, 6));
    let (mut g1, mut g2, mut again) = (vec![0.0; 6], vec![0.0; 6], vec![0.0; 6]);
    let j1 = cost.evaluate(&v1, Some(&mut g1)).unwrap();
    let j2 = cost.evaluate(&v2, Some(&mut g2)).unwrap();
    for (v, g) in [(&v1, &g1), (&v2, &g2)] {
        let slope = taylor_slope(&mut cost, v, g);
        assert!((slope - 2.0).abs() <= 0.05, "{slope}");
        let error = relative(&difference_gradient(&mut cost, v), g);
        assert!(error <= 1e-8, "{error:e}");
        assert_eq!(
            cost.evaluate(if g == &g1 { &v1 } else { &v2 }, Some(&mut again)).unwrap(),
            if g == &g1 { j1 } else { j2 }
        );
        assert_eq!(&again, g);
    }
}

#[test]
fn a_wrong_adjoint_is_caught() {
    let (mut model, background, mut set) = curved_problem();
    model.mutation = 1e-3;
    let b = coupled(6, 0.5);
    let mut cost =
        StrongConstraint::new(&mut model, ControlTransform::new(background, &b).unwrap(), &mut set).unwrap();
    let v = normals(7, 6);
    let mut g = vec![0.0; 6];
    cost.evaluate(&v, Some(&mut g)).unwrap();
    assert!((taylor_slope(&mut cost, &v, &g) - 2.0).abs() > 0.05);
    assert!(relative(&difference_gradient(&mut cost, &v), &g) > 1e-6);
    assert!(dot_product_error(&mut cost) > 1e-6);
}

/// |⟨G dv, w⟩ − ⟨dv, Gᵀ w⟩|, relative to the norms.
fn dot_product_error(cost: &mut dyn LeastSquares) -> f64 {
    let (n, m) = (cost.dim(), cost.observation_dim());
    let (dv, w) = (normals(11, n), normals(12, m));
    let (mut dy, mut back) = (vec![0.0; m], vec![0.0; n]);
    cost.jacobian(&dv, &mut dy).unwrap();
    cost.jacobian_transpose(&w, &mut back).unwrap();
    let (left, right) = (dot(&dy, &w), dot(&dv, &back));
    assert!(left.abs() > 1e-3 * norm(&dy) * norm(&w), "an empty test");
    (left - right).abs() / (norm(&dy) * norm(&w))
}

#[test]
fn hessian_products_agree_with_the_matrix_and_with_differences_of_predictions() {
    let (mut model, background, mut set) = curved_problem();
    let b = coupled(6, 0.5);
    let mut cost =
        StrongConstraint::new(&mut model, ControlTransform::new(background, &b).unwrap(), &mut set).unwrap();
    let n = 6;
    let v = normals(9, n);
    let mut g = vec![0.0; n];
    cost.evaluate(&v, Some(&mut g)).unwrap();
    assert!(dot_product_error(&mut cost) <= 1e-14);
    let mut hessian = vec![0.0; n * n];
    cost.hessian(&mut hessian).unwrap();
    // A trial point must not move the point of the products.
    cost.evaluate(&normals(10, n), None).unwrap();
    let dv = normals(13, n);
    let mut product = vec![0.0; n];
    cost.hessian_apply(&dv, &mut product).unwrap();
    let expected: Vec<f64> = (0..n).map(|i| (0..n).map(|j| hessian[i + j * n] * dv[j]).sum()).collect();
    assert!(relative(&product, &expected) <= 1e-13);
    for i in 0..n {
        for j in 0..n {
            assert_eq!(hessian[i + j * n], hessian[j + i * n]);
        }
    }

    // G from differences of the predictions themselves.
    let m = cost.observation_dim();
    let mut dy = vec![0.0; m];
    cost.jacobian(&dv, &mut dy).unwrap();
    let sigma = cost.observations().sigma().to_vec();
    let mut predicted = |h: f64| {
        let moved: Vec<f64> = v.iter().zip(&dv).map(|(v, d)| v + h * d).collect();
        cost.evaluate(&moved, Some(&mut g)).unwrap();
        cost.predicted().to_vec()
    };
    let mut central = |h: f64| -> Vec<f64> {
        let (up, down) = (predicted(h), predicted(-h));
        (0..m).map(|i| (up[i] - down[i]) / (2.0 * h * sigma[i])).collect()
    };
    let (fine, coarse) = (central(5e-4), central(1e-3));
    let difference: Vec<f64> = fine.iter().zip(&coarse).map(|(f, c)| (4.0 * f - c) / 3.0).collect();
    assert!(relative(&difference, &dy) <= 1e-8);
}

#[test]
fn an_accepted_trial_point_is_not_run_again_and_steps_nobody_observes_are_not_run() {
    let (mut model, background, mut set) = curved_problem();
    let b = Diagonal::uniform(6, 0.5).unwrap();
    let mut cost =
        StrongConstraint::new(&mut model, ControlTransform::new(background, &b).unwrap(), &mut set).unwrap();
    let (v, trial) = (normals(7, 6), normals(8, 6));
    let (mut g, mut g_trial, mut g_fresh) = (vec![0.0; 6], vec![0.0; 6], vec![0.0; 6]);
    cost.evaluate(&v, Some(&mut g)).unwrap();
    // The window has 14 steps; the last observation is at 12.
    let once = varda_implicit::Counts {
        model_steps: 12,
        linearizations: 12,
        adjoint_steps: 12,
        ..Default::default()
    };
    assert_eq!(cost.counts().model, once);
    cost.evaluate(&trial, None).unwrap();
    assert_eq!(cost.counts().model, varda_implicit::Counts { model_steps: 24, ..once });
    cost.evaluate(&trial, Some(&mut g_trial)).unwrap();
    let twice = varda_implicit::Counts {
        model_steps: 24,
        linearizations: 24,
        adjoint_steps: 24,
        ..Default::default()
    };
    assert_eq!(cost.counts().model, twice);
    assert_eq!((cost.counts().forward_runs, cost.counts().gradients), (2, 2));
    // Back to the point before: its trajectory is still there.
    let mut back = vec![0.0; 6];
    cost.evaluate(&v, Some(&mut back)).unwrap();
    assert_eq!(cost.counts().forward_runs, 2);
    assert_eq!(back, g);
    // A dense Hessian takes tangent sweeps only.
    let adjoints = cost.counts().adjoint_sweeps;
    cost.hessian(&mut vec![0.0; 36]).unwrap();
    assert_eq!((cost.counts().adjoint_sweeps, cost.counts().tangent_sweeps), (adjoints, 6));
    drop(cost);
    let (mut model, background, mut set) = curved_problem();
    let mut fresh =
        StrongConstraint::new(&mut model, ControlTransform::new(background, &b).unwrap(), &mut set).unwrap();
    fresh.evaluate(&trial, Some(&mut g_fresh)).unwrap();
    assert_eq!(g_fresh, g_trial);
}

#[test]
fn a_failure_names_its_step_and_leaves_the_linearized_point() {
    let (mut model, background, mut set) = curved_problem();
    model.bound = 50.0;
    let b = Diagonal::uniform(6, 1.0).unwrap();
    let mut cost =
        StrongConstraint::new(&mut model, ControlTransform::new(background, &b).unwrap(), &mut set).unwrap();
    let v = normals(7, 6);
    let (mut g, mut product, mut again) = (vec![0.0; 6], vec![0.0; 6], vec![0.0; 6]);
    cost.evaluate(&v, Some(&mut g)).unwrap();
    cost.hessian_apply(&v, &mut product).unwrap();
    let far: Vec<f64> = v.iter().map(|v| 60.0 * v).collect();
    let terms = cost.terms();
    let error = cost.evaluate(&far, None).unwrap_err();
    assert!(
        matches!(error, Error::Model(varda_implicit::Error::NonFinite { .. }) | Error::Observe { .. }),
        "{error}"
    );
    assert!(error.to_string().contains("step"));
    assert_eq!(cost.terms(), terms);
    cost.hessian_apply(&v, &mut again).unwrap();
    assert_eq!(again, product);
    assert!(matches!(cost.evaluate(&[f64::NAN; 6], None), Err(Error::NonFinite { .. })));
    let wrong = ControlTransform::new(vec![0.0; 5], &b);
    assert!(matches!(wrong.err(), Some(Error::Length { expected: 6, found: 5, .. })));
}

#[test]
fn inflated_errors_scale_j_o_and_reuse_the_run() {
    let (mut model, background, mut set) = curved_problem();
    let b = Diagonal::uniform(6, 0.5).unwrap();
    let mut cost =
        StrongConstraint::new(&mut model, ControlTransform::new(background, &b).unwrap(), &mut set).unwrap();
    let v = normals(7, 6);
    let mut g = vec![0.0; 6];
    cost.evaluate(&v, Some(&mut g)).unwrap();
    let terms = cost.terms();
    cost.set_observation_scale(10.0);
    let mut scaled = vec![0.0; 6];
    cost.evaluate(&v, Some(&mut scaled)).unwrap();
    // A handful of roundings.
    assert!((cost.terms().observation - terms.observation / 100.0).abs() <= 1e-15 * terms.observation);
    let expected: Vec<f64> = g.iter().zip(&v).map(|(g, v)| v + (g - v) / 100.0).collect();
    assert!(relative(&scaled, &expected) <= 1e-13);
    assert_eq!(cost.counts().forward_runs, 1);
}

/// A linear problem against its closed form, worked out densely and apart from all sweeps:
/// x_a = x_b + K (y − H x_b), K = B Hᵀ(H B Hᵀ + R)⁻¹, P_a = (I − K H) B, with H the stacked H_k
/// M_k … M_0.
#[test]
fn a_linear_problem_has_the_closed_form_minimum_and_covariance() {
    let (n, steps) = (4, 8);
    let field = || Linear(n, normals(20, n * n).iter().map(|a| 0.5 * a).collect());
    let mut model = Rk4::new(field(), 0.1);
    let b = coupled(n, 0.8);
    let background = normals(21, n);
    let values = normals(22, 12);
    let observations: Vec<Observation> = (0..4)
        .map(|j| {
            observation(
                &[j % 2, 2, 3],
                2 * j,
                if j == 1 { 0.4 } else { 0.0 },
                &values[3 * j..3 * j + 3],
                0.3 + 0.1 * j as f64,
            )
        })
        .collect();
    let mut set = ObservationSet::new(steps, vec![all_of(n)], observations.clone()).unwrap();
    let m = set.dim();

    // The stacked H, column by column, from runs of the (linear) model.
    let mut stacked = vec![vec![0.0; n]; m];
    for c in 0..n {
        let mut unit = vec![0.0; n];
        unit[c] = 1.0;
        let states = run(&mut Rk4::new(field(), 0.1), &unit, steps);
        for (o, rows) in observations.iter().zip(stacked.chunks_mut(3)) {
            for (row, h) in o.rows.iter().zip(rows) {
                h[c] = (1.0 - o.weight) * states[o.step][*row] + o.weight * states[o.step + 1][*row];
            }
        }
    }
    let apply_b = |x: &[f64]| {
        let mut y = vec![0.0; n];
        b.apply(x, &mut y);
        y
    };
    let bht: Vec<Vec<f64>> = stacked.iter().map(|h| apply_b(h)).collect();
    let s: Vec<Vec<f64>> = (0..m)
        .map(|i| {
            (0..m)
                .map(|j| dot(&stacked[i], &bht[j]) + if i == j { set.sigma()[i].powi(2) } else { 0.0 })
                .collect()
        })
        .collect();
    let d: Vec<f64> = (0..m).map(|i| set.values()[i] - dot(&stacked[i], &background)).collect();
    let weights = solve(s.clone(), d.clone());
    let expected: Vec<f64> =
        (0..n).map(|i| background[i] + (0..m).map(|j| bht[j][i] * weights[j]).sum::<f64>()).collect();
    let j_expected = 0.5 * dot(&d, &weights);
    let mut variance = vec![0.0; n];
    b.variance(&mut variance);
    for i in 0..n {
        let column: Vec<f64> = (0..m).map(|j| bht[j][i]).collect();
        variance[i] -= dot(&column, &solve(s.clone(), column.clone()));
    }

    for minimizer in [
        Minimizer::default(),
        Minimizer::Newton(NewtonOptions::default()),
        Minimizer::NewtonCg(NewtonCgOptions::default()),
        Minimizer::TrustRegion(TrustRegionOptions::default().with_dense_limit(0)),
    ] {
        let transform = ControlTransform::new(background.clone(), &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap();
        let mut v = vec![0.0; n];
        let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
        assert_eq!(minimum.status, Status::Converged, "{minimizer:?}");
        let posterior = Posterior::new(&mut cost).unwrap();
        let analysis = Analysis::new(&transform, &v, &minimum, &posterior, m);
        // |g| ≤ 1e-8 |g₀| and a condition number of some hundred.
        assert!(relative(&analysis.analysis, &expected) <= 1e-8, "{minimizer:?}");
        assert!((analysis.value - j_expected).abs() <= 1e-10 * j_expected);
        let sigma: Vec<f64> = variance.iter().map(|v| v.sqrt()).collect();
        assert!(relative(&analysis.sigma_analysis, &sigma) <= 1e-11);
        assert!((0..n).all(|i| analysis.sigma_analysis[i] < analysis.sigma_background[i]));
        // tr(HK), from the closed form.
        let hk: f64 = (0..m)
            .map(|j| {
                let column: Vec<f64> = (0..m).map(|i| dot(&stacked[i], &bht[j])).collect();
                solve(s.clone(), column)[j]
            })
            .sum();
        assert!((analysis.degrees_of_freedom - hk).abs() <= 1e-10);
        let covariance = posterior.covariance(&transform);
        assert!((0..n).all(|i| (covariance[i + i * n] - variance[i]).abs() <= 1e-11));
        assert!((posterior.trace(&transform) - variance.iter().sum::<f64>()).abs() <= 1e-11);
    }

    // Exact Hessian = Gauss–Newton: a difference of gradients of a quadratic has no truncation error.
    let mut cost =
        StrongConstraint::new(&mut model, ControlTransform::new(background, &b).unwrap(), &mut set).unwrap();
    let dv = normals(23, n);
    let (mut g0, mut g1, mut product) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    cost.evaluate(&vec![0.0; n], Some(&mut g0)).unwrap();
    cost.hessian_apply(&dv, &mut product).unwrap();
    cost.evaluate(&dv, Some(&mut g1)).unwrap();
    let difference: Vec<f64> = g1.iter().zip(&g0).map(|(a, b)| a - b).collect();
    assert!(relative(&product, &difference) <= 1e-12);
}

/// Gaussian elimination with partial pivoting.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).unwrap();
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            for j in k..n {
                a[i][j] -= factor * a[k][j];
            }
            b[i] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        b[k] = (b[k] - (k + 1..n).map(|j| a[k][j] * b[j]).sum::<f64>()) / a[k][k];
    }
    b
}

#[test]
fn without_observations_the_background_is_the_minimum_and_no_model_is_called() {
    let b = Diagonal::uniform(3, 1.0).unwrap();
    let mut model = Rk4::new(Lorenz63, 0.01);
    let mut set = ObservationSet::new(10, vec![all_of(3)], vec![]).unwrap();
    let mut cost =
        StrongConstraint::new(&mut model, ControlTransform::new(vec![1.0; 3], &b).unwrap(), &mut set)
            .unwrap();
    let mut v = vec![1.0, -2.0, 0.5];
    let minimum =
        Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(minimum.status, Status::Converged);
    assert!(norm(&v) <= 1e-8);
    assert_eq!(cost.counts().model, varda_implicit::Counts::default());
    assert_eq!(cost.counts().adjoint_sweeps, 0);
    let mut late =
        ObservationSet::new(1, vec![all_of(3)], vec![observation(&[0], 1, 0.0, &[1.0], 1.0)]).unwrap();
    let refused =
        StrongConstraint::without_model(ControlTransform::new(vec![1.0; 3], &b).unwrap(), &mut late);
    assert!(refused.is_err());
}
