//! Recordings with rows that cannot be true: named with their likely cause before anything runs.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::{Folder, ROD, SEEN};
use varda::Error;
use varda::scene::SceneFile;
use varda::setup::{Inputs, Plan};

const CLAMP: &str = r#"
start = { position = [0.0, 0.0, 1.0], tangent = [0.0, 0.0, -1.0], director = [1.0, 0.0, 0.0] }
[time]
integrator = "backward-euler"
step = 0.01
window = 40
"#;

const MARKERS: &str = r#"
markers = [
  { name = "middle", arc_length = 0.2 },
  { name = "tip", arc_length = 0.5, offset = [0.01, 0.0, 0.0] },
]
"#;

/// Lines of two markers of the hanging rod, ten times; what a test changes of them.
fn recording(change: impl Fn(usize, &str, [f64; 3]) -> (String, [f64; 3])) -> String {
    let mut text = String::from("time_s,marker,x_m,y_m,z_m\n");
    for k in 0..10 {
        for (marker, place) in [("middle", [0.003, 0.001, 0.8]), ("tip", [0.01, -0.002, 0.5])] {
            let (marker, [x, y, z]) = change(k, marker, place);
            text += &format!("{},{marker},{x},{y},{z}\n", 0.02 * k as f64);
        }
    }
    text
}

/// The folder is to stay while the scene is read.
fn open(name: &str, csv: &str, sets: &[&str]) -> (Folder, SceneFile) {
    let folder = Folder::new(&format!("unreachable-{name}")).with("seen.csv", csv);
    let scene = folder.scene(&format!("{ROD}{CLAMP}{SEEN}{MARKERS}"), sets).unwrap();
    (folder, scene)
}

fn refused(name: &str, csv: &str) -> String {
    match Plan::new(&open(name, csv, &[]).1) {
        Err(Error::Data { place, message }) => format!("{place}: {message}"),
        other => panic!("{name}: {:?}", other.map(|p| p.n_obs)),
    }
}

#[test]
fn the_message_names_line_value_reach_and_cause() {
    let as_it_is = |_: usize, marker: &str, place: [f64; 3]| (marker.to_string(), place);
    let plan = Plan::new(&open("clean", &recording(as_it_is), &[]).1).unwrap();
    assert_eq!(plan.n_obs, 60);

    let cases: [(&str, String, &[&str]); 6] = [
        (
            "millimetres",
            recording(|_, m, p| (m.to_string(), p.map(|v| 1e3 * v))),
            &["seen.csv:2:", "marker middle", "0.2", "20 of 20 rows", "millimetres", "x_mm"],
        ),
        (
            "axes",
            recording(|_, m, [x, y, z]| (m.to_string(), [x, z, -y])),
            &["20 of 20 rows", "Other axes?", "observations.frame", "(x, −z, y) of the file"],
        ),
        (
            "zeros",
            recording(|k, m, p| (m.to_string(), if k == 3 && m == "tip" { [0.0; 3] } else { p })),
            &["seen.csv:9:", "marker tip at time 0.06 s is 1.0000 m", "0,0,0?", "\"skip\""],
        ),
        (
            "labels",
            recording(|k, m, p| {
                let other = if m == "tip" { "middle" } else { "tip" };
                (if k == 4 { other } else { m }.to_string(), p)
            }),
            &[
                "seen.csv:10:",
                "labels exchanged: marker middle and marker tip from 0.08 s to 0.08 s",
                "lines 10 to 11",
            ],
        ),
        (
            "false",
            recording(|k, m, p| (m.to_string(), if k == 3 && m == "tip" { [0.0, 0.9, 0.5] } else { p })),
            &["seen.csv:9:", "false detection"],
        ),
        (
            "origin",
            recording(|_, m, [x, y, z]| (m.to_string(), [x + 7.0, y, z])),
            &["20 of 20 rows", "another origin"],
        ),
    ];
    for (name, csv, parts) in cases {
        let message = refused(name, &csv);
        parts.iter().for_each(|part| assert!(message.contains(part), "{name}: {part:?} is not in {message}"));
    }
}

/// A marker that jumps farther than the rod moves, and stays within reach.
#[test]
fn a_jump_is_named_with_its_speed() {
    let jump = |k: usize| if k == 6 { [0.1, 0.05, 0.9] } else { [0.0, 0.0, 0.5] };
    let csv = recording(|k, m, p| (m.to_string(), if m == "tip" { jump(k) } else { p }));
    let message = refused("jump", &csv);
    let parts =
        ["seen.csv:15:", "marker tip at time 0.12 s", "(0.1, 0.05, 0.9)", "(line 13)", "20.", "five times"];
    for part in parts {
        assert!(message.contains(part), "{part:?} is not in {message}");
    }
    let (_folder, stated) = open("stated", &csv, &["observations.max_speed=25.0"]);
    assert_eq!(Plan::new(&stated).unwrap().n_obs, 60);
    let skipped = Plan::new(&open("skipped", &csv, &["observations.unreachable=skip"]).1).unwrap();
    let listed = skipped.left_out.iter().any(|l| l.starts_with("rows that jump, in lines 15:"));
    assert!(skipped.n_obs == 57 && listed);
}

#[test]
fn units_in_the_header_cure_it() {
    let csv = recording(|_, m, p| (m.to_string(), p.map(|v| 1e3 * v)));
    let csv = csv.replace("x_m,y_m,z_m", "x_mm,y_mm,z_mm");
    let inputs = Inputs::read(&open("header", &csv, &[]).1).unwrap();
    assert!((inputs.observed.seen[1].values[2].unwrap() - 0.5).abs() < 1e-15);
}

#[test]
fn what_is_skipped_is_listed_and_a_simulation_needs_no_recording() {
    let csv = recording(|k, m, p| (m.to_string(), if k % 5 == 3 && m == "tip" { [0.0; 3] } else { p }));
    let plan = Plan::new(&open("skip", &csv, &["observations.unreachable=skip"]).1).unwrap();
    assert_eq!(plan.n_obs, 54);
    let listed = plan.left_out.iter().any(|l| l.contains("in lines 9, 19:") && l.contains("0,0,0"));
    assert!(listed, "{:?}", plan.left_out);
    let inputs = Inputs::for_simulation(&open("simulated", &csv, &[]).1).unwrap();
    assert!(inputs.fault_of_observations.is_some() && inputs.observed.seen.is_empty());
}

#[test]
fn a_coordinate_that_was_not_seen_condemns_nothing() {
    let csv = recording(|_, m, p| (m.to_string(), p)).replace(",0.5\n", ",\n");
    assert_eq!(Plan::new(&open("partly", &csv, &[]).1).unwrap().n_obs, 50);
}

#[test]
fn rows_that_repeat_another_count_once() {
    let once = recording(|_, m, p| (m.to_string(), p));
    let twice = format!("{once}{}", once.split_once('\n').unwrap().1);
    let plan = Plan::new(&open("twice", &twice, &[]).1).unwrap();
    assert_eq!(plan.n_obs, 60);
    assert!(plan.left_out.iter().any(|l| l.starts_with("20 rows that repeat")), "{:?}", plan.left_out);
}

/// A recording at 240 Hz, a row a step, written to microseconds, to milliseconds and as it is: every value
/// falls into a window, where windows of four steps tile the time. Times off the steps do not, and that is
/// said.
#[test]
fn rounded_times_lose_no_value_between_windows() {
    let sets = ["time.step=0.004166666666666667", "time.window=3", "algorithm.cycles.count=5"];
    let sets = [&sets[..], &["algorithm.cycles.shift=4", "observations.outside_window=skip"]].concat();
    let values = |name: &str, time: &dyn Fn(usize) -> String| {
        let mut text = String::from("time_s,s_m,x_m,y_m,z_m\n");
        for k in 0..20 {
            text += &format!("{},0.5,0.001,0,0.5\n", time(k));
        }
        let folder = Folder::new(&format!("rounded-{name}")).with("seen.csv", &text);
        let scene = folder.scene(&format!("{ROD}{CLAMP}{SEEN}"), &sets).unwrap();
        let sequence = varda::run::cycles::Sequence::from_scene(&scene).unwrap().unwrap();
        sequence.values()
    };
    let step = 1.0 / 240.0;
    assert_eq!(values("whole", &|k| (step * k as f64).to_string()), [60, 0]);
    assert_eq!(values("micro", &|k| format!("{:.6}", step * k as f64)), [60, 0]);
    assert_eq!(values("milli", &|k| format!("{:.3}", step * k as f64)), [60, 0]);
    // A millionth of a second after the steps, to nine digits: those after the last steps of windows
    // are lost.
    let [inside, between] = values("late", &|k| format!("{:.9}", step * k as f64 + 1e-6));
    assert_eq!((inside + between, between), (60, 12), "4 windows before the last end with a value");
}
