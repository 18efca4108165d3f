//! Seconds of jobs of 1, 2 and 4 ranks, as a table: `cargo build`, then
//! `cargo run --example scaling [SAMPLES [JOB ...]]`, both with `--release` or without.
//!
//! *strong*: the same ensemble on all; *weak*: twenty runs a rank; *sweep*: twenty runs of a study;
//! *newton*: a dense Hessian an iteration, and one for the posterior; *exact*: the posterior of the exact
//! Hessian.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use serde_json::Value;

const RANKS: [usize; 3] = [1, 2, 4];

/// One job.
struct Sample {
    /// From mpirun's start to its end \[s\].
    whole: f64,
    /// The minimization \[s\].
    minimizer: f64,
    /// CPU seconds outside of gathers of the rank with most.
    busiest: f64,
    error: f64,
    counts: String,
}

fn main() -> Result<(), Box<dyn Error>> {
    let samples: usize = std::env::args().nth(1).map_or(Ok(5), |text| text.parse())?;
    let out = std::env::temp_dir().join(format!("varda-mpi-scaling-{}", std::process::id()));
    println!(
        "| job | ranks | s, least | median | minimization, least | median | CPU s of a rank, least | median \
         | RMSE (m) | sent |"
    );
    println!("|{} --- |", " --- |".repeat(9));
    let asked: Vec<String> = std::env::args().skip(2).collect();
    for name in ["strong", "weak", "sweep", "newton", "exact"] {
        if !asked.is_empty() && !asked.iter().any(|job| job == name) {
            continue;
        }
        for ranks in RANKS {
            let members = if name == "weak" { 20 * ranks - 1 } else { 39 };
            let arguments = match name {
                "sweep" => ["sweep", "hanging-rod", "--seeds", "0..19"].map(String::from).to_vec(),
                "newton" => of_long_rod("algorithm.minimizer=\"newton\""),
                "exact" => of_long_rod("algorithm.hessian=\"exact\""),
                _ => {
                    let ensemble = format!("algorithm={{method=\"4denvar\",ensemble={{members={members}}}}}");
                    ["run", "hanging-rod", "--set", &ensemble].map(String::from).to_vec()
                }
            };
            let all = (0..samples)
                .map(|_| job(ranks, &arguments, &out))
                .collect::<Result<Vec<_>, Box<dyn Error>>>()?;
            let of = |of: fn(&Sample) -> f64| {
                let mut sorted: Vec<f64> = all.iter().map(of).collect();
                sorted.sort_by(f64::total_cmp);
                (sorted[0], sorted[samples / 2])
            };
            let ((whole, median), (least, middle)) = (of(|s| s.whole), of(|s| s.minimizer));
            let (busiest, busy) = of(|s| s.busiest);
            let last = &all[samples - 1];
            println!(
                "| {name} | {ranks} | {whole:.3} | {median:.3} | {least:.3} | {middle:.3} | {busiest:.3} | \
                 {busy:.3} | {:.10} | {} |",
                last.error, last.counts
            );
        }
    }
    Ok(())
}

/// 294 unknowns and 600 observed values, 100 steps.
fn of_long_rod(setting: &str) -> Vec<String> {
    let sets = ["model.segments=50", "observations.every=2", setting];
    let mut arguments = ["run", "hanging-rod"].map(String::from).to_vec();
    sets.iter().for_each(|set| arguments.extend(["--set", set].map(String::from)));
    arguments
}

fn job(ranks: usize, arguments: &[String], out: &Path) -> Result<Sample, Box<dyn Error>> {
    let _ = std::fs::remove_dir_all(out);
    let started = Instant::now();
    let output = Command::new("mpirun")
        .args(["--oversubscribe", "-n", &ranks.to_string()])
        .arg(program()?)
        .args(arguments)
        .args(["--quiet", "--counts", "--out"])
        .arg(out)
        .envs([("OMPI_ALLOW_RUN_AS_ROOT", "1"), ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1")])
        .env("RAYON_NUM_THREADS", "1")
        .stdin(Stdio::null())
        .output()?;
    let whole = started.elapsed().as_secs_f64();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let counts = said.lines().find(|line| line.contains(" gathers, ")).ok_or_else(|| said.clone())?;
    let summary: Value = serde_json::from_str(&std::fs::read_to_string(out.join("summary.json"))?)?;
    let number = |table: &str, key: &str| summary[table][key].as_f64().unwrap_or(f64::NAN);
    let sample = Sample {
        whole,
        minimizer: number("seconds", "minimizer"),
        busiest: counts
            .strip_suffix(" CPU s outside")
            .and_then(|c| c.rsplit(' ').next()?.parse().ok())
            .unwrap_or(f64::NAN),
        error: number("rmse", "position_analysis"),
        counts: counts.to_string(),
    };
    std::fs::remove_dir_all(out)?;
    Ok(sample)
}

/// varda-mpi, two folders up from an example.
fn program() -> Result<PathBuf, Box<dyn Error>> {
    let example = std::env::current_exe()?;
    let folder = example.parent().and_then(Path::parent).ok_or("an example is in a folder of its own")?;
    Ok(folder.join("varda-mpi"))
}
