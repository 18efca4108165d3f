//! `[limits]`: the same analysis for less memory, a run that ends in time, and iterations counted over all
//! that it does; the run says what it did.

use std::time::Instant;

use varda::outcome::Outcome;
use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Plan;
use varda::setup::Problem;

fn open(memory: &str) -> Result<SceneFile, varda::Error> {
    SceneFile::open("lorenz63", &[format!("limits.memory=\"{memory}\"")])
}

fn assimilated(memory: &str) -> (Vec<String>, Outcome) {
    let problem = Problem::from_scene(&open(memory).unwrap()).unwrap();
    let outcome = assimilate(&problem, &mut Listener::silent()).unwrap();
    (outcome.experiment.left_out.clone(), outcome)
}

#[test]
fn a_memory_limit_changes_no_bit_of_the_analysis_and_is_reported() {
    let (left_out, unlimited) = assimilated("");
    assert!(!left_out.iter().any(|text| text.contains("limits.memory")));
    let (left_out, limited) = assimilated("13.845 MB");
    let said = left_out.iter().find(|text| text.contains("limits.memory")).unwrap();
    assert!(said.starts_with("all states but"), "{said}");
    assert_eq!(limited.analysis.analysis, unlimited.analysis.analysis);
    assert_eq!(limited.analysis.value.to_bits(), unlimited.analysis.value.to_bits());
    assert!(limited.counts.model_steps > unlimited.counts.model_steps);
    let plan = Plan::new(&open("13.845 MB").unwrap()).unwrap();
    assert!(plan.left_out.iter().any(|text| text.contains("limits.memory")), "{:?}", plan.left_out);
    assert!(plan.bytes < Plan::new(&open("").unwrap()).unwrap().bytes);
}

/// ε‖M‖ ≤ 1e-4 is about 22 time units here (growth exp(0.9 T)): a window of half a unit is reliable,
/// one of 35 is not, and says so wherever a run is reported.
#[test]
fn a_window_beyond_the_horizon_of_its_gradient_is_flagged() {
    let folder = std::env::temp_dir().join(format!("varda-horizon-{}", std::process::id()));
    for (window, reliable) in [(50, true), (3500, false)] {
        let sets = [
            &format!("time.window={window}")[..],
            "algorithm.max_iterations=2",
            "algorithm.minimizer=trust-region",
        ]
        .map(String::from);
        let problem = Problem::from_scene(&SceneFile::open("lorenz63", &sets).unwrap()).unwrap();
        let outcome = assimilate(&problem, &mut Listener::silent()).unwrap();
        let found = outcome.amplification.unwrap();
        let exponent = found.norm.ln() / (0.01 * window as f64);
        assert!(reliable || (0.7..1.2).contains(&exponent), "growth exp({exponent} T)");
        assert_eq!(found.reliable, reliable, "{found:?}");
        // Its Hessian has entries of 1e30; the posterior comes from the singular values of G all the same.
        assert!(outcome.has_posterior, "{:?}", outcome.warnings);

        varda::report::write(&outcome, &folder).unwrap();
        let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&read("summary.json")).unwrap();
        assert_eq!(summary["amplification"]["reliable"], reliable);
        for told in [&read("report.html"), &read("summary.json")] {
            assert_eq!(told.contains("the window amplifies perturbations"), !reliable);
        }
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn an_amount_that_is_none_or_too_small_is_refused() {
    let error = open("plenty").unwrap_err().to_string();
    assert!(error.contains("limits.memory") || error.contains("amount of memory"), "{error}");
    // All but the window takes 13.8 MB of the program and 44.3 kB, most of it the observed values and the
    // table of states; one checkpoint 112 bytes and a linearization 96.
    let error = Plan::new(&open("64 B").unwrap()).unwrap_err().to_string();
    assert!(
        error.contains("this run takes about") && error.contains("more than the limit of 0.1 kB"),
        "{error}"
    );
    let error = Plan::new(&open("13.8446 MB").unwrap()).unwrap_err().to_string();
    assert!(error.contains("bytes are too few for this window"), "{error}");
}

/// Dense blocks of B, and a dense Hessian of 120 000 unknowns, are refused before anything is built, by
/// `check` and by `run` alike.
#[test]
fn a_scene_too_large_for_the_machine_is_refused_with_what_it_needs_and_the_limit() {
    let set = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        SceneFile::open("hanging-rod", &sets).unwrap()
    };
    let begun = Instant::now();
    let large = set(&["model.segments=20000", "algorithm.minimizer=newton"]);
    let planned = Plan::new(&large).unwrap_err().to_string();
    let run = Problem::from_scene(&large).err().unwrap().to_string();
    assert_eq!(planned, run);
    for part in ["takes about 468.", "dense Hessians and Jacobians", "limit of 8.0 GB", "[limits] memory"] {
        assert!(planned.contains(part), "{part:?} in {planned}");
    }
    // Another minimizer and no posterior, B alone: two blocks of 3.2 GB, and seven while they are built and
    // drawn from.
    let planned =
        Plan::new(&set(&["model.segments=20000", "report.posterior=false"])).unwrap_err().to_string();
    assert!(planned.contains("takes about 28.8 GB (the background covariance"), "{planned}");
    // Nothing of it was allocated: that would have taken minutes.
    assert!(begun.elapsed().as_secs() < 20);
    // A limit that is high enough is believed, for methods that cannot keep less too.
    let raised = SceneFile::open("lorenz96-4denvar", &["limits.memory=\"2 GB\"".to_string()]).unwrap();
    assert!(Plan::new(&raised).is_ok());
}

/// How far the memory of a run may be from what was said: 20 %, and 1.5 MB for the pages of the program's own
/// file, of which the system maps more or fewer from one run to the next.
fn bound(said: f64) -> f64 {
    0.2 * said + 1.5e6
}

/// What `check` says is what a run takes, small ones too.
#[test]
fn the_estimate_is_that_of_a_run() {
    let folder = std::env::temp_dir().join(format!("varda-peak-{}", std::process::id()));
    for sets in [
        &["hanging-rod", "model.segments=100"][..],
        &["hanging-rod", "model.segments=200", "report.posterior=false"],
        &["lorenz96", "model.variables=600"],
        &["burgers", "model.points=1000", "report.posterior=false"],
        &["hanging-rod"],
        &["lorenz63"],
    ] {
        let all = [&sets[1..], &["algorithm.minimizer=trust-region", "algorithm.max_iterations=1"]].concat();
        let file = SceneFile::open(sets[0], &all.iter().map(|s| s.to_string()).collect::<Vec<_>>()).unwrap();
        let planned = Plan::new(&file).unwrap().bytes as f64;
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_varda"));
        command.args(["run", sets[0], "--quiet", "--out"]).arg(&folder);
        command.args(all.iter().flat_map(|s| ["--set", s]));
        assert_eq!(command.status().unwrap().code(), Some(4), "one iteration is not enough");
        let text = std::fs::read_to_string(folder.join("summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
        // Only Linux tells.
        let Some(peak) = summary["peak_bytes"].as_f64() else { continue };
        assert!((peak - planned).abs() <= bound(planned), "{sets:?}: planned {planned:e}, held {peak:e}");
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Into how many parts steps are divided shows a run only; what each takes is said.
#[test]
fn divided_steps_are_part_of_the_plan() {
    let open = |sets: &[String]| Plan::new(&SceneFile::open("hanging-rod", sets).unwrap()).unwrap();
    assert_eq!(open(&[]).bytes_per_part, None);
    let divided = open(&["time.tolerance=1e-5".to_string()]);
    // 100 steps of one part each are in the figure.
    let part = divided.bytes_per_part.unwrap();
    assert!(part > 0 && divided.bytes > 100 * part, "{part} of {}", divided.bytes);
}

/// A run without end, and a sequence of windows, end at the time the scene allows with what is best.
#[test]
fn a_run_ends_when_its_seconds_are_over() {
    let sets = [
        "algorithm.minimizer=adam",
        "algorithm.gradient_tolerance=1e-30",
        "algorithm.max_iterations=1000000",
        "limits.seconds=0.3",
    ]
    .map(String::from);
    let began = Instant::now();
    let problem = Problem::from_scene(&SceneFile::open("hanging-rod-case4", &sets).unwrap()).unwrap();
    let mut listener = Listener::silent();
    let outcome = assimilate(&problem, &mut listener).unwrap();
    assert_eq!(outcome.status, varda::outcome::Status::Interrupted);
    assert!(outcome.late && began.elapsed().as_secs_f64() < 20.0);
    assert!(outcome.warnings.iter().any(|w| w.contains("limits.seconds")), "{:?}", outcome.warnings);
    let lowest = outcome.convergence.iter().map(|row| row.j).fold(f64::INFINITY, f64::min);
    assert!(outcome.analysis.value <= lowest && outcome.analysis.value < outcome.j_background);

    let folder = std::env::temp_dir().join(format!("varda-seconds-{}", std::process::id()));
    varda::report::write(&outcome, &folder).unwrap();
    let summary = std::fs::read_to_string(folder.join("summary.json")).unwrap();
    assert!(summary.contains("\"status\": \"interrupted\"") && summary.contains("limits.seconds"));
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(SceneFile::open("lorenz96", &["limits.seconds=0".to_string()]).is_err());
}

/// Sub-windows, σ stages and further starts share `max_iterations`.
#[test]
fn iterations_are_counted_over_all_that_a_run_does() {
    for (scene, set) in [
        ("lorenz63-window", "algorithm.minimizer=auto"),
        ("lorenz63-window", "algorithm.minimizer=trust-region"),
        ("lorenz63", "algorithm.sigma_stages=[10, 3, 1]"),
        ("hanging-rod-case4", "algorithm.minimizer=auto"),
    ] {
        for most in [1, 5] {
            let sets = [set.to_string(), format!("algorithm.max_iterations={most}")];
            let problem = Problem::from_scene(&SceneFile::open(scene, &sets).unwrap()).unwrap();
            let outcome = assimilate(&problem, &mut Listener::silent()).unwrap();
            assert!(outcome.iterations[0] <= most, "{scene}, {set}: {:?}", outcome.iterations);
            assert_eq!(outcome.status, varda::outcome::Status::MaxIterations, "{scene}, {set}");
            assert_eq!(outcome.convergence.last().unwrap().iteration, outcome.iterations[0]);
        }
    }
}

/// The most memory a run has resident \[bytes\], as the system counts it; 0 where it does not.
#[cfg(target_os = "linux")]
fn resident(arguments: &[&str]) -> f64 {
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_varda"));
    let folder = std::env::temp_dir().join(format!("varda-resident-{}", std::process::id()));
    command.args(arguments).arg("--out").arg(&folder);
    command.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::null());
    let mut child = command.spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0.0_f64;
    // The system's own high-water mark never falls: its last value is read within a few milliseconds of the
    // end, when results are written.
    while child.try_wait().unwrap().is_none() {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<f64>().ok());
        most = most.max(1024.0 * kilobytes.unwrap_or(0.0));
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let _ = std::fs::remove_dir_all(&folder);
    most
}

/// What `check` says is what a run of an ensemble takes, within 20 %.
#[cfg(target_os = "linux")]
#[test]
fn an_ensemble_takes_the_memory_that_is_said() {
    for set in ["model.variables=1000", "model.variables=600", "model.variables=40"] {
        let sets = [set.to_string()];
        let said = Plan::new(&SceneFile::open("lorenz96-4denvar", &sets).unwrap()).unwrap().bytes as f64;
        let taken = resident(&["run", "lorenz96-4denvar", "--quiet", "--set", set]);
        assert!((taken - said).abs() <= bound(said), "{set}: {said:e} said, {taken:e} taken");
    }
}
