//! Cameras in scenes: pixels read and drawn, beside coordinates and alone, and what is said of wrong ones.

#[path = "support/cost_gradient.rs"]
mod cost_gradient;
#[path = "support/exact_hessian.rs"]
mod exact_hessian;
#[path = "support/rod_scene.rs"]
mod rod_scene;

use rod_scene::Folder;
use varda::outcome::{Outcome, Verdict, remarks_on_estimates};
use varda::report::write_simulation;
use varda::run::{Listener, assimilate, simulate};
use varda::setup::Problem;
use varda_rod::{Matrix3, Vector3, rotation};

const ROD: &str = r#"
[model]
kind = "rod"
length = 0.5
segments = 10
gravity = [0.0, 0.0, -9.81]
section = { kind = "circle", radius = 0.008 }
material = { youngs_modulus = 5e6, poisson_ratio = 0.5, density = 1100.0 }
damping = { mass = 0.5 }
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

const TWIN: &str = "[background]\nfrom = \"truth-plus-draw\"\n[observations]\nkind = \"synthetic\"\n\
                    places = [0.25, 0.5]\nevery = 4\n";

/// From a folder with what a twin has written.
const RECORDED: &str = "[background]\nfrom = \"file\"\nfile = \"background.csv\"\n[observations]\n\
                        kind = \"file\"\n";

/// Looking along the model's y from its negative side, and along −x.
const LEFT: &str = r#"
[[observations.cameras]]
name = "left"
focal_length = [800.0, 805.0]
principal_point = [320.0, 240.0]
distortion = [-0.2, 0.05, 1e-3, -5e-4, 0.0]
position = [0.0, -1.5, -0.3]
rotation = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
image = [640.0, 480.0]
sigma = 0.5
"#;
const RIGHT: &str = r#"
[[observations.cameras]]
name = "right"
focal_length = [800.0, 800.0]
principal_point = [320.0, 240.0]
position = [1.4, 0.1, -0.25]
rotation = [[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]
image = [640.0, 480.0]
sigma = 0.5
"#;

/// A folder with the files of a twin.
fn of_twin(name: &str, twin: &str) -> (Folder, Problem) {
    let folder = Folder::new(&format!("cameras-{name}"));
    let problem = Problem::from_scene(&folder.scene(twin, &[]).unwrap()).unwrap();
    let simulation = simulate(&problem).unwrap();
    write_simulation(&simulation, 0.0, &folder.path().join("twin")).unwrap();
    for file in ["background.csv", "observations.csv", "pixels.csv"] {
        let _ = std::fs::copy(folder.path().join("twin").join(file), folder.path().join(file));
    }
    (folder, problem)
}

fn write(folder: &Folder, file: &str, text: &str) {
    std::fs::write(folder.path().join(file), text).unwrap();
}

fn read(folder: &Folder, file: &str) -> String {
    std::fs::read_to_string(folder.path().join(file)).unwrap()
}

fn run(problem: &Problem) -> Outcome {
    assimilate(problem, &mut Listener::silent()).unwrap()
}

fn ran(text: &str, folder: &Folder, sets: &[&str]) -> Outcome {
    run(&Problem::from_scene(&folder.scene(text, sets).unwrap()).unwrap())
}

/// One camera, two, and two beside coordinates: what a twin writes is read back to the same cost.
#[test]
fn what_a_twin_draws_is_read_back() {
    let cases = [
        ("one", "", LEFT.to_string(), "pixels = \"pixels.csv\"\n"),
        ("two", "", format!("{LEFT}{RIGHT}"), "pixels = \"pixels.csv\"\n"),
        (
            "both",
            "sigma = 0.002\n",
            format!("{LEFT}{RIGHT}"),
            "file = \"observations.csv\"\npixels = \"pixels.csv\"\n",
        ),
    ];
    let mut sigmas = Vec::new();
    for (name, sigma, cameras, files) in cases {
        let (folder, problem) = of_twin(name, &format!("{ROD}{TWIN}{sigma}{cameras}"));
        let twin = run(&problem);
        let read = ran(&format!("{ROD}{RECORDED}{files}{cameras}"), &folder, &[]);
        let (a, b) = (&twin.analysis, &read.analysis);
        assert_eq!((a.observations, twin.fit.len()), (b.observations, read.fit.len()), "{name}");
        // the same numbers through text, and the same minimum to its tolerance
        assert!((twin.j_background - read.j_background).abs() < 1e-9 * twin.j_background, "{name}");
        assert!((a.value - b.value).abs() < 1e-6 * a.value, "{name}: {} {}", a.value, b.value);
        assert_eq!(twin.judgement.verdict, Verdict::Fits, "{name}: {}", twin.judgement.text);
        assert_eq!(read.fit.iter().filter(|f| f.quantity.unit() == "px").count() % 2, 0);
        sigmas.push(rms(&a.sigma_analysis[..27]));
    }
    // a second camera sees the depth
    assert!(sigmas[1] < 0.8 * sigmas[0] && sigmas[2] < 0.8 * sigmas[0], "{sigmas:?}");
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Cameras calibrated in other axes than the model's, with their frame.
#[test]
fn a_frame_turns_and_displaces_cameras_too() {
    let (folder, _) = of_twin("frame", &format!("{ROD}{TWIN}sigma = 0.002\n{LEFT}"));
    let files = "file = \"observations.csv\"\npixels = \"pixels.csv\"\n";
    let plain = ran(&format!("{ROD}{RECORDED}{files}{LEFT}"), &folder, &[]);
    // x_model = R x_recorded + t, R about z by 90°: recorded = (y − t_y, −(x − t_x), z − t_z)
    let text = read(&folder, "observations.csv");
    let turned: Vec<String> = text
        .lines()
        .enumerate()
        .map(|(i, line)| {
            let cells: Vec<&str> = line.split(',').collect();
            if i == 0 {
                return line.to_string();
            }
            let at = |c: usize| cells[c].parse::<f64>().unwrap();
            let (x, y, z) = (at(3) - 0.2, -(at(2) - 0.1), at(4) + 0.3);
            format!("{},{},{x},{y},{z},{}", cells[0], cells[1], cells[5])
        })
        .collect();
    write(&folder, "observations.csv", &turned.join("\n"));
    let frame = "[observations.frame]\naxis = [0.0, 0.0, 1.0]\nangle = 1.5707963267948966\n\
                 translation = [0.1, 0.2, -0.3]\n";
    // the camera's place and axes in the recording's
    let camera = LEFT.replace("position = [0.0, -1.5, -0.3]", "position = [-1.7, 0.1, 0.0]").replace(
        "[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]",
        "[[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]",
    );
    let other = ran(&format!("{ROD}{RECORDED}{files}{camera}{frame}"), &folder, &[]);
    // rounding of places of a metre over σ of half a millimetre
    assert!((plain.j_background - other.j_background).abs() < 1e-9 * plain.j_background);
    assert!((plain.analysis.value - other.analysis.value).abs() < 1e-6 * plain.analysis.value);
}

/// What is refused, with the words of it.
#[test]
fn what_is_wrong_is_named() {
    let (folder, _) = of_twin("wrong", &format!("{ROD}{TWIN}{LEFT}"));
    let marker = "[[observations.markers]]\nname = \"tip\"\narc_length = 0.5\n";
    let text = |camera: &str| format!("{ROD}{RECORDED}pixels = \"rows.csv\"\n{camera}{marker}");
    let refused = |rows: &str, camera: &str, sets: &[&str]| {
        write(&folder, "rows.csv", rows);
        let file = match folder.scene(&text(camera), sets) {
            Ok(file) => file,
            Err(error) => return error.to_string(),
        };
        match Problem::from_scene(&file) {
            Ok(problem) => assimilate(&problem, &mut Listener::silent()).unwrap_err().to_string(),
            Err(error) => error.to_string(),
        }
    };
    let header = "time_s,camera,marker,u_px,v_px\n";
    let good = format!("{header}1.3,left,tip,320,300\n");
    let no_sigma = LEFT.replace("sigma = 0.5\n", "");
    let cases: [(&str, &str, &[&str], &[&str]); 15] = [
        ("1.3,centre,tip,320,300\n", LEFT, &[], &["rows.csv:2", "\"centre\"", "left"]),
        ("1.3,left,nose,320,300\n", LEFT, &[], &["rows.csv:2", "\"nose\"", "no place"]),
        ("1.3,left,tip,1320,300\n", LEFT, &[], &["rows.csv:2", "marker tip", "(1320, 300) px", "640 × 480"]),
        ("1.3,left,tip,320,500\n", LEFT, &[], &["rows.csv:2", "outside the image", "exchanged"]),
        ("1.3,left,tip,NaN,300\n", LEFT, &[], &["rows.csv:2", "`u_px` is NaN"]),
        ("1.3,left,tip,320,300\n", &no_sigma, &[], &["rows.csv:2", "sigma_px", "camera's `sigma`"]),
        ("1.3,,tip,320,300\n", LEFT, &[], &["rows.csv:2", "`camera` is empty"]),
        ("9.3,left,tip,320,300\n", LEFT, &[], &["rows.csv:2", "outside the window"]),
        ("", LEFT, &[], &["rows.csv:1", "no observations"]),
        ("1.3,left,tip,320,300\n", &format!("{LEFT}{LEFT}"), &[], &["camera \"left\" is there twice"]),
        ("1.3,left,tip,320,300\n", LEFT, &["estimate.bias={sigma=0.01}"], &["marker_offset"]),
        ("1.3,left,tip,320,300\n", LEFT, &["observations.correlation={length=0.1}"], &["take `time`"]),
        ("1.3,left,tip,320,300\n", "", &[], &["needs [[observations.cameras]]"]),
        ("1.3,left,tip,320,300\n", LEFT, &["estimate.camera_rotation={up={sigma=0.1}}"], &["\"up\"", "left"]),
        (
            "1.3,left,tip,320,300\n",
            LEFT,
            &["estimate.camera_rotation={sigma=\"10%\"}"],
            &["camera_rotation", "not a share"],
        ),
    ];
    for (rows, camera, sets, words) in cases {
        let said = refused(&format!("{header}{rows}"), camera, sets);
        assert!(words.iter().all(|word| said.contains(word)), "{said}: {words:?}");
    }
    let said = refused("time_s,camera,marker,u,v_px\n", LEFT, &[]);
    assert!(said.contains("rows.csv:1") && said.contains("u_px"), "{said}");
    // the model has the marker behind a camera that looks away, and far outside a lens that folds over
    let away = LEFT.replace("[0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]", "[0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]");
    let said = refused(&good, &away, &[]);
    assert!(
        ["marker tip in camera left cannot be seen at t = 1.3 s", "behind it"]
            .iter()
            .all(|w| said.contains(w)),
        "{said}"
    );
    let folds = LEFT.replace("-0.2, 0.05", "-90.0, 0.0");
    let said = refused(&good, &folds, &[]);
    assert!(said.contains("marker tip in camera left") && said.contains("k1, k2, k3"), "{said}");
}

/// Rows outside the image are left out where the scene wants that, and listed.
#[test]
fn rows_outside_the_image_may_be_left_out() {
    let (folder, _) = of_twin("outside", &format!("{ROD}{TWIN}{LEFT}"));
    let rows = format!("{}1.3,left,0.5,-900.0,20.0,0.5\n", read(&folder, "pixels.csv"));
    write(&folder, "pixels.csv", &rows);
    let text = format!("{ROD}{RECORDED}pixels = \"pixels.csv\"\nunreachable = \"skip\"\n{LEFT}");
    let problem = Problem::from_scene(&folder.scene(&text, &[]).unwrap()).unwrap();
    let recording = problem.observed.recording.as_ref().unwrap();
    assert_eq!((recording.rows.refused, recording.rows.used, recording.rows.all), (1, 20, 21));
    let listed = &problem.observed.left_out;
    assert!(listed.iter().any(|l| l.contains("outside the image, in lines 22")), "{listed:?}");
    assert!(recording.tracks.iter().all(|track| track.quantity.unit() == "px"));
}

/// A camera kept back, and the forecast, are judged in pixels; markers in metres.
#[test]
fn a_camera_that_is_kept_back_is_judged_in_pixels() {
    let twin = format!("{ROD}{TWIN}sigma = 0.002\n{LEFT}{RIGHT}");
    let (folder, _) = of_twin("withheld", &twin);
    let right = RIGHT.replace("sigma = 0.5", "sigma = 0.5\nuse = \"withhold\"");
    let files = "file = \"observations.csv\"\npixels = \"pixels.csv\"\noutside_window = \"skip\"\n";
    let text = format!("{ROD}{RECORDED}{files}{LEFT}{right}").replace("window = 40", "window = 30");
    let outcome = ran(&text, &folder, &["report.forecast=0.1"]);
    assert_eq!(outcome.withheld.len(), 2);
    for w in &outcome.withheld {
        assert!(w.label.ends_with(" in camera right") && w.quantity.unit() == "px" && w.count == 7, "{w:?}");
        // noise of 0.5 px in u and v, and what two markers and one camera leave unknown
        assert!(w.rms_analysis < 3.0 && w.rms_analysis < 0.5 * w.rms_background, "{w:?}");
    }
    let units: Vec<&str> = outcome.forecast.iter().map(|f| f.quantity.unit()).collect();
    assert_eq!(units, ["m", "m", "px", "px", "px", "px"]);
    assert!(outcome.forecast.iter().all(|f| f.analysis < 0.5 * f.static_model), "{:?}", outcome.forecast);
    assert!(outcome.observed.iter().any(|o| o.reason == "withheld" && o.unit == "px"));
}

/// Two cameras in one place see no depth, one seen twice: σ says so.
#[test]
fn depth_that_no_camera_sees_is_uncertain_and_not_nan() {
    let same = LEFT.replace("\"left\"", "\"beside\"");
    let across = ran(&format!("{ROD}{TWIN}{LEFT}{RIGHT}"), &Folder::new("cameras-across"), &[]);
    let one_place = ran(&format!("{ROD}{TWIN}{LEFT}{same}"), &Folder::new("cameras-beside"), &[]);
    // y of the tip, the depth of the camera on the left
    let depth = |outcome: &Outcome| outcome.analysis.sigma_analysis[3 * 8 + 1];
    let [alone, seen] = [&one_place, &across].map(depth);
    // what is left is known from the rod's length and motion
    assert!(alone.is_finite() && alone > 1.5 * seen, "{alone} {seen}");
    let prior = one_place.analysis.sigma_background[3 * 8 + 1];
    assert!(depth(&one_place) <= prior, "{} {prior}", depth(&one_place));
    // and a lens of a telescope: a pixel is a micrometre
    let far = LEFT
        .replace("[800.0, 805.0]", "[1e6, 1e6]")
        .replace("position = [0.0, -1.5, -0.3]", "position = [0.0, -1000.0, -0.3]")
        .replace("image = [640.0, 480.0]\n", "");
    let far = ran(&format!("{ROD}{TWIN}{far}"), &Folder::new("cameras-far"), &[]);
    assert!(far.analysis.value.is_finite() && far.analysis.sigma_analysis.iter().all(|s| s.is_finite()));
    assert_eq!(far.judgement.verdict, Verdict::Fits, "{}", far.judgement.text);
}

/// A calibration that is off makes one camera stand out, in pixels.
#[test]
fn a_camera_whose_calibration_is_off_stands_out() {
    let twin = format!("{ROD}{TWIN}sigma = 0.001\n{LEFT}{RIGHT}");
    let (folder, _) = of_twin("off", &twin);
    let files = "file = \"observations.csv\"\npixels = \"pixels.csv\"\n";
    let off = RIGHT.replace("principal_point = [320.0, 240.0]", "principal_point = [326.0, 240.0]");
    let outcome = ran(&format!("{ROD}{RECORDED}{files}{LEFT}{off}"), &folder, &[]);
    assert_eq!(outcome.judgement.verdict, Verdict::DoesNotFit);
    let text = &outcome.judgement.text;
    assert!(text.contains("camera right") && !text.contains("camera left"), "{text}");
}

/// A camera that was moved after its calibration, by half a degree and 5 mm: its pose is found beside the
/// rod, and without it nothing fits.
#[test]
fn the_pose_of_a_camera_is_found() {
    let (folder, _) = of_twin("pose", &format!("{ROD}{TWIN}{LEFT}{RIGHT}"));
    // calibrated as turned by −ρ about its own axes, with its centre elsewhere: R_c = exp([ρ]×) R
    let rho = Vector3::new(0.0, 0.5_f64.to_radians(), 0.0);
    let axes = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, -1.0, -1.0, 0.0, 0.0);
    let calibrated = rotation::exponential(&rho) * axes;
    let rows: Vec<Vec<f64>> = (0..3).map(|r| (0..3).map(|c| calibrated[(r, c)]).collect()).collect();
    let off = RIGHT
        .replace("[[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]]", &format!("{rows:?}"))
        .replace("[1.4, 0.1, -0.25]", "[1.4, 0.1, -0.255]");
    assert_ne!(off, RIGHT);
    let text = format!("{ROD}{RECORDED}pixels = \"pixels.csv\"\n{LEFT}{off}");
    let without = ran(&text, &folder, &[]);
    // the minimizer stalls on the way, at many times what a fit has
    assert_ne!(without.judgement.verdict, Verdict::Fits, "{}", without.judgement.text);
    assert!(2.0 * without.analysis.value > 5.0 * without.analysis.observations as f64);
    let of = |names: &str| {
        let sets = ["rotation", "translation"].map(|key| {
            let sigma = if key == "rotation" { 0.02 } else { 0.01 };
            format!("estimate.camera_{key}={}", names.replace("PRIOR", &format!("{{sigma={sigma}}}")))
        });
        ran(&text, &folder, &sets.each_ref().map(String::as_str))
    };
    let found = of("{right=PRIOR}");
    assert_eq!(found.judgement.verdict, Verdict::Fits, "{}", found.judgement.text);
    let m = found.analysis.observations as f64;
    let chi2 = 2.0 * found.analysis.value / m;
    // four standard deviations of χ²/m
    assert!((chi2 - 1.0).abs() < 4.0 * (2.0 / m).sqrt(), "2J/m = {chi2}");
    let names: Vec<&str> = found.estimates.iter().map(|e| e.name.as_str()).collect();
    let axes = |key: &str| ["x", "y", "z"].map(|axis| format!("camera_{key}[right].{axis}"));
    assert_eq!(names, [axes("rotation"), axes("translation")].concat());
    // the camera stands where the twin had it: turned and moved back
    let expected = [0.0, rho.y, 0.0, 0.0, 0.0, 0.005];
    for (e, expected) in found.estimates.iter().zip(expected) {
        assert!((e.value - expected).abs() < 4.0 * e.sigma.unwrap(), "{e:?}, {expected}");
    }
    // about its optical axis it is seen by itself: a tenth of the prior
    assert!(found.estimates[2].sigma.unwrap() < 0.2 * 0.02, "{:?}", found.estimates[2]);
    // every camera: as many unknowns for each
    assert_eq!(of("PRIOR").estimates.len(), 12);
}

/// All cameras turned together is the rig turned.
#[test]
fn a_pose_and_a_mount_are_seen_together() {
    let sets = ["estimate.camera_translation={sigma=0.02}", "estimate.mount_translation={sigma=0.02}"];
    let outcome = ran(&format!("{ROD}{TWIN}{LEFT}"), &Folder::new("cameras-mount"), &sets);
    assert_eq!(outcome.judgement.verdict, Verdict::Fits, "{}", outcome.judgement.text);
    let remarks = remarks_on_estimates(&outcome.estimates, true);
    let both = |r: &String| r.contains("camera_translation[left].x") && r.contains("mount_translation.x");
    assert!(remarks.iter().any(|r| r.contains("seen together only") && both(r)), "{remarks:?}");
}

/// ∇J with poses, at two controls one after the other, and Gᵀ beside G.
#[test]
fn the_gradient_of_a_cost_with_poses() {
    let twin = format!("{ROD}{TWIN}sigma = 0.002\n{LEFT}{RIGHT}");
    let sets = ["estimate.camera_rotation={sigma=0.02}", "estimate.camera_translation={left={sigma=0.01}}"];
    let file = Folder::new("cameras-poses").scene(&twin, &sets).unwrap();
    cost_gradient::is_that_of_differences(&Problem::from_scene(&file).unwrap());
}

/// ∇²J with poses, where the axes of the recording, markers, the clock and constants of the rod are
/// unknown too, beside differences of ∇J.
#[test]
fn the_exact_hessian_of_a_cost_with_poses() {
    let twin = format!("{ROD}{TWIN}sigma = 0.002\n{LEFT}{RIGHT}");
    let poses = ["estimate.camera_rotation={sigma=0.02}", "estimate.camera_translation={left={sigma=0.01}}"];
    let seen = [
        "estimate.mount_rotation={sigma=0.02}",
        "estimate.mount_translation={sigma=0.01}",
        "estimate.marker_offset={sigma=0.002}",
        "estimate.clock={sigma=0.005}",
    ];
    let of_rod = ["estimate.youngs_modulus={sigma=\"30%\"}", "estimate.damping_stiffness={sigma=\"30%\"}"];
    let flat = "model.section={kind=\"ellipse\",semi_axes=[0.008,0.005]}";
    let (damped, curved) = ("model.damping.stiffness=0.01", "model.natural_curvature=[0.8,-0.5]");
    let end = "model.end={position=[0.05,0.02,-0.46],tangent=[0.0,0.0,-1.0],director=[1.0,0.0,0.0]}";
    let cases: [(&str, Vec<&str>, usize); 4] = [
        ("plain", vec![], 9),
        ("all", [&[flat, damped, curved][..], &seen, &of_rod].concat(), 9 + 6 + 6 + 1 + 2),
        ("spins", [&[flat, damped, curved, "model.twist_inertia=true"][..], &seen].concat(), 9 + 6 + 6 + 1),
        ("both-ends", [&[flat, damped, curved, end][..], &seen].concat(), 9 + 6 + 6 + 1),
    ];
    for (name, sets, constants) in cases {
        let sets = [&poses[..], &sets].concat();
        let file = Folder::new(&format!("cameras-hessian-{name}")).scene(&twin, &sets).unwrap();
        let problem = Problem::from_scene(&file).unwrap();
        // h⁸ of the ninth derivative: 9e-10 of a product and less
        let left_out = exact_hessian::is_that_of_differences(&problem, constants, 1e-8);
        assert!(left_out > 1e-3, "{name}: {left_out:e}");
    }
}

/// A run with unknown poses takes the exact Hessian: the same minimum, and another σ.
#[test]
fn unknown_poses_have_the_exact_hessian_too() {
    let twin = format!("{ROD}{TWIN}{LEFT}{RIGHT}");
    let poses = ["estimate.camera_rotation={sigma=0.02}", "estimate.camera_translation={right={sigma=0.01}}"];
    let folder = Folder::new("cameras-exact");
    let exact = ran(&twin, &folder, &[&poses[..], &["algorithm.hessian=\"exact\""]].concat());
    let plain = ran(&twin, &folder, &poses);
    assert_eq!(exact.judgement.verdict, Verdict::Fits, "{}", exact.judgement.text);
    // both end where J falls by less than 1e-6 of itself
    assert!((exact.analysis.value / plain.analysis.value - 1.0).abs() <= 1e-6);
    assert!(exact.convergence.iter().any(|r| r.hessian == Some("exact")));
    assert!(plain.exact_hessian.is_none());
    let found = exact.exact_hessian.unwrap();
    assert!(found.smallest_eigenvalue.is_some_and(|mu| mu > 0.0), "{found:?}");
    assert!(found.sigma_change.is_some_and(|change| change > 1e-4 && change < 1.0), "{found:?}");
}

/// ∇J of pixels and coordinates in one cost, at two controls one after the other, and Gᵀ beside G.
#[test]
fn the_gradient_of_a_cost_in_pixels() {
    let twin = format!("{ROD}{TWIN}sigma = 0.002\n{LEFT}{RIGHT}");
    let problem = Problem::from_scene(&Folder::new("cameras-two").scene(&twin, &[]).unwrap()).unwrap();
    cost_gradient::is_that_of_differences(&problem);
}

/// Windows of a sequence count their own steps; what must be in sight is known by its time.
#[test]
fn windows_of_a_sequence_see_pixels_too() {
    let (folder, _) = of_twin("cycles", &format!("{ROD}{TWIN}{LEFT}{RIGHT}"));
    let run = |cameras: &str, out: &str| {
        write(&folder, "scene.toml", &format!("{ROD}{RECORDED}pixels = \"pixels.csv\"\n{cameras}"));
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_varda"));
        command.args(["run", "scene.toml", "--out", out, "--set", "time.window=20"]);
        command.args(["--set", "algorithm.cycles={count=2}"]).current_dir(folder.path()).output().unwrap()
    };
    let fits = run(&format!("{LEFT}{RIGHT}"), "fits");
    let said = String::from_utf8_lossy(&fits.stdout).into_owned() + &String::from_utf8_lossy(&fits.stderr);
    assert!(fits.status.success() && said.contains("FITS"), "{said}");
    // a camera that looks away names its marker in the first window
    let away =
        RIGHT.replace("[0.0, 1.0, 0.0]", "[0.0, -1.0, 0.0]").replace("[-1.0, 0.0, 0.0]]", "[1.0, 0.0, 0.0]]");
    let refused = run(&format!("{LEFT}{away}"), "away");
    let said =
        String::from_utf8_lossy(&refused.stdout).into_owned() + &String::from_utf8_lossy(&refused.stderr);
    assert!(!refused.status.success() && said.contains("in camera right cannot be seen at t = "), "{said}");
}
