//! Sequences of windows whose model errs: weak windows, and Q beside the other methods.

use varda::outcome::CyclesOutcome;
use varda::run::cycles::{CycleListener, Sequence};
use varda::scene::SceneFile;

const Q: [&str; 3] = [
    "algorithm.model_error.covariance.kind=diagonal",
    "algorithm.model_error.covariance.sigma=0.3",
    "algorithm.model_error.every=4",
];

fn sequence(scene: &str, sets: &[&str]) -> Result<Sequence, varda::Error> {
    let common =
        ["background.covariance.steps=3000", "algorithm.cycles.count=6", "algorithm.cycles.spin_up=1"];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    Ok(Sequence::from_scene(&SceneFile::open(scene, &sets)?)?.expect("a scene with cycles"))
}

fn run(scene: &str, sets: &[&str]) -> (Sequence, CyclesOutcome) {
    let sequence = sequence(scene, sets).unwrap();
    let outcome = sequence.run(sequence.start(), Vec::new(), &mut CycleListener::silent()).unwrap();
    (sequence, outcome)
}

const STRONG: &str = "lorenz96-cycling-4dvar";

fn gap(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |gap: f64, (a, b)| gap.max((a - b).abs()))
}

/// With Q → 0 a weak sequence is the strong one.
#[test]
fn a_weak_sequence_becomes_the_strong_one_as_q_vanishes() {
    let tight = "algorithm.gradient_tolerance=1e-9";
    let strong = run(STRONG, &[tight]).1;
    let small = "algorithm.model_error.covariance.sigma=1e-5";
    let weak = run(STRONG, &["algorithm.method=weak-forcing", tight, Q[0], Q[2], small]).1;
    // η has the size of Q against σ_b = 0.5, its effect that of the squares.
    let gap = gap(&strong.trajectories.analysis, &weak.trajectories.analysis);
    assert!(gap < 1e-6, "{gap}");
    assert_eq!(weak.cycles[0].model_errors.len(), 2 * 40);
    assert!(strong.cycles[0].model_errors.is_empty() && strong.cycles[0].j_q == 0.0);
}

/// The trajectory of a weak sequence is the model's run but for η at the end of every sub-window; a step
/// that two windows share has the later one's analysis, and what it is off from the run before is
/// `increment`.
#[test]
fn the_trajectory_of_a_weak_sequence_has_its_errors_and_one_value_a_step() {
    let (sequence, weak) = run(STRONG, &["algorithm.method=weak-forcing", Q[0], Q[1], Q[2]]);
    let runs = &weak.trajectories;
    let state = |k: usize| runs.state(&runs.analysis, k).unwrap();
    assert_eq!(runs.analysis.len(), 40 * (6 * 8 + 1));
    for (c, row) in weak.cycles.iter().enumerate() {
        assert!(row.j_q > 0.0);
        assert_eq!(gap(state(8 * c), &row.analysis), 0.0);
        let mut model = (sequence.problem.make_model)(8 * c);
        let mut next = vec![0.0; 40];
        for k in 0..8 {
            model.step(k, state(8 * c + k), &mut next).unwrap();
            if k % 4 == 3 {
                let eta = &row.model_errors[k / 4 * 40..][..40];
                next.iter_mut().zip(eta).for_each(|(x, eta)| *x += eta);
            }
            if k < 7 {
                assert_eq!(gap(state(8 * c + k + 1), &next), 0.0, "{c} {k}");
            } else if let Some(after) = weak.cycles.get(c + 1) {
                assert!(gap(&next, &after.background) < 1e-12);
                let sum: f64 = next.iter().zip(&after.analysis).map(|(b, a)| (a - b) * (a - b)).sum();
                assert!(((sum / 40.0).sqrt() - after.increment[0]).abs() < 1e-12);
            }
        }
    }
}

/// Q makes what is handed on wider, by all that hand something on.
#[test]
fn q_widens_what_windows_hand_on() {
    let propagated = ["algorithm.cycles.covariance=propagated"];
    for (scene, sets) in [(STRONG, &propagated[..]), ("lorenz96-cycling-4denvar", &[])] {
        let plain = run(scene, sets).1;
        let wider = run(scene, &[sets, &Q[..]].concat()).1;
        let spread = |of: &CyclesOutcome| of.cycles.last().unwrap().spread[0];
        assert!(spread(&wider) > 1.2 * spread(&plain), "{scene}: {} {}", spread(&plain), spread(&wider));
    }
}

#[test]
fn q_that_nothing_uses_is_refused() {
    let refusal = |sets: &[&str]| sequence(STRONG, sets).err().expect("cannot be meant").to_string();
    assert!(refusal(&Q).contains("Q does not change a static B"), "{}", refusal(&Q));
    let propagated = ["algorithm.cycles.covariance=propagated"];
    let late = [propagated[0], Q[0], Q[1], "algorithm.model_error.every=9"];
    assert!(refusal(&late).contains("no error enters between two windows"), "{}", refusal(&late));
    let lost = ["algorithm.method=weak-state", "algorithm.minimizer=auto", Q[0], Q[1], propagated[0]];
    assert!(refusal(&lost).contains("needs the inverse of B"), "{}", refusal(&lost));
    assert!(refusal(&["algorithm.method=blue", "algorithm.minimizer=auto"]).contains("linearized once"));
}

/// Incremental 4D-Var and 4D-PSAS end where 4D-Var does, window after window; the weak form over states where
/// that over the forcing does, with a static B and with a propagated one.
#[test]
fn methods_of_outer_loops_are_cycled() {
    let tight =
        ["algorithm.gradient_tolerance=1e-10", "algorithm.max_iterations=60", "algorithm.minimizer=auto"];
    let ended = |sets: &[&str]| run(STRONG, &[&tight[..], sets].concat()).1;
    let largest =
        |a: &CyclesOutcome, b: &CyclesOutcome| gap(&a.trajectories.analysis, &b.trajectories.analysis);
    let full = ended(&[]);
    for method in ["algorithm.method=4dvar-incremental", "algorithm.method=4d-psas"] {
        // gradients of 1e-10 of the first, and six windows of a chaotic model
        let gap = largest(&ended(&[method]), &full);
        assert!(gap < 1e-6, "{method}: {gap}");
    }
    for propagated in
        [&[][..], &["algorithm.cycles.covariance=propagated", "algorithm.cycles.dropped_variance=0"]]
    {
        let over = |method| ended(&[&[method][..], &Q, propagated].concat());
        let [forcing, states] = ["algorithm.method=weak-forcing", "algorithm.method=weak-state"].map(over);
        let gap = largest(&forcing, &states);
        assert!(gap < 1e-5, "{propagated:?}: {gap}");
        assert_eq!(states.cycles[0].model_errors.len(), 2 * 40);
        assert!((states.cycles[5].j_q - forcing.cycles[5].j_q).abs() < 1e-4 * forcing.cycles[5].j_q);
    }
}

/// Methods of one instant: incremental 3D-Var and PSAS.
#[test]
fn methods_of_one_instant_are_cycled() {
    let ended = |method: &str| -> Result<CyclesOutcome, varda::Error> {
        let sets = [method, "algorithm.minimizer=auto", "algorithm.gradient_tolerance=1e-10"];
        let sequence = sequence("lorenz96-cycling-3dvar", &sets)?;
        sequence.run(sequence.start(), Vec::new(), &mut CycleListener::silent())
    };
    let full = ended("algorithm.method=3dvar").unwrap();
    for method in ["algorithm.method=3dvar-incremental", "algorithm.method=psas"] {
        let gap = gap(&ended(method).unwrap().trajectories.analysis, &full.trajectories.analysis);
        assert!(gap < 1e-6, "{method}: {gap}");
    }
}
