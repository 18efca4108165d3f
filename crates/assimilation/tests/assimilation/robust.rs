//! The Huber norm and the background check.

use crate::cost::{coupled, curved_problem};
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Ensemble, Localization};
use varda_linalg::dense::Cholesky;

#[test]
fn the_norm_by_hand() {
    assert_eq!(huber(1.5, -1.0), (0.5, -1.0, 1.0));
    assert_eq!(huber(1.5, 1.5), (1.125, 1.5, 1.0));
    assert_eq!(huber(1.5, -3.0), (1.5 * 3.0 - 1.125, -1.5, 0.0));
    assert_eq!(huber(f64::INFINITY, 1e200).1, 1e200);
    assert!(huber(1.0, f64::NAN).0.is_nan());
}

/// Some rows inside δ and some beyond, at two successive controls: the gradient is that of J, the Hessian
/// that of the norm.
#[test]
fn gradient_and_hessian_at_two_successive_controls() {
    let (mut model, background, mut set) = curved_problem();
    let b = coupled(6, 0.5);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    assert!(matches!(cost.set_huber(0.0), Err(Error::Setting { .. })));
    assert!(matches!(cost.set_huber(f64::NAN), Err(Error::Setting { .. })));
    let (n, m) = (6, cost.observation_dim());
    let plain = cost.evaluate(&normals(7, n), None).unwrap();
    cost.set_huber(2.0).unwrap();
    for seed in [7, 8] {
        let (v, p) = (normals(seed, n), normals(seed + 50, n));
        let mut g = vec![0.0; n];
        let value = cost.evaluate(&v, Some(&mut g)).unwrap();
        let inside = cost
            .predicted()
            .iter()
            .zip(cost.observations().values())
            .zip(cost.observations().sigma())
            .filter(|((p, y), s)| (*y - *p).abs() <= 2.0 * **s)
            .count();
        assert!(0 < inside && inside < m, "{inside} of {m}: nothing to tell apart");
        if seed == 7 {
            assert!(value < plain);
        }
        // Small steps, so that no row crosses δ.
        let points: Vec<(f64, f64)> = (0..6)
            .map(|i| {
                let h = 2e-4 * 0.5f64.powi(i);
                let moved: Vec<f64> = v.iter().zip(&p).map(|(v, p)| v + h * p).collect();
                let rest = cost.evaluate(&moved, None).unwrap() - value - h * dot(&g, &p);
                (h.ln(), rest.abs().ln())
            })
            .collect();
        let slope = (points[0].1 - points[5].1) / (points[0].0 - points[5].0);
        assert!((slope - 2.0).abs() <= 0.05, "{slope}");

        let (dv, w) = (normals(seed + 60, n), normals(seed + 70, m));
        let (mut dy, mut back) = (vec![0.0; m], vec![0.0; n]);
        cost.jacobian(&dv, &mut dy).unwrap();
        cost.jacobian_transpose(&w, &mut back).unwrap();
        assert!((dot(&dy, &w) - dot(&dv, &back)).abs() <= 1e-14 * norm(&dy) * norm(&w));
        assert_eq!(dy.iter().filter(|dy| **dy == 0.0).count(), m - inside);
        let (mut product, mut hessian) = (vec![0.0; n], vec![0.0; n * n]);
        cost.hessian_apply(&dv, &mut product).unwrap();
        cost.hessian(&mut hessian).unwrap();
        for i in 0..n {
            let row: f64 = (0..n).map(|j| hessian[i + j * n] * dv[j]).sum();
            assert!((row - product[i]).abs() <= 1e-12 * norm(&product));
        }
    }
}

/// One gross error of 50 σ among twelve values: squares are dragged along, the Huber norm hardly, and a
/// threshold of infinity is squares.
#[test]
fn a_gross_error_pulls_no_harder_than_its_threshold() {
    let b = coupled(3, 1.0);
    let truth = [0.4, -0.2, 0.7];
    let analyse = |gross: f64, delta: f64| {
        let noise = normals(5, 12);
        let seen = (0..4)
            .map(|j| {
                let mut y: Vec<f64> = truth.iter().zip(&noise[3 * j..]).map(|(x, e)| x + 0.1 * e).collect();
                y[1] += if j == 2 { gross } else { 0.0 };
                observation(&[0, 1, 2], 0, 0.0, &y, 0.1)
            })
            .collect();
        let mut set = ObservationSet::new(0, vec![all_of(3)], seen).unwrap();
        let transform = ControlTransform::new(vec![0.0; 3], &b).unwrap();
        let mut cost = StrongConstraint::without_model(transform.clone(), &mut set).unwrap();
        cost.set_huber(delta).unwrap();
        let mut v = vec![0.0; 3];
        let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()));
        assert_eq!(minimum.unwrap().status, Status::Converged);
        let mut z = vec![0.0; 3];
        transform.control(&v, &mut z);
        z
    };
    let away = |z: &[f64], clean: &[f64]| (z[1] - clean[1]).abs();
    let clean = analyse(0.0, f64::INFINITY);
    assert!(away(&analyse(5.0, f64::INFINITY), &clean) > 1.0);
    // Its pull is δ/σ, shared by the three good values of that component: a third of δ σ, and the prior
    // takes a little off.
    let robust = away(&analyse(5.0, 1.5), &clean);
    assert!((0.02..=0.05 + 1e-3).contains(&robust), "{robust}");
    // Twice the error pulls no harder.
    assert!((away(&analyse(10.0, 1.5), &clean) - robust).abs() <= 1e-7);
}

#[test]
fn the_background_check_names_the_gross_errors_and_only_those() {
    let (truth, background, set) = lorenz63_twin(3, 20, 5);
    let b = coupled(3, 1.0);
    let spoil = |set: ObservationSet| {
        let (operators, mut observations) = set.into_parts();
        observations[1].values[2] += 60.0;
        observations[3].values[0] -= 60.0;
        observations[3].label = String::from("loose marker");
        ObservationSet::new(20, operators, observations).unwrap()
    };
    let mut spoiled = spoil(set);
    let mut model = Rk4::new(Lorenz63, 0.01);
    let transform = ControlTransform::new(background.clone(), &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut spoiled).unwrap();
    cost.set_huber(3.0).unwrap();
    let rejected = cost.background_check(4.0).unwrap();
    assert_eq!(cost.huber_threshold(), 3.0);
    assert!(matches!(cost.background_check(f64::NAN), Err(Error::Setting { .. })));
    let named: Vec<(usize, usize, usize, &str)> =
        rejected.iter().map(|r| (r.observation, r.entry, r.row, r.label.as_str())).collect();
    assert_eq!(named, [(1, 2, 5, ""), (3, 0, 9, "loose marker")]);

    // The standard deviation expected, against draws from B carried by the model itself: 2000 of them, 5
    // standard errors, and curvature.
    let predicted = |z: &[f64]| run(&mut Rk4::new(Lorenz63, 0.01), z, 10)[10][2];
    let middle = predicted(&background);
    let variance = (0..2000)
        .map(|i| {
            let mut dz = [0.0; 3];
            b.root(&normals(500 + i, 3).iter().map(|v| 1e-3 * v).collect::<Vec<_>>(), &mut dz);
            let z: Vec<f64> = background.iter().zip(&dz).map(|(z, d)| z + d).collect();
            (1e3 * (predicted(&z) - middle)).powi(2)
        })
        .sum::<f64>()
        / 2000.0;
    let expected = (variance + 2.0).sqrt();
    assert!((rejected[0].expected / expected - 1.0).abs() <= 0.08, "{} {expected}", rejected[0].expected);

    // The ensemble's check, with members that represent B, refuses the same.
    let members: Vec<f64> = (0..400)
        .flat_map(|i| {
            let mut dz = [0.0; 3];
            b.root(&normals(9000 + i, 3), &mut dz);
            background.iter().zip(dz).map(|(z, d)| z + d).collect::<Vec<_>>()
        })
        .collect();
    let ensemble = Ensemble::new(&members, Localization::none(3)).unwrap();
    let make = || -> Box<dyn varda_implicit::Model + Send> { Box::new(Rk4::new(Lorenz63, 0.01)) };
    let by_ensemble: Vec<usize> = {
        let mut envar = EnVar::new(&make, background.clone(), &ensemble, &mut spoiled, &[]).unwrap();
        envar.background_check(4.0).unwrap().iter().map(|r| r.row).collect()
    };
    assert_eq!(by_ensemble, [5, 9]);

    // Without them the analysis is that of a set that never had them.
    let rows: Vec<usize> = rejected.iter().map(|r| r.row).collect();
    let cleaned = spoiled.without(&rows).unwrap();
    assert_eq!(cleaned.dim(), 10);
    let (_, _, original) = lorenz63_twin(3, 20, 5);
    let kept = original.without(&rows).unwrap();
    assert_eq!(cleaned.values(), kept.values());
    assert_eq!(truth.len(), 3);
    let untouched = kept.without(&[]).unwrap();
    assert_eq!(untouched.dim(), 10);
}

#[test]
fn a_sighting_is_refused_whole_by_its_distance_from_the_background() {
    let check = |together: bool, spoil: &dyn Fn(&mut Observation)| {
        let (_, background, set) = lorenz63_twin(3, 20, 5);
        let (operators, mut observations) = set.into_parts();
        spoil(&mut observations[1]);
        if together {
            observations = observations.into_iter().map(Observation::together).collect();
        }
        let mut set = ObservationSet::new(20, operators, observations).unwrap();
        let b = coupled(3, 1.0);
        let mut model = Rk4::new(Lorenz63, 0.01);
        let transform = ControlTransform::new(background, &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        let refused = cost.background_check(4.0).unwrap();

        // Both ways of the distance: by columns of G, as here, and by rows.
        let (n, m) = (cost.dim(), cost.observation_dim());
        let mut g = vec![vec![0.0; n]; m];
        for (row, g) in g.iter_mut().enumerate() {
            let mut unit = vec![0.0; m];
            unit[row] = 1.0;
            cost.jacobian_transpose(&unit, g).unwrap();
        }
        let mut d = vec![0.0; m];
        cost.observations().innovations(cost.predicted(), &mut d);
        cost.observations().whiten(&mut d);
        for group in refused.chunk_by(|a, b| a.observation == b.observation && together) {
            let rows: Vec<usize> = group.iter().map(|r| r.row).collect();
            let r = rows.len();
            let entry = |(i, j): (usize, usize)| {
                let own = if i == j { 1.0 } else { 0.0 };
                own + (0..n).map(|k| g[rows[i]][k] * g[rows[j]][k]).sum::<f64>()
            };
            let s: Vec<f64> = (0..r * r).map(|at| entry((at % r, at / r))).collect();
            let d: Vec<f64> = rows.iter().map(|row| d[*row]).collect();
            let mut solved = d.clone();
            Cholesky::new(r, &s).unwrap().solve(&mut solved);
            let distance = d.iter().zip(&solved).map(|(d, s)| d * s).sum::<f64>().sqrt();
            for refused in group {
                assert!((refused.distance / distance - 1.0).abs() < 1e-10, "{} {distance}", refused.distance);
            }
        }
        refused.iter().map(|r| (r.observation, r.entry)).collect::<Vec<_>>()
    };
    let one_value = |seen: &mut Observation| seen.values[2] += 60.0;
    assert_eq!(check(false, &one_value), [(1, 2)]);
    assert_eq!(check(true, &one_value), [(1, 0), (1, 1), (1, 2)]);
    assert_eq!(check(true, &|_| ()), []);
}
