//! The built binary: its files, its exit codes, its one message on error.

use std::path::Path;

use varda::scene::SHIPPED;

#[path = "support/program.rs"]
mod program;

use program::{Folder, text};

const KEYS: &[&str] = &[
    "verdict",
    "verdict_text",
    "scene",
    "seed",
    "version",
    "method",
    "minimizer",
    "status",
    "n_state",
    "n_control",
    "n_obs",
    "j_background",
    "j_analysis",
    "j_terms",
    "gradient_norm_first",
    "gradient_norm_last",
    "amplification",
    "outer_iterations",
    "inner_iterations",
    "counts",
    "rejected",
    "chi2",
    "rmse",
    "seconds",
    "peak_bytes",
    "left_out",
    "warnings",
];

#[test]
fn the_flagship_writes_everything_it_promises() {
    let folder = Folder::new("flagship");
    let table = text(&folder.varda(&["run", "hanging-rod"]));
    assert!(table.contains("converged") && table.contains("report.html"), "{table}");
    let here = "out/hanging-rod-case1";
    let summary = folder.summary(here);
    for key in KEYS {
        assert!(summary.get(key).is_some(), "summary.json has no {key}");
    }
    for (parent, keys) in [
        ("j_terms", &["background", "observation", "model_error"][..]),
        ("counts", &["model_steps", "tangent_steps", "adjoint_steps", "factorizations", "newton_iterations"]),
        ("rmse", &["position_background", "position_analysis", "velocity_background", "velocity_analysis"]),
        ("seconds", &["total", "forward", "adjoint", "minimizer"]),
    ] {
        for key in keys {
            assert!(summary[parent][key].is_number(), "{parent}.{key}");
        }
    }
    assert_eq!(
        (&summary["status"], &summary["n_control"], &summary["n_obs"]),
        (&"converged".into(), &144.into(), &120.into())
    );
    assert!(summary["rmse"]["position_analysis"].as_f64() < summary["rmse"]["position_background"].as_f64());
    // 2J is about χ² with 120 degrees of freedom: 60 ± 5 √60 covers all but one run in a million.
    let j = summary["j_analysis"].as_f64().unwrap();
    assert!((j - 60.0).abs() < 39.0, "J = {j}");
    assert!(summary["peak_bytes"].is_null() || summary["peak_bytes"].as_u64().unwrap() < 100_000_000);

    let lines = |file: &str| folder.read(&format!("{here}/{file}")).lines().count();
    assert_eq!(lines("analysis.csv"), 145);
    assert_eq!(lines("trajectory.csv"), 1 + 101 * 26);
    assert_eq!(lines("forces.csv"), 1 + 100 * 25);
    let columns = "step,time_s,edge,s_m,tension_n,shear_1_n,shear_2_n,sigma_tension_n,sigma_shear_1_n";
    assert!(folder.read(&format!("{here}/forces.csv")).starts_with(columns));
    assert_eq!(lines("moments.csv"), 1 + 100 * 24);
    assert_eq!(lines("reactions.csv"), 1 + 100);
    assert_eq!(lines("convergence.csv"), 2 + summary["outer_iterations"].as_u64().unwrap() as usize);
    assert!(
        folder
            .read(&format!("{here}/analysis.csv"))
            .starts_with("index,name,unit,x_b,x_a,sigma_b,sigma_a,truth\n")
    );

    // All but the libraries within it, which name their homes: nothing is loaded from anywhere.
    let page = folder.read(&format!("{here}/report.html"));
    let policy =
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:";
    assert!(page.contains(policy));
    for outside in [" src=", "<link rel=\"stylesheet", "@import", "<iframe", "<form"] {
        assert!(!page.contains(outside), "the report reaches outside itself: {outside}");
    }
    assert_eq!(page.matches("<figure").count(), 8);
    for figure in [
        "convergence",
        "covariance-position",
        "covariance-velocity",
        "departures",
        "information",
        "next-marker",
        "snapshots",
        "spread",
        "tracks",
    ] {
        assert!(folder.read(&format!("{here}/figures/{figure}.svg")).starts_with("<svg"));
    }
}

#[test]
fn captions_name_the_runs_that_are_drawn() {
    let folder = Folder::new("captions");
    for (scene, caption) in [
        ("hanging-rod-case2", "plane: truth, background, analysis and observations"),
        ("hanging-rod-csv", "plane: background, analysis and observations"),
    ] {
        text(&folder.varda(&["run", scene, "--out", scene, "--quiet"]));
        assert!(folder.read(&format!("{scene}/report.html")).contains(caption), "{scene}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_one_others() {
    let folder = Folder::new("bits");
    for (out, seed) in [("a", "3"), ("b", "3"), ("c", "4")] {
        text(&folder.varda(&["run", "hanging-rod-case2", "--seed", seed, "--out", out, "--quiet"]));
    }
    for file in ["analysis.csv", "trajectory.csv"] {
        assert_eq!(folder.read(&format!("a/{file}")), folder.read(&format!("b/{file}")), "{file}");
        assert_ne!(folder.read(&format!("a/{file}")), folder.read(&format!("c/{file}")), "{file}");
    }
    // Everything in the convergence table but its seconds.
    let table = |out: &str| -> Vec<String> {
        let without_seconds = |l: &str| {
            l.split(',').enumerate().filter(|c| c.0 != 1).map(|c| c.1).collect::<Vec<_>>().join(",")
        };
        folder.read(&format!("{out}/convergence.csv")).lines().map(without_seconds).collect()
    };
    assert_eq!(table("a"), table("b"));
}

#[test]
fn every_minimizer_finds_the_same_minimum_of_case_2() {
    let folder = Folder::new("minimizers");
    let mut minima = Vec::new();
    for minimizer in ["auto", "trust-region", "newton", "gauss-newton-cg", "lbfgs"] {
        let set = format!("algorithm.minimizer={minimizer}");
        text(&folder.varda(&["run", "hanging-rod-case2", "--set", &set, "--quiet", "--out", minimizer]));
        let summary = folder.summary(minimizer);
        assert_eq!(summary["status"], "converged");
        minima.push(summary["j_analysis"].as_f64().unwrap());
    }
    // Each stops at a gradient 1e-8 of the first: J is then its minimum to far better than this.
    assert!(minima.iter().all(|j| (j / minima[0] - 1.0).abs() < 1e-9), "{minima:?}");
}

#[test]
fn a_twin_written_to_files_and_read_back_is_the_same_problem() {
    let folder = Folder::new("files");
    text(&folder.varda(&["simulate", "hanging-rod-case2", "--seed", "5", "--out", "twin"]));
    text(&folder.varda(&["run", "hanging-rod-case2", "--seed", "5", "--out", "direct", "--quiet"]));
    // σ_v as the twin has it, from v̄.
    let text_of = |v: &serde_json::Value| v.as_f64().unwrap();
    let mean_speed = 1.5987392716799629;
    text(&folder.varda(&[
        "run",
        "hanging-rod-csv",
        "--quiet",
        "--out",
        "files",
        "--set",
        "background.file=twin/background.csv",
        "--set",
        "observations.file=twin/observations.csv",
        "--set",
        &format!("background.covariance.sigma_v={}", 0.4 * mean_speed),
    ]));
    let (direct, files) = (folder.summary("direct"), folder.summary("files"));
    // The files hold every bit; σ_v is the product of another order, 1 ulp off at most.
    for key in ["j_background", "j_analysis"] {
        let (a, b) = (text_of(&direct[key]), text_of(&files[key]));
        assert!((a / b - 1.0).abs() < 1e-9, "{key}: {a} {b}");
    }
    assert!(files["rmse"]["position_background"].is_null(), "a scene that reads files knows no truth");
}

#[test]
fn bad_input_is_one_message_and_no_folder() {
    let folder = Folder::new("bad");
    std::fs::write(folder.0.join("nan.csv"), "time_s,s_m,x_m,y_m,z_m\n1.6,0.5,0,0,0\n1.7,0.5,0,nan,0\n")
        .unwrap();
    std::fs::write(folder.0.join("late.csv"), "time_s,s_m,x_m,y_m,z_m\n9.5,0.5,0,0,0\n").unwrap();
    std::fs::write(folder.0.join("off.csv"), "time_s,s_m,x_m,y_m,z_m\n1.6,1.5,0,0,0\n").unwrap();
    std::fs::write(folder.0.join("who.csv"), "time_s,marker,x_m,y_m,z_m\n0.7,9,0,0,0\n").unwrap();
    let file = |name: &str| format!("observations.file={name}");
    let cases: Vec<(Vec<String>, &[&str])> = vec![
        (vec!["missing.toml".into()], &["missing.toml"]),
        (
            vec!["hanging-rod".into(), "--set".into(), "model.lenght=1".into()],
            &["lenght", "did you mean `length`"],
        ),
        (vec!["hanging-rod".into(), "--set".into(), "model.length=-1".into()], &["greater than 0 [m]"]),
        (vec!["hanging-rod".into(), "--set".into(), "observations.places=[1.2]".into()], &["off the rod"]),
        (vec!["hanging-rod".into(), "--set".into(), "observations.steps=[101]".into()], &["not both"]),
        (
            vec!["hanging-rod".into(), "--set".into(), "model.start.motion.radii=[1e40,1e40]".into()],
            &["spin-up of the truth: step 0", "Newton stopped"],
        ),
        (vec!["hanging-rod-csv".into(), "--set".into(), file("nan.csv")], &["nan.csv:3", "`y_m` is NaN"]),
        (
            vec!["hanging-rod-csv".into(), "--set".into(), file("late.csv")],
            &["late.csv:2", "outside the window"],
        ),
        (vec!["hanging-rod-csv".into(), "--set".into(), file("off.csv")], &["off.csv:2", "off the rod"]),
        (vec!["hanging-rod-csv".into(), "--set".into(), file("none.csv")], &["none.csv", "cannot read"]),
        (vec!["unnamed.toml".into()], &["unnamed.toml:", "--set observations.file="]),
        (
            vec!["beam-release".into(), "--set".into(), file("who.csv")],
            &["who.csv:2", "marker \"9\" has no place"],
        ),
        (vec!["hanging-rod".into(), "--out".into(), ".".into()], &["not a result of Varda"]),
    ];
    let scene = SHIPPED.iter().find(|s| s.name == "beam-release").unwrap().text;
    let unnamed = scene.replace("file = \"data/beam-release.csv\"", "");
    std::fs::write(folder.0.join("unnamed.toml"), unnamed).unwrap();
    for (arguments, expected) in cases {
        let mut all = vec!["run"];
        all.extend(arguments.iter().map(String::as_str));
        let message = folder.refusal(&all);
        for piece in expected {
            assert!(message.contains(piece), "{all:?}: {message}");
        }
    }
}

#[test]
fn a_result_is_replaced_and_anything_else_is_not() {
    let folder = Folder::new("replace");
    for seed in ["1", "2"] {
        text(&folder.varda(&["run", "lorenz63", "--out", "result", "--seed", seed, "--quiet"]));
        assert_eq!(folder.summary("result")["seed"].to_string(), seed);
    }
    std::fs::create_dir(folder.0.join("thesis")).unwrap();
    std::fs::write(folder.0.join("thesis/chapter.tex"), "years").unwrap();
    let message = folder.refusal(&["run", "lorenz63", "--out", "thesis"]);
    assert!(message.contains("thesis exists and is not a result of Varda"), "{message}");
}

#[test]
fn a_new_scene_checks_and_runs_and_is_not_overwritten() {
    let folder = Folder::new("new");
    text(&folder.varda(&["new", "mine"]));
    assert!(text(&folder.varda(&["check", "mine.toml"])).contains("nothing wrong"));
    text(&folder.varda(&["run", "mine.toml", "--quiet"]));
    assert_eq!(folder.summary("out/mine")["status"], "converged");
    let message = folder.refusal(&["new", "mine"]);
    assert!(message.contains("mine.toml"), "{message}");
}

#[test]
fn a_recording_is_converted_and_listed_and_nothing_is_overwritten_unasked() {
    let folder = Folder::new("convert");
    let trc = "PathFileType\t4\t(X/Y/Z)\tswing.trc\n\
        DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n50\t50\t3\t1\tcm\n\
        Frame#\tTime\ttip\n\t\tX1\tY1\tZ1\n\n1\t0\t10\t50\t-2\n2\t0.02\t\t\t\n3\t0.04\t12\t52\t-3\n";
    std::fs::write(folder.0.join("swing.trc"), trc).unwrap();
    let told = text(&folder.varda(&["convert", "swing.trc", "--up", "y"]));
    for part in ["TRC: 1 markers", "tip", "1               1", "(x, −z, y)", "wrote swing.csv"] {
        assert!(told.contains(part), "{part:?} is not in {told}");
    }
    assert_eq!(
        folder.read("swing.csv"),
        "time_s,marker,x_m,y_m,z_m\n0,tip,0.1,0.02,0.5\n0.04,tip,0.12,0.03,0.52\n"
    );
    assert!(folder.refusal(&["convert", "swing.trc"]).contains("swing.csv: it is there already"));
    assert!(folder.refusal(&["convert", "swing.trc", "--out", "swing.trc"]).contains("--out"));
    text(&folder.varda(&["convert", "swing.trc", "--out", "swing.csv", "--unit", "mm"]));
    assert!(folder.read("swing.csv").contains("0,tip,0.01,0.05,-0.002"));
    assert!(folder.refusal(&["convert", "swing.csv"]).contains("needs no conversion"));
    assert!(folder.refusal(&["convert", "missing.c3d"]).contains("missing.c3d"));
}

#[test]
fn lists_and_schema_are_printed() {
    let folder = Folder::new("lists");
    let scenes = text(&folder.varda(&["scenes"]));
    for name in [
        "hanging-rod-case1",
        "hanging-rod-case4-plain",
        "hanging-rod-csv",
        "beam-release",
        "lorenz63",
        "lorenz96",
    ] {
        assert!(scenes.contains(name), "{name}");
    }
    let schema: serde_json::Value = serde_json::from_str(&text(&folder.varda(&["schema"]))).unwrap();
    assert!(schema["properties"]["model"].is_object());
    assert!(text(&folder.varda(&["check", "hanging-rod"])).contains("144 numbers"));
}

#[test]
fn quiet_is_quiet() {
    let folder = Folder::new("quiet");
    let output = folder.varda(&["run", "lorenz96", "--quiet"]);
    assert!(output.status.success() && output.stdout.is_empty() && output.stderr.is_empty());
    assert!(Path::new(&folder.0).join("out/lorenz96/report.html").is_file());
}

#[test]
fn compare_runs_every_method_and_minimizer_and_keeps_failures_as_rows() {
    let folder = Folder::new("compare");
    let printed = text(&folder.varda(&["compare", "lorenz63", "--out", "all"]));
    assert!(printed.contains("gap = (J - J*)/(J0 - J*)"), "{printed}");
    let csv = folder.read("all/compare.csv");
    let rows: Vec<Vec<&str>> = csv.lines().skip(1).map(|l| l.split(',').collect()).collect();
    // 4dvar and weak-forcing with every minimizer; incremental, dual, closed form; weak-state and two
    // ensembles.
    assert_eq!(rows.len(), 8 + 3 + 8 + 3, "{csv}");
    let of_another_j = |row: &[&str]| row[0].starts_with("weak") || row[0].ends_with("envar");
    for row in rows.iter().filter(|r| of_another_j(r)) {
        assert!(row[4].is_empty() && !row[5].is_empty(), "no gap, but an RMSE: {row:?}");
    }
    assert!(csv.contains("Q = 0.01 B assumed"), "{csv}");
    for row in rows.iter().filter(|r| r[2] == "converged" && r[1] != "adam" && !of_another_j(r)) {
        // J at a gradient 1e-8 of the first is its minimum to far better than this.
        assert!(row[4].parse::<f64>().unwrap() < 1e-9, "{row:?}");
    }
    assert!(rows.iter().filter(|r| r[2] == "converged").count() >= 6, "{csv}");
    assert!(rows.iter().any(|r| r[4] == "0"), "one row is the lowest: {csv}");
    assert!(folder.read("all/compare.svg").contains("<svg"));
    // A threshold of the Huber norm leaves the methods that take one.
    text(&folder.varda(&["compare", "lorenz63", "--set", "algorithm.robust=1.5", "--out", "all"]));
    assert_eq!(folder.read("all/compare.csv").lines().count(), 1 + 8);
}

#[test]
fn a_method_that_fails_is_a_row_of_the_comparison_with_its_reason() {
    let folder = Folder::new("compare-failure");
    // A background so far off that the model overflows from it: no cost can be evaluated there.
    let sets = ["--set", "background.covariance.sigma=1e40", "--set", "algorithm.max_iterations=3"];
    text(&folder.varda(&[&["compare", "lorenz63", "--out", "all"], &sets[..]].concat()));
    let csv = folder.read("all/compare.csv");
    assert_eq!(csv.lines().count(), 1 + 22, "{csv}");
    let blue = csv.lines().find(|l| l.starts_with("blue,")).unwrap();
    assert!(blue.starts_with("blue,closed-form,failed,") && !blue.ends_with("\"\""), "{csv}");
}

#[test]
fn the_modes_of_a_rod_come_in_pairs_where_its_section_is_round() {
    let folder = Folder::new("modes");
    text(&folder.varda(&["modes", "hanging-rod-case1", "--count", "4", "--out", "m"]));
    let summary: serde_json::Value = serde_json::from_str(&folder.read("m/summary.json")).unwrap();
    let f: Vec<f64> =
        summary["frequencies_hz"].as_array().unwrap().iter().map(|f| f.as_f64().unwrap()).collect();
    for pair in f.chunks(2) {
        assert!((pair[0] - pair[1]).abs() < 1e-6 * pair[0], "{f:?}");
    }
    assert!(f[2] > 1.5 * f[0] && summary["unstable"] == 0, "{summary}");
    assert_eq!(folder.read("m/modes.csv").lines().count(), 1 + 4);
    assert_eq!(folder.read("m/mode_shapes.csv").lines().count(), 1 + 4 * 26);
    assert!(folder.refusal(&["modes", "lorenz63-window"]).contains("only a rod has natural modes"));
}
