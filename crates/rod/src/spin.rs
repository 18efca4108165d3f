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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use varda_implicit::{ImplicitModel, ImplicitStep, Interval, Model, Scheme, check};

    use super::*;
    use crate::{Damping, Loads, Rod, RodStep, Section, Supports};

    const SEGMENTS: usize = 6;

    /// A damped rod held at a point, all of whose sections resist as much as they bend.
    fn resisting(scheme: Scheme) -> (RodStep, Vec<f64>) {
        let section = Section { ea: 1e2, ei1: 1e-3, ei2: 2e-3, gj: 8e-4, mass_per_length: 0.1 };
        let rod = Rod::uniform(0.5, SEGMENTS, &section).unwrap().naturally([1.0, 0.5], 2.0);
        let supports = Supports { prescribed: vec![(0, Arc::new([0.0; 3]))], ..Supports::default() };
        let damping = Damping { stiffness: 0.01, mass: 0.0 };
        let step = RodStep::new(rod, supports, Loads::default(), damping).unwrap();
        let mut step = step.with_scheme(scheme);
        let spin = step.spin.as_mut().expect("no director is held");
        spin.resistance = (0..SEGMENTS).map(|e| 0.01 * (1.0 + e as f64)).collect();
        let mut z = vec![0.0; step.control_len()];
        let half = z.len() / 2;
        for v in 1..=SEGMENTS {
            let s = v as f64 / SEGMENTS as f64;
            let place = [0.5 * s, 0.1 * s * s, 0.05 * (3.0 * s).sin()];
            z[3 * v - 3..3 * v].copy_from_slice(&place);
        }
        z[half..].iter_mut().enumerate().for_each(|(i, v)| *v = 2.0 * (1.0 + 2.0 * i as f64).sin());
        (step, z)
    }

    #[test]
    fn its_derivatives_are_exact() {
        for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
            let (step, z) = resisting(scheme);
            let half = z.len() / 2;
            let mut model = ImplicitModel::new(step, 0, 0.01);
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&z, &mut x).unwrap();
            let mut next = x.clone();
            for k in 0..2 {
                model.step(k, &x, &mut next).unwrap();
                std::mem::swap(&mut x, &mut next);
            }
            let mut scale = vec![0.01; half];
            scale.resize(2 * half, 1.0);
            scale.resize(2 * half + SEGMENTS, 0.1);
            scale.extend_from_within(..x.len() - scale.len());
            for finding in check::conformance(&mut model, 2, &x, &scale, 3).unwrap() {
                assert!(finding.value <= finding.bound, "{scheme:?}: {finding:?}");
            }
        }
    }

    /// The gradient against differences of the energy, and one entry of it that is wrong.
    #[test]
    fn its_gradient_is_that_of_its_energy() {
        let (mut step, z) = resisting(Scheme::BackwardEuler);
        let mut x = vec![0.0; step.dim()];
        step.initial_state(0.0, &z, &mut x).unwrap();
        let at = Interval { index: 0, start: 0.0, length: 0.01, previous: None };
        step.prepare(&at, &x).unwrap();
        let n = step.unknowns();
        let mut u = vec![0.0; n];
        step.system.gather(&mut u);
        u.iter_mut().enumerate().for_each(|(i, u)| *u += 0.02 * (3.0 + 5.0 * i as f64).cos());
        let du: Vec<f64> = (0..n).map(|i| (1.0 + 3.0 * i as f64).sin()).collect();
        let mut energy = |h: f64, g: &mut [f64]| {
            let moved: Vec<f64> = u.iter().zip(&du).map(|(u, d)| u + h * d).collect();
            step.system.scatter(&moved);
            step.system.update_shape(true, 0.0).unwrap();
            step.spin.as_ref().unwrap().add(&step.system, g, None).unwrap()
        };
        let mut unused = vec![0.0; n];
        let difference = (energy(1e-5, &mut unused) - energy(-1e-5, &mut unused)) / 2e-5;
        let mut g = vec![0.0; n];
        energy(0.0, &mut g);
        // from stored angles to those of the local gauge
        let (mut moved, mut psi) = (vec![Vector3::zeros(); SEGMENTS + 1], vec![0.0; SEGMENTS]);
        step.system.unknown_displacements(&du, &mut moved);
        step.system.shape.holonomy(&moved, &mut psi);
        let layout = &step.system.layout;
        let mut local = du.clone();
        for e in 0..SEGMENTS {
            local[layout.unknown[layout.angle(e)]] -= psi[e];
        }
        let slope = |g: &[f64]| g.iter().zip(&local).map(|(g, d)| g * d).sum::<f64>();
        // central differences: h² and rounding over h
        let off = |g: &[f64]| (slope(g) / difference - 1.0).abs();
        assert!(off(&g) <= 1e-7, "{:e}", off(&g));
        g[0] *= 1.001;
        assert!(off(&g) > 1e-6, "a wrong entry is not seen: {:e}", off(&g));
    }
}
