//! Constants estimated from a recording: the allowance for the mesh, and what is said of it.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::{Folder, NOTHING, SEEN};
use varda::outcome::Outcome;
use varda::run::{Listener, assimilate, simulate};
use varda::setup::Problem;

const START: &str =
    "[model.start]\nposition = [0.0, 0.0, 0.0]\ntangent = [1.0, 0.0, 0.0]\ndirector = [0.0, 0.0, 1.0]\n";
const END: &str =
    "[model.end]\nposition = [0.35, 0.0, 0.0]\ntangent = [1.0, 0.0, 0.0]\ndirector = [0.0, 0.0, 1.0]\n";

/// The estimate of EI of a rod held in this way at rest, from a recording with 0.8 of the prior's.
fn estimated(name: &str, held: &str, sets: &[&str]) -> Outcome {
    let scene = |ei: f64| {
        format!(
            "[model]\nkind = \"rod\"\nlength = 0.5\nsegments = 8\nsection = {{ kind = \"stiffness\", \
             ea = 200.0, ei = [{ei}, {ei}], gj = {ei}, mass_per_length = 0.1 }}\n{held}\
             [time]\nintegrator = \"bdf2\"\nstep = 0.02\nwindow = 10\n\
             [estimate]\nei = {{ sigma = \"30%\", together = true }}\n{SEEN}"
        )
    };
    let folder = Folder::new(&format!("estimates-{name}")).with("seen.csv", NOTHING);
    let truth = Problem::from_scene(&folder.scene(&scene(4e-3), &[]).unwrap()).unwrap();
    let s = truth.experiment.state.geometry.as_ref().expect("a rod").arc_lengths.clone();
    let shapes = simulate(&truth).unwrap().shapes.unwrap().analysis;
    let mut rows = "time_s,s_m,x_m,y_m,z_m\n".to_string();
    for (k, shape) in shapes.iter().enumerate().skip(1) {
        for i in [2, 4, 6] {
            let [x, y, z] = shape[i];
            rows += &format!("{},{},{x},{y},{z}\n", 0.02 * k as f64, s[i]);
        }
    }
    let folder = folder.with("seen.csv", &rows);
    let problem = Problem::from_scene(&folder.scene(&scene(5e-3), sets).unwrap()).unwrap();
    assimilate(&problem, &mut Listener::silent()).unwrap()
}

fn hook(vertex: usize, x: f64) -> String {
    format!("[[model.prescribed]]\nvertex = {vertex}\nposition = [{x}, 0.0, 0.0]\n")
}

fn is_without(remark: &str) -> bool {
    remark.contains("without an allowance for the mesh")
}

#[test]
fn rods_held_anywhere_have_an_allowance_for_the_mesh() {
    // a held edge makes eight segments so much stiffer that twice as many do not fit to 2 mm
    for (name, held, sigma) in [
        ("clamp", START.to_string(), 0.002),
        ("clamp-and-hook", START.to_string() + &hook(8, 0.35), 0.002),
        ("clamps", format!("{START}{END}"), 0.002),
        ("hooks", hook(0, 0.0) + &hook(8, 0.35), 0.002),
        ("clamp-and-hook-between", START.to_string() + &hook(5, 0.25), 0.002),
        ("edge", format!("clamp = \"edge\"\n{START}"), 0.01),
    ] {
        let run = estimated(name, &held, &[&format!("observations.sigma={sigma}")]);
        let ei = &run.estimates[0];
        assert!(!run.warnings.iter().any(|w| is_without(w)), "{name}: {:?}", run.warnings);
        let (mesh, on_mesh) = (ei.mesh.expect(name), ei.sigma_on_mesh.unwrap());
        assert!(mesh > 0.0 && run.seconds.mesh > 0.0, "{name}");
        // the recording was made on this mesh, and EI is what it was made with
        assert!((ei.value - 4e-3).abs() < 3.0 * on_mesh, "{name}: {} ± {on_mesh}", ei.value);
        let sigma = ei.sigma.unwrap();
        assert!((mesh.hypot(on_mesh) / sigma - 1.0).abs() < 1e-12, "{name}: {sigma}");
    }
}

#[test]
fn where_there_is_no_allowance_it_is_said_and_takes_no_time() {
    let run = estimated("not-wanted", START, &["report.mesh=false"]);
    assert!(run.seconds.mesh == 0.0 && run.estimates[0].mesh.is_none());
    assert!(!run.warnings.iter().any(|w| is_without(w)), "{:?}", run.warnings);

    let run = estimated("ended", START, &["algorithm.max_iterations=1"]);
    assert!(run.seconds.mesh == 0.0 && run.estimates[0].mesh.is_none());
    assert!(run.warnings.iter().any(|w| is_without(w)), "{:?}", run.warnings);

    let run = estimated("wrong", START, &["observations.frame.translation=[0.0,0.05,0.0]"]);
    assert!(run.seconds.mesh == 0.0 && run.estimates[0].mesh.is_none());
    assert!(run.warnings.iter().any(|w| is_without(w) && w.contains("2J/m is")), "{:?}", run.warnings);
}

/// A ring of eight variables, seen at all of them four times a time unit, made with short steps and read with
/// long ones.
#[test]
fn a_step_that_is_too_long_is_allowed_for() {
    let scene = |forcing: f64, step: f64, window: usize| {
        format!(
            "[model]\nkind = \"lorenz96\"\nvariables = 8\nforcing = {forcing}\n\
             [time]\nintegrator = \"rk4\"\nstep = {step}\nwindow = {window}\n\
             [background]\nfrom = \"file\"\nfile = \"first.csv\"\n\
             covariance = {{ kind = \"known\" }}\n\
             [estimate]\nforcing = {{ sigma = 0.3 }}\n\
             [observations]\nkind = \"file\"\nfile = \"seen.csv\"\nsigma = 0.15\n"
        )
    };
    let first: String = (0..8).map(|i| format!("{i},{:e}\n", 2.0 + 3.0 * f64::from(i).sin())).collect();
    let folder = Folder::new("estimates-steps")
        .with("first.csv", &format!("component,value\n{first}"))
        .with("seen.csv", "time_s,component,value\n0.25,0,1\n");
    let truth = Problem::from_scene(&folder.scene(&scene(8.0, 0.00625, 160), &[]).unwrap()).unwrap();
    let made = simulate(&truth).unwrap().trajectories;
    let mut rows = "time_s,component,value\n".to_string();
    for (k, state) in made.analysis.chunks_exact(made.dim).enumerate().step_by(40).skip(1) {
        let seen = state.iter().take(8).enumerate();
        rows.extend(seen.map(|(i, x)| format!("{},{i},{x:e}\n", 0.00625 * k as f64)));
    }
    let folder = folder.with("seen.csv", &rows);
    let problem = Problem::from_scene(&folder.scene(&scene(7.7, 0.125, 8), &[]).unwrap()).unwrap();
    let run = assimilate(&problem, &mut Listener::silent()).unwrap();
    let forcing = &run.estimates[0];
    let error = (forcing.value - 8.0).abs();
    assert!(error > 3.0 * forcing.sigma_on_mesh.unwrap(), "{forcing:?}");
    assert!(error < 2.0 * forcing.sigma.unwrap(), "{forcing:?}");
    assert!(run.warnings.iter().any(|w| w.contains("half the step move")), "{:?}", run.warnings);
}
