//! What building costs.

use super::{Options, Page, Result, Table};
use crate::cells;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Instant;

/// What is built: its name, and cargo's arguments.
const BUILDS: [(&str, &[&str]); 7] = [
    ("workspace", &[]),
    ("workspace, with its verification", &["--workspace"]),
    ("varda-covariance", &["-p", "varda-covariance"]),
    ("varda-implicit", &["-p", "varda-implicit"]),
    ("varda-rod", &["-p", "varda-rod"]),
    ("varda-assimilation", &["-p", "varda-assimilation"]),
    ("varda", &["-p", "varda"]),
];

pub(super) fn run(options: &Options) -> Result<Page> {
    let mut table = Table::new(
        "build",
        "cargo build --release, from nothing",
        &["what", "packages compiled", "CPU s", "s"],
    );
    for (name, arguments) in if options.quick { &BUILDS[2..3] } else { &BUILDS[..] } {
        let target = std::env::temp_dir().join(format!("varda-bench-build-{}", std::process::id()));
        let (before, start) = (children()?, Instant::now());
        let built = cold(&target, arguments);
        let (after, seconds) = (children()?, start.elapsed().as_secs_f64());
        std::fs::remove_dir_all(&target)?;
        table.push(cells![*name, built?, after - before, seconds]);
    }
    Ok(Page { title: "What building costs", text: TEXT.into(), tables: vec![table], ..Page::default() })
}

/// Builds into a folder; how many packages were compiled.
fn cold(target: &Path, arguments: &[&str]) -> Result<usize> {
    let output = Command::new(std::env::var("CARGO").unwrap_or("cargo".into()))
        .args(["build", "--release", "--locked", "--manifest-path"])
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../../Cargo.toml"))
        .args(arguments)
        .env("CARGO_TARGET_DIR", target)
        .stdout(Stdio::null())
        .output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    if !output.status.success() {
        return Err(said.into());
    }
    Ok(said.lines().filter(|line| line.trim_start().starts_with("Compiling")).count())
}

/// CPU time of all children that have ended \[s\].
fn children() -> Result<f64> {
    let missing = "CPU time of children is read from /proc/self/stat: run this benchmark on Linux";
    let text = std::fs::read_to_string("/proc/self/stat").map_err(|_| missing)?;
    // After the name in parentheses, which may hold blanks: cutime and cstime are fields 16 and 17 of
    // proc(5), in hundredths.
    let fields = text.rsplit_once(')').map_or("", |(_, rest)| rest).split_whitespace();
    let ticks: Vec<f64> = fields.skip(13).take(2).map(str::parse).collect::<std::result::Result<_, _>>()?;
    Ok(0.01 * ticks.iter().sum::<f64>())
}

const TEXT: &str = "\
`cargo build --release --locked` into an empty target folder, with the sources of dependencies already \
downloaded. A package with a build script counts once. *CPU s*: user and system time of cargo and all it \
starts, whatever the number of cores. The default member builds `varda` and all crates below it.";
