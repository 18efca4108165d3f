//! What each row of [`Sensors`](crate::Sensors) is of a rod in one state, and what it is on changes of it.

use nalgebra::{Matrix3, Vector3};

use crate::forces_of_motion::Motion;
use crate::forces_tangent::transpose::Weights;
use crate::forces_tangent::{ChangeOfForces, Increment, Tangent};
use crate::geometry::Edge;
use crate::read_rotations::{ReadRotations, tilt, tilt_by_tangent, turn, turn_by_section};
use crate::rod::Place;
use crate::sensor::{Placed, Row, Sum};
use crate::support::Damping;
use crate::system::System;

/// Strain rates are differences over this share of the interval; a much smaller one is lost in rounding.
pub(crate) const SHARE: f64 = 1e-3;

/// The rod in a state: ∂E/∂x and loads of every vertex, and how free ones move.
pub(crate) struct Present<'a> {
    pub(crate) sensors: &'a [Placed],
    pub(crate) gradient: Vec<Vector3<f64>>,
    pub(crate) loads: Vec<Vector3<f64>>,
    /// ∂E/∂θ of every edge less the moments of loads; zero without twist.
    pub(crate) about_tangent: Vec<f64>,
    pub(crate) is_free: Vec<bool>,
    pub(crate) velocities: Vec<Vector3<f64>>,
    pub(crate) damping: Damping,
    /// That of the state, and that of the one a little earlier \[s\].
    pub(crate) times: [f64; 2],
    pub(crate) at_rest: bool,
    pub(crate) state: &'a [f64],
}

impl Present<'_> {
    pub(crate) fn tangent<'a>(
        &self,
        system: &mut System,
        motion: &Motion<'a>,
        changes: Vec<(usize, ChangeOfForces)>,
    ) -> Tangent<'a> {
        let share = self.share(motion);
        Tangent::new(system, motion.start, motion.past.filter(|_| share > 0.0), share, changes)
    }

    /// What of a stress is that of the strains before.
    pub(crate) fn share(&self, motion: &Motion) -> f64 {
        self.damping.stiffness / (motion.start.length + self.damping.stiffness)
    }

    /// ∂E/∂x_v − F_v.
    pub(crate) fn net(&self, v: usize) -> Vector3<f64> {
        self.gradient[v] - self.loads[v]
    }

    fn sum(&self, of: &Sum) -> Vector3<f64> {
        let of_vertex = |v: usize| if of.loaded { self.net(v) } else { self.gradient[v] };
        of.vertices.clone().map(of_vertex).sum::<Vector3<f64>>() * of.sign
    }

    fn velocity(&self, motion: &Motion, v: usize) -> Vector3<f64> {
        if self.is_free[v] { self.velocities[v] } else { motion.held[v][0] }
    }

    /// The acceleration of a place; nothing accelerates at rest.
    fn acceleration(&self, system: &System, motion: &Motion, place: &Place) -> Vector3<f64> {
        let of = |v: usize| match self.is_free[v] {
            true => -self.net(v) / system.rod.masses[v] - self.velocities[v] * self.damping.mass,
            false => motion.held[v][1],
        };
        match self.at_rest {
            true => Vector3::zeros(),
            false => of(place.edge) * (1.0 - place.fraction) + of(place.edge + 1) * place.fraction,
        }
    }

    /// What turns with the section of an edge: m₁, m₂, t as columns.
    pub(crate) fn section(system: &System, e: usize) -> Matrix3<f64> {
        Matrix3::from_columns(&[system.shape.m1[e], system.shape.m2[e], system.shape.edges[e].t])
    }

    /// The rows of all sensors.
    pub(crate) fn rows(&self) -> Vec<Row<'_>> {
        let mut all = Vec::new();
        for sensor in self.sensors {
            let axes = [Vector3::x(), Vector3::y(), Vector3::z()];
            all.extend(axes.into_iter().take(sensor.rows()).enumerate().map(|(i, axis)| Row {
                sensor,
                index: i,
                direction: match sensor {
                    Placed::SpecificForce(_, axes) => axes.row(i).transpose(),
                    // ω·m₁ = −m₂·ṫ, ω·m₂ = m₁·ṫ
                    Placed::AngularRate(_) if i == 0 => -Vector3::y(),
                    Placed::AngularRate(_) => Vector3::x(),
                    _ => axis,
                },
            }));
        }
        all
    }

    /// The direction of a row in space.
    pub(crate) fn direction(&self, system: &System, row: &Row) -> Vector3<f64> {
        match row.sensor {
            Placed::Along(_, e) => system.shape.edges[*e].t,
            Placed::SpecificForce(Place { edge: e, .. }, _) | Placed::AngularRate(e) => {
                Self::section(system, *e) * row.direction
            }
            _ => row.direction,
        }
    }

    /// What a row reads.
    pub(crate) fn value(&self, system: &System, motion: &Motion, row: &Row) -> f64 {
        let read = |read: &ReadRotations| read.matrix(self.times[0]);
        match row.sensor {
            Placed::Direction(e, rows) => tilt(&read(rows), &system.shape.edges[*e].t)[row.index],
            Placed::Orientation(e, axes, rows) => {
                turn(&read(rows), &Self::section(system, *e), axes)[row.index]
            }
            _ => self.direction(system, row).dot(&self.measured(system, motion, row)),
        }
    }

    /// The vector whose component a row is.
    pub(crate) fn measured(&self, system: &System, motion: &Motion, row: &Row) -> Vector3<f64> {
        match row.sensor {
            Placed::Force(sum) | Placed::Along(sum, _) => self.sum(sum),
            Placed::Acceleration(place) => self.acceleration(system, motion, place),
            Placed::SpecificForce(place, _) => {
                self.acceleration(system, motion, place) - system.loads.gravity
            }
            Placed::AngularRate(e) => {
                (self.velocity(motion, e + 1) - self.velocity(motion, *e)) / system.shape.edges[*e].l
            }
            Placed::ClampMoment([vertex, beside, e]) => {
                let arm = system.x[*beside] - system.x[*vertex];
                arm.cross(&self.net(*beside)) + system.shape.edges[*e].t * self.about_tangent[*e]
            }
            Placed::Moment(shares) => shares.iter().map(|(v, share)| moment(system, *v) * *share).sum(),
            Placed::Direction(..) | Placed::Orientation(..) => row.direction,
            Placed::Spin(i) => row.direction * self.state[*i],
        }
    }

    /// What a row is on forces, velocities and configurations.
    pub(crate) fn weights(&self, system: &System, motion: &Motion, row: &Row) -> Weights {
        let mut on = Weights::new(system.rod.segments());
        let (direction, measured) = (self.direction(system, row), self.measured(system, motion, row));
        self.force_weights(system, row, &direction, &measured, &mut on);
        self.turn_weights(system, row, &measured, &mut on);
        self.moment_weights(system, motion, row, &direction, &mut on);
        self.rotation_weights(system, row, &mut on);
        on
    }

    /// What a row is that has this direction, which stays.
    pub(crate) fn force_weights(
        &self,
        system: &System,
        row: &Row,
        direction: &Vector3<f64>,
        measured: &Vector3<f64>,
        on: &mut Weights,
    ) {
        match row.sensor {
            Placed::Force(sum) | Placed::Along(sum, _) => {
                for v in sum.vertices.clone() {
                    on.gradient[v] += direction * sum.sign;
                    if sum.loaded {
                        on.loads[v] -= direction * sum.sign;
                    }
                }
            }
            Placed::Acceleration(place) | Placed::SpecificForce(place, _) if !self.at_rest => {
                for (v, share) in [(place.edge, 1.0 - place.fraction), (place.edge + 1, place.fraction)] {
                    if self.is_free[v] {
                        let by_force = direction * (share / system.rod.masses[v]);
                        on.gradient[v] -= by_force;
                        on.loads[v] += by_force;
                        on.velocities[v] -= direction * (share * self.damping.mass);
                    } else {
                        on.accelerations[v] += direction * share;
                    }
                }
            }
            Placed::AngularRate(e) => {
                let edge = &system.shape.edges[*e];
                let by_velocity = direction / edge.l;
                on.velocities[*e] -= by_velocity;
                on.velocities[e + 1] += by_velocity;
                // and the length is in the denominator
                let by_edge = edge.t * (direction.dot(measured) / edge.l);
                on.now.places[*e] += by_edge;
                on.now.places[e + 1] -= by_edge;
            }
            _ => {}
        }
    }

    /// The edge with whose section the direction of a row turns, and that direction along m₁, m₂, t.
    pub(crate) fn axis(&self, row: &Row) -> Option<(usize, Vector3<f64>)> {
        match row.sensor {
            Placed::Along(_, e) => Some((*e, Vector3::z())),
            Placed::SpecificForce(Place { edge: e, .. }, _) | Placed::AngularRate(e) => {
                Some((*e, row.direction))
            }
            _ => None,
        }
    }

    /// What a row is whose direction turns and which measures this, which stays: δm₁ = −(m₁·δt) t
    /// + δφ m₂, δm₂ = −(m₂·δt) t − δφ m₁ with δt = (I − t tᵀ) δe/l.
    pub(crate) fn turn_weights(&self, system: &System, row: &Row, measured: &Vector3<f64>, on: &mut Weights) {
        let Some((e, axis)) = self.axis(row) else { return };
        let [a, b, c]: [f64; 3] = axis.into();
        let (edge, along) = (&system.shape.edges[e], measured.dot(&system.shape.edges[e].t));
        let mut by_edge = (measured - edge.t * along) * c;
        if a != 0.0 || b != 0.0 {
            let (m1, m2) = (system.shape.m1[e], system.shape.m2[e]);
            by_edge -= (m1 * a + m2 * b) * along;
            on.now.angles[e] += a * measured.dot(&m2) - b * measured.dot(&m1);
        }
        on.now.places[e] -= by_edge / edge.l;
        on.now.places[e + 1] += by_edge / edge.l;
    }

    /// What a row of a moment is.
    fn moment_weights(
        &self,
        system: &System,
        motion: &Motion,
        row: &Row,
        direction: &Vector3<f64>,
        on: &mut Weights,
    ) {
        match row.sensor {
            &Placed::ClampMoment([vertex, beside, e]) => {
                let (arm, edge) = (system.x[beside] - system.x[vertex], &system.shape.edges[e]);
                let by_force = direction.cross(&arm);
                on.gradient[beside] += by_force;
                on.loads[beside] -= by_force;
                on.angles[e] += direction.dot(&edge.t);
                on.moments[e] -= direction.dot(&edge.t);
                // a clamp that turns
                let by_arm = self.net(beside).cross(direction);
                on.now.places[beside] += by_arm;
                on.now.places[vertex] -= by_arm;
                on.now.add_direction(e, edge, &(direction * self.about_tangent[e]));
            }
            Placed::Moment(shares) => {
                let share_before = self.share(motion);
                for (v, share) in shares {
                    // the matrix of stiffness is symmetric
                    let mut stress = system.bend[v - 1].times(&(direction * *share).into());
                    if !system.layout.twist {
                        // it twists nowhere, to the last digit
                        stress[2] = 0.0;
                    }
                    let of = |gradient: &[[f64; 11]; 3], factor: f64| -> [f64; 11] {
                        std::array::from_fn(|c| (0..3).map(|a| factor * stress[a] * gradient[a][c]).sum())
                    };
                    on.now.add_at(*v, &of(&system.shape.strains(*v).gradient, 1.0));
                    if let Some(past) = motion.past.filter(|_| share_before > 0.0) {
                        on.before.add_at(*v, &of(&past.strains[v - 1].gradient, -share_before));
                    }
                }
            }
            _ => {}
        }
    }

    /// What a row of a rotation is: a small one along (m₁, m₂, t) is (−m₂·δt, m₁·δt, δφ).
    fn rotation_weights(&self, system: &System, row: &Row, on: &mut Weights) {
        match row.sensor {
            Placed::Direction(e, rows) => {
                let by = tilt_by_tangent(&rows.matrix(self.times[0]), &system.shape.edges[*e].t);
                on.now.add_direction(*e, &system.shape.edges[*e], &by[row.index]);
            }
            Placed::Orientation(e, axes, rows) => {
                let turned = turn(&rows.matrix(self.times[0]), &Self::section(system, *e), axes);
                let by = turn_by_section(&turned, axes).column(row.index).into_owned();
                let by_tangent = system.shape.m1[*e] * by.y - system.shape.m2[*e] * by.x;
                on.now.add_direction(*e, &system.shape.edges[*e], &by_tangent);
                on.now.angles[*e] += by.z;
            }
            _ => {}
        }
    }

    /// What acts on configurations and velocities as what acts on the state, of a step whose state has so
    /// much history; the earlier configuration lies `back` \[s\] along the velocities.
    pub(crate) fn onto_state(
        &self,
        system: &System,
        motion: &Motion,
        on: &mut Weights,
        (history, back): (usize, f64),
        row: &mut [f64],
    ) {
        let mut on_earlier = vec![0.0; row.len()];
        on.now.transpose_add(system, &system.shape, row);
        let then = motion.past.map_or(&system.shape, |past| &past.shape);
        on.before.transpose_add(system, then, &mut on_earlier);
        let places = 3 * system.layout.free_vertices.len();
        for i in 0..places {
            row[i] += on_earlier[i];
            row[places + i] -= back * on_earlier[i];
        }
        for (f, &v) in system.layout.free_vertices.iter().enumerate() {
            (0..3).for_each(|c| row[places + 3 * f + c] += on.velocities[v][c]);
        }
        for i in 2 * places..2 * places + system.layout.free_angles.len() {
            let share = if history > 0 && !self.at_rest { SHARE } else { 0.0 };
            row[i] += (1.0 - share) * on_earlier[i];
            if share > 0.0 {
                row[system.layout.state() + i] += share * on_earlier[i];
            }
        }
    }
}

/// M₁, M₂ and T at a bent vertex.
fn moment(system: &System, vertex: usize) -> Vector3<f64> {
    let (strains, k) = (system.shape.strains(vertex).value, &system.bend[vertex - 1]);
    Vector3::from(k.times(&std::array::from_fn(|c| strains[c] - k.rest[c])))
}

impl Increment {
    /// Adds a weight on the unit tangent of an edge: δt = (I − t tᵀ) δe/l.
    fn add_direction(&mut self, e: usize, edge: &Edge, weight: &Vector3<f64>) {
        let by_edge = (weight - edge.t * edge.t.dot(weight)) / edge.l;
        self.places[e] -= by_edge;
        self.places[e + 1] += by_edge;
    }
}

impl Weights {
    /// Their sum with changes of ∂E/∂x, loads and the present configuration.
    pub(crate) fn along(&self, system: &System, tangent: &Tangent) -> f64 {
        let mut sum = 0.0;
        for v in 0..self.gradient.len() {
            let first = system.layout.vertex(v);
            sum += self.gradient[v].dot(&Vector3::from_column_slice(&tangent.gradient[first..first + 3]));
            sum += self.loads[v].dot(&tangent.loads.forces[v]);
            sum += self.now.places[v].dot(&tangent.now.places[v]);
        }
        for e in (0..self.angles.len()).filter(|e| self.angles[*e] != 0.0 && system.layout.twist) {
            sum += self.angles[e] * tangent.gradient[system.layout.angle(e)];
            sum += self.moments[e] * tangent.loads.moments[e];
        }
        sum + self.now.angles.iter().zip(&tangent.now.angles).map(|(w, a)| w * a).sum::<f64>()
    }
}
