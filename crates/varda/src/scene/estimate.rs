//! `[estimate]`: constants that are estimated beside the state.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::defaults::is_default;
use super::invalid::{Invalid, invalid};

/// Constants that nobody knows well, estimated together with the state at the start of the window. The value
/// written elsewhere in the scene is the prior's, its σ stands here. Absent: all are known.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Estimate {
    /// Young's modulus [Pa]: scales EA and EI, and GJ where Poisson's ratio is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub youngs_modulus: Option<Unknown>,
    /// Bending stiffness EI [N m²] of κ₁ and κ₂: `ei[0]`, `ei[1]`; with `together`, both by one
    /// factor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ei: Option<Unknown>,
    /// Twisting stiffness GJ [N m²].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gj: Option<Unknown>,
    /// Stretching stiffness EA [N].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ea: Option<Unknown>,
    /// Density [kg/m³] of a rod whose section has a material.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density: Option<Unknown>,
    /// Mass per length [kg/m], without point masses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass_per_length: Option<Unknown>,
    /// Time of strain-rate damping [s]: `model.damping.stiffness`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping_stiffness: Option<Unknown>,
    /// Rate of mass-proportional damping [1/s]: `model.damping.mass`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping_mass: Option<Unknown>,
    /// Natural curvature [1/m], both components; with `correlation_length`, a field along the rod.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub natural_curvature: Option<Unknown>,
    /// Natural twist [rad/m]; with `correlation_length`, a field along the rod.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub natural_twist: Option<Unknown>,
    /// Masses of `model.point_masses` [kg], one after the other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_mass: Option<Unknown>,
    /// Direction of gravity [rad]: turned about two axes across it, as where the model's z is not quite
    /// upwards.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity_direction: Option<Unknown>,
    /// Directions of the clamps [rad], each turned about its own axes: `clamp_direction[start].m1`, `.m2`;
    /// and about the tangent (`.t`) where a turn of the section shows: with clamps at both ends, of a section
    /// that is not isotropic, or of a curved rod.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clamp_direction: Option<Unknown>,
    /// Places of clamps and prescribed vertices [m], each displaced from where the scene and its motion put
    /// it: `support_position[start].x`, `support_position[prescribed.0].z`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub support_position: Option<Unknown>,
    /// Semi-axes of the ellipse that a support is driven along [m]: `drive_radii[0]`, `drive_radii[1]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drive_radii: Option<Unknown>,
    /// Phase of that motion [rad]: how far it is ahead of cos ωt, sin ωt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drive_phase: Option<Unknown>,
    /// Errors of the recorded places of supports, an uncertain input: σ of a coordinate of a row [m], or
    /// with `correlation_time` that of the motion followed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base: Option<Unknown>,
    /// Errors of the recorded rotations of clamps, an uncertain input: σ about each axis of a row [rad], or
    /// with `correlation_time` that of the motion followed. The clamp turns about the body's origin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_rotation: Option<Unknown>,
    /// Arc lengths of the observed places [m], each an unknown of its own: `marker_arc_length[tip]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub marker_arc_length: Option<Unknown>,
    /// Offsets of the observed places from the centreline, along m₁, m₂ and the tangent [m]:
    /// `marker_offset[tip].m1`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub marker_offset: Option<Unknown>,
    /// A rotation of the recording's axes against the model's [rad], a small one about each axis of the
    /// recording. It is applied to the values that the model predicts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mount_rotation: Option<Unknown>,
    /// A displacement of the recording's origin [m] in its own axes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mount_translation: Option<Unknown>,
    /// A rotation of every camera from its calibration [rad], about its own axes right, down and forward:
    /// `camera_rotation[left].x`. By names of those cameras.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_rotation: Option<Unknown>,
    /// A displacement of the centre of every camera from its calibration [m], in the axes of its `position`:
    /// `camera_translation[left].x`. By names of those cameras.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_translation: Option<Unknown>,
    /// An error of every observed place or component that stays the same all the time, in its unit:
    /// `bias[tip].x`. By names, of those sensors and markers, each with its prior:
    /// `bias = { imu = { sigma = 0.1 } }` is `bias[imu].ax` and so on, by the names of the tables, in the
    /// unit of the sensor.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias: Option<Unknown>,
    /// Offset of the recording's clock [s]: what it wrote down at t was at t + `clock` by the model's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clock: Option<Unknown>,
    /// A factor of σ of all observations, by its likelihood: σ is that of the scene times a number near 1,
    /// known to the share that is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub observation_sigma: Option<Unknown>,
    /// Forcing F of `lorenz96`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forcing: Option<Unknown>,
    /// σ of `lorenz63`.
    #[serde(rename = "sigma", skip_serializing_if = "Option::is_none")]
    pub prandtl: Option<Unknown>,
    /// ρ of `lorenz63`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rho: Option<Unknown>,
    /// β of `lorenz63`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beta: Option<Unknown>,
    /// Speed c of `linear-advection` [m/s].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub speed: Option<Unknown>,
    /// Diffusivity ν of `linear-advection` [m²/s].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub diffusivity: Option<Unknown>,
    /// Viscosity ν of `burgers` [m²/s].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub viscosity: Option<Unknown>,
}

/// Keys of what a rod's observations depend on, and of those of any model.
pub(crate) const OF_PLACES: [&str; 6] = [
    "marker_arc_length",
    "marker_offset",
    "mount_rotation",
    "mount_translation",
    "camera_rotation",
    "camera_translation",
];
/// Keys of unknowns that may be given by names.
pub(crate) const BY_NAMES: [&str; 3] = ["bias", "camera_rotation", "camera_translation"];
pub(crate) const OF_OBSERVATIONS: [&str; 3] = ["bias", "clock", "observation_sigma"];

/// Keys of errors in time of what was recorded of supports, with their unit.
pub(crate) const OF_BASE: [(&str, &str); 2] = [("base", "m"), ("base_rotation", "rad")];

/// The prior of a constant: of every component alike, or one after the other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Unknown {
    /// The same for every component, each an unknown of its own.
    Every(ConstantPrior),
    /// One for each component.
    Each(Vec<ConstantPrior>),
    /// By the name of a sensor, a marker (`bias`) or a camera, for each of its values.
    Named(BTreeMap<String, ConstantPrior>),
}

/// How well a constant is known.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConstantPrior {
    /// Standard deviation in the unit of the constant (a normal prior), or a share of its value as "30%" (a
    /// log-normal prior: the constant keeps its sign).
    pub sigma: PriorSigma,
    /// One factor for all components. For `ei`, keeps an isotropic section isotropic.
    #[serde(default, skip_serializing_if = "is_default")]
    pub together: bool,
    /// Length over which values of a field along the rod are alike [m]. Absent: one value for the whole rod.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "m"))]
    pub correlation_length: Option<f64>,
    /// Of `base`, `base_rotation`: time over which errors of the motion are alike [s]. Absent: those of
    /// rows are independent, and what smoothing leaves of them is estimated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schemars(extend("exclusiveMinimum" = 0.0, "x-unit" = "s"))]
    pub correlation_time: Option<f64>,
}

/// A standard deviation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum PriorSigma {
    /// In the unit of the constant.
    Value(#[schemars(extend("exclusiveMinimum" = 0.0))] f64),
    /// A share of the value, in percent: "30%".
    Share(String),
}

/// σ of a prior, read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum PriorSpread {
    /// Of the constant, in its unit.
    Normal(f64),
    /// Of the logarithm of the constant.
    LogNormal(f64),
}

impl ConstantPrior {
    /// σ, `path` being that of the prior.
    pub(crate) fn spread(&self, path: &str) -> Result<PriorSpread, Invalid> {
        let refused = |what: &str| invalid(format!("{path}.sigma"), what);
        match &self.sigma {
            PriorSigma::Value(sigma) if *sigma > 0.0 && sigma.is_finite() => Ok(PriorSpread::Normal(*sigma)),
            PriorSigma::Value(_) => refused("a standard deviation is greater than 0"),
            PriorSigma::Share(text) => {
                let share = text.trim().strip_suffix('%').and_then(|n| n.trim().parse::<f64>().ok());
                match share {
                    Some(percent) if percent > 0.0 && percent <= 200.0 => {
                        Ok(PriorSpread::LogNormal(0.01 * percent))
                    }
                    Some(_) => refused("a share is between 0 and 200%"),
                    None => refused("write a number in the unit of the constant, or a share as \"30%\""),
                }
            }
        }
    }
}

impl Unknown {
    /// The prior of each of `components`, with its path; `path` is that of the key.
    pub(crate) fn priors(
        &self,
        path: &str,
        components: usize,
    ) -> Result<Vec<(String, &ConstantPrior)>, Invalid> {
        match self {
            Unknown::Every(prior) => Ok((0..components).map(|_| (path.to_string(), prior)).collect()),
            Unknown::Each(list) if list.len() == components => {
                Ok(list.iter().enumerate().map(|(i, prior)| (format!("{path}.{i}"), prior)).collect())
            }
            Unknown::Each(list) => {
                invalid(path, format!("has {} entries, expected {components}", list.len()))
            }
            Unknown::Named(_) => invalid(path, format!("names are for {} alone", BY_NAMES.join(", "))),
        }
    }

    /// Whether all components are scaled by one factor.
    pub(crate) fn together(&self) -> bool {
        matches!(self, Unknown::Every(prior) if prior.together)
    }
}

impl Estimate {
    /// With the keys of another one beside its own.
    #[allow(clippy::missing_panics_doc)] // both are plain JSON
    pub(crate) fn with(&self, other: &Estimate) -> Estimate {
        let mut own = serde_json::to_value(self).expect("plain JSON");
        let other = serde_json::to_value(other).expect("plain JSON");
        if let (Some(own), Value::Object(other)) = (own.as_object_mut(), other) {
            own.extend(other);
        }
        serde_json::from_value(own).expect("keys of this type")
    }

    /// The keys that are given.
    pub(crate) fn given(&self) -> Vec<(&'static str, &Unknown)> {
        let all = [
            ("youngs_modulus", &self.youngs_modulus),
            ("ei", &self.ei),
            ("gj", &self.gj),
            ("ea", &self.ea),
            ("density", &self.density),
            ("mass_per_length", &self.mass_per_length),
            ("damping_stiffness", &self.damping_stiffness),
            ("damping_mass", &self.damping_mass),
            ("natural_curvature", &self.natural_curvature),
            ("natural_twist", &self.natural_twist),
            ("point_mass", &self.point_mass),
            ("gravity_direction", &self.gravity_direction),
            ("clamp_direction", &self.clamp_direction),
            ("support_position", &self.support_position),
            ("drive_radii", &self.drive_radii),
            ("drive_phase", &self.drive_phase),
            ("base", &self.base),
            ("base_rotation", &self.base_rotation),
            ("forcing", &self.forcing),
            ("sigma", &self.prandtl),
            ("rho", &self.rho),
            ("beta", &self.beta),
            ("speed", &self.speed),
            ("diffusivity", &self.diffusivity),
            ("viscosity", &self.viscosity),
            ("marker_arc_length", &self.marker_arc_length),
            ("marker_offset", &self.marker_offset),
            ("mount_rotation", &self.mount_rotation),
            ("mount_translation", &self.mount_translation),
            ("camera_rotation", &self.camera_rotation),
            ("camera_translation", &self.camera_translation),
            ("bias", &self.bias),
            ("clock", &self.clock),
            ("observation_sigma", &self.observation_sigma),
        ];
        all.into_iter().filter_map(|(key, unknown)| Some((key, unknown.as_ref()?))).collect()
    }
}
