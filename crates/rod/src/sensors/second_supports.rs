//! Second derivatives of what sensors read with parameters that move supports.
//!
//! What is read depends on two configurations, on velocities, and on how held vertices accelerate; parameters
//! move these by w_p, as in [`moved_second`](crate::moved_second):
//!
//! ```text
//! ∂²L/∂p∂q = w_pᵀ L_zz w_q + L_zᵀ w_pq
//! ```

use nalgebra::Vector3;

use super::second::{Seen, in_full_order};
use super::second_parameters::{Changed, WithParameters};
use super::{Placed, Present, Row, SHARE, Sensors};
use crate::forces_of_motion::Motion;
use crate::forces_tangent::transpose::Weights;
use crate::forces_tangent::{Increment, moved, moved_by};
use crate::moved_together::Together;
use crate::shape::Shape;
use crate::system::System;

/// What a parameter does to both configurations, and to velocities and accelerations of held vertices.
pub(super) struct Moved {
    pub(super) parameter: usize,
    now: Increment,
    before: Increment,
    pub(super) held: Vec<[Vector3<f64>; 2]>,
}

impl Moved {
    fn acts(&self) -> bool {
        let zero = Vector3::zeros();
        let moves =
            |of: &Increment| of.places.iter().any(|x| *x != zero) || of.angles.iter().any(|a| *a != 0.0);
        moves(&self.now) || moves(&self.before) || self.held.iter().flatten().any(|v| *v != zero)
    }

    fn dot(&self, on: &Weights) -> f64 {
        let of_vertices = |on: &[Vector3<f64>], by: &dyn Fn(usize) -> Vector3<f64>| -> f64 {
            on.iter().enumerate().map(|(v, on)| on.dot(&by(v))).sum()
        };
        increment_dot(&on.now, &self.now.places, &self.now.angles)
            + increment_dot(&on.before, &self.before.places, &self.before.angles)
            + of_vertices(&on.velocities, &|v| self.held[v][0])
            + of_vertices(&on.accelerations, &|v| self.held[v][1])
    }
}

fn increment_dot(on: &Increment, places: &[Vector3<f64>], angles: &[f64]) -> f64 {
    let of_places: f64 = on.places.iter().zip(places).map(|(on, by)| on.dot(by)).sum();
    of_places + on.angles.iter().zip(angles).map(|(on, by)| on * by).sum::<f64>()
}

/// All of them, and the rod with nothing held.
pub(super) struct Supports {
    all: Vec<Moved>,
    all_free: Option<System>,
}

impl Supports {
    pub(super) fn of(system: &System, motion: &Motion, present: &Present) -> Supports {
        let all_free = (!system.moves.is_empty()).then(|| {
            let mut all = system.clone();
            all.layout = system.layout.all_free();
            all
        });
        let of = |parameter: usize| {
            let [now, before] = moved(system, motion, parameter, present.times);
            let held = match motion.interval {
                Some(h) => moved_by(system, parameter, h, present.times[0]),
                None => vec![[Vector3::zeros(); 2]; system.x.len()],
            };
            Moved { parameter, now, before, held }
        };
        // errors in time act about one time
        let all = system.moves.parameters().into_iter().map(of).filter(Moved::acts);
        Supports { all: all.collect(), all_free }
    }

    /// Whether there are parameters that may move any.
    pub(super) fn moves(&self) -> bool {
        self.all_free.is_some()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Moved> {
        self.all.iter()
    }

    /// The rod that bands are of.
    pub(super) fn bands<'a>(&'a self, system: &'a System) -> &'a System {
        self.all_free.as_ref().unwrap_or(system)
    }

    /// Adds what a parameter of constants does with all of these: `on` is what its increment acts with.
    pub(super) fn with_constant(&self, p: usize, on: &Weights, square: &mut [f64]) {
        let m = square.len().isqrt();
        for moved in &self.all {
            let second = moved.dot(on);
            square[moved.parameter * m + p] += second;
            square[p * m + moved.parameter] += second;
        }
    }

    /// The same of one of these.
    pub(super) fn with_another(&self, p: usize, on: &Weights, square: &mut [f64]) {
        let m = square.len().isqrt();
        self.all.iter().for_each(|moved| square[moved.parameter * m + p] += moved.dot(on));
    }

    /// Adds L_zᵀ w_pq; `on` is what all rows are on forces, velocities and configurations.
    pub(super) fn twice_add(&self, seen: &Seen, mut on: Weights, square: &mut [f64]) {
        let Seen { system, motion, present, tangent, .. } = seen;
        tangent.transpose_add(system, motion.start.length, &mut on);
        let loads = on.loads.clone();
        seen.of_held(&loads, &mut on);
        let m = square.len().isqrt();
        let mut together = Together::default();
        let mut add = |shape: &Shape, t: f64, on: &Increment| {
            together.set(system, shape, t);
            together.each_pair(system, (shape, t), |[p, q], (places, angles), _| {
                let second = increment_dot(on, places, angles);
                square[p * m + q] += second;
                if p != q {
                    square[q * m + p] += second;
                }
            });
        };
        let [now, before] = present.times;
        add(&system.shape, now, &on.now);
        add(motion.past.map_or(&system.shape, |past| &past.shape), before, &on.before);
        let Some(h) = motion.interval else { return };
        // differences over h, as velocities and accelerations of supports are
        let mut of_held = |t: f64, by_velocity: f64, by_acceleration: f64| {
            let mut held = Increment::new(system.rod.segments());
            for (v, place) in held.places.iter_mut().enumerate() {
                *place = on.velocities[v] * by_velocity + on.accelerations[v] * by_acceleration;
            }
            add(&system.shape, t, &held);
        };
        of_held(now - h, -0.5 / h, 1.0 / (h * h));
        of_held(now, 0.0, -2.0 / (h * h));
        of_held(now + h, 0.5 / h, 1.0 / (h * h));
    }
}

impl Sensors {
    /// Fills zeros with Σ_i dy_i ∂²y_i/∂x∂p, a column a parameter, and ∂²/∂p² by rows.
    pub(super) fn second_of_parameters(&mut self, t: f64, x: &[f64], dy: &[f64], numbers: &mut [f64]) {
        let (history, back) = (self.step.repeated(), SHARE * self.interval);
        let Some(parameters) = self.step.parameters.take() else { return };
        let (columns, square) = numbers.split_at_mut(parameters.len() * x.len());
        let zero = vec![0.0; x.len()];
        let done = self.with_state(t, x, &mut |system, motion, present| {
            let rows = present.weighed(dy);
            let supports = Supports::of(system, motion, present);
            let changes = parameters.of_constants(system, motion, &present.damping);
            let mut tangent = present.tangent(system, motion, changes);
            let mut forces = Vec::new();
            for (p, column) in columns.chunks_exact_mut(x.len()).enumerate() {
                let mut dp = vec![0.0; parameters.len()];
                dp[p] = 1.0;
                tangent.vary(system, motion.start.length, [&zero, &zero, &dp]);
                if !parameters.list[p].change.is_of_constants() {
                    forces.push(Seen::of(system, motion, present, &tangent).forces());
                    continue;
                }
                let changed = Changed::of(system, &parameters, &dp);
                let by = Some((&*parameters, &dp[..]));
                let of = Seen::of(system, motion, present, &tangent);
                let seen = Seen { bands: supports.bands(system), dx: &zero, changed, by, ..of };
                let mut on = seen.second(&rows);
                supports.with_constant(p, &on, square);
                present.onto_state(system, motion, &mut on, (history, back), column);
                forces.push(seen.forces());
            }
            let weights = present.on_forces(system, motion, &rows);
            let full = in_full_order(system, &weights.gradient, &weights.angles);
            let with = WithParameters { parameters: &parameters, system, motion, present };
            let of_constants = with.square(&rows, (&weights, &full), &forces);
            square.iter_mut().zip(of_constants).for_each(|(sum, more)| *sum += more);
            if supports.moves() {
                let changes = parameters.of_supports(system, motion, &present.damping, present.times);
                let mut tangent = present.tangent(system, motion, changes);
                for moved in supports.iter() {
                    let mut dp = vec![0.0; parameters.len()];
                    dp[moved.parameter] = 1.0;
                    tangent.vary(system, motion.start.length, [&zero, &zero, &dp]);
                    let of = Seen::of(system, motion, present, &tangent);
                    let held = Some(&moved.held[..]);
                    let seen = Seen { bands: supports.bands(system), dx: &zero, held, ..of };
                    let mut on = seen.second(&rows);
                    supports.with_another(moved.parameter, &on, square);
                    let column = &mut columns[moved.parameter * x.len()..][..x.len()];
                    present.onto_state(system, motion, &mut on, (history, back), column);
                }
                let seen = Seen::of(system, motion, present, &tangent);
                supports.twice_add(&seen, weights, square);
            }
        });
        done.expect("this state was observed before");
        self.step.parameters = Some(parameters);
    }
}

impl Seen<'_> {
    /// Adds what loads, with the inertia of held vertices in them, are on their velocities and accelerations:
    /// `first` is what rows are on loads.
    pub(super) fn of_held(&self, first: &[Vector3<f64>], on: &mut Weights) {
        let Seen { system, present, changed, .. } = self;
        let alpha = present.damping.mass;
        for v in (0..system.x.len()).filter(|&v| !present.is_free[v]) {
            let (mass, more) = (system.rod.masses[v], changed.masses[v]);
            let by_acceleration = on.loads[v] * mass + first[v] * more;
            on.accelerations[v] -= by_acceleration;
            on.velocities[v] -= by_acceleration * alpha + first[v] * (mass * changed.damping);
        }
    }

    /// Adds what a clamp that moves does to the moment that it takes, (x_b − x_a) × N_b + t τ.
    pub(super) fn of_clamps(&self, rows: &[(Row, f64)], on: &mut Weights) {
        let Seen { system, present, tangent, .. } = self;
        for (row, dy) in rows.iter().filter(|(_, dy)| *dy != 0.0) {
            let &Placed::ClampMoment([vertex, beside, e]) = row.sensor else { continue };
            let (d, edge) = (row.direction * *dy, &system.shape.edges[e]);
            let moved = self.edge_moved(e);
            let longer = edge.t.dot(&moved);
            let dt = (moved - edge.t * longer) / edge.l;
            let by_force = d.cross(&(tangent.now.places[beside] - tangent.now.places[vertex]));
            on.gradient[beside] += by_force;
            on.loads[beside] -= by_force;
            on.angles[e] += d.dot(&dt);
            on.moments[e] -= d.dot(&dt);
            let by_arm = self.net(beside, true).cross(&d);
            on.now.places[beside] += by_arm;
            on.now.places[vertex] -= by_arm;
            // of d τ on t: (I − t tᵀ) d τ/l
            let turned = match system.layout.twist {
                true => tangent.gradient[system.layout.angle(e)] - tangent.loads.moments[e],
                false => 0.0,
            };
            let along = edge.t.dot(&d);
            let across = d - edge.t * along;
            let curved = dt * along + edge.t * dt.dot(&d) + across * (longer / edge.l);
            let by_edge = (across * turned - curved * present.about_tangent[e]) / edge.l;
            on.now.places[e] -= by_edge;
            on.now.places[e + 1] += by_edge;
        }
    }
}
