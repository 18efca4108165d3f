//! `varda sweep`: which runs a grid has, the same table however the study was run, runs that fail.

use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[path = "support/program.rs"]
mod program;

use program::{Folder, text};
use serde_json::Value;

/// Two values and three seeds.
const SMALL: [&str; 6] = ["sweep", "lorenz63", "--set", "observations.sigma=0.5,2.0", "--seeds", "0..2"];
/// Four combinations and ten seeds: long enough to be ended in the middle.
const LONG: [&str; 8] = [
    "sweep",
    "lorenz63",
    "--set",
    "observations.sigma=0.5,2.0",
    "--set",
    "time.window=25,50",
    "--seeds",
    "0..9",
];

fn sweep(folder: &Folder, arguments: &[&str], more: &[&str]) {
    text(&folder.varda(&[arguments, &["--quiet"], more].concat()));
}

/// The rows of sweep.csv, or of the means, without their last column, which is seconds.
fn rows(folder: &Folder, file: &str) -> Vec<Vec<String>> {
    let text = folder.read(file);
    let mut reader = csv::ReaderBuilder::new().has_headers(false).from_reader(text.as_bytes());
    let cells = |row: csv::StringRecord| row.iter().map(String::from).collect::<Vec<_>>();
    let mut rows: Vec<Vec<String>> = reader.records().map(|row| cells(row.unwrap())).collect();
    assert!(rows[0].last().unwrap().starts_with("seconds"));
    for (i, row) in rows.iter_mut().enumerate() {
        let seconds = row.pop().unwrap();
        // a combination whose runs have all failed has no median
        let is_time = seconds.is_empty() || seconds.parse::<f64>().is_ok_and(|s| s > 0.0);
        assert!(i == 0 || is_time, "{seconds}");
    }
    rows
}

fn column<'a>(rows: &'a [Vec<String>], name: &str) -> Vec<&'a str> {
    let at = rows[0].iter().position(|n| n == name).unwrap_or_else(|| panic!("{name}: {:?}", rows[0]));
    rows[1..].iter().map(|row| row[at].as_str()).collect()
}

#[test]
fn a_sweep_is_the_runs_of_its_grid_in_their_order() {
    let folder = Folder::new("sweep-small");
    sweep(&folder, &SMALL, &["--out", "s"]);
    let table = rows(&folder, "s/sweep.csv");
    assert_eq!(column(&table, "run"), ["0", "1", "2", "3", "4", "5"]);
    assert_eq!(column(&table, "observations.sigma"), ["0.5", "0.5", "0.5", "2.0", "2.0", "2.0"]);
    assert_eq!(column(&table, "seed"), ["0", "1", "2", "0", "1", "2"]);
    let mut errors = Vec::new();
    for (i, (sigma, seed)) in
        [("0.5", 0), ("0.5", 1), ("0.5", 2), ("2.0", 0), ("2.0", 1), ("2.0", 2)].into_iter().enumerate()
    {
        let set = format!("observations.sigma={sigma}");
        let out = format!("run{i}");
        let output = folder.varda(&[
            "run",
            "lorenz63",
            "--set",
            &set,
            "--seed",
            &seed.to_string(),
            "--quiet",
            "--out",
            &out,
        ]);
        let summary = folder.summary(&out);
        let number = |name: &str| column(&table, name)[i].parse::<f64>().unwrap();
        assert_eq!(number("chi2"), summary["chi2"].as_f64().unwrap());
        for of in ["state_background", "state_analysis"] {
            assert_eq!(number(&format!("rmse_{of}")), summary["rmse"][of].as_f64().unwrap());
        }
        assert_eq!(column(&table, "verdict")[i], summary["verdict"].as_str().unwrap());
        assert_eq!(column(&table, "status")[i], summary["status"].as_str().unwrap());
        assert_eq!(column(&table, "exit_code")[i], output.status.code().unwrap().to_string());
        // the truth within 1.96 σ of the analysis, counted from the run's own table
        let analysis = folder.read(&format!("{out}/analysis.csv"));
        let mut reader = csv::Reader::from_reader(analysis.as_bytes());
        let header = reader.headers().unwrap().clone();
        let at = |name| header.iter().position(|n| n == name).unwrap();
        let (x, sigma, truth) = (at("x_a"), at("sigma_a"), at("truth"));
        let within = reader.records().filter(|row| {
            let cell = |i: usize| row.as_ref().unwrap()[i].parse::<f64>().unwrap();
            (cell(x) - cell(truth)).abs() <= 1.96 * cell(sigma)
        });
        assert_eq!(column(&table, "state_within")[i], within.count().to_string());
        assert_eq!(column(&table, "state_values")[i], "3");
        errors.push(summary["rmse"]["state_analysis"].as_f64().unwrap());
    }
    // mean and standard error of each combination, over its three seeds
    let means = rows(&folder, "s/sweep-means.csv");
    assert_eq!(column(&means, "runs"), ["3", "3"]);
    for (i, three) in errors.chunks(3).enumerate() {
        let mean = three.iter().sum::<f64>() / 3.0;
        let error = (three.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 6.0).sqrt();
        let close = |name: &str, expected: f64| {
            let found: f64 = column(&means, name)[i].parse().unwrap();
            // the order of summation
            assert!((found - expected).abs() <= 1e-14 * expected, "{name}: {found}, {expected}");
        };
        close("rmse_state_analysis", mean);
        close("rmse_state_analysis_se", error);
    }
    let page = folder.read("s/report.html");
    assert!(page.contains("observations.sigma") && page.contains("chart-1") && !page.contains("Runs that"));
    let summary = folder.summary("s");
    assert_eq!((&summary["runs"], &summary["failures"]), (&6.into(), &0.into()));
}

#[test]
fn a_study_ended_in_the_middle_goes_on_to_the_same_table() {
    let folder = Folder::new("sweep-ended");
    sweep(&folder, &LONG, &["--out", "whole", "--jobs", "2"]);
    let whole = rows(&folder, "whole/sweep.csv");
    assert_eq!(whole.len(), 41);
    sweep(&folder, &LONG, &["--out", "alone", "--jobs", "1"]);
    assert_eq!(rows(&folder, "alone/sweep.csv"), whole, "the bits do not depend on how many run at a time");
    let means = rows(&folder, "whole/sweep-means.csv");
    for name in ["-KILL", "-TERM"] {
        let out = format!("s{name}");
        let mut command = Command::new(env!("CARGO_BIN_EXE_varda"));
        command.args(LONG).args(["--out", &out, "--jobs", "1", "--quiet"]).current_dir(&folder.0);
        let mut child = command.stdout(Stdio::null()).spawn().unwrap();
        let done = || std::fs::read_dir(folder.0.join(&out).join("runs")).map_or(0, |all| all.count());
        let begun = Instant::now();
        while done() < 5 && begun.elapsed() < Duration::from_secs(60) {
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(Command::new("kill").args([name, &child.id().to_string()]).status().unwrap().success());
        let code = child.wait().unwrap().code();
        assert_eq!(code, if name == "-TERM" { Some(130) } else { None });
        assert!((5..40).contains(&done()), "ended after {} of 40 runs", done());
        assert!(!folder.0.join(&out).join("sweep.csv").exists(), "no table of half a study");
        // a file that is not whole is that of a run that has not ended
        std::fs::write(folder.0.join(&out).join("runs/1.json"), "{ \"index\": 1").unwrap();
        let kept = folder.read(&format!("{out}/runs/0.json"));
        sweep(&folder, &LONG, &["--out", &out, "--jobs", "2"]);
        assert_eq!(folder.read(&format!("{out}/runs/0.json")), kept, "what is done is not done again");
        assert_eq!(rows(&folder, &format!("{out}/sweep.csv")), whole);
        assert_eq!(rows(&folder, &format!("{out}/sweep-means.csv")), means);
        assert!(!folder.0.join(&out).join("work").exists(), "nothing of a killed run is left");
    }
}

#[test]
fn parts_merged_are_the_whole() {
    let folder = Folder::new("sweep-parts");
    sweep(&folder, &SMALL, &["--out", "whole"]);
    let whole = rows(&folder, "whole/sweep.csv");
    // into one folder
    for part in ["1/3", "2/3"] {
        sweep(&folder, &SMALL, &["--out", "one", "--part", part]);
    }
    let message = folder.refusal(&["sweep", "--merge", "one"]);
    assert!(message.contains("2 of 6 runs are missing, the first is run 2"), "{message}");
    sweep(&folder, &SMALL, &["--out", "one", "--part", "3/3"]);
    sweep(&folder, &["sweep", "--merge", "one"], &[]);
    assert_eq!(rows(&folder, "one/sweep.csv"), whole);
    // into a folder each
    for (part, out) in [("1/3", "a"), ("2/3", "b"), ("3/3", "c")] {
        sweep(&folder, &SMALL, &["--out", out, "--part", part]);
        assert_eq!(std::fs::read_dir(folder.0.join(out).join("runs")).unwrap().count(), 2);
    }
    sweep(&folder, &["sweep", "--merge", "a", "b", "c"], &["--out", "merged"]);
    assert_eq!(rows(&folder, "merged/sweep.csv"), whole);
    // other studies are no parts
    sweep(&folder, &["sweep", "lorenz63", "--seeds", "0..1"], &["--out", "other"]);
    let message = folder.refusal(&["sweep", "--merge", "a", "other"]);
    assert!(message.contains("no part of the sweep in a"), "{message}");
    for part in ["0/3", "4/3", "x"] {
        assert!(folder.refusal(&["sweep", "lorenz63", "--part", part]).contains("--part"));
    }
}

#[test]
fn a_run_that_fails_is_a_row_with_its_error() {
    let folder = Folder::new("sweep-fails");
    let arguments = ["sweep", "lorenz63", "--set", "model.sigma=10.0,1e9", "--seeds", "0,1"];
    let printed = text(&folder.varda(&[&arguments[..], &["--out", "s"]].concat()));
    assert!(printed.contains("2 failed, the first is run 2: model: step"), "{printed}");
    let table = rows(&folder, "s/sweep.csv");
    assert_eq!(column(&table, "exit_code"), ["0", "0", "1", "1"]);
    let errors = column(&table, "error");
    assert_eq!(errors[0], "");
    assert!(errors[2].starts_with("model: step") && errors[2].contains("not finite"), "{}", errors[2]);
    let means = rows(&folder, "s/sweep-means.csv");
    assert_eq!(column(&means, "failures"), ["0", "2"]);
    assert_eq!(column(&means, "chi2")[1], "");
    assert!(folder.read("s/report.html").contains("Runs that failed"));
    assert_eq!(folder.summary("s")["failures"], 2);
}

#[test]
fn constants_come_with_sigma_truth_and_coverage() {
    let folder = Folder::new("sweep-constants");
    let scene = text(&folder.varda(&["show", "lorenz63"]));
    std::fs::write(folder.0.join("mine.toml"), format!("{scene}\n[estimate]\nrho = {{ sigma = 1.0 }}\n"))
        .unwrap();
    let arguments = ["sweep", "mine.toml", "--seeds", "0..4"];
    sweep(&folder, &arguments, &["--out", "s"]);
    let table = rows(&folder, "s/sweep.csv");
    let numbers =
        |name: &str| -> Vec<f64> { column(&table, name).iter().map(|cell| cell.parse().unwrap()).collect() };
    let (rho, sigma, truth, within) =
        (numbers("rho"), numbers("rho_sigma"), numbers("rho_truth"), numbers("rho_within"));
    for i in 0..5 {
        // Where an end of the interval is nearer than its quantile has digits both answers are right.
        let distance = ((rho[i] - truth[i]) / sigma[i]).abs();
        assert!((distance - 1.96).abs() > 1e-3 && (distance < 1.96) == (within[i] == 1.0), "{distance}");
    }
    // the constant is not counted as a part of the state
    assert_eq!(column(&table, "state_values"), ["3"; 5]);
    let means = rows(&folder, "s/sweep-means.csv");
    let coverage: f64 = column(&means, "rho_coverage")[0].parse().unwrap();
    assert!((coverage - within.iter().sum::<f64>() / 5.0).abs() <= 1e-15, "{coverage}");
    // a scene that has changed is another study
    std::fs::write(folder.0.join("mine.toml"), format!("{scene}\n[estimate]\nrho = {{ sigma = 2.0 }}\n"))
        .unwrap();
    let again = [&arguments[..], &["--out", "s"]].concat();
    let message = folder.refusal(&again);
    assert!(
        message.contains("the text of the scene has changed") && message.contains("--fresh"),
        "{message}"
    );
    sweep(&folder, &again, &["--fresh"]);
    assert_ne!(rows(&folder, "s/sweep.csv"), table);
}

#[test]
fn a_study_that_cannot_be_is_refused_before_any_run() {
    let folder = Folder::new("sweep-refused");
    for (arguments, said) in [
        (&["--set", "observations.sgma=1,2"][..], "did you mean `sigma`"),
        (&["--set", "observations.sigma=1,-2"], "--set observations.sigma=-2"),
        (&["--set", "observations.sigma=1,,2"], "empty"),
        (&["--set", "observations.sigma=1,1"], "twice"),
        (&["--set", "observations.components=[0,1"], "not closed"),
        (&["--set", "observations.sigma"], "expected key=a,b,c"),
        (&["--set", "seed=1,2"], "--seeds"),
        (&["--set", "observations.sigma=1", "--set", "observations.sigma=2"], "twice"),
        (&["--seeds", "3..1"], "before its start"),
        (&["--seeds", "a..3"], "is no seed"),
        (&["--seeds", "0..3,2"], "twice"),
        (&["--seeds", "0..2000000"], "at most"),
    ] {
        let message = folder.refusal(&[&["sweep", "lorenz63"], arguments].concat());
        assert!(message.contains(said), "{arguments:?}: {message}");
    }
    assert!(!folder.0.join("out").exists());
    // a folder of something else is left alone
    std::fs::create_dir(folder.0.join("thesis")).unwrap();
    std::fs::write(folder.0.join("thesis/chapter1.tex"), "years of work").unwrap();
    for fresh in [&[][..], &["--fresh"]] {
        let message = folder.refusal(&[&["sweep", "lorenz63", "--out", "thesis"], fresh].concat());
        assert!(message.contains("no sweep.json"), "{message}");
    }
}

#[test]
fn lists_within_brackets_are_one_value_and_json_is_the_summary() {
    let folder = Folder::new("sweep-lists");
    let lists = "truth.state=[1.0, -1.0, 25.0],[2.0, -2.0, 24.0]";
    let output = folder.varda(&["sweep", "lorenz63", "--set", lists, "--json", "--out", "s"]);
    let printed: Value = serde_json::from_str(&text(&output)).unwrap();
    assert_eq!(printed, folder.summary("s"));
    let table = rows(&folder, "s/sweep.csv");
    assert_eq!(column(&table, "truth.state"), ["[1.0, -1.0, 25.0]", "[2.0, -2.0, 24.0]"]);
    assert_eq!(column(&table, "verdict"), ["fits", "fits"]);
}
