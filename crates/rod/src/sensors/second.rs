//! Second derivatives of what sensors read.
//!
//! A row is d·f, of an axis d of its section or of space, and of f, a sum of ∂E/∂x and loads, or a
//! velocity over a length. With W what all rows together are on ∂E/∂x (and on ∂E/∂θ, of moments of
//! clamps),
//!
//! ```text
//! Σ ∂²(d·f) = Wᵀ ∂²(∂E/∂x) + Σ (∂fᵀ ∂d + ∂dᵀ ∂f + f·∂²d)
//! ```
//!
//! The first is the third derivative of the energy as in a step ([`second_order`](crate::second_order)).
//! Angles are not in equilibrium here: ∂E/∂x is taken with directors carried from where an edge is, which
//! adds −A(x) ∂E/∂α with A the form of [`loaded`](crate::loaded), so that KᵀH and H K of the
//! angles count twice, and ∂E/∂α with the curvature of A. That is of W on ∂E/∂x: ∂E/∂α is the
//! same however directors are carried. Stored angles are α + ψ(x), and ψ is curved.

use nalgebra::Vector3;
use varda_implicit::At;
use varda_linalg::dot;

use super::second_parameters::{Changed, Forces, OfStrains};
use super::{Placed, Present, Row, SHARE, Sensors, earlier};
use crate::change::Parameters;
use crate::element::STRAINS;
use crate::forces_of_motion::{Motion, Past};
use crate::forces_tangent::transpose::Weights;
use crate::forces_tangent::{Increment, Tangent};
use crate::layout::band_product_add;
use crate::second_order;
use crate::system::System;

/// Numbers of a configuration in the order of the unknowns: an increment, and what acts on it.
struct Unknowns {
    band: Vec<f64>,
    by: Vec<f64>,
    on: Vec<f64>,
}

impl Unknowns {
    fn of(system: &System, moved: &Increment) -> Unknowns {
        let layout = &system.layout;
        let mut by = vec![0.0; layout.unknowns];
        layout.take(&in_full_order(system, &moved.places, &moved.angles), &mut by);
        Unknowns { band: vec![0.0; layout.band()], by, on: vec![0.0; layout.unknowns] }
    }

    /// Adds the product of the band and what acts beside it to a configuration.
    fn onto(mut self, system: &System, on: &mut Increment) {
        let layout = &system.layout;
        band_product_add(layout.half_bandwidth, &self.band, &self.by, &mut self.on);
        let mut full = vec![0.0; layout.full()];
        layout.fill(&self.on, &mut full);
        for (v, place) in on.places.iter_mut().enumerate() {
            *place += Vector3::from_column_slice(&full[layout.vertex(v)..layout.vertex(v) + 3]);
        }
        if layout.twist {
            on.angles.iter_mut().enumerate().for_each(|(e, angle)| *angle += full[layout.angle(e)]);
        }
    }
}

pub(super) fn in_full_order(system: &System, places: &[Vector3<f64>], angles: &[f64]) -> Vec<f64> {
    let layout = &system.layout;
    let mut full = vec![0.0; layout.full()];
    for (v, place) in places.iter().enumerate() {
        full[layout.vertex(v)..layout.vertex(v) + 3].copy_from_slice(place.as_slice());
    }
    if layout.twist {
        angles.iter().enumerate().for_each(|(e, angle)| full[layout.angle(e)] = *angle);
    }
    full
}

impl Sensors {
    /// (out, out_p) += Σ_i dy_i ∂²y_i/∂(x, p)² (dx, dp) of all parameters p of the rod's step, at a
    /// state that was observed before with these.
    ///
    /// # Panics
    /// If a slice has the wrong length.
    pub fn second_with_parameters_add(
        &mut self,
        at: At,
        x: &[f64],
        [dx, dp]: [&[f64]; 2],
        dy: &[f64],
        [out, out_p]: [&mut [f64]; 2],
    ) {
        assert_eq!((dy.len(), dp.len(), out_p.len()), (self.rows, self.parameters(), self.parameters()));
        self.second_add(at.time, x, dx, dy, out);
        let (states, of) = (x.len(), [x, dy].concat());
        let mut known = std::mem::take(&mut self.known_second);
        let numbers = known.at(at, &of, |numbers| self.second_of_parameters(at.time, x, dy, numbers));
        let (columns, square) = numbers.split_at(dp.len() * states);
        let columns = columns.chunks_exact(states).zip(square.chunks_exact(dp.len().max(1)));
        for (((column, row), out_p), moved) in columns.zip(out_p).zip(dp) {
            out.iter_mut().zip(column).for_each(|(out, c)| *out += c * moved);
            *out_p += dot(column, dx) + dot(row, dp);
        }
        self.known_second = known;
    }

    /// out += Σ_i dy_i ∂²y_i/∂x² dx.
    pub(super) fn second_add(&mut self, t: f64, x: &[f64], dx: &[f64], dy: &[f64], out: &mut [f64]) {
        let mut dx_before = vec![0.0; x.len()];
        earlier(&self.step, SHARE, self.interval, dx, &mut dx_before);
        let (history, back) = (self.step.repeated(), SHARE * self.interval);
        let done = self.with_state(t, x, &mut |system, motion, present| {
            let rows = present.weighed(dy);
            let mut tangent = present.tangent(system, motion, Vec::new());
            tangent.vary(system, motion.start.length, [dx, &dx_before, &[]]);
            let changed = Changed::none(system);
            let of = Seen::of(system, motion, present, &tangent);
            let seen = Seen { dx, changed, ..of };
            let mut on = seen.second(&rows);
            present.onto_state(system, motion, &mut on, (history, back), out);
        });
        done.expect("this state was observed before");
    }
}

impl Present<'_> {
    /// The rows with what acts on each.
    pub(super) fn weighed(&self, dy: &[f64]) -> Vec<(Row<'_>, f64)> {
        self.rows().into_iter().zip(dy.iter().copied()).collect()
    }

    /// What all rows are on forces, velocities and configurations.
    pub(super) fn on_forces(&self, system: &System, motion: &Motion, rows: &[(Row, f64)]) -> Weights {
        let mut on = Weights::new(system.rod.segments());
        for (row, dy) in rows {
            on.add(&self.weights(system, motion, row), *dy);
        }
        on
    }
}

/// The rod in a state, and its forces along an increment.
pub(super) struct Seen<'a> {
    pub(super) system: &'a System,
    pub(super) motion: &'a Motion<'a>,
    pub(super) present: &'a Present<'a>,
    pub(super) tangent: &'a Tangent<'a>,
    /// The rod with nothing held, where parameters move supports.
    pub(super) bands: &'a System,
    pub(super) dx: &'a [f64],
    /// What held vertices are faster by, and accelerate.
    pub(super) held: Option<&'a [[Vector3<f64>; 2]]>,
    pub(super) changed: Changed,
    /// Parameters and their increment.
    pub(super) by: Option<(&'a Parameters, &'a [f64])>,
}

impl<'a> Seen<'a> {
    /// Without an increment of what is beside the tangent.
    pub(super) fn of(
        system: &'a System,
        motion: &'a Motion<'a>,
        present: &'a Present<'a>,
        tangent: &'a Tangent<'a>,
    ) -> Seen<'a> {
        let changed = Changed::none(system);
        Seen { system, motion, present, tangent, bands: system, dx: &[], held: None, changed, by: None }
    }
}

impl Seen<'_> {
    /// What acts on configurations and velocities.
    pub(super) fn second(&self, rows: &[(Row, f64)]) -> Weights {
        let Seen { system, motion, present, tangent, .. } = self;
        let mut first = present.on_forces(system, motion, rows);
        let mut on = Weights::new(system.rod.segments());
        self.of_axes(rows, &mut on);
        self.of_rotations(rows, &mut on.now);
        self.of_moments(rows, &mut on);
        self.of_clamps(rows, &mut on);
        if system.layout.twist {
            self.of_carried(&first.gradient, &mut on);
        }
        tangent.transpose_add(system, motion.start.length, &mut on);
        let loads = first.loads.clone();
        self.of_forces(&mut first, &mut on);
        self.of_held(&loads, &mut on);
        on
    }

    /// What the increment does to forces.
    pub(super) fn forces(&self) -> Forces {
        let Seen { system, tangent, .. } = self;
        let of_vertex = |v: usize| [self.net(v, false), tangent.loads.forces[v]];
        let of_edge = |e: usize| match system.layout.twist {
            true => [tangent.gradient[system.layout.angle(e)], tangent.loads.moments[e]],
            false => [0.0; 2],
        };
        let n = system.rod.segments();
        Forces { of_vertices: (0..=n).map(of_vertex).collect(), of_edges: (0..n).map(of_edge).collect() }
    }

    pub(super) fn edge_moved(&self, e: usize) -> Vector3<f64> {
        self.tangent.now.places[e + 1] - self.tangent.now.places[e]
    }

    /// δV of a vertex.
    fn faster(&self, v: usize) -> Vector3<f64> {
        match self.system.layout.free_vertices.binary_search(&v) {
            Ok(f) => {
                Vector3::from_column_slice(&self.dx[3 * (self.system.layout.free_vertices.len() + f)..][..3])
            }
            Err(_) => self.held.map_or_else(Vector3::zeros, |held| held[v][0]),
        }
    }

    /// δ(∂E/∂x_v), less that of loads where they count.
    pub(super) fn net(&self, v: usize, loaded: bool) -> Vector3<f64> {
        let first = self.system.layout.vertex(v);
        let elastic = Vector3::from_column_slice(&self.tangent.gradient[first..first + 3]);
        if loaded { elastic - self.tangent.loads.forces[v] } else { elastic }
    }

    /// δf of a row, whose f is `measured`.
    fn measured(&self, row: &Row, measured: &Vector3<f64>) -> Vector3<f64> {
        match row.sensor {
            Placed::Force(sum) | Placed::Along(sum, _) => {
                sum.vertices.clone().map(|v| self.net(v, sum.loaded)).sum::<Vector3<f64>>() * sum.sign
            }
            Placed::Acceleration(place) | Placed::SpecificForce(place, _) => {
                let of = |v: usize| match self.present.is_free[v] {
                    true => {
                        let mass = self.system.rod.masses[v];
                        let net = self.net(v, true) - self.present.net(v) * (self.changed.masses[v] / mass);
                        -net / mass
                            - self.faster(v) * self.present.damping.mass
                            - self.present.velocities[v] * self.changed.damping
                    }
                    false => self.held.map_or_else(Vector3::zeros, |held| held[v][1]),
                };
                let gravity = match row.sensor {
                    Placed::SpecificForce(..) => self.changed.gravity,
                    _ => Vector3::zeros(),
                };
                of(place.edge) * (1.0 - place.fraction) + of(place.edge + 1) * place.fraction - gravity
            }
            Placed::AngularRate(e) => {
                let edge = &self.system.shape.edges[*e];
                let longer = edge.t.dot(&self.edge_moved(*e));
                (self.faster(e + 1) - self.faster(*e) - measured * longer) / edge.l
            }
            _ => Vector3::zeros(),
        }
    }

    /// ∂fᵀ ∂d + ∂dᵀ ∂f + f·∂²d of all rows, and ∂²f of those that divide by a length.
    fn of_axes(&self, rows: &[(Row, f64)], on: &mut Weights) {
        let Seen { system, motion, present, tangent, .. } = self;
        for (row, dy) in rows.iter().filter(|(_, dy)| *dy != 0.0) {
            let measured = present.measured(system, motion, row);
            let varied = self.measured(row, &measured);
            let mut of = Weights::new(system.rod.segments());
            self.of_masses(row, &mut of);
            let Some((e, axis)) = present.axis(row) else {
                on.add(&of, *dy);
                continue;
            };
            present.turn_weights(system, row, &varied, &mut of);
            let edge = &system.shape.edges[e];
            let (moved, turned) = (self.edge_moved(e), tangent.now.angles[e]);
            let ends = [tangent.now.places[e], tangent.now.places[e + 1]];
            let on_edge = &mut of.now.places[e..e + 2];
            system.offset_second_add(e, [&measured, &axis], (ends, turned), on_edge, &mut of.now.angles[e]);
            // δd: δm₁ = −(m₁·δt) t + δφ m₂, δm₂ = −(m₂·δt) t − δφ m₁
            let (m1, m2) = (system.shape.m1[e], system.shape.m2[e]);
            let longer = edge.t.dot(&moved);
            let dt = (moved - edge.t * longer) / edge.l;
            let across = m1 * axis.x + m2 * axis.y;
            let direction = (m2 * axis.x - m1 * axis.y) * turned - edge.t * across.dot(&dt) + dt * axis.z;
            present.force_weights(system, row, &direction, &measured, &mut of);
            if let Placed::AngularRate(_) = row.sensor {
                // f = δV/l
                let d = present.direction(system, row);
                let by_velocity = d * (-longer / (edge.l * edge.l));
                of.velocities[e] -= by_velocity;
                of.velocities[e + 1] += by_velocity;
                let rate = d.dot(&measured);
                let faster = d.dot(&(self.faster(e + 1) - self.faster(e))) / edge.l;
                let by_edge = dt * -rate + edge.t * (2.0 * rate * longer / edge.l - faster);
                of.now.places[e] -= by_edge / edge.l;
                of.now.places[e + 1] += by_edge / edge.l;
            }
            on.add(&of, *dy);
        }
    }

    /// What changes of masses and of damping by mass do to a row of an acceleration.
    fn of_masses(&self, row: &Row, on: &mut Weights) {
        let (Placed::Acceleration(place) | Placed::SpecificForce(place, _)) = row.sensor else { return };
        let direction = self.present.direction(self.system, row);
        for (v, share) in [(place.edge, 1.0 - place.fraction), (place.edge + 1, place.fraction)] {
            if self.present.is_free[v] {
                let mass = self.system.rod.masses[v];
                let by_force = direction * (share * self.changed.masses[v] / (mass * mass));
                on.gradient[v] += by_force;
                on.loads[v] -= by_force;
                on.velocities[v] -= direction * (share * self.changed.damping);
            }
        }
    }

    /// What comes with ∂E/∂α, as ∂E/∂x is taken with directors carried from where an edge is.
    fn of_carried(&self, weights: &[Vector3<f64>], on: &mut Weights) {
        let Seen { system, tangent, .. } = self;
        for (e, edge) in system.shape.edges.iter().enumerate() {
            let across = (weights[e + 1] - weights[e]).cross(&edge.t);
            if across == Vector3::zeros() {
                continue;
            }
            let (moved, l) = (self.edge_moved(e), edge.l);
            let i = system.layout.angle(e);
            on.angles[e] += across.dot(&moved) / (l * l);
            let curved = -1.5 * system.gradient[i] / (l * l * l);
            let by_edge = across * (tangent.gradient[i] / (l * l))
                + (across * edge.t.dot(&moved) + edge.t * across.dot(&moved)) * curved;
            on.now.places[e] -= by_edge;
            on.now.places[e + 1] += by_edge;
        }
    }

    /// Wᵀ ∂²(∂E/∂x) and that of loads in the local angles, and what curves these: `first` is what
    /// all rows are on forces, and gets what they are on the two configurations.
    fn of_forces(&self, first: &mut Weights, on: &mut Weights) {
        let Seen { system, motion, present, tangent, bands, .. } = self;
        let n = system.rod.segments();
        let share = present.damping.stiffness / (motion.start.length + present.damping.stiffness);
        let past = motion.past.filter(|_| share > 0.0);
        let weights = in_full_order(system, &first.gradient, &first.angles);
        let mut now = Unknowns::of(bands, &tangent.now);
        let mut before = Unknowns::of(bands, &tangent.before);
        let mut strained = vec![0.0; STRAINS * n];
        let mu = second_order::Increment(&weights);
        bands.third_add(&mu, &mut now.band, past.map(|_| &mut strained[..]));
        let minus: Vec<Vector3<f64>> = first.loads.iter().map(|w| -w).collect();
        let minus_moments: Vec<f64> = first.moments.iter().map(|w| -w).collect();
        let mu = in_full_order(system, &minus, &minus_moments);
        let mut started = vec![0.0; bands.second_of_loads_kept()];
        let start = Some(motion.start);
        bands.second_of_loads(start, &second_order::Increment(&mu), &mut now.band, &mut started);
        bands.second_of_start_add(&started, [&now.by, &before.by], &mut now.on, &mut before.on);

        if let Some((parameters, dp)) = self.by {
            self.of_changes(parameters, dp, (&weights, past), &mut now.on, on);
        }
        tangent.transpose_add(system, motion.start.length, first);
        let mut on_psi = first.now.on_psi(system);
        bands.holonomy_second_add(&system.shape, &mut on_psi, &mut now.band);
        if let Some(past) = past {
            let mut on_psi = first.before.on_psi(system);
            bands.holonomy_second_add(&past.shape, &mut on_psi, &mut before.band);
            let stresses = self.of_past(past, (share, &weights), &strained, on);
            bands.strains_second_add(&past.shape, &stresses, -share, &mut before.band);
        }
        now.onto(bands, &mut on.now);
        before.onto(bands, &mut on.before);
    }

    /// Wᵀ ∂²(∂E/∂x)/∂(x, p) dp, W in the full order.
    fn of_changes(
        &self,
        parameters: &Parameters,
        dp: &[f64],
        (weights, past): (&[f64], Option<&Past>),
        on_now: &mut [f64],
        on: &mut Weights,
    ) {
        let Seen { system, motion, present, .. } = self;
        let strains = OfStrains::of(system, weights, past);
        let strained = strains.strained(present, motion);
        let (mut full, mut by_unknowns) = (vec![0.0; weights.len()], vec![0.0; on_now.len()]);
        let mut stresses = Vec::new();
        for ((parameter, slope), dp) in parameters.list.iter().zip(&parameters.slopes).zip(dp) {
            let times = slope * dp;
            if times == 0.0 {
                continue;
            }
            system.second_of_change(&parameter.change, strained, &mut full);
            self.bands.layout.take(&full, &mut by_unknowns);
            on_now.iter_mut().zip(&by_unknowns).for_each(|(on, by)| *on += times * by);
            let Some(past) = past else { continue };
            if !system.past_of_change(&parameter.change, strained, &mut stresses) {
                continue;
            }
            for (e, [along, bent @ ..]) in stresses.iter().enumerate() {
                let [by_then, by_now] = past.by_edge[e].map(|by| by * (times * along));
                for (on, by) in [(&mut on.before, by_then), (&mut on.now, by_now)] {
                    on.places[e] -= by;
                    on.places[e + 1] += by;
                }
                if let Some(then) = e.checked_sub(1).and_then(|i| past.strains.get(i)) {
                    let of = |c: usize| (0..3).map(|a| then.gradient[a][c] * bent[a]).sum::<f64>();
                    on.before.add_at(e, &std::array::from_fn(|c| times * of(c)));
                }
            }
        }
    }

    /// What couples the two configurations in stresses of strain rates, −share k ε* for every strain.
    /// Returns k ∂ε[W] of bent vertices.
    fn of_past(
        &self,
        past: &Past,
        (share, weights): (f64, &[f64]),
        strained: &[f64],
        on: &mut Weights,
    ) -> Vec<[f64; 4]> {
        let Seen { system, tangent, .. } = self;
        let mut stresses = vec![[0.0; 4]; system.rod.segments()];
        for (i, then) in past.strains.iter().enumerate() {
            let kept: &[[f64; 11]] = strained[STRAINS * (i + 1) + 3..STRAINS * (i + 2)].as_chunks().0;
            let (q, q_then) = (tangent.now.at(i + 1), tangent.before.at(i + 1));
            let strain = then.along(&q_then);
            let by_now: [f64; 3] =
                std::array::from_fn(|a| kept[a].iter().zip(&q).map(|(k, q)| k * q).sum::<f64>());
            let back = |rows: &[[f64; 11]], by: &[f64; 3]| -> [f64; 11] {
                std::array::from_fn(|c| -share * (0..3).map(|a| rows[a][c] * by[a]).sum::<f64>())
            };
            on.now.add_at(i + 1, &back(kept, &strain));
            on.before.add_at(i + 1, &back(&then.gradient, &by_now));
            let first = system.layout.vertex(i);
            let weights = std::array::from_fn(|c| weights[first + c]);
            let stress = system.bend[i].times(&system.shape.strains(i + 1).along(&weights));
            stresses[i + 1][1..].copy_from_slice(&stress);
        }
        for (e, edge) in system.shape.edges.iter().enumerate() {
            let of = |v: usize| Vector3::from_column_slice(&weights[system.layout.vertex(v)..][..3]);
            let along = of(e + 1) - of(e);
            if along == Vector3::zeros() {
                continue;
            }
            // l* = t·e*, times t·along
            let (ea, rest) = system.stretch[e];
            let (k, t, l) = (-share * ea / rest, edge.t, edge.l);
            let moved = self.edge_moved(e);
            let moved_then = tangent.before.places[e + 1] - tangent.before.places[e];
            let flat = |v: &Vector3<f64>| v - t * t.dot(v);
            let then = past.shape.edges[e].t * past.shape.edges[e].l;
            let [by_then, by_now] = &past.by_edge[e];
            let longer = by_then.dot(&moved_then) + by_now.dot(&moved);
            let slope = flat(&along) / l;
            let (stress, across) = (t.dot(&along), flat(&then));
            let curved =
                (across * t.dot(&moved) + t * across.dot(&moved) + flat(&moved) * t.dot(&then)) / (-l * l);
            let by_edge =
                slope * longer + by_now * slope.dot(&moved) + (curved + flat(&moved_then) / l) * stress;
            let by_edge_then = by_then * slope.dot(&moved) + flat(&moved) * (stress / l);
            for (on, by) in [(&mut on.now, by_edge * k), (&mut on.before, by_edge_then * k)] {
                on.places[e] -= by;
                on.places[e + 1] += by;
            }
        }
        stresses
    }
}
