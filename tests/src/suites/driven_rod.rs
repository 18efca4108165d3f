//! A rod whose base is driven: a scene of its twin, and of a recording.

/// A rod clamped level, its clamp driven around an ellipse, seen at four places.
pub(super) const DRIVEN_ROD: &str = r#"
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
tangent = [1.0, 0.0, 0.0]
director = [0.0, 1.0, 0.0]
motion = { kind = "ellipse", radii = [0.03, 0.02], omega = 8.0, ramp_periods = 1.0 }
[time]
integrator = "bdf2"
step = 0.01
spin_up = 150
window = 100
[background.covariance]
kind = "kernel"
sigma_x = 0.03
sigma_v = 0.3
correlation_length_x = 0.25
correlation_length_v = 0.25
localization_length = 0.5
prior = "clamp"
"#;

/// Background and observations of its twin: four places every 0.02 s.
pub(super) const TWIN: &str = r#"
[background]
from = "truth-plus-draw"
[observations]
kind = "synthetic"
places = [0.125, 0.25, 0.375, 0.5]
every = 2
sigma = 0.002
"#;

/// Background and observations of a recording of it.
pub(super) const RECORDING: &str = r#"
[background]
from = "static-equilibrium"
[observations]
kind = "file"
file = "seen.csv"
sigma = 0.002
outside_window = "skip"
"#;
