//! What supports that parameters move do to a configuration of a rod.

use nalgebra::{Matrix3, Vector3};

use crate::Error;
use crate::element;
use crate::layout::{FIXED, Layout};
use crate::moved::{HeldAt, Moved, MovedBy};
use crate::rotation::{exponential, left_jacobian, left_jacobian_derivative};
use crate::shape::Shape;
use crate::support::Supports;
use crate::system::{StageStart, System};

/// What a parameter does to the supports of a rod at one time.
#[derive(Clone, Copy)]
pub(crate) struct MovedSupports {
    /// Whether it moves any.
    any: bool,
    /// By how much the two clamps turn about their tangents, beyond what carries their section along.
    about: [f64; 2],
}

/// A clamp that parameters turn, at one time.
#[derive(Clone, Copy)]
pub(crate) struct TurnedClamp {
    axes: Matrix3<f64>,
    tangent: Vector3<f64>,
    /// The rotation vector in its own axes.
    turn: Vector3<f64>,
    /// The part of it by which the body turns that carries it, and its place in that body.
    carried: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// Two changes of a rotation: ω_p, ω_q, ∂_q ω_p and ∂_p ω_q.
struct Turns {
    omega: [Vector3<f64>; 2],
    derivative: [Vector3<f64>; 2],
}

impl Turns {
    /// Of the rotation vector ρ in `axes`, changed `by` two vectors and `curved` by both.
    fn by(axes: &Matrix3<f64>, rho: &Vector3<f64>, by: [Vector3<f64>; 2], curved: Vector3<f64>) -> Turns {
        let jacobian = left_jacobian(rho);
        let omega = by.map(|by| axes * (jacobian * by));
        let of =
            |a: usize, b: usize| axes * (left_jacobian_derivative(rho, &by[b]) * by[a] + jacobian * curved);
        Turns { omega, derivative: [of(0, 1), of(1, 0)] }
    }

    /// What both do to a vector that is turned.
    fn of(&self, turned: &Vector3<f64>) -> Vector3<f64> {
        let [p, q] = &self.omega;
        self.derivative[0].cross(turned) + p.cross(&q.cross(turned))
    }

    /// What both do to the turn about a tangent.
    fn about(&self, tangent: &Vector3<f64>) -> f64 {
        0.5 * (self.derivative[0] + self.derivative[1]).dot(tangent)
    }
}

/// The vertex at which a support holds a rod of n segments, and the other one of a clamp.
fn held_vertices(of: HeldAt, n: usize) -> [usize; 2] {
    match of {
        HeldAt::Vertex(v) => [v, v],
        HeldAt::Start => [0, 1],
        HeldAt::End => [n, n - 1],
    }
}

impl System {
    /// That clamp at time t.
    ///
    /// # Panics
    /// If the rod has no such clamp.
    pub(crate) fn turned_clamp(&self, end: bool, t: f64) -> Result<TurnedClamp, Error> {
        let frame = self.clamp_frame(end, t)?.expect("a clamp that turns is one of the rod");
        let (turn, carried) = (self.moves.turn(end, t), self.moves.turned(end, t));
        Ok(TurnedClamp { axes: frame.axes, tangent: frame.tangent, turn, carried })
    }

    /// ∂(places)/∂p at time t in all vertices, zero in those that are free.
    pub(crate) fn moved_places(
        &self,
        parameter: usize,
        t: f64,
        places: &mut [Vector3<f64>],
    ) -> Result<MovedSupports, Error> {
        self.moved_places_by(parameter, t, places, |end| self.turned_clamp(end, t))
    }

    /// The same with the clamps at that time.
    pub(crate) fn moved_places_by(
        &self,
        parameter: usize,
        t: f64,
        places: &mut [Vector3<f64>],
        clamp: impl Fn(bool) -> Result<TurnedClamp, Error>,
    ) -> Result<MovedSupports, Error> {
        places.fill(Vector3::zeros());
        let (n, mut of) = (self.rod.segments(), MovedSupports { any: false, about: [0.0; 2] });
        for item in self.moves.of_parameter(parameter) {
            let moved = self.moves.rate(item, t);
            let [vertex, beside] = held_vertices(item.moved.of, n);
            of.any |= moved != Vector3::zeros();
            places[vertex] += moved;
            if beside == vertex {
                continue;
            }
            places[beside] += moved;
            let Some(by) = item.moved.by.turns(t) else { continue };
            if by != Vector3::zeros() {
                let end = item.moved.of == HeldAt::End;
                let frame = clamp(end)?;
                let omega = frame.axes * (left_jacobian(&frame.turn) * by) * item.slope;
                if let (MovedBy::TurnAlong { .. }, Some((turn, arm))) = (&item.moved.by, frame.carried) {
                    let carried = (left_jacobian(&turn) * by).cross(&(exponential(&turn) * arm));
                    let carried = frame.axes * carried * item.slope;
                    places[vertex] += carried;
                    places[beside] += carried;
                }
                let length = self.rod.rest_lengths[if end { n - 1 } else { 0 }];
                let arm = frame.tangent * if end { -length } else { length };
                places[beside] += omega.cross(&arm);
                of.about[usize::from(end)] += omega.dot(&frame.tangent);
                of.any |= omega != Vector3::zeros();
            }
        }
        Ok(of)
    }

    /// ∂²(places)/∂p∂q at time t in all vertices, and of the turns of clamps. With ω_p of a clamp's
    /// axes,
    ///
    /// ```text
    /// ∂²(R y)/∂p∂q = ∂_q ω_p × R y + ω_p × (ω_q × R y)
    /// ∂²α/∂p∂q = ½ (∂_q ω_p + ∂_p ω_q)·t
    /// ```
    ///
    /// with α the turn beyond what carries the section from its present tangent to another.
    fn moved_places_twice(
        &self,
        [p, q]: [usize; 2],
        t: f64,
        places: &mut [Vector3<f64>],
        clamp: impl Fn(bool) -> Result<TurnedClamp, Error>,
    ) -> Result<MovedSupports, Error> {
        places.fill(Vector3::zeros());
        let (n, mut of) = (self.rod.segments(), MovedSupports { any: false, about: [0.0; 2] });
        let pairs = self.moves.of_parameter(p).flat_map(|a| self.moves.of_parameter(q).map(move |b| (a, b)));
        for (a, b) in pairs.filter(|(a, b)| a.moved.of == b.moved.of) {
            let moved = self.moves.second_rate([a, b], t);
            let [vertex, beside] = held_vertices(a.moved.of, n);
            of.any |= moved != Vector3::zeros();
            places[vertex] += moved;
            if beside == vertex {
                continue;
            }
            places[beside] += moved;
            let (Some(by_a), Some(by_b)) = (a.moved.by.turns(t), b.moved.by.turns(t)) else { continue };
            let end = a.moved.of == HeldAt::End;
            let frame = clamp(end)?;
            let by = [by_a * a.slope, by_b * b.slope];
            let curved = if std::ptr::eq(a, b) { by_a * a.curvature } else { Vector3::zeros() };
            let turns = Turns::by(&frame.axes, &frame.turn, by, curved);
            if let (MovedBy::TurnAlong { .. }, MovedBy::TurnAlong { .. }, Some((turn, arm))) =
                (&a.moved.by, &b.moved.by, frame.carried)
            {
                let carried = frame.axes * (exponential(&turn) * arm);
                let carried = Turns::by(&frame.axes, &turn, by, curved).of(&carried);
                places[vertex] += carried;
                places[beside] += carried;
            }
            let length = self.rod.rest_lengths[if end { n - 1 } else { 0 }];
            places[beside] += turns.of(&(frame.tangent * if end { -length } else { length }));
            of.about[usize::from(end)] += turns.about(&frame.tangent);
            of.any = true;
        }
        Ok(of)
    }

    /// What a parameter does to a configuration by moving supports, its stored angles and free vertices as
    /// they are: `places` of all vertices, and `angles` of all edges in their local gauge. Returns how
    /// the end clamp's stored angle changes; `None` where nothing moves.
    pub(crate) fn moved_increment(
        &self,
        shape: &Shape,
        parameter: usize,
        t: f64,
        places: &mut [Vector3<f64>],
        angles: &mut [f64],
    ) -> Option<f64> {
        let moved = self.moved_places(parameter, t, places).expect("supports were placed at this time");
        self.angles_of_moved(shape, &moved, places, angles)
    }

    /// What two parameters do together to a configuration, in coordinates that are fixed at the present one
    /// (see [`second_order`](crate::second_order)): places and angles of held edges. Of other angles it is
    /// what ψ is moved by with the places, not its own second derivatives.
    pub(crate) fn moved_twice(
        &self,
        shape: &Shape,
        (parameters, t): ([usize; 2], f64),
        (places, angles): (&mut [Vector3<f64>], &mut [f64]),
        clamp: impl Fn(bool) -> Result<TurnedClamp, Error>,
    ) -> Option<f64> {
        let moved = self.moved_places_twice(parameters, t, places, clamp);
        let moved = moved.expect("supports were placed at this time");
        self.angles_of_moved(shape, &moved, places, angles)
    }

    pub(crate) fn angles_of_moved(
        &self,
        shape: &Shape,
        moved: &MovedSupports,
        places: &[Vector3<f64>],
        angles: &mut [f64],
    ) -> Option<f64> {
        if !moved.any {
            return None;
        }
        angles.fill(0.0);
        if !self.layout.bending {
            return Some(0.0);
        }
        shape.holonomy(places, angles);
        let [start, end] = moved.about;
        let psi = angles.last().copied().unwrap_or(0.0);
        // a stored angle stays while the frame it is measured from is turned
        let all = if !self.layout.twist && self.supports.end.is_some() { psi + end } else { start };
        angles.iter_mut().for_each(|angle| *angle = all - *angle);
        if let (Some(last), true) = (angles.last_mut(), self.supports.end.is_some()) {
            *last = end;
        }
        Some(end - start + psi)
    }

    /// out (in the full order) += the second derivatives of the elastic energy of the present shape and
    /// stiffness times an increment of all places and local angles.
    pub(crate) fn elastic_second_add(&self, places: &[Vector3<f64>], angles: &[f64], out: &mut [f64]) {
        let System { layout, shape, stretch, bend, .. } = self;
        for (e, edge) in shape.edges.iter().enumerate() {
            let longer = places[e + 1] - places[e];
            if longer == Vector3::zeros() {
                continue;
            }
            let (k, rest) = stretch[e];
            let force = element::stretch(edge, rest, k).2 * longer;
            let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
            for c in 0..3 {
                out[a + c] -= force[c];
                out[b + c] += force[c];
            }
        }
        if !layout.bending {
            return;
        }
        for i in 1..layout.segments {
            let (a, b, turn, k) = (&shape.edges[i - 1], &shape.edges[i], shape.turn(i), &bend[i - 1]);
            let near = [places[i - 1], places[i], places[i + 1]];
            let out = &mut out[layout.vertex(i - 1)..];
            if layout.twist {
                let [x, y, z] = near;
                let (p, q) = (angles[i - 1], angles[i]);
                let by = [x.x, x.y, x.z, p, y.x, y.y, y.z, q, z.x, z.y, z.z];
                if by != [0.0; 11] {
                    let (m, strains) = (shape.directors(i), shape.strains(i));
                    lower_times_add(&element::bend_twist(a, b, turn, &m, &strains, k).hessian, &by, out);
                }
            } else if near.iter().any(|place| *place != Vector3::zeros()) {
                let [x, y, z] = near;
                let by = [x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z];
                lower_times_add(&element::isotropic_bend(a, b, turn, k.bend[0]).hessian, &by, out);
            }
        }
    }

    /// dg += what moved supports do to loads of the motion, by increments of the stage and of the places
    /// that it starts from.
    pub(crate) fn moved_loads_add(
        &self,
        start: Option<StageStart>,
        [places, start_places]: [&[Vector3<f64>]; 2],
        angles: &[f64],
        dg: &mut [f64],
    ) {
        let rate = start.map_or(0.0, |start| 1.0 / start.length);
        self.each_load(start, |acts, motion, unknown| {
            let e = motion.edge;
            let moved = |of: &[Vector3<f64>], b: usize| of[e + b / 3][b % 3];
            let by_places = acts.by_places_of_carried(motion);
            for a in (0..6).filter(|&a| unknown[a] != FIXED) {
                let by = |b: usize| {
                    let velocity = rate * (moved(places, b) - moved(start_places, b));
                    by_places[(a, b)] * moved(places, b) + acts.by_velocities[(a, b)] * velocity
                };
                dg[unknown[a]] -= (0..6).map(by).sum::<f64>() + acts.by_angle[a] * angles[e];
            }
            if unknown[6] != FIXED {
                let by = |b: usize| acts.moment_by_places[b] * moved(places, b);
                dg[unknown[6]] -= (0..6).map(by).sum::<f64>() + acts.moment_by_angle * angles[e];
            }
        });
    }
}

/// Work space: increments of places and local angles.
pub(crate) struct Increments {
    pub(crate) places: Vec<Vector3<f64>>,
    pub(crate) start: Vec<Vector3<f64>>,
    pub(crate) one: Vec<Vector3<f64>>,
    pub(crate) angles: Vec<f64>,
    pub(crate) full: Vec<f64>,
}

impl Increments {
    pub(crate) fn of(system: &System) -> Increments {
        let n = system.rod.segments();
        let places = || vec![Vector3::zeros(); n + 1];
        Increments {
            places: places(),
            start: places(),
            one: places(),
            angles: vec![0.0; n],
            full: vec![0.0; system.layout.full()],
        }
    }
}

/// An increment of places and local angles in the full order.
pub(crate) fn in_full_order(layout: &Layout, places: &[Vector3<f64>], angles: &[f64], full: &mut [f64]) {
    for (v, place) in places.iter().enumerate() {
        full[layout.vertex(v)..layout.vertex(v) + 3].copy_from_slice(place.as_slice());
    }
    if layout.twist {
        for (e, angle) in angles.iter().enumerate() {
            full[layout.angle(e)] = *angle;
        }
    }
}

/// out += a symmetric matrix, of which the lower triangle is read, times x.
pub(crate) fn lower_times_add<const N: usize>(h: &[[f64; N]; N], x: &[f64; N], out: &mut [f64]) {
    for i in 0..N {
        let mut sum = h[i][i] * x[i];
        for j in 0..i {
            sum += h[i][j] * x[j];
            out[j] += h[i][j] * x[i];
        }
        out[i] += sum;
    }
}

/// # Errors
/// A parameter that moves a support which the rod does not have, or a rod that resists spins, whose frames
/// such a parameter would move.
pub(crate) fn check(moved: &Moved, system: &System) -> Result<(), Error> {
    let Supports { start, end, prescribed, .. } = &system.supports;
    let n = system.rod.segments();
    let (vertex, is) = match moved.of {
        HeldAt::Start => (0, start.is_some()),
        HeldAt::End => (n, end.is_some()),
        HeldAt::Vertex(v) => {
            let turns = matches!(moved.by, MovedBy::Turn(_) | MovedBy::TurnAlong { .. });
            (v, prescribed.iter().any(|p| p.0 == v) && !turns)
        }
    };
    let refused = |reason| Err(Error::Support { vertex, reason });
    if !is {
        return refused("a parameter moves or turns it, and no such support holds it");
    }
    if system.layout.spins {
        return refused("it is not moved by a parameter where sections have inertia against twist");
    }
    if system.layout.twist && system.layout.turns_freely() {
        return refused("it is not moved by a parameter where the rod twists and no clamp holds a section");
    }
    Ok(())
}
