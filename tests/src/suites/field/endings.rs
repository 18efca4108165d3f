//! How a run ends: within what it was allowed, with the minimum that is meant, and with the cause named.

use super::folder::{Folder, scene_in};
use crate::row::{Case, Outcome, Rows};
use crate::suites::driven_rod::{DRIVEN_ROD, RECORDING, TWIN};
use std::fmt::Write;
use std::path::Path;
use varda::outcome::{self, Cause, Status, Verdict};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

pub(super) fn run(rows: &mut Rows) {
    rows.area("ending");
    for (name, set) in [
        ("hanging-rod-case4", "algorithm.minimizer=auto"),
        ("lorenz63-window", "algorithm.minimizer=trust-region"),
        ("lorenz63", "algorithm.sigma_stages=[10, 3, 1]"),
    ] {
        rows.case(&format!("max_iterations, {name}"), |case| most_iterations(case, name, set));
    }
    rows.case("limits.seconds", seconds);
    rows.case("a fit is not started again", no_further_start);
    rows.case("second minimum", second_minimum);
    rows.case("Lorenz-96 with a wrong forcing", wrong_forcing);
    rows.area("planted fault");
    for fault in FAULTS {
        rows.case(fault.name, |case| planted(case, &fault));
    }
}

fn ended(file: &SceneFile) -> Result<outcome::Outcome, varda::Error> {
    assimilate(&Problem::from_scene(file)?, &mut Listener::silent())
}

fn shipped(name: &str, sets: &[&str]) -> Result<SceneFile, varda::Error> {
    SceneFile::open(name, &sets.iter().map(|s| s.to_string()).collect::<Vec<_>>())
}

fn most_iterations(case: &mut Case, name: &str, set: &str) -> Outcome {
    const MOST: usize = 5;
    let outcome = ended(&shipped(name, &[set, "algorithm.max_iterations=5"])?)?;
    case.count("iterations beyond", outcome.iterations[0].saturating_sub(MOST), 0)
        .because("the most over all starts, stages and sub-windows");
    case.count("ends as max_iterations", usize::from(outcome.status == Status::MaxIterations), 1);
    Ok(())
}

fn seconds(case: &mut Case) -> Outcome {
    let sets = [
        "algorithm.minimizer=adam",
        "algorithm.gradient_tolerance=1e-30",
        "algorithm.max_iterations=1000000",
        "limits.seconds=0.3",
    ];
    let outcome = ended(&shipped("hanging-rod-case4", &sets)?)?;
    let interrupted = outcome.late && outcome.status == Status::Interrupted;
    case.count("ends as interrupted", usize::from(interrupted), 1);
    let lowest = outcome.convergence.iter().map(|row| row.j).fold(f64::INFINITY, f64::min);
    case.at_most("J above the lowest", outcome.analysis.value / lowest - 1.0, 1e-12, "-")
        .because("the best point is the result, to rounding");
    Ok(())
}

fn no_further_start(case: &mut Case) -> Outcome {
    let outcome = ended(&shipped("hanging-rod-case1", &["algorithm.minimizer=auto"])?)?;
    case.count("converged", usize::from(outcome.status == Status::Converged), 1);
    case.at_most("further starts", outcome.attempts.len().saturating_sub(1) as f64, 0.0, "-")
        .computed(outcome.analysis.chi2)
        .because("2J/m is within its band after the first");
    Ok(())
}

/// The field case of Lorenz-63 over ten units of time: the first minimum has J near 6000.
fn second_minimum(case: &mut Case) -> Outcome {
    let outcome = ended(&scene_in(Path::new("."), LONG_WINDOW, &[])?)?;
    case.at_most("J", outcome.analysis.value, 100.0, "-").because("m/2 = 75, and four times √(m/2)");
    let said = outcome.warnings.iter().chain([&outcome.judgement.text]);
    let named = |w: &&String| w.contains("another minimum") && w.contains("window_growth");
    case.at_most("remarks missing", usize::from(said.filter(named).count() == 0) as f64, 0.0, "-")
        .note(outcome.judgement.text.clone());
    Ok(())
}

const LONG_WINDOW: &str = r#"
[model]
kind = "lorenz63"
[time]
integrator = "rk4"
step = 0.01
spin_up = 500
window = 1000
[background]
from = "truth-plus-draw"
covariance = { kind = "diagonal", sigma = 1.0 }
[observations]
kind = "synthetic"
every = 20
sigma = 1.0
"#;

/// What F = 8 gave, in a model with F = 6 in every variable.
fn wrong_forcing(case: &mut Case) -> Outcome {
    let read = |sets: &[&str]| -> Result<Problem, varda::Error> {
        Problem::from_scene(&scene_in(Path::new("."), RING, sets)?)
    };
    let right = read(&[])?;
    let mut wrong = read(&["model.forcing=6.0"])?;
    wrong.observed.seen = right.observed.seen;
    wrong.background = right.background;
    wrong.truth = None;
    let outcome = assimilate(&wrong, &mut Listener::silent())?;
    let text = outcome.evidence.as_ref().map_or("", |e| e.text.as_str());
    let is_model = outcome.evidence.as_ref().is_some_and(|e| e.cause == Cause::Model);
    case.count("named as the model's", usize::from(is_model), 1).note(text);
    case.count(
        "components and times named",
        usize::from(text.contains("largest in x") && text.contains(" s (")),
        1,
    );
    Ok(())
}

const RING: &str = r#"
[model]
kind = "lorenz96"
variables = 20
forcing = 8.0
[time]
integrator = "rk4"
step = 0.02
spin_up = 500
window = 40
[background]
from = "truth-plus-draw"
covariance = { kind = "diagonal", sigma = 0.5 }
[observations]
kind = "synthetic"
every = 4
sigma = 0.2
"#;

/// A fault that is planted into the recording of a rod or into its model.
struct Fault {
    name: &'static str,
    /// Keys of the rod that was recorded.
    truth: &'static [&'static str],
    /// Keys of the scene that reads the recording.
    scene: &'static [&'static str],
    /// What is done to a place.
    recorded: fn(f64, [f64; 3]) -> [f64; 3],
    /// The causes that say it.
    named: &'static [Cause],
    /// A word of the text.
    word: &'static str,
}

const FAULTS: [Fault; 7] = [
    Fault { name: "nothing wrong", truth: &[], scene: &[], recorded: |_, x| x, named: &[], word: "" },
    Fault {
        name: "damping left out",
        truth: &["model.damping.mass=4.0"],
        scene: &["model.damping.mass=0.0"],
        recorded: |_, x| x,
        named: &[Cause::Damping],
        word: "damping",
    },
    Fault {
        name: "three times too stiff",
        truth: &["model.start.motion.radii=[0.0, 0.0]"],
        scene: &[
            "model.start.motion.radii=[0.0, 0.0]",
            "model.material.youngs_modulus=15e6",
            "algorithm.max_iterations=60",
        ],
        recorded: |_, x| x,
        named: &[Cause::RestShape],
        word: "stiffness",
    },
    Fault {
        name: "clock off 20 ms",
        truth: &["model.start.motion.omega=16.0"],
        scene: &["model.start.motion.omega=16.0", "observations.time_zero=0.02"],
        recorded: |_, x| x,
        named: &[Cause::Clock],
        word: "clock",
    },
    Fault {
        name: "one marker 10 mm aside",
        truth: &[],
        scene: &[],
        recorded: |s, x| if s == 0.25 { [x[0], x[1] + 0.01, x[2]] } else { x },
        named: &[Cause::BiasedMarker],
        word: "s = 0.25",
    },
    Fault {
        name: "sigma three times too small",
        truth: &["observations.sigma=0.006"],
        scene: &["observations.unreachable=skip", "algorithm.max_iterations=60"],
        recorded: |_, x| x,
        named: &[Cause::Sigma],
        word: "times what was assumed",
    },
    Fault {
        name: "axes turned by 5 degrees about the vertical",
        truth: &["model.material.youngs_modulus=2e7"],
        scene: &["model.material.youngs_modulus=2e7"],
        recorded: |_, x| {
            let (sin, cos) = 5.0_f64.to_radians().sin_cos();
            [cos * x[0] - sin * x[1], sin * x[0] + cos * x[1], x[2]]
        },
        named: &[Cause::Frame],
        word: "vertical",
    },
];

fn planted(case: &mut Case, fault: &Fault) -> Outcome {
    let folder = Folder::new(fault.name)?;
    let truth = Problem::from_scene(&folder.scene(&format!("{TWIN}{DRIVEN_ROD}"), fault.truth)?)?;
    let grid = truth.experiment.grid;
    let mut csv = String::from("time_s,s_m,x_m,y_m,z_m\n");
    for sight in truth.observed.sights() {
        let [x, y, z] = (fault.recorded)(sight.arc_length, sight.position);
        writeln!(csv, "{},{},{x},{y},{z}", grid.time(sight.step), sight.arc_length)?;
    }
    folder.write("seen.csv", csv.as_bytes())?;
    let outcome = ended(&folder.scene(&format!("{RECORDING}{DRIVEN_ROD}"), fault.scene)?)?;
    let text = outcome.evidence.as_ref().map_or("", |e| e.text.as_str()).to_string();
    let cause = outcome.evidence.as_ref().map(|e| e.cause);
    let right = cause.map_or(fault.named.is_empty(), |cause| fault.named.contains(&cause));
    case.count("named", usize::from(right && text.contains(fault.word)), 1)
        .computed(outcome.analysis.chi2)
        .note(format!("{cause:?}, {:?}: {text}", outcome.status));
    if outcome.judgement.verdict == Verdict::DoesNotFit {
        case.count("in the verdict", usize::from(outcome.judgement.text.contains(&text)), 1)
            .note(outcome.judgement.text.clone());
    }
    Ok(())
}
