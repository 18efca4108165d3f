//! Tables of the forces and moments within a rod, and of what its supports exert.

use std::fmt::Write;

use varda_rod::InternalForces;

use super::tables::number;
use crate::scene::TimeGrid;

/// Forces of every step from step 1 on, and their standard deviations where there are any.
pub(super) struct Forces<'a> {
    pub(super) grid: &'a TimeGrid,
    pub(super) steps: &'a [InternalForces],
    pub(super) sigma: &'a [InternalForces],
}

impl Forces<'_> {
    /// forces.csv: tension and shear of every edge, at its middle.
    pub(super) fn edges(&self, arc_lengths: &[f64]) -> String {
        let values = |f: &InternalForces, e: usize| {
            let [q1, q2] = f.shear[e];
            [f.tension[e], q1, q2]
        };
        let place = |_: &InternalForces, e: usize| (e, Some(0.5 * (arc_lengths[e] + arc_lengths[e + 1])));
        self.table("edge,s_m", ["tension", "shear_1", "shear_2"].map(|n| (n, "n")), place, values, |f| {
            f.tension.len()
        })
    }

    /// moments.csv: bending and twisting moments of every vertex between two edges.
    pub(super) fn vertices(&self, arc_lengths: &[f64]) -> String {
        let names = ["bending_1", "bending_2", "twisting"].map(|n| (n, "nm"));
        let values = |f: &InternalForces, i: usize| {
            let [m1, m2] = f.bending[i];
            [m1, m2, f.twisting[i]]
        };
        let place = |_: &InternalForces, i: usize| (i + 1, Some(arc_lengths[i + 1]));
        self.table("vertex,s_m", names, place, values, |f| f.twisting.len())
    }

    /// reactions.csv: force and moment of every support on the rod.
    pub(super) fn supports(&self) -> String {
        let names = [("fx", "n"), ("fy", "n"), ("fz", "n"), ("mx", "nm"), ("my", "nm"), ("mz", "nm")];
        let values = |f: &InternalForces, i: usize| {
            let r = &f.reactions[i];
            [r.force.x, r.force.y, r.force.z, r.moment.x, r.moment.y, r.moment.z]
        };
        let vertex = |f: &InternalForces, i: usize| (f.reactions[i].vertex, None);
        self.table("vertex", names, vertex, values, |f| f.reactions.len())
    }

    /// A row a step and place: its number, its arc length if it has one, the values, and σ of each.
    fn table<const N: usize>(
        &self,
        place_names: &str,
        names: [(&str, &str); N],
        place: impl Fn(&InternalForces, usize) -> (usize, Option<f64>),
        values: impl Fn(&InternalForces, usize) -> [f64; N],
        places: impl Fn(&InternalForces) -> usize,
    ) -> String {
        let mut out = format!("step,time_s,{place_names}");
        for (name, unit) in names {
            let _ = write!(out, ",{name}_{unit}");
        }
        if !self.sigma.is_empty() {
            for (name, unit) in names {
                let _ = write!(out, ",sigma_{name}_{unit}");
            }
        }
        out.push('\n');
        for (i, forces) in self.steps.iter().enumerate() {
            let time = number(self.grid.time(i + 1));
            for p in 0..places(forces) {
                let (name, arc_length) = place(forces, p);
                let _ = write!(out, "{},{time},{name}", i + 1);
                let sigma = self.sigma.get(i).map(|sigma| values(sigma, p));
                let all = arc_length.into_iter().chain(values(forces, p)).chain(sigma.into_iter().flatten());
                all.for_each(|v| {
                    let _ = write!(out, ",{}", number(v));
                });
                out.push('\n');
            }
        }
        out
    }
}
