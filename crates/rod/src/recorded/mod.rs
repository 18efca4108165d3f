//! Motions that were recorded: rows of time, place and rotation, followed or smoothed.

mod graduation;
mod motion;
mod rotation;

pub use graduation::{SmoothBy, Smoothing};
pub use motion::{RecordedMotion, noise_of_rows};
pub use rotation::{RecordedRotation, noise_of_rotations};
