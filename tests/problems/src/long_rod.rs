//! A rod of many segments as a scene: a Krylov minimizer and a posterior of low rank.

/// The scene, to be parsed with [`segments`]. A step of two milliseconds is what 20 000 segments of this rod
/// need: at ten, Newton's method fails on edges of 25 µm.
pub const SCENE: &str = r#"
title = "A rod of many segments"
seed = 0

[model]
kind = "rod"
length = 0.5
segments = 20
gravity = [0.0, 0.0, -9.81]
section = { kind = "circle", radius = 0.005 }
material = { youngs_modulus = 1e6, poisson_ratio = 0.5, density = 1100.0 }

[model.start]
position = [0.0, 0.0, 0.0]
tangent = [0.0, 0.0, -1.0]
director = [1.0, 0.0, 0.0]
motion = { kind = "ellipse", radii = [0.05, 0.03], omega = 9.0, ramp_periods = 1.0 }

[time]
integrator = "bdf2"
step = 0.002
spin_up = 5
window = 10

[background]
from = "truth-plus-draw"

[background.covariance]
kind = "kernel"
sigma_x = 0.001
sigma_v = 0.02
correlation_length_x = 0.125
correlation_length_v = 0.125
prior = "clamp"

[observations]
kind = "synthetic"
places = [0.25, 0.5]
every = 5
sigma = 0.0005

[algorithm]
method = "4dvar"
minimizer = "gauss-newton-cg"
max_iterations = 50
gradient_tolerance = 1e-4
"#;

/// What makes it one of so many segments.
pub fn segments(count: usize) -> [String; 1] {
    [format!("model.segments={count}")]
}

/// The slope of log y against log x, by least squares.
pub fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs = || points.iter().map(|(x, y)| (x.ln(), y.ln()));
    let [x, y] = [logs().map(|p| p.0).sum::<f64>() / n, logs().map(|p| p.1).sum::<f64>() / n];
    let [xy, xx] =
        [logs().map(|p| (p.0 - x) * (p.1 - y)).sum::<f64>(), logs().map(|p| (p.0 - x).powi(2)).sum::<f64>()];
    xy / xx
}
