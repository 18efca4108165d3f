//! What resists a spin of sections about their tangents, from the configuration of x_k on.
//!
//! The spin s of an edge is measured against its director carried by parallel transport from its tangent p
//! at x_k to its tangent q now, so that no frame of the rod enters: it is the twist between then and now
//! (Bergou et al. 2010, with time in place of arc length), and its derivatives are those of a twist,
//!
//! ```text
//! s = ∠(P(p → q) m₁(x_k), m₁(y)),   Φ += ½ a (s − s*)²
//! δs = δθ_y − δθ_k + ½ κb·(δe_y/l_y + δe_k/l_k),   κb = 2 p×q/(1 + p·q)
//! ```
//!
//! both δθ in their local gauges.

use nalgebra::Vector3;

use crate::Error;
use crate::geometry::{Turn, signed_angle, symmetric_product};
use crate::layout::FIXED;
use crate::shape::Shape;
use crate::system::System;

/// Share of its twisting and bending stiffness with which the first section of a rod that holds no director
/// resists a spin within one step. Where nothing depends on the common turn of all sections it alone
/// decides (the first section does not spin), at no moment; else it is a friction that fades with Δt.
const SLIGHT: f64 = 1e-6;

/// Resistance of the sections to spin in the step being worked on.
pub(crate) struct Spin {
    /// a of the first edges \[N m\]; the others have none.
    resistance: Vec<f64>,
    /// The configuration that spins are measured from.
    before: Shape,
    theta: Vec<f64>,
    displacement: Vec<Vector3<f64>>,
    psi: Vec<f64>,
}

/// Spin of one edge.
struct Spun {
    turn: Turn,
    /// Angle from the Bishop director carried along to that of now.
    frame: f64,
    spin: f64,
}

impl Spin {
    /// That of a rod which holds no director, where it has one: its common turn is an unknown.
    pub(crate) fn of_free_turn(system: &System, damped: bool) -> Option<Spin> {
        let n = system.rod.segments();
        let share = if damped || system.rod.bends_by_angle() { SLIGHT } else { 1.0 };
        system.layout.turns_freely().then(|| Spin {
            resistance: vec![share * system.rod.section_stiffness(1)],
            before: Shape::new(n),
            theta: vec![0.0; n],
            displacement: vec![Vector3::zeros(); n + 1],
            psi: vec![0.0; n],
        })
    }

    /// a of an edge.
    pub(crate) fn resistance(&self, edge: usize) -> f64 {
        self.resistance.get(edge).copied().unwrap_or(0.0)
    }

    /// Spins are measured from the present shape of `system`.
    pub(crate) fn start_from(&mut self, system: &System) {
        self.before.copy_from(&system.shape);
        self.theta.copy_from_slice(&system.theta);
    }

    /// Spin of an edge; `frame` is that of the edge before, whose branch is kept.
    fn spun(&self, system: &System, e: usize, frame: f64) -> Result<Spun, Error> {
        let (p, q) = (&self.before.edges[e].t, &system.shape.edges[e].t);
        let turn = Turn::between(p, q, e).map_err(|_| Error::TurnedOver { edge: e })?;
        let carried = turn.transport(q, &self.before.d1[e]);
        let angle = signed_angle(&carried, &system.shape.d1[e], q);
        let round = std::f64::consts::TAU;
        let frame = angle + round * ((frame - angle) / round).round();
        Ok(Spun { turn, frame, spin: frame + system.theta[e] - self.theta[e] })
    }

    /// Adds what resists to the equations at the present shape of `system`. Returns its share of Φ.
    pub(crate) fn add(
        &self,
        system: &System,
        g: &mut [f64],
        mut jacobian: Option<&mut [f64]>,
    ) -> Result<f64, Error> {
        let layout = &system.layout;
        let (mut potential, mut frame) = (0.0, 0.0);
        for (e, &a) in self.resistance.iter().enumerate() {
            let Spun { turn, frame: angle, spin } = self.spun(system, e, frame)?;
            frame = angle;
            let edge = &system.shape.edges[e];
            let moment = a * spin;
            potential += 0.5 * moment * spin;
            let v = turn.kb * (0.5 / edge.l);
            let slope = [-v.x, -v.y, -v.z, 1.0, v.x, v.y, v.z];
            let first = layout.vertex(e);
            let unknown = &layout.unknown[first..first + 7];
            for i in (0..7).filter(|&i| unknown[i] != FIXED) {
                g[unknown[i]] += moment * slope[i];
            }
            let Some(values) = jacobian.as_deref_mut() else { continue };
            let h =
                symmetric_product(&turn.kb, &(turn.tilde + edge.t)) * (-0.25 * moment / (edge.l * edge.l));
            let second = |i: usize, j: usize| match (i, j) {
                (3, _) | (_, 3) => 0.0,
                _ if (i < 3) == (j < 3) => h[(i % 4, j % 4)],
                _ => -h[(i % 4, j % 4)],
            };
            system.add_entries(values, unknown, |i, j| a * slope[i] * slope[j] + second(i, j));
        }
        Ok(potential)
    }

    /// dg += ∂G/∂x_k dx, `system` having the shape of the stage.
    pub(crate) fn previous_add(&mut self, system: &System, dx: &[f64], dg: &mut [f64]) {
        let layout = &system.layout;
        system.displacements(dx, &mut self.displacement);
        self.before.holonomy(&self.displacement, &mut self.psi);
        let angles = &dx[6 * layout.free_vertices.len()..];
        let mut frame = 0.0;
        for (e, &a) in self.resistance.iter().enumerate() {
            let at = self.spun(system, e, frame).expect("u was assembled before");
            frame = at.frame;
            let (then, now) = (&self.before.edges[e], &system.shape.edges[e]);
            let moved = (self.displacement[e + 1] - self.displacement[e]) / then.l;
            let turned = layout.free_angles.binary_search(&e).map_or(0.0, |f| angles[f] - self.psi[e]);
            let ds = 0.5 * at.turn.kb.dot(&moved) - turned;
            let dp = moved - then.t * then.t.dot(&moved);
            let dkb = (dp.cross(&now.t) * 2.0 - at.turn.kb * dp.dot(&now.t)) / at.turn.chi;
            let v = (at.turn.kb * ds + dkb * at.spin) * (0.5 * a / now.l);
            let first = layout.vertex(e);
            let entries = [-v.x, -v.y, -v.z, a * ds, v.x, v.y, v.z];
            for (&unknown, value) in layout.unknown[first..first + 7].iter().zip(entries) {
                if unknown != FIXED {
                    dg[unknown] += value;
                }
            }
        }
    }

    /// dx += (∂G/∂x_k)ᵀ μ, `system` having the shape of the stage.
    pub(crate) fn previous_transpose_add(&mut self, system: &System, mu: &[f64], dx: &mut [f64]) {
        let layout = &system.layout;
        let nf = layout.free_vertices.len();
        self.displacement.fill(Vector3::zeros());
        self.psi.fill(0.0);
        let mut frame = 0.0;
        for (e, &a) in self.resistance.iter().enumerate() {
            let at = self.spun(system, e, frame).expect("u was assembled before");
            frame = at.frame;
            let (then, now) = (&self.before.edges[e], &system.shape.edges[e]);
            let first = layout.vertex(e);
            let mu = |i: usize| mu.get(layout.unknown[first + i]).copied().unwrap_or(0.0);
            let along = Vector3::new(mu(4) - mu(0), mu(5) - mu(1), mu(6) - mu(2));
            let c = a * (mu(3) + at.turn.kb.dot(&along) * (0.5 / now.l));
            if let Ok(f) = layout.free_angles.binary_search(&e) {
                dx[6 * nf + f] -= c;
                self.psi[e] = c;
            }
            let bent = (now.t.cross(&along) * 2.0 - now.t * at.turn.kb.dot(&along))
                * (0.5 * a * at.spin / (now.l * at.turn.chi));
            let force = (at.turn.kb * (0.5 * c) + bent - then.t * then.t.dot(&bent)) / then.l;
            self.displacement[e] -= force;
            self.displacement[e + 1] += force;
        }
        self.before.holonomy_transpose_add(&self.psi, &mut self.displacement);
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            for c in 0..3 {
                dx[3 * f + c] += self.displacement[v][c];
            }
        }
    }
}
