//! What a sensor on a rod measures, and on which of its edges and vertices.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::Error;
use crate::rod::Place;
use crate::system::System;

/// What a sensor measures, and where: rest arc lengths s in m.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Sensor {
    /// The tension N of the edge at s \[N\], positive where the rod is pulled: one value, that of the
    /// middle of the edge. An edge that a clamp holds has what the clamp takes.
    Tension {
        /// Its place \[m\].
        s: f64,
    },
    /// The force that a support exerts on the rod \[N\], in space: three values.
    SupportForce {
        /// The held place: that of a clamp, or of a prescribed vertex \[m\].
        s: f64,
    },
    /// The same along the unit tangent of a clamp, which points towards greater s: one value.
    AxialSupportForce {
        /// The place of the clamp \[m\].
        s: f64,
    },
    /// The acceleration of a point of the centreline in space [m/s²]: three values.
    Acceleration {
        /// Its place \[m\].
        s: f64,
    },
    /// What an accelerometer fixed to a section reads, f = Aᵀ(a − g) \[m/s²\]: three values along its axes,
    /// 9.81 upwards at rest.
    SpecificForce {
        /// Its place \[m\].
        s: f64,
        /// Its axes along (m₁, m₂, t) of the edge: a row for each.
        axes: Matrix3<f64>,
    },
    /// The angular rate of a section across its tangent \[rad/s\], along m₁ and m₂: two values.
    AngularRate {
        /// Its place \[m\].
        s: f64,
    },
    /// The angular rate of a section about its tangent \[rad/s\], of a rod with inertia against it: one value.
    Spin {
        /// Its place \[m\].
        s: f64,
    },
}

impl Sensor {
    /// Number of its values.
    pub fn rows(&self) -> usize {
        match self {
            Sensor::Tension { .. } | Sensor::AxialSupportForce { .. } | Sensor::Spin { .. } => 1,
            Sensor::AngularRate { .. } => 2,
            Sensor::SupportForce { .. } | Sensor::Acceleration { .. } | Sensor::SpecificForce { .. } => 3,
        }
    }
}

/// A sum over vertices, sign·(∂E/∂x_v − F_v) without loads where it is not `loaded`.
#[derive(Clone)]
pub(crate) struct Sum {
    pub(crate) vertices: Range<usize>,
    pub(crate) sign: f64,
    pub(crate) loaded: bool,
}

/// A sensor on its edges and vertices.
pub(crate) enum Placed {
    /// A force in space.
    Force(Sum),
    /// A force along the tangent of an edge.
    Along(Sum, usize),
    /// The acceleration of a place.
    Acceleration(Place),
    /// The same less gravity, along axes of the section.
    SpecificForce(Place, Matrix3<f64>),
    /// How fast the tangent of an edge turns, along m₁ and m₂.
    AngularRate(usize),
    /// A number of the state.
    Spin(usize),
}

impl Placed {
    pub(crate) fn rows(&self) -> usize {
        match self {
            Placed::Along(..) | Placed::Spin(_) => 1,
            Placed::AngularRate(_) => 2,
            Placed::Force(_) | Placed::Acceleration(_) | Placed::SpecificForce(..) => 3,
        }
    }
}

/// A row: its sensor, and its direction in space or, of a sensor on a section, along (m₁, m₂, t).
pub(crate) struct Row<'a> {
    pub(crate) sensor: &'a Placed,
    pub(crate) direction: Vector3<f64>,
}


