//! `[observations.correlation]`: errors correlated along a rod or line, or in time.

#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::{Folder, ROD, SEEN};
use varda::outcome::{ObservedValue, Outcome, Verdict};
use varda::run::{Listener, assimilate};
use varda::scene::{SHIPPED, SceneFile};
use varda::setup::{Inputs, Problem};
use varda_covariance::{Dense, Precision};

/// A linear problem: what is seen of a field that is carried along. Its posterior is exact.
const FIELD: &str = r#"
[model]
kind = "linear-advection"
points = 24
speed = 1.0
diffusivity = 0.01
fixed_ends = [0.0, 0.0]
[time]
integrator = "midpoint"
step = 0.01
window = 30
[background]
from = "truth-plus-draw"
covariance = { kind = "line", sigma = 0.3, correlation_length = 0.2 }
[observations]
kind = "synthetic"
components = [5, 11, 17, 20]
every = 1
sigma = 0.1
"#;

fn run(problem: &Problem) -> Outcome {
    assimilate(problem, &mut Listener::silent()).unwrap()
}

fn problem(text: &str, seed: u64, sets: &[&str]) -> Problem {
    let mut all: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    all.push(format!("seed={seed}"));
    Problem::from_scene(&SceneFile::parse("s", "s.toml", text, None, &all).unwrap()).unwrap()
}

/// Components within 1.96 σ_a of the truth, and Σ 2J, over seeds.
#[derive(Default)]
struct Tally {
    within: usize,
    components: usize,
    twice_j: f64,
    values: usize,
    fits: usize,
}

impl Tally {
    fn add(&mut self, problem: &Problem) {
        let outcome = run(problem);
        let (truth, analysis) = (problem.truth.as_ref().unwrap(), &outcome.analysis);
        let sigma = &analysis.sigma_analysis;
        let errors = truth.iter().zip(&analysis.analysis).map(|(t, x)| (x - t).abs());
        self.within += errors.zip(sigma).filter(|(e, s)| *e <= 1.96 * **s).count();
        self.components += truth.len();
        self.twice_j += 2.0 * analysis.value;
        self.values += problem.observations().unwrap().dim();
        self.fits += usize::from(outcome.judgement.verdict == Verdict::Fits);
    }

    fn coverage(&self) -> f64 {
        self.within as f64 / self.components as f64
    }

    fn chi2(&self) -> f64 {
        self.twice_j / self.values as f64
    }
}

/// Twins whose errors are correlated: with the key intervals cover 95 % and 2J/m is 1; without it, of the
/// same values, the intervals are too narrow.
#[test]
fn intervals_cover_with_the_key_and_not_without() {
    let time: &[&str] = &["observations.correlation={ time = 0.3 }"];
    // errors as smooth as the field itself, twice in the window
    let length: &[&str] = &[
        "observations.correlation={ length = 2.0, kernel = \"matern-3/2\" }",
        "observations.components=[]",
        "observations.every=15",
        "background.covariance.correlation_length=1.0",
    ];
    for keys in [time, length] {
        let key = keys[0];
        let (mut with, mut without) = (Tally::default(), Tally::default());
        const SEEDS: u64 = 20;
        for seed in 0..SEEDS {
            let known = problem(FIELD, seed, keys);
            let mut unknown = problem(FIELD, seed, &keys[1..]);
            unknown.observed.seen.clone_from(&known.observed.seen);
            with.add(&known);
            without.add(&unknown);
        }
        // E 2J = m for a linear problem, with a deviation of √(2/m)
        let four_sigma = 4.0 * (2.0 / with.values as f64).sqrt();
        assert!((with.chi2() - 1.0).abs() <= four_sigma, "{key}: {} ± {four_sigma}", with.chi2());
        // 24 components of a field are some 5 independent ones: 3 √(0.95 · 0.05 / 100) = 0.065
        assert!((with.coverage() - 0.95).abs() <= 0.065, "{key}: {}", with.coverage());
        assert!(with.fits as u64 >= SEEDS - 1, "{key}: {} of {SEEDS} fit", with.fits);
        assert!(without.coverage() < 0.8, "{key}: {} without it", without.coverage());
    }
}

/// Every method that takes the key gives the same analysis of a linear problem.
#[test]
fn every_method_carries_it() {
    let key = "observations.correlation={ time = 0.05, kernel = \"matern-3/2\" }";
    let of = |method: &str, more: &[&str]| {
        let mut sets = vec![key.to_string(), format!("algorithm.method={method}")];
        sets.extend(more.iter().map(|s| s.to_string()));
        let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
        run(&problem(FIELD, 3, &sets)).analysis
    };
    let first = of("4dvar", &[]);
    let minimizers = ["trust-region", "gauss-newton-cg", "newton", "lbfgs"];
    let by_minimizer = minimizers.map(|m| of("4dvar", &[&format!("algorithm.minimizer={m}")]));
    let others = ["4dvar-incremental", "4d-psas"].map(|method| of(method, &[]));
    for (name, other) in minimizers.iter().zip(&by_minimizer).chain(["inner", "dual"].iter().zip(&others)) {
        for (a, b) in first.analysis.iter().zip(&other.analysis) {
            // gradients fall by 1e-6 to 1e-8 of the first; components are of size 0.3
            assert!((a - b).abs() <= 1e-5, "{name}: {a} {b}");
        }
        assert!((first.value - other.value).abs() <= 1e-6 * first.value, "{name}");
    }
}

/// J before and after is that of the dense R, whatever the method, along the line and in time: ½ dᵀR⁻¹d
/// of the values of both runs.
#[test]
fn j_of_every_method_is_that_of_the_dense_covariance() {
    let error = "algorithm.model_error={ every = 6, covariance = { kind = \"line\", sigma = 0.05, \
                 correlation_length = 0.2 } }";
    let members = "algorithm.ensemble={ members = 12, localization_length = 0.5 }";
    let methods: [(&str, &[&str]); 9] = [
        ("4dvar", &[]),
        ("4dvar-incremental", &[]),
        ("4d-psas", &[]),
        ("blue", &[]),
        ("weak-forcing", &[error]),
        ("weak-state", &[error]),
        ("4denvar", &[members]),
        ("hybrid-4denvar", &[members]),
        ("psas", &["time.window=0"]),
    ];
    // of one instant
    let at_once = FIELD.replace("every = 1", "steps = [0]");
    for key in ["{ time = 0.05 }", "{ length = 0.3, kernel = \"matern-3/2\" }"] {
        for (method, more) in methods {
            let mut sets =
                vec![format!("observations.correlation={key}"), format!("algorithm.method={method}")];
            sets.extend(more.iter().map(|s| s.to_string()));
            let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
            let problem = problem(if method == "psas" { &at_once } else { FIELD }, 3, &sets);
            let outcome = run(&problem);
            let set = problem.observations().unwrap();
            let (m, r) = (set.dim(), set.error_covariance());
            let dense = Dense::new(m, &r).unwrap();
            // values are draws: each stands for itself
            let of = |y: &f64| outcome.observed.iter().find(|o| o.value == *y).unwrap();
            let half = |h: &dyn Fn(&ObservedValue) -> f64| {
                let d: Vec<f64> = set.values().iter().map(|y| y - h(of(y))).collect();
                let mut solved = vec![0.0; m];
                dense.solve(&d, &mut solved);
                0.5 * d.iter().zip(&solved).map(|(d, s)| d * s).sum::<f64>()
            };
            let (before, after) = (half(&|o| o.background), half(&|o| o.analysis));
            // R has a condition number below 1e4
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-9 * b;
            assert!(near(outcome.j_background, before), "{method}: {} {before}", outcome.j_background);
            let j_o = outcome.analysis.terms.observation;
            assert!(near(j_o, after), "{method} {key}: {j_o} {after}");
            assert!(after < before, "{method} {key}: {before} {after}");
        }
    }
}

#[test]
fn a_rod_has_chains_of_each_axis() {
    let file = "time_s,s_m,x_m,y_m,z_m\n0.1,0.2,0.01,,0.8\n0.1,0.4,0.01,0.0,0.6\n0.1,0.5,0.0,0.0,0.5\n\
                0.2,0.4,0.01,0.0,0.6\n";
    let clamp = "start = { position = [0.0, 0.0, 1.0], tangent = [0.0, 0.0, -1.0], director = [1.0, 0.0, \
                 0.0] }\n[time]\nintegrator = \"bdf2\"\nstep = 0.01\nwindow = 30\n";
    let folder = Folder::new("correlated-rod").with("seen.csv", file);
    let scene = |key: &str| folder.scene(&format!("{ROD}{clamp}{SEEN}"), &[key]);
    let inputs = Inputs::read(&scene("observations.correlation={ length = 0.1 }").unwrap()).unwrap();
    let set = inputs.observed.set(&inputs.grid).unwrap();
    let (m, r) = (set.dim(), set.error_covariance());
    // rows: x z of 0.2; x y z of 0.4; x y z of 0.5; x y z of 0.4 later
    let k = |d: f64| 4e-6 * (-d / 0.1_f64).exp();
    for (i, j, expected) in [
        (0, 0, 4e-6),
        (0, 2, k(0.2)),
        (0, 5, k(0.3)),
        (1, 4, k(0.2)),
        (3, 6, k(0.1)),
        (0, 1, 0.0),
        (2, 8, 0.0),
    ] {
        assert!((r[i + j * m] - expected).abs() <= 1e-18, "{i} {j}: {}", r[i + j * m]);
    }
    let inputs = Inputs::read(&scene("observations.correlation={ time = 0.1 }").unwrap()).unwrap();
    let set = inputs.observed.set(&inputs.grid).unwrap();
    let r = set.error_covariance();
    assert!((r[2 + 8 * m] - k(0.1)).abs() <= 1e-18 && r[2] == 0.0, "{}", r[2 + 8 * m]);
}

#[test]
fn what_cannot_carry_it_says_so() {
    let refused = |scene: &str, sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        SceneFile::open(scene, &sets).and_then(|file| Inputs::read(&file)).err().map(|e| e.to_string())
    };
    let time = "observations.correlation={ time = 0.1 }";
    let cases: [(&str, &[&str], &str); 7] = [
        ("lorenz96", &["observations.correlation={}"], "needs `length` or `time`"),
        ("lorenz96", &["observations.correlation={ length = 1.0 }"], "no line"),
        ("lorenz96", &["observations.correlation={ length = 1.0, time = 1.0 }"], "time"),
        ("linear-advection", &["observations.correlation={ length = 1.0 }"], "closes to a circle"),
        ("hanging-rod-case1", &[time, "algorithm.background_check=3.0"], "independent errors"),
        ("hanging-rod-cycling", &[time], "one window to the next"),
        ("hose", &["observations.correlation={ time = 0.1, kernel = \"gaussian\" }"], "no inverse"),
    ];
    for (scene, sets, words) in cases {
        let message = refused(scene, sets).unwrap_or_default();
        assert!(message.contains(words), "{scene} {sets:?}: {message:?}");
    }
    assert!(SHIPPED.iter().any(|s| s.name == "hose"));
    assert_eq!(refused("hose", &[time]), None);
}
