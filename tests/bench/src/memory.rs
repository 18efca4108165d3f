//! The memory that `varda check` says beside what a run takes, for every method.

use std::path::Path;
use std::process::{Command, Stdio};

use super::{Options, Page, Result, Table};
use crate::cells;
use varda::scene::SceneFile;
use varda::setup::Plan;

/// Names the file that a process started by [`program`] writes its peak to.
const PEAK: &str = "VARDA_BENCH_PEAK";

/// A name, a scene, keys that are set.
type Run = (&'static str, &'static str, &'static [&'static str]);

/// Most components that are observed at four times; all of them at every step.
const EVERY: &str = "observations.components=[]";
const ALWAYS: &str = "observations.every=1";
const SOON: &str = "algorithm.max_iterations=2";
const N600: &str = "model.variables=600";
const N1000: &str = "model.variables=1000";
const N1500: &str = "model.variables=1500";
const N20000: &str = "model.variables=20000";
const LBFGS: &str = "algorithm.minimizer=lbfgs";
const ERRORS: &str = "algorithm.model_error={ every = 4, covariance = { kind = \"diagonal\", sigma = 0.1 } }";
const FORCING: &str = "algorithm.method=weak-forcing";
const STATES: &str = "algorithm.method=weak-state";
const ENVAR: &str = "algorithm.method=4denvar";
const HYBRID: &str = "algorithm.method=hybrid-4denvar";
const NONE: &str = "report.posterior=false";
const FEW: &str = "algorithm.cycles.count=3";
const APART: &str = "background.covariance={ kind = \"diagonal\", sigma = 0.4 }";
const FROM_FIRST: &str = "algorithm.cycles.spin_up=0";

/// What said may be off by.
const OFF: f64 = 0.2;

const RUNS: &[Run] = &[
    ("three unknowns", "lorenz63", &[]),
    ("4D-Var, 40 unknowns", "lorenz96", &[]),
    ("rod of 25 segments", "hanging-rod", &[]),
    ("rod of 25 segments, errors of the model", "hanging-rod-weak", &[]),
    ("field of 99 points", "burgers", &[]),
    ("4D-EnVar, 40 unknowns", "lorenz96-4denvar", &[]),
    ("cycles, 3D-Var, 40 unknowns", "lorenz96-cycling-3dvar", &[]),
    ("cycles, 4D-Var, 40 unknowns", "lorenz96-cycling-4dvar", &[]),
    ("recording, 24 segments", "hose", &[]),
    ("4D-Var, few values", "lorenz96", &[N1500, SOON]),
    ("4D-Var, many values", "lorenz96", &[N1000, SOON, EVERY, ALWAYS]),
    ("4D-Var, Newton", "lorenz96", &[N1500, SOON, "algorithm.minimizer=newton"]),
    ("4D-Var, low-rank posterior", "lorenz96", &[N20000, SOON, LBFGS]),
    ("4D-Var, low-rank posterior, many values", "lorenz96", &["model.variables=8000", SOON, LBFGS, EVERY]),
    ("4D-Var, field", "burgers", &["model.points=1500", SOON]),
    ("4D-Var, rod", "hanging-rod", &["model.segments=250", SOON, "algorithm.minimizer=trust-region"]),
    (
        "4D-Var within a limit of 230 MB",
        "lorenz96",
        &[N20000, SOON, LBFGS, NONE, "time.window=100", "limits.memory=\"230 MB\""],
    ),
    ("incremental", "lorenz96", &[N1500, SOON, "algorithm.method=4dvar-incremental"]),
    ("4D-PSAS", "lorenz96", &[N1500, SOON, "algorithm.method=4d-psas"]),
    ("BLUE, few values", "lorenz96", &[N1500, "algorithm.method=blue"]),
    ("BLUE, many values", "lorenz96", &[N600, EVERY, ALWAYS, "algorithm.method=blue"]),
    ("weak-forcing, few values", "lorenz96", &[N1500, SOON, LBFGS, ERRORS, FORCING]),
    ("weak-forcing, many values", "lorenz96", &["model.variables=300", SOON, LBFGS, ERRORS, FORCING, EVERY]),
    ("weak-forcing, no posterior", "lorenz96", &[N20000, SOON, LBFGS, ERRORS, FORCING, NONE]),
    ("weak-state, many values", "lorenz96", &["model.variables=300", SOON, ERRORS, STATES, EVERY]),
    ("weak-state, no posterior", "lorenz96", &[N20000, SOON, ERRORS, STATES, NONE]),
    (
        "4D-EnVar, 80 members",
        "lorenz96",
        &["model.variables=4000", SOON, ENVAR, "algorithm.ensemble={ members = 80 }"],
    ),
    (
        "4D-EnVar, 80 members, many values",
        "lorenz96",
        &[N1000, SOON, ENVAR, EVERY, ALWAYS, "algorithm.ensemble={ members = 80 }"],
    ),
    (
        "4D-EnVar, localized",
        "lorenz96",
        &[N1500, SOON, ENVAR, "algorithm.ensemble={ members = 20, localization_length = 40 }"],
    ),
    (
        "4D-EnVar, localized, many values",
        "lorenz96",
        &[
            "model.variables=400",
            SOON,
            ENVAR,
            EVERY,
            ALWAYS,
            "algorithm.ensemble={ members = 20, localization_length = 40 }",
        ],
    ),
    (
        "hybrid 4D-EnVar",
        "lorenz96",
        &["model.variables=400", HYBRID, EVERY, "algorithm.ensemble={ members = 20 }"],
    ),
    (
        "hybrid 4D-EnVar, localized, many values",
        "lorenz96",
        &[
            "model.variables=300",
            HYBRID,
            EVERY,
            ALWAYS,
            "algorithm.ensemble={ members = 20, localization_length = 40 }",
        ],
    ),
    ("cycles, 3D-Var", "lorenz96-cycling-3dvar", &["model.variables=1500", APART, FEW, FROM_FIRST]),
    ("cycles, static B", "lorenz96-cycling-4dvar", &["model.variables=1500", APART, FEW, FROM_FIRST]),
    ("cycles, ensemble", "lorenz96-cycling-4denvar", &["model.variables=1500", APART, FEW, FROM_FIRST]),
    ("cycles, rod", "hanging-rod-cycling", &["model.segments=100", FEW]),
    ("recording", "hose", &["model.segments=150", SOON, "algorithm.minimizer=trust-region"]),
    (
        "recording, two constants estimated, finer mesh",
        "hose",
        &[
            "model.segments=75",
            "algorithm.minimizer=trust-region",
            "estimate={ ei = { sigma = \"20%\" }, damping_stiffness = { sigma = \"50%\" } }",
        ],
    ),
];

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut table = Table::new(
        "",
        "",
        &["run", "method", "unknowns", "values", "said (MB)", "taken (MB)", "said / taken"],
    );
    let (mut within, mut rows) = (0, 0);
    for (name, scene, sets) in &RUNS[..if options.quick { 2 } else { RUNS.len() }] {
        let all: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        let plan = Plan::new(&SceneFile::open(scene, &all)?)?;
        let (said, taken) = (plan.bytes as f64, taken(scene, &all)?);
        rows += 1;
        within += usize::from((said / taken - 1.0).abs() <= OFF);
        table.push(cells![
            *name,
            plan.method,
            plan.n_control + plan.n_errors,
            plan.n_obs,
            1e-6 * said,
            1e-6 * taken,
            said / taken,
        ]);
    }
    Ok(Page {
        title: "Memory: what `check` says and what a run takes",
        text: format!(
            "*Said*: by `varda check`, and what `[limits] memory` is compared with. *Taken*: the most that \
             a process of `varda run` has resident, tables and report included. Said is within {:.0} % of \
             taken in {within} of {rows} rows. Minimizations end after two iterations, which changes no \
             matrix; the posterior is computed all the same. Those of small scenes run on, as does that \
             with constants estimated, for the estimate on a finer mesh.",
            100.0 * OFF
        ),
        tables: vec![table],
        ..Page::default()
    })
}

/// Most bytes that `varda run` of a scene has resident, as the system counts them.
fn taken(scene: &str, sets: &[String]) -> Result<f64> {
    let folder = std::env::temp_dir().join(format!("varda-bench-memory-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let peak = folder.join("peak");
    let mut command = program()?;
    command.env(PEAK, &peak).args(["run", scene, "--quiet", "--out"]).arg(folder.join("out"));
    command.args(sets.iter().flat_map(|s| ["--set", s])).stdout(Stdio::null());
    let code = command.status()?.code();
    if !matches!(code, Some(0 | 3 | 4)) {
        return Err(format!("{scene} {sets:?} ends with {code:?}").into());
    }
    let text = std::fs::read_to_string(&peak).map_err(|e| format!("{scene} {sets:?}: no peak: {e}"))?;
    std::fs::remove_dir_all(&folder)?;
    Ok(text.trim().parse()?)
}

/// The command line of varda: this program, which then does [`as_child`].
pub(super) fn program() -> Result<Command> {
    let mut command = Command::new(std::env::current_exe()?);
    command.env(PEAK, "");
    Ok(command)
}

/// In a process that [`program`] started: runs the command line and writes the peak of this process to the
/// file that is named, if one is.
pub fn as_child() -> Option<std::process::ExitCode> {
    let file = std::env::var_os(PEAK)?;
    let code = varda::cli::main();
    if file.is_empty() {
        return Some(code);
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<f64>().ok());
    // a file that is missing is an error of the parent
    let _ = kilobytes.map(|kb| std::fs::write(Path::new(&file), format!("{}", 1024.0 * kb)));
    Some(code)
}
