//! A forward run.

use serde::Serialize;

use super::{Experiment, Quantity, Shapes, Trajectories, WorkCounts};

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
    /// How far it is from a recording, marker by marker; empty without a recording.
    pub distances: Vec<Distance>,
    /// Remarks for the user.
    pub warnings: Vec<String>,
}

/// How far a forward run is from what a recording saw of a marker, a place or a component.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Distance {
    /// The marker, place or component.
    pub label: String,
    /// How often it was seen.
    pub count: usize,
    /// What its values are.
    pub quantity: Quantity,
    /// Root mean square of the distance, in the unit of the values.
    pub rms: f64,
}

impl Simulation {
    /// Root mean square of the distance from a recording over all that was seen, in the unit of the values;
    /// `None` without a recording, or where places and pixels have none in common.
    pub fn rms_distance(&self) -> Option<f64> {
        let count: usize = self.distances.iter().map(|d| d.count).sum();
        let squares: f64 = self.distances.iter().map(|d| d.count as f64 * d.rms * d.rms).sum();
        let alike = self.distances.windows(2).all(|d| d[0].quantity == d[1].quantity);
        (count > 0 && alike).then(|| (squares / count as f64).sqrt())
    }

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
    /// What sensors read.
    pub readings: Vec<Reading>,
}

/// What a sensor read at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// Model time \[s\].
    pub time: f64,
    /// The sensor.
    pub sensor: String,
    /// The columns of its values.
    pub columns: &'static [&'static str],
    /// A value for each; `None` was not read.
    pub values: Vec<Option<f64>>,
    /// Their standard deviation, in their unit.
    pub sigma: f64,
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
