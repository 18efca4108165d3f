//! The runs of a study: child processes of one program, and a file for each that has ended.

use std::ffi::OsStr;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::grid::{Part, Plan, Run};
use crate::Error;
use crate::setup::constant::is_of_constant;

/// How long to wait for the end of a process before it is asked again whether to go on.
const PAUSE: Duration = Duration::from_millis(50);
/// A signal that has ended a child has reached this program by then.
const SIGNAL: Duration = Duration::from_millis(300);
/// The exit code of a run that was interrupted.
const INTERRUPTED: i32 = 130;

/// What a run gave: `runs/<index>.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Its place in the grid, from 0.
    pub index: usize,
    /// `key=value`, for each key.
    pub settings: Vec<String>,
    /// Its seed.
    pub seed: u64,
    /// That of its [`Run`].
    pub checksum: String,
    /// Exit code of the process; `null` where a signal ended it.
    pub exit_code: Option<i32>,
    /// Why there is no result.
    pub error: Option<String>,
    /// Components of the state whose truth is within 1.96 σ of the analysis, and how many have a σ; `null`
    /// where truth or σ are not known.
    pub state_within: Option<[usize; 2]>,
    /// From its start to its end \[s\].
    pub seconds: f64,
    /// summary.json of the run; `null` where it has none.
    pub summary: Option<Value>,
}

impl Record {
    /// Whether there is no result.
    pub fn has_failed(&self) -> bool {
        self.error.is_some()
    }
}

/// How far a study is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Runs that have ended, now or before.
    pub done: usize,
    /// Those that had ended before.
    pub before: usize,
    /// All runs of this share.
    pub count: usize,
    /// Those without a result.
    pub failures: usize,
}

/// A study that can be run.
#[derive(Debug)]
pub struct Study<'a> {
    /// The program `varda`.
    pub program: &'a Path,
    /// What stands before `run` in its arguments.
    pub leading: &'a [&'a str],
    /// The scene as the program is given it.
    pub scene: &'a str,
    /// Which runs there are.
    pub plan: &'a Plan,
    /// Which of them are this one's.
    pub part: Part,
    /// Folder of the study.
    pub folder: &'a Path,
    /// How many processes at a time.
    pub jobs: usize,
    /// Whether runs that have ended are run again.
    pub fresh: bool,
}

impl Study<'_> {
    /// Runs what has not been run yet, and tells of each that ends. Where `interrupted` becomes true the
    /// processes are ended and what is done is left; returns how far it came.
    ///
    /// # Errors
    /// [`Error::Occupied`], [`Error::Sweep`] where the folder holds another study, [`Error::Write`]. A run
    /// that fails is no error: its [`Record`] says so.
    pub fn run(
        &self,
        on_run: &mut dyn FnMut(Progress),
        interrupted: &dyn Fn() -> bool,
    ) -> Result<Progress, Error> {
        begin(self.folder, self.plan, self.part, self.fresh)?;
        clear_work(self.folder, self.part);
        let share: Vec<usize> = self.part.runs(self.plan.count()).collect();
        let mut progress = Progress { done: 0, before: 0, count: share.len(), failures: 0 };
        let mut open = Vec::new();
        for index in share {
            let run = self.plan.run(index);
            match read(self.folder, &run)? {
                Some(record) => {
                    progress.before += 1;
                    progress.failures += usize::from(record.has_failed());
                }
                None => open.push(run),
            }
        }
        progress.done = progress.before;
        open.reverse();
        let mut running: Vec<Running> = Vec::new();
        let (tells, told) = channel();
        while !open.is_empty() || !running.is_empty() {
            while running.len() < self.jobs.max(1) && !open.is_empty() && !interrupted() {
                running.extend(open.pop().map(|run| self.start(run, &tells)).transpose()?);
            }
            let index = told.recv_timeout(PAUSE).ok();
            if let Some(place) = running.iter().position(|one| Some(one.run.index) == index) {
                let mut one = running.swap_remove(place);
                let status = one.process.wait().map_err(|reason| Error::Sweep {
                    path: one.folder.clone(),
                    reason: format!("its process cannot be waited for: {reason}"),
                })?;
                let record = one.record(status);
                let was_told = status.code() == Some(INTERRUPTED);
                if was_told {
                    std::thread::sleep(SIGNAL);
                }
                if !(was_told && interrupted()) {
                    let text = serde_json::to_string_pretty(&record).unwrap_or_default();
                    write_whole(&file_of(self.folder, record.index), &text)?;
                    progress.done += 1;
                    progress.failures += usize::from(record.has_failed());
                    on_run(progress);
                }
            }
            if interrupted() {
                // Dropping one ends its process.
                running.clear();
                open.clear();
            }
        }
        clear_work(self.folder, self.part);
        Ok(progress)
    }

    /// Starts a run. When it has ended its index comes through `tells`: a thread reads its output, of which
    /// there is nothing but the end.
    fn start(&self, run: Run, tells: &Sender<usize>) -> Result<Running, Error> {
        let work = self.folder.join(WORK);
        let folder = work.join(format!("{}-{}", run.index, std::process::id()));
        let failed = |path: &Path| {
            let path = path.to_path_buf();
            move |reason| Error::Write { path, reason }
        };
        std::fs::create_dir_all(&folder).map_err(failed(&folder))?;
        let messages = folder.join(MESSAGES);
        let stderr = File::create(&messages).map_err(failed(&messages))?;
        let mut command = Command::new(self.program);
        command.args(self.leading).arg("run").arg(self.scene);
        run.settings.iter().for_each(|setting| {
            command.arg("--set").arg(setting);
        });
        command.args(["--seed", &run.seed.to_string(), "--quiet", "--out"]).arg(folder.join(RESULT));
        command.env("RAYON_NUM_THREADS", "1").env("NO_COLOR", "1").env_remove("CLICOLOR_FORCE");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(stderr);
        let cannot = |reason| Error::Sweep {
            path: self.program.to_path_buf(),
            reason: format!("a run cannot be started: {reason}"),
        };
        let started = Instant::now();
        let process = command.spawn().map_err(cannot)?;
        let mut running = Running { run, folder, process, started };
        let (output, index, tells) = (running.process.stdout.take(), running.run.index, tells.clone());
        let wait = move || {
            let _ = output.map(|mut output| std::io::copy(&mut output, &mut std::io::sink()));
            // nobody listens any more where the study has ended
            let _ = tells.send(index);
        };
        std::thread::Builder::new().spawn(wait).map_err(cannot)?;
        Ok(running)
    }
}

/// A process, and its folder while it lives. Dropped, both are gone.
struct Running {
    run: Run,
    folder: PathBuf,
    process: Child,
    started: Instant,
}

impl Running {
    fn record(&self, status: ExitStatus) -> Record {
        let result = self.folder.join(RESULT);
        let text = std::fs::read_to_string(result.join("summary.json")).unwrap_or_default();
        let summary: Option<Value> = serde_json::from_str(&text).ok();
        let has_result = summary.as_ref().is_some_and(|summary| summary["status"] != "failed");
        let messages = std::fs::read(self.folder.join(MESSAGES)).unwrap_or_default();
        let message = last_message(&String::from_utf8_lossy(&messages)).unwrap_or(status.to_string());
        Record {
            index: self.run.index,
            settings: self.run.settings.clone(),
            seed: self.run.seed,
            checksum: self.run.checksum.clone(),
            exit_code: status.code(),
            error: (!has_result).then_some(message),
            state_within: state_within(&result, summary.as_ref()),
            seconds: self.started.elapsed().as_secs_f64(),
            summary,
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // Of a process that has ended both do nothing.
        let _ = self.process.kill();
        let _ = self.process.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// The last error that a program has told, else its last line: an excerpt of a scene follows the first,
/// advice follows a panic.
fn last_message(text: &str) -> Option<String> {
    let lines = || text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with("note: "));
    let error = lines().filter_map(|line| line.strip_prefix("error: ")).next_back();
    error.or_else(|| lines().next_back()).map(str::to_string)
}

/// Of a run's analysis.csv, or those of its recordings: how many components of the truth are within 1.96 σ
/// of the analysis, and how many have a σ. Constants are none of the state.
fn state_within(result: &Path, summary: Option<&Value>) -> Option<[usize; 2]> {
    let names = summary?["recordings"].as_array();
    let folders: Vec<PathBuf> = match names {
        Some(all) => all.iter().filter_map(|one| Some(result.join(one["scene"].as_str()?))).collect(),
        None => vec![result.to_path_buf()],
    };
    let mut within = [0, 0];
    for folder in folders {
        let mut table = csv::Reader::from_path(folder.join("analysis.csv")).ok()?;
        let header = table.headers().ok()?.clone();
        let place = |name: &str| header.iter().position(|n| n == name);
        let (name, places) = (place("name")?, [place("x_a")?, place("sigma_a")?, place("truth")?]);
        for row in table.records() {
            let row = row.ok()?;
            if is_of_constant(row.get(name)?) {
                continue;
            }
            let numbers = places.map(|at| row.get(at).and_then(|cell| cell.parse::<f64>().ok()));
            let [Some(analysis), Some(sigma), Some(truth)] = numbers else { continue };
            if sigma > 0.0 {
                within[1] += 1;
                within[0] += usize::from((analysis - truth).abs() <= 1.96 * sigma);
            }
        }
    }
    (within[1] > 0).then_some(within)
}

const PLAN: &str = "sweep.json";
const RUNS: &str = "runs";
/// Folders of running processes.
const WORK: &str = "work";
const RESULT: &str = "result";
const MESSAGES: &str = "stderr";

/// Makes the folder of a study, or finds it: the same study goes on, its runs of this part once more where
/// `fresh`.
///
/// # Errors
/// [`Error::Occupied`], [`Error::Sweep`] where the folder holds another study, [`Error::Write`].
pub fn begin(folder: &Path, plan: &Plan, part: Part, fresh: bool) -> Result<(), Error> {
    // Another share may be about to write its plan.
    let is_plan = |name: &OsStr| name.to_string_lossy().starts_with(&format!(".{PLAN}."));
    let is_new = match std::fs::read_dir(folder) {
        Ok(entries) => entries.flatten().all(|entry| is_plan(&entry.file_name())),
        Err(_) if folder.exists() => {
            return Err(Error::Occupied { path: folder.to_path_buf(), reason: "it is a file" });
        }
        Err(_) => true,
    };
    let failed = |reason| Error::Write { path: folder.join(RUNS), reason };
    if !is_new {
        let earlier = read_plan(folder);
        if matches!(&earlier, Err(Error::Sweep { .. })) && !folder.join(PLAN).exists() {
            return Err(Error::Occupied { path: folder.to_path_buf(), reason: "it has no sweep.json" });
        }
        let difference = match &earlier {
            Ok(earlier) => earlier.difference(plan),
            Err(error) => Some(error.to_string()),
        };
        match difference {
            Some(difference) if !fresh => {
                let reason = format!(
                    "it holds another sweep ({difference}); begin again with --fresh, or choose another \
                     folder with --out"
                );
                return Err(Error::Sweep { path: folder.to_path_buf(), reason });
            }
            Some(_) => std::fs::remove_dir_all(folder.join(RUNS)).or_else(unless_missing).map_err(failed)?,
            None if fresh => {
                for index in part.runs(plan.count()) {
                    std::fs::remove_file(file_of(folder, index)).or_else(unless_missing).map_err(failed)?;
                }
            }
            None => {}
        }
    }
    std::fs::create_dir_all(folder).map_err(failed)?;
    // First: a folder without it is not a study's.
    write_whole(&folder.join(PLAN), &serde_json::to_string_pretty(plan).unwrap_or_default())?;
    std::fs::create_dir_all(folder.join(RUNS)).map_err(failed)
}

fn unless_missing(reason: std::io::Error) -> std::io::Result<()> {
    if reason.kind() == std::io::ErrorKind::NotFound { Ok(()) } else { Err(reason) }
}

/// Removes what killed processes of a share have left; the folder stays where another share is running.
fn clear_work(folder: &Path, part: Part) {
    let work = folder.join(WORK);
    for entry in std::fs::read_dir(&work).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let index = name.split('-').next().and_then(|index| index.parse::<usize>().ok());
        if index.is_some_and(|index| index % part.of == part.which - 1) {
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
    let _ = std::fs::remove_dir(&work);
}

fn file_of(folder: &Path, index: usize) -> PathBuf {
    folder.join(RUNS).join(format!("{index}.json"))
}

/// The plan of the study in a folder.
///
/// # Errors
/// [`Error::Sweep`].
pub fn read_plan(folder: &Path) -> Result<Plan, Error> {
    let path = folder.join(PLAN);
    let text = std::fs::read_to_string(&path);
    let text = text.map_err(|e| Error::Sweep { path: path.clone(), reason: format!("no sweep: {e}") })?;
    serde_json::from_str(&text).map_err(|e| Error::Sweep { path, reason: format!("no plan of a sweep: {e}") })
}

/// The record of a run; `None` where it has not ended, or its file is not whole.
fn read(folder: &Path, run: &Run) -> Result<Option<Record>, Error> {
    let path = file_of(folder, run.index);
    let text = std::fs::read_to_string(&path).unwrap_or_default();
    let Ok(record) = serde_json::from_str::<Record>(&text) else { return Ok(None) };
    if record.checksum != run.checksum || record.index != run.index {
        let reason = format!(
            "it is of another run ({}, seed {}), not of {}, seed {}; begin again with --fresh",
            record.settings.join(" "),
            record.seed,
            run.settings.join(" "),
            run.seed
        );
        return Err(Error::Sweep { path, reason });
    }
    Ok(Some(record))
}

/// The records of a study in the order of its grid.
///
/// # Errors
/// [`Error::Sweep`] where a run is missing, or is of another study.
pub fn records(folder: &Path, plan: &Plan) -> Result<Vec<Record>, Error> {
    let (mut records, mut missing) = (Vec::new(), Vec::new());
    for index in 0..plan.count() {
        match read(folder, &plan.run(index))? {
            Some(record) => records.push(record),
            None => missing.push(index),
        }
    }
    match missing.first() {
        None => Ok(records),
        Some(first) => Err(Error::Sweep {
            path: folder.to_path_buf(),
            reason: format!(
                "{} of {} runs are missing, the first is run {first}; run their parts first",
                missing.len(),
                plan.count()
            ),
        }),
    }
}

/// Puts the runs of several folders of one study into `out`.
///
/// # Errors
/// [`Error::Sweep`] where they are not of one study; [`Error::Occupied`], [`Error::Write`].
pub fn merge(folders: &[PathBuf], out: &Path) -> Result<Plan, Error> {
    let nothing = || Error::Sweep { path: out.to_path_buf(), reason: "there is nothing to merge".into() };
    let first = folders.first().ok_or_else(nothing)?;
    let plan = read_plan(first)?;
    for folder in &folders[1..] {
        if let Some(difference) = read_plan(folder)?.difference(&plan) {
            let reason = format!("it is no part of the sweep in {}: {difference}", first.display());
            return Err(Error::Sweep { path: folder.clone(), reason });
        }
    }
    begin(out, &plan, Part::WHOLE, false)?;
    for index in 0..plan.count() {
        let run = plan.run(index);
        if read(out, &run)?.is_some() {
            continue;
        }
        for folder in folders {
            if read(folder, &run)?.is_some() {
                let from = file_of(folder, index);
                let text = std::fs::read_to_string(&from);
                let text = text.map_err(|e| Error::Sweep { path: from, reason: e.to_string() })?;
                write_whole(&file_of(out, index), &text)?;
                break;
            }
        }
    }
    Ok(plan)
}

/// Writes a file whole or not at all: under a hidden name first.
///
/// # Errors
/// [`Error::Write`].
pub(crate) fn write_whole(path: &Path, text: &str) -> Result<(), Error> {
    let name = path.file_name().map(OsStr::to_string_lossy).unwrap_or_default();
    let hidden = path.with_file_name(format!(".{name}.{}", std::process::id()));
    std::fs::write(&hidden, text)
        .and_then(|()| std::fs::rename(&hidden, path))
        .map_err(|reason| Error::Write { path: path.to_path_buf(), reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_message_of_a_failure_is_its_error_or_its_last_line() {
        let of = |text| last_message(text);
        assert_eq!(of("error: a.toml:1:2: no\n    1 | x\n      | ^\n").unwrap(), "a.toml:1:2: no");
        let panic = "thread 'main' panicked at x.rs:1:1:\nout of cheese\nnote: run with RUST_BACKTRACE=1\n";
        assert_eq!(of(panic).unwrap(), "out of cheese");
        assert_eq!(of("\n"), None);
    }
}
