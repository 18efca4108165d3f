//! Case 4 of the hanging rod over many seeds: the default and every minimizer against the lowest J known.
//! `cargo xtask bench case4`.
#![allow(clippy::print_stdout)]

mod edges;
mod report;
mod runs;

use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use report::Study;
use runs::{Run, Twin, Way};

const WORDS: &str = include_str!("words.md");

const HELP: &str = "\
cargo xtask bench case4 [--seeds N] [--first N] [--threads N] [--priors clamp,plain] [--adam N]
                        [--only NAME,…] [--again NAME,…] [--edges SEED,…] [--out DIR]
    Runs the default, the paper's minimizers and the reference on N seeds (100; Adam on the first 5) of
    either prior and writes DIR/case4.md, .csv and .svg (docs/results). Runs already in
    target/case4/runs.csv are not repeated but for those of --again; --only runs nothing else, and writes
    no report; --threads 0 runs nothing and reports what is there. --edges looks for
    the jump of J next to where these seeds end with the plain prior, and writes DIR/case4-edges.md.
";

struct Options {
    seeds: u64,
    first: u64,
    threads: usize,
    priors: Vec<&'static str>,
    /// Seeds on which Adam, much the slowest, is run.
    adam: u64,
    only: Vec<Way>,
    again: Vec<Way>,
    /// Seeds beside whose end the jump of J is looked for; nothing else is run.
    edges: Vec<u64>,
    out: PathBuf,
}

/// Runs the study with the given arguments and writes its results.
///
/// # Errors
/// An unknown argument, a run that cannot be set up, a file that cannot be written.
pub fn run(arguments: &[String]) -> Result<(), Box<dyn Error>> {
    if arguments.iter().any(|a| a == "--help") {
        println!("{HELP}");
        return Ok(());
    }
    let options = options(arguments)?;
    if options.edges.is_empty() {
        return study(&options);
    }
    let page = edges::page(&options.edges)?;
    std::fs::write(options.out.join("case4-edges.md"), &page)?;
    println!("{page}");
    Ok(())
}

fn options(arguments: &[String]) -> Result<Options, Box<dyn Error>> {
    let top = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut options = Options {
        seeds: 100,
        first: 0,
        threads: std::thread::available_parallelism()?.get(),
        priors: vec!["clamp", "plain"],
        adam: 5,
        only: Vec::new(),
        again: Vec::new(),
        edges: Vec::new(),
        out: top.join("docs/results"),
    };
    let ways = |text: &str| -> Result<Vec<Way>, String> {
        let known =
            |name: &str| Way::ALL.into_iter().filter(|w| w.name().starts_with(name)).collect::<Vec<Way>>();
        let found: Vec<Way> = text.split(',').flat_map(known).collect();
        if found.is_empty() { Err(format!("no minimizer {text}")) } else { Ok(found) }
    };
    let mut arguments = arguments.iter();
    while let Some(argument) = arguments.next() {
        let value = arguments.next().ok_or(format!("{argument} needs a value"))?;
        match argument.as_str() {
            "--seeds" => options.seeds = value.parse()?,
            "--first" => options.first = value.parse()?,
            "--threads" => options.threads = value.parse()?,
            "--priors" => options.priors.retain(|p| value.split(',').any(|v| v == *p)),
            "--adam" => options.adam = value.parse()?,
            "--only" => options.only = ways(value)?,
            "--again" => options.again = ways(value)?,
            "--edges" => {
                options.edges = value.split(',').map(str::parse).collect::<Result<_, _>>()?;
            }
            "--out" => options.out = value.into(),
            _ => return Err(format!("unknown option {argument}").into()),
        }
    }
    Ok(options)
}

fn study(options: &Options) -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../target/case4");
    std::fs::create_dir_all(&folder)?;
    let file = folder.join("runs.csv");
    let mut all = runs::remembered(&file)?;
    all.retain(|r| !options.again.contains(&r.way));
    let text: String = all.iter().map(|r| runs::line(r) + "\n").collect();
    std::fs::write(&file, text)?;

    let seeds = options.first..options.first + options.seeds;
    let chosen = |way: &Way| {
        (options.only.is_empty() && options.again.is_empty())
            || options.only.contains(way)
            || options.again.contains(way)
    };
    let mut jobs: Vec<(Twin, Way)> = Vec::new();
    for seed in seeds.clone() {
        for &prior in &options.priors {
            jobs.extend(Way::ALL.into_iter().filter(&chosen).map(|way| (Twin { prior, seed }, way)));
        }
    }
    jobs.retain(|(twin, way)| {
        !matches!(way, Way::AdamControl | Way::AdamRaw) || twin.seed < options.first + options.adam
    });
    jobs.retain(|(twin, way)| !all.iter().any(|r| r.twin == *twin && r.way == *way));
    let new = parallel(&jobs, options.threads, &mut std::fs::OpenOptions::new().append(true).open(&file)?)?;
    all.extend(new);
    all.retain(|r| seeds.contains(&r.twin.seed) && options.priors.contains(&r.twin.prior));
    all.sort_by_key(|r| (r.twin, r.way));
    if !options.only.is_empty() {
        return Ok(());
    }
    let study = Study { runs: all, words: WORDS };
    std::fs::write(options.out.join("case4.md"), study.markdown())?;
    std::fs::write(options.out.join("case4.csv"), study.csv())?;
    std::fs::write(options.out.join("case4.svg"), study.svg())?;
    println!("{}", study.markdown());
    Ok(())
}

/// Runs the jobs on some threads, remembering each as it is done.
fn parallel(
    jobs: &[(Twin, Way)],
    threads: usize,
    file: &mut std::fs::File,
) -> Result<Vec<Run>, Box<dyn Error>> {
    let next = AtomicUsize::new(0);
    let done = Mutex::new((Vec::new(), file, None));
    std::thread::scope(|scope| {
        for _ in 0..threads.min(jobs.len()) {
            scope.spawn(|| {
                while let Some(&(twin, way)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let run = runs::run(twin, way).map_err(|e| format!("{twin:?}, {way:?}: {e}"));
                    let mut done = done.lock().expect("no thread panics with it");
                    let written = run.and_then(|run| {
                        writeln!(done.1, "{}", runs::line(&run)).map_err(|e| e.to_string())?;
                        done.0.push(run);
                        Ok(())
                    });
                    if let Err(error) = written {
                        done.2 = Some(error);
                    }
                }
            });
        }
    });
    let (runs, _, error) = done.into_inner().expect("no thread panics with it");
    error.map_or(Ok(runs), |e| Err(e.into()))
}
