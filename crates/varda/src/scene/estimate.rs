//! `[estimate]`: constants that are estimated beside the state.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::defaults::is_default;
use super::invalid::{Check, Invalid, invalid};
use super::{Model, RodModel, Scene, Section, Shear};

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
    /// An error of every observed place or component that stays the same all the time, in its unit:
    /// `bias[tip].x`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bias: Option<Unknown>,
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

/// The prior of a constant: of every component alike, or one after the other.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Unknown {
    /// The same for every component, each an unknown of its own.
    Every(ConstantPrior),
    /// One for each component.
    Each(Vec<ConstantPrior>),
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
        }
    }

    /// Whether all components are scaled by one factor.
    pub(crate) fn together(&self) -> bool {
        matches!(self, Unknown::Every(prior) if prior.together)
    }
}

impl Estimate {
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
            ("bias", &self.bias),
        ];
        all.into_iter().filter_map(|(key, unknown)| Some((key, unknown.as_ref()?))).collect()
    }
}

/// Keys of a rod, of its observations, and of each other model.
const OF_ROD: [&str; 11] = [
    "youngs_modulus",
    "ei",
    "gj",
    "ea",
    "density",
    "mass_per_length",
    "damping_stiffness",
    "damping_mass",
    "natural_curvature",
    "natural_twist",
    "point_mass",
];
const OF_PLACES: [&str; 4] = ["marker_arc_length", "marker_offset", "mount_rotation", "mount_translation"];

fn known(model: &Model) -> &'static [&'static str] {
    match model {
        Model::Rod(_) => &OF_ROD,
        Model::Lorenz63(_) => &["sigma", "rho", "beta"],
        Model::Lorenz96(_) => &["forcing"],
        Model::LinearAdvection(_) => &["speed", "diffusivity"],
        Model::Burgers(_) => &["viscosity"],
        Model::KuramotoSivashinsky(_) => &[],
    }
}

pub(super) fn validate_estimate(estimate: &Estimate, scene: &Scene) -> Check {
    let names = known(&scene.model);
    let is_rod = matches!(scene.model, Model::Rod(_));
    for (key, unknown) in estimate.given() {
        let path = format!("estimate.{key}");
        if !(names.contains(&key) || key == "bias" || is_rod && OF_PLACES.contains(&key)) {
            let others = if names.is_empty() { "none but `bias`".to_string() } else { names.join(", ") };
            return invalid(path, format!("is no constant of this model, which has {others}"));
        }
        let priors: Vec<&ConstantPrior> = match unknown {
            Unknown::Every(prior) => vec![prior],
            Unknown::Each(list) => list.iter().collect(),
        };
        for prior in priors {
            prior.spread(&path)?;
            if prior.correlation_length.is_some() && !["natural_curvature", "natural_twist"].contains(&key) {
                return invalid(path, "is one number: only natural_curvature and natural_twist are fields");
            }
            if prior.together
                && !(["ei", "point_mass"].contains(&key) && matches!(unknown, Unknown::Every(_)))
            {
                return invalid(path, "`together` is for one table of `ei` or `point_mass`");
            }
        }
    }
    if let Model::Rod(rod) = &scene.model {
        validate_of_rod(estimate, rod)?;
    }
    if scene.time.tolerance.is_some() && !estimate.given().is_empty() {
        return invalid("time.tolerance", "time steps that adapt do not go with [estimate]: leave one out");
    }
    Ok(())
}

fn validate_of_rod(estimate: &Estimate, rod: &RodModel) -> Check {
    let both = |a: (&str, bool), b: (&str, bool)| match a.1 && b.1 {
        true => invalid(format!("estimate.{}", a.0), format!("`{}` says the same: leave one out", b.0)),
        false => Ok(()),
    };
    let e = ("youngs_modulus", estimate.youngs_modulus.is_some());
    both(e, ("ei", estimate.ei.is_some()))?;
    both(e, ("ea", estimate.ea.is_some()))?;
    if rod.material.as_ref().is_some_and(|m| m.poisson_ratio.is_some()) {
        both(e, ("gj", estimate.gj.is_some()))?;
    }
    both(("density", estimate.density.is_some()), ("mass_per_length", estimate.mass_per_length.is_some()))?;
    if matches!(rod.section, Section::Stiffness { .. }) {
        let instead = [
            ("youngs_modulus", e.1, "ei, gj or ea"),
            ("density", estimate.density.is_some(), "mass_per_length"),
        ];
        for (key, given, other) in instead {
            if given {
                let message = format!("a section of kind \"stiffness\" has none: estimate {other}");
                return invalid(format!("estimate.{key}"), message);
            }
        }
    }
    if estimate.point_mass.is_some() && rod.point_masses.is_empty() {
        return invalid("estimate.point_mass", "needs [[model.point_masses]], whose masses are the prior's");
    }
    Ok(())
}

impl RodModel {
    /// Whether the shear modulus follows from Young's.
    pub(crate) fn shear_follows(&self) -> bool {
        self.solid_material().is_ok_and(|m| matches!(m.shear, Shear::PoissonRatio(_)))
    }
}
