//! Twist inertia in scenes: keys, unknowns, files, modes.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::Folder;
use varda::report;
use varda::run::{Listener, assimilate, modes, simulate};
use varda::scene::SceneFile;
use varda::setup::{Inputs, Problem};
use varda_implicit::{At, ObservationOperator};
use varda_rod::{Marker, Markers};

/// Between two clamps, the far one turned; seen through markers beside the centreline.
const MODEL: &str = r#"
[model]
kind = "rod"
length = 0.5
segments = 8
twist_inertia = true
gravity = [0.0, 0.0, 0.0]
section = { kind = "circle", radius = 0.02 }
material = { youngs_modulus = 1e5, poisson_ratio = 0.5, density = 1100.0 }
[model.start]
position = [0.0, 0.0, 0.0]
tangent = [1.0, 0.0, 0.0]
director = [0.0, 0.0, 1.0]
[model.end]
position = [0.5, 0.0, 0.0]
tangent = [1.0, 0.0, 0.0]
director = [0.0, 0.0, 1.0]
turns = 0.1
[time]
integrator = "bdf2"
step = 0.002
window = 30
"#;

const PRIOR: &str = r#"
[background.covariance]
kind = "kernel"
sigma_x = 0.001
sigma_v = 0.01
sigma_theta = 0.2
sigma_spin = 20.0
correlation_length_x = 0.25
correlation_length_v = 0.25
localization_length = 0.5
prior = "clamp"
"#;

const TWIN: &str = r#"
[background]
from = "truth-plus-draw"
[observations]
kind = "synthetic"
sigma = 0.0005
every = 2
places = [0.1, 0.3]
"#;

const MARKERS: &str = r#"
[background]
from = "static-equilibrium"
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.0005
markers = [
    { name = "a", arc_length = 0.15, offset = [0.02, 0.0, 0.0] },
    { name = "b", arc_length = 0.33, offset = [0.0, 0.02, 0.0] },
]
"#;

fn twin() -> String {
    format!("{MODEL}{TWIN}{PRIOR}")
}

fn scene(name: &str, text: &str) -> (Folder, Result<SceneFile, varda::Error>) {
    let folder = Folder::new(&format!("spin-{name}"));
    let file = folder.scene(text, &[]);
    (folder, file)
}

/// The lowest mode of twist, let go with a spin and seen by two markers beside the centreline: a background
/// at rest becomes that motion.
#[test]
fn angles_and_spins_are_found_where_they_have_sigmas() {
    let folder = Folder::new("spin-found").with("seen.csv", "time_s,marker,x_m,y_m,z_m\n0.01,a,,,\n");
    let text = format!("{MODEL}{MARKERS}{PRIOR}");
    let problem = Problem::from_scene(&folder.scene(&text, &[]).unwrap()).unwrap();
    let layout = &problem.experiment.state;
    let groups: Vec<_> = layout.groups.iter().map(|g| (g.name, g.range.len())).collect();
    // vertices 2 to 6 and edges 1 to 6 move
    assert_eq!(groups, [("position", 15), ("velocity", 15), ("angle", 6), ("spin", 6)]);
    // at rest with a tenth of a turn inserted: angles in equilibrium, linear between the clamps' faces
    let inserted = 0.1 * std::f64::consts::TAU;
    for (f, angle) in problem.background[30..36].iter().enumerate() {
        assert!((angle - inserted * (f + 1) as f64 / 7.0).abs() < 1e-9, "edge {}: {angle}", f + 1);
    }
    assert!(problem.background[36..].iter().all(|spin| *spin == 0.0));

    let mut truth = problem.background.clone();
    for f in 0..6 {
        let mode = (std::f64::consts::PI * (f + 1) as f64 / 7.0).sin();
        truth[30 + f] += 0.3 * mode;
        truth[36 + f] += 15.0 * mode;
    }
    let folder = folder.with("seen.csv", &seen_from(&problem, &truth));
    let problem = Problem::from_scene(&folder.scene(&text, &[]).unwrap()).unwrap();
    let found = assimilate(&problem, &mut Listener::silent()).unwrap().analysis.analysis;
    let [before, after] = [&problem.background, &found].map(|z| layout.rms_difference(z, &truth));
    for (i, group) in layout.groups.iter().enumerate().skip(2) {
        // two markers see the lowest modes, and this is the lowest
        assert!(after[i] < 0.1 * before[i], "{}: {} to {}", group.name, before[i], after[i]);
    }
}

/// The recording of both markers in the run from a control.
fn seen_from(problem: &Problem, control: &[f64]) -> String {
    let dynamics = problem.system.rod().unwrap().parts.dynamics().unwrap();
    let marker = |s, offset: [f64; 3]| Marker { s, offset: offset.into() };
    let places = [marker(0.15, [0.02, 0.0, 0.0]), marker(0.33, [0.0, 0.02, 0.0])];
    let mut markers = Markers::new(&dynamics, &places).unwrap();
    let mut model = problem.model();
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(control, &mut x).unwrap();
    let (mut seen, mut y) = ("time_s,marker,x_m,y_m,z_m\n".to_string(), [0.0; 6]);
    for k in 0..30 {
        model.step(k, &x, &mut next).unwrap();
        std::mem::swap(&mut x, &mut next);
        let time = 0.002 * (k + 1) as f64;
        markers.observe(At { step: k + 1, time }, &x, &mut y).unwrap();
        for (name, p) in ["a", "b"].into_iter().zip(y.chunks_exact(3)) {
            seen += &format!("{time},{name},{},{},{}\n", p[0], p[1], p[2]);
        }
    }
    seen
}

/// A background of angles and spins that a simulation wrote is read again, to the same bits.
#[test]
fn a_background_with_angles_and_spins_reads_back() {
    let (folder, file) = scene("background", &twin());
    let file = file.unwrap();
    let problem = Problem::from_scene(&file).unwrap();
    let out = std::env::temp_dir().join(format!("varda-spin-out-{}", std::process::id()));
    let written = report::write_simulation(&simulate(&problem).unwrap(), 0.0, &out).unwrap();
    let table = std::fs::read_to_string(written.join("background.csv")).unwrap();
    std::fs::remove_dir_all(&out).unwrap();
    let folder =
        folder.with("background.csv", &table).with("seen.csv", "time_s,s_m,x_m,y_m,z_m\n0.01,0.2,,,\n");
    let text = format!(
        "{MODEL}[background]\nfrom = \"file\"\nfile = \"background.csv\"\n{PRIOR}\
         [observations]\nkind = \"file\"\nfile = \"seen.csv\"\nsigma = 0.001\n"
    );
    let read = Problem::new(Inputs::read(&folder.scene(&text, &[]).unwrap()).unwrap()).unwrap();
    assert_eq!(read.background, problem.background);
    let short = table.lines().filter(|l| !l.starts_with("1,")).collect::<Vec<_>>().join("\n");
    let folder = folder.with("background.csv", &short);
    let error = Inputs::read(&folder.scene(&text, &[]).unwrap()).err().unwrap().to_string();
    assert!(error.contains("angle[1] is missing"), "{error}");
}

#[test]
fn modes_of_twist_are_listed() {
    let (_folder, file) = scene("modes", &twin().replace("turns = 0.1", ""));
    let found = modes(&file.unwrap(), 6).unwrap();
    let pure: Vec<_> = found.found.modes.iter().filter(|m| found.spin_share(m) > 0.999).collect();
    // f = √(G/ρ)/2L, at second order in the mesh of seven lengths
    let expected = (1e5 / 3.0 / 1100.0_f64).sqrt();
    let f = pure.first().expect("a mode of twist").frequency().unwrap();
    assert!((f / expected - 1.0).abs() < 0.01, "{f} Hz, {expected}");
}

/// Sections with inertia have the exact Hessian.
#[test]
fn spins_have_the_exact_hessian() {
    let (folder, _) = scene("exact", &twin());
    let run = |sets: &[&str]| {
        let problem = Problem::from_scene(&folder.scene(&twin(), sets).unwrap()).unwrap();
        assimilate(&problem, &mut Listener::silent()).unwrap()
    };
    let (plain, exact) = (run(&[]), run(&["algorithm.hessian=\"exact\""]));
    assert!((exact.analysis.value / plain.analysis.value - 1.0).abs() <= 1e-6);
    assert_eq!(plain.model_counts.adjoint_derivatives, 0);
    let found = exact.exact_hessian.unwrap();
    assert!(found.smallest_eigenvalue.is_some_and(|mu| mu > 0.0), "{found:?}");
    assert!(found.sigma_change.is_some_and(|change| change > 0.0 && change < 1.0), "{found:?}");
}

#[test]
fn keys_that_do_not_belong_together_are_refused() {
    let refusal = |name: &str, from: &str, to: &str| {
        let text = twin();
        assert!(text.contains(from), "{from}");
        let (_folder, file) = scene(name, &text.replace(from, to));
        file.and_then(|file| Problem::from_scene(&file).map(|_| ())).expect_err("refused").to_string()
    };
    let massless = refusal("massless", "twist_inertia = true", "");
    assert!(massless.contains("model.twist_inertia = true"), "{massless}");
    let half = refusal("half", "sigma_spin = 20.0", "");
    assert!(half.contains("`sigma_theta` needs `sigma_spin`"), "{half}");
    let (_folder, file) = scene(
        "stiffness",
        &twin()
            .replace(
                r#"kind = "circle", radius = 0.02"#,
                r#"kind = "stiffness", ea = 100.0, ei = [1e-2, 1e-2], gj = 1e-2, mass_per_length = 1.0"#,
            )
            .replace("material =", "# material ="),
    );
    let error = file.expect_err("refused").to_string();
    assert!(error.contains("needs `rotary_inertia`"), "{error}");
}
