//! Scenes and recordings with one thing wrong each: a unit, a clock, a direction, a mesh.

use super::folder::{Folder, RECORDED_ROD};
use crate::row::{Case, Outcome, Rows};
use std::fmt::Write;
use varda::Error;
use varda::preview::{Finding, Preview, Severity, findings};
use varda::scene::SceneFile;
use varda::setup::Inputs;

/// What must come of an input.
enum Wanted {
    /// Nothing is said.
    Right,
    /// An error with these words, before anything runs.
    Refused(&'static [&'static str]),
    /// A warning at this key with these words.
    Warned(&'static str, &'static [&'static str]),
    /// An error at this key with these words, when the scene is checked.
    Faulty(&'static str, &'static [&'static str]),
}
use Wanted::{Faulty, Refused, Right, Warned};

/// A name, keys that are set, the recording, what must come of it.
type Input = (&'static str, &'static [&'static str], fn() -> String, Wanted);

pub(super) fn run(rows: &mut Rows) {
    rows.area("input");
    rows.reason("what was probably meant is named with the key and its value");
    for (name, sets, recording, wanted) in VALUES {
        rows.case(name, |case| looked_at(case, name, sets, recording(), wanted, false));
    }
    rows.area("ensemble");
    for (name, sets, recording, wanted) in ENSEMBLES {
        rows.case(name, |case| looked_at(case, name, sets, recording(), wanted, false));
    }
    rows.area("recording");
    for (name, sets, recording, wanted) in RECORDINGS {
        rows.case(name, |case| looked_at(case, name, sets, recording(), wanted, false));
    }
    rows.area("numerics");
    for (name, sets, recording, wanted) in NUMERICS {
        rows.case(name, |case| looked_at(case, name, sets, recording(), wanted, true));
    }
    rows.area("other models");
    for (name, scene, set, place) in [
        ("Lorenz-63, a step of half a unit", "lorenz63", "time.step=0.5", "time.step"),
        ("Lorenz-96, σ of 100", "lorenz96", "observations.sigma=100.0", "observations.sigma"),
    ] {
        rows.case(name, |case| {
            let inputs = Inputs::read(&SceneFile::open(scene, &[set.to_string()])?)?;
            let named = findings(&inputs).iter().any(|f| f.place == place);
            case.count("named", usize::from(named), 1);
            Ok(())
        });
    }
}

fn looked_at(
    case: &mut Case,
    name: &str,
    sets: &[&str],
    recording: String,
    wanted: &Wanted,
    with_runs: bool,
) -> Outcome {
    let folder = Folder::new(name)?;
    folder.write("seen.csv", recording.as_bytes())?;
    // a section of stiffnesses has no material
    let stiffnesses = sets.iter().any(|set| set.contains("kind = \"stiffness\""));
    let of_section = |line: &&str| !(stiffnesses && line.starts_with("material"));
    let scene: String = RECORDED_ROD.lines().filter(of_section).map(|line| format!("{line}\n")).collect();
    let found = folder.scene(&scene, sets).and_then(|file| found(&file, with_runs));
    let all = |words: &[&str], text: &str| words.iter().all(|word| text.contains(word));
    let at = |found: &[Finding], severity: Severity, place: &str, words: &[&str]| {
        found.iter().any(|f| f.severity == severity && f.place == place && all(words, &f.text))
    };
    let (right, note) = match (&found, wanted) {
        (Err(error), Refused(words)) => (all(words, &error.to_string()), error.to_string()),
        (Err(error), _) => (false, error.to_string()),
        (Ok((found, _)), wanted) => {
            let right = match wanted {
                Right => found.is_empty(),
                Refused(_) => false,
                Warned(place, words) => {
                    let none_worse = found.iter().all(|f| f.severity == Severity::Warning);
                    at(found, Severity::Warning, place, words) && none_worse
                }
                Faulty(place, words) => at(found, Severity::Error, place, words),
            };
            (right, found.iter().map(Finding::to_string).collect::<Vec<_>>().join("; "))
        }
    };
    case.count("as it should be", usize::from(right), 1).note(note);
    if let Ok((_, [all, parts])) = found {
        case.count("rows accounted for", parts, all).because("used, refused, outside and what else is said");
    }
    Ok(())
}

/// What is found, and the rows of the file beside the sum of where they went.
fn found(file: &SceneFile, with_runs: bool) -> Result<(Vec<Finding>, [usize; 2]), Error> {
    let inputs = Inputs::read(file)?;
    let rows = inputs.observed.recording.as_ref().map_or([0, 0], |r| [r.rows.all, r.rows.parts()]);
    let found = if with_runs { Preview::new(file)?.findings } else { findings(&inputs) };
    Ok((found, rows))
}

/// Values that a scene may have.
const VALUES: &[Input] = &[
    ("nothing wrong", &[], clean, Right),
    ("length in millimetres", &["model.length=500.0"], clean, Warned("model.length", &["0.5 m", "mm"])),
    ("radius in millimetres", &["model.section.radius=5.0"], clean, Refused(&["model.section", "unit"])),
    ("radius in centimetres", &["model.section.radius=0.2"], clean, Warned("model.section", &["0.2 m"])),
    ("a hair", &["model.section.radius=5e-6"], clean, Warned("model.section", &["0.005"])),
    (
        "Young's modulus in GPa",
        &["model.material.youngs_modulus=210.0"],
        clean,
        Warned("model.material.youngs_modulus", &["210", "2.1e11"]),
    ),
    (
        "Young's modulus times a thousand",
        &["model.material.youngs_modulus=2.1e14"],
        clean,
        Warned("model.material.youngs_modulus", &["2.1e11"]),
    ),
    (
        "density in g/cm³",
        &["model.material.density=1.1"],
        clean,
        Warned("model.material.density", &["g/cm³", "1100"]),
    ),
    (
        "density times a thousand",
        &["model.material.density=1.1e6"],
        clean,
        Warned("model.material.density", &["1100"]),
    ),
    (
        "Poisson's ratio of 3",
        &["model.material.poisson_ratio=3.0"],
        clean,
        Refused(&["poisson_ratio", "3", "0.2 to 0.5"]),
    ),
    ("gravity in mm", &["model.gravity=[0.0, 0.0, -9810.0]"], clean, Warned("model.gravity", &["mm/s²"])),
    (
        "a radius of curvature",
        &["model.natural_curvature=[200.0, 0.0]"],
        clean,
        Warned("model.natural_curvature", &["0.0050"]),
    ),
    (
        "twist in degrees",
        &["model.natural_twist=3600.0"],
        clean,
        Warned("model.natural_twist", &["degrees", "62.83"]),
    ),
    (
        "damping in milliseconds",
        &["model.damping.stiffness=8.0"],
        clean,
        Warned("model.damping.stiffness", &["0.008 s"]),
    ),
    (
        "a mass in grams",
        &["model.point_masses=[{ arc_length = 0.5, mass = 50.0 }]"],
        clean,
        Warned("model.point_masses.0.mass", &["50 kg", "0.05 kg"]),
    ),
    (
        "a director not across",
        &["model.start.director=[1.0, 0.0, -1.0]"],
        clean,
        Warned("model.start.director", &["45.0°"]),
    ),
    (
        "a director along the rod",
        &["model.start.director=[0.0, 0.0, -1.0]"],
        clean,
        Refused(&["director", "across"]),
    ),
    (
        "clamps farther apart than the rod is long",
        &["model.end={ position = [0.0, 0.0, 0.0], tangent = [0.0, 0.0, -1.0], director = [1.0, 0.0, 0.0] }"],
        || "time_s,marker,x_m,y_m,z_m\n0,tip,0,0,0\n".into(),
        Warned("model.end.position", &["100 %"]),
    ),
    (
        "a drive in millimetres",
        &["model.start.motion={ kind = \"ellipse\", radii = [20.0, 10.0], omega = 6.0, ramp_periods = 1.0 }"],
        none,
        Warned("model.start.motion.radii", &["0.02 m"]),
    ),
    (
        "four steps to a circle",
        &[
            "model.start.motion={ kind = \"ellipse\", radii = [0.02, 0.01], omega = 6.0, ramp_periods = 1 }",
            "time={ integrator = \"bdf2\", steps_per_period = 4, window = 40 }",
        ],
        none,
        Warned("time.steps_per_period", &["4 steps"]),
    ),
    (
        "σ in millimetres",
        &["observations.sigma=2.0"],
        clean,
        Warned("observations.sigma", &["2 m", "0.002 m"]),
    ),
    (
        "σ of the background in millimetres",
        &["background.covariance.sigma_x=20.0"],
        clean,
        Warned("background.covariance.sigma_x", &["0.02 m"]),
    ),
    (
        "σ of velocities in mm/s",
        &["background.covariance.sigma_v=300.0"],
        clean,
        Warned("background.covariance.sigma_v", &["0.3 m/s"]),
    ),
    (
        "a correlation length in millimetres",
        &["background.covariance.correlation_length_x=250.0"],
        clean,
        Warned("background.covariance.correlation_length_x", &["0.25 m"]),
    ),
    (
        "a frame turned by 90, in degrees",
        &["observations.frame={ axis = [0.0, 0.0, 1.0], angle = 90.0 }"],
        clean,
        Refused(&["90 rad", "degrees", "1.570796"]),
    ),
    (
        "a frame turned by 5, in degrees",
        &["observations.frame={ axis = [0.0, 0.0, 1.0], angle = 5.0 }"],
        clean,
        Warned("observations.frame.angle", &["5 rad", "0.0873"]),
    ),
    (
        "an offset in centimetres",
        &["observations.markers=[{ name = \"middle\", arc_length = 0.25, offset = [0.5, 0.0, 0.0] }, \
          { name = \"tip\", arc_length = 0.5 }]"],
        clean,
        Warned("observations.markers.0.offset", &["0.5 m off"]),
    ),
    (
        "a speed in mm/s",
        &["observations.max_speed=30000.0"],
        clean,
        Warned("observations.max_speed", &["30 m/s"]),
    ),
    (
        "EI in N mm²",
        &["model.section={ kind = \"stiffness\", ea = 78.0, ei = [490.0, 490.0], gj = 330.0, \
          mass_per_length = 0.086 }"],
        clean,
        Warned("model.section.ei", &["490 N m²", "4.9e-4"]),
    ),
    (
        "GJ in N mm²",
        &["model.section={ kind = \"stiffness\", ea = 78.0, ei = [4.9e-4, 4.9e-4], gj = 330.0, \
          mass_per_length = 0.086 }"],
        clean,
        Warned("model.section.gj", &["330 N m²"]),
    ),
    (
        "a focal length in millimetres",
        &["observations.cameras=[{ name = \"left\", focal_length = [8.0, 8.0], \
          principal_point = [640.0, 360.0], \
          image = [1280.0, 720.0], sigma = 0.5, position = [0.0, -2.0, 0.5], \
          rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]] }]"],
        clean,
        Warned("observations.cameras.0.focal_length", &["millimetres"]),
    ),
    (
        "a focal length with a digit lost",
        &["observations.cameras=[{ name = \"left\", focal_length = [900.0, 90.0], \
          principal_point = [640.0, 360.0], \
          image = [1280.0, 720.0], sigma = 0.5, position = [0.0, -2.0, 0.5], \
          rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]] }]"],
        clean,
        Warned("observations.cameras.0.focal_length", &["square"]),
    ),
    (
        "a principal point of a larger image",
        &["observations.cameras=[{ name = \"left\", focal_length = [900.0, 900.0], \
          principal_point = [960.0, 540.0], \
          image = [1280.0, 720.0], sigma = 0.5, position = [0.0, -2.0, 0.5], \
          rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]] }]"],
        clean,
        Right,
    ),
    (
        "a principal point outside the image",
        &["observations.cameras=[{ name = \"left\", focal_length = [900.0, 900.0], \
          principal_point = [1930.0, 1085.0], \
          image = [1280.0, 720.0], sigma = 0.5, position = [0.0, -2.0, 0.5], \
          rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]] }]"],
        clean,
        Warned("observations.cameras.0.principal_point", &["outside the image", "another size"]),
    ),
    (
        "σ of pixels in metres",
        &["observations.cameras=[{ name = \"left\", focal_length = [900.0, 900.0], \
          principal_point = [640.0, 360.0], \
          image = [1280.0, 720.0], sigma = 5e-4, position = [0.0, -2.0, 0.5], \
          rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]] }]"],
        clean,
        Warned("observations.cameras.0.sigma", &["pixels"]),
    ),
    (
        "a camera placed in millimetres",
        &["observations.cameras=[{ name = \"left\", focal_length = [900.0, 900.0], \
          principal_point = [640.0, 360.0], \
          image = [1280.0, 720.0], sigma = 0.5, position = [0.0, -2000.0, 500.0], \
          rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]] }]"],
        clean,
        Warned("observations.cameras.0.position", &["millimetres"]),
    ),
    (
        "a camera that mirrors",
        &["observations.cameras=[{ name = \"left\", focal_length = [900.0, 900.0], \
          position = [0.0, -2.0, 0.5], principal_point = [640.0, 360.0], \
          rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]] }]"],
        clean,
        Refused(&["it mirrors"]),
    ),
];

/// Ensembles of a rod.
const ENSEMBLES: &[Input] = &[
    (
        "an ensemble localized to less than a wave travels",
        &["algorithm={ method = \"4denvar\", ensemble = { members = 20, localization_length = 0.1 } }"],
        clean,
        Warned(
            "algorithm.ensemble.localization_length",
            &["0.1 m", "30 m/s", "0.500 m of its 0.500 m", "4dvar"],
        ),
    ),
    (
        "a hybrid ensemble localized to less than a wave travels",
        &["algorithm={ method = \"hybrid-4denvar\", ensemble = { localization_length = 0.1 } }"],
        clean,
        Warned("algorithm.ensemble.localization_length", &["0.1 m", "4dvar"]),
    ),
    (
        "a window too short for a wave to cross",
        &[
            "algorithm={ method = \"4denvar\", ensemble = { members = 20, localization_length = 0.4 } }",
            "time={ integrator = \"bdf2\", step = 0.0004, window = 25 }",
        ],
        || recorded(|t| 0.02 * t, |x| x, 21),
        Right,
    ),
    (
        "an ensemble without localization",
        &["algorithm={ method = \"4denvar\", ensemble = { members = 20 } }"],
        clean,
        Right,
    ),
];

/// Recordings beside a scene.
const RECORDINGS: &[Input] = &[
    (
        "times in milliseconds",
        &["observations.outside_window=skip"],
        || recorded(|t| 1e3 * t + 50.0, |x| x, 21),
        Faulty("observations.file", &["nothing is observed", "time_ms"]),
    ),
    (
        "times in milliseconds, from 0",
        &["observations.outside_window=skip"],
        || recorded(|t| 1e3 * t, |x| x, 21),
        Warned("observations.file", &["40 of 42 rows", "time_ms"]),
    ),
    (
        "times in milliseconds, rows outside refused",
        &[],
        || recorded(|t| 1e3 * t, |x| x, 21),
        Refused(&["seen.csv:4", "outside the window", "time_ms"]),
    ),
    (
        "a clock that began long before",
        &["observations.outside_window=skip"],
        || recorded(|t| t + 100.0, |x| x, 21),
        Faulty("observations.file", &["nothing is observed", "time_zero = 100"]),
    ),
    (
        "a recording twelve times as long",
        &["observations.outside_window=skip"],
        || recorded(|t| t, |x| x, 250),
        Warned("observations.file", &["left out", "500 rows"]),
    ),
    (
        "a marker with its place in the file",
        &["observations.outside_window=skip"],
        || placed([0.375, 0.375]),
        Right,
    ),
    (
        "a marker at two places",
        &["observations.outside_window=skip"],
        || placed([0.375, 0.38]),
        Refused(&["seen.csv:4", "marker \"third\" is at s_m = 0.38", "0.375"]),
    ),
    (
        "markers that were never seen",
        &[],
        || "time_s,marker,x_m,y_m,z_m\n0.1,tip,,,\n0.2,tip,,,\n".into(),
        Faulty("observations.file", &["nothing is observed", "2 empty"]),
    ),
    (
        "all markers kept back",
        &["observations.markers=[{ name = \"middle\", arc_length = 0.25, use = \"withhold\" }, \
          { name = \"tip\", arc_length = 0.5, use = \"withhold\" }]"],
        clean,
        Faulty("observations.file", &["nothing is observed", "42 kept back"]),
    ),
    (
        "all markers ignored",
        &["observations.markers=[]", "observations.ignore=[\"middle\", \"tip\"]"],
        clean,
        Faulty("observations.file", &["nothing is observed", "42 ignored"]),
    ),
    (
        "a marker with no place",
        &["observations.markers=[{ name = \"middle\", arc_length = 0.25 }]"],
        clean,
        Refused(&["seen.csv:3", "\"tip\"", "has no place"]),
    ),
    (
        "places in millimetres",
        &[],
        || recorded(|t| t, |x| x.map(|c| 1e3 * c), 21),
        Refused(&["seen.csv", "x_mm"]),
    ),
    (
        "arc lengths too near each other",
        &["observations.markers=[{ name = \"middle\", arc_length = 0.45 }, \
          { name = \"tip\", arc_length = 0.5 }]"],
        clean,
        Warned("observations.markers", &["marker middle and marker tip", "apart", "0.0500 m"]),
    ),
    (
        "hundreds of rows to a step",
        &["time.step=0.02", "time.window=20"],
        || recorded(|t| 1e-3 * t, |x| x, 401),
        Warned("observations.file", &["hundreds of rows"]),
    ),
    (
        "two frames to a window",
        &["observations.outside_window=skip"],
        || recorded(|t| 12.5 * t, |x| x, 6),
        Warned("observations.file", &["every 0.25 s", "time_ms"]),
    ),
    (
        "σ three hundred times the noise",
        &["observations.sigma=0.2"],
        || recorded(|t| t, |x| x, 21),
        Warned("observations.sigma", &["scatters by"]),
    ),
    ("half of the rows outside", &["observations.outside_window=skip"], || recorded(|t| t, |x| x, 42), Right),
    (
        "rows twice",
        &[],
        || {
            let once = clean();
            format!("{once}{}", once.split_once('\n').map_or("", |(_, rows)| rows))
        },
        Right,
    ),
    (
        "a lost marker as 0,0,0, left out on request",
        &["observations.unreachable=skip"],
        || format!("{}0.15,tip,0,0,0\n", clean()),
        Right,
    ),
];

/// What a run and two equilibria tell.
const NUMERICS: &[Input] = &[
    ("a step that is right", &[], clean, Right),
    (
        "backward Euler with long steps",
        &["time={ integrator = \"backward-euler\", step = 0.04, window = 25 }"],
        || recorded(|t| t, |x| x, 51),
        Warned("time.integrator", &["of its amplitude", "bdf2"]),
    ),
    (
        "a few steps to a period",
        &["time={ integrator = \"bdf2\", step = 0.2, window = 4 }"],
        || recorded(|t| t, |x| x, 41),
        Warned("time.step", &["steps to a period"]),
    ),
    (
        "three segments",
        &["model.segments=3", "model.start.tangent=[1.0, 0.0, 0.0]", "model.start.director=[0.0, 1.0, 0.0]"],
        || recorded(|t| t, |x| [0.4 * (1.0 - x[2]), x[1], 1.0 - 0.85 * (1.0 - x[2])], 21),
        Warned("model.segments", &["twice as many as 3"]),
    ),
];

/// What was recorded right.
fn clean() -> String {
    recorded(|t| t, |x| x, 21)
}

/// Too little to contradict a drive.
/// A marker that the scene does not list, at places of its own.
fn placed(places: [f64; 2]) -> String {
    let [a, b] = places.map(|s| format!("third,{s},0,0,{}", 1.0 - places[0]));
    format!("time_s,marker,s_m,x_m,y_m,z_m\n0,tip,,0,0,0.5\n0,{a}\n0.01,{b}\n0.01,tip,,0,0,0.5\n")
}

fn none() -> String {
    "time_s,marker,x_m,y_m,z_m\n0,tip,0,0,0.5\n".into()
}

/// Two markers that swing, every 0.02 s, with a millimetre of something like noise.
fn recorded(time: fn(f64) -> f64, place: fn([f64; 3]) -> [f64; 3], frames: usize) -> String {
    let mut csv = String::from("time_s,marker,x_m,y_m,z_m\n");
    for k in 0..frames {
        let t = 0.02 * k as f64;
        for (m, name) in ["middle", "tip"].into_iter().enumerate() {
            let noise = 1e-3 * (7.3 * k as f64 + 2.1 * m as f64).sin();
            let swing = 0.02 * (6.0 * t).sin() * (m + 1) as f64 + noise;
            let [x, y, z] = place([swing, 0.001 * t, 0.75 - 0.25 * m as f64 + 0.002]);
            let _ = writeln!(csv, "{:.6},{name},{x:.6},{y:.6},{z:.6}", time(t));
        }
    }
    csv
}
