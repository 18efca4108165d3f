//! What `[model]` of a rod must satisfy beyond the type of each key.

use super::invalid::{Check, invalid, one_of};
use super::{Clamp, RodModel, Section};

pub(super) fn validate_rod(rod: &RodModel) -> Check {
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

/// An arc length must lie on the rod.
pub(super) fn on_rod(path: &str, s: f64, length: f64) -> Check {
    if s >= 0.0 && s <= length * (1.0 + 1e-9) {
        Ok(())
    } else {
        invalid(path, format!("arc length {s} m is off the rod (0 to {length} m)"))
    }
}
