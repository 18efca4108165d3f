//! Supports whose place and directions follow a recording: poses, and markers of the observation file.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::{Folder, NOTHING, ROD, SEEN};
use varda::setup::Inputs;
use varda::setup::system::System;
use varda_rod::{Quaternion, UnitQuaternion, Vector3};

fn scene() -> String {
    let clamp = "[model.start]\nmotion = { kind = \"pose\", file = \"base.csv\" }\n";
    format!("{ROD}{clamp}[time]\nintegrator = \"midpoint\"\nstep = 0.01\nwindow = 40\n{SEEN}")
}

fn inputs(name: &str, base: &str, seen: &str, sets: &[&str]) -> Result<Inputs, varda::Error> {
    let folder = Folder::new(&format!("pose-{name}")).with("base.csv", base).with("seen.csv", seen);
    Inputs::read(&folder.scene(&scene(), sets)?)
}

const AT: f64 = 0.237;

/// Place, tangent and director at [`AT`].
fn clamp(inputs: &Inputs) -> [Vector3<f64>; 3] {
    let System::Rod(rod) = &inputs.system else { panic!("a rod") };
    let clamp = rod.parts.supports.start.as_ref().unwrap();
    [&clamp.position, &clamp.tangent, &clamp.director].map(|motion| motion.at(AT))
}

fn place(t: f64) -> Vector3<f64> {
    Vector3::new(0.1 * t, 0.2 * t * t, 1.0 - 0.3 * t)
}

/// Local x points down at first and then swings and spins.
fn turn(t: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 1.5 + 0.8 * t)
        * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 3.0 * t * t)
}

fn row(time: f64, place: Vector3<f64>, q: Quaternion<f64>) -> String {
    format!("{time},{},{},{},{},{},{},{}\n", place.x, place.y, place.z, q.i, q.j, q.k, q.w)
}

const HEADER: &str = "time_s,x_m,y_m,z_m,qx,qy,qz,qw\n";

fn poses(of: impl Fn(usize, f64) -> String) -> String {
    let rows: String = (0..=40).map(|k| of(k, 0.01 * k as f64)).collect();
    format!("{HEADER}{rows}")
}

/// Splines of rows 0.01 s apart.
fn same(found: [Vector3<f64>; 3], expected: [Vector3<f64>; 3]) {
    for (a, b) in found.iter().zip(&expected) {
        assert!((a - b).norm() < 1e-6, "{found:?} {expected:?}");
    }
}

fn expected() -> [Vector3<f64>; 3] {
    [place(AT), turn(AT) * Vector3::x(), turn(AT) * Vector3::z()]
}

#[test]
fn clock_axes_signs_and_meaning_of_poses_are_said() {
    // Every third quaternion has the other sign.
    let sign = |k: usize, q: Quaternion<f64>| if k % 3 == 1 { -q } else { q };
    let plain = poses(|k, t| row(t, place(t), sign(k, turn(t).into_inner())));
    same(clamp(&inputs("plain", &plain, NOTHING, &[]).unwrap()), expected());

    // The model's axes are the file's turned by Q and displaced.
    let q = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.7);
    let shift = Vector3::new(1.0, 2.0, 3.0);
    let other =
        poses(|_, t| row(100.0 + t, q.inverse() * (place(t) - shift), (q.inverse() * turn(t)).into_inner()));
    let sets = [
        "model.start.motion.time_zero=100.0",
        "model.start.motion.frame.axis=[0.0,0.0,1.0]",
        "model.start.motion.frame.angle=0.7",
        "model.start.motion.frame.translation=[1.0,2.0,3.0]",
    ];
    same(clamp(&inputs("framed", &other, NOTHING, &sets).unwrap()), expected());

    // A tracker whose y is the tangent and whose x is against m₁, mounted beside the face.
    let axes = UnitQuaternion::from_matrix(&matrix_of_columns([-Vector3::z(), Vector3::x(), -Vector3::y()]));
    let lever = Vector3::new(0.02, -0.01, 0.03);
    let mounted = poses(|_, t| {
        let body = turn(t) * axes;
        row(t, place(t) - body * lever, body.into_inner())
    });
    let sets = [
        "model.start.motion.tangent_axis=[0.0,1.0,0.0]",
        "model.start.motion.director_axis=[-1.0,0.0,0.0]",
        "model.start.motion.offset=[0.02,-0.01,0.03]",
    ];
    same(clamp(&inputs("mounted", &mounted, NOTHING, &sets).unwrap()), expected());

    // A body whose axes mean nothing: the clamp's keys say where it is at model time 0.
    let [p, t, d] = [place(0.0), turn(0.0) * Vector3::x(), turn(0.0) * Vector3::z()];
    let keys = [("position", p), ("tangent", t), ("director", d)]
        .map(|(key, v)| format!("model.start.{key}=[{:?},{:?},{:?}]", v.x, v.y, v.z));
    let mut sets: Vec<&str> = keys.iter().map(String::as_str).collect();
    sets.push("model.start.motion.values=displacement");
    same(clamp(&inputs("displaced", &mounted, NOTHING, &sets).unwrap()), expected());
}

fn matrix_of_columns(columns: [Vector3<f64>; 3]) -> varda_rod::Matrix3<f64> {
    varda_rod::Matrix3::from_columns(&columns)
}

#[test]
fn what_is_wrong_with_a_pose_is_named_with_its_line() {
    let good = |_: usize, t: f64| row(t, place(t), turn(t).into_inner());
    let refused = |name: &str, base: &str, sets: &[&str], parts: &[&str]| {
        let message = inputs(name, base, NOTHING, sets).map(|_| ()).unwrap_err().to_string();
        parts.iter().for_each(|part| assert!(message.contains(part), "{name}: {part:?} not in {message}"));
    };
    let with = |at: usize, text: &str| poses(|k, t| if k == at { text.to_string() } else { good(k, t) });
    refused("scaled", &with(3, "0.03,0,0,1,0,0,0,0.5\n"), &[], &["base.csv:5", "has length 0.5"]);
    refused("half", &with(3, "0.03,0,0,1,0.1,,0,1\n"), &[], &["base.csv:5", "`qy` is empty"]);
    refused(
        "turned",
        &with(3, "0.03,0,0,1,1,0,0,0\n"),
        &[],
        &["base.csv:5", "a quarter turn", "qw the last"],
    );
    refused(
        "late",
        &poses(|k, t| good(k, t + 0.2)),
        &[],
        &["needs 0 to 0.4 s", "model.start.motion.time_zero"],
    );
    let plain = poses(good);
    refused("twice", &plain, &["model.start.tangent=[0.0,0.0,-1.0]"], &["leave `tangent` out"]);
    let across = ["model.start.motion.director_axis=[2.0,0.0,0.0]"];
    refused("along", &plain, &across, &["m₁ lies across the rod"]);
    let both = ["model.start.motion.sigma=1e-4", "model.start.motion.cutoff=10.0"];
    refused("both", &plain, &both, &["`cutoff`, or a `sigma`"]);
    refused("absent", &plain, &["model.start.motion.values=displacement"], &["needs the key `position`"]);
}

#[test]
fn a_gap_is_drawn_across_and_said() {
    let gap = poses(|k, t| {
        if (10..20).contains(&k) { format!("{t},,,,,,,\n") } else { row(t, place(t), turn(t).into_inner()) }
    });
    let inputs = inputs("gap", &gap, NOTHING, &[]).unwrap();
    let System::Rod(rod) = &inputs.system else { panic!("a rod") };
    let told = rod.parts.remarks.iter().any(|r| r.contains("no rows from 0.09 to 0.2 s"));
    assert!(told, "{:?}", rod.parts.remarks);
}

/// A recording of markers, in local axes of the body, and of one on the rod.
fn markers(local: &[(&str, [f64; 3])], lost: impl Fn(usize, usize) -> bool) -> String {
    let mut text = "time_s,marker,x_m,y_m,z_m\n".to_string();
    for k in 0..=40 {
        let t = 0.01 * k as f64;
        for (i, (name, own)) in local.iter().enumerate().filter(|(i, _)| !lost(k, *i)) {
            let _ = i;
            let seen = place(t) + turn(t) * Vector3::from(*own);
            text += &format!("{},{name},{},{},{}\n", 7.0 + t, seen.x, seen.y, seen.z);
        }
    }
    text + "7.1,tip,,,\n"
}

const FOLLOWED: [&str; 3] = [
    "observations.time_zero=7.0",
    "observations.markers=[{name=\"tip\",arc_length=0.5}]",
    "model.start.motion={kind=\"markers\",names=[\"a\",\"b\",\"c\",\"d\"],sigma=0.0}",
];

#[test]
fn markers_of_the_observation_file_carry_a_clamp() {
    let local =
        [("a", [0.0; 3]), ("b", [0.05, 0.0, 0.0]), ("c", [0.02, 0.0, 0.04]), ("d", [0.01, 0.03, 0.02])];
    // Any one of them may be lost.
    let seen = markers(&local, |k, i| k % 5 == 1 && k % 4 == i);
    let found = inputs("four", HEADER, &seen, &FOLLOWED).unwrap();
    same(clamp(&found), expected());
    assert!(found.observed.left_out.iter().any(|l| l.ends_with("rows of markers that move a support")));

    let three =
        "model.start.motion={kind=\"markers\",names=[\"a\",\"b\",\"c\"],sigma=0.0,offset=[0.01,0.02,0.03]}";
    let found = clamp(
        &inputs("offset", HEADER, &seen, &[FOLLOWED[0], FOLLOWED[1], three, "observations.ignore=[\"d\"]"])
            .unwrap(),
    );
    // m₁, m₂ = t × m₁, t.
    let [p, t, d] = expected();
    same(found, [p + d * 0.01 + t.cross(&d) * 0.02 + t * 0.03, t, d]);

    let [p, t, d] = [place(0.0), turn(0.0) * Vector3::x(), turn(0.0) * Vector3::z()];
    let keys = [("position", p), ("tangent", t), ("director", d)]
        .map(|(key, v)| format!("model.start.{key}=[{:?},{:?},{:?}]", v.x, v.y, v.z));
    let moved =
        "model.start.motion={kind=\"markers\",names=[\"d\",\"c\",\"b\"],sigma=0.0,values=\"displacement\"}";
    let mut sets = vec![FOLLOWED[0], FOLLOWED[1], moved, "observations.ignore=[\"a\"]"];
    sets.extend(keys.iter().map(String::as_str));
    same(clamp(&inputs("moved", HEADER, &seen, &sets).unwrap()), expected());

    let one = "model.start={tangent=[0.0,0.0,-1.0],director=[1.0,0.0,0.0],motion={kind=\"markers\",\
               names=[\"a\"],sigma=0.0}}";
    let found = clamp(
        &inputs(
            "one",
            HEADER,
            &seen,
            &[FOLLOWED[0], FOLLOWED[1], one, "observations.ignore=[\"b\",\"c\",\"d\"]"],
        )
        .unwrap(),
    );
    same(found, [place(AT), -Vector3::z(), Vector3::x()]);
}

#[test]
fn two_markers_give_a_tangent_that_does_not_spin() {
    let local = [("a", [0.0; 3]), ("b", [0.05, 0.0, 0.0])];
    let seen = markers(&local, |_, _| false);
    let two = "model.start={director=[0.0,1.0,0.0],motion={kind=\"markers\",names=[\"a\",\"b\"],sigma=0.0}}";
    let [p, t, d] = clamp(&inputs("two", HEADER, &seen, &[FOLLOWED[0], FOLLOWED[1], two]).unwrap());
    let [place, tangent, _] = expected();
    // The tangent swings about y.
    assert!((p - place).norm() < 1e-6 && (t.normalize() - tangent).norm() < 1e-6);
    assert!((d - Vector3::y()).norm() < 1e-6, "{d}");
}

#[test]
fn markers_that_cannot_carry_a_clamp_are_named() {
    let refused = |name: &str, local: &[(&str, [f64; 3])], sets: &[&str], parts: &[&str]| {
        let seen = markers(local, |_, _| false);
        let all: Vec<&str> = FOLLOWED.iter().chain(sets).copied().collect();
        let message = inputs(name, HEADER, &seen, &all).map(|_| ()).unwrap_err().to_string();
        parts.iter().for_each(|part| assert!(message.contains(part), "{name}: {part:?} not in {message}"));
    };
    let [a, b, c] = [("a", [0.0; 3]), ("b", [0.05, 0.0, 0.0]), ("c", [0.02, 0.0, 0.04])];
    refused("missing", &[a, b, c], &[], &["has no marker \"d\""]);
    let line = ["model.start.motion.names=[\"a\",\"b\",\"d\"]"];
    refused("line", &[a, b, c, ("d", [0.02, 0.0, 0.0])], &line, &["a, b, d lie on a line"]);
    let same = ["model.start.motion.names=[\"a\",\"b\",\"a\"]"];
    refused("same", &[a, b, c], &same, &["marker \"a\" is named twice"]);
    let tip = ["model.start.motion.names=[\"a\",\"b\",\"tip\"]"];
    refused("tip", &[a, b, c], &tip, &["marker \"tip\" moves a support"]);
}

#[test]
fn noise_of_poses_is_taken_off_and_said() {
    let mut state = 7_u64;
    let mut noise = || {
        let mut uniform = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    };
    let mut error = |sigma: f64| Vector3::new(noise(), noise(), noise()) * sigma;
    let rows: Vec<String> = (0..=200)
        .map(|k| {
            let t = 0.002 * f64::from(k);
            let rotation = turn(t) * UnitQuaternion::new(error(1e-3));
            row(t, place(t) + error(1e-4), rotation.into_inner())
        })
        .collect();
    let base = format!("{HEADER}{}", rows.concat());
    for (name, sets) in [
        ("found", vec![]),
        ("given", vec!["model.start.motion.sigma=1e-4", "model.start.motion.sigma_angle=1e-3"]),
        ("chosen", vec!["model.start.motion.cutoff=12.0"]),
    ] {
        let inputs = inputs(name, &base, NOTHING, &sets).unwrap();
        let [p, t, d] = clamp(&inputs);
        let [place, tangent, director] = expected();
        // 201 rows, half a second: what is left is a small share of σ.
        assert!((p - place).norm() < 8e-5, "{name} {}", (p - place).norm());
        assert!((t - tangent).norm() < 8e-4 && (d - director).norm() < 8e-4, "{name}");
        let System::Rod(rod) = &inputs.system else { panic!("a rod") };
        for what in ["jitter of the recorded motion", "jitter of the recorded rotation"] {
            assert!(rod.parts.remarks.iter().any(|r| r.starts_with(what)), "{name}: {:?}", rod.parts.remarks);
        }
    }
}
