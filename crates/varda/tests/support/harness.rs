//! What is done with bytes from outside: every reader of a scene and of its files, up to a problem ready to
//! run where that is small. Shared by the property tests and the fuzz targets: none of these may panic.

use varda::scene::{Covariance, SceneFile};
use varda::setup::Plan;
use varda::setup::Problem;
use varda::setup::csv;

/// Bytes as a scene: parsed, validated, planned, and built where it takes little. True where it came to a
/// problem.
pub(crate) fn scene(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let Ok(file) = SceneFile::parse("fuzz", "fuzz.toml", text, None, &[]) else { return false };
    // Sizes are counted before anything is built, and an error is an answer.
    small(&file) && Plan::new(&file).is_ok_and(|plan| plan.n_obs < 1000) && Problem::from_scene(&file).is_ok()
}

/// Whether a scene is built in milliseconds.
fn small(file: &SceneFile) -> bool {
    let scene = &file.scene;
    let segments = match &scene.model {
        varda::scene::Model::Rod(rod) => {
            rod.segments.unwrap_or(0).max(rod.segment_lengths.as_ref().map_or(0, Vec::len))
        }
        model => model.components().unwrap_or(0),
    };
    let steps = scene.time.window + scene.time.spin_up;
    let run = match &scene.background.covariance {
        Covariance::Climatology(c) => c.steps,
        _ => 0,
    };
    let members = scene.algorithm.members().map_or(0, |e| e.members);
    let windows = scene.algorithm.cycles.as_ref().map_or(1, |c| c.count);
    let Ok(grid) = file.grid() else { return false };
    let forecast = scene.report.forecast / grid.step;
    segments <= 50
        && steps.saturating_mul(windows) <= 100
        && run <= 2000
        && members <= 100
        && forecast <= 100.0
}

/// Bytes as a CSV file of observations, of a background, of a motion.
pub(crate) fn csv(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    let finite = |x: &f64| x.is_finite();
    if let Ok(rows) = csv::observations("fuzz.csv", text) {
        assert!(rows.iter().all(|r| r.time.is_finite() && r.position.iter().flatten().all(finite)));
        assert!(rows.iter().all(|r| r.line <= text.len()), "more lines than bytes");
    }
    let background = ["vertex", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s"];
    if let Ok(rows) = csv::numbers("fuzz.csv", text, background) {
        assert!(rows.iter().flatten().all(finite));
    }
    let _ = csv::numbers("fuzz.csv", text, ["time_s", "x_m", "y_m", "z_m"]);
    let _ = csv::numbers("fuzz.csv", text, ["component", "value"]);
}
