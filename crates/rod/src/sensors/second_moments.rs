//! Second derivatives of moments within the rod, M = k (ε − ε̄) with strain rates in ε̄.
//!
//! With s = k d of a row d·M, which k leaves as it is where no constant changes it,
//!
//! ```text
//! ∂²(d·M) = s·∂²ε − share s·∂²ε*,   ∂²(d·M)/∂x∂c = (∂k/∂c d)·∂ε + …
//! ```
//!
//! and ∂²(d·M)/∂c² as in [`second_parameters`](crate::second_parameters).

use nalgebra::Vector3;

use super::second::Seen;
use super::second_parameters::WithParameters;
use super::{Placed, Row};
use crate::change::{Parameters, VertexChange};
use crate::element::{self, LOCAL};
use crate::forces_of_motion::Motion;
use crate::forces_tangent::transpose::Weights;
use crate::moved_increment::lower_times_add;
use crate::sensor_rows::Present;
use crate::shape::Shape;
use crate::system::System;

/// The weights of rows on the moments of bent vertices.
fn weighed<'a>(rows: &'a [(Row, f64)]) -> impl Iterator<Item = (usize, [f64; 3])> + 'a {
    rows.iter().flat_map(|(row, dy)| {
        let shares: &[(usize, f64)] = match row.sensor {
            Placed::Moment(shares) if *dy != 0.0 => shares,
            _ => &[],
        };
        shares.iter().map(move |(v, share)| (*v, (row.direction * (dy * share)).into()))
    })
}

/// Σ s ∂ε along the columns of gradients.
fn back(gradient: &[[f64; LOCAL]; 3], stress: &[f64; 3]) -> [f64; LOCAL] {
    std::array::from_fn(|c| (0..3).map(|a| stress[a] * gradient[a][c]).sum())
}

/// Σ s ∂²ε q of a bent vertex.
fn curved(shape: &Shape, vertex: usize, stress: &[f64; 3], q: &[f64; LOCAL]) -> [f64; LOCAL] {
    let (a, b) = (&shape.edges[vertex - 1], &shape.edges[vertex]);
    let mut h = [[0.0; LOCAL]; LOCAL];
    let (turn, directors, strains) = (shape.turn(vertex), shape.directors(vertex), shape.strains(vertex));
    element::strain_hessian_add(a, b, turn, &directors, &strains, stress, &mut h);
    let mut out = [0.0; LOCAL];
    lower_times_add(&h, q, &mut out);
    out
}

impl Present<'_> {
    /// β/Δ of strain rates and what a change does to it, Δ what lies between the two configurations.
    fn rates(&self, motion: &Motion, change: f64) -> [f64; 2] {
        [self.damping.stiffness, change].map(|beta| beta / motion.start.length)
    }

    /// A stress; of a rod that twists nowhere, none about its tangent.
    fn stress(system: &System, [m1, m2, twist]: [f64; 3]) -> [f64; 3] {
        [m1, m2, if system.layout.twist { twist } else { 0.0 }]
    }
}

impl Seen<'_> {
    /// Adds what acts on the two configurations.
    pub(super) fn of_moments(&self, rows: &[(Row, f64)], on: &mut Weights) {
        let Seen { system, motion, present, tangent, .. } = self;
        let share = present.share(motion);
        let past = motion.past.filter(|_| share > 0.0);
        for (v, direction) in weighed(rows) {
            let stress = Present::stress(system, system.bend[v - 1].times(&direction));
            on.now.add_at(v, &curved(&system.shape, v, &stress, &tangent.now.at(v)));
            if let Some(past) = past {
                let stress = stress.map(|s| -share * s);
                on.before.add_at(v, &curved(&past.shape, v, &stress, &tangent.before.at(v)));
            }
            let Some((parameters, dp)) = self.by else { continue };
            for ((parameter, slope), dp) in parameters.list.iter().zip(&parameters.slopes).zip(dp) {
                let (change, times) = (&parameter.change, slope * dp);
                if times == 0.0 {
                    continue;
                }
                let rates = present.rates(motion, change.damping.stiffness);
                let by = system.change_of_vertex(v, change);
                let weights = direction.map(|d| times * d);
                let stress = Present::stress(system, by.stress_of(&weights, rates));
                on.now.add_at(v, &back(&system.shape.strains(v).gradient, &stress));
                if let Some(past) = past {
                    let stress = Present::stress(system, by.stress_of_past(&weights, rates));
                    on.before.add_at(v, &back(&past.strains[v - 1].gradient, &stress));
                }
            }
        }
    }
}

impl WithParameters<'_> {
    /// Adds what parameters do to moments, once and twice.
    pub(super) fn of_moments(&self, rows: &[(Row, f64)], first: &mut [f64], square: &mut [f64]) {
        let WithParameters { parameters, system, motion, present } = self;
        let Parameters { list, slopes, .. } = parameters;
        for (v, direction) in weighed(rows) {
            let direction = Vector3::from(Present::stress(system, direction));
            let value = system.shape.strains(v).value;
            let past = motion.past.map(|past| &past.strains[v - 1].value);
            let of = |i: usize| {
                let change = &list[i].change;
                let [r, dr] = present.rates(motion, change.damping.stiffness);
                (system.change_of_vertex(v, change), [r, dr])
            };
            for (i, first) in first.iter_mut().enumerate() {
                let (by, rates) = of(i);
                let stress = by.stress(&value, rates, past);
                *first += slopes[i] * direction.dot(&Vector3::from(stress));
                for j in 0..=i {
                    let (other, [_, other_dr]) = of(j);
                    let second = VertexChange::second(&by, &other, [rates[1], other_dr], &value, past);
                    parameters.both_add(square, [i, j], direction.dot(&Vector3::from(second)));
                }
            }
        }
    }
}
