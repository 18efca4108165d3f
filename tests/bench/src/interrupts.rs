//! How soon Ctrl-C ends a run that is in a long calculation.

use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::{Options, Page, Result, Table};
use crate::cells;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

/// Signals a run, each in a process of its own.
const SIGNALS: usize = 4;
/// A run that lasts longer is not waited for to its end \[s\].
const LONGEST: f64 = 15.0;

/// A name, a scene, keys that are set.
type Run = (&'static str, &'static str, &'static [&'static str]);

const ALL: &str = "observations.components=[]";
const SOON: &str = "algorithm.max_iterations=2";

const RUNS: &[Run] = &[
    (
        "posterior from a dense Hessian, 3000 unknowns",
        "lorenz96",
        &["model.variables=3000", ALL, "algorithm.minimizer=lbfgs", SOON],
    ),
    (
        "dense Newton, 4000 unknowns",
        "lorenz96",
        &["model.variables=4000", ALL, "algorithm.minimizer=newton", SOON],
    ),
    (
        "posterior from singular values, 3000 unknowns, 2000 values",
        "lorenz96",
        &["model.variables=3000", ALL, "observations.every=12", "algorithm.method=4d-psas", SOON],
    ),
    (
        "closed form, 1500 unknowns, 6000 values",
        "lorenz96",
        &["model.variables=1500", ALL, "algorithm.method=blue"],
    ),
    (
        "weak constraint, 1500 unknowns, 1200 values",
        "lorenz96",
        &[
            "model.variables=300",
            ALL,
            "algorithm.method=weak-forcing",
            "algorithm.minimizer=lbfgs",
            "algorithm.model_error={ every = 4, covariance = { kind = \"diagonal\", sigma = 0.1 } }",
            SOON,
        ],
    ),
    (
        "hybrid ensemble, 1000 variables, 4000 values",
        "lorenz96",
        &[
            "model.variables=1000",
            ALL,
            "algorithm.method=hybrid-4denvar",
            "algorithm.ensemble={ members = 20 }",
        ],
    ),
    (
        "ensemble of 400 members, 4000 variables",
        "lorenz96",
        &["model.variables=4000", "algorithm.method=4denvar", "algorithm.ensemble={ members = 400 }"],
    ),
    ("rod of 300 segments", "hanging-rod", &["model.segments=300", SOON, "algorithm.minimizer=trust-region"]),
];

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut table = Table::new(
        "",
        "",
        &["run", "lasts (s)", "signals", "s to the end, median", "s to the end, most", "ends with"],
    );
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    for (name, scene, sets) in &RUNS[..if options.quick { 1 } else { RUNS.len() }] {
        let (seconds, code) = ended(scene, sets, LONGEST)?;
        let lasts = if code.is_some() { LONGEST } else { seconds };
        let (mut waits, mut codes) = (Vec::new(), Vec::new());
        for _ in 0..if options.quick { 1 } else { SIGNALS } {
            let after = lasts * rng.random_range(0.02..0.98);
            let (wait, code) = ended(scene, sets, after)?;
            // one that was over before the signal says nothing
            if let Some(code) = code {
                waits.push(wait);
                codes.push(code);
            }
        }
        waits.sort_by(f64::total_cmp);
        codes.sort_unstable();
        codes.dedup();
        let codes: Vec<String> = codes.iter().map(i32::to_string).collect();
        let [median, most] = [waits.len() / 2, waits.len().saturating_sub(1)].map(|i| waits.get(i).copied());
        table.push(cells![*name, lasts, waits.len(), median, most, codes.join(", ")]);
    }
    Ok(Page {
        title: "How soon Ctrl-C ends a run",
        text: format!(
            "A run in a process of its own is sent SIGINT at a random time between its begin and its end (up \
             to {LONGEST} s after it), {SIGNALS} times. *To the end*: seconds until the process is gone, its \
             result written. Exit code 130: interrupted; 0, 3 and 4: the signal came while the result was \
             being written. A signal that came after the end is left out."
        ),
        tables: vec![table],
        ..Page::default()
    })
}

/// Sends SIGINT after so many seconds. The seconds from there to the end and the exit code; of a run that
/// ended before, how long it took, and no code.
fn ended(scene: &str, sets: &[&str], after: f64) -> Result<(f64, Option<i32>)> {
    let folder = std::env::temp_dir().join(format!("varda-bench-interrupts-{}", std::process::id()));
    let mut command = super::memory::program()?;
    command.args(["run", scene, "--quiet", "--out"]).arg(&folder);
    command.args(sets.iter().flat_map(|s| ["--set", s])).stdout(Stdio::null()).stderr(Stdio::null());
    let (mut child, began) = (command.spawn()?, Instant::now());
    if wait(&mut child, Duration::from_secs_f64(after))?.is_some() {
        return Ok((began.elapsed().as_secs_f64(), None));
    }
    let told = Instant::now();
    Command::new("kill").args(["-INT", &child.id().to_string()]).status()?;
    let code = wait(&mut child, Duration::from_secs(600))?;
    let seconds = told.elapsed().as_secs_f64();
    let _ = std::fs::remove_dir_all(&folder);
    Ok((seconds, Some(code.ok_or("a run that does not end after SIGINT")?)))
}

/// The exit code, if it ends in that time; −1 without one.
fn wait(child: &mut Child, longest: Duration) -> Result<Option<i32>> {
    let began = Instant::now();
    while began.elapsed() < longest {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status.code().unwrap_or(-1)));
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Ok(None)
}
