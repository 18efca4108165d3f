//! A forward run.

use super::{Experiment, Shapes, Trajectories, WorkCounts};

/// A forward run over the window and its forecast.
#[derive(Debug)]
pub struct Simulation {
    /// What was run.
    pub experiment: Experiment,
    /// Where the run started: "truth" or "background".
    pub of: &'static str,
    /// Its states, in the place of an analysis.
    pub trajectories: Trajectories,
    /// Its vertices, for models in space.
    pub shapes: Option<Shapes>,
    /// Steps taken.
    pub steps: usize,
    /// Work of the model.
    pub counts: WorkCounts,
    /// For a twin experiment in space: the files from which its problem can be read again.
    pub twin: Option<TwinFiles>,
    /// Remarks for the user.
    pub warnings: Vec<String>,
}

impl Simulation {
    /// The last vertex at the end of the run \[m\]: the free end of a hanging rod.
    pub fn tip(&self) -> Option<[f64; 3]> {
        self.shapes.as_ref()?.analysis.last()?.last().copied()
    }
}

/// What a twin experiment drew.
#[derive(Debug)]
pub struct TwinFiles {
    /// x_b, in the control.
    pub background: Vec<f64>,
    /// The angle of the end clamp at its start \[rad\], whole turns included, where it is part of the state.
    pub end_angle: Option<f64>,
    /// What cameras saw.
    pub pixels: Vec<PixelSight>,
}

/// A point of a rod in the image of a camera at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct PixelSight {
    /// Model time \[s\].
    pub time: f64,
    /// The camera.
    pub camera: String,
    /// Arc length of the point \[m\].
    pub arc_length: f64,
    /// u and v \[px\].
    pub pixel: [f64; 2],
    /// Their standard deviation \[px\].
    pub sigma: f64,
}
