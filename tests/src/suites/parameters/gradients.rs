//! ∂J/∂p of the assembled cost, against differences of J, and J against that of a scene which says the
//! value.

use problems::allocations::allocations;
use varda::scene::{STARTER, SceneFile};
use varda::setup::Problem;
use varda_assimilation::{ControlTransform, CostFunction, LeastSquares, StrongConstraint};
use varda_implicit::Storage;

use crate::row::{Case, Outcome, Rows};
use crate::suites::hessian::exact;

/// A constant, with its key and prior in the scene, and how another value is written there.
struct Constant {
    scene: &'static str,
    /// Needed so that there is the constant, and background and observations do not move with it.
    sets: &'static [&'static str],
    estimate: &'static str,
    /// The same scene at p: assignments with the value in place of {}.
    written: &'static [&'static str],
    /// The value at p = 0, and whether the prior is log-normal.
    value: f64,
    exponential: bool,
}

/// From files that do not depend on the constants.
const HOSE: &[&str] = &["model.damping.mass=0.2", "time.window=30"];

/// Pixels of two cameras, also between two steps.
const IN_PIXELS: &[&str] = &[
    "estimate={}",
    "time.window=20",
    "observations.time_zero=10.697",
    "observations.outside_window=\"skip\"",
];

/// A base that is recorded, seen by markers off the axis in axes that are not those of the model.
const ON_BASE: &[&str] = &[
    "estimate={mount_rotation={sigma=0.02},marker_offset={sigma=0.003}}",
    "model.segments=10",
    "time.window=15",
    "report.forecast=0",
];

/// Clamped at both ends, with twist, at a state that the truth does not move.
const TWISTED: &[&str] = &["estimate={}", "time.window=15", "model.segments=12"];

const CONSTANTS: [Constant; 33] = [
    Constant {
        scene: "tether-on-base",
        sets: ON_BASE,
        estimate: "estimate.base={sigma=0.002}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "tether-on-base",
        sets: ON_BASE,
        estimate: "estimate.base_rotation={sigma=0.02}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "twisted-rod",
        sets: TWISTED,
        estimate: "estimate.clamp_direction={sigma=0.05}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "twisted-rod",
        sets: TWISTED,
        estimate: "estimate.drive_phase={sigma=0.05}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.support_position={sigma=0.01}",
        written: &["model.start.position=[{},0.0,0.0]"],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.clamp_direction={sigma=0.1}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "hanging-rod-csv",
        sets: &[],
        estimate: "estimate.clamp_direction={sigma=0.1}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "hanging-rod-csv",
        sets: &[],
        estimate: "estimate.drive_radii=[{sigma=\"10%\"},{sigma=\"10%\"}]",
        written: &["model.start.motion.radii=[{},0.06]"],
        value: 0.10,
        exponential: true,
    },
    Constant {
        scene: "hanging-rod-csv",
        sets: &[],
        estimate: "estimate.drive_radii={sigma=0.01}",
        written: &["model.start.motion.radii=[{},0.06]"],
        value: 0.10,
        exponential: false,
    },
    Constant {
        scene: "hanging-rod-csv",
        sets: &[],
        estimate: "estimate.drive_phase={sigma=0.05}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.gravity_direction={sigma=0.1}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.ei={sigma=\"30%\",together=true}",
        written: &["model.section.ei=[{},{}]"],
        value: 0.3,
        exponential: true,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.ei={sigma=0.1,together=true}",
        written: &["model.section.ei=[{},{}]"],
        value: 0.3,
        exponential: false,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.gj={sigma=\"30%\"}",
        written: &["model.section.gj={}"],
        value: 0.2,
        exponential: true,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.mass_per_length={sigma=\"30%\"}",
        written: &["model.section.mass_per_length={}"],
        value: 0.35,
        exponential: true,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.point_mass={sigma=0.02}",
        written: &["model.point_masses.0.mass={}"],
        value: 0.05,
        exponential: false,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.damping_stiffness={sigma=\"50%\"}",
        written: &["model.damping.stiffness={}"],
        value: 0.008,
        exponential: true,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.damping_mass={sigma=\"50%\"}",
        written: &["model.damping.mass={}"],
        value: 0.2,
        exponential: true,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.natural_curvature=[{sigma=0.5},{sigma=0.5}]",
        written: &["model.natural_curvature=[{},0.0]"],
        value: 1.0,
        exponential: false,
    },
    Constant {
        scene: "hose",
        sets: HOSE,
        estimate: "estimate.ea={sigma=\"30%\"}",
        written: &["model.section.ea={}"],
        value: 1e5,
        exponential: true,
    },
    Constant {
        scene: "starter",
        sets: &[],
        estimate: "estimate.marker_arc_length={sigma=0.004}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "starter",
        sets: &[],
        estimate: "estimate.marker_offset={sigma=0.004}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "starter",
        sets: &[],
        estimate: "estimate.mount_rotation={sigma=0.2}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "starter",
        sets: &[],
        estimate: "estimate.mount_translation={sigma=0.01}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "starter",
        sets: &[],
        estimate: "estimate.bias={sigma=0.01}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "starter",
        sets: &[],
        estimate: "estimate.clock={sigma=0.004}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    // between two steps
    Constant {
        scene: "hose",
        sets: &["model.damping.mass=0.2", "time.window=30", "observations.time_zero=0.004"],
        estimate: "estimate.clock={sigma=0.004}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    // by cameras
    Constant {
        scene: "rope-two-cameras",
        sets: IN_PIXELS,
        estimate: "estimate.marker_arc_length={sigma=0.005}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "rope-two-cameras",
        sets: IN_PIXELS,
        estimate: "estimate.marker_offset={sigma=0.005}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "rope-two-cameras",
        sets: IN_PIXELS,
        estimate: "estimate.mount_rotation={sigma=0.02}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "rope-two-cameras",
        sets: IN_PIXELS,
        estimate: "estimate.mount_translation={sigma=0.01}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "rope-two-cameras",
        sets: IN_PIXELS,
        estimate: "estimate.clock={sigma=0.01}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
    Constant {
        scene: "rope-two-cameras",
        sets: IN_PIXELS,
        estimate: "estimate.clamp_direction={sigma=0.05}",
        written: &[],
        value: 0.0,
        exponential: false,
    },
];

pub(super) fn run(rows: &mut Rows) {
    rows.area("gradient of J");
    for constant in rows.grid("constants", &CONSTANTS) {
        let name = constant.estimate.split('=').next().unwrap_or("").to_string();
        let law = if constant.exponential { "log-normal" } else { "normal" };
        rows.case(&format!("{name}, {law}"), |case| gradient(case, constant));
    }
}

/// Steps of a stiff rod are solved to 1e-11 of its length, and its gradients are good to ten times that; the
/// worst of all constants is the stretching stiffness of a hose, whose differences are off by 1.02e-10.
const ACCURACY: exact::Accuracy = exact::Accuracy { reach: 0.05, rounding: 2e-10, symmetry: 4e-12 };

/// Products with the exact Hessian, along all unknowns and along single constants.
fn second(case: &mut Case, problem: &Problem, v: &[f64], of_state: usize) -> Outcome {
    let mut observations = problem.observations()?;
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
    let mut model = problem.model();
    let mut cost = StrongConstraint::new(model.as_mut(), transform, &mut observations)?;
    cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
    exact::product(case, &mut cost, v, ACCURACY)?;
    let p: Vec<f64> = (0..v.len()).map(|i| (1.0 + i as f64).sin()).collect();
    let mut products = Vec::new();
    for storage in [Storage::KeepAll, Storage::States, Storage::Checkpoints { states: 3 }] {
        cost.set_storage(storage);
        cost.evaluate(v, Some(&mut vec![0.0; v.len()]))?;
        let mut product = vec![0.0; v.len()];
        cost.exact_hessian_apply(&p, &mut product)?;
        let (requests, outcome) = allocations(|| cost.exact_hessian_apply(&p, &mut product));
        outcome?;
        if storage == Storage::KeepAll {
            case.count("allocations: exact_hessian_apply", requests, 0);
        }
        products.push(product);
    }
    let differ = products[1..].iter().filter(|p| **p != products[0]).count();
    case.at_most("storage policies with other bits", differ as f64, 0.0, "policies");
    cost.set_storage(Storage::KeepAll);
    for p in (of_state..v.len()).take(6) {
        let alone: Vec<f64> = (0..v.len()).map(|i| f64::from(i == p)).collect();
        exact::along(case, &format!(", p[{}] alone", p - of_state), &mut cost, [v, &alone], ACCURACY)?;
    }
    Ok(())
}

/// J and its gradient at a control, as a function of v.
fn cost_at(
    problem: &Problem,
    v: &[f64],
    gradient: Option<&mut [f64]>,
) -> Result<f64, Box<dyn std::error::Error>> {
    let mut observations = problem.observations()?;
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
    let mut model = problem.model();
    let mut cost = StrongConstraint::new(model.as_mut(), transform, &mut observations)?;
    Ok(cost.evaluate(v, gradient)?)
}

fn problem(scene: &str, sets: &[String]) -> Result<Problem, varda::Error> {
    let file = match scene {
        "starter" => SceneFile::parse("starter", "starter.toml", STARTER, None, sets)?,
        shipped => SceneFile::open(shipped, sets)?,
    };
    Problem::from_scene(&file)
}

fn gradient(case: &mut Case, constant: &Constant) -> Outcome {
    let base: Vec<String> = constant.sets.iter().map(|s| s.to_string()).collect();
    let with: Vec<String> = base.iter().cloned().chain([constant.estimate.to_string()]).collect();
    let (with, without) = (problem(constant.scene, &with)?, problem(constant.scene, &base)?);
    let (n, known) = (with.background.len(), without.background.len());
    let columns = with.covariance.as_ref().root_dim();
    let of_state = without.covariance.as_ref().root_dim();

    // off the background, in state and constants
    let mut v: Vec<f64> = (0..columns).map(|i| 0.2 * (1.0 + 1.7 * i as f64).sin()).collect();
    let mut gradient = vec![0.0; columns];
    let j = cost_at(&with, &v, Some(&mut gradient))?;
    for p in of_state..columns {
        let mut at = |h: f64| {
            let before = v[p];
            v[p] += h;
            let j = cost_at(&with, &v, None);
            v[p] = before;
            j
        };
        let mut central = |h: f64| Ok::<f64, Box<dyn std::error::Error>>((at(h)? - at(-h)?) / (2.0 * h));
        let difference = (4.0 * central(1e-3)? - central(2e-3)?) / 3.0;
        let size = gradient.iter().fold(1.0_f64, |size, g| size.max(g.abs()));
        let size = gradient[p].abs().max(1e-6 * size);
        case.at_most(
            &format!("∂J/∂p[{}] off its difference", p - of_state),
            (gradient[p] - difference).abs() / size,
            1e-6 + 100.0 * f64::EPSILON * j / (1e-3 * size),
            "-",
        )
        .because("extrapolated differences of J: h⁴ of its fifth derivative, 100 roundings of J over h");
    }

    second(case, &with, &v, of_state)?;

    // the same cost where the scene says the value that p stands for
    if constant.written.is_empty() {
        return Ok(());
    }
    let mut z = vec![0.0; n];
    let transform = ControlTransform::new(with.background.clone(), with.covariance.as_ref())?;
    transform.control(&v, &mut z);
    z[known + 1..].fill(0.0);
    let value =
        if constant.exponential { constant.value * z[known].exp() } else { constant.value + z[known] };
    let written = constant.written.iter().map(|s| s.replace("{}", &format!("{value:e}")));
    let said = problem(constant.scene, &base.iter().cloned().chain(written).collect::<Vec<_>>())?;
    let of = |problem: &Problem, z: &[f64]| -> Result<f64, Box<dyn std::error::Error>> {
        let mut observations = problem.observations()?;
        let mut model = problem.model();
        observations.follow(model.rate());
        let mut x = vec![0.0; model.dim()];
        model.initial_state(z, &mut x)?;
        let mut run = observations.prediction();
        let (mut next, mut d) = (x.clone(), vec![0.0; observations.dim()]);
        for k in 0..=observations.last_step().unwrap_or(0) {
            observations.observe_add(k, &x, &mut run)?;
            model.step(k, &x, &mut next)?;
            std::mem::swap(&mut x, &mut next);
        }
        observations.innovations(run.values(), &mut d);
        Ok(0.5 * d.iter().zip(observations.sigma()).map(|(d, s)| (d / s).powi(2)).sum::<f64>())
    };
    let (in_state, in_scene) = (of(&with, &z)?, of(&said, &z[..known])?);
    case.at_most("J_o off that of the scene with this value", (in_state / in_scene - 1.0).abs(), 1e-9, "-")
        .because("Newton's 1e-11 of the length in each step, over σ")
        .computed(in_state);
    Ok(())
}
