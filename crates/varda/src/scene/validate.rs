//! What a scene must satisfy beyond the type of each key: keys that exclude or need one another.

use varda_implicit::line::Line;

use super::invalid::{Check, invalid, one_of};
use super::sizes::validate_sizes;
use super::validate_algorithm::validate_algorithm;
use super::validate_covariance::validate_covariance;
use super::validate_cycles::validate_cycles;
use super::validate_observations::{validate_recording, validate_synthetic};
use super::validate_rod::validate_rod;
use super::{Background, Integrator, Model, Observations, Origin, RodModel, Scene};

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
