//! Where one more observation would help most, and the exact Hessian of a scene.

#[path = "support/exact_hessian.rs"]
mod exact_hessian;

use varda::outcome::{Outcome, Status};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

fn run(scene: &str, set: &[&str]) -> Outcome {
    let set: Vec<String> = set.iter().map(|s| s.to_string()).collect();
    let problem = Problem::from_scene(&SceneFile::open(scene, &set).unwrap()).unwrap();
    assimilate(&problem, &mut Listener::silent()).unwrap()
}

fn refused(scene: &str, set: &[&str]) -> String {
    let set: Vec<String> = set.iter().map(|s| s.to_string()).collect();
    let file = match SceneFile::open(scene, &set) {
        Ok(file) => file,
        Err(error) => return error.to_string(),
    };
    Problem::from_scene(&file).err().map_or(String::new(), |error| error.to_string())
}

/// Root mean square σ of all components at the end.
fn at_the_end(outcome: &Outcome) -> f64 {
    let n = outcome.trajectories.dim;
    let last = &outcome.sigma_states[outcome.sigma_states.len() - n..];
    (last.iter().map(|s| s * s).sum::<f64>() / n as f64).sqrt()
}

/// Of a linear problem what was said is what a run with that component more finds.
#[test]
fn one_more_component_does_what_was_said() {
    let outcome = run("linear-advection", &[]);
    let next = outcome.next_observation.as_ref().unwrap();
    assert_eq!((next.times, next.candidates.len()), (8, 25));
    assert!((next.sigma_now / at_the_end(&outcome) - 1.0).abs() <= 1e-9);
    let best = next.best().unwrap();
    let component: usize = best
        .component
        .as_ref()
        .unwrap()
        .chars()
        .filter(char::is_ascii_digit)
        .collect::<String>()
        .parse()
        .unwrap();
    let more = run("linear-advection", &[&format!("observations.components=[0,16,32,48,64,{component}]")]);
    // two decompositions of a matrix of condition 1e3
    assert!((best.sigma / at_the_end(&more) - 1.0).abs() <= 1e-9, "{} {}", best.sigma, at_the_end(&more));
    assert!(best.sigma < 0.95 * next.sigma_now);
}

/// Of a rod the places are its free vertices; a marker more never makes σ larger.
#[test]
fn one_more_marker_of_a_rod() {
    let outcome = run("hanging-rod-case2", &[]);
    let next = outcome.next_observation.as_ref().unwrap();
    assert_eq!(next.candidates.len(), 24);
    let along = |i: usize| next.candidates[i].arc_length.unwrap();
    assert!((along(0) - 0.08).abs() < 1e-12 && (along(23) - 1.0).abs() < 1e-12);
    assert!(next.candidates.iter().all(|c| c.sigma > 0.0 && c.sigma <= next.sigma_now * (1.0 + 1e-12)));
}

#[test]
fn a_scene_asks_for_the_exact_hessian() {
    let plain = run("hanging-rod-case1", &[]);
    let exact = run("hanging-rod-case1", &["algorithm.hessian=exact"]);
    assert_eq!((plain.status, exact.status), (Status::Converged, Status::Converged));
    assert!((exact.analysis.value / plain.analysis.value - 1.0).abs() <= 1e-8);
    assert!(exact.iterations[0] < plain.iterations[0], "{:?} {:?}", exact.iterations, plain.iterations);
    let made_with =
        |outcome: &Outcome, name: &str| outcome.convergence.iter().any(|r| r.hessian == Some(name));
    assert!(made_with(&exact, "exact") && made_with(&exact, "gauss-newton") && !made_with(&plain, "exact"));
    assert!(plain.exact_hessian.is_none());
    assert_eq!(plain.model_counts.adjoint_derivatives, 0);
    assert!(exact.model_counts.adjoint_derivatives > 0);
    let found = exact.exact_hessian.unwrap();
    let (smallest, change) = (found.smallest_eigenvalue.unwrap(), found.sigma_change.unwrap());
    assert!(smallest > 0.3 && smallest < 1.0, "{smallest}");
    assert!(change > 0.01 && change < 1.0, "{change}");
    let share = found.effective_share.unwrap();
    assert!(share > 0.0 && share <= 1.0, "{share}");
    // a linear problem has one Hessian, and its posterior is Gaussian
    let linear = run("linear-advection", &["algorithm.method=4dvar", "algorithm.hessian=exact"]);
    let found = linear.exact_hessian.unwrap();
    assert!(found.sigma_change.unwrap() <= 1e-7, "{found:?}");
    assert!(found.effective_share.unwrap() >= 1.0 - 1e-6, "{found:?}");
}

/// A hose whose bending stiffness, damping and curvature are unknown.
const UNKNOWN: [&str; 4] = [
    "model.damping.mass=0.2",
    "estimate.ei={sigma=\"30%\",together=true}",
    "estimate.damping_stiffness={sigma=\"50%\"}",
    "estimate.natural_curvature={sigma=0.5}",
];

#[test]
fn estimates_have_the_exact_hessian_too() {
    let with: Vec<&str> = UNKNOWN.into_iter().chain(["algorithm.hessian=exact"]).collect();
    let (plain, exact) = (run("hose", &UNKNOWN), run("hose", &with));
    assert_eq!((plain.status, exact.status), (Status::Converged, Status::Converged));
    assert!((exact.analysis.value / plain.analysis.value - 1.0).abs() <= 1e-6);
    assert_eq!(plain.model_counts.adjoint_derivatives, 0);
    assert!(exact.convergence.iter().any(|r| r.hessian == Some("exact")));
    let found = exact.exact_hessian.unwrap();
    assert!(found.smallest_eigenvalue.unwrap() > 0.0, "{found:?}");
    for (one, other) in plain.estimates.iter().zip(&exact.estimates) {
        assert!((one.value - other.value).abs() <= 1e-3 * other.sigma.unwrap(), "{}", one.name);
        // by second derivatives of the model, and not the same number
        let change = other.sigma.unwrap() / one.sigma.unwrap() - 1.0;
        assert!(change != 0.0 && change.abs() <= found.sigma_change.unwrap() * 1.01, "{change}");
    }
}

/// Constants that move supports, also with places of markers and a mount that are unknown.
#[test]
fn what_moves_supports_has_the_exact_hessian_too() {
    let clamp =
        ["time.window=80", "estimate.clamp_direction={sigma=0.05}", "estimate.support_position={sigma=0.01}"];
    let seen = ["estimate.mount_rotation={sigma=0.02}"];
    let base = [
        "model.segments=10",
        "time.window=40",
        "estimate.base={sigma=2e-4}",
        "estimate.base_rotation={sigma=9e-4}",
        "estimate.marker_offset={sigma=0.003}",
    ];
    let cases: [(&str, Vec<&str>); 2] =
        [("hose", [&clamp[..], &seen].concat()), ("tether-on-base", base.to_vec())];
    for (scene, sets) in cases {
        let sets: Vec<&str> = ["report.forecast=0", "report.mesh=false"].into_iter().chain(sets).collect();
        let with: Vec<&str> = sets.iter().copied().chain(["algorithm.hessian=exact"]).collect();
        let (plain, exact) = (run(scene, &sets), run(scene, &with));
        assert_eq!((plain.status, exact.status), (Status::Converged, Status::Converged));
        let (one, other) = (plain.analysis.value, exact.analysis.value);
        assert!((other / one - 1.0).abs() <= 1e-6, "{scene}: {one} and {other}");
        assert_eq!(plain.model_counts.adjoint_derivatives, 0);
        assert!(exact.convergence.iter().any(|r| r.hessian == Some("exact")), "{scene}");
        let found = exact.exact_hessian.unwrap();
        assert!(found.smallest_eigenvalue.unwrap() > 0.0, "{scene}: {found:?}");
        for (one, other) in plain.estimates.iter().zip(&exact.estimates) {
            let change = other.sigma.unwrap() / one.sigma.unwrap() - 1.0;
            assert!(change.abs() <= found.sigma_change.unwrap() * 1.01, "{scene}, {}: {change}", one.name);
        }
    }
}

/// ∇²J beside differences of ∇J, of every key that moves supports: without twist and with, held at both
/// ends, with markers off the axis, a mount and a clock that are unknown, and stiffness and damping.
#[test]
fn the_exact_hessian_of_a_cost_with_supports_that_move() {
    let short = ["time.window=15", "report.forecast=0"];
    let seen = [
        "estimate.mount_rotation={sigma=0.02}",
        "estimate.marker_offset={sigma=0.003}",
        "estimate.damping_stiffness={sigma=\"30%\"}",
    ];
    let placed = ["estimate.clamp_direction={sigma=0.05}", "estimate.support_position={sigma=0.01}"];
    let drive = ["estimate.drive_radii={sigma=\"10%\"}", "estimate.drive_phase={sigma=0.05}"];
    let base = ["estimate.base={sigma=0.002}", "estimate.base_rotation={sigma=0.02}"];
    let (clock, skip) = ("estimate.clock={sigma=0.005}", "observations.outside_window=skip");
    let coarse = "model.segments=12";
    let flat = "model.section.ei=[0.03,0.02]";
    let cases: [(&str, Vec<&str>); 5] = [
        ("hanging-rod-csv", [&placed[..], &drive, &[skip]].concat()),
        (
            "hose",
            [&placed[..], &[seen[0], seen[2], clock, coarse, "background.covariance.sigma_x=0.03"]].concat(),
        ),
        ("twisted-rod", [&placed[..], &drive, &[coarse]].concat()),
        ("tether-on-base", [&placed[..], &base, &seen, &[coarse]].concat()),
        ("tether-on-base", [&base[..], &seen, &[coarse, flat]].concat()),
    ];
    for (scene, sets) in cases {
        let all: Vec<String> = short.into_iter().chain(sets).map(str::to_string).collect();
        let problem = Problem::from_scene(&SceneFile::open(scene, &all).unwrap()).unwrap();
        // h⁸ of the ninth derivative
        let left_out = exact_hessian::is_that_of_differences(&problem, 5, 1e-7);
        assert!(left_out > 1e-4, "{scene}: {left_out:e}");
    }
}

/// Drag, a force that follows the rod and a moment.
#[test]
fn loads_of_the_motion_have_the_exact_hessian_too() {
    let loads = [
        "model.moments=[{arc_length=1.5,moment=[0.0,0.0004,0.0002]}]",
        "model.forces=[{arc_length=2.0,force=[0.0,0.0,0.766],follower=true}]",
    ];
    let with: Vec<&str> = loads.into_iter().chain(["algorithm.hessian=exact"]).collect();
    let (plain, exact) = (run("tether-in-current", &loads), run("tether-in-current", &with));
    assert_eq!((plain.status, exact.status), (Status::Converged, Status::Converged));
    assert!((exact.analysis.value / plain.analysis.value - 1.0).abs() <= 1e-6);
    // nothing of it is made without the key
    assert_eq!(plain.model_counts.adjoint_derivatives, 0);
    assert!(exact.convergence.iter().any(|r| r.hessian == Some("exact")));
    let found = exact.exact_hessian.unwrap();
    assert!(found.smallest_eigenvalue.is_some_and(|mu| mu > 0.0), "{found:?}");
    assert!(found.sigma_change.is_some_and(|change| change > 1e-4 && change < 1.0), "{found:?}");
}

/// Beyond 3000 unknowns.
#[test]
fn the_exact_hessian_has_a_posterior_of_low_rank() {
    let sets = ["model.segments=520", "time.window=10", "report.mesh=false"];
    let with: Vec<&str> = sets.into_iter().chain(["algorithm.hessian=exact"]).collect();
    let (plain, exact) = (run("hose", &sets), run("hose", &with));
    assert!(plain.exact_hessian.is_none());
    let found = exact.exact_hessian.unwrap();
    assert!(found.smallest_eigenvalue.is_some_and(|mu| mu > 0.0 && mu <= 1.0), "{found:?}");
    assert!(found.sigma_change.is_some_and(|change| change > 0.0 && change < 0.5), "{found:?}");
    assert_eq!((found.draws, found.effective_share), (0, None));
}

#[test]
fn the_exact_hessian_is_refused_where_there_is_none() {
    let lbfgs = refused("hanging-rod-case1", &["algorithm.hessian=exact", "algorithm.minimizer=lbfgs"]);
    assert!(lbfgs.contains("algorithm.hessian") && lbfgs.contains("trust-region"), "{lbfgs}");
    let weak = refused("hanging-rod-weak", &["algorithm.hessian=exact"]);
    assert!(weak.contains("algorithm.hessian") && weak.contains("4dvar"), "{weak}");
}

#[test]
fn a_shape_without_times_has_the_exact_hessian() {
    let exact = run("wire", &["algorithm.hessian=exact"]);
    let found = exact.exact_hessian.unwrap();
    assert!(found.smallest_eigenvalue.is_some_and(|mu| mu > 0.0), "{found:?}");
    let plain = run("wire", &[]);
    // the same minimum, in fewer iterations (measured: 8 for 15)
    assert!((exact.analysis.value / plain.analysis.value - 1.0).abs() < 1e-9);
    assert!(exact.iterations[0] < plain.iterations[0], "{:?} {:?}", exact.iterations, plain.iterations);
}
