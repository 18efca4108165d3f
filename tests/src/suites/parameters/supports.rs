//! Supports that are not quite where the scene has them: clamps askew, drives, a base recorded with noise.

use std::fmt::Write;

use problems::allocations::allocations;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use varda::outcome::Outcome as Ended;
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;
use varda_assimilation::{ControlTransform, CostFunction, ObservationOperator, StrongConstraint};
use varda_implicit::{At, check};
use varda_rod::{Marker, Markers, UnitQuaternion, Vector3};

use super::observed::products_at;
use crate::row::{Case, Outcome, Rows};
use crate::suites::folder::{Folder, RECORDED_ROD};
use crate::suites::gripped_cable::gripped_cable;

pub(super) fn run(rows: &mut Rows, quick: bool) {
    rows.area("supports");
    rows.case("∂J/∂p of a cable between two grippers", gripped);
    rows.case("clamp and drive of a twin", twin);
    rows.case("products of what supports move", products);
    rows.case("products of markers beside the centreline", beside);
    let seeds = if quick { 6 } else { 40 };
    rows.case("a base recorded with 1 mm of noise", |case| base(case, Recorded::Places, seeds));
    rows.case("a base recorded with 0.02 rad of noise", |case| base(case, Recorded::Rotations, seeds));
    rows.case("a row just beyond the reach of a recorded base", beyond);
    rows.case("parts of J, and σ with the constants known", parts);
    for p in rows.grid("priors of supports", [1e-6, 1.0, 1e3, 1e6]) {
        rows.case(&format!("supports at {p:e} times their priors"), |case| extreme(case, p));
    }
}

fn ended(file: &SceneFile) -> Result<Ended, varda::Error> {
    assimilate(&Problem::from_scene(file)?, &mut Listener::silent())
}

/// Poses that move, damping and angles of a curved cable with two clamps, each askew in three directions and
/// each recorded with errors.
fn gripped(case: &mut Case) -> Outcome {
    let sets = [
        "time.window=20",
        "model.segments=19",
        "estimate.clamp_direction={sigma=0.05}",
        "estimate.base={sigma=0.001,correlation_time=0.1}",
        "estimate.base_rotation={sigma=0.01,correlation_time=0.1}",
        "report.forecast=0.0",
    ];
    let problem = Problem::from_scene(&gripped_cable(0.0, &sets)?)?;
    let mut observations = problem.observations()?;
    let transform = ControlTransform::new(problem.background.clone(), problem.covariance.as_ref())?;
    let (n, constants) = (problem.covariance.as_ref().root_dim(), problem.experiment.state.constants.len());
    let names = problem.experiment.state.names.clone();
    let mut model = problem.model();
    let mut cost = StrongConstraint::new(model.as_mut(), transform, &mut observations)?;
    let mut v: Vec<f64> = (0..n).map(|i| 0.2 * (1.0 + 1.7 * i as f64).sin()).collect();
    let mut gradient = vec![0.0; n];
    cost.evaluate(&v, Some(&mut gradient))?;
    let size = gradient.iter().fold(1.0_f64, |size, g| size.max(g.abs()));
    let mut worst = [(0.0_f64, 0); 3];
    for p in n - constants..n {
        let mut at = |h: f64| {
            let before = v[p];
            v[p] += h;
            let j = cost.evaluate(&v, None);
            v[p] = before;
            j
        };
        let mut central = |h: f64| Ok::<f64, varda_assimilation::Error>((at(h)? - at(-h)?) / (2.0 * h));
        let difference = (4.0 * central(0.016)? - central(0.032)?) / 3.0;
        let error = (gradient[p] - difference).abs() / gradient[p].abs().max(1e-5 * size);
        let name = &names[names.len() + p - n];
        let kind = ["base[", "base_rotation["].iter().position(|kind| name.contains(kind));
        let worst = &mut worst[kind.map_or(0, |kind| kind + 1)];
        *worst = (worst.0.max(error), worst.1 + 1);
    }
    let because = "extrapolated differences of J: h⁴ of its fifth derivative, and rounding of J over h";
    for (kind, (error, count)) in ["directions", "base", "base_rotation"].into_iter().zip(worst) {
        case.at_most(&format!("{kind}: ∂J/∂p off its difference"), error, 1e-6, "-")
            .because(because)
            .note(format!("{count} numbers"));
    }
    case.count("directions", worst[0].1, 6);
    case.count("axes of rotations as of places", worst[1].1, worst[2].1);
    Ok(())
}

fn twin(case: &mut Case) -> Outcome {
    let sets = [
        "estimate.clamp_direction={sigma=0.05}",
        "estimate.drive_radii={sigma=\"10%\"}",
        "estimate.drive_phase={sigma=0.1}",
        "background.draw=\"covariance\"",
        "seed=3",
    ];
    let ended = ended(&SceneFile::open("hanging-rod-case2", &sets.map(String::from))?)?;
    let names: Vec<&str> = ended.estimates.iter().map(|e| e.name.as_str()).collect();
    let expected = [
        "clamp_direction[start].m1",
        "clamp_direction[start].m2",
        "drive_radii[0]",
        "drive_radii[1]",
        "drive_phase",
    ];
    case.count("named as they should be", usize::from(names == expected), 1).note(names.join(", "));
    for e in &ended.estimates {
        let (sigma, truth) = (e.sigma.ok_or("no σ")?, e.truth.ok_or("no truth")?);
        case.at_most(&format!("{}: off the truth", e.name), (e.value - truth).abs() / sigma, 3.5, "σ")
            .because("five numbers of one seed within 3.5 σ")
            .computed(e.value);
        case.at_most(&format!("{}: σ over the prior's", e.name), sigma / e.prior_sigma, 0.9, "-")
            .because("what moves the whole rod is seen");
    }
    Ok(())
}

/// Markers beside the centreline: they turn with the frames of a clamp, as the shape between carries them.
fn beside(case: &mut Case) -> Outcome {
    let sets = ["estimate.clamp_direction={sigma=0.03}".to_string()];
    let problem = Problem::from_scene(&SceneFile::open("beam-release", &sets)?)?;
    let mut model = problem.model();
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&problem.background, &mut x)?;
    products_at(case, &problem, 0, &x)
}

/// Of the model and of what is observed: exact transposes that ask for no memory.
fn products(case: &mut Case) -> Outcome {
    let sets = [
        "time.window=6",
        "estimate.clamp_direction={sigma=0.05}",
        "estimate.base={sigma=0.001}",
        "estimate.base_rotation={sigma=0.01}",
    ];
    let problem = Problem::from_scene(&gripped_cable(0.0, &sets)?)?;
    let mut model = problem.model();
    let n = model.dim();
    let (mut x, mut next) = (vec![0.0; n], vec![0.0; n]);
    let mut z = problem.background.clone();
    let constants = problem.experiment.state.constants.len();
    let len = z.len();
    z[len - constants..].iter_mut().enumerate().for_each(|(i, p)| *p = 1e-3 * (1.0 + i as f64).sin());
    model.initial_state(&z, &mut x)?;
    products_at(case, &problem, 0, &x)?;
    let dx: Vec<f64> = (0..n).map(|i| (1.0 + 1.7 * i as f64).sin()).collect();
    let (mut tangent, mut adjoint) = (dx.clone(), dx.clone());
    for round in 0..2 {
        let (asked_of_model, outcome) = allocations(|| {
            model.step(0, &x, &mut next)?;
            model.linearize(0, 0, &x, &next)?;
            tangent.copy_from_slice(&dx);
            model.tangent(0, &mut tangent);
            adjoint.copy_from_slice(&dx);
            model.adjoint(0, &mut adjoint);
            Ok::<(), varda_implicit::Error>(())
        });
        outcome?;
        if round > 0 {
            case.count("allocations, a step and its products", asked_of_model, 0);
        }
    }
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let size = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a * b).abs()).sum::<f64>();
    case.at_most(
        "a step: adjoint off the tangent",
        (dot(&tangent, &dx) - dot(&dx, &adjoint)).abs() / size(&tangent, &dx),
        1e-11,
        "-",
    )
    .because("rounding of a solve with EA/l beside EI/l³");
    // small changes of the state, so that those of the constants show
    let scale: Vec<f64> =
        (0..n).map(|i| if (len - constants..len).contains(&i) { 1e-3 } else { 1e-5 }).collect();
    let report = check::model(model.as_mut(), &z, 3, &scale, 1)?;
    case.count("Taylor and dot-product tests passed", usize::from(report.passed()), 1)
        .note(report.to_string().lines().next().unwrap_or_default().to_string());
    Ok(())
}

/// The time at which the base's rows begin \[s\], and how many there are, 100 a second.
const ROWS: (f64, usize) = (-0.2, 90);
/// σ of a marker that is seen, and of a row of the base \[m\].
const NOISE: [f64; 2] = [3e-4, 1e-3];
/// Markers: those at the second and the fourth place are assimilated.
const PLACES: [f64; 4] = [0.125, 0.25, 0.375, 0.5];

fn moved(t: f64) -> Vector3<f64> {
    Vector3::new(0.03 * (8.0 * t).sin(), 0.02 * (5.0 * t).cos(), 0.01 * (6.0 * t).sin())
}

/// What of the base is recorded with errors.
#[derive(Clone, Copy)]
enum Recorded {
    Places,
    Rotations,
}

/// σ of a rotation about an axis of a row \[rad\], and where the clamp is on the body that turns \[m\].
const TURN_NOISE: f64 = 0.02;
const OFFSET: [f64; 3] = [0.02, 0.03, -0.01];

fn turned(t: f64) -> Vector3<f64> {
    Vector3::new(0.2 * (6.0 * t).sin(), 0.15 * (4.0 * t).cos(), 0.1 * (5.0 * t).sin())
}

impl Recorded {
    /// The scene of a rod whose base is recorded in base.csv, by a key that smooths what has errors.
    fn scene(self, smoothing: &str) -> String {
        let (model, _) = RECORDED_ROD.split_once("[[observations.markers]]").unwrap_or((RECORDED_ROD, ""));
        let model = match self {
            Recorded::Places => {
                let motion = format!("motion = {{ kind = \"table\", file = \"base.csv\", {smoothing} }}");
                model.replace("# motion", &motion)
            }
            Recorded::Rotations => {
                let keys = [
                    "position = [0.0, 0.0, 1.0]",
                    "tangent = [0.0, 0.0, -1.0]",
                    "director = [1.0, 0.0, 0.0]",
                ];
                let model = keys.iter().fold(model.to_string(), |model, key| model.replace(key, ""));
                let axes = "tangent_axis = [0.0, 0.0, -1.0], director_axis = [1.0, 0.0, 0.0]";
                let keys = format!("offset = {OFFSET:?}, {axes}, {smoothing}");
                let motion = format!("motion = {{ kind = \"pose\", file = \"base.csv\", {keys} }}");
                model.replace("# motion", &motion)
            }
        };
        let mut text =
            model.replace("sigma_x = 0.02", "sigma_x = 0.005").replace("sigma_v = 0.3", "sigma_v = 0.1");
        for (i, s) in PLACES.into_iter().enumerate() {
            let used = if i % 2 == 0 { "withhold" } else { "assimilate" };
            let _ = write!(
                text,
                "[[observations.markers]]\nname = \"m{i}\"\narc_length = {s}\nuse = \"{used}\"\n"
            );
        }
        text
    }

    /// Its rows, each with errors of size one times what they are.
    fn rows(self, mut error: impl FnMut() -> f64) -> String {
        let mut text = String::from(match self {
            Recorded::Places => "time_s,x_m,y_m,z_m\n",
            Recorded::Rotations => "time_s,x_m,y_m,z_m,qx,qy,qz,qw\n",
        });
        for k in 0..ROWS.1 {
            let t = ROWS.0 + 0.01 * k as f64;
            match self {
                Recorded::Places => {
                    let [x, y, z] = [0, 1, 2].map(|c| moved(t)[c] + NOISE[1] * error());
                    let _ = writeln!(text, "{t:.4},{x},{y},{z}");
                }
                Recorded::Rotations => {
                    let off = Vector3::from([0, 1, 2].map(|_| TURN_NOISE * error()));
                    let q = UnitQuaternion::new(turned(t)) * UnitQuaternion::new(off);
                    let (p, q) = (moved(t) + Vector3::new(0.0, 0.0, 1.0), q.coords);
                    let _ = writeln!(text, "{t:.4},{},{},{},{},{},{},{}", p.x, p.y, p.z, q.x, q.y, q.z, q.w);
                }
            }
        }
        text
    }

    /// How errors of this size are smoothed, and the key that estimates what that leaves.
    fn keys(self) -> [String; 2] {
        match self {
            Recorded::Places => ["sigma = 0.001".into(), format!("estimate.base={{sigma={}}}", NOISE[1])],
            Recorded::Rotations => [
                format!("sigma = 0.0, sigma_angle = {TURN_NOISE}"),
                format!("estimate.base_rotation={{sigma={TURN_NOISE}}}"),
            ],
        }
    }
}

/// Shares of withheld coordinates within 1.96 σ, without and with the errors of the base, and the mean σ of
/// those coordinates.
fn covered(what: Recorded, seed: u64) -> Result<[[f64; 2]; 2], Box<dyn std::error::Error>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
    let folder = Folder::new(&format!("base-{seed}"))?;
    folder.write("base.csv", what.rows(|| 0.0).as_bytes())?;
    folder.write("seen.csv", b"time_s,marker,x_m,y_m,z_m\n0.0,m1,0.0,0.02,0.75\n")?;
    let sets = ["observations.unreachable=\"skip\""];
    let truth = Problem::from_scene(&folder.scene(&what.scene("cutoff = 40.0"), &sets)?)?;
    let transform = ControlTransform::new(truth.background.clone(), truth.covariance.as_ref())?;
    let v: Vec<f64> = (0..truth.covariance.as_ref().root_dim()).map(|_| normal()).collect();
    let mut z = truth.background.clone();
    transform.control(&v, &mut z);
    let mut model = truth.model();
    let rod = truth.system.rod().ok_or("no rod")?;
    let places = PLACES.map(|s| Marker { s, offset: Vector3::zeros() });
    let mut markers = Markers::new(&rod.parts.dynamics()?, &places)?;
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(&z, &mut x)?;
    let mut seen = String::from("time_s,marker,x_m,y_m,z_m\n");
    for k in 0..=truth.experiment.grid.steps {
        let (time, mut y) = (truth.experiment.grid.time(k), [0.0; 12]);
        markers.observe(At { step: k, time }, &x, &mut y)?;
        for (i, y) in y.chunks_exact(3).enumerate() {
            // what is kept back is the truth itself
            let noise = if i % 2 == 0 { 0.0 } else { NOISE[0] };
            let [a, b, c] = [0, 1, 2].map(|c| y[c] + noise * normal());
            writeln!(seen, "{time:.4},m{i},{a},{b},{c}")?;
        }
        if k < truth.experiment.grid.steps {
            model.step(k, &x, &mut next)?;
            std::mem::swap(&mut x, &mut next);
        }
    }
    folder.write("seen.csv", seen.as_bytes())?;
    folder.write("base.csv", what.rows(&mut normal).as_bytes())?;
    let sigma = format!("observations.sigma={}", NOISE[0]);
    let [smoothing, estimate] = what.keys();
    let of = |sets: &[&str]| -> Result<[f64; 2], Box<dyn std::error::Error>> {
        let ended = ended(&folder.scene(&what.scene(&smoothing), sets)?)?;
        let kept: Vec<_> = ended.observed.iter().filter(|o| o.reason == "withheld").collect();
        let sigmas: Option<Vec<f64>> = kept.iter().map(|o| o.sigma_analysis).collect();
        let sigmas = sigmas.ok_or("no σ of a withheld coordinate")?;
        let inside =
            |(o, s): &(&&varda::outcome::ObservedValue, &f64)| (o.value - o.analysis).abs() <= 1.96 * **s;
        let count = kept.len() as f64;
        let inside = kept.iter().zip(&sigmas).filter(inside).count() as f64 / count;
        Ok([inside, sigmas.iter().sum::<f64>() / count])
    };
    let common = [sigma.as_str(), "report.mesh=false", sets[0]];
    Ok([of(&common)?, of(&[&common[..], &[estimate.as_str()]].concat())?])
}

fn base(case: &mut Case, what: Recorded, seeds: u64) -> Outcome {
    let mut all = Vec::new();
    for seed in 0..seeds {
        all.push(covered(what, seed)?);
    }
    let count = all.len() as f64;
    let mean = |of: &dyn Fn(&[[f64; 2]; 2]) -> f64| all.iter().map(of).sum::<f64>() / count;
    let [without, with] = [0, 1].map(|i| mean(&|one| one[i][0]));
    let sigma = [0, 1].map(|i| 1e3 * mean(&|one| one[i][1]));
    let spread = (mean(&|one| (one[1][0] - with).powi(2)) / (count - 1.0)).sqrt();
    case.at_most("with errors of the base: covered, off 0.95", (with - 0.95).abs(), 0.02 + 3.0 * spread, "-")
        .because("coordinates kept back, pooled within a seed: three standard errors of seeds, and 2 %")
        .computed(with)
        .note(format!("mean σ {:.3} mm, {seeds} seeds", sigma[1]));
    case.at_most("without: covered", without, 0.8, "-")
        .because("σ that does not know of an error is too small: else this case shows nothing")
        .computed(without)
        .note(format!("mean σ {:.3} mm", sigma[0]));
    Ok(())
}

/// 3 cm beyond where the rod reaches from the recorded place: more than stretch and noise of the marker, and
/// about one σ of the base.
fn beyond(case: &mut Case) -> Outcome {
    let folder = Folder::new("beyond")?;
    folder.write("base.csv", Recorded::Places.rows(|| 0.0).as_bytes())?;
    let tip = moved(0.1) + Vector3::new(0.0, 0.0, 1.0 - PLACES[3] - 0.03);
    let row = format!("time_s,marker,x_m,y_m,z_m\n0.1,m3,{},{},{}\n", tip.x, tip.y, tip.z);
    folder.write("seen.csv", row.as_bytes())?;
    let refused = |sets: &[&str]| -> Result<bool, varda::Error> {
        let sets = [&["observations.sigma=0.0005"], sets].concat();
        let problem = Problem::from_scene(&folder.scene(&Recorded::Places.scene("cutoff = 20.0"), &sets)?);
        Ok(problem.is_err_and(|error| error.to_string().contains("reach")))
    };
    case.count("refused where the base is known", usize::from(refused(&[])?), 1);
    let known = refused(&["estimate.base={sigma=0.03}"])?;
    case.count("refused where it is uncertain", usize::from(known), 0);
    Ok(())
}

/// The parts of J add up, and σ given the constants is that of a run which knows them.
fn parts(case: &mut Case) -> Outcome {
    let sets = ["estimate.ei={sigma=\"30%\",together=true}", "report.mesh=false", "report.forecast=0.0"];
    let sets = sets.map(String::from);
    let with = ended(&SceneFile::open("hose", &sets)?)?;
    let sum: f64 = with.shares.iter().map(|share| share.j).sum();
    case.at_most("parts of J off J", (sum / with.analysis.value - 1.0).abs(), 1e-12, "-").because("a sum");
    let expected: Option<f64> = with.shares.iter().map(|share| share.expected).sum();
    let half = 0.5 * with.analysis.observations as f64;
    case.at_most("their means off m/2", (expected.ok_or("no mean")? / half - 1.0).abs(), 1e-12, "-")
        .because("an identity of the posterior");
    case.count("parts", with.shares.len(), 3);
    let ei = with.estimates[0].value;
    let known = format!("model.section.ei=[{ei:e},{ei:e}]");
    let known = ended(&SceneFile::open("hose", &[known, "report.forecast=0.0".into()])?)?;
    let n = known.trajectories.dim;
    let last = known.experiment.state.geometry.as_ref().ok_or("no rod")?.free.len() - 1;
    for (of, k) in with.with_constants_known.iter().zip([0, known.experiment.grid.steps]) {
        let sigma = &known.sigma_states[k * n + 3 * last..][..3];
        let sigma = sigma.iter().map(|s| s * s).sum::<f64>().sqrt();
        case.at_most(
            &format!("{} at {} s: σ given EI off that of a run that knows it", of.of, of.time),
            (of.sigma_known / sigma - 1.0).abs(),
            1e-5,
            "-",
        )
        .because("linearized about states that are as near as the two minimizations end")
        .note(format!("{:.4} mm, {:.4} mm with EI unknown", 1e3 * of.sigma_known, 1e3 * of.sigma));
        case.at_most("σ given EI over σ", of.sigma_known / of.sigma, 1.0, "-")
            .because("knowing more leaves less open");
    }
    case.count("times", with.with_constants_known.len(), 2);
    Ok(())
}

/// At p far from the prior J is a number, or the error says what failed.
fn extreme(case: &mut Case, times: f64) -> Outcome {
    let sets = [
        "time.window=10",
        "model.segments=19",
        "estimate.clamp_direction={sigma=0.05}",
        "estimate.base={sigma=0.001,correlation_time=0.1}",
        "report.forecast=0.0",
    ];
    let problem = Problem::from_scene(&gripped_cable(0.0, &sets)?)?;
    let constants = problem.experiment.state.constants.len();
    let (mut ran, mut refused, mut wrong) = (0, 0, 0);
    // each direction, and one error of each coordinate of a base
    for i in (0..6).chain([8, 8 + (constants - 6) / 6, 8 + (constants - 6) / 2]) {
        let mut model = problem.model();
        let mut z = problem.background.clone();
        let first = z.len() - constants;
        z[first + i] = times * if i < 6 { 0.05 } else { 0.001 };
        let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        let mut ended = model.initial_state(&z, &mut x);
        for k in 0..10 {
            if ended.is_ok() {
                ended = model.step(k, &x, &mut next).map(|_| std::mem::swap(&mut x, &mut next));
            }
        }
        match ended {
            Ok(()) => {
                ran += 1;
                wrong += usize::from(x.iter().any(|v| !v.is_finite()));
            }
            Err(error) => {
                refused += 1;
                wrong += usize::from(!error.to_string().contains("step"));
            }
        }
    }
    case.count("neither places nor an error that names its step", wrong, 0)
        .note(format!("{ran} ran, {refused} were refused"))
        .because("a right answer or a clear error");
    Ok(())
}
