//! What the loads of a rod must satisfy beyond the type of each key.

use super::invalid::{Check, invalid, on_rod};
use super::validate_frame::validate_frame;
use super::{Frame, RodModel};

/// Loads on a rod of this length \[m\].
pub(super) fn validate_loads(rod: &RodModel, length: f64) -> Check {
    for (i, force) in rod.forces.iter().enumerate() {
        let path = format!("model.forces.{i}");
        on_rod(&format!("{path}.arc_length"), force.arc_length, length)?;
        match (&force.force, &force.file) {
            (Some(_), Some(_)) => invalid(format!("{path}.file"), "give `force`, or `file`")?,
            (None, None) => invalid(&path, "give `force` [N], or the `file` of a recorded one")?,
            _ => {}
        }
        recorded(&path, force.file.is_some(), force.time_zero, &force.frame)?;
        if force.follower && force.frame != Frame::default() {
            let message = "a force that follows is given along (m₁, m₂, t), in no other axes";
            return invalid(format!("{path}.frame"), message);
        }
    }
    for (i, moment) in rod.moments.iter().enumerate() {
        let path = format!("model.moments.{i}");
        on_rod(&format!("{path}.arc_length"), moment.arc_length, length)?;
        let given = [moment.moment.is_some(), moment.twist.is_some(), moment.file.is_some()];
        if given.iter().filter(|given| **given).count() != 1 {
            return invalid(&path, "give one of `moment` [N m], `twist` [N m] and `file`");
        }
        recorded(&path, moment.file.is_some(), moment.time_zero, &moment.frame)?;
    }
    Ok(())
}

/// Clock and axes are those of a file.
fn recorded(path: &str, file: bool, time_zero: f64, frame: &Frame) -> Check {
    if !file && time_zero != 0.0 {
        return invalid(format!("{path}.time_zero"), "there is no file whose clock this could be");
    }
    if !file && *frame != Frame::default() {
        return invalid(format!("{path}.frame"), "there is no file whose axes these could be");
    }
    if frame.translation != [0.0; 3] {
        let message = "a force or moment has a direction and no place: only the rotation counts";
        return invalid(format!("{path}.frame.translation"), message);
    }
    validate_frame(frame, &format!("{path}.frame"))
}
