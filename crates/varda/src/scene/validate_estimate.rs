//! What `[estimate]` must satisfy beyond the type of each key.

use super::estimate::{BY_NAMES, OF_BASE, OF_OBSERVATIONS, OF_PLACES, PriorSpread};
use super::invalid::{Check, invalid};
use super::{ConstantPrior, Estimate, Method, Model, Motion, RodModel, Scene, Section, Unknown};

/// Keys of a rod, of its observations, and of each other model.
const OF_ROD: [&str; 18] = [
    "clamp_direction",
    "support_position",
    "drive_radii",
    "drive_phase",
    "base",
    "base_rotation",
    "gravity_direction",
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
        if !(names.contains(&key) || OF_OBSERVATIONS.contains(&key) || is_rod && OF_PLACES.contains(&key)) {
            let others = if names.is_empty() {
                format!("none but those of observations: {}", OF_OBSERVATIONS.join(", "))
            } else {
                names.join(", ")
            };
            return invalid(path, format!("is no constant of this model, which has {others}"));
        }
        let priors: Vec<&ConstantPrior> = match unknown {
            Unknown::Every(prior) => vec![prior],
            Unknown::Each(list) => list.iter().collect(),
            Unknown::Named(_) if !BY_NAMES.contains(&key) => {
                return invalid(path, format!("names are for {} alone", BY_NAMES.join(", ")));
            }
            Unknown::Named(by_name) => by_name.values().collect(),
        };
        for prior in priors {
            prior.spread(&path)?;
            if prior.correlation_length.is_some() && !["natural_curvature", "natural_twist"].contains(&key) {
                return invalid(path, "is one number: only natural_curvature and natural_twist are fields");
            }
            if prior.correlation_time.is_some() && OF_BASE.iter().all(|(base, _)| *base != key) {
                return invalid(path, "correlation_time is for `base` and `base_rotation` alone");
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
    if estimate.given().is_empty() {
        return Ok(());
    }
    if scene.time.tolerance.is_some() {
        return invalid("time.tolerance", "time steps that adapt do not go with [estimate]: leave one out");
    }
    let algorithm = &scene.algorithm;
    let is_sensor = |name: &String| scene.observations.sensors().iter().any(|sensor| sensor.name == *name);
    let of_coordinates = match &estimate.bias {
        Some(Unknown::Named(by_name)) => !by_name.keys().all(is_sensor),
        bias => bias.is_some(),
    };
    validate_poses(estimate, scene)?;
    if of_coordinates && !scene.observations.cameras().is_empty() {
        let message = "is of coordinates: beside cameras take marker_offset, or mount_translation";
        return invalid("estimate.bias", message);
    }
    if estimate.observation_sigma.is_some() {
        validate_sigma(estimate, scene)?;
    }
    if algorithm.cycles.is_some() {
        return invalid("algorithm.cycles", "constants are estimated in one window: leave [estimate] out");
    }
    if algorithm.method == Method::WeakState {
        let message = "constants have no model error, and \"weak-state\" needs the inverse of Q: with \
                       [estimate] take \"weak-forcing\"";
        return invalid("algorithm.method", message);
    }
    if algorithm.members().is_some_and(|ensemble| ensemble.localization_length.is_some()) {
        let message = "constants have no place that a distance could be taken from: leave it out, or \
            [estimate]";
        return invalid("algorithm.ensemble.localization_length", message);
    }
    Ok(())
}

/// Poses are of cameras that are there.
fn validate_poses(estimate: &Estimate, scene: &Scene) -> Check {
    let cameras = scene.observations.cameras();
    let keys = [
        ("camera_rotation", &estimate.camera_rotation),
        ("camera_translation", &estimate.camera_translation),
    ];
    for (key, unknown) in keys {
        let (Some(unknown), path) = (unknown, format!("estimate.{key}")) else { continue };
        if cameras.is_empty() {
            return invalid(path, "needs [[observations.cameras]]");
        }
        if let Unknown::Named(by_name) = unknown
            && let Some(name) = by_name.keys().find(|name| cameras.iter().all(|c| c.name != **name))
        {
            let known: Vec<&str> = cameras.iter().map(|c| c.name.as_str()).collect();
            return invalid(path, format!("{name:?} is none of the cameras: {}", known.join(", ")));
        }
    }
    Ok(())
}

/// σ by its likelihood needs the degrees of freedom that an analysis takes, and errors that are normal.
fn validate_sigma(estimate: &Estimate, scene: &Scene) -> Check {
    const KEY: &str = "estimate.observation_sigma";
    let Some(unknown) = &estimate.observation_sigma else { return Ok(()) };
    for (path, prior) in unknown.priors(KEY, 1)? {
        if let PriorSpread::Normal(_) = prior.spread(&path)? {
            return invalid(path, "is a factor: give sigma as a share, \"50%\"");
        }
    }
    if !scene.report.posterior {
        return invalid("report.posterior", "estimate.observation_sigma needs it: leave one out");
    }
    if scene.algorithm.robust.is_some() {
        let message =
            "is no likelihood that σ could be found by: leave it out, or estimate.observation_sigma";
        return invalid("algorithm.robust", message);
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
    if estimate.clamp_direction.is_some() && rod.start.is_none() && rod.end.is_none() {
        return invalid("estimate.clamp_direction", "needs [model.start] or [model.end]");
    }
    for (key, given) in
        [("drive_radii", estimate.drive_radii.is_some()), ("drive_phase", estimate.drive_phase.is_some())]
    {
        if given && !rod.motions().any(|motion| matches!(motion, Motion::Ellipse { .. })) {
            return invalid(format!("estimate.{key}"), "needs a support with motion.kind = \"ellipse\"");
        }
    }
    for (key, unit) in OF_BASE {
        let Some((_, base)) = estimate.given().into_iter().find(|(given, _)| *given == key) else { continue };
        let path = format!("estimate.{key}");
        if !rod.motions().any(|motion| !matches!(motion, Motion::Ellipse { .. })) {
            return invalid(path, "needs a support that moves as a file or markers say");
        }
        let Unknown::Every(prior) = base else { return invalid(path, "is one table") };
        if let PriorSpread::LogNormal(_) = prior.spread(&path)? {
            return invalid(format!("{path}.sigma"), format!("is in {unit}, not a share"));
        }
        if prior.correlation_time.is_some_and(|t| !(t > 0.0 && t.is_finite())) {
            return invalid(format!("{path}.correlation_time"), "is greater than 0");
        }
    }
    if estimate.point_mass.is_some() && rod.point_masses.is_empty() {
        return invalid("estimate.point_mass", "needs [[model.point_masses]], whose masses are the prior's");
    }
    Ok(())
}
