//! Why an analysis does not fit.

use serde::Serialize;

/// What departures that are larger than their σ tell of their cause.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Evidence {
    /// The likely cause.
    pub cause: Cause,
    /// The same in words, with its numbers.
    pub text: String,
    /// Correlation of departures from one time to the next.
    pub in_time: f64,
    /// Correlation of departures of neighbouring markers; 0 for models that are not in space.
    pub along_the_rod: f64,
    /// Mean of (d/σ)².
    pub mean_square: f64,
}

/// A cause of departures that are larger than their σ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// σ of the observations is too small.
    Sigma,
    /// One marker is a constant off.
    BiasedMarker,
    /// One marker is noisier than assumed.
    NoisyMarker,
    /// One marker is not where, or not which, it is said to be.
    MisplacedMarker,
    /// The recording's clock is off.
    Clock,
    /// The recording's axes are turned.
    Frame,
    /// The rod hangs in another shape: rest shape, stiffness, mass, mesh.
    RestShape,
    /// The rod swings at another rate: stiffness, mass.
    Stiffness,
    /// The rod loses energy at another rate.
    Damping,
    /// A model that is not in space does not describe what was seen.
    Model,
}
