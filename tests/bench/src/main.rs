//! Runs benchmarks: `cargo xtask bench [NAME…] [--quick] [--out DIR]`.
#![allow(clippy::print_stdout, clippy::print_stderr)]

use bench::{BENCHES, Options, case4, cycling, figures, kernels, memory};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

fn main() -> ExitCode {
    if let Some(code) = memory::as_child() {
        return code;
    }
    match bench(std::env::args().skip(1)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

fn bench(arguments: impl Iterator<Item = String>) -> Result<(), String> {
    let words: Vec<String> = arguments.collect();
    // What `bench instructions` runs under valgrind: one kernel, so many times.
    if let [word, kernel, repeats] = words.as_slice()
        && word == "--kernel"
    {
        return kernels::repeat(kernel, repeats.parse().map_err(|e| format!("{repeats}: {e}"))?);
    }
    // Studies with arguments of their own.
    match words.split_first() {
        Some((word, rest)) if word == "case4" => return case4::run(rest).map_err(|e| e.to_string()),
        Some((word, [])) if word == "figures" => {
            let top = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).ok_or("no workspace")?;
            return figures::draw(top).map_err(|e| e.to_string());
        }
        Some((word, rest)) if word == "lorenz96-cycling" => {
            return cycling::table(rest).map_err(|e| e.to_string());
        }
        _ => {}
    }
    let mut options = Options::default();
    let mut out = None;
    let mut names = Vec::new();
    let mut words = words.into_iter();
    while let Some(word) = words.next() {
        match word.as_str() {
            "--quick" => options.quick = true,
            "--out" => out = Some(words.next().map(PathBuf::from).ok_or("--out needs a folder")?),
            name => names.push(name.to_string()),
        }
    }
    let known: Vec<&str> = BENCHES.iter().map(|b| b.name).collect();
    if let Some(name) = names.iter().find(|n| !known.contains(&n.as_str())) {
        return Err(format!(
            "no benchmark or option {name:?} (benchmarks: {}; options: --quick, --out DIR)",
            known.join(", ")
        ));
    }
    // A quick run is no result: it is kept only where a folder is named.
    let results =
        Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).map(|top| top.join("docs/results"));
    let folder = out.or(results.filter(|_| !options.quick));
    for bench in BENCHES.iter().filter(|b| names.is_empty() || names.iter().any(|n| n == b.name)) {
        let page = (bench.run)(&options).map_err(|e| format!("{}: {e}", bench.name))?;
        println!("{}", page.plain());
        if let Some(folder) = &folder {
            page.write(bench.name, folder).map_err(|e| format!("{}: {e}", bench.name))?;
        }
    }
    Ok(())
}
