//! Errors of the model in a weak-constraint run: their σ, the J_q to expect, and the guide to Q.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rod_scene::{Folder, NOTHING, ROD, SEEN};
use varda::outcome::Outcome;
use varda::report::Summary;
use varda::run::{Listener, assimilate, simulate};
use varda::setup::Problem;

/// A rod hanging from a clamp, for one second.
const HANGING: &str = r#"
[model.start]
position = [0.0, 0.0, 0.0]
tangent = [0.0, 0.0, -1.0]
director = [1.0, 0.0, 0.0]
[time]
integrator = "bdf2"
step = 0.02
window = 50
"#;

/// A wind that rises and falls, 0.1 N in all.
const WIND: &str =
    "time_s,fx_n,fy_n,fz_n\n0,0,0,0\n0.1,0.03,0,0\n0.5,0.05,0.01,0\n0.7,0.0,0.02,0\n1,0.04,0,0\n";

const Q: &str = r#"
[algorithm]
method = "weak-forcing"
[algorithm.model_error]
every = 5
[algorithm.model_error.covariance]
kind = "kernel"
sigma_x = 0.0005
sigma_v = 0.05
correlation_length_x = 0.25
correlation_length_v = 0.25
"#;

/// The rod in the wind, recorded at four places with σ = 2 mm, and the error of an analysis of it by a model
/// that knows no wind: rms of all vertices at all steps.
struct Windy {
    folder: Folder,
    truth: Vec<Vec<[f64; 3]>>,
}

impl Windy {
    fn new(case: &str) -> Self {
        let folder = Folder::new(case).with("seen.csv", NOTHING).with("wind.csv", WIND);
        let wind =
            r#"forces = [{ arc_length = 0.5, file = "wind.csv" }, { arc_length = 0.25, file = "wind.csv" }]"#;
        let windy = folder.scene(&format!("{ROD}{wind}{HANGING}{SEEN}"), &[]).unwrap();
        let run = simulate(&Problem::from_scene(&windy).unwrap()).unwrap();
        let (truth, places) =
            (run.shapes.unwrap().analysis, run.experiment.state.geometry.unwrap().arc_lengths);
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut rows = String::from("time_s,s_m,x_m,y_m,z_m\n");
        for (k, shape) in truth.iter().enumerate().skip(1).step_by(2) {
            for v in [2, 4, 6, 8] {
                let s = places[v];
                let x: Vec<f64> = (0..3).map(|c| shape[v][c] + 0.002 * normal(&mut rng)).collect();
                rows += &format!("{},{s},{},{},{}\n", 0.02 * k as f64, x[0], x[1], x[2]);
            }
        }
        Self { folder: folder.with("seen.csv", &rows), truth }
    }

    fn run(&self, method: &str, factor: f64) -> (f64, Outcome) {
        let sets: Vec<String> = ["x", "v"]
            .iter()
            .map(|group| {
                let sigma = if *group == "x" { 0.0005 } else { 0.05 };
                format!("algorithm.model_error.covariance.sigma_{group}={}", factor * sigma)
            })
            .collect();
        let scene = match method {
            "4dvar" => self.folder.scene(&format!("{ROD}{HANGING}{SEEN}"), &[]),
            _ => {
                let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
                self.folder.scene(&format!("{ROD}{HANGING}{SEEN}{Q}"), &sets)
            }
        };
        let problem = Problem::from_scene(&scene.unwrap()).unwrap();
        let outcome = assimilate(&problem, &mut Listener::silent()).unwrap();
        let analysis = &outcome.shapes.as_ref().unwrap().analysis;
        let (mut sum, mut count) = (0.0, 0);
        for (a, t) in analysis.iter().zip(&self.truth) {
            for (a, t) in a.iter().zip(t) {
                sum += (0..3).map(|c| (a[c] - t[c]).powi(2)).sum::<f64>();
                count += 1;
            }
        }
        ((sum / count as f64).sqrt(), outcome)
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

#[test]
fn the_guide_to_q_brings_the_error_down_to_the_best() {
    let windy = Windy::new("wind");
    let strong = windy.run("4dvar", 1.0).0;
    let tried = [1.0, 3.0, 10.0, 30.0].map(|factor| windy.run("weak", factor).0);
    let best = tried.iter().fold(f64::INFINITY, |best, e| best.min(*e));
    // Measured: strong 65 mm; 3.3, 2.7, 2.4 and 2.9 mm; with the guide 2.3 mm from either side.
    assert!(strong > 10.0 * best, "{strong} {tried:?}");
    for (wrong, said) in [(0.1, "too small"), (30.0, "too large")] {
        let (before, outcome) = windy.run("weak", wrong);
        let scale = outcome.model_errors.as_ref().unwrap().scale.unwrap();
        assert!(outcome.warnings.iter().any(|w| w.contains(said) && w.contains("try sigma_v = ")), "{wrong}");
        let (after, guided) = windy.run("weak", wrong * scale.factor);
        assert!(before > 1.15 * best && after <= 1.05 * best, "{wrong}: {before} -> {after}, {best}");
        let again = guided.model_errors.as_ref().unwrap().scale.unwrap();
        assert!(again.low <= 1.0 && 1.0 <= again.high, "{wrong}: {scale:?}, then {again:?}");
        assert!(!guided.warnings.iter().any(|w| w.contains("model error")), "{:?}", guided.warnings);
    }
}

#[test]
fn errors_are_written_with_their_sigma() {
    let windy = Windy::new("wind-files");
    let outcome = windy.run("weak", 10.0).1;
    let errors = outcome.model_errors.as_ref().unwrap();
    let n = errors.sigma_prior.len();
    // The last observation is at step 49, so that the last error enters at 45.
    assert_eq!((errors.steps.len(), errors.steps[8]), (9, [45, 45]));
    assert!(errors.sigma.iter().zip(errors.sigma_prior.iter().cycle()).all(|(a, q)| *a > 0.0 && a <= q));
    let out = windy.folder.path().join("out");
    varda::report::write(&outcome, &out).unwrap();
    let table = std::fs::read_to_string(out.join("model_error.csv")).unwrap();
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows[0], "error,first_step,last_step,time_s,name,unit,eta,sigma_q,sigma_eta");
    assert_eq!(rows.len(), 1 + 9 * n);
    let cells: Vec<&str> = rows[1 + n].split(',').collect();
    assert_eq!(cells[..3], ["1", "10", "10"]);
    assert_eq!(cells[6].parse::<f64>().unwrap().to_bits(), errors.values[n].to_bits());
    assert_eq!(cells[8].parse::<f64>().unwrap().to_bits(), errors.sigma[n].to_bits());
    let summary = Summary::new(&outcome).model_error.unwrap();
    assert_eq!((summary.count, summary.j_q), (9, outcome.analysis.terms.model_error));
    assert!(summary.j_q_expected.unwrap() > 1.0 && summary.sigma_factor_interval[1].is_some());
}

#[test]
fn sigma_is_known_along_window_and_forecast() {
    let windy = Windy::new("wind-sigma");
    let outcome = windy.run("weak", 10.0).1;
    let runs = &outcome.trajectories;
    assert_eq!(outcome.sigma_states.len(), runs.analysis.len());
    let sigma = |k: usize| runs.state(&outcome.sigma_states, k).unwrap();
    let start = &outcome.analysis.sigma_analysis;
    assert!(start.iter().zip(sigma(0)).all(|(a, s)| (a - s).abs() <= 1e-9 * a), "that of the initial state");
    // Every value has its σ; seen with 2 mm, the analysis is known better than that.
    let seen = |v: &varda::outcome::ObservedValue| v.sigma_analysis.unwrap();
    assert!(outcome.observed.iter().all(|v| seen(v) > 0.0 && seen(v) < 0.002));
    // Of the tip after the last observation, at step 49, an error of 5 mm/s at step 50 is to be expected too.
    let tip = outcome.experiment.state.groups[1].range.end - 1;
    assert!(sigma(50)[tip] > sigma(49)[tip], "{:?}", [sigma(49)[tip], sigma(50)[tip]]);
    let shapes = outcome.shapes.as_ref().unwrap();
    assert_eq!(shapes.sigma_forces.len(), shapes.forces.len());
    // The truth is known: of all vertices and steps about 95 % are within 1.96 σ.
    let (mut inside, mut count) = (0, 0);
    let free = &outcome.experiment.state.geometry.as_ref().unwrap().free;
    for (k, truth) in windy.truth.iter().enumerate() {
        for (i, v) in free.iter().enumerate() {
            for c in 0..3 {
                let off = shapes.analysis[k][*v][c] - truth[*v][c];
                inside += usize::from(off.abs() <= 1.96 * sigma(k)[3 * i + c]);
                count += 1;
            }
        }
    }
    let share = inside as f64 / count as f64;
    // one wind, not drawn from the Q assumed
    assert!((0.85..=1.0).contains(&share), "{share}");
}
