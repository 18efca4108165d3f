//! Scenes of the recordings under tests/fixtures, for suites and benchmarks.

use std::path::PathBuf;

/// Points of the wires, by wire and pose.
const WIRES: &str = include_str!("../../fixtures/wires/shapes.csv");

fn fixtures() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../fixtures")
}

/// σ of a coordinate of a marker of the gripped cable \[m\].
pub const CABLE_SIGMA: f64 = 1e-3;

/// Constants that the recording of the gripped cable was made with, by their names in `[estimate]`.
pub const CABLE_CONSTANTS: [(&str, f64); 6] = [
    ("ei", 3e-3),
    ("gj", 3e-3),
    ("damping_stiffness", 0.02),
    ("damping_mass", 0.7),
    ("natural_curvature[0]", 2.0),
    ("natural_curvature[1]", 0.0),
];

/// Keys of a scene of it with priors 30 to 50 % off.
pub const CABLE_PRIORS: [&str; 10] = [
    "time.window=150",
    "model.section.ei=[4.2e-3,4.2e-3]",
    "model.section.gj=2e-3",
    "model.damping={stiffness=0.03,mass=1.05}",
    "model.natural_curvature=[1.2,0.0]",
    "estimate.ei={sigma=\"40%\",together=true}",
    "estimate.gj={sigma=\"50%\"}",
    "estimate.damping_stiffness={sigma=\"50%\"}",
    "estimate.damping_mass={sigma=\"50%\"}",
    "estimate.natural_curvature={sigma=0.8}",
];

/// Where the files of the gripped cable are.
pub fn gripped_cable_folder() -> PathBuf {
    fixtures().join("gripped-cable")
}

/// The cable between two grippers from a time of the recording on \[s\], with the constants that it was made
/// with and the odd markers assimilated.
pub fn gripped_cable(begin: f64) -> String {
    let marker = |i: usize| {
        let used = if i.is_multiple_of(2) { "withhold" } else { "assimilate" };
        format!("{{ name = \"m{i}\", arc_length = {}, use = \"{used}\" }}, ", i as f64 / 12.0)
    };
    let markers: String = (1..=11).map(marker).collect();
    let gripper = |file: &str| {
        format!(
            "motion = {{ kind = \"pose\", file = \"{file}\", time_zero = {begin}, sigma = 1e-4, \
             sigma_angle = 8.727e-4 }}"
        )
    };
    format!(
        r#"
[model]
kind = "rod"
length = 1.0
segments = 61
clamp = "face"
gravity = [0.0, 0.0, -9.81]
section = {{ kind = "stiffness", ea = 1e3, ei = [3e-3, 3e-3], gj = 3e-3, mass_per_length = 0.08 }}
natural_curvature = [2.0, 0.0]
damping = {{ stiffness = 0.02, mass = 0.7 }}
[model.start]
{}
[model.end]
{}
[time]
integrator = "bdf2"
step = 0.01
window = 50
[background]
from = "static-equilibrium"
[background.covariance]
kind = "kernel"
sigma_x = 0.03
sigma_v = 0.5
correlation_length_x = 0.2
correlation_length_v = 0.2
localization_length = 1.0
prior = "clamp"
[observations]
kind = "file"
file = "markers.csv"
sigma = {CABLE_SIGMA}
time_zero = {begin}
outside_window = "skip"
markers = [{markers}]
[report]
forecast = 0.5
"#,
        gripper("poses_a.csv"),
        gripper("poses_b.csv")
    )
}

/// A real wire at rest in one pose, of fixtures/wires.
pub struct Wire {
    /// The points p0 … p10, as `marker,x_m,y_m,z_m`.
    pub csv: String,
    /// The scene, which reads them from seen.csv.
    pub scene: String,
    /// EI that is listed for the wire \[N m²\].
    pub ei: f64,
}

impl Wire {
    /// The wire and the pose of this name, as "black 2": stiffness with a prior of 50 % about the value
    /// listed for it, directions of the clamps from the first and the last chord, known to 0.3 rad, and their
    /// places as seen; points 3 and 7 are kept back.
    pub fn of(pose: &str) -> Option<Wire> {
        let (wire, number) = pose.split_once(' ')?;
        let point = |line: &str| -> Option<[f64; 3]> {
            let mut cells = line.split(',');
            (cells.next()? == wire && cells.next()? == number).then_some(())?;
            let mut next = || cells.next()?.parse().ok();
            next()?;
            Some([next()?, next()?, next()?])
        };
        let points: Vec<[f64; 3]> = WIRES.lines().filter_map(point).collect();
        if points.len() != 11 {
            return None;
        }
        let (mass, ei, gj) = match wire {
            "white" => (0.087 / 5.0, 5.8e-5, 5.6e-5),
            "black" => (0.079 / 2.98, 1e-3, 1.1e-3),
            _ => (0.043 / 2.0, 6.4e-4, 1.2e-3),
        };
        let chord = |a: usize, b: usize| std::array::from_fn::<f64, 3, _>(|c| points[b][c] - points[a][c]);
        // across the chord, as upright as it can be
        let across = |t: [f64; 3]| {
            let square: f64 = t.iter().map(|t| t * t).sum();
            std::array::from_fn::<f64, 3, _>(|c| f64::from(u8::from(c == 2)) - t[2] * t[c] / square)
        };
        let mut csv = "marker,x_m,y_m,z_m\n".to_string();
        let mut markers = String::new();
        for (i, [x, y, z]) in points.iter().enumerate() {
            csv += &format!("p{i},{x},{y},{z}\n");
            let used = if i == 3 || i == 7 { "withhold" } else { "assimilate" };
            markers += &format!("{{ name = \"p{i}\", arc_length = {}, use = \"{used}\" }},", 0.04 * i as f64);
        }
        let [first, last] = [chord(0, 1), chord(9, 10)];
        let clamp = |at: usize, t: [f64; 3]| {
            format!("{{ position = {:?}, tangent = {t:?}, director = {:?} }}", points[at], across(t))
        };
        let scene = format!(
            r#"
[model]
kind = "rod"
length = 0.4
segments = 40
gravity = [0.0, 0.0, -9.81]
section = {{ kind = "stiffness", ea = 1e3, ei = [{ei}, {ei}], gj = {gj}, mass_per_length = {mass} }}
start = {}
end = {}
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.004
markers = [{markers}]
[estimate]
ei = {{ sigma = "50%", together = true }}
# directions are read off two points; how the grippers are turned about the wire was not recorded
clamp_direction = [
    {{ sigma = 0.3 }}, {{ sigma = 0.3 }}, {{ sigma = 1.5 }},
    {{ sigma = 0.3 }}, {{ sigma = 0.3 }}, {{ sigma = 1.5 }},
]
support_position = {{ sigma = 0.004 }}
[algorithm]
method = "static"
"#,
            clamp(0, first),
            clamp(10, last)
        );
        Some(Wire { csv, scene, ei })
    }
}
