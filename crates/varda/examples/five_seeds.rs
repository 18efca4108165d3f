//! One scene, five seeds: how much of the background's error is left? Shows a scene used from code, overrides
//! and all.
#![allow(clippy::print_stdout)]

use varda::run::{Listener, assimilate};
use varda::scene::SceneFile;
use varda::setup::Problem;

fn main() -> Result<(), varda::Error> {
    println!("seed  status      J before      J after   position error left  velocity error left  seconds");
    for seed in 0..5 {
        let file =
            SceneFile::open("hanging-rod-case2", &[format!("seed={seed}"), "report.posterior=false".into()])?;
        let problem = Problem::from_scene(&file)?;
        let outcome = assimilate(&problem, &mut Listener::silent())?;
        let left = |group: &str| {
            let rmse = outcome.rmse.of(group).and_then(|g| g.known());
            rmse.map_or(f64::NAN, |[before, after]| 100.0 * after / before)
        };
        println!(
            "{seed:>4}  {:<10}  {:>9.3}  {:>10.4}  {:>17.1} %  {:>17.1} %  {:>7.2}",
            outcome.status.name(),
            outcome.j_background,
            outcome.analysis.value,
            left("position"),
            left("velocity"),
            outcome.seconds.total,
        );
    }
    Ok(())
}
