//! What is unknown of observations and not of the model: their clock, and their σ.

use std::fmt::Write;

use problems::allocations::allocations;
use varda::outcome::{Estimated, Outcome as Ended};
use varda::run::{Listener, assimilate};
use varda::scene::{STARTER, SceneFile};
use varda::setup::Problem;

use crate::row::{Case, Outcome, Rows};
use crate::suites::driven_rod::{DRIVEN_ROD, RECORDING, TWIN};
use crate::suites::folder::Folder;

pub(super) fn run(rows: &mut Rows) {
    rows.area("clock and σ");
    for offset in rows.grid("offsets", [0.013, -0.004, -0.027, 0.04]) {
        rows.case(&format!("a recording off by {offset} s, its σ by a factor of 2"), |case| {
            clock(case, offset)
        });
    }
    rows.case("σ of a twin", twin);
    rows.case("a rod at rest", at_rest);
    rows.case("no rates, no clock", refused);
    rows.case("products of everything that is seen", products);
}

fn ended(file: &SceneFile) -> Result<Ended, varda::Error> {
    assimilate(&Problem::from_scene(file)?, &mut Listener::silent())
}

fn named<'a>(ended: &'a Ended, name: &str) -> Result<&'a Estimated, String> {
    ended.estimates.iter().find(|e| e.name == name).ok_or(format!("no estimate of {name}"))
}

/// The recording of a driven rod with 2 mm of noise, by a clock that shows `offset` less than the model's.
fn recorded(name: &str, offset: f64, sets: &[&str]) -> Result<Folder, Box<dyn std::error::Error>> {
    let folder = Folder::new(&format!("clock-{name}"))?;
    let sets: Vec<&str> = sets.iter().copied().chain(["observations.every=1"]).collect();
    let truth = Problem::from_scene(&folder.scene(&format!("{TWIN}{DRIVEN_ROD}"), &sets)?)?;
    let grid = truth.experiment.grid;
    let mut csv = String::from("time_s,s_m,x_m,y_m,z_m\n");
    for sight in truth.observed.sights() {
        let [x, y, z] = sight.position;
        writeln!(csv, "{:.6},{},{x},{y},{z}", grid.time(sight.step) - offset, sight.arc_length)?;
    }
    folder.write("seen.csv", csv.as_bytes())?;
    Ok(folder)
}

fn clock(case: &mut Case, offset: f64) -> Outcome {
    let folder = recorded(&offset.to_string(), offset, &[])?;
    let sets = [
        "observations.sigma=0.001",
        "estimate.clock={sigma=0.05}",
        "estimate.observation_sigma={sigma=\"100%\"}",
    ];
    let file = folder.scene(&format!("{RECORDING}{DRIVEN_ROD}"), &sets)?;
    let ended = ended(&file)?;
    let c = named(&ended, "clock")?;
    let sigma = c.sigma.ok_or("no σ")?;
    case.at_most("clock: off the offset", (c.value - offset).abs() / sigma, 3.5, "σ")
        .because("a number of one seed, a fixed grid of four")
        .note(format!("{:.6} ± {sigma:.6} s", c.value))
        .computed(c.value);
    case.at_most("clock: σ", sigma, 1e-3, "s").because("2 mm at 0.24 m/s, some hundred places");
    let s = named(&ended, "observation_sigma")?;
    let open = s.sigma.ok_or("no σ")? / s.value;
    case.at_most("ln σ off that of the noise", (s.value / 0.002).ln().abs() / open, 3.5, "σ")
        .because("a number of one seed")
        .note(format!("{:.6} ± {:.6} m", s.value, open * s.value))
        .computed(s.value);
    let chi2 = ended.analysis.chi2;
    case.at_most("2J/m off 1", (chi2 - 1.0).abs(), 0.1, "-")
        .because("σ is estimated: the degrees of freedom and the background are what differs from 1")
        .computed(chi2);
    Ok(())
}

/// The twin's own σ is found again from a scene that says another: values are drawn with that of the scene.
fn twin(case: &mut Case) -> Outcome {
    let sets = ["estimate.observation_sigma={sigma=\"100%\"}", "seed=2"].map(String::from);
    for scene in ["hanging-rod-case2", "lorenz96"] {
        let ended = ended(&SceneFile::open(scene, &sets)?)?;
        let s = named(&ended, "observation_sigma")?;
        let (open, truth) = (s.sigma.ok_or("no σ")? / s.value, s.truth.ok_or("no truth")?);
        case.at_most(&format!("{scene}: ln σ off the truth"), (s.value / truth).ln().abs() / open, 3.5, "σ")
            .because("a number of one seed")
            .note(format!("{:.5} ± {:.5}, truth {truth}", s.value, open * s.value))
            .computed(s.value / truth);
    }
    Ok(())
}

/// A rod at rest has no times: 60 s of damping by 0.5/s before the window.
fn at_rest(case: &mut Case) -> Outcome {
    let still = "model.start.motion.radii=[0.0, 0.0]";
    let folder = recorded("rest", 0.0, &[still, "time.spin_up=6000"])?;
    let sets = [still, "estimate.clock={sigma=0.005}"];
    let ended = ended(&folder.scene(&format!("{RECORDING}{DRIVEN_ROD}"), &sets)?)?;
    let c = named(&ended, "clock")?;
    case.at_most("clock: called identifiable", f64::from(u8::from(c.identifiable != Some(false))), 0.0, "-")
        .because("nothing moves")
        .computed(c.sigma.ok_or("no σ")? / c.prior_sigma);
    Ok(())
}

/// All constants of observations at once: no allocation after the first call, and the dot product.
fn products(case: &mut Case) -> Outcome {
    let sets = [
        "estimate.marker_arc_length={sigma=0.004}",
        "estimate.marker_offset={sigma=0.004}",
        "estimate.mount_rotation={sigma=0.2}",
        "estimate.mount_translation={sigma=0.01}",
        "estimate.bias={sigma=0.01}",
        "estimate.clock={sigma=0.01}",
    ];
    let file = SceneFile::parse("starter", "starter.toml", STARTER, None, &sets.map(String::from))?;
    let problem = Problem::from_scene(&file)?;
    let mut model = problem.model();
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&problem.background, &mut x)?;
    products_at(case, &problem, 3, &x)
}

/// H of a problem at a step and a state: no allocation after the first call, and the dot product.
pub(super) fn products_at(case: &mut Case, problem: &Problem, step: usize, x: &[f64]) -> Outcome {
    let mut operator = problem.observed.operator()?;
    let (n, rows) = (operator.state_dim(), operator.dim());
    let wave = |i: usize, w: f64| (1.0 + w * i as f64).sin();
    let dx: Vec<f64> = (0..n).map(|i| wave(i, 1.7)).collect();
    let dy: Vec<f64> = (0..rows).map(|i| wave(i, 2.3)).collect();
    let (mut y, mut back, mut forth) = (vec![0.0; rows], vec![0.0; n], vec![0.0; rows]);
    let at = problem.experiment.grid.at(step);
    for round in 0..2 {
        let (asked, outcome) = allocations(|| {
            back.fill(0.0);
            operator.observe(at, x, &mut y)?;
            operator.tangent(at, x, &dx, &mut forth);
            operator.adjoint_add(at, x, &dy, &mut back);
            Ok::<(), varda_implicit::Refusal>(())
        });
        outcome?;
        if round > 0 {
            case.count("allocations, observations", asked, 0);
        }
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (a, b) = (dot(&forth, &dy), dot(&dx, &back));
    let size = forth.iter().zip(&dy).map(|(a, b)| (a * b).abs()).sum::<f64>();
    case.at_most("observations: adjoint off the tangent", (a - b).abs() / size, 1e-13, "-")
        .computed(a)
        .because("rounding of sums");
    // what is kept of one state is not taken for another, nor lost by coming back
    let other: Vec<f64> = x.iter().enumerate().map(|(i, x)| x + 1e-4 * wave(i, 0.7)).collect();
    let mut unlike = 0;
    for state in [&other[..], x, &other[..]] {
        let (mut fresh, mut expected) = (problem.observed.operator()?, vec![0.0; rows]);
        fresh.observe(at, state, &mut y)?;
        fresh.tangent(at, state, &dx, &mut expected);
        operator.observe(at, state, &mut y)?;
        operator.tangent(at, state, &dx, &mut forth);
        unlike += forth.iter().zip(&expected).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
    }
    case.count("numbers of a tangent that depend on what was asked before", unlike, 0);
    Ok(())
}

fn refused(case: &mut Case) -> Outcome {
    let sets = ["time.integrator=midpoint", "estimate.clock={sigma=0.002}"].map(String::from);
    let error =
        Problem::from_scene(&SceneFile::open("hose", &sets)?).err().map_or(String::new(), |e| e.to_string());
    case.count("named", usize::from(error.contains("estimate.clock") || error.contains("a clock needs")), 1)
        .note(error);
    for set in ["estimate.observation_sigma={sigma=0.1}", "estimate.clock={sigma=\"10%\"}"] {
        let error = match SceneFile::open("hose", &[set.to_string()]) {
            Ok(file) => Problem::from_scene(&file).err().map(|e| e.to_string()),
            Err(error) => Some(error.to_string()),
        };
        case.count(&format!("{set} refused"), usize::from(error.is_some()), 1)
            .note(error.unwrap_or_default());
    }
    Ok(())
}
