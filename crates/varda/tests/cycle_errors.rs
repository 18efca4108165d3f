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
    let late = ["algorithm.cycles.covariance=propagated", Q[0], Q[1], "algorithm.model_error.every=9"];
    assert!(refusal(&late).contains("no error enters between two windows"), "{}", refusal(&late));
    let state = ["algorithm.method=weak-state", Q[0], Q[1], "algorithm.minimizer=auto"];
    assert!(refusal(&state).contains("\"weak-state\" is not cycled"), "{}", refusal(&state));
}
