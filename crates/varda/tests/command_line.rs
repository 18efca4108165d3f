//! What the command line offers beside its runs: JSON of every command, help, completions, manual pages,
//! colours, the line at fault, and how far a forward run is from a recording.

use std::process::{Command, Stdio};

#[path = "support/program.rs"]
mod program;

use program::{Folder, text};
use serde_json::Value;

fn json(folder: &Folder, arguments: &[&str]) -> Value {
    let output = folder.varda(arguments);
    let text = String::from_utf8(output.stdout).unwrap();
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{arguments:?}: {e}: {text}"))
}

#[test]
fn json_on_stdout_is_the_summary_of_the_folder() {
    let folder = Folder::new("json");
    let short = ["--set", "time.window=20"];
    for (command, scene) in [("simulate", "hanging-rod"), ("compare", "lorenz63"), ("modes", "hanging-rod")] {
        let sets = if command == "simulate" { &short[..] } else { &[] };
        let printed = json(&folder, &[&[command, scene, "--json", "--out", command], sets].concat());
        assert_eq!(printed["method"], command);
        assert_eq!(printed, folder.summary(command), "{command}");
    }
}

#[test]
fn check_tells_findings_and_errors_as_json() {
    let folder = Folder::new("json-check");
    let found = json(&folder, &["check", "lorenz96", "--json", "--set", "observations.sigma=100.0"]);
    assert_eq!(found["findings"][0]["place"], "observations.sigma");
    assert_eq!(found["scenes"][0]["plan"]["n_state"], 40);
    let output = folder.varda(&["check", "lorenz63", "--json", "--set", "time.step=-1.0"]);
    assert_eq!(output.status.code(), Some(1));
    let found: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&found["scene"], &found["findings"][0]["severity"]), (&Value::Null, &"error".into()));
    let text = found["findings"][0]["text"].as_str().unwrap();
    assert!(text.contains("time.step") && output.stderr.is_empty(), "{text}");
    let both = json(&folder, &["check", "wires", "--json"]);
    assert_eq!(both["scenes"].as_array().map(Vec::len), Some(2));
}

#[test]
fn every_command_has_examples_and_every_run_its_exit_codes() {
    let folder = Folder::new("help");
    let whole = text(&folder.varda(&["--help"]));
    let names = whole.split("Commands:").nth(1).unwrap().split("Options:").next().unwrap();
    let names: Vec<&str> = names.lines().filter_map(|l| l.strip_prefix("  ")?.split(' ').next()).collect();
    let names: Vec<&str> = names.into_iter().filter(|n| !n.is_empty() && *n != "help").collect();
    assert_eq!(names.len(), 14, "{names:?}");
    for name in names {
        let help = text(&folder.varda(&[name, "--help"]));
        assert!(help.contains("Examples:\n  varda "), "{name}: {help}");
        let prints = ["show", "schema", "scenes", "completions", "man"].contains(&name);
        assert!(prints || help.contains("Exit codes: 0 "), "{name}: {help}");
        let page = text(&folder.varda(&["man", name]));
        assert!(page.contains(&format!(".TH varda-{name} 1")), "{page}");
    }
    assert!(text(&folder.varda(&["man"])).contains(".TH varda 1"));
    assert_eq!(folder.varda(&["man", "fly"]).status.code(), Some(2));
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let script = text(&folder.varda(&["completions", shell]));
        assert!(script.contains("simulate") && script.contains("resume"), "{shell}");
    }
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let folder = Folder::new("pipe");
    for arguments in ["schema", "check hanging-rod --json", "completions bash", "run lorenz63 --json"] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_varda"));
        command.args(arguments.split(' ')).current_dir(&folder.0);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.is_empty(), "{arguments}: {said}");
    }
}

#[test]
fn colour_is_for_terminals_and_on_request() {
    let folder = Folder::new("colour");
    let run = |scene: &str, variable: Option<&str>| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_varda"));
        command.args(["run", scene]).current_dir(&folder.0);
        ["NO_COLOR", "CLICOLOR", "CLICOLOR_FORCE"].iter().for_each(|name| {
            command.env_remove(name);
        });
        variable.map(|name| command.env(name, "1"));
        let output = command.output().unwrap();
        [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap())
    };
    for variable in [None, Some("NO_COLOR")] {
        let [table, _] = run("lorenz63", variable);
        assert!(table.starts_with("FITS ") && !table.contains('\u{1b}'), "{table}");
        let [_, error] = run("nothing", variable);
        assert!(error.starts_with("error: no scene") && !error.contains('\u{1b}'), "{error}");
    }
    let [table, _] = run("lorenz63", Some("CLICOLOR_FORCE"));
    assert!(table.starts_with("\u{1b}[") && table.contains("FITS\u{1b}[0m "), "{table:?}");
    let [_, error] = run("nothing", Some("CLICOLOR_FORCE"));
    assert!(error.starts_with("\u{1b}[") && error.contains("error:\u{1b}[0m no scene"), "{error:?}");
}

#[test]
fn an_error_shows_the_line_and_marks_the_key() {
    let folder = Folder::new("excerpt");
    let scene = text(&folder.varda(&["show", "lorenz63"]));
    for (from, to, line) in [
        ("window = ", "windo = ", "windo = "),
        ("kind = \"lorenz63\"", "kind = \"lorenz64\"", "\"lorenz64\""),
        // keys that exclude one another: found when all are read
        ("[time]\n", "[time]\nsteps_per_period = 3\n", "3"),
    ] {
        let changed = scene.replacen(from, to, 1);
        assert_ne!(changed, scene, "{from}");
        std::fs::write(folder.0.join("odd.toml"), changed).unwrap();
        let message = folder.refusal(&["check", "odd.toml"]);
        let lines: Vec<&str> = message.lines().collect();
        let column = lines[2].find('^').unwrap_or_else(|| panic!("{message}"));
        assert!(lines[1][column..].starts_with(line), "{message}");
        let place = lines[1].split(" | ").next().unwrap().trim();
        assert!(lines[0].starts_with(&format!("error: odd.toml:{place}:")), "{message}");
    }
    // an override has no line
    assert_eq!(folder.refusal(&["check", "lorenz63", "--set", "time.step=-1.0"]).lines().count(), 1);
}

#[test]
fn a_simulation_tells_how_far_it_is_from_the_recording() {
    let folder = Folder::new("distance");
    let simulated = json(&folder, &["simulate", "hanging-rod-csv", "--json", "--out", "s"]);
    let run = json(&folder, &["run", "hanging-rod-csv", "--json", "--out", "r"]);
    let (distances, fits) =
        (simulated["distances"].as_array().unwrap(), run["innovations"].as_array().unwrap());
    assert!(distances.len() == fits.len() && !fits.is_empty(), "{distances:?}");
    let (mut squares, mut count) = (0.0, 0.0);
    for (distance, fit) in distances.iter().zip(fits) {
        assert_eq!(distance["label"], fit["label"]);
        let [rms, seen] = ["rms", "count"].map(|key| distance[key].as_f64().unwrap());
        // the run's departures at the same background are those of single coordinates
        let [of_values, values] = ["rms_background", "count"].map(|key| fit[key].as_f64().unwrap());
        assert_eq!(3.0 * seen, values);
        assert!((rms - 3.0_f64.sqrt() * of_values).abs() <= 1e-12 * rms, "{distance} {fit}");
        (squares, count) = (squares + seen * rms * rms, count + seen);
    }
    let all = simulated["rms_distance"].as_f64().unwrap();
    assert!((all - (squares / count).sqrt()).abs() <= 1e-12 * all);
    let table = text(&folder.varda(&["simulate", "hanging-rod-csv", "--out", "t"]));
    assert!(
        table.contains(&format!("off recording  {:.2} mm rms over {count} sightings", 1e3 * all)),
        "{table}"
    );
    // a twin has no recording
    let twin = json(&folder, &["simulate", "lorenz63", "--json", "--out", "u"]);
    assert_eq!((&twin["rms_distance"], &twin["distances"]), (&Value::Null, &serde_json::json!([])));
}

#[test]
fn a_new_scene_names_the_schema_beside_it() {
    let folder = Folder::new("schema");
    let schema = text(&folder.varda(&["schema"]));
    text(&folder.varda(&["new", "mine"]));
    assert!(folder.read("mine.toml").starts_with("#:schema ./varda-schema.json\n"));
    assert_eq!(folder.read("varda-schema.json").trim_end(), schema.trim_end());
    text(&folder.varda(&["check", "mine.toml"]));
}
