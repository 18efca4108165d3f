//! Force cells, accelerometers and gyroscopes in scenes: twins of each kind, what they find that markers do
//! not, readings read back, and what is said of wrong ones.

#[path = "support/cost_gradient.rs"]
mod cost_gradient;
#[path = "support/exact_hessian.rs"]
mod exact_hessian;
#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::Folder;
use varda::outcome::{Estimated, Outcome, Verdict};
use varda::preview::Preview;
use varda::report::write_simulation;
use varda::run::{Listener, assimilate, simulate};
use varda::setup::Problem;
use varda_rod::{Quaternion, UnitQuaternion, Vector3};

const ROD: &str = r#"
[model]
kind = "rod"
length = 0.5
segments = 10
gravity = [0.0, 0.0, -9.81]
damping = { mass = 0.5, stiffness = 0.01 }
[model.section]
kind = "stiffness"
ea = 1005.0
ei = [0.0161, 0.0161]
gj = 0.0107
mass_per_length = 0.221
rotary_inertia = 7.08e-6
[model.start]
position = [0.0, 0.0, 0.0]
tangent = [0.0, 0.0, -1.0]
director = [1.0, 0.0, 0.0]
motion = { kind = "ellipse", radii = [0.03, 0.02], omega = 8.0, ramp_periods = 1.0 }
[time]
integrator = "bdf2"
step = 0.01
spin_up = 100
window = 40
[background.covariance]
kind = "kernel"
sigma_x = 0.01
sigma_v = 0.1
correlation_length_x = 0.25
correlation_length_v = 0.25
"#;

const TWIN: &str =
    "[background]\nfrom = \"truth-plus-draw\"\n[observations]\nkind = \"synthetic\"\nevery = 4\n";
const PLACES: &str = "places = [0.25, 0.5]\nsigma = 0.002\n";
const BOTH: &str = "estimate={mass_per_length={sigma=\"30%\"},ei={sigma=\"30%\",together=true}}";

/// From a folder with what a twin has written.
const RECORDED: &str =
    "[background]\nfrom = \"file\"\nfile = \"background.csv\"\n[observations]\nkind = \"file\"\n";

fn sensor(name: &str, kind: &str, arc_length: f64, sigma: f64) -> String {
    format!(
        "[[observations.sensors]]\nname = \"{name}\"\nkind = \"{kind}\"\narc_length = {arc_length}\n\
         sigma = {sigma}\n"
    )
}

/// A body whose first axis is the tangent of the rod.
const AXES: &str = "axes = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]\n";

/// One of every kind that this rod has.
fn all_kinds() -> String {
    let more = [
        sensor("pointer", "direction", 0.2, 0.01),
        sensor("body", "orientation", 0.35, 0.01) + AXES,
        sensor("bench", "support-moment", 0.0, 0.001),
        sensor("gauge", "moment", 0.12, 0.001),
    ];
    of_forces_and_motion() + &more.concat()
}

fn of_forces_and_motion() -> String {
    [
        sensor("strand", "tension", 0.3, 0.01),
        sensor("clamp", "support-force", 0.0, 0.01),
        sensor("axis", "axial-support-force", 0.0, 0.02),
        sensor("chip", "acceleration", 0.4, 0.1),
        sensor("imu", "specific-force", 0.45, 0.1),
        sensor("gyro", "angular-rate", 0.45, 0.05),
    ]
    .concat()
}

fn ran(text: &str, folder: &Folder, sets: &[&str]) -> Outcome {
    let problem = Problem::from_scene(&folder.scene(text, sets).unwrap()).unwrap();
    assimilate(&problem, &mut Listener::silent()).unwrap()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn sigma(found: &Estimated) -> f64 {
    found.sigma.unwrap()
}

/// Each kind beside markers: the run fits, and σ at the start is smaller than by markers alone.
#[test]
fn every_kind_fits_in_a_twin_and_lowers_sigma() {
    let folder = Folder::new("sensors-kinds");
    let alone = ran(&format!("{ROD}{TWIN}{PLACES}"), &folder, &[]);
    // the share of σ that is left, a fifth above the 0.75, 0.51, 0.59, 0.57, 0.59 and 0.83 of this scene
    let kinds = [
        ("tension", 0.3, 0.01, "N", 0.9),
        ("support-force", 0.0, 0.01, "N", 0.61),
        ("axial-support-force", 0.0, 0.01, "N", 0.71),
        ("acceleration", 0.4, 0.1, "m/s²", 0.69),
        ("specific-force", 0.4, 0.1, "m/s²", 0.71),
        ("angular-rate", 0.4, 0.05, "rad/s", 0.99),
        ("direction", 0.4, 0.005, "rad", 0.99),
        ("orientation", 0.4, 0.005, "rad", 0.99),
        ("support-moment", 0.0, 0.001, "N m", 0.99),
        ("moment", 0.12, 0.001, "N m", 0.99),
    ];
    for (kind, s, sigma, unit, bound) in kinds {
        let text = format!("{ROD}{TWIN}{PLACES}{}", sensor("it", kind, s, sigma));
        let outcome = ran(&text, &folder, &[]);
        assert_eq!(outcome.judgement.verdict, Verdict::Fits, "{kind}: {}", outcome.judgement.text);
        let m = outcome.analysis.observations as f64;
        let chi2 = 2.0 * outcome.analysis.value / m;
        // four standard deviations of χ²/m
        assert!((chi2 - 1.0).abs() < 4.0 * (2.0 / m).sqrt(), "{kind}: 2J/m = {chi2}");
        assert!(outcome.observed.iter().any(|o| o.label == "sensor it" && o.unit == unit), "{kind}");
        let share = rms(&outcome.analysis.sigma_analysis[..27]) / rms(&alone.analysis.sigma_analysis[..27]);
        assert!(share < bound, "{kind}: σ of places {share} of that by markers");
    }
}

/// Markers find the ratio of stiffness and mass alone: a motion without forces has no kilogram in it.
#[test]
fn a_force_cell_finds_the_mass_that_markers_do_not() {
    let folder = Folder::new("sensors-mass");
    let of = |sensors: &str| {
        let outcome = ran(&format!("{ROD}{TWIN}{PLACES}{sensors}"), &folder, &[BOTH]);
        assert_eq!(outcome.judgement.verdict, Verdict::Fits, "{}", outcome.judgement.text);
        let found = outcome.estimates.into_iter().map(|e| (e.name.clone(), e));
        found.collect::<std::collections::BTreeMap<_, _>>()
    };
    let markers = of("");
    let [mass, ei] = ["mass_per_length", "ei"].map(|name| markers[name].clone());
    // the prior of the common factor, 30 % of two logarithms, is left: 21 %
    assert!(sigma(&mass) > 0.15 * mass.value && sigma(&ei) > 0.15 * ei.value, "{mass:?} {ei:?}");
    let cells = [("support-force", 0.0, 0.01, 0.01), ("moment", 0.12, 2e-4, 0.05)];
    // ten readings of 0.01 N of a weight of 1.08 N; of 0.2 mN m of moments of some 10 mN m
    for (kind, s, of_one, bound) in cells {
        let with = of(&sensor("cell", kind, s, of_one));
        let [mass, ei] = ["mass_per_length", "ei"].map(|name| with[name].clone());
        assert!(sigma(&mass) < bound * mass.value && sigma(&ei) < 0.05 * ei.value, "{kind} {mass:?} {ei:?}");
        for found in [mass, ei] {
            let truth = found.truth.unwrap();
            // of a draw: less than four σ
            assert!((found.value - truth).abs() < 4.0 * sigma(&found), "{kind} {found:?}");
        }
    }
}

/// A folder with the files of a twin.
fn of_twin(name: &str, twin: &str, sets: &[&str]) -> (Folder, Problem) {
    let folder = Folder::new(&format!("sensors-{name}"));
    let problem = Problem::from_scene(&folder.scene(twin, sets).unwrap()).unwrap();
    let simulation = simulate(&problem).unwrap();
    write_simulation(&simulation, 0.0, &folder.path().join("twin")).unwrap();
    for file in ["background.csv", "observations.csv", "readings.csv"] {
        let _ = std::fs::copy(folder.path().join("twin").join(file), folder.path().join(file));
    }
    (folder, problem)
}

#[test]
fn what_a_twin_draws_is_read_back() {
    let spins = ["model.twist_inertia=true"];
    let more = sensor("turn", "spin", 0.4, 0.05);
    let cases: [(&str, &str, String, &str, &[&str]); 3] = [
        ("alone", "", all_kinds(), "readings = \"readings.csv\"\n", &[]),
        ("both", PLACES, all_kinds(), "file = \"observations.csv\"\nreadings = \"readings.csv\"\n", &[]),
        ("spins", "", all_kinds() + &more, "readings = \"readings.csv\"\n", &spins),
    ];
    for (name, places, sensors, files, sets) in cases {
        let (folder, problem) = of_twin(name, &format!("{ROD}{TWIN}{places}{sensors}"), sets);
        let twin = assimilate(&problem, &mut Listener::silent()).unwrap();
        let read = ran(&format!("{ROD}{RECORDED}{files}{sensors}"), &folder, sets);
        let (a, b) = (&twin.analysis, &read.analysis);
        assert_eq!((a.observations, twin.fit.len()), (b.observations, read.fit.len()), "{name}");
        // the same numbers through text, and the same minimum to its tolerance
        assert!((twin.j_background - read.j_background).abs() < 1e-9 * twin.j_background, "{name}");
        assert!((a.value - b.value).abs() < 1e-6 * a.value, "{name}: {} {}", a.value, b.value);
        assert_eq!(twin.judgement.verdict, Verdict::Fits, "{name}: {}", twin.judgement.text);
    }
}

#[test]
fn a_force_that_is_read_at_the_start_is_warned_of() {
    let imu = sensor("imu", "specific-force", 0.4, 0.1);
    let warned = |every: usize| {
        let sets = [format!("observations.every={every}")];
        let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
        let (folder, _) = of_twin(&format!("early-{every}"), &format!("{ROD}{TWIN}{imu}"), &sets);
        let text = format!("{ROD}{RECORDED}readings = \"readings.csv\"\n{imu}");
        let preview = Preview::new(&folder.scene(&text, &[]).unwrap()).unwrap();
        preview.findings.iter().any(|f| f.text.contains("imu is read 1.0 steps after the start"))
    };
    assert!(warned(1) && !warned(2));
}

/// Readings kept back and after the window are judged in their own unit.
#[test]
fn a_sensor_that_is_kept_back_is_judged_in_its_unit() {
    let (folder, _) = of_twin("withheld", &format!("{ROD}{TWIN}{PLACES}{}", all_kinds()), &[]);
    let kept_back =
        all_kinds().replace("kind = \"support-force\"", "kind = \"support-force\"\nuse = \"withhold\"");
    let files = "file = \"observations.csv\"\nreadings = \"readings.csv\"\noutside_window = \"skip\"\n";
    let text = format!("{ROD}{RECORDED}{files}{kept_back}").replace("window = 40", "window = 30");
    let outcome = ran(&text, &folder, &["report.forecast=0.1"]);
    assert_eq!(outcome.withheld.len(), 1);
    let w = &outcome.withheld[0];
    assert!(w.label == "sensor clamp" && w.quantity.unit() == "N" && w.count == 7, "{w:?}");
    // noise of 0.01 N in three components, 0.017 N, of 21 values to 4 of its standard deviations
    assert!(w.rms_analysis < 0.03 && w.rms_analysis < 0.2 * w.rms_background, "{w:?}");
    let units: Vec<&str> = outcome.forecast.iter().map(|f| f.quantity.unit()).collect();
    assert_eq!(units, ["m", "m", "N", "N", "N", "m/s²", "m/s²", "rad/s", "rad", "rad", "N m", "N m"]);
    // a rotation that stays as it was last read is off by more than its noise of √2 and √3 times 0.01
    for f in outcome.forecast.iter().filter(|f| f.quantity.unit() == "rad") {
        assert!(f.analysis < 0.03 && f.persistence > 2.0 * f.analysis, "{f:?}");
        assert!(f.static_model > 2.0 * f.analysis, "{f:?}");
    }
    assert!(outcome.observed.iter().any(|o| o.reason == "withheld" && o.unit == "N" && o.axis == "fz"));
}

/// A direction has two degrees of freedom and an orientation three: readings of them alone have 2J/m of 1.
#[test]
fn rotations_alone_fit_with_their_degrees_of_freedom() {
    let folder = Folder::new("sensors-rotations");
    for (kind, values) in [("direction", 2), ("orientation", 3)] {
        let places = [0.1, 0.2, 0.3, 0.4, 0.5];
        let all: String = places.map(|s| sensor(&format!("at {s}"), kind, s, 0.01)).concat();
        let outcome = ran(&format!("{ROD}{TWIN}{all}"), &folder, &["observations.every=2"]);
        assert_eq!(outcome.judgement.verdict, Verdict::Fits, "{kind}: {}", outcome.judgement.text);
        let m = outcome.analysis.observations;
        assert_eq!(m, 20 * places.len() * values, "{kind}");
        let chi2 = 2.0 * outcome.analysis.value / m as f64;
        // three standard deviations of χ²/m, which 2/3 is not within
        let bound = 3.0 * (2.0 / m as f64).sqrt();
        assert!(bound < 0.33 && (chi2 - 1.0).abs() < bound, "{kind}: 2J/m = {chi2}");
        let correlated = "observations.correlation={time=0.05}";
        let outcome = ran(&format!("{ROD}{TWIN}{all}"), &folder, &["observations.every=2", correlated]);
        assert_eq!(outcome.judgement.verdict, Verdict::Fits, "{kind}: {}", outcome.judgement.text);
        let chi2 = 2.0 * outcome.analysis.value / m as f64;
        assert!((chi2 - 1.0).abs() < bound, "{kind}, correlated: 2J/m = {chi2}");
    }
}

/// A rod that is twisted by nature hangs as one that is not: its sections alone show it.
#[test]
fn an_orientation_finds_the_twist_that_a_direction_does_not() {
    let folder = Folder::new("sensors-twist");
    let of = |kind: &str| {
        let text = format!("{ROD}{TWIN}{PLACES}{}", sensor("tip", kind, 0.5, 0.01));
        let outcome = ran(&text, &folder, &["estimate={natural_twist={sigma=0.5}}"]);
        assert_eq!(outcome.judgement.verdict, Verdict::Fits, "{kind}: {}", outcome.judgement.text);
        let chi2 = 2.0 * outcome.analysis.value / outcome.analysis.observations as f64;
        let found = outcome.estimates.into_iter().find(|e| e.name == "natural_twist").unwrap();
        (found, chi2, outcome.analysis.observations as f64)
    };
    let (unseen, ..) = of("direction");
    // the prior is left, to its digits
    assert!(sigma(&unseen) > 0.99 * 0.5, "{unseen:?}");
    let (found, chi2, m) = of("orientation");
    // ten readings of 0.01 rad of an angle of half a metre of twist: 0.0063 rad/m, and what lags
    assert!(sigma(&found) < 0.02, "{found:?}");
    assert!((found.value - found.truth.unwrap()).abs() < 4.0 * sigma(&found), "{found:?}");
    assert!((chi2 - 1.0).abs() < 4.0 * (2.0 / m).sqrt(), "2J/m = {chi2}");
}

/// q and −q are one rotation, and digits are no error.
#[test]
fn the_sign_of_a_quaternion_does_not_matter() {
    let body = sensor("body", "orientation", 0.35, 0.01) + AXES;
    let (folder, _) = of_twin("sign", &format!("{ROD}{TWIN}{body}"), &[]);
    let text = format!("{ROD}{RECORDED}readings = \"readings.csv\"\n{body}");
    let as_drawn = ran(&text, &folder, &[]);
    let path = folder.path().join("readings.csv");
    let written = std::fs::read_to_string(&path).unwrap();
    let turned = |(i, line): (usize, &str)| {
        let mut cells: Vec<String> = line.split(',').map(String::from).collect();
        for cell in cells[2..6].iter_mut().filter(|_| i > 0 && i % 2 == 0) {
            *cell = (-1.001 * cell.parse::<f64>().unwrap()).to_string();
        }
        cells.join(",")
    };
    std::fs::write(&path, written.lines().enumerate().map(turned).collect::<Vec<_>>().join("\n")).unwrap();
    let other = ran(&text, &folder, &[]);
    // to the rounding of a product, and the minimum to its tolerance
    let [a, b] = [&as_drawn, &other].map(|o| (o.j_background, o.analysis.value));
    assert!((a.0 - b.0).abs() < 1e-9 * a.0 && (a.1 - b.1).abs() < 1e-6 * a.1, "{a:?} {b:?}");
}

/// A cell that reads 2 % too much stands out, by its name.
#[test]
fn a_cell_that_is_off_stands_out() {
    let (folder, _) = of_twin("off", &format!("{ROD}{TWIN}{PLACES}{}", all_kinds()), &[]);
    let path = folder.path().join("readings.csv");
    let text = std::fs::read_to_string(&path).unwrap();
    let heavier = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(String::from).collect();
        if cells[1] == "\"clamp\"" {
            let z = cells.iter().rposition(|c| c.parse::<f64>().is_ok_and(|v| v > 0.5)).unwrap();
            cells[z] = (cells[z].parse::<f64>().unwrap() + 0.1).to_string();
        }
        cells.join(",")
    };
    std::fs::write(&path, text.lines().map(heavier).collect::<Vec<_>>().join("\n")).unwrap();
    let files = "file = \"observations.csv\"\nreadings = \"readings.csv\"\n";
    let outcome = ran(&format!("{ROD}{RECORDED}{files}{}", all_kinds()), &folder, &[]);
    assert_eq!(outcome.judgement.verdict, Verdict::DoesNotFit);
    assert!(outcome.judgement.text.contains("sensor clamp"), "{}", outcome.judgement.text);
}

/// Windows of a sequence count their own steps; what was read is known by its time.
#[test]
fn windows_of_a_sequence_see_rotations_too() {
    let sensors = sensor("body", "orientation", 0.35, 0.01) + &sensor("pointer", "direction", 0.2, 0.01);
    let (folder, _) = of_twin("cycles", &format!("{ROD}{TWIN}{PLACES}{sensors}"), &[]);
    let files = "file = \"observations.csv\"\nreadings = \"readings.csv\"\n";
    std::fs::write(folder.path().join("scene.toml"), format!("{ROD}{RECORDED}{files}{sensors}")).unwrap();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_varda"));
    command.args(["run", "scene.toml", "--set", "time.window=20", "--set", "algorithm.cycles={count=2}"]);
    let ended = command.current_dir(folder.path()).output().unwrap();
    let said = String::from_utf8_lossy(&ended.stdout).into_owned() + &String::from_utf8_lossy(&ended.stderr);
    assert!(ended.status.success() && said.contains("FITS"), "{said}");
}

/// Offsets that accelerometers, cells and mounts of bodies have: found beside the state, and without them
/// nothing fits.
#[test]
fn biases_of_sensors_are_found() {
    let sensors = sensor("imu", "specific-force", 0.45, 0.1)
        + &sensor("clamp", "support-force", 0.0, 0.01)
        + &sensor("strand", "tension", 0.3, 0.01)
        + &sensor("body", "orientation", 0.35, 0.01);
    let (folder, _) = of_twin("bias", &format!("{ROD}{TWIN}{PLACES}{sensors}"), &[]);
    let path = folder.path().join("readings.csv");
    let written = std::fs::read_to_string(&path).unwrap();
    let columns: Vec<&str> = written.lines().next().unwrap().split(',').collect();
    let of = |name: &str| columns.iter().position(|column| *column == name).unwrap();
    // how the body is mounted, along its own axes
    let mount = UnitQuaternion::from_scaled_axis(Vector3::new(0.06, -0.04, 0.09));
    let offsets = [("\"imu\"", "fx_m_s2", 0.6), ("\"imu\"", "fz_m_s2", -0.4), ("\"clamp\"", "fz_n", 0.15)];
    let off = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(String::from).collect();
        for (name, column, by) in offsets {
            if cells[1] == name {
                cells[of(column)] = (cells[of(column)].parse::<f64>().unwrap() + by).to_string();
            }
        }
        if cells[1] == "\"body\"" {
            let [x, y, z, w] = [0, 1, 2, 3].map(|i| cells[of("qx") + i].parse::<f64>().unwrap());
            let turned = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)) * mount;
            for i in 0..4 {
                cells[of("qx") + i] = turned.coords[i].to_string();
            }
        }
        cells.join(",")
    };
    std::fs::write(&path, written.lines().map(off).collect::<Vec<_>>().join("\n")).unwrap();
    let files = "file = \"observations.csv\"\nreadings = \"readings.csv\"\n";
    let text = format!("{ROD}{RECORDED}{files}{sensors}");
    assert_eq!(ran(&text, &folder, &[]).judgement.verdict, Verdict::DoesNotFit);
    let biases = "estimate={bias={imu={sigma=1.0},clamp={sigma=0.3},body={sigma=0.2}}}";
    let outcome = ran(&text, &folder, &[biases]);
    assert_eq!(outcome.judgement.verdict, Verdict::Fits, "{}", outcome.judgement.text);
    let expected = [
        ("bias[imu].ax", "m/s²", 0.6),
        ("bias[imu].ay", "m/s²", 0.0),
        ("bias[imu].az", "m/s²", -0.4),
        ("bias[clamp].fx", "N", 0.0),
        ("bias[clamp].fy", "N", 0.0),
        ("bias[clamp].fz", "N", 0.15),
        ("bias[body].rx", "rad", 0.06),
        ("bias[body].ry", "rad", -0.04),
        ("bias[body].rz", "rad", 0.09),
    ];
    assert_eq!(outcome.estimates.len(), expected.len());
    for (found, (name, unit, value)) in outcome.estimates.iter().zip(expected) {
        assert_eq!((found.name.as_str(), found.unit), (name, unit));
        assert!((found.value - value).abs() < 4.0 * sigma(found), "{found:?}, {value}");
        // ten readings: a third of σ of one and less, of a prior of ten times that and more
        assert!(sigma(found) < 0.2 * found.prior_sigma, "{found:?}");
    }
}

/// All kinds have second derivatives, material damping and constants
/// included; without the key nothing of them is made.
#[test]
fn readings_have_the_exact_hessian_too() {
    let folder = Folder::new("sensors-exact");
    let text = format!("{ROD}{TWIN}{PLACES}{}", all_kinds());
    for sets in [&["report.mesh=false"][..], &["report.mesh=false", BOTH]] {
        let with = [sets, &["algorithm.hessian=\"exact\""]].concat();
        let (plain, exact) = (ran(&text, &folder, sets), ran(&text, &folder, &with));
        assert!((exact.analysis.value / plain.analysis.value - 1.0).abs() <= 1e-6);
        assert_eq!(plain.model_counts.adjoint_derivatives, 0);
        assert!(exact.convergence.iter().any(|r| r.hessian == Some("exact")));
        let found = exact.exact_hessian.unwrap();
        assert!(found.smallest_eigenvalue.is_some_and(|mu| mu > 0.0), "{found:?}");
        assert!(found.sigma_change.is_some_and(|change| change > 1e-4 && change < 1.0), "{found:?}");
    }
}

/// ∇²J with constants and biases beside differences of ∇J, of a rod without twist, with supports that
/// move, and of one that twists, with natural curvature, anisotropic, with inertia of its sections and
/// without.
#[test]
fn the_exact_hessian_of_a_cost_with_readings_and_constants() {
    let text = format!("{ROD}{TWIN}{PLACES}{}", all_kinds());
    let damping = "estimate.damping_stiffness={sigma=\"30%\"}";
    let anisotropic = "model.section.ei=[0.0161,0.011]";
    let curved = "model.natural_curvature=[0.8,-0.5]";
    let end = "model.end={position=[0.05,0.02,-0.46],tangent=[0.0,0.0,-1.0],director=[1.0,0.0,0.0]}";
    let (turned, placed) =
        ("estimate.clamp_direction={sigma=0.05}", "estimate.support_position={sigma=0.01}");
    let cases: [(&str, &[&str]); 7] = [
        ("plain", &[]),
        ("a clamp that moves", &[turned, placed]),
        ("clamps that move", &[anisotropic, curved, end, turned, placed]),
        ("anisotropic", &[anisotropic]),
        ("curved", &[anisotropic, curved]),
        ("spins", &[anisotropic, curved, "model.twist_inertia=true"]),
        ("held at both ends", &[anisotropic, curved, end]),
    ];
    for (name, sets) in cases {
        let sets = [sets, &[BOTH, damping, BIAS]].concat();
        let file = Folder::new(&format!("sensors-hessian-{name}")).scene(&text, &sets);
        let problem = Problem::from_scene(&file.unwrap()).unwrap();
        // gradients have rounding of strain rates, over 1e-3 Δt, in tensions: 3e-8 of a product and less
        let left_out = exact_hessian::is_that_of_differences(&problem, 3, 1e-7);
        assert!(left_out > 1e-3, "{name}: {left_out:e}");
    }
}

/// What is refused, with the words of it.
#[test]
fn what_is_wrong_is_named() {
    let (folder, _) = of_twin("wrong", &format!("{ROD}{TWIN}{}", all_kinds()), &[]);
    let refused = |rows: &str, sensors: &str, sets: &[&str]| {
        std::fs::write(folder.path().join("rows.csv"), rows).unwrap();
        let text = format!("{ROD}{RECORDED}readings = \"rows.csv\"\n{sensors}");
        match folder.scene(&text, sets) {
            Ok(file) => Problem::from_scene(&file).err().map_or_else(String::new, |e| e.to_string()),
            Err(error) => error.to_string(),
        }
    };
    let cell = sensor("cell", "tension", 0.3, 0.01);
    let no_sigma = cell.replace("sigma = 0.01\n", "");
    let clamp = sensor("clamp", "support-force", 0.0, 0.01);
    let (two, hook) = (format!("{cell}{clamp}"), sensor("hook", "support-force", 0.3, 0.01));
    let header = "time_s,sensor,tension_n";
    let good = format!("{header}\n1.3,cell,1.0\n");
    let row = |row: &str| format!("{header}\n{row}\n");
    let body = sensor("body", "orientation", 0.3, 0.01);
    let gauge = sensor("cell", "moment", 0.02, 0.01);
    let q = |q: &str| format!("time_s,sensor,qx,qy,qz,qw\n1.3,body,{q}\n");
    let euler = "time.integrator=\"backward-euler\"";
    let axes = format!("{cell}axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n");
    let ei = "estimate.ei={sigma=\"30%\",together=true}";
    let moved = "estimate.clamp_direction={sigma=0.1}";
    let cases: [(String, &str, &[&str], &[&str]); 31] = [
        (good.clone(), &cell, &[], &[]),
        (row("1.3,scale,1.0"), &cell, &[], &["rows.csv:2", "\"scale\"", "cell"]),
        (row("1.3,cell,NaN"), &cell, &[], &["rows.csv:2", "`tension_n` is NaN"]),
        (row("1.3,cell,1.0"), &no_sigma, &[], &["rows.csv:2", "the sensor's `sigma`"]),
        (row("9.3,cell,1.0"), &cell, &[], &["rows.csv:2", "outside the window"]),
        (format!("{header}\n"), &cell, &[], &["rows.csv:1", "no readings"]),
        ("time_s,sensor,force\n1.3,cell,1.0\n".into(), &cell, &[], &["rows.csv:1", "tension_n"]),
        ("time_s,sensor,fx_n\n1.3,cell,1.0\n".into(), &cell, &[], &["rows.csv:1", "no column \"tension_n\""]),
        (
            format!("{header},fx_n,fy_n,fz_n\n1.3,cell,,0.1,0.2,0.3\n"),
            &two,
            &[],
            &["rows.csv:2", "`fx_n`", "tension"],
        ),
        (good.clone(), &format!("{cell}{cell}"), &[], &["\"cell\" is there twice"]),
        (good.clone(), "", &[], &["needs [[observations.sensors]]"]),
        (good.clone(), &sensor("cell", "tension", 0.7, 0.01), &[], &["arc length 0.7 m is off the rod"]),
        (
            "time_s,sensor,fx_n,fy_n,fz_n\n1.3,hook,1,1,1\n".into(),
            &hook,
            &[],
            &["no support holds the rod at s = 0.3 m"],
        ),
        (
            "time_s,sensor,spin_rad_s\n1.3,cell,1.0\n".into(),
            &sensor("cell", "spin", 0.3, 0.01),
            &[],
            &["spin of edge", "is not in the state"],
        ),
        (good.clone(), &axes, &[], &["\"specific-force\" and \"orientation\" alone"]),
        (
            "time_s,sensor,m1_n_m,m2_n_m,t_n_m\n1.3,cell,0,0,0\n".into(),
            &gauge,
            &[],
            &["the moment at s = 0.02 m", "vertices that bend"],
        ),
        (q("0,0,0,1"), &body, &[], &[]),
        (
            good.clone(),
            &cell,
            &["estimate.bias={scale={sigma=0.1}}"],
            &["estimate.bias", "\"scale\" is none of what is observed: cell"],
        ),
        (good.clone(), &cell, &["estimate.ei={cell={sigma=0.1}}"], &["names are for bias, camera_rotation"]),
        (q("0,0,0.6,0.6"), &body, &[], &["rows.csv:2", "has length 0.84", "is 1"]),
        (q("0,0,,1"), &body, &[], &["rows.csv:2", "(qx, qy, qz, qw) is one reading"]),
        (
            q("0,0,0,1\n1.3,body,0,0,1,0"),
            &body,
            &[],
            &["rows.csv:3", "\"body\" reads a second orientation at this time"],
        ),
        (
            q("0,0,0,1\n1.3033,body,0,0,1,0"),
            &body,
            &["time.integrator=\"midpoint\""],
            &["scene.toml", "between two steps"],
        ),
        (
            q("0,0,0,1"),
            &body,
            &["model.section.ei=[0.0,0.0]", "model.section.gj=0.0"],
            &["scene.toml", "observe its `direction`"],
        ),
        (good.clone(), &cell, &[euler], &["time.integrator", "angles of the state before"]),
        (good.clone(), &cell, &["time.tolerance=1e-3"], &["time.tolerance", "leave it out"]),
        (good.clone(), &cell, &["estimate.clock={sigma=0.01}"], &["estimate.clock"]),
        (good.clone(), &cell, &["algorithm.hessian=\"exact\""], &[]),
        (good.clone(), &cell, &["algorithm.hessian=\"exact\"", ei], &[]),
        (good.clone(), &cell, &["algorithm.hessian=\"exact\"", moved], &[]),
        (good, &cell, &["observations.correlation={length=0.1}"], &["take `time`"]),
    ];
    for (rows, sensors, sets, words) in cases {
        let said = refused(&rows, sensors, sets);
        assert!(words.iter().all(|word| said.contains(word)), "{said}: {words:?}");
        assert_eq!(said.is_empty(), words.is_empty(), "{said}");
    }
}

const BIAS: &str = "estimate.bias={imu={sigma=0.5},clamp={sigma=0.1},body={sigma=0.1},strand={sigma=0.1}}";

/// ∇J with constants, at two controls one after the other, and Gᵀ beside G.
#[test]
fn the_gradient_of_a_cost_with_readings_and_constants() {
    let text = format!("{ROD}{TWIN}{PLACES}{}", all_kinds());
    let file = Folder::new("sensors-gradient")
        .scene(&text, &[BOTH, "estimate.damping_stiffness={sigma=\"30%\"}", BIAS]);
    let problem = Problem::from_scene(&file.unwrap()).unwrap();
    cost_gradient::is_that_of_differences(&problem);
}

/// A rod at rest: its mass by the force on its clamp, and how it hangs by an accelerometer, which sees
/// gravity.
#[test]
fn a_rod_at_rest_is_weighed() {
    let rod = ROD.split("[time]").next().unwrap().replace("motion = ", "# motion = ").replace(
        "tangent = [0.0, 0.0, -1.0]\ndirector = [1.0, 0.0, 0.0]",
        "tangent = [1.0, 0.0, 0.0]\ndirector = [0.0, 0.0, 1.0]",
    );
    let rod = rod.replace("damping = { mass = 0.5, stiffness = 0.01 }\n", "");
    let text = format!(
        "{rod}[algorithm]\nmethod = \"static\"\n[estimate]\nmass_per_length = {{ sigma = \"30%\" }}\n\
         ei = {{ sigma = \"30%\", together = true }}\n[observations]\n\
         kind = \"file\"\nreadings = \"rows.csv\"\n{}{}",
        sensor("clamp", "support-force", 0.0, 0.01),
        sensor("imu", "specific-force", 0.45, 0.02)
    );
    let rows = "sensor,fx_n,fy_n,fz_n,fx_m_s2,fy_m_s2,fz_m_s2\nclamp,0.0,0.0,1.3,,,\nimu,,,,6.2,0.0,-7.6\n";
    let folder = Folder::new("sensors-static").with("rows.csv", rows);
    let outcome = ran(&text, &folder, &[]);
    let mass = outcome.estimates.iter().find(|e| e.name == "mass_per_length").unwrap();
    // 1.3 N over g and half a metre, ± 0.01 N; the prior is 100 times wider
    let weighed = 1.3 / (9.81 * 0.5);
    assert!((mass.value - weighed).abs() < 1e-3 * weighed, "{mass:?}");
    assert!((sigma(mass) - 0.01 / (9.81 * 0.5)).abs() < 1e-2 * sigma(mass), "{mass:?}");
    let ei = outcome.estimates.iter().find(|e| e.name == "ei").unwrap();
    assert!(sigma(ei) < 0.2 * ei.prior_sigma, "{ei:?}");
}
