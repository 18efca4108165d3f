//! What `check` says of the data beside the model, and `run` before it starts.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use std::process::{Command, Output};

use rod_scene::{Folder, ROD, SEEN};
use varda::preview::{Preview, enough_segments};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

fn scene() -> String {
    let clamp =
        "[model.start]\nposition = [0.0, 0.0, 1.0]\ntangent = [0.0, 0.0, -1.0]\ndirector = [1.0, 0.0, 0.0]\n";
    format!("{ROD}{clamp}[time]\nintegrator = \"bdf2\"\nstep = 0.01\nwindow = 40\n{SEEN}")
}

/// The tip and the middle, swinging, to 0.6 s.
fn seen() -> String {
    let rows = (0..=30).map(|k| {
        let t = 0.02 * f64::from(k);
        let swing = 0.03 * (6.0 * t).sin() + 1e-3 * (7.3 * f64::from(k)).sin();
        format!("{t:.2},0.25,{:.6},0,0.75\n{t:.2},0.5,{swing:.6},0,0.502\n", 0.5 * swing)
    });
    format!("time_s,s_m,x_m,y_m,z_m\n{}", rows.collect::<String>())
}

#[test]
fn the_misfit_is_that_of_the_run() {
    let folder = Folder::new("preview-misfit").with("seen.csv", &seen());
    let file = folder.scene(&scene(), &["observations.outside_window=skip"]).unwrap();
    let preview = Preview::new(&file).unwrap();
    let outcome = assimilate(&Problem::from_scene(&file).unwrap(), &mut Listener::silent()).unwrap();
    let misfit = preview.misfit.unwrap();
    let m = outcome.analysis.observations;
    assert_eq!(misfit.values, m);
    // the same run, summed in another order
    assert!((misfit.chi2 / (2.0 * outcome.j_background / m as f64) - 1.0).abs() < 1e-12);
    let recording = preview.recording.unwrap();
    assert_eq!((recording.rows.all, recording.rows.used, recording.rows.outside), (62, 42, 20));
    assert_eq!(recording.rows.parts(), recording.rows.all);
    assert_eq!((recording.span, recording.window), ([0.0, 0.6], [0.0, 0.4]));
    let tip = &recording.tracks[1];
    assert_eq!((tip.rows, tip.gap), (31, None));
    assert!((tip.interval - 0.02).abs() < 1e-9);
    assert_eq!(recording.neighbours.len(), 1);
    assert!(preview.findings.is_empty(), "{:?}", preview.findings);
}

/// A hanging rod's frequencies are those of the hanging beam, and the mesh converges at second order.
#[test]
fn modes_and_mesh_are_measured() {
    let folder = Folder::new("preview-mesh").with("seen.csv", &seen());
    let sets = ["model.start.tangent=[1.0, 0.0, 0.0]", "model.start.director=[0.0, 0.0, 1.0]"];
    let of = |segments: usize| {
        let segments = format!("model.segments={segments}");
        let skip = "observations.outside_window=skip";
        let loose = "observations.unreachable=skip";
        let sets = [&sets[..], &[segments.as_str(), skip, loose]].concat();
        Preview::new(&folder.scene(&scene(), &sets).unwrap()).unwrap()
    };
    let [coarse, fine] = [of(10), of(20)];
    let [a, b] = [&coarse, &fine].map(|p| p.mesh.as_ref().unwrap().moves);
    // halving the mesh divides what halving it again does by four
    assert!((2.5..6.0).contains(&(a / b)), "{a} {b}");
    let frequency = |p: &Preview| p.modes[0].frequency;
    assert!((frequency(&coarse) / frequency(&fine) - 1.0).abs() < 0.02);
    assert!(fine.modes[0].numerical < 1e-2 && fine.modes[0].material == 0.0);
}

fn varda(folder: &Folder, sets: &[&str], command: &str, more: &[&str]) -> Output {
    let mut process = Command::new(env!("CARGO_BIN_EXE_varda"));
    folder.scene(&scene(), &[]).unwrap();
    process.arg(command).arg(folder.path().join("scene.toml")).args(more);
    process.args(sets.iter().flat_map(|set| ["--set", set])).current_dir(folder.path());
    process.output().unwrap()
}

#[test]
fn warnings_end_in_0_and_errors_in_1_and_run_says_the_same() {
    let folder = Folder::new("preview-command").with("seen.csv", &seen());
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).to_string();
    let skip = "observations.outside_window=skip";
    let right = varda(&folder, &[skip], "check", &[]);
    assert_eq!(right.status.code(), Some(0));
    for part in ["nothing wrong", "62 rows = 42 used + 20 outside + 0 refused", "2J/m", "steps a period"] {
        assert!(text(&right.stdout).contains(part), "{part}: {}", text(&right.stdout));
    }
    let odd = [skip, "observations.sigma=2.0"];
    let warned = varda(&folder, &odd, "check", &[]);
    assert_eq!(warned.status.code(), Some(0));
    assert!(text(&warned.stdout).contains("scene: 1 warning"), "{}", text(&warned.stdout));
    let run = varda(&folder, &odd, "run", &[]);
    let said = text(&run.stderr);
    assert!(said.contains("data: 62 rows") && said.contains("warning: observations.sigma: 2 m"), "{said}");
    let quiet = varda(&folder, &odd, "run", &["--quiet"]);
    assert!(quiet.stderr.is_empty(), "{}", text(&quiet.stderr));
    let late = [skip, "observations.time_zero=100.0"];
    let nothing = varda(&folder, &late, "check", &[]);
    assert_eq!(nothing.status.code(), Some(1));
    assert!(text(&nothing.stdout).contains("nothing is observed"), "{}", text(&nothing.stdout));
}

/// A rod that sags from a level clamp: a scene of its recording gets so many segments that `check` has
/// nothing to say of them.
#[test]
fn a_new_scene_of_a_recording_has_enough_segments() {
    let level = scene().replace("tangent = [0.0, 0.0, -1.0]", "tangent = [1.0, 0.0, 0.0]");
    let level = level.replace("director = [1.0, 0.0, 0.0]", "director = [0.0, 0.0, 1.0]");
    let none = "time_s,s_m,x_m,y_m,z_m\n0.1,0.5,,,\n0.2,0.3,0.2,0,0.9\n";
    let folder = Folder::new("preview-segments").with("seen.csv", none);
    let scene = |segments: usize| {
        let sets = [&format!("model.segments={segments}")[..], "observations.sigma=0.0005"];
        folder.scene(&level, &sets).unwrap()
    };
    let mesh = |segments: usize| Preview::new(&scene(segments)).unwrap().mesh.unwrap().moves;
    assert!(mesh(8) > 0.0005, "{}", mesh(8));
    let enough = enough_segments(&scene(8), 120).unwrap();
    assert!(mesh(enough) <= 0.0005 && enough <= 100, "{enough}: {}", mesh(enough));
    // no more than a third above what is needed, and none where there are enough
    assert!(mesh(enough * 3 / 4 - 4) > 0.0005, "{enough}");
    assert_eq!(enough_segments(&scene(enough), 120), Some(enough));
    assert_eq!(enough_segments(&scene(8), 12), Some(12));
    assert_eq!(enough_segments(&SceneFile::open("lorenz96", &[]).unwrap(), 120), None);
}
