//! `time.tolerance`: adaptive time steps, fixed during a minimization and chosen again if they are too long
//! along the analysis.

use varda::outcome::{Outcome, Status};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

/// Ten segments over 40 steps, each step to 1e-4 of the length.
fn problem(seed: u64, more: &[&str]) -> Problem {
    let sets = ["time.tolerance=1e-4", "time.window=40", "model.segments=10"];
    let sets: Vec<String> = sets.iter().chain(more).map(|s| s.to_string()).collect();
    let sets = [sets, vec![format!("seed={seed}")]].concat();
    Problem::from_scene(&SceneFile::open("hanging-rod-case1", &sets).unwrap()).unwrap()
}

fn assimilated(problem: &Problem) -> Outcome {
    assimilate(problem, &mut Listener::silent()).unwrap()
}

/// Seed 6 starts so far from the truth that steps chosen along its background are too long along its
/// analysis; seed 4 does not.
#[test]
fn steps_that_are_too_long_along_the_analysis_are_chosen_again() {
    let kept = assimilated(&problem(4, &[]));
    assert_eq!(kept.accepted_steps.unwrap().refreshed, 0);
    assert!(kept.convergence.windows(2).all(|pair| pair[0].iteration < pair[1].iteration));

    let given = problem(6, &[]);
    let anew = assimilated(&given);
    let steps = anew.accepted_steps.as_ref().unwrap();
    assert_eq!((anew.status, steps.refreshed), (Status::Converged, 1));
    assert!(steps.largest_error.unwrap() <= 2.0 * steps.tolerance && anew.warnings.is_empty());
    // The table goes on where the first minimization ended: once more that iterate, with the new steps.
    let again = anew.convergence.windows(2).filter(|pair| pair[0].iteration == pair[1].iteration).count();
    assert_eq!(again, 1);
    // One of the two is enough: the point is as stationary as was first asked for.
    assert!(anew.gradient_norms[1] <= 1e-8 * anew.gradient_norms[0], "{:?}", anew.gradient_norms);
    assert!(anew.has_posterior);

    // The outcome has the new steps, and they are those of the analysed trajectory.
    let mut model = given.model_with(steps);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&anew.analysis.analysis, &mut x).unwrap();
    let mut next = x.clone();
    for k in 0..given.experiment.grid.steps {
        model.step(k, &x, &mut next).unwrap();
        std::mem::swap(&mut x, &mut next);
        assert_eq!(x, anew.trajectories.state(&anew.trajectories.analysis, k + 1).unwrap(), "step {k}");
    }

    let folder = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("adaptive-steps");
    let _ = std::fs::remove_dir_all(&folder);
    varda::report::write(&anew, &folder).unwrap();
    let page = std::fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(page.contains(&format!("Adaptive time steps</dt><dd>{}</dd>", steps.accepted)));
    assert!(page.contains("at a tolerance of 1e-4, chosen again: 1"));

    for twice in [assimilated(&given), assimilated(&problem(6, &[]))] {
        assert_eq!(twice.analysis.analysis, anew.analysis.analysis, "the same bits");
        assert_eq!(twice.accepted_steps, anew.accepted_steps);
    }
}

/// The steps of the truth are its own: what it shows does not depend on the background.
#[test]
fn the_truth_does_not_depend_on_the_background() {
    let wide = ["background.covariance.sigma_v_over_mean_speed=4.0"];
    let (one, other) = (problem(6, &[]), problem(6, &wide));
    assert_ne!(one.background, other.background);
    assert_eq!(one.observed.seen, other.observed.seen);
}
