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

#[test]
fn an_amount_that_is_none_or_too_small_is_refused() {
    let error = open("plenty").unwrap_err().to_string();
    assert!(error.contains("limits.memory") || error.contains("amount of memory"), "{error}");
    let error = Plan::new(&open("64 B").unwrap()).unwrap_err().to_string();
    assert!(error.contains("64 bytes are too few"), "{error}");
}
