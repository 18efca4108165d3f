//! Second derivatives of what sensors read with constants of a rod.
//!
//! With N = ∂E/∂x − F of a vertex and γ the acceleration of gravity,
//!
//! ```text
//! F = m γ,   a = −N/m − α V,   f = Aᵀ(a − γ)
//! ∂²a/∂p² = −N_pp/m + 2 N_p m_p/m² − 2 N m_p²/m³,   each of its parameters in turn
//! ```

use nalgebra::Vector3;

use super::{Placed, Present, Row};
use crate::along::Along;
use crate::change::Parameters;
use crate::forces_of_motion::{Motion, Past};
use crate::forces_tangent::transpose::Weights;
use crate::second_order::Increment;
use crate::second_parameters::Strained;
use crate::system::{PastStrains, System};

/// What an increment of parameters does to masses, to α and to gravity.
pub(super) struct Changed {
    pub(super) masses: Vec<f64>,
    pub(super) damping: f64,
    pub(super) gravity: Vector3<f64>,
}

impl Changed {
    pub(super) fn none(system: &System) -> Changed {
        Changed { masses: vec![0.0; system.x.len()], damping: 0.0, gravity: Vector3::zeros() }
    }

    pub(super) fn of(system: &System, parameters: &Parameters, dp: &[f64]) -> Changed {
        let mut changed = Changed::none(system);
        for ((parameter, slope), dp) in parameters.list.iter().zip(&parameters.slopes).zip(dp) {
            let (change, times) = (&parameter.change, slope * dp);
            changed.masses.iter_mut().zip(&change.masses).for_each(|(m, c)| *m += c * times);
            changed.damping += change.damping.mass * times;
            changed.gravity += parameters.change_of_gravity(change, &system.loads.gravity) * times;
        }
        changed
    }
}

/// What a parameter does to ∂E/∂x and F of every vertex, and to ∂E/∂θ and moments of every edge.
pub(super) struct Forces {
    pub(super) of_vertices: Vec<[Vector3<f64>; 2]>,
    pub(super) of_edges: Vec<[f64; 2]>,
}

impl Forces {
    /// What weights see of them.
    fn seen_by(&self, weights: &Weights) -> f64 {
        let on_vertices = weights.gradient.iter().zip(&weights.loads).zip(&self.of_vertices);
        let on_edges = weights.angles.iter().zip(&weights.moments).zip(&self.of_edges);
        on_vertices.map(|((g, l), [e, f])| g.dot(e) + l.dot(f)).sum::<f64>()
            + on_edges.map(|((a, m), [e, f])| a * e + m * f).sum::<f64>()
    }
}

/// The rod in a state, with its parameters.
pub(super) struct WithParameters<'a> {
    pub(super) parameters: &'a Parameters,
    pub(super) system: &'a System,
    pub(super) motion: &'a Motion<'a>,
    pub(super) present: &'a Present<'a>,
}

/// Strains along weights on ∂E/∂x (in the full order), and those of the past.
pub(super) struct OfStrains {
    along: Along,
    past: PastStrains,
}

impl OfStrains {
    pub(super) fn of(system: &System, weights: &[f64], past: Option<&Past>) -> OfStrains {
        let mut along = Along::default();
        system.along(&Increment(weights), &mut along);
        OfStrains { along, past: past.map_or_else(PastStrains::default, Past::strains) }
    }

    pub(super) fn strained(&self, present: &Present, motion: &Motion) -> Strained<'_> {
        let length = motion.start.length;
        let rate = present.damping.stiffness / length;
        Strained { rate, moves: 1.0 / length, past: &self.past, along: &self.along }
    }
}

impl WithParameters<'_> {
    /// ∂²(Σ dy y)/∂p², row by row; `forces` has what each parameter does to forces, `weights` what
    /// all rows are on them.
    pub(super) fn square(
        &self,
        rows: &[(Row, f64)],
        weights: (&Weights, &[f64]),
        forces: &[Forces],
    ) -> Vec<f64> {
        let WithParameters { parameters, system, motion, present } = self;
        let (m, (weights, full)) = (parameters.len(), weights);
        let alone = |p: usize| -> Vec<f64> { (0..m).map(|i| f64::from(u8::from(i == p))).collect() };
        let changed: Vec<Changed> = (0..m).map(|p| Changed::of(system, parameters, &alone(p))).collect();
        let mut square = vec![0.0; m * m];
        let strains = OfStrains::of(system, full, motion.past);
        parameters.square_add(system, strains.strained(present, motion), &vec![0.0; m], &mut square);
        let mut first = self.of_rows(rows, &changed, forces, &mut square);
        self.of_moments(rows, &mut first, &mut square);
        let on_gravity = self.of_loads(rows, weights, &changed, &mut square);
        self.of_gravity(&on_gravity, &mut square);
        for (p, (first, forces)) in first.iter().zip(forces).enumerate() {
            let first = first + forces.seen_by(weights);
            square[p * m + p] += parameters.curvatures[p] / parameters.slopes[p] * first;
        }
        square
    }

    /// What masses, α and gravity do to rows of accelerations beside forces: adds second derivatives and
    /// returns the first.
    fn of_rows(
        &self,
        rows: &[(Row, f64)],
        changed: &[Changed],
        forces: &[Forces],
        square: &mut [f64],
    ) -> Vec<f64> {
        let WithParameters { system, present, .. } = self;
        let m = changed.len();
        let mut first = vec![0.0; m];
        for (row, dy) in rows {
            let (Placed::Acceleration(place) | Placed::SpecificForce(place, _)) = row.sensor else {
                continue;
            };
            let direction = present.direction(system, row) * *dy;
            if let Placed::SpecificForce(..) = row.sensor {
                first.iter_mut().zip(changed).for_each(|(by, c)| *by -= direction.dot(&c.gravity));
            }
            for (v, share) in [(place.edge, 1.0 - place.fraction), (place.edge + 1, place.fraction)] {
                if !present.is_free[v] {
                    continue;
                }
                let (mass, net) = (system.rod.masses[v], present.net(v));
                let on = direction * share;
                for (i, a) in changed.iter().enumerate() {
                    let slower = present.velocities[v] * a.damping;
                    first[i] += on.dot(&(net * (a.masses[v] / (mass * mass)) - slower));
                    let of = |p: usize| forces[p].of_vertices[v][0] - forces[p].of_vertices[v][1];
                    for (j, b) in changed.iter().enumerate() {
                        let [ma, mb] = [a, b].map(|c| c.masses[v] / mass);
                        let both = of(i) * mb + of(j) * ma - net * (2.0 * ma * mb);
                        square[i * m + j] += on.dot(&both) / mass;
                    }
                }
            }
        }
        first
    }

    /// Weights and inertia of supports: adds what two parameters do to F but for the curvature of gravity,
    /// and returns what all is on gravity.
    fn of_loads(
        &self,
        rows: &[(Row, f64)],
        weights: &Weights,
        changed: &[Changed],
        square: &mut [f64],
    ) -> Vector3<f64> {
        let WithParameters { system, motion, present, .. } = self;
        let m = changed.len();
        let mut on_gravity = Vector3::zeros();
        for (v, on) in weights.loads.iter().enumerate() {
            on_gravity += on * system.rod.masses[v];
            let velocity = motion.held[v][0];
            for (i, a) in changed.iter().enumerate() {
                for (j, b) in changed.iter().enumerate() {
                    let both = (b.gravity - velocity * b.damping) * a.masses[v]
                        + (a.gravity - velocity * a.damping) * b.masses[v];
                    square[i * m + j] += on.dot(&both);
                }
            }
        }
        for (row, dy) in rows {
            if let Placed::SpecificForce(..) = row.sensor {
                on_gravity -= present.direction(system, row) * *dy;
            }
        }
        on_gravity
    }

    fn of_gravity(&self, on_gravity: &Vector3<f64>, square: &mut [f64]) {
        let WithParameters { parameters, system, .. } = self;
        let gravity = &system.loads.gravity;
        let all = || parameters.list.iter().map(|p| &p.change).enumerate();
        for (i, a) in all() {
            for (j, b) in all().take(i + 1) {
                let changes = [a, b].map(|change| parameters.change_of_gravity(change, gravity));
                let second = parameters.second_change_of_gravity([a, b], changes.each_ref(), gravity);
                parameters.both_add(square, [i, j], on_gravity.dot(&second));
            }
        }
    }
}
