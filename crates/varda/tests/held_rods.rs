//! Rods held anywhere, from their scenes: the shape at rest, and that they stay there.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::Folder;
use varda::run::simulate;
use varda::setup::Problem;

const REST: &str = r#"
[time]
integrator = "midpoint"
step = 0.001
window = 10
[background]
from = "static-equilibrium"
[background.covariance]
kind = "kernel"
sigma_x = 0.01
sigma_v = 0.1
correlation_length_x = 0.3
correlation_length_v = 0.3
localization_length = 0.6
prior = "clamp"
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.01
"#;

const STIFF: &str =
    r#"section = { kind = "stiffness", ea = 1e4, ei = [1e-3, 1e-3], gj = 0.8e-3, mass_per_length = 0.1 }"#;

/// Rods at rest, from their scenes in one folder.
struct Held(Folder);

impl Held {
    fn new(name: &str) -> Held {
        let seen = "time_s,s_m,x_m,y_m,z_m\n0.002,0.5,,,\n";
        Held(Folder::new(&format!("held-{name}")).with("seen.csv", seen))
    }

    fn with(self, file: &str, text: &str) -> Held {
        Held(self.0.with(file, text))
    }

    fn problem(&self, model: &str) -> Result<Problem, varda::Error> {
        Problem::from_scene(&self.0.scene(&format!("[model]\nkind = \"rod\"\n{model}{REST}"), &[])?)
    }

    fn refusal(&self, model: &str) -> String {
        self.problem(model).err().expect("this scene is wrong").to_string()
    }

    /// The vertices at rest, and how far any of them moves in the window.
    fn run(&self, model: &str) -> (Vec<[f64; 3]>, f64) {
        let shapes = simulate(&self.problem(model).unwrap()).unwrap().shapes.unwrap().analysis;
        let moved = |a: &[f64; 3], b: &[f64; 3]| distance(*a, *b);
        let most = shapes.iter().flat_map(|x| x.iter().zip(&shapes[0]).map(|(a, b)| moved(a, b)));
        (shapes[0].clone(), most.fold(0.0, f64::max))
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>().sqrt()
}

fn clamps(far: f64) -> String {
    let clamp = |end: &str, x: f64| {
        format!("{end} = {{ position = [{x}, 0, 0], tangent = [1, 0, 0], director = [0, 0, 1] }}\n")
    };
    clamp("start", 0.0) + &clamp("end", far)
}

#[test]
fn two_clamps_nearer_than_the_length_hold_a_bow_or_a_cable() {
    let folder = Held::new("clamps");
    let rod = format!("length = 1.0\nsegments = 40\n{STIFF}\n");
    let (bow, moved) = folder.run(&format!("{rod}gravity = [0, 0, 0]\n{}", clamps(0.8)));
    let height = bow.iter().map(|x| x[1].hypot(x[2])).fold(0.0, f64::max);
    // the elastica between the faces, and the mesh's error of second order
    assert!((height - 0.266293).abs() <= 4e-4, "{height}");
    assert!(moved <= 1e-9, "{moved}");
    // the paper's clamps hold edges: the rod bends between their middles, L' = 0.975 and D' = 0.775
    let edges = format!("{rod}clamp = \"edge\"\ngravity = [0, 0, 0]\n{}", clamps(0.8));
    let height = folder.run(&edges).0.iter().map(|x| x[1].hypot(x[2])).fold(0.0, f64::max);
    assert!((height - 0.26249).abs() <= 1e-3, "{height}");
    let (cable, moved) = folder.run(&format!("{rod}{}", clamps(0.5)));
    assert!(cable[20][2] < -0.3 && cable[20][1].abs() < 1e-6, "{:?}", cable[20]);
    assert!(moved <= 1e-9, "{moved}");
}

#[test]
fn a_cable_hangs_from_its_middle_and_from_three_hooks() {
    let folder = Held::new("hooks");
    let cable = r#"length = 2.0
segments = 40
section = { kind = "stiffness", ea = 1e4, ei = [1e-4, 1e-4], gj = 1e-4, mass_per_length = 0.05 }
"#;
    let (middle, moved) =
        folder.run(&format!("{cable}prescribed = [{{ vertex = 20, position = [0, 0, 1] }}]"));
    assert!(middle[0][2] < 0.3 && middle[40][2] < 0.3 && moved <= 1e-9, "{moved}");
    let hooks = "prescribed = [{ vertex = 0, position = [0, 0, 0] }, \
                 { vertex = 20, position = [0.7, 0.2, 0.1] }, \
                 { vertex = 40, position = [1.2, 0, 0] }]";
    let (three, moved) = folder.run(&format!("{cable}{hooks}"));
    assert!(three[10][2] < -0.2 && three[30][2] < -0.2 && moved <= 1e-9, "{moved}");
}

#[test]
fn an_initial_shape_picks_the_branch() {
    let rows: String = (0..=10)
        .map(|i| {
            let u = f64::from(i) / 10.0;
            format!("{u},{},0,{}\n", 0.8 * u, -0.25 * (std::f64::consts::PI * u).sin().powi(2))
        })
        .collect();
    let folder = Held::new("branch").with("down.csv", &format!("s_m,x_m,y_m,z_m\n{rows}"));
    // a ruler, soft towards z: bowed up or down
    let ruler = format!(
        "length = 1.0\nsegments = 40\ngravity = [0, 0, 0]\nsection = {{ kind = \"stiffness\", ea = 1e4, \
         ei = [1e-3, 1e-1], gj = 1e-3, mass_per_length = 0.1 }}\n{}",
        clamps(0.8)
    );
    let up = "initial_shape = { points = \
              [[0, 0, 0], [0.2, 0, 0.15], [0.4, 0, 0.3], [0.6, 0, 0.15], [0.8, 0, 0]] }";
    for (shape, side) in [(up, 1.0), ("initial_shape = { file = \"down.csv\" }", -1.0)] {
        let (bow, moved) = folder.run(&format!("{ruler}{shape}"));
        assert!(
            (side * bow[20][2] - 0.266293).abs() <= 4e-4 && moved <= 1e-9,
            "{shape}: {:?} {moved}",
            bow[20]
        );
    }
}

#[test]
fn a_rest_shape_is_the_natural_curvature_wherever_it_was_laid() {
    // an arc of radius 0.2 m on a table, laid along y, and bent towards x as seen from its first segment
    let arc = |s: f64| [0.2 - 0.2 * (5.0 * s).cos(), 0.2 * (5.0 * s).sin(), 0.7];
    let rows: String = (0..=40)
        .map(|i| f64::from(i) / 40.0)
        .map(|s| (s, arc(s)))
        .map(|(s, p)| format!("{s},{},{},{}\n", p[0], p[1], p[2]))
        .collect();
    let folder = Held::new("arc").with("arc.csv", &format!("s_m,x_m,y_m,z_m\n{rows}"));
    let rod = format!(
        "length = 1.0\nsegments = 100\n{STIFF}\ngravity = [0, 0, 0]\n\
         start = {{ position = [0, 0, 0], tangent = [1, 0, 0], director = [0, 0, 1] }}\n"
    );
    // in the clamp the arc rises towards m₁ = z
    let (found, moved) =
        folder.run(&format!("{rod}rest_shape = {{ file = \"arc.csv\", director = [1, 0, 0] }}"));
    let (tip, far) = (found[100], arc(1.0));
    assert!(
        (tip[0] - far[1]).abs() <= 5e-3 && (tip[2] - far[0]).abs() <= 5e-3 && tip[1].abs() <= 1e-3,
        "{tip:?}"
    );
    assert!(moved <= 1e-9, "{moved}");
    // as the same curvature said by numbers
    let (said, _) = folder.run(&format!("{rod}natural_curvature = [5, 0]"));
    assert!(distance(said[100], tip) <= 5e-3, "{:?} {tip:?}", said[100]);
}

/// The angles of a coil that was just found are those from which its first step starts.
#[test]
fn a_coil_stays_where_it_was_found() {
    let folder = Held::new("coil");
    let coil = format!(
        "length = 1.0\nsegments = 200\ngravity = [0, 0, 0]\n{STIFF}\n\
         natural_curvature = [30, 0]\nnatural_twist = 10\n\
         start = {{ position = [0, 0, 0], tangent = [0, 0, 1], director = [1, 0, 0] }}"
    );
    let (found, moved) = folder.run(&coil);
    let chord = distance(found[0], found[200]);
    assert!((chord - 0.31638).abs() <= 2e-3 && moved <= 1e-6, "{chord} {moved}");
}

#[test]
fn what_cannot_be_a_shape_or_holds_nothing_is_said() {
    let folder = Held::new("refused").with("far.csv", "s_m,x_m,y_m,z_m\n0,0,0,0\n1.5,1,0,0\n");
    let rod = format!("length = 1.0\nsegments = 20\n{STIFF}\n");
    let held = format!("{rod}{}", clamps(0.8));
    let cases = [
        (rod, "nothing holds the rod"),
        (format!("{held}initial_shape = {{}}"), "give `file`, or `points`"),
        (format!("{held}initial_shape = {{ points = [[0, 0, 0]] }}"), "two points or more"),
        (format!("{held}initial_shape = {{ file = \"far.csv\" }}"), "arc length 1.5 m is off the rod"),
        (
            format!("{held}natural_twist = 1\nrest_shape = {{ points = [[0, 0, 0], [1, 0, 0]] }}"),
            "leave one of them out",
        ),
        (
            format!("{held}rest_shape = {{ points = [[0, 0, 0], [1, 0, 0]], director = [0, 0, 0] }}"),
            "a direction cannot be zero",
        ),
    ];
    for (model, says) in cases {
        let message = folder.refusal(&model);
        assert!(message.contains(says), "{message}");
    }
}

#[test]
fn whole_turns_of_a_clamp_twist_a_rod_and_buckle_it() {
    let folder = Held::new("turns").with("turns.csv", "time_s,turns\n-1,0\n0,2\n1,2\n");
    let scene = |turns: &str| {
        let held = clamps(1.0);
        let held = held.strip_suffix(" }\n").expect("the end clamp is the last");
        format!("length = 1.0\nsegments = 30\n{STIFF}\ngravity = [0, 0, 0]\n{held}, turns = {turns} }}\n")
    };
    let height = |turns: &str| {
        let (shape, moved) = folder.run(&scene(turns));
        assert!(moved <= 1e-6, "{turns}: {moved}");
        shape.iter().map(|x| x[1].hypot(x[2])).fold(0.0, f64::max)
    };
    // it buckles at 8.99 EI/GJ = 11.2 rad: with two turns, from a file too; its clamps keep it from more
    assert!(height("1") <= 1e-9);
    assert!(height("2") >= 1e-5);
    assert!(height("{ file = \"turns.csv\", time_zero = 0.0 }") >= 1e-5);
    let late = folder.refusal(&scene("{ file = \"turns.csv\", time_zero = 5.0 }"));
    assert!(late.contains("model.end.turns.time_zero"), "{late}");
    let word = folder.refusal(&scene("\"two\""));
    assert!(word.contains("model.end.turns"), "{word}");
    let unknown = folder.refusal(&scene("{ name = \"turns.csv\" }"));
    assert!(unknown.contains("name"), "{unknown}");
}

/// A cantilever in a scene sinks as the beam of its free length does, its outputs begin at the face, and what
/// holds an edge is said.
#[test]
fn a_clamp_is_at_its_face_and_two_prescribed_neighbours_are_not() {
    let folder = Held::new("faces");
    let beam = "length = 1.0\nsegments = 20\ngravity = [0, 0, -9.81]\nsection = { kind = \"stiffness\", \
                ea = 1e8, ei = [1e3, 1e3], gj = 1e3, mass_per_length = 0.1 }\n";
    let start = "start = { position = [0.5, 0, 0], tangent = [1, 0, 0], director = [0, 0, 1] }\n";
    let (found, moved) = folder.run(&format!("{beam}{start}"));
    // w L⁴/8 EI, the mesh's 1.3e-3 and Newton's last update of 1e-11 m
    let sinks = 0.1 * 9.81 / 8e3;
    assert!((-found[20][2] / sinks - 1.0).abs() <= 2e-3 && moved <= 1e-9, "{:?} {moved}", found[20]);
    assert!(distance(found[0], [0.5, 0.0, 0.0]) == 0.0, "{:?}", found[0]);
    assert!((found[1][0] - 0.5 - 0.5 / 19.5).abs() <= 1e-15, "{:?}", found[1]);
    let points = "prescribed = [{ vertex = 1, position = [0.05, 0, 0] }, \
                  { vertex = 0, position = [0, 0, 0] }]\n";
    let held = folder.problem(&format!("{beam}{points}")).unwrap();
    let said =
        |p: &Problem| p.experiment.left_out.iter().any(|l| l.contains("vertices 0 and 1 hold the edge"));
    assert!(said(&held), "{:?}", held.experiment.left_out);
    let clamped = folder.problem(&format!("{beam}{start}")).unwrap();
    assert!(!said(&clamped));
    let short = format!("length = 1.0\nsegments = 2\n{STIFF}\n{}", clamps(0.8));
    assert!(folder.refusal(&short).contains("at least 3 segments"), "{}", folder.refusal(&short));
}
