//! `[limits] memory`: the same analysis for less memory, and the run says what it did.

use std::time::Instant;

use varda::check::Plan;
use varda::problem::Problem;
use varda::run::{Listener, Outcome, assimilate};
use varda::scene::SceneFile;

fn open(memory: &str) -> Result<SceneFile, varda::Error> {
    SceneFile::open("lorenz63", &[format!("limits.memory=\"{memory}\"")])
}

fn assimilated(memory: &str) -> (Vec<String>, Outcome) {
    let mut problem = Problem::from_scene(&open(memory).unwrap()).unwrap();
    let mut listener =
        Listener { on_iteration: &mut |_| {}, interrupted: &|| false, started: Instant::now() };
    let outcome = assimilate(&mut problem, &mut listener).unwrap();
    (problem.left_out, outcome)
}

#[test]
fn a_memory_limit_changes_no_bit_of_the_analysis_and_is_reported() {
    let (left_out, unlimited) = assimilated("");
    assert!(!left_out.iter().any(|text| text.contains("limits.memory")));
    let (left_out, limited) = assimilated("1.5 kB");
    let said = left_out.iter().find(|text| text.contains("limits.memory")).unwrap();
    assert!(said.starts_with("all states but"), "{said}");
    assert_eq!(limited.analysis.analysis, unlimited.analysis.analysis);
    assert_eq!(limited.analysis.value.to_bits(), unlimited.analysis.value.to_bits());
    assert!(limited.counts.model_steps > unlimited.counts.model_steps);
    let plan = Plan::new(&open("1.5 kB").unwrap()).unwrap();
    assert!(plan.left_out.iter().any(|text| text.contains("limits.memory")), "{:?}", plan.left_out);
    assert!(plan.bytes < Plan::new(&open("").unwrap()).unwrap().bytes);
}

/// ε‖M‖ ≤ 1e-4 is about 22 time units here (growth exp(0.9 T)): a window of half a unit is reliable, one of 35 is not, and says so
/// wherever a run is reported.
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
        let mut problem = Problem::from_scene(&SceneFile::open("lorenz63", &sets).unwrap()).unwrap();
        let mut listener =
            Listener { on_iteration: &mut |_| {}, interrupted: &|| false, started: Instant::now() };
        let outcome = assimilate(&mut problem, &mut listener).unwrap();
        let found = outcome.amplification.unwrap();
        let exponent = found.norm.ln() / (0.01 * window as f64);
        assert!(reliable || (0.7..1.2).contains(&exponent), "growth exp({exponent} T)");
        assert_eq!(found.reliable, reliable, "{found:?}");
        // Its Hessian has entries of 1e30 and is indefinite by rounding: no posterior, but an analysis and the reason.
        assert_eq!(outcome.has_posterior, reliable);
        assert_eq!(outcome.warnings.iter().any(|w| w.starts_with("there is no posterior")), !reliable);

        varda::report::write(&mut problem, &outcome, &folder).unwrap();
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
    let error = Plan::new(&open("64 B").unwrap()).unwrap_err().to_string();
    assert!(error.contains("64 bytes are too few"), "{error}");
}
