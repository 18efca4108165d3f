//! Constants found again: of recordings by other programs, and what cannot be found.

use varda::outcome::{Estimated, Outcome as Ended};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

use crate::row::{Case, Outcome, Rows};

/// Of the hose, from 20 to 50 % off.
const OFF: [&str; 9] = [
    "model.section.ei=[0.25,0.25]",
    "model.damping.stiffness=0.012",
    "model.natural_curvature=[1.3,0.0]",
    "model.point_masses.0.mass=0.065",
    "estimate.ei={sigma=\"30%\",together=true}",
    "estimate.damping_stiffness={sigma=\"50%\"}",
    "estimate.natural_curvature={sigma=0.5}",
    "estimate.point_mass={sigma=\"30%\"}",
    "seed=0",
];

pub(super) fn run(rows: &mut Rows) {
    rows.area("recovery");
    rows.case("hose: EI, damping, curvature and tip mass", hose);
    rows.case("what the observations do not see", unseen);
    rows.case("what they see together only", together);
    rows.case("mount and bias of a twin", mount);
    rows.area("extremes");
    for p in rows.grid("priors", [1e-6, 1e-3, 0.1, 10.0, 1e3, 1e6]) {
        rows.case(&format!("EI {p:e} times its prior"), |case| extreme(case, p));
    }
}

fn ended(scene: &str, sets: &[&str]) -> Result<Ended, varda::Error> {
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    let problem = Problem::from_scene(&SceneFile::open(scene, &sets)?)?;
    assimilate(&problem, &mut Listener::silent())
}

fn named<'a>(ended: &'a Ended, name: &str) -> Result<&'a Estimated, String> {
    ended.estimates.iter().find(|e| e.name == name).ok_or(format!("no estimate of {name}"))
}

fn hose(case: &mut Case) -> Outcome {
    let ended = ended("hose", &OFF)?;
    let truths = [
        ("ei", 0.30),
        ("damping_stiffness", 0.008),
        ("natural_curvature[0]", 1.0),
        ("natural_curvature[1]", 0.0),
        ("point_mass[0]", 0.05),
    ];
    for (name, truth) in truths {
        let e = named(&ended, name)?;
        let sigma = e.sigma.ok_or("no σ")?;
        case.at_most(
            &format!("{name}: off the constant it was made with"),
            (e.value - truth).abs() / sigma,
            3.0,
            "σ",
        )
        .because("the constants of the program that made the recording")
        .computed(e.value);
        if truth != 0.0 {
            case.at_most(&format!("{name}: σ"), sigma / truth, 0.3, "-")
                .because("known well enough to be of use");
        }
    }
    let chi2 = ended.analysis.chi2;
    case.at_most("2J/m off 1.025", (chi2 - 1.025).abs(), 0.175, "-")
        .because("a fit: 0.85 to 1.2")
        .computed(chi2);
    Ok(())
}

/// The stretch of a hose is far below the noise.
fn unseen(case: &mut Case) -> Outcome {
    let ended = ended("hose", &["estimate.ea={sigma=\"10%\"}", "estimate.gj={sigma=\"50%\"}"])?;
    for name in ["ea", "gj"] {
        let e = named(&ended, name)?;
        case.at_most(
            &format!("{name}: called identifiable"),
            f64::from(u8::from(e.identifiable != Some(false))),
            0.0,
            "-",
        )
        .because("a plane motion does not twist, and 2 mm of noise hide the stretch");
    }
    let said = ended
        .warnings
        .iter()
        .any(|w| w.contains("not identifiable: gj, ea") || w.contains("not identifiable: ea, gj"));
    case.at_most("not said in the remarks", f64::from(u8::from(!said)), 0.0, "-")
        .because("a person reads these");
    Ok(())
}

/// Places show only the ratio of stiffness and mass.
fn together(case: &mut Case) -> Outcome {
    let sets = [
        "estimate.ei={sigma=\"50%\",together=true}",
        "estimate.mass_per_length={sigma=\"50%\"}",
        "estimate.point_mass={sigma=\"50%\"}",
    ];
    let ended = ended("hose", &sets)?;
    let e = named(&ended, "ei")?;
    let least = e.correlations.iter().fold(1.0_f64, |least, c| least.min(c.abs()));
    case.at_most("1 − least correlation of ei, mass and tip mass", 1.0 - least, 0.05, "-")
        .because("a common factor of all three moves nothing");
    let said =
        ended.warnings.iter().any(|w| w.contains("seen together only") && w.contains("mass_per_length"));
    case.at_most("not said in the remarks", f64::from(u8::from(!said)), 0.0, "-")
        .because("a person reads these");
    Ok(())
}

fn mount(case: &mut Case) -> Outcome {
    let sets = ["estimate.mount_rotation={sigma=0.05}", "estimate.mount_translation={sigma=0.02}", "seed=3"];
    let ended = ended("hanging-rod-case2", &sets)?;
    for e in &ended.estimates {
        let (sigma, truth) = (e.sigma.ok_or("no σ")?, e.truth.ok_or("no truth")?);
        case.at_most(&format!("{}: off the truth", e.name), (e.value - truth).abs() / sigma, 3.5, "σ")
            .because("six numbers of one seed within 3.5 σ")
            .computed(e.value);
    }
    Ok(())
}

/// At p far from the prior J is a number, or the error says what failed.
fn extreme(case: &mut Case, times: f64) -> Outcome {
    let sets = ["estimate.ei={sigma=\"100%\",together=true}".to_string(), "time.window=10".into()];
    let problem = Problem::from_scene(&SceneFile::open("hose", &sets)?)?;
    let mut model = problem.model();
    let mut z = problem.background.clone();
    *z.last_mut().ok_or("no control")? = f64::ln(times);
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(&z, &mut x)?;
    let mut ended = Ok(());
    for k in 0..10 {
        match model.step(k, &x, &mut next) {
            Ok(_) => std::mem::swap(&mut x, &mut next),
            Err(error) => {
                ended = Err(error);
                break;
            }
        }
    }
    let wrong = match &ended {
        Ok(()) => x.iter().any(|v| !v.is_finite() || v.abs() > 1e6),
        Err(error) => !error.to_string().contains("step"),
    };
    let how = ended.map_or_else(|e| e.to_string(), |()| "ran".to_string());
    case.at_most("neither places nor an error that names its step", f64::from(u8::from(wrong)), 0.0, "-")
        .because("a right answer or a clear error")
        .note(how);
    Ok(())
}
