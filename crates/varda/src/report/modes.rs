//! Tables of the natural modes of a rod.

use std::fmt::Write;

use super::tables::{number, optional};
use crate::outcome::RodModes;

/// modes.csv: ω² and the frequency of every mode; no frequency for one that grows. With twist inertia the
/// share of spins in its kinetic energy, one for a mode of twist alone.
pub(super) fn frequencies(modes: &RodModes) -> String {
    let mut out = String::from("mode,omega_squared_1_s2,frequency_hz");
    out.push_str(if modes.spins() { ",spin_share\n" } else { "\n" });
    for (i, mode) in modes.found.modes.iter().enumerate() {
        let frequency = optional(mode.frequency());
        let _ = write!(out, "{},{},{frequency}", i + 1, number(mode.omega_squared));
        if modes.spins() {
            let _ = write!(out, ",{}", number(modes.spin_share(mode)));
        }
        out.push('\n');
    }
    out
}

/// mode_shapes.csv: the rod at rest, and the displacement of every vertex in every mode, the greatest of a
/// mode being 1. With twist inertia also the turn of the edge after the vertex, as the way r φ of a point at
/// the radius of gyration r; the greatest of both is then 1.
pub(super) fn shapes(modes: &RodModes) -> String {
    let mut out = String::from("mode,vertex,s_m,x_m,y_m,z_m,dx,dy,dz");
    out.push_str(if modes.spins() { ",r_turn\n" } else { "\n" });
    for (i, mode) in modes.found.modes.iter().enumerate() {
        let turns = mode.turns.iter().filter(|_| modes.spins()).map(|turn| modes.gyration * turn);
        let turns: Vec<f64> = turns.collect();
        let sizes = mode.displacements.iter().map(|d| d.norm()).chain(turns.iter().map(|turn| turn.abs()));
        let greatest = sizes.fold(0.0, f64::max);
        let scale = if greatest > 0.0 { 1.0 / greatest } else { 0.0 };
        let places = modes.arc_lengths.iter().zip(&modes.vertices).zip(&mode.displacements);
        for (v, ((s, x), d)) in places.enumerate() {
            let values = [*s, x[0], x[1], x[2], scale * d.x, scale * d.y, scale * d.z];
            let _ = write!(out, "{},{v},{}", i + 1, values.map(number).join(","));
            if modes.spins() {
                let _ = write!(out, ",{}", optional(turns.get(v).map(|turn| scale * turn)));
            }
            out.push('\n');
        }
    }
    out
}
