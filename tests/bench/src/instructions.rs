//! Instructions of every kernel, counted by valgrind: free of noise, so that a regression shows.

use super::kernels::KERNELS;
use super::{Options, Page, Result, Table};
use crate::cells;
use std::process::Command;

const MISSING: &str = "valgrind is not installed; it counts the instructions. Debian, Ubuntu: apt-get \
    install valgrind; Fedora: dnf install valgrind; macOS and Windows: run this benchmark in a Linux \
    container";

pub(super) fn run(options: &Options) -> Result<Page> {
    Command::new("valgrind").arg("--version").output().map_err(|_| MISSING)?;
    let mut table = Table::new(
        "kernels",
        "Instructions of one call",
        &["kernel", "instructions", "per", "instructions per"],
    );
    let kernels = if options.quick { &KERNELS[..2] } else { KERNELS };
    for kernel in kernels {
        // What setting up costs is the same in both runs.
        let (few, many) = (2, 6);
        let count = (counted(kernel.name, many)? - counted(kernel.name, few)?) / (many - few);
        let (parts, unit) = kernel.per;
        table.push(cells![kernel.name, count, format!("{unit} ({parts})"), count as f64 / parts as f64]);
    }
    Ok(Page { title: "Instructions of kernels", text: TEXT.into(), tables: vec![table], ..Page::default() })
}

/// Instructions of a process that calls a kernel `repeats` times.
fn counted(kernel: &str, repeats: usize) -> Result<usize> {
    let program = std::env::current_exe()?;
    let output = Command::new("valgrind")
        .args(["--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"])
        .arg(program)
        .args(["--kernel", kernel, &repeats.to_string()])
        .output()?;
    let said = String::from_utf8_lossy(&output.stderr);
    // Versions differ in the blanks: "I refs:", "I   refs:".
    let instructions = |line: &str| {
        let (head, number) = line.split_once("refs:")?;
        head.trim_end().ends_with(" I").then(|| number.trim().replace(',', ""))
    };
    let number = said.lines().find_map(instructions);
    match number {
        Some(number) if output.status.success() => Ok(number.parse()?),
        _ => Err(format!("{kernel}: {said}").into()),
    }
}

const TEXT: &str = "\
Counted by valgrind (cachegrind without cache simulation): the difference between six calls and two, \
divided by four. The counts are free of noise: the same binary gives the same numbers, so a change here \
is a change in the code or the compiler. Valgrind offers AVX2, not AVX-512. *Rod*: the [driven \
rod](../reference-problems.md#driven-rod) at 1 s with Δt = 0.02 s, without angles (3 unknowns a \
segment, half-bandwidth 8); *twisting rod*: with angles (4, 10). *Step*: a whole step with its Newton \
iterations; *linearize*: assembly and factorization. The flagship window is case 1 of the [hanging \
rod](../reference-problems.md#hanging-rod): 144 controls, 100 steps, 120 observations. Clock times of \
the same kernels: `cargo bench -p bench`.";
