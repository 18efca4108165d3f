//! The transpose of what small changes of a state do to the forces within a rod: from weights on forces to
//! weights on states.

use nalgebra::{Vector3, Vector6};

use super::{Increment, Loaded, Tangent};
use crate::shape::Shape;
use crate::system::System;

/// What acts on ∂E/∂x and on the forces of loads at every vertex, on ∂E/∂θ and on the moments of
/// loads at every edge, on velocities, on accelerations of held vertices, and on the two configurations.
pub(crate) struct Weights {
    pub(crate) gradient: Vec<Vector3<f64>>,
    pub(crate) loads: Vec<Vector3<f64>>,
    pub(crate) angles: Vec<f64>,
    pub(crate) moments: Vec<f64>,
    pub(crate) velocities: Vec<Vector3<f64>>,
    pub(crate) accelerations: Vec<Vector3<f64>>,
    pub(crate) now: Increment,
    pub(crate) before: Increment,
}

impl Weights {
    pub(crate) fn new(segments: usize) -> Weights {
        let none = || vec![Vector3::zeros(); segments + 1];
        let [gradient, loads, velocities, accelerations] = [none(), none(), none(), none()];
        let (now, before) = (Increment::new(segments), Increment::new(segments));
        let [angles, moments] = [vec![0.0; segments], vec![0.0; segments]];
        Weights { gradient, loads, angles, moments, velocities, accelerations, now, before }
    }

    /// Adds so many times others.
    pub(crate) fn add(&mut self, other: &Weights, times: f64) {
        let of_vertices = [
            (&mut self.gradient, &other.gradient),
            (&mut self.loads, &other.loads),
            (&mut self.velocities, &other.velocities),
            (&mut self.accelerations, &other.accelerations),
        ];
        for (own, other) in of_vertices {
            own.iter_mut().zip(other).for_each(|(a, b)| *a += b * times);
        }
        for (own, other) in [(&mut self.angles, &other.angles), (&mut self.moments, &other.moments)] {
            own.iter_mut().zip(other).for_each(|(a, b)| *a += b * times);
        }
        self.now.add(&other.now, times);
        self.before.add(&other.before, times);
    }
}

impl Increment {
    /// The transpose of `set`: adds weights on vertices and local angles to those on a state.
    pub(crate) fn transpose_add(&mut self, system: &System, shape: &Shape, dx: &mut [f64]) {
        let layout = &system.layout;
        if layout.bending {
            let first = 6 * layout.free_vertices.len();
            for (i, &e) in layout.free_angles.iter().enumerate() {
                dx[first + i] += self.angles[e];
            }
            shape.holonomy_transpose_add(&self.on_psi(system), &mut self.places);
        }
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            (0..3).for_each(|c| dx[3 * f + c] += self.places[v][c]);
        }
    }

    /// What weights on local angles are on the holonomy of every edge.
    pub(crate) fn on_psi(&self, system: &System) -> Vec<f64> {
        let layout = &system.layout;
        let mut on_psi: Vec<f64> = self.angles.iter().map(|a| -a).collect();
        if layout.twist {
            // an angle that is given turns with its clamp
            let held = |e: &usize| layout.free_angles.binary_search(e).is_err();
            (0..layout.segments).filter(held).for_each(|e| on_psi[e] = 0.0);
        } else if system.supports.end.is_some() {
            *on_psi.last_mut().expect("a rod has an edge") += self.angles.iter().sum::<f64>();
        }
        on_psi
    }

    /// Adds the eleven numbers at a bent vertex.
    pub(crate) fn add_at(&mut self, vertex: usize, q: &[f64; 11]) {
        for (i, first) in [0, 4, 8].into_iter().enumerate() {
            self.places[vertex - 1 + i] += Vector3::from_column_slice(&q[first..first + 3]);
        }
        self.angles[vertex - 1] += q[3];
        self.angles[vertex] += q[7];
    }
}

impl Tangent<'_> {
    /// Adds what weights on ∂E/∂x, ∂E/∂θ and loads are on the two configurations, h apart \[s\].
    pub(crate) fn transpose_add(&self, system: &System, h: f64, on: &mut Weights) {
        let Weights { gradient, loads, angles, moments, now, before, .. } = on;
        for (e, edge) in system.shape.edges.iter().enumerate() {
            let along = gradient[e + 1] - gradient[e];
            if along == Vector3::zeros() {
                continue;
            }
            let add = |on: &mut Increment, force: Vector3<f64>| {
                on.places[e] -= force;
                on.places[e + 1] += force;
            };
            add(now, self.stretched[e].tr_mul(&along));
            if let Some(past) = self.past {
                let (ea, rest) = system.stretch[e];
                let (stress, [by_then, by_now]) =
                    (-ea / rest * self.share * edge.t.dot(&along), past.by_edge[e]);
                add(before, by_then * stress);
                add(now, by_now * stress);
            }
        }
        for (i, (bent, k)) in self.bent.iter().zip(&system.bend).enumerate() {
            let mut weights = [0.0; 11];
            for (v, first) in [0, 4, 8].into_iter().enumerate() {
                weights[first..first + 3].copy_from_slice(gradient[i + v].as_slice());
            }
            [weights[3], weights[7]] = [angles[i], angles[i + 1]];
            if weights == [0.0; 11] {
                continue;
            }
            let by_row = bent.hessian.map(|row| row.iter().zip(&weights).map(|(h, w)| h * w).sum());
            now.add_at(i + 1, &by_row);
            if let Some(past) = self.past {
                let stress = k.times(&bent.strains.along(&weights)).map(|s| -self.share * s);
                let then = &past.strains[i].gradient;
                let on_then = std::array::from_fn(|c| (0..3).map(|a| then[a][c] * stress[a]).sum());
                before.add_at(i + 1, &on_then);
            }
        }
        for &Loaded { edge: e, ref acts } in &self.loaded {
            let [a, b] = [loads[e], loads[e + 1]];
            let force = Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z);
            let by_rates = acts.by_velocities.tr_mul(&force) / h;
            let on_places = acts.by_places.tr_mul(&force) + by_rates + acts.moment_by_places * moments[e];
            for v in 0..2 {
                now.places[e + v] += on_places.fixed_rows::<3>(3 * v);
                before.places[e + v] -= by_rates.fixed_rows::<3>(3 * v);
            }
            now.angles[e] += acts.by_angle.dot(&force) + acts.moment_by_angle * moments[e];
        }
    }
}
