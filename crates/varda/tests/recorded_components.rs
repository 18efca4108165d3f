//! Observations of models that are not rods, read from files: components and places on a line.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use std::fmt::Write;

use rod_scene::Folder;
use varda::preview::Preview;
use varda::run::{Listener, assimilate};
use varda::scene::{SceneFile, shipped_scene};
use varda::setup::{Inputs, Plan, Problem};

const RING: &str = r#"
[model]
kind = "lorenz96"
variables = 8
[time]
integrator = "rk4"
step = 0.025
window = 8
[background]
from = "file"
file = "first.csv"
covariance = { kind = "diagonal", sigma = 1.0 }
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.4
"#;

const FIELD: &str = r#"
[model]
kind = "burgers"
points = 30
length = 2.0
viscosity = 0.05
fixed_ends = [0.5, -0.25]
[time]
integrator = "midpoint"
step = 0.01
window = 20
[background]
from = "truth-plus-draw"
covariance = { kind = "line", sigma = 0.1, correlation_length = 0.3 }
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.01
"#;

fn first(values: &[f64]) -> String {
    let rows = values.iter().enumerate().map(|(i, v)| format!("{i},{v:e}\n"));
    format!("component,value\n{}", rows.collect::<String>())
}

fn ring(name: &str, seen: &str) -> Folder {
    let x: Vec<f64> = (0..8).map(|i| 4.0 * f64::from(i as u32).sin()).collect();
    Folder::new(&format!("components-{name}")).with("first.csv", &first(&x)).with("seen.csv", seen)
}

/// A twin's values and background, written to files, give the twin's J.
#[test]
fn a_file_is_what_a_twin_draws() {
    let twin = Problem::from_scene(&SceneFile::open("lorenz96", &[]).unwrap()).unwrap();
    let mut csv = String::from("time_s,component,value,sigma\n");
    let grid = twin.experiment.grid;
    // in reverse: rows may stand in any order
    for (i, seen) in twin.observed.seen.iter().enumerate().rev() {
        let label = &twin.observed.sites[seen.site].label;
        let name = if i % 2 == 0 { label.clone() } else { label[1..].to_string() };
        let _ = writeln!(csv, "{},{name},{:e},0.4", grid.time(seen.step), seen.values[0].unwrap());
    }
    let folder = Folder::new("components-twin").with("first.csv", &first(&twin.background));
    let folder = folder.with("seen.csv", &csv);
    let text = shipped_scene("lorenz96").unwrap();
    let (head, _) = text.text.split_once("[background]").unwrap();
    let (_, tail) = RING.split_once("[background]").unwrap();
    let scene = folder.scene(&format!("{head}[background]{tail}"), &[]).unwrap();
    let problem = Problem::from_scene(&scene).unwrap();
    let mut by_file = problem.observed.seen.clone();
    by_file.sort_by_key(|s| (s.step, s.site));
    assert_eq!(by_file, twin.observed.seen);
    let j = |problem: &Problem| assimilate(problem, &mut Listener::silent()).unwrap().analysis.value;
    // the same problem up to the order of the rows of H
    let (of_twin, of_file) = (j(&twin), j(&problem));
    assert!((of_twin - of_file).abs() <= 1e-12 * of_twin, "{of_twin} {of_file}");
    // and check says what it read
    let preview = Preview::new(&scene).unwrap();
    let recording = preview.recording.unwrap();
    assert_eq!(recording.rows.to_string(), "80 rows = 80 used + 0 outside + 0 refused");
    assert_eq!((recording.tracks.len(), recording.tracks[3].label.as_str()), (20, "x6"));
    assert!(preview.misfit.unwrap().chi2 > 2.0);
}

#[test]
fn rows_are_accounted_for() {
    let seen = "time_s;component;value\n0,05;x1;1,5\n0,1;3;-2,0\n0,05;1;1,5\n0,1;x4;\n0,9;2;1,0\n0,21;2;1\n";
    let scene =
        |sets: &[&str]| ring("rows", seen).scene(RING, sets).map(|s| Inputs::read(&s).map(|i| i.observed));
    let skip = "observations.outside_window=skip";
    let observed = scene(&[skip]).unwrap().unwrap();
    let recording = observed.recording.clone().unwrap();
    let rows = recording.rows;
    assert_eq!((rows.all, rows.parts()), (6, 6));
    assert_eq!((rows.used, rows.repeated, rows.empty, rows.outside), (2, 1, 1, 2), "{rows}");
    // 0.21 s is 8.4 steps: in the forecast, where there is one
    let observed = scene(&[skip, "report.forecast=0.1"]).unwrap().unwrap();
    let rows = observed.recording.unwrap().rows;
    assert_eq!((rows.outside, rows.forecast, rows.parts()), (1, 1, rows.all));
    let message = match scene(&[]).unwrap() {
        Err(error) => error.to_string(),
        Ok(_) => panic!("a row outside is an error unless it is skipped"),
    };
    assert!(message.contains("seen.csv:6") && message.contains("outside_window"), "{message}");
}

#[test]
fn what_cannot_be_is_named_with_its_line_and_cause() {
    let field = FIELD;
    let cases: [(&str, &str, &[&str]); 10] = [
        (RING, "time_s,component,value\n0.1,8,1\n", &["seen.csv:2", "component 8", "0 to 7", "from 0"]),
        (RING, "time_s,component,value\n0.1,x9,1\n", &["seen.csv:2", "\"x9\"", "x0 to x7"]),
        (RING, "time_s,component,value\n0.1,,1\n", &["seen.csv:2", "`component` is empty"]),
        (RING, "time_s,s_m,value\n0.1,1,1\n", &["seen.csv:2", "no line", "`component`"]),
        (RING, "time_s,x_m,value\n0.1,1,1\n", &["seen.csv:1", "unknown column"]),
        (RING, "time_s,value\n0.1,1\n", &["seen.csv:1", "neither `component` nor `s_m`"]),
        (RING, "time_s,component,value,sigma\n0.1,1,1,0\n", &["seen.csv:2", "greater than 0"]),
        (RING, "time_s,component,value\n150,1,1\n", &["seen.csv:2", "outside the window", "time_ms"]),
        (field, "time_s,s_m,value\n0.1,1500,1\n", &["seen.csv:2", "off the line (0 to 2 m)", "s_mm"]),
        (field, "time_s,s_m,value\n0.1,1,nan\n", &["seen.csv:2", "`value` is NaN"]),
    ];
    for (i, (text, seen, words)) in cases.into_iter().enumerate() {
        let folder = ring(&format!("bad-{i}"), seen);
        let message = match folder.scene(text, &[]).and_then(|scene| Plan::new(&scene)) {
            Err(error) => error.to_string(),
            Ok(plan) => panic!("{seen}: {} values", plan.n_obs),
        };
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    }
    let folder = ring("keys", "time_s,component,value\n0.1,1,1\n");
    for key in ["max_speed=1.0", "unreachable=skip", "ignore=[\"tip\"]"] {
        let message = folder.scene(RING, &[&format!("observations.{key}")]).unwrap_err().to_string();
        assert!(message.contains("is about rods"), "{message}");
    }
    let message = folder.scene(RING, &["observations.sigma=50.0"]).map(|s| Preview::new(&s).unwrap());
    assert_eq!(message.unwrap().findings[0].place, "observations.sigma");
}

/// Places between the points of a line: the analysis is near the field that was seen there, and the given
/// ends count.
#[test]
fn places_on_a_line_are_between_its_points() {
    let folder = ring("line", "time_s,s_m,value\n0.1,1,0\n");
    let truth = {
        let scene = folder.scene(FIELD, &[]).unwrap();
        Problem::from_scene(&scene).unwrap().truth.unwrap()
    };
    let mut csv = String::from("time_ms,s_cm,value\n");
    // an independent reading of the field: the quadratic through the three nearest of 32 nodes
    let node = |i: usize| match i {
        0 => 0.5,
        31 => -0.25,
        i => truth[i - 1],
    };
    let h = 2.0 / 31.0;
    for place in (0..41).map(|i| 0.05 * f64::from(i)) {
        let i = ((place / h).round() as usize).clamp(1, 30);
        let t = place / h - i as f64;
        let (a, b, c) = (node(i - 1), node(i), node(i + 1));
        let value = b + 0.5 * t * (c - a) + 0.5 * t * t * (a - 2.0 * b + c);
        let _ = writeln!(csv, "0,{:.6},{value:.9}", 100.0 * place);
    }
    let folder = ring("line", &csv);
    let scene = folder.scene(FIELD, &["observations.sigma=0.001"]).unwrap();
    let problem = Problem::from_scene(&scene).unwrap();
    assert_eq!(problem.observed.sites.len(), 41);
    let outcome = assimilate(&problem, &mut Listener::silent()).unwrap();
    let analysis = &outcome.analysis.analysis;
    let rms = |x: &[f64]| {
        (x.iter().zip(&truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / truth.len() as f64).sqrt()
    };
    // the background is off by some 0.1; three points and four differ by h³u‴/15 = 2e-4 here
    assert!(rms(&problem.background) > 0.03, "{}", rms(&problem.background));
    assert!(rms(analysis) < 1e-3, "{}", rms(analysis));
}
