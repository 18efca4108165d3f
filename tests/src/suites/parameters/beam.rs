//! The modulus and the damping of a silicone beam, from a real recording of its release.
//!
//! The reference is a damped cosine fitted to the same rows, c + e^(−δt) (a cos ωt + b sin ωt), and
//! linear theory: ω² + δ² = ω₀² = β⁴ EI/(ρA L⁴) with β = 1.8751, and
//! δ = τ ω₀²/2 for strain-rate damping of time τ.

use varda::outcome::{Outcome as Ended, Verdict};
use varda::run::{Listener, assimilate};
use varda::scene::{SceneFile, shipped_data};
use varda::setup::Problem;

use crate::row::{Case, Outcome, Rows};
use crate::suites::Options;

/// Young's modulus [Pa] that the makers of the recording fitted with a simulator of their own.
const LISTED: f64 = 263_824.0;
/// The release in the recording [s], and the window from there.
const RELEASE: f64 = 0.65;
const WINDOW: f64 = 0.3;

pub(super) fn run(rows: &mut Rows, options: &Options) {
    rows.area("silicone beam");
    for (from, modulus, damping) in [("below", 0.7, 0.7), ("above", 1.3, 1.3)] {
        rows.case(&format!("modulus and damping from 30 % {from}"), |case| beam(case, modulus, damping));
    }
    if options.full {
        rows.case("with the σ of the cameras", cameras);
    }
}

/// Constants this many times the listed ones, markers on the tip known to 2 mm, the clamp to 0.03 rad.
fn ended(modulus: f64, damping: f64, sigma: f64) -> Result<Ended, varda::Error> {
    let sets = [
        format!("model.material.youngs_modulus={}", modulus * LISTED),
        format!("model.damping.stiffness={}", damping * 0.0022),
        "estimate.youngs_modulus={sigma=\"30%\"}".into(),
        "estimate.damping_stiffness={sigma=\"50%\"}".into(),
        "estimate.clamp_direction={sigma=0.03}".into(),
        "estimate.marker_offset={sigma=0.002}".into(),
        format!("observations.sigma={sigma:e}"),
        "report.mesh=false".into(),
    ];
    assimilate(&Problem::from_scene(&SceneFile::open("beam-release", &sets)?)?, &mut Listener::silent())
}

fn beam(case: &mut Case, modulus: f64, damping: f64) -> Outcome {
    let ended = ended(modulus, damping, 3e-4)?;
    let (omega, delta) = ring()?;
    let square = omega * omega + delta * delta;
    // EI/(ρA) = E h²/(12 ρ) of a square of side h
    let young = square * 0.10_f64.powi(4) / 1.875_104_f64.powi(4) * 12.0 * 1070.0 / (0.03 * 0.03);
    for (name, theory) in [("youngs_modulus", young), ("damping_stiffness", 2.0 * delta / square)] {
        let e = ended.estimates.iter().find(|e| e.name == name).ok_or(format!("no estimate of {name}"))?;
        let sigma = e.sigma.ok_or("no σ")?;
        case.at_most(&format!("{name}: off a damped cosine's"), (e.value - theory).abs() / sigma, 3.0, "σ")
            .because("linear theory and the frequency and decay of the same rows")
            .note(format!("{theory:.6}; {}", e.in_words()))
            .computed(e.value);
        case.at_most(&format!("{name}: σ"), sigma / e.value, if theory > 1.0 { 0.02 } else { 0.1 }, "-")
            .because("two periods, each to a few per cent of its swing");
        if name == "youngs_modulus" {
            // the distance to what is listed is not of the estimate: it is in the frequency
            case.inform("youngs_modulus: above what is listed", e.value / LISTED - 1.0, "-").note(format!(
                "{:.3} by the frequency of these rows, {:.3} Hz",
                young / LISTED - 1.0,
                omega / std::f64::consts::TAU
            ));
        }
    }
    case.at_most("does not fit", f64::from(u8::from(ended.judgement.verdict != Verdict::Fits)), 0.0, "-")
        .note(ended.judgement.text.clone())
        .because("σ of 0.3 mm is what the model errs by in the forecast");
    Ok(())
}

/// The cameras' noise is 8 μm at most; the model errs by more, and must not be believed to a part in 5000.
fn cameras(case: &mut Case) -> Outcome {
    let ended = ended(1.3, 1.3, 8e-6)?;
    case.at_most("said to fit", f64::from(u8::from(ended.judgement.verdict == Verdict::Fits)), 0.0, "-")
        .because("its σ of the modulus, 0.02 %, is not the error")
        .note(ended.judgement.text.clone());
    Ok(())
}

/// ω and δ of the three markers on the tip, upwards, within the window, by a search in halved steps.
fn ring() -> Result<(f64, f64), Box<dyn std::error::Error>> {
    let (_, text) = shipped_data("\"data/beam-release.csv\"").next().ok_or("no file")?;
    let mut markers = vec![Vec::new(); 3];
    for line in text.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let (t, marker) = (cells[0].parse::<f64>()? - RELEASE, cells[1].parse::<usize>()?);
        if marker < 3 && (-1e-9..=WINDOW + 1e-9).contains(&t) {
            markers[marker].push((t, cells[2].parse::<f64>()?));
        }
    }
    let misfit = |[omega, delta]: [f64; 2]| markers.iter().map(|rows| left(rows, omega, delta)).sum::<f64>();
    let mut at = [48.0, 2.5];
    let (mut least, mut step) = (misfit(at), 1.0);
    while step > 1e-4 {
        let around = [[step, 0.0], [-step, 0.0], [0.0, step], [0.0, -step]];
        let tried = around.map(|[a, b]| [at[0] + a, at[1] + b]);
        match tried.into_iter().find(|&p| misfit(p) < least) {
            Some(better) => (at, least) = (better, misfit(better)),
            None => step /= 2.0,
        }
    }
    Ok((at[0], at[1]))
}

/// What the best a, b and c leave of the squares, by Gram and Schmidt.
fn left(rows: &[(f64, f64)], omega: f64, delta: f64) -> f64 {
    let column = |f: &dyn Fn(f64) -> f64| rows.iter().map(|&(t, _)| f(t)).collect::<Vec<f64>>();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut columns = [
        column(&|_| 1.0),
        column(&|t| (-delta * t).exp() * (omega * t).cos()),
        column(&|t| (-delta * t).exp() * (omega * t).sin()),
        rows.iter().map(|&(_, x)| x).collect(),
    ];
    for i in 1..4 {
        let (before, rest) = columns.split_at_mut(i);
        for b in before {
            let share = dot(b, &rest[0]) / dot(b, b);
            rest[0].iter_mut().zip(b.iter()).for_each(|(c, b)| *c -= share * b);
        }
    }
    dot(&columns[3], &columns[3])
}
