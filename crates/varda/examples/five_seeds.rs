//! One scene, five seeds: how much of the background's error is left? Shows a scene used from code, overrides and all.
#![allow(clippy::print_stdout)]

use std::time::Instant;

use varda::run::window::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::problem::Problem;

fn main() -> Result<(), varda::Error> {
    println!("seed  status      J before      J after   position error left  velocity error left  seconds");
    for seed in 0..5 {
        let file =
            SceneFile::open("hanging-rod-case2", &[format!("seed={seed}"), "report.posterior=false".into()])?;
        let mut problem = Problem::from_scene(&file)?;
        let mut listener =
            Listener { on_iteration: &mut |_| {}, interrupted: &|| false, started: Instant::now() };
        let outcome = assimilate(&mut problem, &mut listener)?;
        let left =
            |after: Option<f64>, before: Option<f64>| after.unwrap_or(f64::NAN) / before.unwrap_or(f64::NAN);
        println!(
            "{seed:>4}  {:<10}  {:>9.3}  {:>10.4}  {:>17.1} %  {:>17.1} %  {:>7.2}",
            outcome.status.name(),
            outcome.j_background,
            outcome.analysis.value,
            100.0 * left(outcome.rmse.position_analysis, outcome.rmse.position_background),
            100.0 * left(outcome.rmse.velocity_analysis, outcome.rmse.velocity_background),
            outcome.seconds.total,
        );
    }
    Ok(())
}
