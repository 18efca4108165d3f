//! What the supports of a rod must satisfy beyond the type of each key.

use super::invalid::{Check, invalid};
use super::motion::Said;
use super::validate_frame::validate_frame;
use super::{Clamp, Motion, PoseValues, Prescribed, Turns};

pub(super) fn validate_clamp(clamp: &Clamp, path: &str) -> Check {
    if let Some(Turns::Constant(turns)) = clamp.turns
        && !turns.is_finite()
    {
        return invalid(format!("{path}.turns"), format!("{turns} turns are impossible"));
    }
    let said = validate_motion(clamp.motion.as_ref(), path)?;
    place(&clamp.position, clamp.motion.as_ref(), said, path)?;
    needed("tangent", clamp.tangent.is_some(), said.tangent, path)?;
    needed("director", clamp.director.is_some(), said.director, path)?;
    for (key, v) in [("tangent", &clamp.tangent), ("director", &clamp.director)] {
        if let Some(v) = v {
            direction(v, &format!("{path}.{key}"))?;
        }
    }
    match (&clamp.tangent, &clamp.director) {
        (Some(t), Some(d)) => across(t, d, &format!("{path}.director")),
        _ => Ok(()),
    }
}

pub(super) fn validate_prescribed(vertex: &Prescribed, path: &str) -> Check {
    let said = validate_motion(vertex.motion.as_ref(), path)?;
    place(&vertex.position, vertex.motion.as_ref(), said, path)
}

fn place(position: &Option<[f64; 3]>, motion: Option<&Motion>, said: Said, path: &str) -> Check {
    // A table of places has always been allowed beside a position.
    let said = said.place && !(position.is_some() && matches!(motion, Some(Motion::Table(_))));
    if let (None, false, Some(Motion::Table(_))) = (position, said, motion) {
        let message = format!(
            "[{path}] needs the key `position`, or motion.values = \"absolute\" where the table has places \
             and not displacements"
        );
        return invalid(path, message);
    }
    needed("position", position.is_some(), said, path)
}

/// A key is there, or the motion says what it would say; not both.
fn needed(key: &str, given: bool, said: bool, path: &str) -> Check {
    match (given, said) {
        (false, false) => invalid(path, format!("[{path}] needs the key `{key}`")),
        (true, true) => invalid(
            format!("{path}.{key}"),
            format!("the motion says it: leave `{key}` out, or say motion.values = \"displacement\""),
        ),
        _ => Ok(()),
    }
}

fn validate_motion(motion: Option<&Motion>, path: &str) -> Result<Said, super::Invalid> {
    let path = format!("{path}.motion");
    let Some(motion) = motion else { return Ok(Said { place: false, tangent: false, director: false }) };
    let either = |cutoff: &Option<f64>, sigma: bool| match cutoff {
        Some(_) if sigma => invalid(format!("{path}.cutoff"), "give `cutoff`, or a `sigma`"),
        _ => Ok(()),
    };
    match motion {
        Motion::Ellipse { .. } => {}
        Motion::Table(keys) => {
            validate_frame(&keys.frame, &format!("{path}.frame"))?;
            either(&keys.cutoff, keys.sigma.is_some())?;
        }
        Motion::Pose(keys) => {
            validate_frame(&keys.frame, &format!("{path}.frame"))?;
            either(&keys.cutoff, keys.sigma.is_some() || keys.sigma_angle.is_some())?;
            direction(&keys.tangent_axis, &format!("{path}.tangent_axis"))?;
            direction(&keys.director_axis, &format!("{path}.director_axis"))?;
            across(&keys.tangent_axis, &keys.director_axis, &format!("{path}.director_axis"))?;
        }
        Motion::Markers(keys) => {
            either(&keys.cutoff, keys.sigma.is_some())?;
            if keys.names.is_empty() {
                invalid(format!("{path}.names"), "name one marker, two along the tangent, or three or more")?;
            }
            if let Some(i) = (1..keys.names.len()).find(|i| keys.names[..*i].contains(&keys.names[*i])) {
                let message = format!("marker {:?} is named twice", keys.names[i]);
                invalid(format!("{path}.names.{i}"), message)?;
            }
            let rigid = keys.names.len() >= 3 && keys.values == PoseValues::Absolute;
            if keys.offset != [0.0; 3] && !rigid {
                let message = "an offset needs three markers whose directions are the rod's";
                invalid(format!("{path}.offset"), message)?;
            }
        }
    }
    Ok(motion.says())
}

fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn direction(v: &[f64; 3], path: &str) -> Check {
    if norm(v) > 0.0 { Ok(()) } else { invalid(path, "a direction cannot be zero") }
}

fn across(t: &[f64; 3], d: &[f64; 3], path: &str) -> Check {
    let cos = (0..3).map(|i| t[i] * d[i]).sum::<f64>() / (norm(t) * norm(d));
    if cos.abs() > 1.0 - 1e-9 {
        return invalid(path, "m₁ lies across the rod: it cannot point along the tangent");
    }
    Ok(())
}
