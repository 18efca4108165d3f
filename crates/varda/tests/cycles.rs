//! Scenes with `[algorithm.cycles]`: what they write, what they refuse, and that a run can be ended and taken
//! up again.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use varda::run::cycles::Sequence;
use varda::scene::SceneFile;

/// A folder of its own for every test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("varda-cycles-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }

    fn command(&self, scene: &str, sets: &[&str], more: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_varda"));
        command.args(["run", scene]).current_dir(&self.0);
        for set in sets {
            command.args(["--set", set]);
        }
        command.args(more);
        command
    }

    fn run(&self, scene: &str, sets: &[&str], more: &[&str]) -> Output {
        self.command(scene, sets, more).output().unwrap()
    }

    fn read(&self, file: &str) -> String {
        std::fs::read_to_string(self.0.join(file)).unwrap_or_else(|e| panic!("{file}: {e}"))
    }

    fn summary(&self, folder: &str) -> serde_json::Value {
        serde_json::from_str(&self.read(&format!("{folder}/summary.json"))).unwrap()
    }

    /// cycles.csv without its seconds, the last column.
    fn cycles(&self, folder: &str) -> Vec<String> {
        let text = self.read(&format!("{folder}/cycles.csv"));
        text.lines().map(|l| l.rsplit_once(',').unwrap().0.to_string()).collect()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn ok(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Few enough for an unoptimized build.
const SHORT: &str = "background.covariance.steps=3000";

#[test]
fn a_sequence_writes_what_it_promises() {
    let folder = Folder::new("writes");
    let sets = [SHORT, "algorithm.cycles.count=12", "algorithm.cycles.spin_up=4"];
    let output = folder.run("lorenz96-cycling-4denvar", &sets, &["--out", "r"]);
    ok(&output);
    let table = String::from_utf8_lossy(&output.stdout).to_string();
    assert!(table.contains("12 windows of 4 steps, 4 apart, B ensemble; 8 in the means"), "{table}");
    let summary = folder.summary("r");
    let cycles = &summary["cycles"];
    assert_eq!((&cycles["count"], &cycles["counted"], &cycles["shift"]), (&12.into(), &8.into(), &4.into()));
    assert_eq!(summary["n_obs"], 12 * 4 * 40);
    assert_eq!(
        (&summary["counts"]["tangent_steps"], &summary["counts"]["adjoint_steps"]),
        (&0.into(), &0.into())
    );
    let mean = |key: &str| cycles[key].as_f64().unwrap();
    // What every component observed with σ = 1 must beat, and what the spread must tell.
    assert!(mean("rmse_end") < 0.4 && mean("rmse_start") < mean("rmse_background"), "{cycles}");
    assert!((0.5..2.0).contains(&(mean("spread") / mean("rmse_end"))), "{cycles}");
    // 160 values a window, 8 windows: 2J/m is 1 ± 0.04 where all is right; a young ensemble is not quite.
    assert!((0.8..1.2).contains(&mean("chi2")), "{cycles}");

    // The means are those of the rows.
    let rows: Vec<Vec<String>> =
        folder.read("r/cycles.csv").lines().map(|l| l.split(',').map(String::from).collect()).collect();
    let column = rows[0].iter().position(|c| c == "rmse_end").unwrap();
    let ends: Vec<f64> = rows[5..].iter().map(|r| r[column].parse().unwrap()).collect();
    assert_eq!((rows.len(), ends.len()), (13, 8));
    assert!((ends.iter().sum::<f64>() / 8.0 - mean("rmse_end")).abs() < 1e-12);

    assert_eq!(folder.read("r/trajectory.csv").lines().count(), 1 + (12 * 4 + 1) * 40);
    let analysis = folder.read("r/analysis.csv");
    assert!(analysis.starts_with("index,name,unit,x_b,x_a,truth\n") && analysis.lines().count() == 41);
    let page = folder.read("r/report.html");
    // errors, 2J/m, consistency, the field and components of it, and one of the observed components
    assert_eq!(page.matches("<figure").count(), 6);
    assert_eq!(folder.read("r/observations.csv").lines().count(), 1 + 12 * 4 * 40);
    assert!(folder.read("r/trajectory.csv").starts_with("step,time_s,component,x_a,truth,sigma_a\n"));
    assert!(!page.contains(" src="));
    assert!(!folder.0.join("r.partial").exists(), "a finished run leaves nothing beside its result");
}

#[test]
fn the_same_seed_gives_the_same_bits_whatever_the_threads_and_more_cycles_do_not_change_the_first() {
    let folder = Folder::new("bits");
    for update in ["square-root", "perturbed-observations"] {
        let update = format!("algorithm.cycles.update={update}");
        for (out, threads, count) in [("one", "1", 6), ("three", "3", 6), ("longer", "2", 9)] {
            let count = format!("algorithm.cycles.count={count}");
            let sets = [SHORT, "algorithm.cycles.spin_up=0", &update, &count];
            let mut command =
                folder.command("lorenz96-cycling-4denvar", &sets, &["--quiet", "--seed", "3", "--out", out]);
            ok(&command.env("RAYON_NUM_THREADS", threads).output().unwrap());
        }
        assert_eq!(folder.cycles("one"), folder.cycles("three"));
        assert_eq!(folder.read("one/analysis.csv"), folder.read("three/analysis.csv"));
        assert_eq!(folder.cycles("one")[..], folder.cycles("longer")[..7]);
    }
}

#[test]
fn a_run_killed_at_any_moment_goes_on_with_the_same_bits() {
    let folder = Folder::new("resume");
    for (scene, count, more) in [
        ("lorenz96-cycling-4dvar", 14, "algorithm.cycles.covariance=propagated"),
        ("lorenz96-cycling-4denvar", 20, "algorithm.cycles.update=perturbed-observations"),
    ] {
        let count_set = format!("algorithm.cycles.count={count}");
        let sets = [SHORT, "algorithm.cycles.spin_up=0", &count_set, more];
        ok(&folder.run(scene, &sets, &["--quiet", "--out", "whole"]));
        let rows = folder.0.join("r.partial/cycles.jsonl");
        let done = || std::fs::read_to_string(&rows).map_or(0, |text| text.lines().count());
        for stop in [1, count / 2] {
            let mut child = folder
                .command(scene, &sets, &["--quiet", "--out", "r"])
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            while done() < stop && child.try_wait().unwrap().is_none() {
                std::thread::sleep(std::time::Duration::from_micros(300));
            }
            child.kill().unwrap();
            child.wait().unwrap();
            assert!(!folder.0.join("r").exists(), "killed before it was finished: no result");
            assert!((stop..count).contains(&done()), "killed after {} of {count} cycles", done());
            // A new run does not throw the unfinished one away, and another scene cannot go on with it.
            let again = folder.run(scene, &sets, &["--out", "r"]);
            assert!(String::from_utf8_lossy(&again.stderr).contains("--resume"), "{again:?}");
            let other = folder.run(scene, &sets, &["--out", "r", "--seed", "9", "--resume"]);
            assert!(String::from_utf8_lossy(&other.stderr).contains("seed was 0 and is 9 now"), "{other:?}");

            ok(&folder.run(scene, &sets, &["--quiet", "--out", "r", "--resume"]));
            assert_eq!(folder.cycles("r"), folder.cycles("whole"), "{scene}");
            for file in ["analysis.csv", "trajectory.csv"] {
                assert!(folder.read(&format!("r/{file}")) == folder.read(&format!("whole/{file}")), "{file}");
            }
            std::fs::remove_dir_all(folder.0.join("r")).unwrap();
        }
    }
    let nothing = folder.run("lorenz96-cycling-4dvar", &[], &["--out", "r", "--resume"]);
    assert!(String::from_utf8_lossy(&nothing.stderr).contains("there is no unfinished run"), "{nothing:?}");
}

#[test]
fn a_sequence_that_cannot_begin_leaves_nothing() {
    let folder = Folder::new("begins");
    // A background thousands of units off the attractor: the explicit step overflows.
    let sets = [SHORT, "background.covariance.scale=1e8"];
    let output = folder.run("lorenz96-cycling-4dvar", &sets, &["--out", "r"]);
    assert!(!output.status.success() && output.stdout.is_empty(), "{output:?}");
    assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 0);
}

#[test]
fn a_window_that_fails_leaves_those_before_it() {
    let folder = Folder::new("fails");
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let scene = std::fs::read_to_string(scenes.join("hanging-rod-csv.toml")).unwrap();
    let drive = scene.lines().find(|l| l.starts_with("motion = ")).unwrap();
    let scene = scene
        .replace(drive, "motion = { kind = \"table\", file = \"drive.csv\" }")
        .replace("steps_per_period = 50", "step = 0.0104719755")
        .replace("\"data/", &format!("\"{}/data/", scenes.display()));
    std::fs::write(folder.0.join("jump.toml"), scene).unwrap();
    // Windows of 20 steps begin at 1.571, 1.780 and 1.990 s; in the third the clamp leaves the world.
    let drive = "time_s,x_m,y_m,z_m\n0,0,0,0\n2.05,0,0,0\n2.06,1e45,0,0\n3,1e45,0,0\n";
    std::fs::write(folder.0.join("drive.csv"), drive).unwrap();
    let sets = [
        "time.window=20",
        "algorithm.cycles.count=5",
        "algorithm.minimizer=trust-region",
        "observations.unreachable=skip",
    ];
    let output = folder.run("jump.toml", &sets, &["--out", "r"]);
    let message = String::from_utf8_lossy(&output.stderr).to_string();
    assert!(!output.status.success() && message.contains("cycle 2 could not be done"), "{message}");
    let summary = folder.summary("r");
    assert_eq!((&summary["status"], &summary["cycles"]["count"]), (&"failed".into(), &2.into()));
    assert_eq!(folder.cycles("r").len(), 3);
    assert!(folder.0.join("r/report.html").is_file());
}

/// A rod's sequence over its CSV file: rows fall into windows by time, and the model's clock goes on.
#[test]
fn a_recording_is_cut_into_windows() {
    let folder = Folder::new("recording");
    let sets = ["time.window=20", "algorithm.cycles.count=5", "algorithm.minimizer=trust-region"];
    ok(&folder.run("hanging-rod-csv", &sets, &["--quiet", "--out", "r"]));
    let (rows, summary) = (folder.cycles("r"), folder.summary("r"));
    assert_eq!(summary["n_obs"], 120, "all of the file: {summary}");
    assert_eq!(rows.len(), 6);
    assert!(summary["rmse"]["position_end"].is_null(), "no truth is known");
    // Steps go on from window to window: those of the last begin at the file's late times, 2π/(50·12) s
    // apart.
    let last: Vec<&str> = rows[5].split(',').collect();
    assert_eq!(last[1], "80");
    let time: f64 = last[2].parse().unwrap();
    assert!((time - 230.0 * std::f64::consts::TAU / 600.0).abs() < 1e-9, "{time}");
    assert_eq!(folder.read("r/trajectory.csv").lines().count(), 1 + 101 * 26);

    // One window that is the whole recording is the scene without cycles.
    ok(&folder.run("hanging-rod-csv", &["algorithm.cycles.count=1"], &["--quiet", "--out", "one"]));
    ok(&folder.run("hanging-rod-csv", &[], &["--quiet", "--out", "plain"]));
    let j: f64 = folder.cycles("one")[1].split(',').nth(3).unwrap().parse().unwrap();
    let plain = folder.summary("plain")["j_analysis"].as_f64().unwrap();
    // The same operations in the same order.
    assert_eq!(j, plain);
}

/// The rod's own ways to carry B: static, propagated, by an ensemble.
#[test]
fn a_rod_is_cycled_with_every_covariance() {
    let folder = Folder::new("rod");
    let few = ["algorithm.cycles.count=3", "algorithm.cycles.spin_up=0", "model.segments=8"];
    // The scene without the keys that belong to one of the ways only.
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/hanging-rod-cycling.toml");
    let own =
        ["covariance = \"propagated\"", "inflation", "static_weight", "minimizer", "gradient_tolerance"];
    let scene = std::fs::read_to_string(path).unwrap();
    let lines = scene.lines().filter(|l| !own.iter().any(|key| l.starts_with(key)));
    std::fs::write(folder.0.join("rod.toml"), lines.map(|l| format!("{l}\n")).collect::<String>()).unwrap();
    let by = |more: &[&str]| -> serde_json::Value {
        ok(&folder.run("rod.toml", &[&few[..], more].concat(), &["--quiet", "--out", "r"]));
        folder.summary("r")
    };
    let mut of_static = [f64::NAN; 2];
    for (name, more) in [
        ("static", &["algorithm.cycles.covariance=static"][..]),
        ("propagated", &["algorithm.cycles.covariance=propagated", "algorithm.cycles.static_weight=0.1"]),
        ("ensemble", &["algorithm.method=hybrid-4denvar", "algorithm.ensemble.members=20"]),
    ] {
        let summary = by(more);
        assert_eq!(summary["cycles"]["covariance"], name);
        let rmse = |key: &str| summary["rmse"][key].as_f64().unwrap();
        // Far below the distance √3 · 0.1 m by which an observed place is off.
        let [position, velocity] = [rmse("position_end"), rmse("velocity_end")];
        assert!(position < 0.09, "{name}: {position} m");
        match name {
            "static" => of_static = [position, velocity],
            // The posterior of the windows before knows more than the same B again.
            "propagated" => {
                assert!(
                    position < of_static[0] && velocity < of_static[1],
                    "{position} {velocity} {of_static:?}"
                )
            }
            _ => {}
        }
        assert_eq!(summary["rmse"]["position_spread"].is_null(), name == "static");
    }
}

/// Every observed value belongs to one window, whatever their overlap; those between tiled windows are
/// counted as left out.
#[test]
fn every_value_is_used_once() {
    for (window, shift, used, unused) in [(8, 8, 24, 0), (8, 3, 24, 0), (4, 5, 24, 0), (8, 9, 24, 0)] {
        let steps = 24;
        let count = (steps - window) / shift + 1;
        let sets: Vec<String> = vec![
            SHORT.into(),
            format!("time.window={window}"),
            format!("algorithm.cycles.count={count}"),
            format!("algorithm.cycles.shift={shift}"),
            "algorithm.cycles.spin_up=0".into(),
        ];
        let file = SceneFile::open("lorenz96-cycling-4dvar", &sets).unwrap();
        let sequence = Sequence::from_scene(&file).unwrap().unwrap();
        let reached = (count - 1) * shift + window;
        let [inside, between] = sequence.values();
        assert_eq!(
            (inside, between),
            (40 * used.min(reached), 40 * unused),
            "window {window}, shift {shift}"
        );
    }
}

#[test]
fn what_makes_no_sequence_is_refused_with_its_place() {
    let cases: &[(&str, &[&str], &str)] = &[
        (
            "lorenz96-cycling-4dvar",
            &["algorithm.cycles.shift=10"],
            "--set algorithm.cycles.shift=10: windows of 8 steps",
        ),
        ("lorenz96-cycling-4dvar", &["algorithm.cycles.covariance=ensemble"], "an ensemble is carried by"),
        (
            "lorenz96-cycling-4dvar",
            &["algorithm.cycles.inflation=1.1"],
            "belongs to covariance = \"propagated\"",
        ),
        (
            "lorenz96-cycling-4dvar",
            &["algorithm.cycles.update=square-root"],
            "belongs to covariance = \"ensemble\"",
        ),
        ("lorenz96-cycling-4dvar", &["algorithm.robust=1.5"], "--set algorithm.robust=1.5: does not go with"),
        ("lorenz96-cycling-4dvar", &["algorithm.cycles.count=0"], "at least 1"),
        ("lorenz96-cycling-4dvar", &["algorithm.cycles.spin_up=75"], "all 75 cycles"),
        ("lorenz96-cycling-4dvar", &["algorithm.cycles.cuont=3"], "did you mean `count`"),
        ("lorenz96-cycling-4denvar", &["algorithm.cycles.inflation=1.1"], "algorithm.ensemble.inflation"),
        (
            "lorenz96-cycling-4denvar",
            &["algorithm.cycles.covariance=static"],
            "does not go with covariance \"static\"",
        ),
        ("lorenz96-cycling-3dvar", &["time.window=4"], "analyses one step"),
        ("lorenz96", &["algorithm.cycles.count=2", "algorithm.method=blue"], "is not cycled"),
    ];
    for (scene, sets, expected) in cases {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        let error = SceneFile::open(scene, &sets).unwrap_err().to_string();
        assert!(error.contains(expected), "{scene} {sets:?}: {error}");
    }
    // In a file, by line and column.
    let text = varda::scene::SHIPPED.iter().find(|s| s.name == "lorenz96-cycling-4dvar").unwrap().text;
    let text = text.replace("spin_up = 25", "spin_up = 75");
    let line = text.lines().position(|l| l.starts_with("spin_up = 75")).unwrap() + 1;
    let error = SceneFile::parse("s", "s.toml", &text, None, &[]).unwrap_err().to_string();
    assert!(error.starts_with(&format!("s.toml:{line}:")), "{error}");
}

#[test]
fn check_tells_the_size_of_a_sequence() {
    let output =
        Command::new(env!("CARGO_BIN_EXE_varda")).args(["check", "lorenz96-cycling-4dvar"]).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).to_string();
    assert!(text.contains("75 windows, 8 steps apart: 600 steps"), "{text}");
    assert!(text.contains("24000 values at 600 times"), "{text}");
}

/// An ensemble that inflates itself and is turned between windows stays on the truth and says that its errors
/// are as assumed; one of ten members left alone loses it, and says so with what to do.
#[test]
fn a_sequence_says_whether_its_errors_are_as_assumed() {
    let folder = Folder::new("checks");
    let run = |sets: &[&str], code: i32| -> serde_json::Value {
        let few = ["algorithm.cycles.count=80", "algorithm.cycles.spin_up=30"];
        let sets = [&few[..], sets].concat();
        let output = folder.run("lorenz96-cycling-4denvar", &sets, &["--quiet", "--out", "r"]);
        assert_eq!(output.status.code(), Some(code), "{}", folder.summary("r")["verdict_text"]);
        folder.summary("r")
    };
    let adaptive = [
        "algorithm.cycles.inflation=adaptive",
        "algorithm.cycles.rotation=true",
        "algorithm.cycles.spread=1e-3",
        "algorithm.ensemble.inflation=1.0",
    ];
    let good = run(&adaptive, 0);
    let cycles = &good["cycles"];
    assert!(cycles["rmse_end"].as_f64().unwrap() < 0.25, "{cycles}");
    assert!(cycles["inflation"].as_f64().unwrap() > 1.0, "{cycles}");
    for ratio in ["innovation_ratio", "observation_ratio", "chi2_of_all"] {
        // 50 windows of 160 values: √(2/8000) and what is not linear.
        assert!((cycles[ratio].as_f64().unwrap() - 1.0).abs() < 0.15, "{ratio}: {cycles}");
    }
    assert!(!good["warnings"].to_string().contains("is expected"), "{}", good["warnings"]);

    // With localization, ten members hold the truth, which they lose without (below).
    let few = ["algorithm.ensemble.members=10", "algorithm.ensemble.localization_length=20"];
    let local = &run(&[&adaptive[..1], &adaptive[3..], &few[..]].concat(), 0)["cycles"];
    let of = |key: &str| local[key].as_f64().unwrap();
    assert!(of("rmse_end") < 0.25 && (1.0..1.15).contains(&of("inflation")), "{local}");
    assert!((0.8..1.25).contains(&(of("rmse_end") / of("spread"))), "{local}");

    let lost = run(&["algorithm.ensemble.members=10", "algorithm.ensemble.inflation=1.0"], 3);
    let warnings = lost["warnings"].to_string();
    assert!(lost["cycles"]["rmse_end"].as_f64().unwrap() > 1.0, "{}", lost["cycles"]);
    for part in ["2J/m over all windows", "B is too small", "inflation of", "the spread has collapsed"] {
        assert!(warnings.contains(part), "{part}: {warnings}");
    }
    let header = folder.cycles("r")[0].clone();
    assert!(header.contains("innovation_ratio,observation_ratio,background_ratio,inflation,drawn_again"));

    for (sets, part) in [
        (&["algorithm.cycles.spread=2.0"][..], "spread"),
        (&["algorithm.cycles.inflation=adaptive"], "ensemble's own inflation"),
        (&["algorithm.cycles.inflation=adaptively"], "inflation"),
    ] {
        let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
        let error = SceneFile::open("lorenz96-cycling-4denvar", &sets).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
}
