//! Jobs of several ranks beside the plain program: the same bits, and what happens where one of them fails.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

const PROGRAM: &str = env!("CARGO_BIN_EXE_varda-mpi");

/// A folder that is gone after the test.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("varda-mpi-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// `varda`: the build of the workspace above where there is one, else this program without MPI.
    fn plain(&self, arguments: &str) -> Output {
        let mut command = match std::env::var_os("VARDA_BINARY") {
            Some(varda) => Command::new(varda),
            None => {
                let mut alone = Command::new(PROGRAM);
                alone.arg("alone");
                alone
            }
        };
        command.args(arguments.split(' ')).current_dir(&self.0).output().unwrap()
    }

    fn job(&self, ranks: usize) -> Command {
        let mut command = mpirun();
        command.args(["-n", &ranks.to_string(), PROGRAM]).current_dir(&self.0);
        command
    }

    fn ranks(&self, ranks: usize, arguments: &str) -> Output {
        self.job(ranks).args(arguments.split(' ')).output().unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn mpirun() -> Command {
    let mut command = Command::new("mpirun");
    command.arg("--oversubscribe").env("RAYON_NUM_THREADS", "1").stdin(Stdio::null());
    // Open MPI wants to be asked twice; others look at neither.
    command.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    command
}

#[track_caller]
fn ends_with(output: &Output, code: i32) -> (String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(code), "{out}\n{err}");
    (out, err)
}

/// A table without its columns of seconds, which are clock times.
fn table(path: &Path) -> String {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    let kept: Vec<usize> = (0..rows[0].len()).filter(|i| !rows[0][*i].starts_with("seconds")).collect();
    let line =
        |row: &Vec<&str>| kept.iter().filter_map(|i| row.get(*i).copied()).collect::<Vec<_>>().join(",");
    rows.iter().map(|row| line(row) + "\n").collect()
}

/// summary.json without what a clock or the memory of a process says.
fn summary(folder: &Path) -> Value {
    let text = std::fs::read_to_string(folder.join("summary.json")).unwrap();
    let mut summary: Value = serde_json::from_str(&text).unwrap();
    for key in ["seconds", "peak_bytes"] {
        summary.as_object_mut().unwrap().remove(key);
    }
    if let Some(cycles) = summary["cycles"].as_object_mut() {
        cycles.remove("seconds_each");
    }
    summary
}

#[track_caller]
fn same(a: &Path, b: &Path, tables: &[&str]) {
    for name in tables {
        let (x, y) = (table(&a.join(name)), table(&b.join(name)));
        assert!(x.len() > 100, "{name}: {x}");
        assert!(x == y, "{name} of {} and {} differ", a.display(), b.display());
    }
    assert_eq!(summary(a), summary(b));
}

const TABLES: [&str; 4] = ["analysis.csv", "trajectory.csv", "observations.csv", "convergence.csv"];

#[test]
fn an_ensemble_has_the_same_bits_on_any_number_of_ranks() {
    let folder = Folder::new("ensemble");
    // a rod, whose steps need Newton's method, and Lorenz's ring
    let rod = "run hanging-rod --set algorithm={method=\"4denvar\",ensemble={members=6}} --set \
               time.window=20 --quiet --out";
    for (name, scene) in [("rod", rod), ("ring", "run lorenz96-4denvar --quiet --out")] {
        let plain = folder.plain(&format!("{scene} {name}"));
        let code = plain.status.code().unwrap();
        assert!(matches!(code, 0 | 3 | 4), "{plain:?}");
        for ranks in [1, 2, 4] {
            let output = folder.ranks(ranks, &format!("{scene} {name}-{ranks} --counts"));
            let (_, err) = ends_with(&output, code);
            assert!(err.contains(&format!("{ranks} ranks, ")), "{err}");
            same(&folder.path(name), &folder.path(&format!("{name}-{ranks}")), &TABLES);
        }
    }
}

#[test]
fn dense_hessians_have_the_same_bits_on_any_number_of_ranks() {
    let folder = Folder::new("dense");
    // rows of G, which are fewer than its columns; columns; columns of the exact Hessian; errors of the model
    let rod = "run hanging-rod --set time.window=100 --quiet";
    let ring = "run lorenz96 --set time.window=40 --quiet";
    let exact = "algorithm.hessian=\"exact\"";
    let scenes = [
        ("rows", format!("{rod} --set algorithm.minimizer=\"newton\"")),
        ("columns", format!("{ring} --set observations.every=1")),
        ("exact-rod", format!("{rod} --set {exact}")),
        ("exact-ring", format!("{ring} --set {exact}")),
        ("weak", "run hanging-rod-weak --set algorithm.minimizer=\"newton\" --quiet".to_string()),
    ];
    for (name, scene) in scenes {
        let plain = folder.plain(&format!("{scene} --out {name}"));
        let code = plain.status.code().unwrap();
        assert!(matches!(code, 0 | 3 | 4), "{name}: {plain:?}");
        for ranks in [1, 2, 4] {
            let output = folder.ranks(ranks, &format!("{scene} --out {name}-{ranks} --counts"));
            let (_, err) = ends_with(&output, code);
            assert!(
                err.contains(&format!("{ranks} ranks, ")) && !err.contains(" 0 gathers"),
                "{name}: {err}"
            );
            same(&folder.path(name), &folder.path(&format!("{name}-{ranks}")), &TABLES);
        }
    }
}

const CYCLES: &str = "run lorenz96-cycling-4denvar --set algorithm.cycles.spin_up=2 --quiet --out";

#[test]
fn a_sequence_of_windows_is_the_same_and_goes_on_after_a_killed_rank() {
    let folder = Folder::new("cycles");
    let all = "--set algorithm.cycles.count=40";
    ends_with(&folder.plain(&format!("{CYCLES} plain {all}")), 0);
    ends_with(&folder.ranks(2, &format!("{CYCLES} two {all}")), 0);
    same(&folder.path("plain"), &folder.path("two"), &["cycles.csv"]);

    // Killed after its first windows; four ranks go on with what two have begun.
    let mut job = folder.job(2);
    job.args(format!("{CYCLES} killed --set algorithm.cycles.count=5000").split(' '));
    let job = job.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let state = folder.path("killed.partial/state.json");
    let output = kill_a_rank_once(job, || state.exists());
    assert_ne!(output.status.code(), Some(0));
    let text = std::fs::read_to_string(&state).unwrap();
    let next = serde_json::from_str::<Value>(&text).unwrap()["next"].as_u64().unwrap();
    let more = next + 3;
    let counted = format!("--set algorithm.cycles.count={more}");
    ends_with(&folder.ranks(4, &format!("{CYCLES} killed --resume {counted}")), 0);
    ends_with(&folder.plain(&format!("{CYCLES} whole {counted}")), 0);
    same(&folder.path("whole"), &folder.path("killed"), &["cycles.csv"]);
}

const STUDY: &str = "sweep lorenz63 --set observations.sigma=0.5,2.0 --seeds 0..4 --quiet --out";

#[test]
fn a_sweep_has_the_same_table_on_any_number_of_ranks() {
    let folder = Folder::new("sweep");
    ends_with(&folder.plain(&format!("{STUDY} plain")), 0);
    for ranks in [1, 2, 4] {
        ends_with(&folder.ranks(ranks, &format!("{STUDY} {ranks}")), 0);
        for name in ["sweep.csv", "sweep-means.csv"] {
            let of = |out: &str| table(&folder.path(&format!("{out}/{name}")));
            assert_eq!(of("plain"), of(&ranks.to_string()), "{name}, {ranks} ranks");
        }
    }
    // another study in the same folder is refused by one and all, and said once
    let other = folder.ranks(2, "sweep lorenz63 --seeds 0..1 --quiet --out 2");
    let (_, err) = ends_with(&other, 1);
    assert_eq!(err.matches("it holds another sweep").count(), 1, "{err}");
}

#[test]
fn a_sweep_goes_on_after_a_killed_rank() {
    let folder = Folder::new("killed");
    let study = STUDY.replace("0..4", "0..19");
    ends_with(&folder.plain(&format!("{study} plain")), 0);
    let mut job = folder.job(2);
    let job = job.args(format!("{study} s").split(' ')).stdout(Stdio::null()).stderr(Stdio::null());
    let ended = || -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder.path("s/runs")).into_iter().flatten().flatten();
        // a hidden one is being written
        entries
            .map(|e| e.path())
            .filter(|p| !p.file_name().unwrap().to_string_lossy().starts_with('.'))
            .collect()
    };
    let output = kill_a_rank_once(job.spawn().unwrap(), || ended().len() > 2);
    assert_ne!(output.status.code(), Some(0));
    let done = ended();
    assert!((3..40).contains(&done.len()), "{} of 40 runs when a rank was killed", done.len());
    assert!(!folder.path("s/sweep.csv").exists());
    let written =
        || done.iter().map(|p| std::fs::metadata(p).unwrap().modified().unwrap()).collect::<Vec<_>>();
    let before = written();
    ends_with(&folder.ranks(4, &format!("{study} s")), 0);
    assert_eq!(before, written(), "what had ended is not run again");
    assert_eq!(table(&folder.path("plain/sweep.csv")), table(&folder.path("s/sweep.csv")));
    assert!(!folder.path("s/work").exists());
}

#[test]
fn a_rank_that_fails_is_named_and_ends_the_job() {
    let folder = Folder::new("fails");
    for (name, seed) in [("with", 0), ("without", 0), ("other", 1)] {
        std::fs::create_dir(folder.path(name)).unwrap();
        if name != "without" {
            let shown = folder.plain("show lorenz96-4denvar");
            let scene =
                String::from_utf8(shown.stdout).unwrap().replace("seed = 0", &format!("seed = {seed}"));
            std::fs::write(folder.path(name).join("s.toml"), scene).unwrap();
        }
    }
    // two ranks in folders of their own
    let run = |folders: [&str; 2]| {
        let mut command = mpirun();
        for (i, name) in folders.iter().enumerate() {
            command.args(if i > 0 { &[":"][..] } else { &[] });
            command.args(["-n", "1", "--wdir"]).arg(folder.path(name));
            command.args([PROGRAM, "run", "s.toml", "--quiet", "--out", "r"]);
        }
        command.output().unwrap()
    };
    ends_with(&run(["with", "with"]), 0);
    let _ = std::fs::remove_dir_all(folder.path("with/r"));

    let (_, err) = ends_with(&run(["with", "without"]), 1);
    assert!(err.contains("error: rank 1 on ") && err.contains("no scene \"s.toml\""), "{err}");
    let (_, err) = ends_with(&run(["without", "with"]), 1);
    assert!(err.contains("error: rank 0 on ") && err.contains("no scene \"s.toml\""), "{err}");
    let (_, err) = ends_with(&run(["without", "without"]), 1);
    assert!(err.contains("error: no scene") && err.matches("no scene").count() == 1, "{err}");
    let (_, err) = ends_with(&run(["with", "other"]), 1);
    assert!(err.contains("error: rank 1 on ") && err.contains("other numbers than rank 0"), "{err}");
    assert!(!folder.path("with/r").exists(), "no result of a job that failed");
}

#[test]
fn what_ranks_cannot_share_is_refused() {
    let folder = Folder::new("refused");
    let refused = |arguments: &str, code: i32, why: &str| {
        let (_, err) = ends_with(&folder.ranks(2, arguments), code);
        assert_eq!(err.matches(why).count(), 1, "{err}");
    };
    refused("run lorenz63 --quiet", 1, "share the members of an ensemble");
    refused(
        "run hanging-rod --set algorithm.method=\"4d-psas\" --set report.posterior=false --quiet",
        1,
        "has none of them",
    );
    refused("run lorenz96-4denvar --set limits.seconds=9.0 --quiet", 1, "no clock in common");
    refused("sweep lorenz63 --seeds 0..3 --part 1/2 --quiet", 1, "divide the whole sweep");
    refused("check lorenz63", 2, "Usage: mpirun");
    refused("run lorenz63 --nonsense", 2, "unexpected argument");
}

/// Kills one rank of a job once something has happened, and waits for the job.
fn kill_a_rank_once(job: Child, happened: impl Fn() -> bool) -> Output {
    let started = Instant::now();
    let mut job = job;
    while !happened() {
        assert!(started.elapsed() < Duration::from_secs(60), "nothing happened within a minute");
        assert!(job.try_wait().unwrap().is_none(), "the job has ended before");
        std::thread::sleep(Duration::from_millis(2));
    }
    let last = ranks_of(job.id()).last().copied().expect("a job has ranks");
    let kill = Command::new("sh").args(["-c", &format!("kill -9 {last}")]).status();
    assert!(kill.unwrap().success());
    job.wait_with_output().unwrap()
}

/// The processes of our program that another one has started.
fn ranks_of(parent: u32) -> Vec<u32> {
    let processes = std::fs::read_dir("/proc").unwrap().flatten();
    let numbers = processes.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    let is_rank = |process: &u32| {
        // number (name) state parent ...
        let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
        let after = stat.rsplit(')').next().unwrap_or_default();
        stat.contains("(varda-mpi)") && after.split_whitespace().nth(1) == Some(&parent.to_string())
    };
    numbers.filter(is_rank).collect()
}
