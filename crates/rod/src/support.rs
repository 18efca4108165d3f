//! What holds the rod and what pulls at it.

use std::sync::Arc;

use nalgebra::Vector3;

use crate::load::Load;
use crate::{Error, Rod};

/// A vector that depends on time: the place of a vertex \[m\], a direction, a force \[N\].
///
/// Constant vectors and arrays are motions, and so are closures that return either: `|t| [x, y, z]`.
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
/// x(t) = c + a(u) (r_x cos ωt, r_y sin ωt, 0),   a = u³ (10 − 15u + 6u²),   u = min(1, t / T_ramp)
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseDrive {
    /// Centre c \[m\].
    pub centre: Vector3<f64>,
    /// Semi-axes r_x, r_y \[m\].
    pub radii: [f64; 2],
    /// Angular frequency ω [rad/s].
    pub omega: f64,
    /// Duration of the ramp \[s\]; 0 for none.
    pub ramp: f64,
}

impl Motion for EllipseDrive {
    fn at(&self, t: f64) -> Vector3<f64> {
        let u = if self.ramp > 0.0 { (t / self.ramp).clamp(0.0, 1.0) } else { 1.0 };
        let a = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u);
        let (sin, cos) = (self.omega * t).sin_cos();
        self.centre + Vector3::new(a * self.radii[0] * cos, a * self.radii[1] * sin, 0.0)
    }
}

/// A clamped end: it prescribes the end vertex, the direction of the end edge (at its rest length) and the
/// direction m₁ of the section there, all as functions of time. Directions need not be normalized, nor m₁
/// exactly perpendicular.
#[derive(Clone)]
pub struct Clamp {
    /// Place of the end vertex \[m\].
    pub position: Arc<dyn Motion>,
    /// Direction of the end edge, towards growing arc length.
    pub tangent: Arc<dyn Motion>,
    /// Direction m₁ of the section.
    pub director: Arc<dyn Motion>,
}

impl Clamp {
    /// A clamp of these motions; constant vectors are motions too.
    pub fn new(
        position: impl Motion + 'static,
        tangent: impl Motion + 'static,
        director: impl Motion + 'static,
    ) -> Clamp {
        Clamp { position: Arc::new(position), tangent: Arc::new(tangent), director: Arc::new(director) }
    }
}

/// All supports of a rod.
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
    /// tangent.
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

    /// Vertices whose place is prescribed, ascending.
    ///
    /// # Errors
    /// [`Error::Support`] where two supports claim a vertex or it does not exist.
    pub(crate) fn prescribed_vertices(&self, rod: &Rod) -> Result<Vec<usize>, Error> {
        let n = rod.segments();
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
#[derive(Clone, Default)]
pub struct Loads {
    /// Gravity \[m/s²\], for example (0, 0, −9.81).
    pub gravity: Vector3<f64>,
    /// Forces \[N\] at arc lengths s \[m\], shared linearly by the two vertices beside s.
    pub point_forces: Vec<(f64, Arc<dyn Motion>)>,
    /// Loads that depend on places or velocities of the rod.
    pub of_motion: Vec<Arc<dyn Load>>,
}

/// Damping of the motion. Both are zero by default.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Damping {
    /// Kelvin–Voigt time β \[s\]: every strain ε gets the stress β k ε̇ of its own stiffness k. Zero
    /// for rigid motion.
    pub stiffness: f64,
    /// Mass-proportional rate α [1/s]: force −α M V.
    pub mass: f64,
}
