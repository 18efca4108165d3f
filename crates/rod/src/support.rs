//! What holds the rod and what pulls at it.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::load::Load;
use crate::{Error, Rod};

/// A vector that depends on time: the place of a vertex \[m\], a direction, a force \[N\].
///
/// Constant vectors and arrays are motions, and so are closures that return either: `|t| [x, y, z]`.
///
/// ```
/// use varda_rod::{Motion, Vector3};
///
/// let swinging = |t: f64| [0.1 * (2.0 * t).sin(), 0.0, 0.0];
/// assert_eq!(swinging.at(0.0), Vector3::zeros());
/// assert_eq!(Vector3::z().at(5.0), [0.0, 0.0, 1.0].at(7.0)); // constants are motions too
/// ```
pub trait Motion: Send + Sync {
    /// Its value at time t \[s\].
    fn at(&self, t: f64) -> Vector3<f64>;
}

impl Motion for Vector3<f64> {
    fn at(&self, _t: f64) -> Vector3<f64> {
        *self
    }
}

impl Motion for [f64; 3] {
    fn at(&self, _t: f64) -> Vector3<f64> {
        (*self).into()
    }
}

impl<V: Into<Vector3<f64>>, F: Fn(f64) -> V + Send + Sync> Motion for F {
    fn at(&self, t: f64) -> Vector3<f64> {
        self(t).into()
    }
}

/// The paper's drive: an ellipse in the xy plane, faded in by a quintic ramp.
///
/// ```text
/// x(t) = c + a(u) (r_x cos(ωt + φ), r_y sin(ωt + φ), 0)
/// a = u³ (10 − 15u + 6u²),   u = min(1, t / T_ramp)
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseDrive {
    /// Centre c \[m\].
    pub centre: Vector3<f64>,
    /// Semi-axes r_x, r_y \[m\].
    pub radii: [f64; 2],
    /// Angular frequency ω [rad/s].
    pub omega: f64,
    /// Phase φ \[rad\]; 0 in the paper.
    pub phase: f64,
    /// Duration of the ramp \[s\]; 0 for none.
    pub ramp: f64,
}

impl Motion for EllipseDrive {
    fn at(&self, t: f64) -> Vector3<f64> {
        let (a, (sin, cos)) = (self.faded_in(t), (self.omega * t + self.phase).sin_cos());
        self.centre + Vector3::new(a * self.radii[0] * cos, a * self.radii[1] * sin, 0.0)
    }
}

impl EllipseDrive {
    /// a(t).
    fn faded_in(&self, t: f64) -> f64 {
        let u = if self.ramp > 0.0 { (t / self.ramp).clamp(0.0, 1.0) } else { 1.0 };
        u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
    }

    /// What changes of its semi-axes and phase do to its place at time t.
    pub(crate) fn rate_by(&self, radii: [f64; 2], phase: f64, t: f64) -> Vector3<f64> {
        let (a, (sin, cos)) = (self.faded_in(t), (self.omega * t + self.phase).sin_cos());
        let [rx, ry] = self.radii;
        Vector3::new(a * (radii[0] * cos - rx * phase * sin), a * (radii[1] * sin + ry * phase * cos), 0.0)
    }

    /// What two such changes do together.
    pub(crate) fn second_by(&self, radii: [[f64; 2]; 2], phases: [f64; 2], t: f64) -> Vector3<f64> {
        let (a, (sin, cos)) = (self.faded_in(t), (self.omega * t + self.phase).sin_cos());
        let ([rx, ry], both) = (self.radii, phases[0] * phases[1]);
        let mixed = |c: usize| radii[0][c] * phases[1] + radii[1][c] * phases[0];
        Vector3::new(-a * (mixed(0) * sin + rx * both * cos), a * (mixed(1) * cos - ry * both * sin), 0.0)
    }
}

/// What of a rod a clamp holds: of which section its `position` is the place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClampAt {
    /// The section at the clamp's face, s = 0 (s = L at the end of the rod). The edge that the clamp holds
    /// has its middle there: the first rest length is the half of it that stands out, and the rod bends from
    /// the face on. Deflections and frequencies are of second order in the mesh.
    Face,
    /// The end vertex. The clamp holds the first edge from vertex to vertex, as in the paper: a rod that
    /// bends as if it were half a segment shorter, an error of first order.
    Edge,
}

/// A clamped end: it prescribes the end of the rod, the direction of the held edge (at its rest length) and
/// the direction m₁ of the section there, all as functions of time. Directions need not be normalized, nor
/// m₁ exactly perpendicular.
///
/// ```
/// use varda_rod::{Clamp, ClampAt, Vector3};
///
/// // Hanging down from a face that moves sideways, its section not turning.
/// let moved = |t: f64| [0.1 * t * t, 0.0, 0.0];
/// let clamp = Clamp::new(ClampAt::Face, moved, -Vector3::z(), Vector3::x());
/// assert_eq!(clamp.position.at(2.0), Vector3::new(0.4, 0.0, 0.0));
/// ```
#[derive(Clone)]
pub struct Clamp {
    /// What `position` is the place of.
    pub at: ClampAt,
    /// Place of the face, or of the end vertex \[m\].
    pub position: Arc<dyn Motion>,
    /// Direction of the held edge, towards growing arc length.
    pub tangent: Arc<dyn Motion>,
    /// Direction m₁ of the section, before `turns`.
    pub director: Arc<dyn Motion>,
    /// Turns of the director about the tangent as a function of time \[–\]: m₁ is turned by 2π times as
    /// much, and whole turns between the two ends of a rod are its twist. Absent: none.
    pub turns: Option<Arc<dyn Fn(f64) -> f64 + Send + Sync>>,
}

impl Clamp {
    /// A clamp of these motions; constant vectors are motions too.
    pub fn new(
        at: ClampAt,
        position: impl Motion + 'static,
        tangent: impl Motion + 'static,
        director: impl Motion + 'static,
    ) -> Clamp {
        let (position, tangent, director) = (Arc::new(position), Arc::new(tangent), Arc::new(director));
        Clamp { at, position, tangent, director, turns: None }
    }

    /// The same, turned about its tangent as a function of time; right-handed.
    ///
    /// ```
    /// use varda_rod::{Clamp, ClampAt, Vector3};
    ///
    /// // three turns within two seconds
    /// let clamp = Clamp::new(ClampAt::Face, [0.0; 3], Vector3::x(), Vector3::z());
    /// let clamp = clamp.with_turns(|t: f64| 3.0 * (t / 2.0).clamp(0.0, 1.0));
    /// assert_eq!(clamp.turns_at(1.0), 1.5);
    /// ```
    #[must_use]
    pub fn with_turns(mut self, turns: impl Fn(f64) -> f64 + Send + Sync + 'static) -> Clamp {
        self.turns = Some(Arc::new(turns));
        self
    }

    /// Its turns at time t \[s\]; zero where it has none.
    pub fn turns_at(&self, t: f64) -> f64 {
        self.turns.as_ref().map_or(0.0, |turns| turns(t))
    }
}

/// All supports of a rod.
///
/// ```
/// use std::sync::Arc;
/// use varda_rod::{Clamp, ClampAt, Supports, Vector3};
///
/// // Clamped at its start, vertex 10 held at a hook.
/// let clamp = Clamp::new(ClampAt::Edge, [0.0; 3], Vector3::x(), Vector3::z());
/// let mut supports = Supports::clamped_start(clamp);
/// supports.prescribed.push((10, Arc::new([0.9, 0.0, -0.1])));
/// assert!(supports.end.is_none());
/// ```
#[derive(Clone)]
pub struct Supports {
    /// Clamp at arc length 0.
    pub start: Option<Clamp>,
    /// Clamp at arc length L.
    pub end: Option<Clamp>,
    /// Further vertices whose place is given as a function of time (a pinned end, a hook).
    pub prescribed: Vec<(usize, Arc<dyn Motion>)>,
    /// Frame of the first edge where no clamp gives it: a tangent and a director d₁, carried from that
    /// tangent to the first edge by parallel transport. The first edge may point anywhere but against the
    /// tangent; a tangent against which the prescribed vertices lie at time 0 is turned round.
    pub free_frame: (Vector3<f64>, Vector3<f64>),
}

impl Default for Supports {
    fn default() -> Supports {
        Supports { start: None, end: None, prescribed: Vec::new(), free_frame: (Vector3::x(), Vector3::y()) }
    }
}

impl Supports {
    /// Clamped at its start, free elsewhere.
    pub fn clamped_start(clamp: Clamp) -> Supports {
        Supports { start: Some(clamp), ..Supports::default() }
    }

    /// Whether a clamp holds the rod at its face, at the start and at the end.
    pub fn faces(&self) -> [bool; 2] {
        [&self.start, &self.end].map(|c| c.as_ref().is_some_and(|c| c.at == ClampAt::Face))
    }

    /// Turns \[–\] of the end clamp beyond those of the start clamp at time t \[s\].
    pub fn turns_at(&self, t: f64) -> f64 {
        let of = |clamp: &Option<Clamp>| clamp.as_ref().map_or(0.0, |clamp| clamp.turns_at(t));
        of(&self.end) - of(&self.start)
    }

    /// Whether the rod leads from its first to its last prescribed vertex against a direction, as they are at
    /// time 0: no frame can be carried from there to a first edge that points so.
    pub(crate) fn runs_against(&self, direction: &Vector3<f64>) -> bool {
        let first = self.prescribed.iter().min_by_key(|p| p.0);
        let last = self.prescribed.iter().max_by_key(|p| p.0);
        let (Some(first), Some(last)) = (first, last) else { return false };
        let chord = last.1.at(0.0) - first.1.at(0.0);
        chord.dot(direction) < -0.5 * chord.norm() * direction.norm()
    }

    /// Vertices whose place is prescribed, ascending.
    ///
    /// # Errors
    /// [`Error::Support`] where two supports claim a vertex or it does not exist.
    pub(crate) fn prescribed_vertices(&self, rod: &Rod) -> Result<Vec<usize>, Error> {
        let n = rod.segments();
        if self.start.is_some() && self.end.is_some() && n < 3 {
            return Err(Error::Value {
                field: "segments of a rod between two clamps",
                value: n as f64,
                expected: "at least 3: each clamp holds one",
            });
        }
        let mut all: Vec<usize> = self.prescribed.iter().map(|p| p.0).collect();
        if self.start.is_some() {
            all.extend([0, 1]);
        }
        if self.end.is_some() {
            all.extend([n - 1, n]);
        }
        all.sort_unstable();
        if let Some(&vertex) = all.iter().find(|&&v| v > n) {
            return Err(Error::Support { vertex, reason: "the rod has no such vertex" });
        }
        if let Some(pair) = all.windows(2).find(|w| w[0] == w[1]) {
            return Err(Error::Support { vertex: pair[0], reason: "two supports prescribe it" });
        }
        Ok(all)
    }
}

/// External forces on the rod.
///
/// ```
/// use std::sync::Arc;
/// use varda_rod::{Loads, Vector3};
///
/// // Weight, and a pull of 0.2 N along y at 0.5 m that fades.
/// let pull = |t: f64| [0.0, 0.2 * (-t).exp(), 0.0];
/// let loads = Loads {
///     gravity: Vector3::new(0.0, 0.0, -9.81),
///     point_forces: vec![(0.5, Arc::new(pull))],
///     ..Loads::default()
/// };
/// assert_eq!(loads.point_forces[0].1.at(0.0).y, 0.2);
/// ```
#[derive(Clone, Default)]
pub struct Loads {
    /// Gravity \[m/s²\], for example (0, 0, −9.81).
    pub gravity: Vector3<f64>,
    /// Forces \[N\] at arc lengths s \[m\], shared linearly by the two vertices beside s.
    pub point_forces: Vec<(f64, Arc<dyn Motion>)>,
    /// Loads that depend on places, velocities or sections of the rod.
    pub of_motion: Vec<Arc<dyn Load>>,
}

impl Loads {
    /// A load looks at directors or turns sections.
    pub(crate) fn need_angles(&self) -> bool {
        self.of_motion.iter().any(|load| load.uses_directors() || load.has_moment())
    }
}

/// Damping of the motion. Both are zero by default.
///
/// ```
/// use varda_rod::Damping;
///
/// // Bending and stretching lose energy with a time of 5 ms; motion as a whole does not.
/// let damping = Damping { stiffness: 0.005, ..Damping::default() };
/// assert_eq!(damping.mass, 0.0);
/// ```
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Damping {
    /// Kelvin–Voigt time β \[s\]: every strain ε gets the stress β k ε̇ of its own stiffness k. Zero
    /// for rigid motion.
    pub stiffness: f64,
    /// Mass-proportional rate α [1/s]: force −α M V.
    pub mass: f64,
}
