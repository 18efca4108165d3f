//! `[model]`: the dynamical system.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use varda_implicit::line::{Ends, Line};

use super::defaults::is_default;
use super::loads::{Drag, Force, Moment};
use super::motion::{Motion, Turns};

/// The dynamical system.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Model {
    /// A discrete elastic rod; the control is [X₀, V₀] of its free vertices.
    Rod(Box<RodModel>),
    /// Lorenz's three equations of convection (1963).
    Lorenz63(Lorenz63),
    /// Lorenz's ring of N variables (1996).
    Lorenz96(Lorenz96),
    /// A field carried along a line at a constant speed, and spread by diffusion.
    #[serde(rename = "linear-advection")]
    LinearAdvection(LinearAdvection),
    /// A velocity that carries itself along a line (Burgers 1948).
    Burgers(Burgers),
    /// Fronts on a circle that long waves feed and short ones damp: a chaotic field.
    #[serde(rename = "kuramoto-sivashinsky")]
    KuramotoSivashinsky(KuramotoSivashinsky),
}

impl Model {
    /// Number of components of a state, for models that are not rods.
    pub fn components(&self) -> Option<usize> {
        match self {
            Model::Rod(_) => None,
            Model::Lorenz63(_) => Some(3),
            Model::Lorenz96(m) => Some(m.variables),
            Model::LinearAdvection(m) => Some(m.points),
            Model::Burgers(m) => Some(m.points),
            Model::KuramotoSivashinsky(m) => Some(m.points),
        }
    }

    /// The line of a field along one.
    pub fn line(&self) -> Option<Line> {
        match self {
            Model::LinearAdvection(m) => Some(m.line()),
            Model::Burgers(m) => Some(m.line()),
            Model::KuramotoSivashinsky(m) => Some(m.line()),
            Model::Rod(_) | Model::Lorenz63(_) | Model::Lorenz96(_) => None,
        }
    }
}

fn line(points: usize, length: f64, fixed_ends: Option<[f64; 2]>) -> Line {
    let ends = fixed_ends.map_or(Ends::Periodic, |[left, right]| Ends::Fixed { left, right });
    Line { points, length, ends }
}

/// ∂u/∂t + c ∂u/∂s = ν ∂²u/∂s² along a line of points at equal distances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LinearAdvection {
    /// Number of points at which u is unknown.
    #[schemars(extend("minimum" = 3, "maximum" = 1000000))]
    pub points: usize,
    /// Length L of the line [m].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub length: f64,
    /// u given at both ends of the line. Left out: the line closes to a circle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fixed_ends: Option<[f64; 2]>,
    /// Speed c [m/s].
    #[schemars(extend("x-unit" = "m/s"))]
    pub speed: f64,
    /// Diffusivity ν [m²/s].
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m²/s"))]
    pub diffusivity: f64,
}

impl LinearAdvection {
    /// Its line.
    pub fn line(&self) -> Line {
        line(self.points, self.length, self.fixed_ends)
    }
}

impl Default for LinearAdvection {
    fn default() -> Self {
        LinearAdvection { points: 100, length: 1.0, fixed_ends: None, speed: 1.0, diffusivity: 0.0 }
    }
}

/// ∂u/∂t + u ∂u/∂s = ν ∂²u/∂s² along a line of points at equal distances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Burgers {
    /// Number of points at which u is unknown.
    #[schemars(extend("minimum" = 3, "maximum" = 1000000))]
    pub points: usize,
    /// Length L of the line [m].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub length: f64,
    /// u given at both ends of the line [m/s]. Left out: the line closes to a circle.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "m/s"))]
    pub fixed_ends: Option<[f64; 2]>,
    /// Viscosity ν [m²/s].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m²/s"))]
    pub viscosity: f64,
}

impl Burgers {
    /// Its line.
    pub fn line(&self) -> Line {
        line(self.points, self.length, self.fixed_ends)
    }
}

impl Default for Burgers {
    fn default() -> Self {
        Burgers { points: 100, length: 1.0, fixed_ends: None, viscosity: 0.01 }
    }
}

/// ∂u/∂t = −u ∂u/∂s − ∂²u/∂s² − ∂⁴u/∂s⁴ on a circle (Kuramoto and Tsuzuki 1976;
/// Sivashinsky 1977).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct KuramotoSivashinsky {
    /// Number of points at which u is known, five at least.
    #[schemars(extend("minimum" = 5, "maximum" = 1000000))]
    pub points: usize,
    /// Length L of the circle; waves longer than 2π grow.
    #[schemars(extend("exclusiveMinimum" = 0.0))]
    pub length: f64,
}

impl KuramotoSivashinsky {
    /// Its line.
    pub fn line(&self) -> Line {
        line(self.points, self.length, None)
    }
}

impl Default for KuramotoSivashinsky {
    fn default() -> Self {
        KuramotoSivashinsky { points: 128, length: 32.0 * std::f64::consts::PI }
    }
}

/// ẋ = σ(y−x), ẏ = x(ρ−z)−y, ż = xy−βz.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Lorenz63 {
    /// Prandtl number σ.
    pub sigma: f64,
    /// Rayleigh number over its critical value, ρ.
    pub rho: f64,
    /// Aspect of the rolls, β.
    pub beta: f64,
}

impl Default for Lorenz63 {
    fn default() -> Self {
        Lorenz63 { sigma: 10.0, rho: 28.0, beta: 8.0 / 3.0 }
    }
}

/// ẋ_i = (x_{i+1} − x_{i−2}) x_{i−1} − x_i + F on a ring.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Lorenz96 {
    /// Number of variables N, at most 1e6.
    #[schemars(extend("minimum" = 4, "maximum" = 1000000))]
    pub variables: usize,
    /// Forcing F.
    pub forcing: f64,
}

impl Default for Lorenz96 {
    fn default() -> Self {
        Lorenz96 { variables: 40, forcing: 8.0 }
    }
}

/// A discrete elastic rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RodModel {
    /// Rest length of the rod L [m], from clamp to clamp or to a free end. Give this and `segments`, or
    /// `segment_lengths`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub length: Option<f64>,
    /// Number of equal segments, at most 20000 (B is dense).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("minimum" = 2, "maximum" = 20000))]
    pub segments: Option<usize>,
    /// Rest length of every segment [m], where they differ, from clamp to clamp or to a free end; at most
    /// 20000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "m", "maxItems" = 20000))]
    pub segment_lengths: Option<Vec<f64>>,
    /// The cross-section, the same all along.
    pub section: Section,
    /// What the rod is made of. Not needed where the section gives its stiffnesses directly.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub material: Option<Material>,
    /// Sections have inertia ρ(I₁ + I₂) against a spin about the tangent: twist travels in waves, and a
    /// state is [X, V, θ, ω]. Left out: twist is in equilibrium at every moment.
    #[serde(default, skip_serializing_if = "is_default")]
    pub twist_inertia: bool,
    /// Natural curvature (κ̄₁, κ̄₂) per length [1/m]: (1, 0) bends the rod at rest towards m₁,
    /// (0, 1) towards m₂, with radius 1 m. A clamp's `director` says where m₁ points.
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "1/m"))]
    pub natural_curvature: [f64; 2],
    /// Natural twist per length [rad/m].
    #[serde(default, skip_serializing_if = "is_default")]
    #[schemars(extend("x-unit" = "rad/m"))]
    pub natural_twist: f64,
    /// A shape at rest, measured or drawn, whose curvature and twist are the natural ones: in place of
    /// `natural_curvature` and `natural_twist`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest_shape: Option<RestShape>,
    /// A first guess of the static equilibrium, which picks one where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub initial_shape: Option<ShapePoints>,
    /// What `start` and `end` hold: the rod at their faces, or its first and last edge.
    #[serde(default, skip_serializing_if = "is_default")]
    pub clamp: ClampAt,
    /// Clamp at arc length 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<Clamp>,
    /// Clamp at arc length L.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub end: Option<Clamp>,
    /// Further vertices whose place is given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub prescribed: Vec<Prescribed>,
    /// Gravity [m/s²].
    #[serde(default = "standard_gravity")]
    #[schemars(extend("x-unit" = "m/s²"))]
    pub gravity: [f64; 3],
    /// Forces on points of the rod; `point_forces` is another name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub forces: Vec<Force>,
    /// Moments on points of the rod.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub moments: Vec<Moment>,
    /// Drag of the fluid around the rod. Absent: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drag: Option<Drag>,
    /// Masses hung on points of the rod.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub point_masses: Vec<PointMass>,
    /// Damping of the motion.
    #[serde(default, skip_serializing_if = "is_default")]
    pub damping: DampingValues,
}

impl RodModel {
    /// Whether a clamp holds the rod at its face, at the start and at the end.
    pub(crate) fn faces(&self) -> [bool; 2] {
        [&self.start, &self.end].map(|clamp| clamp.is_some() && self.clamp == ClampAt::Face)
    }

    /// ω of the start clamp's ellipse drive [rad/s].
    pub(crate) fn drive_frequency(&self) -> Option<f64> {
        match self.start.as_ref()?.motion {
            Some(Motion::Ellipse { omega, .. }) => Some(omega),
            _ => None,
        }
    }

    /// How its supports move.
    pub(crate) fn motions(&self) -> impl Iterator<Item = &Motion> {
        let clamps = [&self.start, &self.end].into_iter().flatten().map(|clamp| &clamp.motion);
        clamps.chain(self.prescribed.iter().map(|p| &p.motion)).flatten()
    }
}

impl RodModel {
    /// Markers of the observation file that supports follow.
    pub(crate) fn followed_markers(&self) -> impl Iterator<Item = &str> {
        self.motions().flat_map(|motion| match motion {
            Motion::Markers(keys) => keys.names.iter().map(String::as_str).collect(),
            Motion::Ellipse { .. } | Motion::Table(_) | Motion::Pose(_) => Vec::new(),
        })
    }
}

fn standard_gravity() -> [f64; 3] {
    [0.0, 0.0, -9.81]
}

/// The cross-section of a rod. m₁ and m₂ are its directions in the rod; a clamp says where m₁ points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Section {
    /// A full circle.
    Circle {
        /// Radius [m].
        #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
        radius: f64,
    },
    /// A full ellipse.
    Ellipse {
        /// Semi-axes along m₁ and m₂ [m].
        #[schemars(extend("x-unit" = "m", "x-positive" = true))]
        semi_axes: [f64; 2],
    },
    /// A full rectangle.
    Rectangle {
        /// Side along m₁ [m].
        #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
        width: f64,
        /// Side along m₂ [m].
        #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
        height: f64,
    },
    /// Stiffnesses given directly.
    Stiffness {
        /// Stretching stiffness EA [N].
        #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "N"))]
        ea: f64,
        /// Bending stiffnesses (EI₁, EI₂) [N m²].
        #[schemars(extend("x-unit" = "N m²"))]
        ei: [f64; 2],
        /// Twisting stiffness GJ [N m²].
        #[schemars(extend("minimum" = 0.0, "x-unit" = "N m²"))]
        gj: f64,
        /// Mass per length [kg/m].
        #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "kg/m"))]
        mass_per_length: f64,
        /// Inertia ρ(I₁ + I₂) against a spin about the tangent, per length [kg m]. Needed with
        /// `twist_inertia`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "kg m"))]
        rotary_inertia: Option<f64>,
    },
}

/// An elastic material. Give `poisson_ratio` or `shear_modulus`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Young's modulus E [Pa].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "Pa"))]
    pub youngs_modulus: f64,
    /// Poisson's ratio ν; the shear modulus is then E / (2 (1 + ν)).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = -1.0, "maximum" = 0.5, "x-meant" = "solids have 0.2 to 0.5"))]
    pub poisson_ratio: Option<f64>,
    /// Shear modulus G [Pa].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "Pa"))]
    pub shear_modulus: Option<f64>,
    /// Density ρ [kg/m³].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "kg/m³"))]
    pub density: f64,
}

/// What the place of a clamp is the place of.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ClampAt {
    /// The section at the clamp's face, from which the rod is free: `length` is the free length, arc lengths
    /// count from the face. The edge it holds has its middle there: equal segments are
    /// length / (segments − ½ per clamp) long, and the first (last) of `segment_lengths` is half of it.
    #[default]
    Face,
    /// The end vertex: the clamp holds the whole first (last) edge, as the paper's does, and the rod bends as
    /// if it were half a segment shorter.
    Edge,
}

/// A clamped end: place, direction and rotation of the end of the rod are given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Clamp {
    /// Place of the section at its face [m]; of the end vertex where `clamp = "edge"`. Needed where the
    /// motion does not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "m"))]
    pub position: Option<[f64; 3]>,
    /// Direction of the rod there, towards growing arc length. Needed where the motion does not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tangent: Option<[f64; 3]>,
    /// Direction m₁ of the section. Needed where the motion does not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub director: Option<[f64; 3]>,
    /// How the clamp moves. Absent: it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
    /// Turns of the director about the tangent, right-handed: a number, or a file with the header
    /// `time_s,turns`. Whole turns between two clamps are twist of the rod. Absent: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turns: Option<Turns>,
}

/// A shape of the rod: points along it, in a file or here.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ShapePoints {
    /// A CSV file with the header `s_m,x_m,y_m,z_m`: points by arc length, ascending; straight on beyond
    /// them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Points from one end of the rod to the other [m]; the curve's own length is scaled to the rod's.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "m", "maxItems" = 20000))]
    pub points: Option<Vec<[f64; 3]>>,
}

/// A shape at rest: points along the rod, in a file or here, wherever it was laid.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RestShape {
    /// A CSV file with the header `s_m,x_m,y_m,z_m`: points by arc length, ascending; straight on beyond
    /// them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<String>,
    /// Points from one end of the rod to the other [m]; the curve's own length is scaled to the rod's.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "m", "maxItems" = 20000))]
    pub points: Option<Vec<[f64; 3]>>,
    /// Where m₁ of the first segment points, in the axes of the points. Absent: the start clamp's director.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub director: Option<[f64; 3]>,
}

impl RestShape {
    /// Its points.
    pub(crate) fn shape(&self) -> ShapePoints {
        ShapePoints { file: self.file.clone(), points: self.points.clone() }
    }
}

/// A vertex whose place is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Prescribed {
    /// Number of the vertex, 0 at the start.
    pub vertex: usize,
    /// Its place [m]. Needed where the motion does not say it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "m"))]
    pub position: Option<[f64; 3]>,
    /// How it moves. Absent: it does not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion: Option<Motion>,
}

/// A mass hung on a point of the rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PointMass {
    /// Arc length of the point [m].
    #[schemars(extend("minimum" = 0.0, "x-unit" = "m"))]
    pub arc_length: f64,
    /// The mass [kg].
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "kg"))]
    pub mass: f64,
}

/// Damping of the motion.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DampingValues {
    /// Kelvin–Voigt time β [s]: a strain ε of stiffness k gets the stress β k ε̇.
    #[schemars(extend("minimum" = 0.0, "x-unit" = "s"))]
    pub stiffness: f64,
    /// Mass-proportional rate α [1/s]: the force −α M V.
    #[schemars(extend("minimum" = 0.0, "x-unit" = "1/s"))]
    pub mass: f64,
}
