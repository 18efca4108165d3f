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

/// The place known least at the end of the window and the largest tension there, of a run with something
/// changed.
fn numbers_of(considered: &Outcome, outcome: &Outcome) -> Vec<f64> {
    let last = outcome.experiment.grid.steps;
    let state = outcome.trajectories.state(&outcome.trajectories.analysis, last).unwrap();
    let names = &outcome.experiment.state.names;
    considered
        .considered
        .iter()
        .map(|of| match of.of.strip_prefix("tension of segment ") {
            Some(rest) => {
                let edge: usize = rest.split(',').next().unwrap().parse().unwrap();
                outcome.shapes.as_ref().unwrap().forces.last().unwrap().tension[edge]
            }
            None if of.unit == "m" => {
                let geometry = outcome.experiment.state.geometry.as_ref().unwrap();
                let axis = ["x", "y", "z"].iter().position(|a| of.of.starts_with(a)).unwrap();
                let group = &outcome.experiment.state.groups[0];
                let place = |v: &usize| of.of.contains(&format!("at s = {:.4} m", geometry.place(group, *v)));
                state[3 * (0..group.range.len() / 3).find(place).unwrap() + axis]
            }
            None => {
                let estimate = outcome.estimates.iter().find(|e| e.name == of.of);
                let name = of.of.split(',').next().unwrap();
                estimate.map_or_else(
                    || state[names.iter().position(|n| n == name).unwrap()],
                    |estimate| estimate.value,
                )
            }
        })
        .collect()
}

/// Differences of complete runs of a scene with a key at values around `value`, extrapolated to h⁴;
/// observations and, of a twin, the background and B stay.
fn differences(
    before: &Outcome,
    at: &Problem,
    (scene, set): (&str, &[&str]),
    key: &str,
    value: f64,
) -> Vec<f64> {
    let run = |factor: f64| {
        let key = key.replace("{}", &format!("{}", value * factor));
        let mut changed = problem(scene, &[set, &[&key]].concat());
        changed.observed.seen.clone_from(&at.observed.seen);
        if at.truth.is_some() {
            changed.background.clone_from(&at.background);
            // σ of velocities is a share of those of the truth
            changed.covariance = problem(scene, set).covariance;
        }
        numbers_of(before, &ended(&changed))
    };
    let central = |h: f64| -> Vec<f64> {
        let [high, low] = [1.0 + h, 1.0 - h].map(run);
        high.iter().zip(&low).map(|(high, low)| (high - low) / (2.0 * h * value)).collect()
    };
    let [far, near] = [1e-3, 5e-4].map(central);
    near.iter().zip(&far).map(|(near, far)| (4.0 * near - far) / 3.0).collect()
}

/// The derivatives by the constant with this name.
fn derivatives(outcome: &Outcome, name: &str) -> Vec<f64> {
    let by = |of: &varda::outcome::Considered| {
        of.by.iter().find(|c| c.name == name).unwrap_or_else(|| panic!("{name}")).derivative
    };
    outcome.considered.iter().map(by).collect()
}

/// Numbers are near each other, to a part of the largest of them.
fn near(found: &[f64], expected: &[f64], part: f64, what: &str) {
    let largest = expected.iter().fold(0.0_f64, |m, e| m.max(e.abs()));
    assert!(largest > 0.0 && found.len() == expected.len(), "{what}: {found:?} {expected:?}");
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= part * largest, "{what}: {found:e} {expected:e}");
    }
}

/// Of a linear model: two runs with a constant 1e-4 of it larger and smaller.
#[test]
fn a_constant_taken_for_known_moves_the_result_as_was_said() {
    let set = [
        "algorithm.method=\"4dvar\"",
        "algorithm.hessian=\"exact\"",
        "algorithm.gradient_tolerance=1e-13",
        "consider.speed={sigma=0.02}",
        "consider.diffusivity={sigma=\"10%\"}",
    ];
    let scene = "linear-advection";
    let at = problem(scene, &set);
    let before = ended(&at);
    let of = &before.considered[0];
    let by = &of.by[0];
    assert!((by.moves - 0.02 * by.derivative).abs() <= 1e-15 && by.sigma == 0.02 && by.value == 1.0);
    let squares = of.by.iter().map(|c| c.moves * c.moves).sum::<f64>() + of.sigma.unwrap().powi(2);
    assert!((of.sigma_with_considered.unwrap() - squares.sqrt()).abs() <= 1e-15);
    for (name, value) in [("speed", 1.0), ("diffusivity", 0.002)] {
        let expected = differences(&before, &at, (scene, &set), &format!("model.{name}={{}}"), value);
        // h⁴ of differences over a circle of some 60 rad: (60 · 1e-3)⁴/100
        near(&derivatives(&before, name), &expected, 1e-6, name);
    }
}

/// Of a rod, in motion in a twin and with a recording: stiffness, density, damping.
#[test]
fn a_rod_moves_with_what_is_taken_for_known() {
    let set = [
        "algorithm.hessian=\"exact\"",
        "algorithm.gradient_tolerance=1e-10",
        "model.damping.stiffness=0.01",
        "consider.youngs_modulus={sigma=\"1%\"}",
        "consider.density={sigma=\"1%\"}",
        "consider.damping_stiffness={sigma=0.001}",
        "consider.bias={sigma=0.001}",
    ];
    let scene = "hanging-rod-case2";
    let at = problem(scene, &set);
    let before = ended(&at);
    add_up(&before);
    let units: Vec<&str> = before.considered.iter().map(|of| of.unit).collect();
    assert_eq!(units, ["m", "m", "m", "N"]);
    for (name, key, value) in [
        ("youngs_modulus", "model.material.youngs_modulus={}", 1e6),
        ("density", "model.material.density={}", 1100.0),
        ("damping_stiffness", "model.damping.stiffness={}", 0.01),
    ] {
        let expected = differences(&before, &at, (scene, &set), key, value);
        // a tension is EA times a strain that Newton's method finds to 1e-11 of the length; measured 1.4e-8
        near(&derivatives(&before, name), &expected, 1e-6, name);
    }
}

/// A background at rest moves with the constants, and so do the estimates of others.
#[test]
fn a_background_at_rest_and_estimates_move_too() {
    let set = [
        "algorithm.hessian=\"exact\"",
        "algorithm.gradient_tolerance=1e-10",
        "time.window=20",
        "report.forecast=0.0",
        "report.mesh=false",
        "estimate.ei={sigma=\"30%\",together=true}",
        "consider.mass_per_length={sigma=\"1%\"}",
        "consider.natural_curvature={sigma=0.01}",
    ];
    let scene = "hose";
    let at = problem(scene, &set);
    let before = ended(&at);
    assert_eq!(before.considered.last().unwrap().of, "ei");
    for (name, key, value) in [
        ("mass_per_length", "model.section.mass_per_length={}", 0.35),
        ("natural_curvature[0]", "model.natural_curvature=[{},0.0]", 1.0),
    ] {
        let expected = differences(&before, &at, (scene, &set), key, value);
        let found = derivatives(&before, name);
        // EA is 1e5 N here: a tension is known to 1e-7 N, over 1e-3 of the constant; measured 9e-6,
        // places 1e-9
        for (numbers, part) in [(0..3, 1e-7), (3..4, 1e-4), (4..5, 1e-6)] {
            near(&found[numbers.clone()], &expected[numbers], part, name);
        }
    }
}

/// Of a rod, with the exact Hessian: a run with σ of a marker, the prior of a constant or a value
/// changed moves by the derivatives, those of the constant too.
#[test]
fn values_and_their_sigma_move_a_rod_as_was_said() {
    let ei = |share: f64| format!("estimate.ei={{sigma=\"{share}%\",together=true}}");
    let at = |hessian: &str, share: f64| {
        let hessian = format!("algorithm.hessian=\"{hessian}\"");
        let (tolerance, ei) = ("algorithm.gradient_tolerance=1e-10", ei(share));
        let set = [&hessian, tolerance, "time.window=20", "report.forecast=0.0", "report.mesh=false", &ei];
        problem("hose", &set)
    };
    let before = ended(&at("exact", 30.0));
    add_up_but_for_shares(&before);
    let other = ended(&at("gauss-newton", 30.0));
    let place = |outcome: &Outcome| -> Vec<f64> {
        let state = outcome.trajectories.state(&outcome.trajectories.analysis, 20).unwrap();
        let group = &outcome.experiment.state.groups[0];
        state[group.range.clone()][group.range.len() - 3..].to_vec()
    };
    assert!(before.sources[0].of.contains("at s = 0.6000 m"), "the tip");
    let by_sigma = |outcome: &Outcome, source: &str| -> Vec<f64> {
        let of = |of: &varda::outcome::Sources| {
            of.shares
                .iter()
                .find(|s| s.source == source)
                .unwrap_or_else(|| panic!("{source}"))
                .by_relative_sigma
        };
        outcome.sources[..3].iter().map(of).collect()
    };
    let central = |of: &dyn Fn(f64) -> Vec<f64>, h: f64| -> Vec<f64> {
        of(h).iter().zip(of(-h)).map(|(high, low)| (high - low) / (2.0 * h)).collect()
    };
    let marker = before.sensitivities[3].label.clone();
    let of_marker = |h: f64| {
        let mut changed = at("exact", 30.0);
        let sites: Vec<bool> = changed.observed.sites.iter().map(|site| site.label == marker).collect();
        let seen = changed.observed.seen.iter_mut().filter(|one| sites[one.site]);
        seen.for_each(|one| one.sigma *= h.exp());
        place(&ended(&changed))
    };
    let of_prior = |h: f64| place(&ended(&at("exact", 30.0 * h.exp())));
    let of_value = |h: f64| {
        let mut changed = at("exact", 30.0);
        let (seen, time) = (&before.sensitivities[3], &changed.experiment.grid.clone());
        let one = changed.observed.seen.iter_mut().find(|one| {
            let t = time.start + one.at() * time.step;
            (t - seen.time).abs() < 1e-12 && changed.observed.sites[one.site].label == seen.label
        });
        let axis = ["x", "y", "z"].iter().position(|axis| *axis == seen.axis).unwrap();
        *one.unwrap().values[axis].as_mut().unwrap() += h;
        place(&ended(&changed))
    };
    // h² of central differences in ln σ; a value moves by a twentieth of its σ
    near(&by_sigma(&before, &marker), &central(&of_marker, 1e-2), 1e-3, "σ of a marker");
    near(&by_sigma(&before, "prior of ei"), &central(&of_prior, 1e-2), 1e-3, "σ of a prior");
    near(&before.sensitivities[3].by_value[..3], &central(&of_value, 1e-4), 1e-3, "a value");
    // Gauss and Newton leave out second derivatives times departures: some per cent
    near(&by_sigma(&other, &marker), &by_sigma(&before, &marker), 0.2, "by Gauss and Newton");
}

/// With the exact Hessian what is left of a variance may be negative.
fn add_up_but_for_shares(outcome: &Outcome) {
    assert!(!outcome.sources.is_empty());
    for of in &outcome.sources {
        let moves: f64 = of.shares.iter().map(|s| s.by_relative_sigma).sum();
        assert!(moves.abs() <= 1e-12 * of.sigma, "{}: {moves}", of.of);
        assert!(of.shares.last().unwrap().source.ends_with("second derivatives"));
    }
}

/// What it does not go with says so at its key.
#[test]
fn what_is_not_considered_is_refused() {
    for (scene, set, expected) in [
        ("hose", "consider.base={sigma=0.001}", "[estimate] takes such"),
        ("hose", "consider.observation_sigma={sigma=\"10%\"}", "`sources` of summary.json"),
        ("hose", "consider.density={sigma=\"1%\"}", "mass_per_length"),
        ("hose", "consider.natural_twist={sigma=\"1%\"}", "is 0 in the scene"),
        ("hose", "consider.rho={sigma=1.0}", "no constant of this model"),
        ("lorenz96-4denvar", "consider.forcing={sigma=0.1}", "do not go with [consider]"),
        ("wires", "consider.ea={sigma=\"1%\"}", "several recordings"),
    ] {
        let set = [set.to_string()];
        let error = SceneFile::open(scene, &set).and_then(|file| Problem::from_scene(&file).map(|_| ()));
        let text = error.expect_err(expected).to_string();
        assert!(text.contains(expected), "{text}");
        assert!(text.contains("--set consider.") || text.contains(".toml"), "{text}");
    }
}
