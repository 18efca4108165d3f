//! The command line: commands, progress, tables, exit codes. Only this module prints.

#![allow(clippy::print_stdout, clippy::print_stderr)]

mod convert;
mod cycles;
mod exit;
mod manual;
mod new;
mod preview;
mod progress;
mod recordings;
mod style;
mod sweep;
mod table;

use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use clap::{Args, Parser, Subcommand};
use clap_complete::Shell;
use varda_assimilation::ranks;
use varda_linalg::interrupt::{self, Ends};

use crate::Error;
use crate::convert::{Options, Unit, Up};
use crate::outcome::{Outcome, Status};
use crate::preview::Preview;
use crate::report;
use crate::report::Summary;
use crate::report::checkpoint::Checkpoint;
use crate::report::folder::ResultFolder;
use crate::run::compare::{Compared, compare};
use crate::run::cycles::Sequence;
use crate::run::{self, Listener, assimilate};
use crate::scene::{DATA_BYTES, SHIPPED, Scene, SceneFile};
use crate::setup::{Inputs, Plan, Problem};
use exit::INTERRUPTED;
use progress::ProgressDisplay;

#[derive(Parser)]
#[command(
    name = "varda",
    version,
    about = "Estimates the state of a dynamical system from noisy, sparse observations",
    after_help = manual::PROGRAM
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Assimilate: minimise the cost of a scene and write a report
    #[command(after_help = manual::RUN)]
    Run {
        #[command(flatten)]
        scene: SceneArguments,
        /// Folder for the result [default: out/<scene name>]
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        /// Print nothing but errors
        #[arg(long)]
        quiet: bool,
        /// Print summary.json instead of the table
        #[arg(long, conflicts_with = "quiet")]
        json: bool,
        /// End with exit code 3 where there is any warning
        #[arg(long)]
        strict: bool,
        /// Continue an unfinished run of many windows ([algorithm.cycles]) after its last finished window
        #[arg(long)]
        resume: bool,
    },
    /// Run the model forward only: from the truth where there is one, else from the background
    #[command(after_help = manual::SIMULATE)]
    Simulate {
        #[command(flatten)]
        scene: SceneArguments,
        /// Folder for the result [default: out/<scene name>-simulation]
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        /// Print nothing but errors
        #[arg(long)]
        quiet: bool,
        /// Print summary.json instead of the table
        #[arg(long, conflicts_with = "quiet")]
        json: bool,
    },
    /// Run every method and minimizer that applies; print and draw error against seconds
    #[command(after_help = manual::COMPARE)]
    Compare {
        #[command(flatten)]
        scene: SceneArguments,
        /// Folder for the result [default: out/<scene name>-compare]
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        /// Print summary.json instead of the table
        #[arg(long)]
        json: bool,
    },
    /// Run a scene with several values and seeds, each a process; tables, means and charts of all
    #[command(after_help = manual::SWEEP)]
    Sweep(sweep::SweepArguments),
    /// Find the natural frequencies and modes of a rod about its shape at rest
    #[command(after_help = manual::MODES)]
    Modes {
        #[command(flatten)]
        scene: SceneArguments,
        /// How many modes, the lowest first
        #[arg(long, value_name = "N", default_value_t = 10)]
        count: usize,
        /// Folder for the result [default: out/<scene name>-modes]
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        /// Print summary.json instead of the table
        #[arg(long)]
        json: bool,
    },
    /// Draw the page of a finished result again, report.html, without running anything
    #[command(after_help = manual::PLOT)]
    Plot {
        /// Folder of the result: of run, compare, modes or sweep
        #[arg(value_name = "FOLDER")]
        folder: PathBuf,
    },
    /// Check a scene and look at the data beside the model: one forward run, no minimization
    #[command(after_help = manual::CHECK)]
    Check {
        #[command(flatten)]
        scene: SceneArguments,
        /// Print the findings and all numbers as JSON
        #[arg(long)]
        json: bool,
    },
    /// Write a scene to start from to NAME.toml: a commented one, one for a recording, or a shipped one
    #[command(after_help = manual::NEW)]
    New {
        /// Name of the scene
        name: String,
        /// A recording of a rod: time_s, s_m or marker, x_m, y_m, z_m (see convert for other formats);
        /// without times a shape at rest
        #[arg(long, value_name = "FILE.csv", conflicts_with = "from")]
        recording: Option<PathBuf>,
        /// A scene that comes with the program (see scenes), with the files it names
        #[arg(long, value_name = "SCENE")]
        from: Option<String>,
    },
    /// Print a scene that comes with the program
    #[command(after_help = manual::SHOW)]
    Show {
        /// Its name
        scene: String,
    },
    /// Convert a recording (C3D, CSV of Motive or Nexus, TRC) to time_s,marker,x_m,y_m,z_m, z upwards
    #[command(after_help = manual::CONVERT)]
    Convert {
        /// The recording
        file: PathBuf,
        /// The table [default: the recording's name, ending in .csv; beside a .csv: -varda.csv]
        #[arg(long, value_name = "FILE.csv")]
        out: Option<PathBuf>,
        /// Axis of the recording that points upwards [default: as the file says, else z]
        #[arg(long, value_name = "x|y|z", value_parser = convert::up)]
        up: Option<Up>,
        /// Unit of its coordinates [default: as the file says]
        #[arg(long, value_name = "mm|cm|m", value_parser = convert::unit)]
        unit: Option<Unit>,
    },
    /// Print the JSON Schema of a scene
    #[command(after_help = manual::SCHEMA)]
    Schema,
    /// List the scenes that come with the program
    #[command(after_help = manual::SCENES)]
    Scenes,
    /// Print what a shell needs to complete commands and flags
    #[command(after_help = manual::COMPLETIONS)]
    Completions {
        /// The shell
        shell: Shell,
    },
    /// Print the manual page of the program, or of one of its commands
    #[command(after_help = manual::MAN)]
    Man {
        /// The command
        command: Option<String>,
    },
}

#[derive(Args)]
struct SceneArguments {
    /// A scene file, or the name of a shipped scene
    scene: String,
    /// Seed of every random number
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Set a key of the scene, for example --set observations.sigma=0.01
    #[arg(long = "set", value_name = "key=value")]
    sets: Vec<String>,
}

impl SceneArguments {
    fn open(&self) -> Result<SceneFile, Error> {
        let seed = self.seed.map(|s| format!("seed={s}"));
        let sets: Vec<String> = self.sets.iter().cloned().chain(seed).collect();
        SceneFile::open(&self.scene, &sets)
    }
}

/// Runs the program: parses its arguments, does what they say, prints one message on error.
pub fn main() -> ExitCode {
    run(std::env::args_os()).unwrap_or_else(|error| {
        style::error(&error);
        ExitCode::FAILURE
    })
}

/// Does what the arguments say, the first of which names the program. Where several processes share the work
/// ([`ranks::within`]), rank 0 prints and writes: commands `run` and `sweep`.
///
/// # Errors
/// As the command has them; nothing is printed of them.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> Result<ExitCode, Error> {
    let started = Instant::now();
    let parsed = match Cli::try_parse_from(arguments) {
        Ok(parsed) => parsed,
        // a text that was asked for is one of these errors
        Err(error) => {
            if ranks::is_first() {
                let _ = error.print();
            }
            return Ok(ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(exit::USAGE)));
        }
    };
    match parsed.command {
        Command::Run { scene, out, quiet, json, strict, resume } => {
            let options = RunOptions { shown: Shown::of(quiet, json), strict, resume };
            run_scene(&scene, out.as_deref(), options, started)
        }
        Command::Simulate { scene, out, quiet, json } => {
            simulate(&scene, out.as_deref(), Shown::of(quiet, json), started)
        }
        Command::Compare { scene, out, json } => compare_all(&scene, out.as_deref(), json),
        Command::Sweep(arguments) => sweep::run(&arguments, started),
        Command::Modes { scene, count, out, json } => modes(&scene, count, out.as_deref(), json),
        Command::Plot { folder } => {
            let pages = report::plot::draw_again(&folder)?;
            pages.iter().for_each(|page| style::line(page.display()));
            Ok(ExitCode::SUCCESS)
        }
        Command::Check { scene, json: true } => Ok(preview::check_as_json(scene.open())),
        Command::Check { scene, json: false } => scene.open().and_then(|file| check(&file)),
        Command::New { name, recording, from } => {
            let from = match (recording, from) {
                (Some(file), _) => new::From::Recording(file),
                (None, Some(scene)) => new::From::Shipped(scene),
                (None, None) => new::From::Starter,
            };
            new::new(&name, from).map(|()| ExitCode::SUCCESS)
        }
        Command::Show { scene } => new::show(&scene).map(|()| ExitCode::SUCCESS),
        Command::Convert { file, out, up, unit } => {
            convert::convert(&file, out, &Options { up, unit }).map(|()| ExitCode::SUCCESS)
        }
        Command::Schema => {
            style::line(Scene::schema());
            Ok(ExitCode::SUCCESS)
        }
        Command::Scenes => {
            list();
            Ok(ExitCode::SUCCESS)
        }
        Command::Completions { shell } => {
            style::print(&manual::completions::<Cli>(shell));
            Ok(ExitCode::SUCCESS)
        }
        Command::Man { command } => {
            style::print(&manual::man::<Cli>(command.as_deref()));
            Ok(ExitCode::SUCCESS)
        }
    }
}

/// Whether several processes share the work. Each must do what the others do: a signal, or an end of the time
/// allowed, would be heard by one before the other.
fn is_shared() -> bool {
    ranks::current().is_some_and(|ranks| ranks.count() > 1)
}

/// Becomes true at Ctrl-C, SIGTERM or SIGHUP; the run then ends with the result so far. A second signal ends
/// the program at once.
fn stop_on_signals() -> Arc<AtomicBool> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    // Without a handler a signal still ends the program, but without a result.
    let _ = ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::SeqCst) {
            std::process::exit(INTERRUPTED.into());
        }
    });
    stop
}

/// What a run prints.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shown {
    Nothing,
    Table,
    /// summary.json.
    Json,
}

impl Shown {
    /// What the first of several processes prints; the others print nothing.
    fn of(quiet: bool, json: bool) -> Shown {
        match (quiet || !ranks::is_first(), json) {
            (true, _) => Shown::Nothing,
            (false, true) => Shown::Json,
            (false, false) => Shown::Table,
        }
    }
}

/// Flags of `run`.
#[derive(Clone, Copy)]
struct RunOptions {
    shown: Shown,
    /// Any warning is a failure.
    strict: bool,
    resume: bool,
}

fn run_scene(
    arguments: &SceneArguments,
    out: Option<&Path>,
    options: RunOptions,
    started: Instant,
) -> Result<ExitCode, Error> {
    let RunOptions { shown, strict, resume } = options;
    let quiet = shown == Shown::Nothing;
    let file = arguments.open()?;
    let folder = out.map_or_else(|| Path::new("out").join(&file.name), Path::to_path_buf);
    if is_shared() {
        refuse_unshared(&file)?;
    }
    if ranks::is_first() {
        refuse_occupied(&folder, quiet)?;
    }

    // of several processes a signal ends all, by its default
    let stop = if is_shared() { Arc::default() } else { stop_on_signals() };
    let mut progress = ProgressDisplay::new(quiet, started, file.scene.limits.seconds);
    let interrupted = || stop.load(Ordering::SeqCst);
    let flag = Arc::clone(&stop);
    let ends: Ends = Arc::new(move || flag.load(Ordering::SeqCst));
    if resume && file.scene.algorithm.cycles.is_none() {
        return Err(file.invalid("algorithm", "only a run with [algorithm.cycles] can be resumed"));
    }
    if file.has_recordings() {
        return recordings::run(&file, &folder, &mut progress, &interrupted, options, started);
    }
    let inputs = Inputs::read(&file)?;
    if is_shared() {
        refuse_undivided(&inputs)?;
    }
    // said before it starts, but an error is the one message of a run that cannot
    let said = if quiet { String::new() } else { preview::in_short(&inputs) };
    if let Some(settings) = &file.scene.algorithm.cycles {
        // Before anything is run: the scene or its files may have changed since the run began.
        let resumed = match resume && ranks::is_first() {
            true => Some(Checkpoint::resume(&folder, &file, &inputs.files)?),
            false => None,
        };
        let files = inputs.files.clone();
        let sequence = Sequence::new(settings.clone(), inputs)?;
        eprint!("{said}");
        let start = cycles::SequenceStart { file: &file, files: &files, folder: &folder, resumed };
        return interrupt::within(ends, || {
            cycles::run(&sequence, start, &mut progress, &interrupted, options, started)
        });
    }
    let problem = match interrupt::within(Arc::clone(&ends), || Problem::new(inputs)) {
        Err(_) if interrupted() => {
            eprintln!("interrupted before the first value of J: nothing is written");
            return Ok(ExitCode::from(INTERRUPTED));
        }
        problem => problem?,
    };
    eprint!("{said}");
    progress.expect(problem.observations()?.dim(), problem.experiment.grid.steps);
    let mut listener = Listener {
        on_iteration: Box::new(|row| progress.row(row)),
        interrupted: Box::new(interrupted),
        ends: Some(Arc::clone(&ends)),
        started,
    };
    let outcome = assimilate(&problem, &mut listener)?;
    drop(listener);
    progress.finish();
    let folder = if ranks::is_first() { report::write(&outcome, &folder)? } else { folder };
    match shown {
        Shown::Nothing => {}
        Shown::Table => style::table(
            outcome.judgement.verdict,
            &table::outcome(&outcome, &folder, started.elapsed().as_secs_f64()),
        ),
        Shown::Json => style::print(&Summary::new(&outcome).to_json()),
    }
    Ok(exit_code(&outcome, strict))
}

fn exit_code(outcome: &Outcome, strict: bool) -> ExitCode {
    if outcome.status == Status::Failed {
        let reason = outcome.failure.as_ref().map(ToString::to_string);
        if ranks::is_first() {
            style::message(reason.as_deref().unwrap_or("the minimizer failed"));
        }
        return ExitCode::FAILURE;
    }
    exit::code(&outcome.judgement, outcome.status, outcome.late, strict && !outcome.warnings.is_empty())
}

/// Refuses what several processes would not do alike, or of which they would share nothing.
fn refuse_unshared(file: &SceneFile) -> Result<(), Error> {
    if file.has_recordings() {
        return Err(file.invalid("recordings", "several processes do not share a scene of recordings"));
    }
    if file.scene.limits.seconds.is_some() {
        let message = "several processes have no clock in common: the limit cannot be kept";
        return Err(file.invalid("limits.seconds", message));
    }
    Ok(())
}

/// Refuses a run of which several processes would share nothing.
fn refuse_undivided(inputs: &Inputs) -> Result<(), Error> {
    let file = &inputs.file;
    if file.scene.algorithm.method.is_ensemble() {
        return Ok(());
    }
    let (numbers, least) = (Plan::of(inputs)?.dense_numbers(&file.scene), ranks::LEAST_NUMBERS);
    let has = match numbers {
        None => "this method has none of them".to_string(),
        Some(numbers) if numbers < least => {
            format!(
                "here columns of {numbers} numbers at most go through the steps, and {least} are worth it"
            )
        }
        Some(_) => return Ok(()),
    };
    let message = format!(
        "several processes share the members of an ensemble, the runs of a sweep, or the columns of a dense \
         Hessian; {has}"
    );
    Err(file.invalid("algorithm.method", message))
}

/// Refuses an occupied folder before the work, not after it; reports what killed runs had left there.
fn refuse_occupied(folder: &Path, quiet: bool) -> Result<(), Error> {
    let out = ResultFolder::begin(folder)?;
    let found = out.found();
    if !quiet && !found.removed.is_empty() {
        let names: Vec<String> = found.removed.iter().map(|p| p.display().to_string()).collect();
        eprintln!("removed what killed runs had left: {}", names.join(", "));
    }
    if !quiet && found.put_back {
        eprintln!("{} is restored: a killed run was about to replace it", folder.display());
    }
    Ok(())
}

fn simulate(
    arguments: &SceneArguments,
    out: Option<&Path>,
    shown: Shown,
    started: Instant,
) -> Result<ExitCode, Error> {
    let quiet = shown == Shown::Nothing;
    let file = arguments.open()?;
    let default = || Path::new("out").join(format!("{}-simulation", file.name));
    let folder = out.map_or_else(default, Path::to_path_buf);
    refuse_occupied(&folder, quiet)?;
    let inputs = Inputs::for_simulation(&file.as_one_window())?;
    if let (Some(fault), false) = (&inputs.fault_of_observations, quiet) {
        eprintln!("nothing is observed: {fault}");
    }
    let problem = Problem::new(inputs)?;
    let simulation = run::simulate(&problem)?;
    let seconds = started.elapsed().as_secs_f64();
    let folder = report::write_simulation(&simulation, seconds, &folder)?;
    match shown {
        Shown::Nothing => {}
        Shown::Table => {
            style::print(&table::simulation(&simulation, &folder, started.elapsed().as_secs_f64()));
        }
        Shown::Json => style::line(format_args!("{:#}", report::summary_of_simulation(&simulation, seconds))),
    }
    Ok(ExitCode::SUCCESS)
}

fn compare_all(arguments: &SceneArguments, out: Option<&Path>, json: bool) -> Result<ExitCode, Error> {
    let file = arguments.open()?;
    let default = || Path::new("out").join(format!("{}-compare", file.name));
    let folder = out.map_or_else(default, Path::to_path_buf);
    refuse_occupied(&folder, false)?;
    let stop = stop_on_signals();
    let interrupted = || stop.load(Ordering::SeqCst);
    if file.scene.algorithm.cycles.is_some() {
        eprintln!("[algorithm.cycles] is left out: the methods are compared on the first window");
    }
    let mut on_row = |r: &Compared| eprintln!("{} {}: {}", r.method, r.solver, r.status);
    let rows = compare(&file, &mut on_row, &interrupted)?;
    let folder = report::write_comparison(&file, &rows, interrupted(), &folder)?;
    match json {
        true => style::line(format_args!("{:#}", report::summary_of_comparison(&file, &rows, interrupted()))),
        false => style::print(&table::comparison(&rows, &folder)),
    }
    Ok(if interrupted() { ExitCode::from(INTERRUPTED) } else { ExitCode::SUCCESS })
}

fn modes(
    arguments: &SceneArguments,
    count: usize,
    out: Option<&Path>,
    json: bool,
) -> Result<ExitCode, Error> {
    let file = arguments.open()?;
    let default = || Path::new("out").join(format!("{}-modes", file.name));
    let folder = out.map_or_else(default, Path::to_path_buf);
    refuse_occupied(&folder, false)?;
    let modes = run::modes(&file, count)?;
    let folder = report::write_modes(&modes, &folder)?;
    match json {
        true => style::line(format_args!("{:#}", report::summary_of_modes(&modes))),
        false => style::print(&table::modes(&modes, &folder)),
    }
    Ok(ExitCode::SUCCESS)
}

fn check(file: &SceneFile) -> Result<ExitCode, Error> {
    if file.has_recordings() {
        return recordings::check(file);
    }
    let preview = Preview::new(file)?;
    style::print(&preview::table(&preview));
    Ok(if preview.has_errors() { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// The bytes of a file of data.
fn bytes_of(file: &Path) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    std::fs::File::open(file)?.take(DATA_BYTES + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > DATA_BYTES {
        let message = format!("it has more than {DATA_BYTES} bytes");
        return Err(std::io::Error::new(std::io::ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

fn list() {
    let width = SHIPPED.iter().map(|s| s.name.len()).max().unwrap_or(0);
    for shipped in SHIPPED {
        let title =
            shipped.text.lines().find_map(|l| l.strip_prefix("title = ")).unwrap_or("").trim_matches('"');
        style::line(format_args!("{:width$}  {title}", shipped.name));
    }
    style::line(format_args!("\nhanging-rod is short for hanging-rod-case1."));
}
