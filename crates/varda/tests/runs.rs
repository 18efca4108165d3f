//! Runs that end badly: by a signal, killed, out of room, beside another. What they leave is whole, or
//! plainly unfinished.
#![cfg(unix)]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("varda-runs-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn command(&self, scene: &str, sets: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_varda"));
        command.args(["run", scene, "--quiet", "--out", "r"]).current_dir(&self.0);
        command.args(sets.iter().flat_map(|s| ["--set", s])).stderr(Stdio::piped()).stdout(Stdio::null());
        command
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A result is whole: its summary says a status, and every file a run writes is there.
fn whole(result: &Path) -> String {
    let text = std::fs::read_to_string(result.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    for file in ["report.html", "analysis.csv", "trajectory.csv"] {
        assert!(std::fs::metadata(result.join(file)).unwrap().len() > 0, "{file}");
    }
    summary["status"].as_str().unwrap().to_string()
}

fn signal(child: &Child, name: &str) {
    assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
}

const CYCLES: [&str; 3] =
    ["background.covariance.steps=3000", "algorithm.cycles.spin_up=0", "algorithm.cycles.count=400"];

#[test]
fn ctrl_c_and_sigterm_leave_a_valid_partial_result() {
    for name in ["-INT", "-TERM"] {
        let folder = Folder::new(&format!("signal{name}"));
        let mut child = folder.command("lorenz96-cycling-4dvar", &CYCLES).spawn().unwrap();
        let begun = Instant::now();
        while !folder.0.join("r.partial/state.json").exists() && begun.elapsed() < Duration::from_secs(30) {
            std::thread::sleep(Duration::from_millis(1));
        }
        signal(&child, name);
        assert_eq!(child.wait().unwrap().code(), Some(130), "{name}");
        assert_eq!(whole(&folder.0.join("r")), "interrupted");
        // What is unfinished beside it goes on to the end.
        let resumed = folder.command("lorenz96-cycling-4dvar", &CYCLES).arg("--resume").output().unwrap();
        assert!(resumed.status.success(), "{}", String::from_utf8_lossy(&resumed.stderr));
        assert_ne!(whole(&folder.0.join("r")), "interrupted");
        assert_eq!(folder.names(), ["r"]);
    }
    // One window: the last accepted point is the result.
    for name in ["-INT", "-TERM"] {
        let folder = Folder::new(&format!("window{name}"));
        // Many minutes of iterations.
        let long = [
            "algorithm.minimizer=adam",
            "algorithm.gradient_tolerance=1e-30",
            "algorithm.max_iterations=1000000",
        ];
        let child = folder.command("hanging-rod-case4", &long).spawn().unwrap();
        std::thread::sleep(Duration::from_secs(1));
        signal(&child, name);
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(130), "{name}: {}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(whole(&folder.0.join("r")), "interrupted");
        assert_eq!(folder.names(), ["r"]);
    }
}

/// `VARDA_KILLS` sets how often; 50 without it. Every second time there is an earlier result, which is being
/// replaced.
#[test]
fn a_run_killed_at_any_moment_leaves_nothing_that_looks_finished() {
    let kills: u64 = std::env::var("VARDA_KILLS").ok().and_then(|k| k.parse().ok()).unwrap_or(50);
    let folder = Folder::new("kill");
    let run = || folder.command("lorenz63", &[]);
    let begun = Instant::now();
    assert!(run().status().unwrap().success());
    let takes = begun.elapsed();
    let mut killed = 0;
    for k in 0..kills {
        if k % 2 == 0 {
            let _ = std::fs::remove_dir_all(folder.0.join("r"));
        }
        let mut child = run().spawn().unwrap();
        // Moments spread over the run and, more closely, over its end, where files are written.
        let part = (k as f64 + 0.5) / kills as f64;
        std::thread::sleep(takes.mul_f64(part.sqrt()));
        let _ = child.kill();
        killed += usize::from(!child.wait().unwrap().success());
        if folder.0.join("r").exists() {
            whole(&folder.0.join("r"));
        }
    }
    assert!(killed > 0, "not one of {kills} runs was killed before its end");
    assert!(run().status().unwrap().success(), "what the killed runs left is in nobody's way");
    assert_eq!(folder.names(), ["r"], "and it is gone");
}

impl Folder {
    fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(&self.0)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// The hidden folders of runs that are writing, or were killed at it.
    fn hidden(&self) -> Vec<String> {
        let mut names = self.names();
        names.retain(|n| n.starts_with(".r.varda-") && !n.ends_with(".lock"));
        names
    }

    /// A run that is caught while it has a hidden folder, by a signal after which it does nothing more.
    fn caught(&self, name: &str) -> Child {
        for _ in 0..200 {
            let mut child = self.command("lorenz63", &["time.window=1000"]).spawn().unwrap();
            while self.hidden().is_empty() && child.try_wait().unwrap().is_none() {}
            if child.try_wait().unwrap().is_some() {
                continue;
            }
            signal(&child, name);
            std::thread::sleep(Duration::from_millis(2));
            if !self.hidden().is_empty() {
                return child;
            }
            let _ = child.kill();
            child.wait().unwrap();
        }
        panic!("not one of 200 runs was caught writing");
    }
}

/// Killed while it writes, a run leaves a hidden folder; the next one removes it and says so. That of a run
/// that is only slow stays.
#[test]
fn what_a_killed_run_left_is_removed_by_the_next_but_not_what_a_live_one_writes() {
    let folder = Folder::new("left");
    folder.caught("-KILL").wait().unwrap();
    let left = folder.hidden();
    let program = env!("CARGO_BIN_EXE_varda");
    let run =
        || Command::new(program).args(["run", "lorenz63", "--out", "r"]).current_dir(&folder.0).output();
    let output = run().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).to_string();
    assert!(output.status.success() && message.contains("removed what killed runs had left"), "{message}");
    assert!(left.iter().all(|name| message.contains(name)), "{left:?}: {message}");
    assert_eq!(folder.names(), ["r"]);

    let mut stopped = folder.caught("-STOP");
    let held = folder.hidden();
    let output = run().unwrap();
    assert!(output.status.success() && !String::from_utf8_lossy(&output.stderr).contains("removed"));
    assert_eq!(folder.hidden(), held, "a run that holds its lock is let alone");
    signal(&stopped, "-CONT");
    // Over so long a window it finds no minimum, or a wrong one.
    assert!(matches!(stopped.wait().unwrap().code(), Some(3 | 4)));
    assert_eq!(folder.names(), ["r"]);
    whole(&folder.0.join("r"));
}

/// A limit on the size of a file stands for a full disk: a write in the middle of a file fails.
#[test]
fn a_disk_without_room_is_an_error_that_names_the_file() {
    let folder = Folder::new("full");
    let program = env!("CARGO_BIN_EXE_varda");
    let limited = |blocks: usize, arguments: &str| {
        let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec '{program}' {arguments}");
        let output = Command::new("sh").args(["-c", &script]).current_dir(&folder.0).output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr).to_string();
        assert_eq!(output.status.code(), Some(1), "{message}");
        message
    };
    for arguments in ["run lorenz63 --quiet --out r", "simulate lorenz63 --quiet --out r"] {
        let message = limited(1, arguments);
        assert!(message.contains("cannot write r/"), "{message}");
        assert_eq!(folder.names(), [""; 0], "nothing is left");
    }
    let message = limited(0, "new scene");
    assert!(message.contains("cannot write scene.toml"), "{message}");
    assert_eq!(folder.names(), [""; 0], "nothing is left");

    // A sequence keeps the windows it has stored, and goes on when there is room again.
    let sets = "--set background.covariance.steps=3000 --set algorithm.cycles.spin_up=0 --set \
     algorithm.cycles.count=40";
    let message = limited(50, &format!("run lorenz96-cycling-4dvar {sets} --quiet --out r"));
    assert!(message.contains("cannot write r.partial/cycles.jsonl"), "{message}");
    assert_eq!(folder.names(), ["r.partial"]);
    let run = |more: &[&str]| {
        let mut command = Command::new(program);
        command.args(["run", "lorenz96-cycling-4dvar", "--quiet"]).args(sets.split(' ')).args(more);
        assert!(command.current_dir(&folder.0).status().unwrap().success());
    };
    run(&["--out", "r", "--resume"]);
    run(&["--out", "uninterrupted"]);
    for file in ["analysis.csv", "trajectory.csv"] {
        let read = |result: &str| std::fs::read_to_string(folder.0.join(result).join(file)).unwrap();
        assert_eq!(read("r"), read("uninterrupted"), "{file}");
    }
}

/// In /proc nobody can make a folder, not even root.
#[test]
fn a_folder_that_takes_nothing_is_an_error_that_names_it() {
    let folder = Folder::new("readonly");
    let output = folder.command("lorenz63", &[]).args(["--out", "/proc/r"]).output().unwrap();
    let twice = String::from_utf8_lossy(&output.stderr).to_string();
    assert!(!output.status.success(), "{twice}");
    let output =
        Command::new(env!("CARGO_BIN_EXE_varda")).args(["run", "lorenz63", "--out", "/proc/r"]).output();
    let message = String::from_utf8_lossy(&output.unwrap().stderr).to_string();
    assert!(message.contains("cannot write /proc/"), "{message}");
}

#[test]
fn two_runs_into_one_folder_do_not_mix() {
    let folder = Folder::new("two");
    for _ in 0..4 {
        let seeds = ["seed=1", "seed=2", "seed=3"];
        let children: Vec<Child> =
            seeds.iter().map(|s| folder.command("lorenz63", &[s]).spawn().unwrap()).collect();
        for child in children {
            let output = child.wait_with_output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
        // One of them, and all of it of one seed.
        whole(&folder.0.join("r"));
        let text = std::fs::read_to_string(folder.0.join("r/summary.json")).unwrap();
        let seed = serde_json::from_str::<serde_json::Value>(&text).unwrap()["seed"].as_u64().unwrap();
        let alone = Folder::new("alone");
        assert!(alone.command("lorenz63", &[&format!("seed={seed}")]).status().unwrap().success());
        for file in ["analysis.csv", "trajectory.csv"] {
            let read = |f: &Folder| std::fs::read_to_string(f.0.join("r").join(file)).unwrap();
            assert_eq!(read(&folder), read(&alone), "{file}");
        }
        assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 1, "nothing is left beside the result");
    }
}

/// The unfinished run of a cycling scene is taken up only as it was left.
#[test]
fn a_state_that_was_tampered_with_is_not_resumed() {
    let folder = Folder::new("tamper");
    let mut child = folder.command("lorenz96-cycling-4dvar", &CYCLES).spawn().unwrap();
    let state = folder.0.join("r.partial/state.json");
    let begun = Instant::now();
    while !state.exists() && begun.elapsed() < Duration::from_secs(30) {
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let good = std::fs::read_to_string(&state).unwrap();
    let mut short: serde_json::Value = serde_json::from_str(&good).unwrap();
    short["background"].as_array_mut().unwrap().pop();
    let mut ahead: serde_json::Value = serde_json::from_str(&good).unwrap();
    ahead["next"] = 399.into();
    for bad in ["", "{", "[]", &good[..good.len() / 2], &short.to_string(), &ahead.to_string()] {
        std::fs::write(&state, bad).unwrap();
        let output = folder.command("lorenz96-cycling-4dvar", &CYCLES).arg("--resume").output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr).to_string();
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains("r.partial cannot be resumed"), "{message}");
    }
}

/// A run of a scene with files of its own, killed after its first window, goes on only where neither the
/// scene nor a file has changed.
#[test]
fn a_run_whose_scene_or_data_have_changed_is_not_resumed() {
    let folder = Folder::new("changed");
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let (scene, data) =
        ("hanging-rod-csv.toml", ["hanging-rod-background.csv", "hanging-rod-observations.csv"]);
    std::fs::create_dir(folder.0.join("data")).unwrap();
    for file in [scene.to_string()].into_iter().chain(data.map(|d| format!("data/{d}"))) {
        std::fs::copy(scenes.join(&file), folder.0.join(&file)).unwrap();
    }
    let sets = ["time.window=20", "algorithm.cycles.count=5", "algorithm.minimizer=trust-region"];
    let mut child = folder.command(scene, &sets).spawn().unwrap();
    let begun = Instant::now();
    while !folder.0.join("r.partial/state.json").exists() && begun.elapsed() < Duration::from_secs(60) {
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    assert!(!child.wait().unwrap().success() && !folder.0.join("r").exists());

    let resume = || folder.command(scene, &sets).arg("--resume").output().unwrap();
    let change = |file: &str, from: &str, to: &str, expected: &str| {
        let path = folder.0.join(file);
        let text = std::fs::read_to_string(&path).unwrap();
        let changed = text.replacen(from, to, 1);
        assert_ne!(changed, text, "{file} has no {from:?}");
        std::fs::write(&path, changed).unwrap();
        let output = resume();
        let message = String::from_utf8_lossy(&output.stderr).to_string();
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(message.contains("r.partial cannot be resumed") && message.contains(expected), "{message}");
        std::fs::write(&path, text).unwrap();
    };
    change(
        scene,
        "density = 1100.0",
        "density = 1101.0",
        "model.material.density was 1100.0 and is 1101.0 now",
    );
    for (file, key) in data.iter().zip(["background.file", "observations.file"]) {
        // The last digit of the last number.
        let text = std::fs::read_to_string(folder.0.join("data").join(file)).unwrap();
        let last = text.trim_end().lines().last().unwrap();
        let (rest, digit) = last.split_at(last.len() - 1);
        let other = format!("{rest}{}", if digit == "1" { 2 } else { 1 });
        change(&format!("data/{file}"), last, &other, &format!("data/{file} ({key}) has changed"));
    }
    assert!(resume().status.success(), "as it was, it goes on");
    assert_eq!(whole(&folder.0.join("r")), "converged");
    assert!(!folder.0.join("r.partial").exists());
}

/// Named pipes in the place of a scene's data files: each can be read once, and a program that opened one
/// again would wait for ever.
#[test]
fn every_input_file_is_read_once() {
    let folder = Folder::new("once");
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    std::fs::create_dir(folder.0.join("data")).unwrap();
    std::fs::copy(scenes.join("hanging-rod-csv.toml"), folder.0.join("hanging-rod-csv.toml")).unwrap();
    let data = ["data/hanging-rod-background.csv", "data/hanging-rod-observations.csv"];
    let cycles = ["--set", "time.window=20", "--set", "algorithm.cycles.count=5"];
    for (command, more) in [("run", &[][..]), ("run", &cycles), ("check", &[]), ("simulate", &[])] {
        for file in data {
            let pipe = folder.0.join(file);
            let _ = std::fs::remove_file(&pipe);
            assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
            let text = std::fs::read(scenes.join(file)).unwrap();
            // Opening a pipe for writing waits for its reader.
            std::thread::spawn(move || std::fs::write(pipe, text));
        }
        let mut program = Command::new(env!("CARGO_BIN_EXE_varda"));
        program.args([command, "hanging-rod-csv.toml"]).args(more).current_dir(&folder.0);
        let mut child = program.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let begun = Instant::now();
        let ended = loop {
            match child.try_wait().unwrap() {
                Some(status) => break Some(status),
                None if begun.elapsed() > Duration::from_secs(60) => break None,
                None => std::thread::sleep(Duration::from_millis(5)),
            }
        };
        if ended.is_none() {
            child.kill().unwrap();
        }
        let message = String::from_utf8_lossy(&child.wait_with_output().unwrap().stderr).to_string();
        assert!(ended.is_some_and(|s| s.success()), "{command} {more:?}: {ended:?} {message}");
    }
}

/// A drive seen five times a period: on the steps of the scene nothing is said; with eight steps a period the
/// observations lie between steps that a cubic joins well, and a straight line, which is midpoint's, badly.
#[test]
fn observations_between_coarse_steps_are_said() {
    let warned = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        let file = varda::scene::SceneFile::open("hanging-rod-csv", &sets).unwrap();
        let problem = varda::setup::Problem::from_scene(&file).unwrap();
        let outcome = varda::run::assimilate(&problem, &mut varda::run::Listener::silent()).unwrap();
        let warned = |what: &str| outcome.warnings.iter().any(|w| w.contains(what));
        [warned("a straight line is off"), warned("a cubic is off")]
    };
    let coarse = [
        "time.steps_per_period=8",
        "time.window=16",
        "time.spin_up=24",
        "observations.outside_window=skip",
        "time.integrator=backward-euler",
    ];
    assert_eq!(warned(&[]), [false, false]);
    assert_eq!(warned(&coarse), [false, false]);
    let lines: Vec<&str> = coarse[..4].iter().copied().chain(["time.integrator=midpoint"]).collect();
    assert_eq!(warned(&lines), [true, false]);
}
