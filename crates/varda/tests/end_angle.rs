//! The angle of an end clamp, whole turns included, goes with a background file and from window to window.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use std::f64::consts::TAU;
use std::path::Path;

use rod_scene::{Folder, ROD};
use varda::outcome::CycleRow;
use varda::run::cycles::{CycleListener, Sequence};
use varda::run::simulate;
use varda::setup::Problem;
use varda_assimilation::CycleState;

/// Two clamps 45 cm apart; the end clamp turns twice a second about the rod, and says nothing of its turns.
fn scene(rest: &str) -> String {
    let clamps = r#"
[model.start]
position = [0.0, 0.0, 0.0]
tangent = [1.0, 0.0, 0.0]
director = [0.0, 0.0, 1.0]
[model.end]
motion = { kind = "pose", file = "end.csv", sigma = 0.0, sigma_angle = 0.0 }
"#;
    format!("{ROD}damping = {{ mass = 2.0 }}\n{clamps}{rest}")
}

/// One turn in half a second.
fn poses() -> String {
    let rows = (0..=110).map(|k| {
        let t = 0.01 * f64::from(k);
        let (sin, cos) = (TAU * t).sin_cos();
        format!("{t},0.45,0,0,{sin},0,0,{cos}\n")
    });
    format!("time_s,x_m,y_m,z_m,qx,qy,qz,qw\n{}", rows.collect::<String>())
}

const TWIN: &str = r#"
[background.covariance]
kind = "kernel"
sigma_x = 0.002
sigma_v = 0.02
correlation_length_x = 0.25
correlation_length_v = 0.25
localization_length = 0.5
prior = "clamp"
[observations]
kind = "synthetic"
places = [0.125, 0.25, 0.375]
every = 5
sigma = 0.001
"#;

fn folder(name: &str) -> Folder {
    Folder::new(&format!("end-angle-{name}")).with("end.csv", &poses())
}

#[test]
fn a_background_file_has_it_bit_for_bit() {
    let time = |spin_up: usize| {
        format!("[time]\nintegrator = \"bdf2\"\nstep = 0.01\nspin_up = {spin_up}\nwindow = 20\n")
    };
    let folder = folder("file");
    let from = |from: &str| format!("[background]\n{from}\n");
    let text = scene(&format!("{}{}{TWIN}", time(75), from("from = \"truth-plus-draw\"")));
    let problem = Problem::from_scene(&folder.scene(&text, &[]).unwrap()).unwrap();
    let simulation = simulate(&problem).unwrap();
    let twin = simulation.twin.as_ref().unwrap();
    // one turn and a half were driven before the window
    let driven = simulation.trajectories.analysis[simulation.trajectories.dim - 1];
    assert!((driven - 1.5 * TAU).abs() < 0.5, "{driven}");

    let out = std::env::temp_dir().join(format!("varda-end-angle-out-{}", std::process::id()));
    varda::report::write_simulation(&simulation, 0.0, &out).unwrap();
    let csv = std::fs::read_to_string(out.join("background.csv")).unwrap();
    let seen = std::fs::read_to_string(out.join("observations.csv")).unwrap();
    std::fs::remove_dir_all(&out).unwrap();
    assert!(csv.lines().next().unwrap().ends_with(",end_angle_rad"), "{csv}");

    let folder = folder.with("background.csv", &csv).with("seen.csv", &seen);
    let file = "[observations]\nkind = \"file\"\nfile = \"seen.csv\"\n";
    let covariance = TWIN.split("[observations]").next().unwrap();
    let read = |name: &str| {
        let background = from(&format!("from = \"file\"\nfile = \"{name}\""));
        let text = scene(&format!("{}{background}{covariance}{file}", time(75)));
        Problem::from_scene(&folder.scene(&text, &[]).unwrap())
    };
    let start = |problem: &Problem| {
        let mut model = problem.model();
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&problem.background, &mut x).unwrap();
        x
    };
    let again = read("background.csv").unwrap();
    let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&again.background), bits(&problem.background));
    assert_eq!(start(&again).last().unwrap().to_bits(), twin.end_angle.unwrap().to_bits());

    // without the column the turn is lost
    let short: String = csv.lines().map(|l| format!("{}\n", l.rsplit_once(',').unwrap().0)).collect();
    let folder_without = folder.with("without.csv", &short);
    let background = from("from = \"file\"\nfile = \"without.csv\"");
    let text = scene(&format!("{}{background}{covariance}{file}", time(75)));
    let without = Problem::from_scene(&folder_without.scene(&text, &[]).unwrap()).unwrap();
    let (lost, had) = (*start(&without).last().unwrap(), twin.end_angle.unwrap());
    assert!((lost - had).abs() > 3.0, "{lost} {had}");

    // it is one angle
    let two = csv.replacen(&format!(",{}\n", twin.end_angle.unwrap()), ",0.5\n", 1);
    let folder_two = folder_without.with("two.csv", &two);
    let background = from("from = \"file\"\nfile = \"two.csv\"");
    let text = scene(&format!("{}{background}{covariance}{file}", time(75)));
    let error = Problem::from_scene(&folder_two.scene(&text, &[]).unwrap()).err().unwrap().to_string();
    assert!(error.contains("it is one angle"), "{error}");
}

#[test]
fn windows_hand_it_on() {
    let text = scene(&format!(
        "[time]\nintegrator = \"bdf2\"\nstep = 0.01\nwindow = 25\n[background]\nfrom = \"truth-plus-draw\"\n\
         {TWIN}[algorithm]\nmethod = \"4dvar\"\nminimizer = \"trust-region\"\n[algorithm.cycles]\ncount = 4\n\
         shift = 25\ncovariance = \"static\"\n"
    ));
    let folder = folder("cycles");
    let sequence = Sequence::from_scene(&folder.scene(&text, &[]).unwrap()).unwrap().unwrap();
    let mut states: Vec<CycleState> = Vec::new();
    let mut listener = CycleListener::silent();
    listener.on_cycle = Box::new(|_, state| {
        states.push(state.clone());
        Ok(())
    });
    let outcome = sequence.run(sequence.start(), Vec::new(), &mut listener).unwrap();
    drop(listener);
    let runs = &outcome.trajectories;
    let last = |states: &[f64]| states[states.len() - 1];
    // two turns in a second
    assert!((last(&runs.truth) - 2.0 * TAU).abs() < 0.5, "{}", last(&runs.truth));
    assert!((last(&runs.analysis) - last(&runs.truth)).abs() < 0.2, "{}", last(&runs.analysis));

    // a run taken up after two windows, its rows read back from their text
    let stored = |row: &CycleRow| serde_json::to_string(row).unwrap();
    let done: Vec<CycleRow> =
        outcome.cycles[..2].iter().map(|r| serde_json::from_str(&stored(r)).unwrap()).collect();
    assert_eq!(
        done[1].next_end_angle.unwrap().to_bits(),
        outcome.cycles[1].next_end_angle.unwrap().to_bits()
    );
    let resumed = sequence.run(states[1].clone(), done, &mut CycleListener::silent()).unwrap();
    let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&resumed.trajectories.analysis), bits(&runs.analysis));
}

/// A rod with one clamp has no such angle and no such column.
#[test]
fn other_rods_have_no_column() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/hanging-rod-case1.toml");
    let file = varda::scene::SceneFile::open(path.to_str().unwrap(), &[]).unwrap();
    let simulation = simulate(&Problem::from_scene(&file).unwrap()).unwrap();
    assert_eq!(simulation.twin.unwrap().end_angle, None);
}
