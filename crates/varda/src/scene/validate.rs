//! What a scene must satisfy beyond the type of each key: keys that exclude or need one another.

use varda_implicit::line::{Ends, Line};

use super::cycles::validate_cycles;
use super::sizes::validate_sizes;
use super::{
    Background, Clamp, Covariance, Frame, Integrator, KernelCovariance, Model, Motion, Observations, Origin,
    Recording, RodModel, Scene, Section, Synthetic, Taper, validate_algorithm::validate_algorithm,
};

/// What is wrong with which key (dotted path).
#[derive(Debug)]
pub(super) struct Invalid {
    pub(super) path: String,
    pub(super) message: String,
}

pub(super) type Check = Result<(), Invalid>;

pub(super) fn invalid(path: impl Into<String>, message: impl Into<String>) -> Check {
    Err(Invalid { path: path.into(), message: message.into() })
}

/// Exactly one of two keys must be there.
fn one_of(section: &str, a: (&str, bool), b: (&str, bool)) -> Check {
    match (a.1, b.1) {
        (true, true) => {
            invalid(format!("{section}.{}", b.0), format!("give `{}` or `{}`, not both", a.0, b.0))
        }
        (false, false) => invalid(section, format!("[{section}] needs `{}` or `{}`", a.0, b.0)),
        _ => Ok(()),
    }
}

pub(super) fn validate(scene: &Scene) -> Check {
    let rod = match &scene.model {
        Model::Rod(rod) => Some(rod.as_ref()),
        _ => None,
    };
    if let Some(rod) = rod {
        validate_rod(rod)?;
    }
    let (what, integrators): (_, &[Integrator]) = match &scene.model {
        Model::Rod(_) => ("rods are", &[Integrator::BackwardEuler, Integrator::Midpoint, Integrator::Bdf2]),
        Model::Lorenz63(_) | Model::Lorenz96(_) => ("Lorenz models are", &[Integrator::Rk4]),
        Model::LinearAdvection(_) | Model::Burgers(_) => {
            ("fields along a line are", &[Integrator::BackwardEuler, Integrator::Midpoint, Integrator::Rk4])
        }
    };
    if !integrators.contains(&scene.time.integrator) {
        let names: Vec<String> = integrators.iter().map(|i| format!("{:?}", i.name())).collect();
        return invalid("time.integrator", format!("{what} integrated with {}", names.join(" or ")));
    }
    if rod.is_none() && scene.time.tolerance.is_some() {
        return invalid("time.tolerance", "steps are divided by their error for rods only");
    }
    one_of(
        "time",
        ("step", scene.time.step.is_some()),
        ("steps_per_period", scene.time.steps_per_period.is_some()),
    )?;
    if scene.time.steps_per_period.is_some() && rod.and_then(RodModel::drive_frequency).is_none() {
        return invalid(
            "time.steps_per_period",
            "a period is that of the drive [model.start.motion] kind = \"ellipse\", which is not there",
        );
    }
    if let (Some(line), Some(step)) = (scene.model.line(), scene.time.step) {
        validate_line(&scene.model, &line, scene.time.integrator, step)?;
    }
    if let Some(truth) = &scene.truth {
        let Some(n) = scene.model.components() else {
            return invalid("truth", "a rod's truth starts from its static equilibrium; leave [truth] out");
        };
        if truth.state.len() != n {
            return invalid(
                "truth.state",
                format!("has {} entries, the model has {n} components", truth.state.len()),
            );
        }
    }
    validate_background(&scene.background, &scene.model)?;
    match &scene.observations {
        Observations::Synthetic(s) => validate_synthetic(s, scene, rod)?,
        Observations::File(f) => validate_recording(f, rod)?,
    }
    scene.limits.bytes().or_else(|message| invalid("limits.memory", message).map(|()| 0))?;
    validate_algorithm(scene)?;
    if let Some(cycles) = &scene.algorithm.cycles {
        validate_cycles(cycles, scene)?;
    }
    validate_sizes(scene)
}

impl RodModel {
    /// ω of the start clamp's ellipse drive [rad/s].
    pub(crate) fn drive_frequency(&self) -> Option<f64> {
        match self.start.as_ref()?.motion {
            Some(Motion::Ellipse { omega, .. }) => Some(omega),
            _ => None,
        }
    }

    /// Rest length of every segment [m].
    pub(crate) fn rest_lengths(&self) -> Vec<f64> {
        match (&self.segment_lengths, self.length, self.segments) {
            (Some(lengths), _, _) => lengths.clone(),
            (None, Some(length), Some(n)) => vec![length / n as f64; n],
            _ => Vec::new(),
        }
    }
}

fn validate_rod(rod: &RodModel) -> Check {
    one_of("model", ("segment_lengths", rod.segment_lengths.is_some()), ("length", rod.length.is_some()))?;
    if rod.length.is_some() != rod.segments.is_some() {
        return invalid("model", "`length` and `segments` go together");
    }
    if let Some(i) = rod.segment_lengths.as_ref().and_then(|l| l.iter().position(|v| !(*v > 0.0))) {
        return invalid(format!("model.segment_lengths.{i}"), "a segment must be longer than 0 [m]");
    }
    let lengths = rod.rest_lengths();
    if lengths.len() < 2 {
        return invalid("model.segment_lengths", "a rod needs at least 2 segments");
    }
    let total: f64 = lengths.iter().sum();
    let (thickest, key) = match &rod.section {
        Section::Circle { radius } => (*radius, "radius"),
        Section::Ellipse { semi_axes } => (semi_axes[0].max(semi_axes[1]), "semi_axes"),
        Section::Rectangle { width, height } => (0.5 * width.max(*height), "width"),
        Section::Stiffness { .. } => (0.0, "ea"),
    };
    if thickest > total {
        return invalid(
            format!("model.section.{key}"),
            format!(
                "a section {} m thick on a rod {total} m long: lengths are in metres, was another unit meant?",
                2.0 * thickest
            ),
        );
    }
    match (&rod.material, &rod.section) {
        (None, Section::Stiffness { .. }) => {}
        (Some(_), Section::Stiffness { .. }) => {
            return invalid(
                "model.material",
                "the section gives its stiffnesses and mass directly; leave [model.material] out",
            );
        }
        (None, _) => {
            return invalid(
                "model",
                "[model.material] is missing: the section needs youngs_modulus, density and poisson_ratio or shear_modulus",
            );
        }
        (Some(m), _) => one_of(
            "model.material",
            ("poisson_ratio", m.poisson_ratio.is_some()),
            ("shear_modulus", m.shear_modulus.is_some()),
        )?,
    }
    for (clamp, path) in [(&rod.start, "model.start"), (&rod.end, "model.end")] {
        if let Some(clamp) = clamp {
            validate_clamp(clamp, path)?;
        }
    }
    if rod.start.is_none() && rod.end.is_none() && rod.prescribed.is_empty() {
        return invalid(
            "model",
            "nothing holds the rod: give [model.start], [model.end] or [[model.prescribed]]",
        );
    }
    let places =
        rod.point_forces.iter().map(|f| f.arc_length).enumerate().map(|(i, s)| ("point_forces", i, s));
    let masses =
        rod.point_masses.iter().map(|m| m.arc_length).enumerate().map(|(i, s)| ("point_masses", i, s));
    for (list, i, s) in places.chain(masses) {
        on_rod(&format!("model.{list}.{i}.arc_length"), s, total)?;
    }
    match rod.prescribed.iter().position(|p| p.vertex > lengths.len()) {
        Some(i) => invalid(
            format!("model.prescribed.{i}.vertex"),
            format!("the rod has vertices 0 to {}", lengths.len()),
        ),
        None => Ok(()),
    }
}

fn validate_clamp(clamp: &Clamp, path: &str) -> Check {
    let norm = |v: &[f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (t, d) = (&clamp.tangent, &clamp.director);
    for (key, v) in [("tangent", t), ("director", d)] {
        if !(norm(v) > 0.0) {
            return invalid(format!("{path}.{key}"), "a direction cannot be zero");
        }
    }
    let cos = (0..3).map(|i| t[i] * d[i]).sum::<f64>() / (norm(t) * norm(d));
    if cos.abs() > 1.0 - 1e-9 {
        return invalid(
            format!("{path}.director"),
            "m₁ lies across the rod: it cannot point along the tangent",
        );
    }
    Ok(())
}

fn on_rod(path: &str, s: f64, length: f64) -> Check {
    if s >= 0.0 && s <= length * (1.0 + 1e-9) {
        Ok(())
    } else {
        invalid(path, format!("arc length {s} m is off the rod (0 to {length} m)"))
    }
}

fn validate_background(background: &Background, model: &Model) -> Check {
    match (&background.file, background.from) {
        (None, Origin::File) => return invalid("background", "from = \"file\" needs the key `file`"),
        (Some(_), Origin::TruthPlusDraw | Origin::StaticEquilibrium) => {
            return invalid("background.file", "a file is read only with from = \"file\"");
        }
        _ => {}
    }
    if background.from == Origin::StaticEquilibrium && !matches!(model, Model::Rod(_)) {
        return invalid("background.from", "only rods have a static equilibrium");
    }
    validate_covariance(&background.covariance, "background.covariance", model)
}

/// A covariance of a model's control, at `path`.
pub(super) fn validate_covariance(covariance: &Covariance, path: &str, model: &Model) -> Check {
    match (covariance, model) {
        (Covariance::Kernel(k), Model::Rod(_)) => validate_kernel(k, path),
        (Covariance::Line(k), Model::LinearAdvection(_) | Model::Burgers(_)) => {
            validate_taper(k.taper, k.localization_length, path)?;
            match k.taper {
                Taper::Triangle if model.line().is_some_and(|line| line.ends == Ends::Periodic) => invalid(
                    format!("{path}.taper"),
                    "a triangle is no covariance on a circle: take \"gaspari-cohn\"",
                ),
                _ => Ok(()),
            }
        }
        (Covariance::Climatology(_), Model::Lorenz63(_) | Model::Lorenz96(_)) => Ok(()),
        (_, Model::Rod(_)) => invalid(format!("{path}.kind"), "rods take kind = \"kernel\""),
        (Covariance::Diagonal(_), _) => Ok(()),
        (_, Model::Lorenz63(_) | Model::Lorenz96(_)) => {
            invalid(format!("{path}.kind"), "Lorenz models take kind = \"diagonal\" or \"climatology\"")
        }
        (Covariance::Kernel(_) | Covariance::Climatology(_), _) => {
            invalid(format!("{path}.kind"), "a field along a line takes kind = \"line\" or \"diagonal\"")
        }
    }
}

/// What an explicit step can follow, as `varda_implicit::line::Transport` has it.
fn validate_line(model: &Model, line: &Line, integrator: Integrator, step: f64) -> Check {
    if integrator != Integrator::Rk4 {
        return Ok(());
    }
    let h = line.spacing();
    let (speed, diffusivity) = match model {
        Model::LinearAdvection(m) => (m.speed.abs(), m.diffusivity),
        Model::Burgers(m) => (0.0, m.viscosity),
        _ => (0.0, 0.0),
    };
    for (what, number, most) in
        [("ν Δt/h²", diffusivity * step / (h * h), 0.69), ("|c| Δt/h", speed * step / h, 2.8)]
    {
        if !(number <= most) {
            let message = format!(
                "{what} = {number:.3} is beyond {most}, where \"rk4\" blows up: take a smaller step, or \"midpoint\""
            );
            return invalid("time.step", message);
        }
    }
    Ok(())
}

fn validate_taper(taper: Taper, length: Option<f64>, section: &str) -> Check {
    match (taper, length) {
        (Taper::None, Some(_)) => {
            invalid(format!("{section}.localization_length"), "there is no taper to use it")
        }
        (Taper::Triangle | Taper::GaspariCohn, None) => {
            invalid(section, "a taper needs `localization_length` [m]")
        }
        _ => Ok(()),
    }
}

fn validate_kernel(k: &KernelCovariance, section: &str) -> Check {
    one_of(
        section,
        ("sigma_x", k.sigma_x.is_some()),
        ("sigma_x_over_length", k.sigma_x_over_length.is_some()),
    )?;
    one_of(
        section,
        ("sigma_v", k.sigma_v.is_some()),
        ("sigma_v_over_mean_speed", k.sigma_v_over_mean_speed.is_some()),
    )?;
    validate_taper(k.taper, k.localization_length, section)
}

fn validate_synthetic(s: &Synthetic, scene: &Scene, rod: Option<&RodModel>) -> Check {
    let section = "observations";
    one_of(section, ("every", s.every.is_some()), ("steps", s.steps.is_some()))?;
    one_of(section, ("sigma", s.sigma.is_some()), ("sigma_over_length", s.sigma_over_length.is_some()))?;
    if scene.background.from != Origin::TruthPlusDraw {
        return invalid(
            section,
            "synthetic observations need a truth: background.from = \"truth-plus-draw\"",
        );
    }
    let window = scene.time.window;
    if let Some(i) = s.steps.as_ref().and_then(|steps| steps.iter().position(|k| *k > window)) {
        return invalid(
            format!("{section}.steps.{i}"),
            format!("outside the window, which has {window} steps"),
        );
    }
    if s.every.is_some_and(|e| e > window) {
        return invalid(
            format!("{section}.every"),
            format!("no observation falls in the window, which has {window} steps"),
        );
    }
    match rod {
        Some(rod) => {
            let length = rod.rest_lengths().iter().sum();
            if s.places.is_empty() {
                return invalid(section, "a rod needs `places`, the observed arc lengths [m]");
            }
            if !s.components.is_empty() {
                return invalid(
                    format!("{section}.components"),
                    "a rod is observed at `places` (arc lengths)",
                );
            }
            s.places
                .iter()
                .enumerate()
                .try_for_each(|(i, s)| on_rod(&format!("{section}.places.{i}"), *s, length))
        }
        None => {
            let n = scene.model.components().unwrap_or(0);
            if !s.places.is_empty() {
                return invalid(format!("{section}.places"), "this model is observed in `components`");
            }
            if s.sigma_over_length.is_some() {
                return invalid(
                    format!("{section}.sigma_over_length"),
                    "this model has no length; give `sigma`",
                );
            }
            match s.components.iter().position(|c| *c >= n) {
                Some(i) => invalid(
                    format!("{section}.components.{i}"),
                    format!("the model has components 0 to {}", n - 1),
                ),
                None => Ok(()),
            }
        }
    }
}

fn validate_recording(f: &Recording, rod: Option<&RodModel>) -> Check {
    let Some(rod) = rod else {
        return invalid(
            "observations.kind",
            "observations are read from a file for rods only; take kind = \"synthetic\"",
        );
    };
    let length = rod.rest_lengths().iter().sum();
    for (i, marker) in f.markers.iter().enumerate() {
        on_rod(&format!("observations.markers.{i}.arc_length"), marker.arc_length, length)?;
        if f.markers[..i].iter().any(|m| m.name == marker.name) || f.ignore.contains(&marker.name) {
            return invalid(
                format!("observations.markers.{i}.name"),
                format!("marker {:?} is named twice", marker.name),
            );
        }
    }
    validate_frame(&f.frame)
}

fn validate_frame(frame: &Frame) -> Check {
    let path = "observations.frame";
    match (&frame.rotation, &frame.axis, &frame.angle) {
        (Some(_), Some(_), _) | (Some(_), _, Some(_)) => {
            invalid(format!("{path}.rotation"), "give `rotation`, or `axis` and `angle`")
        }
        (None, Some(_), None) | (None, None, Some(_)) => invalid(path, "`axis` and `angle` go together"),
        (None, Some(axis), Some(_)) if !(axis.iter().map(|x| x * x).sum::<f64>() > 0.0) => {
            invalid(format!("{path}.axis"), "an axis cannot be zero")
        }
        (Some(r), None, None) => {
            for i in 0..3 {
                for j in 0..3 {
                    let product: f64 = (0..3).map(|k| r[i][k] * r[j][k]).sum();
                    // Rows written with four digits are meant as a rotation; a mirrored or scaled frame is not.
                    if !((product - f64::from(i == j)).abs() < 1e-3) {
                        return invalid(
                            format!("{path}.rotation"),
                            "its rows are not perpendicular unit vectors",
                        );
                    }
                }
            }
            let det = r[0][0] * (r[1][1] * r[2][2] - r[1][2] * r[2][1])
                - r[0][1] * (r[1][0] * r[2][2] - r[1][2] * r[2][0])
                + r[0][2] * (r[1][0] * r[2][1] - r[1][1] * r[2][0]);
            if det > 0.0 {
                Ok(())
            } else {
                invalid(format!("{path}.rotation"), "it mirrors: its determinant is −1")
            }
        }
        _ => Ok(()),
    }
}
