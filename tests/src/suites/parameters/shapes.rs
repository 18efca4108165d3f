//! Shapes without times: constants of a rod at rest.

use problems::recordings::Wire;
use varda::outcome::{Estimated, Outcome as Ended, Verdict};
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;
use crate::suites::folder::Folder;

pub(super) fn run(rows: &mut Rows, options: &Options) {
    rows.area("shapes");
    rows.case("a cantilever by its formula", cantilever);
    rows.case("a twin's stiffness, curvature and clamp", |case| twin(case, options));
    // the best shape of the last is at the edge where the wire snaps into another: that takes a while
    let poses = ["white 0", "white 2", "black 2", "red 2", "black 0", "red 0"];
    for (i, pose) in poses.into_iter().enumerate().take(if options.full { 6 } else { 5 }) {
        rows.case(&format!("wire {pose}"), |case| wire(case, pose, i < 5));
    }
}

fn ended(scene: &SceneFile) -> Result<Ended, varda::Error> {
    assimilate(&Problem::from_scene(scene)?, &mut Listener::silent())
}

fn named<'a>(ended: &'a Ended, name: &str) -> Result<&'a Estimated, String> {
    ended.estimates.iter().find(|e| e.name == name).ok_or(format!("no estimate of {name}"))
}

/// z = −w s² (6 L² − 4 L s + s²)/24 EI, which sinks by 1.6 % of its length: of what is not linear
/// 10⁻⁴ of it is left.
fn cantilever(case: &mut Case) -> Outcome {
    const EI: f64 = 0.1;
    let (length, weight, sigma) = (0.3_f64, 0.05 * 9.81, 1e-4);
    let mut text = "s_m,x_m,y_m,z_m\n".to_string();
    for i in 1..=10 {
        let s = 0.03 * f64::from(i);
        let z = -weight * s * s * (6.0 * length * length - 4.0 * length * s + s * s) / (24.0 * EI);
        // ± σ in turn, so that the fit is neither too good nor by chance
        let off = |k: i32| if (i * k) % 3 == 0 { sigma } else { -0.6 * sigma };
        text += &format!("{s},{},{},{}\n", s + off(1), off(2), z + off(4));
    }
    let folder = Folder::new("shape-cantilever")?;
    folder.write("seen.csv", text.as_bytes())?;
    let scene = folder.scene(
        r#"
[model]
kind = "rod"
length = 0.3
segments = 30
gravity = [0.0, 0.0, -9.81]
section = { kind = "stiffness", ea = 1e4, ei = [0.05, 0.05], gj = 0.05, mass_per_length = 0.05 }
start = { position = [0.0, 0.0, 0.0], tangent = [1.0, 0.0, 0.0], director = [0.0, 0.0, 1.0] }
[observations]
kind = "file"
file = "seen.csv"
sigma = 1e-4
[estimate]
ei = { sigma = "50%", together = true }
[algorithm]
method = "static"
"#,
        &[],
    )?;
    let ended = ended(&scene)?;
    let e = named(&ended, "ei")?;
    let sigma = e.sigma.ok_or("no σ")?;
    case.at_most("EI: off the one of the formula", (e.value - EI).abs() / sigma, 3.0, "σ")
        .computed(e.value)
        .note(format!("{:.4} ± {sigma:.4} N m²", e.value))
        .because("3 σ");
    case.at_most("σ of it", sigma / EI, 0.03, "-").because("the tip sinks by 50 σ");
    fits(case, &ended);
    case.at_most("unknowns", ended.experiment.n_unknown() as f64, 1.0, "-")
        .because("places and velocities are none: the state is known");
    Ok(())
}

fn fits(case: &mut Case, ended: &Ended) {
    case.at_most("does not fit", f64::from(u8::from(ended.judgement.verdict != Verdict::Fits)), 0.0, "-")
        .note(ended.judgement.text.clone())
        .because("σ supposes a fit");
}

/// A rod with natural curvature, clamped a little askew, its constants drawn from their priors.
fn twin(case: &mut Case, options: &Options) -> Outcome {
    const SCENE: &str = r#"
[model]
kind = "rod"
length = 0.5
segments = 20
gravity = [0.0, 0.0, -9.81]
section = { kind = "stiffness", ea = 1e3, ei = [4e-3, 4e-3], gj = 3e-3, mass_per_length = 0.05 }
natural_curvature = [1.0, 0.5]
start = { position = [0.0, 0.0, 0.0], tangent = [1.0, 0.0, 0.0], director = [0.0, 0.0, 1.0] }
[background]
from = "truth-plus-draw"
covariance = { kind = "known" }
[observations]
kind = "synthetic"
places = [0.1, 0.2, 0.3, 0.4, 0.5]
steps = [0]
sigma = 0.002
[estimate]
ei = { sigma = "30%", together = true }
natural_curvature = { sigma = 0.5 }
clamp_direction = [{ sigma = 0.1 }, { sigma = 0.1 }, { sigma = 0.1 }]
[algorithm]
method = "static"
"#;
    let seeds = if options.full { 200 } else { 20 };
    let folder = Folder::new("shape-twin")?;
    let (mut inside, mut count, mut squares) = (0.0, 0.0, 0.0);
    for seed in 0..seeds {
        let ended = ended(&folder.scene(SCENE, &[&format!("seed={seed}")])?)?;
        for e in &ended.estimates {
            let (sigma, truth) = (e.sigma.ok_or("no σ")?, e.truth.ok_or("no truth")?);
            let [low, high] = e.interval.ok_or("no interval")?;
            count += 1.0;
            inside += f64::from(u8::from((low..=high).contains(&truth)));
            squares += ((e.value - truth) / sigma).powi(2);
        }
    }
    // constants of one seed are correlated: as good as one or two of their own
    let share = inside / count;
    let bound = 3.0 * (0.95_f64 * 0.05 / f64::from(seeds)).sqrt();
    case.at_most("covered, off 0.95", (share - 0.95).abs(), bound, "-")
        .computed(share)
        .note(format!("{count} constants of {seeds} seeds"))
        .because("three binomial σ of the seeds");
    case.inform("error over σ, rms", (squares / count).sqrt(), "-");
    Ok(())
}

/// EI of a wire from one shape; points 3 and 7 are kept back.
fn wire(case: &mut Case, pose: &str, settles: bool) -> Outcome {
    let Wire { csv, scene, ei } = Wire::of(pose).ok_or("no such wire")?;
    let folder = Folder::new(&format!("wire {pose}"))?;
    folder.write("seen.csv", csv.as_bytes())?;
    let ended = ended(&folder.scene(&scene, &[])?)?;
    let e = named(&ended, "ei")?;
    let sigma = e.sigma.ok_or("no σ")?;
    let words = e.in_words();
    case.inform("seconds", ended.seconds.total, "s").note(words.clone());
    if !settles {
        // near these constants the rod snaps into another shape: J has an edge, and it must be said
        let wrong = ended.judgement.verdict == Verdict::Fits && e.identifiable == Some(true);
        case.at_most("a value without a minimum", f64::from(u8::from(wrong)), 0.0, "-")
            .note(ended.judgement.text.clone())
            .because("not converged is no fit");
        return Ok(());
    }
    fits(case, &ended);
    case.at_most("EI: off what is listed for this wire", (e.value - ei).abs() / sigma, 3.0, "σ")
        .note(words)
        .because("3 σ");
    for w in &ended.withheld {
        case.at_most(&format!("{}: kept back, off", w.label), 1e3 * w.rms_analysis, 12.0, "mm")
            .note(format!("{:.1} mm before", 1e3 * w.rms_background))
            .because("three σ of 4 mm");
    }
    Ok(())
}
