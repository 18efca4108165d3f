//! Twin problems with known minima (tests/fixtures: from an independent NumPy implementation).

use crate::models::*;
use serde_json::Value;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Dense, Precision};
use varda_implicit::Model;

pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn check(text: &str, mut model: Option<&mut dyn Model>, minimizer: &Minimizer) {
    let problem: Value = serde_json::from_str(text).unwrap();
    let n = problem["n"].as_u64().unwrap() as usize;
    let steps = problem["K"].as_u64().unwrap() as usize;
    let matrix: Vec<f64> = problem["B"].as_array().unwrap().iter().flat_map(numbers).collect();
    let b = Dense::new(n, &matrix).unwrap();
    let rows: Vec<usize> = numbers(&problem["H_rows"]).iter().map(|&r| r as usize).collect();
    let sigma = problem["R_diag"].as_f64().unwrap().sqrt();
    let every: Vec<usize> = (0..rows.len()).collect();
    let observations = problem["obs"].as_object().unwrap();
    let observations = observations
        .iter()
        .map(|(k, y)| observation(&every, k.parse().unwrap(), 0.0, &numbers(y), sigma))
        .collect();
    let mut set =
        ObservationSet::new(steps, vec![Box::new(Selection::new(rows, n).unwrap())], observations).unwrap();
    let m = set.dim();
    let transform = ControlTransform::new(numbers(&problem["xb"]), &b).unwrap();
    let mut cost = match &mut model {
        Some(model) => StrongConstraint::new(*model, transform.clone(), &mut set).unwrap(),
        None => StrongConstraint::without_model(transform.clone(), &mut set).unwrap(),
    };

    let mut v = vec![0.0; n];
    let j_b = cost.evaluate(&v, None).unwrap();
    let expected = problem["J_b"].as_f64().unwrap();
    assert!((j_b - expected).abs() <= 1e-10 * expected, "J(x_b) {j_b} {expected}");
    let minimum = minimizer.minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(minimum.status, Status::Converged, "{minimizer:?}: {minimum:?}");
    let expected = problem["J_min"].as_f64().unwrap();
    assert!((minimum.value - expected).abs() <= 1e-8 * expected, "J {} {expected}", minimum.value);
    let posterior = Posterior::new(&mut cost).unwrap();
    let analysis = Analysis::new(&transform, &v, &minimum, &posterior, m);
    let gap: Vec<f64> = analysis.analysis.iter().zip(numbers(&problem["xa"])).map(|(a, e)| a - e).collect();
    let mut white = vec![0.0; n];
    b.whiten(&gap, &mut white);
    assert!(norm(&white) <= 1e-4, "|Δx| {:e}", norm(&white));
    let expected = problem["trPa"].as_f64().unwrap();
    let trace = posterior.trace(&transform);
    assert!((trace - expected).abs() <= 1e-6 * expected, "tr P_a {trace} {expected}");
}

fn minimizers() -> Vec<Minimizer> {
    vec![
        Minimizer::default(),
        Minimizer::TrustRegion(TrustRegionOptions::default().with_dense_limit(0)),
        Minimizer::TrustRegion(TrustRegionOptions::default().with_secant_terms(0)),
        Minimizer::NewtonCg(NewtonCgOptions::default()),
        Minimizer::NewtonCg(NewtonCgOptions::default().with_preconditioner_pairs(100)),
        Minimizer::Auto(AutoOptions::default()),
        Minimizer::Lbfgs(LbfgsOptions::default()),
        #[cfg(feature = "argmin")]
        Minimizer::ArgminLbfgs(ArgminLbfgsOptions::default().with_gradient_tolerance(1e-6)),
        #[cfg(feature = "argmin")]
        Minimizer::ArgminTrustRegion(ArgminTrustRegionOptions::default().with_gradient_tolerance(1e-6)),
    ]
}

#[test]
fn lin3dvar() {
    for minimizer in minimizers().into_iter().chain([Minimizer::Newton(NewtonOptions::default())]) {
        check(include_str!("../../../../tests/fixtures/twin/lin3dvar.json"), None, &minimizer);
    }
}

#[test]
fn l63() {
    for minimizer in minimizers() {
        check(
            include_str!("../../../../tests/fixtures/twin/l63.json"),
            Some(&mut Rk4::new(Lorenz63, 0.01)),
            &minimizer,
        );
    }
}

#[test]
fn l96() {
    for minimizer in minimizers() {
        check(
            include_str!("../../../../tests/fixtures/twin/l96.json"),
            Some(&mut Rk4::new(Lorenz96(40), 0.0125)),
            &minimizer,
        );
    }
}
