//! Shapes without times, rods at rest at every step, and states that are known.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::Folder;
use varda::outcome::remarks_on_estimates;
use varda::run::{Listener, assimilate, simulate};
use varda::scene::SceneFile;
use varda::setup::Problem;

const ROD: &str = r#"
[model]
kind = "rod"
length = 0.5
segments = 10
gravity = [0.0, 0.0, -9.81]
section = { kind = "stiffness", ea = 200.0, ei = [5e-3, 5e-3], gj = 5e-3, mass_per_length = 0.1 }
"#;
const START: &str =
    "start = { position = [0.0, 0.0, 0.0], tangent = [1.0, 0.0, 0.0], director = [0.0, 0.0, 1.0] }\n";
const SEEN: &str = "[observations]\nkind = \"file\"\nfile = \"seen.csv\"\nsigma = 0.001\n";
const EI: &str = "[estimate]\nei = { sigma = \"30%\", together = true }\n";
const STATIC: &str = "[algorithm]\nmethod = \"static\"\n";
const SHAPE: &str = "s_m,x_m,y_m,z_m\n0.25,0.24,0,-0.04\n0.5,0.45,0,-0.15\n";

/// What is said of a scene and its recording.
fn refused(name: &str, scene: &str, seen: &str) -> String {
    let folder = Folder::new(&format!("shapes-{name}")).with("seen.csv", seen);
    let problem = folder.scene(scene, &[]).and_then(|file| Problem::from_scene(&file).map(|_| ()));
    problem.err().map_or("nothing".into(), |e| e.to_string())
}

#[test]
fn what_a_shape_has_not_is_named() {
    let timed = "[time]\nintegrator = \"bdf2\"\nstep = 0.01\nwindow = 10\n";
    let kernel = "[background]\nfrom = \"static-equilibrium\"\ncovariance = { kind = \"kernel\", sigma_x = \
    0.01, sigma_v = 0.1, correlation_length_x = 0.1, correlation_length_v = 0.1 }\n";
    let scene = |parts: &[&str]| [&[ROD, START, SEEN], parts].concat().concat();
    let times = "time_s,s_m,x_m,y_m,z_m\n0,0.25,0.24,0,-0.04\n";
    let damped = "[model.damping]\nstiffness = 0.01\n";
    let hook = "prescribed = [{ vertex = 0, position = [0.0, 0.0, 0.0] }]\n";
    let cases: [(&str, String, &str, &str); 11] = [
        ("right", scene(&[EI, STATIC]), SHAPE, "nothing"),
        ("times", scene(&[EI, STATIC]), times, "average the frames"),
        ("time", scene(&[EI, STATIC, timed]), SHAPE, "leave [time] out"),
        ("timeless", scene(&[EI, timed, kernel]), SHAPE, "method \"static\""),
        ("no-time", scene(&[EI]), SHAPE, "[time] is missing"),
        ("background", scene(&[EI, STATIC, kernel]), SHAPE, "leave [background] out"),
        ("nothing-unknown", scene(&[STATIC]), SHAPE, "nothing is unknown"),
        (
            "damping",
            scene(&[damped, "[estimate]\ndamping_stiffness = { sigma = \"30%\" }\n", STATIC]),
            SHAPE,
            "a rod at rest does not show it",
        ),
        ("free", [ROD, SEEN, EI, STATIC].concat(), SHAPE, "nothing holds the rod"),
        ("hung", [ROD, hook, SEEN, EI, STATIC].concat(), SHAPE, "two prescribed vertices"),
        (
            "forecast",
            scene(&[EI, STATIC, "[report]\nforecast = 1.0\n"]),
            SHAPE,
            "a shape without times has no forecast",
        ),
    ];
    for (name, scene, seen, words) in cases {
        let said = refused(name, &scene, seen);
        assert!(said.contains(words), "{name}: {said}");
    }
}

/// A clamp that a robot moves slowly: at every step the shape of a scene with the clamp there alone.
#[test]
fn a_slow_motion_is_a_row_of_shapes() {
    let motion = "time_s,x_m,y_m,z_m\n0,0,0,0\n1,0.05,0,0\n2,0.05,0.03,0.1\n3,0,0.05,0.1\n";
    let moved = START.replace(" }\n", ", motion = { kind = \"table\", file = \"clamp.csv\" } }\n");
    let end = "end = { position = [0.3, 0.0, 0.0], tangent = [1.0, 0.0, 0.2], director = [0.0, 1.0, 0.0] }\n";
    let known = "[background]\nfrom = \"static-equilibrium\"\ncovariance = { kind = \"known\" }\n";
    let slow = "[time]\nintegrator = \"quasi-static\"\nstep = 1.0\nwindow = 3\n";
    let rows = "time_s,s_m,x_m,y_m,z_m\n0,0.25,0.2,0,-0.1\n3,0.25,0.2,0.02,0.02\n";
    let folder = Folder::new("shapes-slow").with("seen.csv", rows).with("clamp.csv", motion);
    let scene = [ROD, &moved, end, SEEN, EI, known, slow].concat();
    let problem = Problem::from_scene(&folder.scene(&scene, &[]).unwrap()).unwrap();
    let shapes = simulate(&problem).unwrap().shapes.unwrap().analysis;
    let places = [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.05, 0.03, 0.1], [0.0, 0.05, 0.1]];
    for (k, place) in places.into_iter().enumerate() {
        let there = START.replace("[0.0, 0.0, 0.0]", &format!("{place:?}"));
        let alone = [ROD, &there, end, SEEN, EI, STATIC].concat();
        let at = "s_m,x_m,y_m,z_m\n0.25,0.2,0,-0.05\n";
        let folder = Folder::new(&format!("shapes-alone-{k}")).with("seen.csv", at);
        let alone = Problem::from_scene(&folder.scene(&alone, &[]).unwrap()).unwrap();
        let shape = &simulate(&alone).unwrap().shapes.unwrap().analysis[0];
        for (a, b) in shapes[k].iter().zip(shape) {
            let apart = (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>().sqrt();
            // both solve to 1e-11 of the length
            assert!(apart <= 1e-9, "step {k}: {apart:e} m");
        }
    }
    let ended = assimilate(&problem, &mut Listener::silent()).unwrap();
    assert_eq!(ended.experiment.n_unknown(), 1);
}

/// Only the forcing of Lorenz-96 is unknown: it is found, and no number of the state moves.
#[test]
fn a_known_state_stays() {
    let sets = [
        "background.covariance={kind=\"known\"}",
        "estimate.forcing={sigma=0.5}",
        "background.from=\"truth-plus-draw\"",
    ];
    let file = SceneFile::open("lorenz96", &sets.map(String::from)).unwrap();
    let problem = Problem::from_scene(&file).unwrap();
    let ended = assimilate(&problem, &mut Listener::silent()).unwrap();
    let n = ended.analysis.analysis.len();
    assert_eq!(ended.analysis.analysis[..n - 1], ended.analysis.background[..n - 1]);
    assert!(ended.analysis.sigma_analysis[..n - 1].iter().all(|s| *s == 0.0));
    let e = &ended.estimates[0];
    let (sigma, truth) = (e.sigma.unwrap(), e.truth.unwrap());
    assert!(sigma < 0.5 * e.prior_sigma, "{sigma}");
    assert!((e.value - truth).abs() < 4.0 * sigma, "{} ± {sigma}, truth {truth}", e.value);
    let nothing = SceneFile::open("lorenz96", &[String::from(sets[0])]).err().unwrap().to_string();
    assert!(nothing.contains("nothing is unknown"), "{nothing}");
}

/// A rod in a plane, its picture taken from the side: how far its clamp is turned out of the picture is seen
/// by how much shorter it looks, which is nothing to first order. σ is then the prior's; the interval is
/// not. Its direction in the picture is seen; GJ of a rod in a plane is not.
#[test]
fn what_is_bounded_but_not_to_first_order_is_identified() {
    let unknown = "[estimate]\ngj = { sigma = \"30%\" }\nclamp_direction = { sigma = 0.2 }\n";
    let scene = [ROD, START, SEEN, unknown, STATIC].concat().replace("sigma = 0.001", "sigma = 0.0003");
    let folder = Folder::new("shapes-picture").with("seen.csv", SHAPE);
    let of = |folder: &Folder| Problem::from_scene(&folder.scene(&scene, &[]).unwrap()).unwrap();
    let shape = simulate(&of(&folder)).unwrap().shapes.unwrap().analysis[0].clone();
    let (mut rows, mut s) = (String::from("s_m,x_m,y_m,z_m\n"), 0.0);
    for ends in shape.windows(2) {
        s += (0..3).map(|c| (ends[1][c] - ends[0][c]).powi(2)).sum::<f64>().sqrt();
        rows += &format!("{},{},,{}\n", f64::min(s, 0.5), ends[1][0], ends[1][2]);
    }
    let ended = assimilate(&of(&folder.with("seen.csv", &rows)), &mut Listener::silent()).unwrap();
    let found = |name: &str| ended.estimates.iter().find(|e| e.name == name).unwrap();
    let said = |name: &str| (found(name).identifiable, found(name).by_interval_alone);
    assert_eq!(said("clamp_direction[start].m1"), (Some(true), true), "{:?}", ended.estimates);
    assert_eq!(said("clamp_direction[start].m2"), (Some(true), false), "{:?}", ended.estimates);
    assert_eq!(said("gj"), (Some(false), false), "{:?}", ended.estimates);
    let out = found("clamp_direction[start].m1");
    let [low, high] = out.interval.unwrap();
    // no more than rounding of σ²: J is flat there
    assert!((out.sigma.unwrap() / out.prior_sigma - 1.0).abs() < 1e-6, "{out:?}");
    // at φ the end looks nearer by ½ φ² of 0.45 m, which is a σ at 0.04 rad and twelve at 0.13: J is
    // followed in steps of σ, and not finer; symmetric as the picture is
    assert!(low < -0.03 && (low + high).abs() < 1e-3 && high < 0.2, "{out:?}");
    assert!(out.in_words().contains("rad with 95 %, not Gaussian (prior"), "{}", out.in_words());
    let remarks = remarks_on_estimates(&ended.estimates, true);
    let says = |start: &str| remarks.iter().any(|r| r.starts_with(start));
    assert!(says("not Gaussian: clamp_direction[start].m1: J is flat"), "{remarks:?}");
    assert!(says("not identifiable: gj: "), "{remarks:?}");
}
