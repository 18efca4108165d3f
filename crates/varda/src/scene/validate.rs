//! What a scene must satisfy beyond the type of each key: keys that exclude or need one another.

use varda_implicit::line::Line;

use super::grid::TimeGrid;
use super::invalid::{Check, invalid};
use super::sizes::validate_sizes;
use super::validate_algorithm::validate_algorithm;
use super::validate_consider::validate_consider;
use super::validate_covariance::validate_covariance;
use super::validate_cycles::validate_cycles;
use super::validate_estimate::validate_estimate;
use super::validate_observations::{
    validate_components, validate_correlation, validate_places, validate_recorded_components,
    validate_recording,
};
use super::validate_recordings::validate_recordings;
use super::validate_rod::validate_rod;
use super::validate_static::validate_static;
use super::{Background, Covariance, Draw, Format, Integrator, Model, Observations, Origin, Scene};

pub(super) fn validate(scene: &Scene) -> Check {
    let rod = match &scene.model {
        Model::Rod(rod) => Some(rod.as_ref()),
        _ => None,
    };
    if let Some(rod) = rod {
        validate_rod(rod)?;
    }
    let integrator = scene.time.integrator;
    match &scene.model {
        Model::Rod(_) => integrator.of_rod().map(|_| ())?,
        Model::Lorenz63(_) | Model::Lorenz96(_) => integrator.of_lorenz()?,
        Model::LinearAdvection(_) | Model::Burgers(_) | Model::KuramotoSivashinsky(_) => {
            integrator.of_line().map(|_| ())?
        }
    }
    if rod.is_none() && scene.time.tolerance.is_some() {
        return invalid("time.tolerance", "time steps are adapted to their error for rods only");
    }
    TimeGrid::of(scene)?;
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
    match (&scene.observations, rod) {
        (Observations::File(recording), Some(rod)) => validate_recording(recording, scene, rod)?,
        (Observations::Synthetic(keys), Some(rod)) => validate_places(keys, scene, rod)?,
        (Observations::File(recording), None) => validate_recorded_components(recording)?,
        (Observations::Synthetic(keys), None) => validate_components(keys, scene)?,
    }
    validate_correlation(scene)?;
    scene.limits.bytes().or_else(|message| invalid("limits.memory", message))?;
    if rod.is_none() && scene.output.formats.contains(&Format::Vtk) {
        let message = "\"vtk\" is a format of curves in space: of this model take \"netcdf\" or \"npz\"";
        return invalid("output.formats", message);
    }
    validate_algorithm(scene)?;
    validate_recordings(scene)?;
    validate_static(scene)?;
    validate_estimate(&scene.estimate, scene)?;
    validate_consider(scene)?;
    if let Some(cycles) = &scene.algorithm.cycles {
        validate_cycles(cycles, scene)?;
    }
    validate_sizes(scene)
}

fn validate_background(background: &Background, model: &Model) -> Check {
    background.source()?;
    if !matches!(model, Model::Rod(_)) {
        background.file_of_components()?;
    }
    validate_covariance(&background.covariance, "background.covariance", model)?;
    let draws_from_kernel = matches!(background.covariance, Covariance::Kernel(_));
    if background.draw == Draw::Kernel && !(draws_from_kernel && background.from == Origin::TruthPlusDraw) {
        return invalid(
            "background.draw",
            "\"kernel\" draws an error from a rod's kernel without its taper: it needs from = \
             \"truth-plus-draw\" and covariance.kind = \"kernel\"",
        );
    }
    Ok(())
}

/// What an explicit step can follow, as `varda_implicit::line::Transport` has it.
fn validate_line(model: &Model, line: &Line, integrator: Integrator, step: f64) -> Check {
    if integrator != Integrator::Rk4 {
        return Ok(());
    }
    let h = line.spacing();
    if let Model::KuramotoSivashinsky(_) = model {
        let number = step / h.powi(4);
        return match number <= 0.17 {
            true => Ok(()),
            false => invalid(
                "time.step",
                format!("Δt/h⁴ = {number:.3} is beyond 0.17, where \"rk4\" blows up: take \"midpoint\""),
            ),
        };
    }
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
                "{what} = {number:.3} is beyond {most}, where \"rk4\" blows up: take a smaller step, or \
                 \"midpoint\""
            );
            return invalid("time.step", message);
        }
    }
    Ok(())
}
