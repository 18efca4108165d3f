//! σ along a whole sequence of windows: that of a single window, of an independent calculation, of the
//! members of an ensemble; in the tables and on the page; and that nobody pays who does not ask.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use varda::outcome::{CyclesOutcome, Status};
use varda::report::write_cycles;
use varda::run::cycles::{CycleListener, Sequence};
use varda::run::{Listener, assimilate};
use varda::scene::{SHIPPED, SceneFile};
use varda::setup::Problem;
use varda_implicit::{ControlMap, Error, Model, Work};

fn sequence(scene: &str, sets: &[&str]) -> Sequence {
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    Sequence::from_scene(&SceneFile::open(scene, &sets).unwrap()).unwrap().expect("cycles")
}

fn run(sequence: &Sequence) -> CyclesOutcome {
    sequence.run(sequence.start(), Vec::new(), &mut CycleListener::silent()).unwrap()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// The first window of a sequence is that of a run without cycles: the same σ of states and of what was
/// seen, to the last bit, of a rod whose B is the posterior before and of a model with static B.
#[test]
fn the_first_window_has_the_sigma_of_a_run_of_its_own() {
    let rod = SHIPPED.iter().find(|s| s.name == "hanging-rod-cycling").unwrap().text;
    let alone = &rod[..rod.find("[algorithm.cycles]").unwrap()];
    let alone = SceneFile::parse("alone", "alone.toml", alone, None, &[]).unwrap();
    let pairs = [
        (alone, sequence("hanging-rod-cycling", &["algorithm.cycles.count=3"])),
        (SceneFile::open("lorenz63", &[]).unwrap(), sequence("lorenz63", &["algorithm.cycles.count=3"])),
    ];
    for (alone, sequence) in pairs {
        let single = assimilate(&Problem::from_scene(&alone).unwrap(), &mut Listener::silent()).unwrap();
        let cycles = run(&sequence);
        assert_eq!(cycles.status, Status::Converged);
        assert!(!cycles.warnings.iter().any(|w| w.contains("σ is left out")), "{:?}", cycles.warnings);
        let shown = sequence.shift * cycles.trajectories.dim;
        assert_eq!(cycles.trajectories.analysis[..shown], single.trajectories.analysis[..shown]);
        assert_eq!(cycles.sigma_states.len(), cycles.trajectories.analysis.len());
        assert!(cycles.sigma_states.iter().all(|s| s.is_finite() && *s >= 0.0));
        assert_eq!(cycles.sigma_states[..shown], single.sigma_states[..shown], "{}", alone.name);
        let first = |v: &&varda::outcome::ObservedValue| v.time < cycles.cycles[1].time - 1e-9;
        let of_single: Vec<_> = single.observed.iter().filter(first).collect();
        let of_cycles: Vec<_> = cycles.observed.iter().filter(first).collect();
        assert!(!of_single.is_empty() && of_single.iter().all(|v| v.sigma_analysis.is_some()));
        assert_eq!(of_cycles, of_single, "{}", alone.name);
        // a value at the start of the second window was used by the first, and is shown once
        let all: usize = sequence.values().iter().sum();
        assert_eq!(cycles.observed.len(), all);
    }
}

/// In the second window σ is √diag(M P Mᵀ), P⁻¹ = B⁻¹ + Σ MᵀHᵀR⁻¹HM,
/// with M by differences of runs.
#[test]
fn sigma_of_a_later_window_is_that_of_differences() {
    let sequence = sequence("lorenz63", &["algorithm.cycles.count=2"]);
    let cycles = run(&sequence);
    let (row, window) = (&cycles.cycles[1], sequence.window);
    let states = |x: &[f64]| -> Vec<[f64; 3]> {
        let mut model = (sequence.problem.make_model)(row.first_step);
        let (mut all, mut x) = (vec![[x[0], x[1], x[2]]], x.to_vec());
        for k in 0..window {
            let mut next = vec![0.0; 3];
            model.step(k, &x, &mut next).unwrap();
            x = next;
            all.push([x[0], x[1], x[2]]);
        }
        all
    };
    // Central differences: an error of h² M'''/6 and of 1e-16/h, both about 1e-8 of M here.
    let h = 1e-4;
    let columns: Vec<Vec<[f64; 3]>> = (0..3)
        .map(|c| {
            let [ahead, behind] = [h, -h].map(|h| {
                let mut x = row.analysis.clone();
                x[c] += h;
                states(&x)
            });
            ahead.iter().zip(behind).map(|(a, b)| [0, 1, 2].map(|i| (a[i] - b[i]) / (2.0 * h))).collect()
        })
        .collect();
    // B = I; all three components seen with variance 2 every fifth step, the first of them by the window
    // before.
    let mut precision = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for k in (5..=window).step_by(5) {
        for (i, row) in precision.iter_mut().enumerate() {
            for (j, entry) in row.iter_mut().enumerate() {
                *entry += (0..3).map(|c| columns[i][k][c] * columns[j][k][c]).sum::<f64>() / 2.0;
            }
        }
    }
    let p = inverse(precision);
    for k in 0..=window {
        let at = (row.first_step + k) * 3;
        for c in 0..3 {
            let m = [0, 1, 2].map(|j| columns[j][k][c]);
            let variance: f64 =
                (0..3).flat_map(|i| (0..3).map(move |j| (i, j))).map(|(i, j)| m[i] * p[i][j] * m[j]).sum();
            let (sigma, expected) = (cycles.sigma_states[at + c], variance.sqrt());
            assert!((sigma - expected).abs() <= 1e-6 * expected, "step {k}, {c}: {sigma} and {expected}");
        }
    }
}

/// By cofactors.
fn inverse(a: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let cofactor = |i: usize, j: usize| {
        let [r, s] = [(i + 1) % 3, (i + 2) % 3];
        let [p, q] = [(j + 1) % 3, (j + 2) % 3];
        a[r][p] * a[s][q] - a[r][q] * a[s][p]
    };
    let det: f64 = (0..3).map(|j| a[0][j] * cofactor(0, j)).sum();
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| cofactor(j, i) / det))
}

/// At the end of the last window σ is what the row of that window says of its spread: that of the members;
/// of a propagated B, of which nothing is left out and which is not inflated, that of the next background.
#[test]
fn sigma_at_the_end_is_the_spread_of_the_last_window() {
    let few = ["background.covariance.steps=3000", "algorithm.cycles.spin_up=0", "algorithm.cycles.count=4"];
    let ensemble = sequence("lorenz96-cycling-4denvar", &few);
    let whole = ["algorithm.cycles.covariance=propagated", "algorithm.cycles.dropped_variance=0"];
    let propagated = sequence("lorenz96-cycling-4dvar", &[&few[..], &whole].concat());
    for sequence in [ensemble, propagated] {
        let cycles = run(&sequence);
        let last = &cycles.sigma_states[cycles.sigma_states.len() - cycles.trajectories.dim..];
        // the same sums in another order
        let spread = cycles.cycles.last().unwrap().spread[0];
        assert!((rms(last) - spread).abs() <= 1e-10 * spread, "{} and {spread}", rms(last));
        assert!(cycles.sigma_states.iter().all(|s| s.is_finite()));
    }
}

/// Weak windows, and strong ones whose model errs: σ of every step, and wider where the model is said to
/// err.
#[test]
fn windows_of_a_model_that_errs_have_sigma_too() {
    let few = [
        "background.covariance.steps=3000",
        "algorithm.cycles.spin_up=0",
        "algorithm.cycles.count=3",
        "algorithm.cycles.covariance=propagated",
    ];
    let errs = ["algorithm.model_error={ every = 4, covariance = { kind = \"diagonal\", sigma = 0.1 } }"];
    let right = run(&sequence("lorenz96-cycling-4dvar", &few));
    for method in ["algorithm.method=4dvar", "algorithm.method=weak-forcing"] {
        let cycles = run(&sequence("lorenz96-cycling-4dvar", &[&few[..], &errs, &[method]].concat()));
        assert_eq!(cycles.sigma_states.len(), cycles.trajectories.analysis.len(), "{:?}", cycles.warnings);
        let [erring, right] = [&cycles, &right].map(|c| rms(&c.sigma_states));
        assert!(erring > right && erring.is_finite(), "{method}: {erring} and {right}");
    }
}

#[test]
fn tables_and_page_show_it() {
    let folder = Folder::new("shown");
    let sets = ["algorithm.cycles.count=2", "algorithm.cycles.spin_up=0"];
    let mut cycles = run(&sequence("hanging-rod-cycling", &sets));
    write_cycles(&cycles, &folder.0.join("r")).unwrap();
    let trajectory = folder.read("r/trajectory.csv");
    let header = trajectory.lines().next().unwrap();
    assert!(header.ends_with(",sigma_x_m,sigma_y_m,sigma_z_m,sigma_vx_m_s,sigma_vy_m_s,sigma_vz_m_s"));
    let cells = header.split(',').count();
    // the clamp holds vertices 0 and 1, whose velocities are no numbers of the state
    let free = |line: &&str| line.split(',').nth(2).is_some_and(|v| v.parse::<usize>().is_ok_and(|v| v > 1));
    let lines: Vec<&str> = trajectory.lines().filter(free).collect();
    assert_eq!(lines.len(), (cycles.experiment.grid.steps + 1) * 24);
    let whole = |line: &&str| line.split(',').count() == cells && line.split(',').all(|c| !c.is_empty());
    assert!(lines.iter().all(whole));
    let observations = folder.read("r/observations.csv");
    assert!(observations.lines().next().unwrap().contains("sigma_h_analysis"));
    assert_eq!(observations.lines().count(), 1 + cycles.observed.len());
    let page = folder.read("r/report.html");
    assert!(page.contains("The whole recording with ±2σ") && page.contains("±2σ around it"));
    // of the free end and of four markers, three axes each
    assert_eq!(page.matches("\"label\":\"analysis ± 2σ\"").count(), 15);
    assert!(page.contains("\"name\":\"σ of place\""));

    // A window of which σ is not known has empty cells, and no band.
    let known = 10 * cycles.trajectories.dim;
    cycles.sigma_states[known..].fill(f64::NAN);
    write_cycles(&cycles, &folder.0.join("r")).unwrap();
    let trajectory = folder.read("r/trajectory.csv");
    for line in trajectory.lines().filter(free) {
        let [step, sigma] = [0, cells - 1].map(|c| line.split(',').nth(c).unwrap());
        assert_eq!(sigma.is_empty(), step.parse::<usize>().unwrap() >= 10, "{line}");
    }
    let page = folder.read("r/report.html");
    assert_eq!(page.matches("\"label\":\"analysis ± 2σ\"").count(), 15, "of the end up to there");
}

#[test]
fn without_a_posterior_nothing_is_shown_and_nothing_is_paid() {
    let counted = |sets: &[&str]| {
        let mut sequence = sequence("lorenz63", sets);
        let calls: Arc<[AtomicUsize; 3]> = Arc::default();
        let (make, counter) = (sequence.problem.make_model, Arc::clone(&calls));
        sequence.problem.make_model =
            Box::new(move |k| Box::new(Counted { model: make(k), calls: Arc::clone(&counter) }));
        let cycles = run(&sequence);
        let calls = [0, 1, 2].map(|i| calls[i].load(Ordering::Relaxed));
        (cycles, calls)
    };
    let count = "algorithm.cycles.count=3";
    let (with, calls_with) = counted(&[count]);
    let (without, calls) = counted(&[count, "report.posterior=false"]);
    assert!(without.sigma_states.is_empty() && without.warnings == with.warnings);
    assert!(without.observed.iter().all(|v| v.sigma_analysis.is_none() && v.analysis.is_finite()));
    assert_eq!(with.trajectories, without.trajectories, "σ changes no bit of the analyses");
    assert_eq!(with.counts(), without.counts(), "those of the minimizations");
    // Without σ a model is called for the minimizations and, of the last window, for `amplification`: four
    // tangents a step.
    let [_, tangents, adjoints] = calls;
    assert!(without.amplification.is_some());
    assert_eq!(adjoints, without.counts().adjoint_steps);
    assert_eq!(tangents, without.counts().tangent_steps + 4 * without.window);
    assert!(calls_with[1] > tangents && calls_with[0] > calls[0], "{calls_with:?} and {calls:?}");
    let folder = Folder::new("without");
    write_cycles(&without, &folder.0.join("r")).unwrap();
    assert!(!folder.read("r/trajectory.csv").lines().next().unwrap().contains("sigma"));
    assert!(!folder.read("r/report.html").contains("analysis ± 2σ"));
}

/// A model that counts calls of steps, tangents (by columns) and adjoints.
struct Counted {
    model: Box<dyn Model + Send>,
    calls: Arc<[AtomicUsize; 3]>,
}

impl Counted {
    fn count(&self, what: usize, columns: usize) {
        self.calls[what].fetch_add(columns, Ordering::Relaxed);
    }
}

impl Model for Counted {
    fn dim(&self) -> usize {
        self.model.dim()
    }

    fn step(&mut self, k: usize, x: &[f64], x_next: &mut [f64]) -> Result<Work, Error> {
        self.count(0, 1);
        self.model.step(k, x, x_next)
    }

    fn linearize(&mut self, slot: usize, k: usize, x: &[f64], x_next: &[f64]) -> Result<Work, Error> {
        self.model.linearize(slot, k, x, x_next)
    }

    fn tangent(&mut self, slot: usize, dx: &mut [f64]) {
        self.count(1, dx.len() / self.model.dim());
        self.model.tangent(slot, dx);
    }

    fn adjoint(&mut self, slot: usize, lambda: &mut [f64]) {
        self.count(2, lambda.len() / self.model.dim());
        self.model.adjoint(slot, lambda);
    }

    fn release(&mut self, from_slot: usize) {
        self.model.release(from_slot);
    }

    fn slot_bytes(&self) -> usize {
        self.model.slot_bytes()
    }

    fn bytes(&self) -> usize {
        self.model.bytes()
    }

    fn control_map(&mut self) -> Option<&mut dyn ControlMap> {
        self.model.control_map()
    }
}

/// A folder of its own for a test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("varda-cycles-sigma-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn read(&self, file: &str) -> String {
        std::fs::read_to_string(self.0.join(file)).unwrap_or_else(|e| panic!("{file}: {e}"))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
