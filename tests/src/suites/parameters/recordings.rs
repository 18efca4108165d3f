//! Several recordings in one estimate.

use varda::outcome::{Estimated, JointOutcome, Verdict};
use varda::run::{Listener, assimilate, assimilate_recordings};
use varda::scene::{STARTER, SceneFile, shipped_scene};
use varda::setup::{Problem, Recordings};

use crate::row::{Case, Outcome, Rows};

pub(super) fn run(rows: &mut Rows, quick: bool) {
    rows.area("several recordings");
    rows.case("hose: the same recording twice", |case| twice(case, "{}", [1e-4, 1e-3]));
    rows.case("hose: two windows", |case| twice(case, "{ time_zero = 1.0 }", [1e-3, 0.05]));
    let seeds = if quick { 20 } else { 200 };
    rows.case("two runs of a driven rod: 95 % intervals", |case| covered(case, seeds));
}

fn joint(file: &SceneFile) -> Result<JointOutcome, varda::Error> {
    assimilate_recordings(&Recordings::from_scene(file)?, &mut Listener::silent())
}

/// The hose with EI 17 % too small, and recordings.
fn hose(recordings: &str, sets: &[&str]) -> Result<SceneFile, varda::Error> {
    let text = shipped_scene("hose")?.text;
    let text = format!("{text}\n[estimate]\nei = {{ sigma = \"30%\", together = true }}\n{recordings}");
    let common =
        ["model.section.ei=[0.25,0.25]", "report.mesh=false", "report.forecast=0.0", "time.window=50"];
    let sets: Vec<String> = common.iter().chain(sets).map(|s| s.to_string()).collect();
    SceneFile::parse("hose", "hose.toml", &text, None, &sets)
}

/// ln of EI over its prior's, and σ of it.
fn logarithm(e: &Estimated) -> Result<[f64; 2], String> {
    Ok([(e.value / e.prior).ln(), e.sigma.ok_or("no σ")? / e.value])
}

/// Precisions w = 1/σ² add, the prior's once: w = w₁ + w₂ − w_b, and w p = w₁ p₁ + w₂ p₂.
fn twice(case: &mut Case, second: &str, bounds: [f64; 2]) -> Outcome {
    let prior = 0.3_f64;
    let alone = |observations: &str| -> Result<[f64; 2], Box<dyn std::error::Error>> {
        let zero = if observations == "{}" { 0.0 } else { 1.0 };
        let file = hose("", &[&format!("observations.time_zero={zero:?}")])?;
        let ended = assimilate(&Problem::from_scene(&file)?, &mut Listener::silent())?;
        Ok(logarithm(&ended.estimates[0])?)
    };
    let [p1, s1] = alone("{}")?;
    let [p2, s2] = alone(second)?;
    let recordings = format!(
        "[[recordings]]\nname = \"first\"\n[[recordings]]\nname = \"second\"\nobservations = {second}\n"
    );
    let both = joint(&hose(&recordings, &[])?)?;
    let [p, s] = logarithm(&both.estimates[0])?;
    let [w1, w2] = [s1, s2].map(|s| s.powi(-2));
    let precision = w1 + w2 - prior.powi(-2);
    let expected = (p1 * w1 + p2 * w2) / precision;
    case.at_most(
        "σ of ln EI off the combination of two Gaussians",
        (s * precision.sqrt() - 1.0).abs(),
        bounds[0],
        "-",
    )
    .because("σ is that of a linearization, at points that are less than a few σ apart")
    .computed(s)
    .note(format!("{s:.3e} of both, {s1:.3e} and {s2:.3e} alone"));
    case.at_most("ln EI off the combination", (p - expected).abs() / s, bounds[1], "σ")
        .because("the same")
        .computed(both.estimates[0].value)
        .note(both.estimates[0].in_words());
    let fits = both.judgement.verdict == Verdict::Fits;
    case.at_most("does not fit", f64::from(u8::from(!fits)), 0.0, "-")
        .because("the recordings are of one hose")
        .note(both.judgement.text);
    Ok(())
}

/// Modulus, damping and curvature of a rod in two runs that start at other times of its drive.
fn covered(case: &mut Case, seeds: u64) -> Outcome {
    let text = format!(
        "{STARTER}\n[estimate]\nyoungs_modulus = {{ sigma = \"15%\" }}\n\
         damping_stiffness = {{ sigma = \"30%\" }}\nnatural_curvature = {{ sigma = 0.2 }}\n\
         [[recordings]]\nname = \"a\"\n[[recordings]]\nname = \"b\"\ntime = {{ spin_up = 37 }}\n"
    );
    let (mut inside, mut count, mut squares) = (0.0, 0.0, 0.0);
    for seed in 0..seeds {
        let sets = ["model.damping={stiffness=0.01,mass=0.5}".to_string(), format!("seed={seed}")];
        let ended = joint(&SceneFile::parse("several", "several.toml", &text, None, &sets)?)?;
        for e in &ended.estimates {
            let (truth, [low, high]) = (e.truth.ok_or("no truth")?, e.interval.ok_or("no σ")?);
            count += 1.0;
            inside += f64::from(u8::from((low..=high).contains(&truth)));
            squares += ((e.value - truth) / e.sigma.ok_or("no σ")?).powi(2);
        }
    }
    // constants of one seed are correlated: as good as one of their own
    let share = inside / count;
    let bound = 0.02 + 3.0 * (0.95_f64 * 0.05 / seeds as f64).sqrt();
    case.at_most("covered, off 0.95", (share - 0.95).abs(), bound, "-")
        .computed(share)
        .note(format!("{count} constants of {seeds} seeds"))
        .because("95 ± 2 % within three binomial σ of the seeds");
    case.inform("error over σ, rms", (squares / count).sqrt(), "-");
    Ok(())
}
