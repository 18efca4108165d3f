//! What the uncertainty of a result comes from, and how the result depends on observed values.

use varda::outcome::Outcome;
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

fn problem(scene: &str, set: &[&str]) -> Problem {
    let set: Vec<String> = set.iter().map(|s| s.to_string()).collect();
    Problem::from_scene(&SceneFile::open(scene, &set).unwrap()).unwrap()
}

fn ended(problem: &Problem) -> Outcome {
    assimilate(problem, &mut Listener::silent()).unwrap()
}

/// The shares sum to one, and none is negative but for rounding.
fn add_up(outcome: &Outcome) {
    assert!(!outcome.sources.is_empty());
    for of in &outcome.sources {
        let sum: f64 = of.shares.iter().map(|s| s.share).sum();
        assert!((sum - 1.0).abs() <= 1e-12, "{}: {sum}", of.of);
        let moves: f64 = of.shares.iter().map(|s| s.by_relative_sigma).sum();
        assert!(moves.abs() <= 1e-12 * of.sigma, "{}: {moves}", of.of);
        for share in &of.shares {
            assert!(share.share >= -1e-6, "{}: {} {:e}", of.of, share.source, share.share);
        }
    }
}

/// Of a linear problem a run with one value changed moves by the derivative.
#[test]
fn a_changed_value_moves_the_result_as_was_said() {
    let mut problem = problem("linear-advection", &["algorithm.gradient_tolerance=1e-13"]);
    let before = ended(&problem);
    add_up(&before);
    let of = &before.sources[0];
    let name = of.of.split(',').next().unwrap().to_string();
    let component = before.experiment.state.names.iter().position(|n| *n == name).unwrap();
    let last = problem.experiment.grid.steps;
    let at_end = |o: &Outcome| o.trajectories.state(&o.trajectories.analysis, last).unwrap()[component];
    let sigma = o_sigma(&before, last, component);
    assert!((of.sigma / sigma - 1.0).abs() <= 1e-9, "{} {sigma}", of.sigma);
    for i in [0, 7, before.sensitivities.len() - 1] {
        let seen = &before.sensitivities[i];
        let changed = problem.observed.seen.iter().position(|one| {
            let t = problem.experiment.grid.start + one.at() * problem.experiment.grid.step;
            (t - seen.time).abs() < 1e-12 && problem.observed.sites[one.site].label == seen.label
        });
        let changed = changed.unwrap();
        let old = problem.observed.seen[changed].values[0].unwrap();
        problem.observed.seen[changed].values[0] = Some(old + 1.0);
        let moved = at_end(&ended(&problem)) - at_end(&before);
        problem.observed.seen[changed].values[0] = Some(old);
        // two minimizations to 1e-13 of the gradient
        assert!((moved - seen.by_value[0]).abs() <= 1e-8, "{moved} {}", seen.by_value[0]);
        assert!(i != 7 || seen.by_value[0].abs() > 1e-6, "a value that says nothing");
    }
}

/// And with the σ of a component changed, or that of the background.
#[test]
fn a_changed_sigma_moves_the_result_as_was_said() {
    let mut problem = problem("linear-advection", &["algorithm.gradient_tolerance=1e-13"]);
    let before = ended(&problem);
    let of = &before.sources[0];
    let name = of.of.split(',').next().unwrap().to_string();
    let component = before.experiment.state.names.iter().position(|n| *n == name).unwrap();
    let last = problem.experiment.grid.steps;
    let at_end = |o: &Outcome| o.trajectories.state(&o.trajectories.analysis, last).unwrap()[component];
    let of_background = of.shares.last().unwrap();
    assert!(of_background.by_relative_sigma.abs() > 1e-3 * of.sigma, "a background that pulls at nothing");
    let largest = |s: &&varda::outcome::SourceShare| s.by_relative_sigma.abs();
    let marker = of.shares[..of.shares.len() - 1].iter().max_by(|a, b| largest(a).total_cmp(&largest(b)));
    let marker = marker.unwrap();
    let label = |i: usize, p: &Problem| p.observed.sites[p.observed.seen[i].site].label.clone();
    // central differences, h² of the third derivative
    let h = 1e-3_f64;
    let mut by = |own: bool| {
        let mut moved = [h, -h].map(|h| {
            let old: Vec<f64> = problem.observed.seen.iter().map(|one| one.sigma).collect();
            for i in 0..old.len() {
                if (label(i, &problem) == marker.source) == own {
                    problem.observed.seen[i].sigma *= h.exp();
                }
            }
            let end = at_end(&ended(&problem));
            problem.observed.seen.iter_mut().zip(old).for_each(|(one, old)| one.sigma = old);
            end
        });
        moved[0] -= moved[1];
        moved[0] / (2.0 * h)
    };
    let (own, others) = (by(true), by(false));
    assert!((own - marker.by_relative_sigma).abs() <= 1e-5 * of.sigma, "{own} {marker:?}");
    // all markers together undo what the background does
    let all = own + others + of_background.by_relative_sigma;
    assert!(all.abs() <= 1e-5 * of.sigma, "{all} {of_background:?}");
}

fn o_sigma(outcome: &Outcome, step: usize, component: usize) -> f64 {
    outcome.sigma_states[step * outcome.trajectories.dim + component]
}

/// Of a rod: three coordinates of a place and the largest tension; priors of constants among the sources.
#[test]
fn a_rod_and_its_stiffness() {
    let outcome = ended(&problem("hanging-rod-case2", &["estimate.youngs_modulus={sigma=\"20%\"}"]));
    add_up(&outcome);
    let units: Vec<&str> = outcome.sources.iter().map(|of| of.unit).collect();
    assert_eq!(units, ["m", "m", "m", "N"]);
    let named = |source: &str| outcome.sources[0].shares.iter().any(|s| s.source == source);
    assert!(named("prior of youngs_modulus") && named("background of the state") && named("s = 1 m"));
    assert_eq!(outcome.sensitivities[0].by_value.len(), 4);
    // Huber's norm has another posterior than the values' σ say
    assert!(ended(&problem("hanging-rod-case2", &["algorithm.robust=2.0"])).sources.is_empty());
}
