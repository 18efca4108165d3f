//! Tables of the natural modes of a rod.

use std::fmt::Write;

use varda_rod::Modes;

use super::tables::{number, optional};
use crate::outcome::RodModes;

/// modes.csv: ω² and the frequency of every mode; no frequency for one that grows.
pub(super) fn frequencies(found: &Modes) -> String {
    let mut out = String::from("mode,omega_squared_1_s2,frequency_hz\n");
    for (i, mode) in found.modes.iter().enumerate() {
        let frequency = optional(mode.frequency());
        let _ = writeln!(out, "{},{},{frequency}", i + 1, number(mode.omega_squared));
    }
    out
}

/// mode_shapes.csv: the rod at rest, and the displacement of every vertex in every mode, the greatest of a
/// mode being 1.
pub(super) fn shapes(modes: &RodModes) -> String {
    let mut out = String::from("mode,vertex,s_m,x_m,y_m,z_m,dx,dy,dz\n");
    for (i, mode) in modes.found.modes.iter().enumerate() {
        let greatest = mode.displacements.iter().map(|d| d.norm()).fold(0.0, f64::max);
        let scale = if greatest > 0.0 { 1.0 / greatest } else { 0.0 };
        let places = modes.arc_lengths.iter().zip(&modes.vertices).zip(&mode.displacements);
        for (v, ((s, x), d)) in places.enumerate() {
            let values = [*s, x[0], x[1], x[2], scale * d.x, scale * d.y, scale * d.z];
            let _ = writeln!(out, "{},{v},{}", i + 1, values.map(number).join(","));
        }
    }
    out
}
