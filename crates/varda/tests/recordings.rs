//! Several recordings in one estimate.

use std::path::PathBuf;

use varda::outcome::{JointOutcome, Verdict};
use varda::report::write_recordings;
use varda::run::{Listener, assimilate, assimilate_recordings};
use varda::scene::{STARTER, SceneFile};
use varda::setup::{Problem, Recordings};

/// The starter's rod with an unknown modulus, and recordings.
fn scene(recordings: &str, sets: &[&str]) -> Result<SceneFile, varda::Error> {
    let text = format!("{STARTER}\n[estimate]\nyoungs_modulus = {{ sigma = \"15%\" }}\n{recordings}");
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    SceneFile::parse("several", "several.toml", &text, None, &sets)
}

const TWO: &str = "[[recordings]]\nname = \"a\"\n[[recordings]]\nname = \"b\"\ntime = { spin_up = 37 }\n";
const SMALL: [&str; 2] = ["model.segments=8", "time.window=30"];

fn run(file: &SceneFile) -> JointOutcome {
    assimilate_recordings(&Recordings::from_scene(file).unwrap(), &mut Listener::silent()).unwrap()
}

fn message(recordings: &str, sets: &[&str]) -> String {
    let sets = [&SMALL, sets].concat();
    match scene(recordings, &sets).and_then(|file| Recordings::from_scene(&file)) {
        Ok(_) => panic!("this is wrong: {recordings}"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn one_recording_is_the_scene_without() {
    let plain = scene("", &SMALL).unwrap();
    let plain = assimilate(&Problem::from_scene(&plain).unwrap(), &mut Listener::silent()).unwrap();
    let joint = run(&scene("[[recordings]]\nname = \"a\"\n", &SMALL).unwrap());
    let one = &joint.recordings[0];
    for (a, b) in
        [(&plain.analysis.analysis, &one.analysis.analysis), (&plain.sigma_states, &one.sigma_states)]
    {
        let size = a.iter().fold(0.0_f64, |size, a| size.max(a.abs()));
        let off = a.iter().zip(b).fold(0.0_f64, |off, (a, b)| off.max((a - b).abs()));
        assert!(off <= 1e-9 * size && a.len() == b.len(), "{off} of {size}");
    }
    assert!((joint.j / plain.analysis.value - 1.0).abs() < 1e-12);
    let (a, b) = (&plain.estimates[0], &joint.estimates[0]);
    assert!(
        (a.value / b.value - 1.0).abs() < 1e-12 && (a.sigma.unwrap() / b.sigma.unwrap() - 1.0).abs() < 1e-9
    );
    assert!((joint.degrees_of_freedom.unwrap() - plain.analysis.degrees_of_freedom).abs() < 1e-8);
    assert!((one.analysis.degrees_of_freedom - plain.analysis.degrees_of_freedom).abs() < 1e-6);
    assert_eq!(joint.judgement.verdict, Verdict::Fits, "{}", joint.judgement.text);
    assert!(joint.judgement.text.ends_with(" values in one recording"), "{}", joint.judgement.text);
}

#[test]
fn parts_of_j_and_their_means_add_up() {
    let joint = run(&scene(TWO, &SMALL).unwrap());
    let sum: f64 = joint.shares.iter().map(|share| share.j).sum();
    assert!((sum / joint.j - 1.0).abs() < 1e-12, "{sum} and {}", joint.j);
    let of_each: f64 = joint.recordings.iter().map(|one| one.analysis.value).sum();
    assert!((of_each + joint.shares[1].j - joint.j).abs() < 1e-9 * joint.j, "{of_each}");
    let expected: Option<f64> = joint.shares.iter().map(|share| share.expected).sum();
    assert!((expected.unwrap() / (0.5 * joint.observations as f64) - 1.0).abs() < 1e-12);
    let signal: f64 = joint.recordings.iter().map(|one| one.analysis.degrees_of_freedom).sum();
    assert!((signal / joint.degrees_of_freedom.unwrap() - 1.0).abs() < 1e-6, "{signal}");
    // one number is shared
    assert_eq!(joint.unknowns, 2 * 6 * 7 + 1);
    let [a, b] = [0, 1].map(|r| &joint.recordings[r]);
    assert_eq!(a.estimates[0].value.to_bits(), b.estimates[0].value.to_bits());
    assert!((a.estimates[0].sigma.unwrap() / b.estimates[0].sigma.unwrap() - 1.0).abs() < 1e-8);
    assert!(a.truth != b.truth, "states of other times");
}

#[test]
fn methods_that_see_least_squares_agree() {
    let j = |method: &str| {
        let joint = run(&scene(TWO, &[&SMALL[..], &[method]].concat()).unwrap());
        assert_eq!(joint.judgement.verdict, Verdict::Fits, "{method}: {}", joint.judgement.text);
        joint.j
    };
    let first = j("algorithm.minimizer=trust-region");
    for method in [
        "algorithm.method=4dvar-incremental",
        "algorithm.method=4d-psas",
        "algorithm.minimizer=gauss-newton-cg",
    ] {
        assert!((j(method) / first - 1.0).abs() < 1e-9, "{method}");
    }
}

#[test]
fn a_constant_of_a_recording_alone_is_named_with_it() {
    let own = TWO.replacen("name = \"a\"", "name = \"a\"\nestimate = { drive_phase = { sigma = 0.1 } }", 1);
    let joint = run(&scene(&own, &SMALL).unwrap());
    let names: Vec<&str> = joint.estimates.iter().map(|e| e.name.as_str()).collect();
    assert_eq!(names, ["youngs_modulus", "drive_phase (a)"]);
    assert_eq!([joint.recordings[0].estimates.len(), joint.recordings[1].estimates.len()], [2, 1]);
    for e in &joint.estimates {
        let off = (e.value - e.truth.unwrap()).abs() / e.sigma.unwrap();
        assert!(off < 3.5, "{}: {off} σ", e.name);
    }
}

const WEAK: &str = "algorithm.model_error={every=10,covariance={kind=\"kernel\",sigma_x=0.001,sigma_v=0.01,\
                    correlation_length_x=0.1,correlation_length_v=0.1}}";
const OTHER: &str = "[[recordings]]\nname = \"a\"\n[[recordings]]\nname = \"b\"\n\
                     model = { material = { youngs_modulus = 2e6 } }\n";

#[test]
fn what_cannot_be_is_refused_with_the_key() {
    for (recordings, sets, expected) in [
        (TWO, &["algorithm.method=4denvar"][..], "takes one recording"),
        (TWO, &["algorithm.method=weak-forcing", WEAK][..], "takes one recording"),
        (TWO, &["algorithm.window_growth=[10,30]"][..], "leave it out"),
        (TWO, &["algorithm.background_check=5.0"][..], "leave it out"),
        (TWO, &["estimate.clock={sigma=0.01}"][..], "passes over one recording"),
        (TWO, &["estimate.observation_sigma={sigma=\"10%\"}"][..], "passes over one recording"),
        ("[[recordings]]\nname = \"a/b\"\n", &[][..], "a folder's name"),
        (
            "[[recordings]]\nname = \"a\"\n[[recordings]]\nname = \"A\"\n",
            &[][..],
            "two recordings are called",
        ),
        ("[[recordings]]\nname = \"a\"\ntime = { windou = 3 }\n", &[][..], "did you mean `window`"),
        ("[[recordings]]\nname = \"a\"\nalgorithm = { }\n", &[][..], "unknown key `algorithm`"),
        (
            "[[recordings]]\nname = \"a\"\n[[recordings]]\nname = \"b\"\nmodel = { length = 0.3 }\n",
            &[][..],
            "recording \"b\": arc length 0.5 m is off the rod",
        ),
        (OTHER, &[][..], "are the same in all recordings"),
        (
            "[[recordings]]\nname = \"a\"\nestimate = { youngs_modulus = { sigma = \"5%\" } }\n",
            &[][..],
            "leave it out there or here",
        ),
    ] {
        let message = message(recordings, sets);
        assert!(message.contains(expected), "{recordings}{sets:?}: {message}");
    }
    // a key of a recording is pointed at where it stands
    let message = message("[[recordings]]\nname = \"a\"\ntime = { windou = 3 }\n", &[]);
    let line = STARTER.matches('\n').count() + 6;
    assert!(message.starts_with(&format!("several.toml:{line}:")), "{message}, line {line}");
    let one = Problem::from_scene(&scene(TWO, &SMALL).unwrap()).err().map(|e| e.to_string()).unwrap();
    assert!(one.contains("--set recordings=[]"), "{one}");
}

/// A folder with seen.csv: a tip seen four times.
fn folder_with_file(of: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("varda-recordings-{of}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let rows = [1.05, 1.1, 1.15, 1.2].map(|t| format!("{t},0.5,0.1,0.0,-0.45\n")).concat();
    std::fs::write(folder.join("seen.csv"), format!("time_s,s_m,x_m,y_m,z_m\n{rows}")).unwrap();
    folder
}

const OF_FILE: &str = "observations = { kind = \"file\", file = \"seen.csv\", time_zero = 0.0, sigma = 0.5, \
                       outside_window = \"skip\" }\nbackground = { from = \"static-equilibrium\" }\n";

fn of_files(of: &str, recordings: &str) -> Result<Recordings, varda::Error> {
    let folder = folder_with_file(of);
    let text = format!("{STARTER}\n[estimate]\nyoungs_modulus = {{ sigma = \"15%\" }}\n{recordings}");
    let sets = [&SMALL[..], &["algorithm.max_iterations=30"]].concat();
    let sets: Vec<String> = sets.iter().map(|s| s.to_string()).collect();
    let all = SceneFile::parse("several", "several.toml", &text, Some(&folder), &sets)
        .and_then(|file| Recordings::from_scene(&file));
    std::fs::remove_dir_all(&folder).unwrap();
    all
}

/// The prior of what a twin shares is drawn around the truth, that of a real recording is the scene's: one
/// number would have two values.
#[test]
fn twins_and_real_recordings_are_not_mixed() {
    for (first, second) in [("", OF_FILE), (OF_FILE, "")] {
        let both = format!("[[recordings]]\nname = \"a\"\n{first}[[recordings]]\nname = \"b\"\n{second}");
        let message = of_files("mixed", &both).err().map(|error| error.to_string()).unwrap();
        assert!(message.contains("make all of them synthetic, or none"), "{message}");
    }
}

#[test]
fn a_recording_with_nothing_in_its_window_does_not_fit() {
    let both = format!(
        "[[recordings]]\nname = \"a\"\n{OF_FILE}[[recordings]]\nname = \"b\"\n{OF_FILE}time = {{ spin_up = \
         300 }}\n"
    );
    let joint = assimilate_recordings(&of_files("empty", &both).unwrap(), &mut Listener::silent()).unwrap();
    assert_eq!([0, 1].map(|r| joint.recordings[r].analysis.observations), [12, 0]);
    assert_eq!(
        joint.recordings[0].judgement.verdict,
        Verdict::Fits,
        "{}",
        joint.recordings[0].judgement.text
    );
    assert_eq!(joint.judgement.verdict, Verdict::NothingObserved, "{}", joint.judgement.text);
    assert!(joint.judgement.text.starts_with("b ("), "{}", joint.judgement.text);
}

#[test]
fn remarks_that_are_of_all_are_said_once() {
    let joint = run(&scene(TWO, &[&SMALL[..], &["algorithm.max_iterations=1"]].concat()).unwrap());
    let notes = joint.notes();
    let count = joint.recordings[0].warnings.len();
    assert!(count > 0 && notes.len() < joint.warnings.len() + 2 * count, "{notes:?}");
    assert!(joint.judgement.text.starts_with("all ("), "{}", joint.judgement.text);
}

/// What markers and priors of one recording leave of a variance is not only its background's.
#[test]
fn the_rest_of_a_variance_is_also_that_of_other_recordings() {
    let joint = run(&scene(TWO, &SMALL).unwrap());
    for one in &joint.recordings {
        let last = one.sources[0].shares.last().unwrap();
        assert_eq!(last.source, "background of the state, other recordings");
    }
}

#[test]
fn the_folder_has_one_of_each_and_their_sum() {
    let file = SceneFile::open("wires", &[]).unwrap();
    let joint = run(&file);
    assert_eq!(joint.judgement.verdict, Verdict::Fits, "{}", joint.judgement.text);
    let folder = std::env::temp_dir().join(format!("varda-recordings-{}", std::process::id()));
    let folder = write_recordings(&joint, &folder).unwrap();
    for name in ["summary.json", "report.html", "estimates.csv", "convergence.csv"] {
        assert!(folder.join(name).is_file(), "{name}");
    }
    for (name, one) in ["pose-0", "pose-2"].iter().zip(&joint.recordings) {
        assert_eq!(one.experiment.name, *name);
        for of_one in ["summary.json", "report.html", "observations.csv", "analysis.csv"] {
            assert!(folder.join(name).join(of_one).is_file(), "{name}/{of_one}");
        }
        // iterations are of all
        for of_all in ["convergence.csv", "figures/convergence.svg"] {
            assert!(!folder.join(name).join(of_all).exists(), "{name}/{of_all}");
        }
    }
    let text = std::fs::read_to_string(folder.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["recordings"].as_array().unwrap().len(), 2);
    assert_eq!(summary["estimates"][0]["name"], "ei");
    assert_eq!(summary["n_unknown"], 25);
    let page = std::fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(page.contains("Recording pose-0") && page.contains("href=\"pose-2/report.html\""));
    std::fs::remove_dir_all(&folder).unwrap();
}
