//! A scene on a finer mesh.

use crate::scene::{Model, SceneFile};

/// The scene with twice the segments, where its constants are estimated from a recording: a twin has the same
/// mesh in truth and model. Without posterior and forecast.
pub(crate) fn finer(file: &SceneFile) -> Option<SceneFile> {
    let mut file = file.clone();
    let scene = &mut file.scene;
    let Model::Rod(rod) = &mut scene.model else { return None };
    let wanted = scene.report.mesh && !scene.estimate.given().is_empty() && scene.algorithm.cycles.is_none();
    if !wanted || !scene.algorithm.method.is_strong() {
        return None;
    }
    // a vertex beside a clamp's face is not at the same place in both meshes
    if !rod.prescribed.is_empty() && rod.faces() != [false; 2] {
        return None;
    }
    match (&mut rod.segments, &mut rod.segment_lengths) {
        (Some(segments), _) => *segments *= 2,
        (None, Some(lengths)) => *lengths = lengths.iter().flat_map(|l| [0.5 * l; 2]).collect(),
        (None, None) => return None,
    }
    // a vertex keeps its place
    rod.prescribed.iter_mut().for_each(|p| p.vertex *= 2);
    scene.report.mesh = false;
    scene.report.posterior = false;
    scene.report.forecast = 0.0;
    Some(file)
}
