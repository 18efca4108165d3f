//! Tables of the forces and moments within a rod, and of what its supports exert.

use std::fmt::Write;

use varda_rod::InternalForces;

use super::tables::number;
use crate::scene::TimeGrid;

/// forces.csv: tension and shear of every edge, at its middle, from step 1 on.
pub(super) fn edges(grid: &TimeGrid, steps: &[InternalForces], arc_lengths: &[f64]) -> String {
    let mut out = String::from("step,time_s,edge,s_m,tension_n,shear_1_n,shear_2_n\n");
    for (k, forces) in numbered(steps) {
        let time = number(grid.time(k));
        for (e, (tension, [q1, q2])) in forces.tension.iter().zip(&forces.shear).enumerate() {
            let middle = 0.5 * (arc_lengths[e] + arc_lengths[e + 1]);
            let values = [middle, *tension, *q1, *q2].map(number).join(",");
            let _ = writeln!(out, "{k},{time},{e},{values}");
        }
    }
    out
}

/// moments.csv: bending and twisting moments of every vertex between two edges, from step 1 on.
pub(super) fn vertices(grid: &TimeGrid, steps: &[InternalForces], arc_lengths: &[f64]) -> String {
    let mut out = String::from("step,time_s,vertex,s_m,bending_1_nm,bending_2_nm,twisting_nm\n");
    for (k, forces) in numbered(steps) {
        let time = number(grid.time(k));
        for (i, ([m1, m2], twist)) in forces.bending.iter().zip(&forces.twisting).enumerate() {
            let values = [arc_lengths[i + 1], *m1, *m2, *twist].map(number).join(",");
            let _ = writeln!(out, "{k},{time},{},{values}", i + 1);
        }
    }
    out
}

/// reactions.csv: force and moment of every support on the rod, from step 1 on.
pub(super) fn supports(grid: &TimeGrid, steps: &[InternalForces]) -> String {
    let mut out = String::from("step,time_s,vertex,fx_n,fy_n,fz_n,mx_nm,my_nm,mz_nm\n");
    for (k, forces) in numbered(steps) {
        let time = number(grid.time(k));
        for r in &forces.reactions {
            let values: Vec<String> = r.force.iter().chain(r.moment.iter()).map(|v| number(*v)).collect();
            let _ = writeln!(out, "{k},{time},{},{}", r.vertex, values.join(","));
        }
    }
    out
}

/// Every step with its number: the first is 1.
fn numbered(steps: &[InternalForces]) -> impl Iterator<Item = (usize, &InternalForces)> {
    steps.iter().enumerate().map(|(i, forces)| (i + 1, forces))
}
