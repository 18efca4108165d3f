//! What a sensor on a rod measures, and on which of its edges and vertices.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::Error;
use crate::read_rotations::ReadRotations;
use crate::rod::Place;
use crate::system::System;

/// What a sensor measures, and where: rest arc lengths s in m. What it reads in a state is that of
/// [`Sensors`](crate::Sensors).
///
/// ```
/// use varda_rod::{Matrix3, Sensor};
///
/// // an accelerometer whose first axis points along the rod: a row for each axis, along (m₁, m₂, t)
/// let axes = Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
/// let imu = Sensor::SpecificForce { s: 0.45, axes };
/// assert_eq!((imu.rows(), Sensor::Tension { s: 0.1 }.rows()), (3, 1));
/// ```
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
    /// The moment that a clamp exerts on the rod about its place \[N m\], in space: three values.
    SupportMoment {
        /// The place of the clamp \[m\].
        s: f64,
    },
    /// The moments M₁, M₂ that bend the rod as κ₁ and κ₂, and T that twists it \[N m\]: three
    /// values, between two bent vertices on the straight line through theirs.
    Moment {
        /// Its place \[m\].
        s: f64,
    },
    /// The acceleration of a point of the centreline in space [m/s²]: three values.
    Acceleration {
        /// Its place \[m\].
        s: f64,
    },
    /// What an accelerometer fixed to a section reads, f = Aᵀ(a − g) \[m/s²\]: three values along its
    /// axes, 9.81 upwards at rest.
    SpecificForce {
        /// Its place \[m\].
        s: f64,
        /// Its axes along (m₁, m₂, t) of the edge: a row for each.
        axes: Matrix3<f64>,
    },
    /// The direction of the rod at s, from one that was read: two angles \[rad\].
    Direction {
        /// Its place \[m\].
        s: f64,
    },
    /// The orientation of a body fixed to a section, from one that was read: a rotation vector along its
    /// axes, three angles \[rad\].
    Orientation {
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
    /// The angular rate of a section about its tangent \[rad/s\], of a rod with inertia against it: one
    /// value.
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
            Sensor::AngularRate { .. } | Sensor::Direction { .. } => 2,
            Sensor::SupportForce { .. }
            | Sensor::SupportMoment { .. }
            | Sensor::Moment { .. }
            | Sensor::Acceleration { .. }
            | Sensor::SpecificForce { .. }
            | Sensor::Orientation { .. } => 3,
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
    /// The moment of a clamp about a vertex, the one beside it and its edge.
    ClampMoment([usize; 3]),
    /// Moments of bent vertices, each with its share.
    Moment(Vec<(usize, f64)>),
    /// The acceleration of a place.
    Acceleration(Place),
    /// The same less gravity, along axes of the section.
    SpecificForce(Place, Matrix3<f64>),
    /// The tangent of an edge from what was read.
    Direction(usize, ReadRotations),
    /// What is fixed to an edge from what was read.
    Orientation(usize, Matrix3<f64>, ReadRotations),
    /// How fast the tangent of an edge turns, along m₁ and m₂.
    AngularRate(usize),
    /// A number of the state.
    Spin(usize),
}

impl Placed {
    pub(crate) fn rows(&self) -> usize {
        match self {
            Placed::Along(..) | Placed::Spin(_) => 1,
            Placed::AngularRate(_) | Placed::Direction(..) => 2,
            Placed::Force(_)
            | Placed::ClampMoment(_)
            | Placed::Moment(_)
            | Placed::Acceleration(_)
            | Placed::SpecificForce(..)
            | Placed::Orientation(..) => 3,
        }
    }
}

/// A row: its sensor, which of its rows it is, and its direction in space or, of a sensor on a section,
/// along (m₁, m₂, t).
pub(crate) struct Row<'a> {
    pub(crate) sensor: &'a Placed,
    pub(crate) index: usize,
    pub(crate) direction: Vector3<f64>,
}

/// A sensor on the edges and vertices of a rod.
pub(crate) fn placed(system: &System, sensor: &Sensor) -> Result<Placed, Error> {
    let (rod, supports, n) = (&system.rod, &system.supports, system.rod.segments());
    let clamps = [
        supports.start.as_ref().map(|_| (0.0, 0..2, 0)),
        supports.end.as_ref().map(|_| (rod.length(), n - 1..n + 1, n - 1)),
    ];
    let is_at = |place: f64, s: f64| (place - s).abs() <= 1e-6 * rod.length();
    let clamp = |s: f64| clamps.iter().flatten().find(|(place, ..)| is_at(*place, s));
    Ok(match *sensor {
        Sensor::Tension { s } => {
            let e = rod.place("tension", s)?.edge;
            let held = clamps.iter().flatten().find(|(.., edge)| *edge == e);
            let sum = match held {
                // an edge that a clamp holds carries what the clamp takes
                Some((place, vertices, _)) => {
                    let sign = if *place == 0.0 { -1.0 } else { 1.0 };
                    Sum { vertices: vertices.clone(), sign, loaded: true }
                }
                None => Sum { vertices: 0..e + 1, sign: -1.0, loaded: false },
            };
            Placed::Along(sum, e)
        }
        Sensor::SupportForce { s } => {
            rod.place("support force", s)?;
            let arc_lengths = rod.arc_lengths();
            let at_vertex = |(vertex, _): &&(usize, _)| is_at(arc_lengths[*vertex], s);
            let vertices = match (clamp(s), supports.prescribed.iter().find(at_vertex)) {
                (Some((_, vertices, _)), _) => vertices.clone(),
                (None, Some((vertex, _))) => *vertex..vertex + 1,
                (None, None) => return Err(Error::NotHeld { s, what: "support" }),
            };
            Placed::Force(Sum { vertices, sign: 1.0, loaded: true })
        }
        Sensor::AxialSupportForce { s } => {
            rod.place("support force", s)?;
            let (_, vertices, edge) = clamp(s).ok_or(Error::NotHeld { s, what: "clamp" })?;
            Placed::Along(Sum { vertices: vertices.clone(), sign: 1.0, loaded: true }, *edge)
        }
        Sensor::SupportMoment { s } => {
            rod.place("support moment", s)?;
            let (.., edge) = clamp(s).ok_or(Error::NotHeld { s, what: "clamp" })?;
            Placed::ClampMoment(if *edge == 0 { [0, 1, 0] } else { [n, n - 1, *edge] })
        }
        Sensor::Moment { s } => {
            let Place { edge, fraction } = with_sections(system, rod.place("moment", s)?)?;
            let shares = [(edge, 1.0 - fraction), (edge + 1, fraction)];
            let shares: Vec<_> = shares.into_iter().filter(|(_, share)| *share > 1e-9).collect();
            if shares.iter().any(|(vertex, _)| *vertex == 0 || *vertex == n) {
                let arc_lengths = rod.arc_lengths();
                return Err(Error::NoMoment { s, from: arc_lengths[1], to: arc_lengths[n - 1] });
            }
            Placed::Moment(shares)
        }
        Sensor::Acceleration { s } => Placed::Acceleration(rod.place("acceleration", s)?),
        Sensor::SpecificForce { s, axes } => {
            check_axes(&axes)?;
            Placed::SpecificForce(with_sections(system, rod.place("specific force", s)?)?, axes)
        }
        Sensor::Direction { s } => {
            Placed::Direction(rod.place("direction", s)?.edge, ReadRotations::default())
        }
        Sensor::Orientation { s, axes } => {
            check_axes(&axes)?;
            let e = rod.place("orientation", s)?.edge;
            let held = supports.start.is_some() || supports.end.is_some();
            if !(system.layout.twist || system.layout.bending && held) {
                return Err(Error::NoAngle);
            }
            Placed::Orientation(e, axes, ReadRotations::default())
        }
        Sensor::AngularRate { s } => {
            Placed::AngularRate(with_sections(system, rod.place("angular rate", s)?)?.edge)
        }
        Sensor::Spin { s } => {
            let edge = rod.place("spin", s)?.edge;
            let layout = &system.layout;
            match layout.free_angles.binary_search(&edge) {
                Ok(i) if layout.spins => Placed::Spin(layout.first_spin() + i),
                _ => return Err(Error::NoSpin { edge }),
            }
        }
    })
}

fn check_axes(axes: &Matrix3<f64>) -> Result<(), Error> {
    let skew = (axes.tr_mul(axes) - Matrix3::identity()).abs().max();
    if !(skew <= 1e-3 && axes.determinant() > 0.0) {
        let expected = "a rotation: RᵀR = I, det R > 0";
        return Err(Error::Value { field: "axes of a sensor", value: skew, expected });
    }
    Ok(())
}

/// A place of a rod whose sections are known.
fn with_sections(system: &System, place: Place) -> Result<Place, Error> {
    match system.layout.bending {
        true => Ok(place),
        false => Err(Error::NoFrames),
    }
}
