//! What `[model]` of a rod must satisfy beyond the type of each key.

use super::invalid::{Check, invalid, on_rod, rounded};
use super::validate_loads::validate_loads;
use super::validate_support::{validate_clamp, validate_prescribed};
use super::{RodModel, Section, ShapePoints};

pub(super) fn validate_rod(rod: &RodModel) -> Check {
    let lengths = rod.rest_lengths()?;
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
                "a section {} m thick on a rod {} m long: lengths are in metres, was another unit \
                 meant?",
                rounded(2.0 * thickest),
                rounded(total)
            ),
        );
    }
    match &rod.section {
        Section::Circle { .. } | Section::Ellipse { .. } | Section::Rectangle { .. } => {
            rod.solid_material()?;
        }
        Section::Stiffness { .. } if rod.material.is_some() => {
            let message = "the section gives its stiffnesses and mass directly; leave [model.material] out";
            return invalid("model.material", message);
        }
        Section::Stiffness { rotary_inertia: None, .. } if rod.twist_inertia => {
            let message = "`twist_inertia` needs `rotary_inertia` here, ρ(I₁ + I₂) per length [kg m]: \
                           m r²/2 for a full circle of radius r and mass m per length";
            return invalid("model.section.rotary_inertia", message);
        }
        Section::Stiffness { .. } => {}
    }
    if let Some(shape) = &rod.rest_shape {
        validate_shape(&shape.shape(), "model.rest_shape")?;
        if rod.natural_curvature != [0.0; 2] || rod.natural_twist != 0.0 {
            let message = "the rest shape says the natural curvature and twist: leave one of them out";
            return invalid("model.rest_shape", message);
        }
        if shape.director.is_some_and(|d| !(d.iter().any(|c| *c != 0.0))) {
            return invalid("model.rest_shape.director", "a direction cannot be zero");
        }
    }
    if let Some(shape) = &rod.initial_shape {
        validate_shape(shape, "model.initial_shape")?;
    }
    for (clamp, path) in [(&rod.start, "model.start"), (&rod.end, "model.end")] {
        if let Some(clamp) = clamp {
            validate_clamp(clamp, path)?;
        }
    }
    for (i, p) in rod.prescribed.iter().enumerate() {
        validate_prescribed(p, &format!("model.prescribed.{i}"))?;
    }
    if rod.start.is_none() && rod.end.is_none() && rod.prescribed.is_empty() {
        return invalid(
            "model",
            "nothing holds the rod: give [model.start], [model.end] or [[model.prescribed]]",
        );
    }
    for (i, mass) in rod.point_masses.iter().enumerate() {
        on_rod(&format!("model.point_masses.{i}.arc_length"), mass.arc_length, total)?;
    }
    validate_loads(rod, total)?;
    match rod.prescribed.iter().position(|p| p.vertex > lengths.len()) {
        Some(i) => invalid(
            format!("model.prescribed.{i}.vertex"),
            format!("the rod has vertices 0 to {}", lengths.len()),
        ),
        None => Ok(()),
    }
}

/// A shape is in a file or written out, with two points or more.
fn validate_shape(shape: &ShapePoints, path: &str) -> Check {
    match (&shape.file, &shape.points) {
        (Some(_), None) => Ok(()),
        (None, Some(points)) if points.len() >= 2 => Ok(()),
        (None, Some(_)) => invalid(format!("{path}.points"), "a shape has two points or more"),
        _ => invalid(path, "give `file`, or `points`"),
    }
}
