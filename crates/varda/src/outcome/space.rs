//! Runs and observations of a curve in space.

use varda_rod::{Curvature, InternalForces};

/// Vertices \[m\] at every step of the runs of a curve; a run that ended early has fewer steps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Shapes {
    /// From x_b.
    pub background: Vec<Vec<[f64; 3]>>,
    /// From x_a.
    pub analysis: Vec<Vec<[f64; 3]>>,
    /// The truth, or nothing.
    pub truth: Vec<Vec<[f64; 3]>>,
    /// What was seen whole, in the model's axes.
    pub seen: Vec<Sight>,
    /// One marker followed through all runs.
    pub track: Option<Track>,
    /// Forces and moments within the rod of the analysis, from step 1 on: rates are those over a step.
    pub forces: Vec<InternalForces>,
    /// Curvature and rate of twist of the analysis, from step 0 on; none of a step at which the rod is
    /// folded.
    pub curvature: Vec<Option<Curvature>>,
    /// Standard deviations of the forces, where there is a posterior.
    pub sigma_forces: Vec<InternalForces>,
}

/// A marker or place seen at one time.
#[derive(Debug, Clone, PartialEq)]
pub struct Sight {
    /// Index of the site.
    pub site: usize,
    /// Arc length of the site \[m\].
    pub arc_length: f64,
    /// Whether it was kept back from the assimilation.
    pub withheld: bool,
    /// Step k of the window; may lie after its end, in the forecast.
    pub step: usize,
    /// Fraction of the way to step k + 1, in [0, 1).
    pub weight: f64,
    /// Place in the model's axes \[m\].
    pub position: [f64; 3],
    /// Standard deviation of a coordinate \[m\].
    pub sigma: f64,
}

impl Sight {
    /// Time within the window, in steps.
    pub fn at(&self) -> f64 {
        self.step as f64 + self.weight
    }
}

/// A marker in all runs, step by step \[m\].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Track {
    /// The marker.
    pub label: String,
    /// Index of its site.
    pub site: usize,
    /// Whether it was kept back.
    pub withheld: bool,
    /// From x_b.
    pub background: Vec<[f64; 3]>,
    /// From x_a.
    pub analysis: Vec<[f64; 3]>,
    /// The truth, or nothing.
    pub truth: Vec<[f64; 3]>,
}
