//! Runs that end badly: by a signal, killed, out of room, beside another. What they leave is whole, or plainly unfinished.
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
    }
}

/// `VARDA_KILLS` sets how often; 10 without it.
#[test]
fn a_run_killed_at_any_moment_leaves_nothing_that_looks_finished() {
    let kills: u64 = std::env::var("VARDA_KILLS").ok().and_then(|k| k.parse().ok()).unwrap_or(10);
    let folder = Folder::new("kill");
    let run = || folder.command("lorenz63", &[]);
    let begun = Instant::now();
    assert!(run().status().unwrap().success());
    let takes = begun.elapsed();
    let mut killed = 0;
    for k in 0..kills {
        let _ = std::fs::remove_dir_all(folder.0.join("r"));
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
}

/// A limit on the size of a file stands for a full disk: a write in the middle of a file fails.
#[test]
fn a_disk_without_room_is_an_error_that_names_the_file() {
    let folder = Folder::new("full");
    let program = env!("CARGO_BIN_EXE_varda");
    let script = format!("trap '' XFSZ; ulimit -f 1; exec '{program}' run lorenz63 --quiet --out r");
    let output = Command::new("sh").args(["-c", &script]).current_dir(&folder.0).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("cannot write r/"), "{message}");
    assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 0, "nothing is left");
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
