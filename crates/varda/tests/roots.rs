//! One covariance, two roots: the recursion along a rod and the eigenvectors of the dense matrix.

use varda::outcome::Outcome;
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

fn assimilated(sets: &[&str]) -> Outcome {
    let common =
        ["time.window=40", "algorithm.minimizer=gauss-newton-cg", "algorithm.gradient_tolerance=1e-10"];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| (*s).to_string()).collect();
    let problem = Problem::from_scene(&SceneFile::open("hose", &sets).unwrap()).unwrap();
    assimilate(&problem, &mut Listener::silent()).unwrap()
}

fn apart(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let largest = a.iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    a.iter().zip(b).fold(0.0_f64, |m, (a, b)| m.max((a - b).abs())) / largest
}

/// J, analysis and σ depend on B, not on its root.
#[test]
fn a_recursion_and_eigenvectors_give_the_same_analysis() {
    let recursion = assimilated(&[]);
    let truncated = |part: &str| assimilated(&["background.covariance.root=truncated", part]);
    let dense = truncated("background.covariance.truncation=1e-15");
    let [ours, theirs] = [recursion.analysis.value, dense.analysis.value];
    assert!((ours - theirs).abs() <= 1e-9 * theirs, "J {ours} {theirs}");
    // The minimum is where the gradient is 1e-10 of the first: the analysis is within that times the
    // square root of the condition number of the Hessian (some 1e3) of it.
    let analysis = |a: &Outcome, b: &Outcome| apart(&a.analysis.analysis, &b.analysis.analysis);
    assert!(analysis(&recursion, &dense) <= 1e-7, "{:e}", analysis(&recursion, &dense));
    let sigma = apart(&recursion.sigma_states, &dense.sigma_states);
    assert!(recursion.has_posterior && sigma <= 1e-6, "{sigma:e}");
    // A B that lacks what is below a thousandth is told apart.
    let rough = truncated("background.covariance.truncation=1e-3");
    assert!(analysis(&recursion, &rough) > 1e-5, "{:e}", analysis(&recursion, &rough));
}
