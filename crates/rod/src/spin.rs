//! What resists a spin of sections about their tangents, from the configuration of x_k on.
//!
//! The spin s of an edge is measured against its director carried by parallel transport from its tangent at
//! x_k to its tangent q now, so that no frame of the rod enters: it is the twist between then and now
//! (Bergou et al. 2010, with time in place of arc length), and its derivatives are those of a twist,
//!
//! ```text
//! s = ∠(P(p → q) P(t_k → p) m₁(x_k), m₁(y)),   Φ += ½ a (s − s*)²
//! δs = δθ_y − δθ_k + ½ κb(p, q)·(δe_y/l_y + δe_p/l_p) + ½ κb(t_k, p)·(δe_p/l_p + δe_k/l_k)
//! κb(p, q) = 2 p×q/(1 + p·q)
//! ```
//!
//! both δθ in their local gauges.
//!
//! **Inertia.** I s̈ = −∂E/∂θ is a backward Euler step of length η from the point between the last
//! states as that of X is (`RodStage`): with ω* = a₀ ω_k + a₁ ω_{k−1} and s_{k−1} the spin from
//! x_{k−1} to x_k,
//!
//! ```text
//! a = I/η² + α I/η,   s* = −a₁ s_{k−1} + η ω*/(1 + αη)
//! ω_{k+1} = b₀ (s + a₁ s_{k−1})/η + b₁ ω_k,   spin from x_k to x_{k+1} = b₀ s
//! ```
//!
//! **The way by p.** ∂Φ/∂e = ½ a (s − s*) κb(p, q)/l is no force of the rod: that of a rate against
//! carried directors acts on θ alone. It vanishes with p − q: of the order of Δt, as the error of
//! backward Euler, if p = t_k; of Δt² if p is the tangent of the edge that x_k and x_{k−1} lead to, e_k +
//! (t* − t_k)(e_k − e_{k−1})/Δt_{k−1}. Of an edge that keeps its length, turned by any angle in a
//! step of the same length, p is within 30 degrees of t_k.

mod configuration;
mod second;

use nalgebra::Vector3;

use crate::Error;
use crate::geometry::{Edge, Turn, signed_angle, symmetric_product};
use crate::layout::FIXED;
use crate::stage::{RodStage, mixed, mixed_add};
use crate::system::System;
pub(crate) use configuration::Configuration;

/// Share of its twisting and bending stiffness with which the first section of a rod that holds no director
/// resists a spin within one step. Where nothing depends on the common turn of all sections it alone
/// decides (the first section does not spin), at no moment; else it is a friction that fades with Δt.
const SLIGHT: f64 = 1e-6;

/// Resistance of the sections to spin in the step being worked on.
pub(crate) struct Spin {
    /// a of the first edges \[N m\]: of all with inertia, zero where an angle is given, else of one.
    resistance: Vec<f64>,
    /// s* of every edge \[rad\].
    target: Vec<f64>,
    /// a₀, a₁, and η/(1 + αη): the share of ω* in s*.
    from: [f64; 2],
    rate: f64,
    pub(crate) before: Configuration,
    pub(crate) earlier: Configuration,
    /// Where spins are measured from, and whether x_{k−1} is in it.
    reference: Vec<Reference>,
    with_past: bool,
    /// The spins at the shape last measured.
    pub(crate) now: Vec<Spun>,
    pub(crate) next: Configuration,
    /// δs of every edge, or what acts on it.
    pub(crate) varied: Vec<f64>,
    second: second::Work,
}

/// Where the spin of one edge is measured from.
#[derive(Clone, Copy)]
struct Reference {
    /// p, and the length of the edge along it.
    edge: Edge,
    /// d₁ of x_k carried to it.
    d1: Vector3<f64>,
    /// Shares of e_k and e_{k−1} in the edge.
    along: [f64; 2],
    /// From t_k to p, and from t_{k−1} to t_k.
    there: Turn,
    back: Turn,
    /// s_{k−1}.
    spun_before: f64,
}

/// Spin of one edge.
#[derive(Clone, Copy)]
pub(crate) struct Spun {
    /// From p to the tangent now.
    pub(crate) turn: Turn,
    pub(crate) edge: Edge,
    /// Angle from the Bishop director carried along to that of now.
    pub(crate) frame: f64,
    pub(crate) spin: f64,
}

/// What an increment of x_k and x_{k−1} does to the spin of an edge, or what acts on that.
#[derive(Clone, Copy)]
pub(crate) struct Past {
    /// δs.
    pub(crate) spin: f64,
    /// δs_{k−1}.
    pub(crate) before: f64,
    /// δe_p/l_p.
    pub(crate) reference: Vector3<f64>,
}

impl Past {
    pub(crate) const NONE: Past = Past { spin: 0.0, before: 0.0, reference: Vector3::new(0.0, 0.0, 0.0) };
}

/// Angle from a director, `carried` along, to `to`, on the branch of `near`.
pub(crate) fn angle_on_branch(carried: &Vector3<f64>, to: &Vector3<f64>, q: &Vector3<f64>, near: f64) -> f64 {
    let angle = signed_angle(carried, to, q);
    let round = std::f64::consts::TAU;
    angle + round * ((near - angle) / round).round()
}

impl Spin {
    /// That of a rod whose sections have inertia, or of one which holds no director, where it has one: its
    /// common turn is an unknown.
    pub(crate) fn new(system: &System, sees_angles: bool) -> Option<Spin> {
        let n = system.rod.segments();
        let share = if sees_angles || system.rod.bends_by_angle() { SLIGHT } else { 1.0 };
        let resistance = match (system.layout.spins, system.layout.turns_freely()) {
            (true, _) => vec![0.0; n],
            (false, true) => vec![share * system.rod.section_stiffness(1)],
            (false, false) => return None,
        };
        let none = Reference {
            edge: Edge::none(),
            d1: Vector3::zeros(),
            along: [1.0, 0.0],
            there: Turn::none(),
            back: Turn::none(),
            spun_before: 0.0,
        };
        let flat = Spun { turn: Turn::none(), edge: Edge::none(), frame: 0.0, spin: 0.0 };
        let edges = resistance.len();
        Some(Spin {
            resistance,
            target: vec![0.0; edges],
            from: [1.0, 0.0],
            rate: 0.0,
            before: Configuration::new(n),
            earlier: Configuration::new(n),
            reference: vec![none; edges],
            with_past: false,
            now: vec![flat; edges],
            next: Configuration::new(n),
            varied: vec![0.0; edges],
            second: second::Work::default(),
        })
    }

    /// a of an edge.
    pub(crate) fn resistance(&self, edge: usize) -> f64 {
        self.resistance.get(edge).copied().unwrap_or(0.0)
    }

    /// Spins are measured from the present shape of `system`, that of x_k.
    pub(crate) fn start_from(&mut self, system: &System) {
        self.before.take(system);
        self.with_past = false;
        for (e, r) in self.reference.iter_mut().enumerate() {
            (r.edge, r.d1) = (self.before.shape.edges[e], self.before.shape.d1[e]);
        }
    }

    /// The present shape of `system` is that of x_{k−1}.
    pub(crate) fn came_from(&mut self, system: &System) {
        self.earlier.take(system);
        self.with_past = true;
    }

    /// Inertia of the stage from x_k on: `alpha` is α, `x` the state.
    pub(crate) fn aim(
        &mut self,
        system: &System,
        stage: &RodStage,
        alpha: f64,
        x: &[f64],
    ) -> Result<(), Error> {
        let (layout, h) = (&system.layout, stage.of.length);
        let (own, first) = (layout.state(), layout.first_spin());
        self.from = stage.of.from;
        self.rate = h / (1.0 + alpha * h);
        let mut frame = 0.0;
        for e in 0..self.reference.len() {
            let r = &mut self.reference[e];
            r.spun_before = 0.0;
            if self.with_past {
                let (now, then) = (&self.before.shape, &self.earlier.shape);
                let (k, past) = (&now.edges[e], &then.edges[e]);
                let over = |_| Error::TurnedOver { edge: e };
                r.along = stage.along;
                let along = k.t * (r.along[0] * k.l) + past.t * (r.along[1] * past.l);
                r.edge = Edge::between(&Vector3::zeros(), &along, e)?;
                r.there = Turn::between(&k.t, &r.edge.t, e).map_err(over)?;
                r.back = Turn::between(&past.t, &k.t, e).map_err(over)?;
                r.d1 = r.there.transport(&r.edge.t, &now.d1[e]);
                frame = angle_on_branch(&r.back.transport(&k.t, &then.d1[e]), &now.d1[e], &k.t, frame);
                r.spun_before = frame + self.before.theta[e] - self.earlier.theta[e];
            }
            (self.resistance[e], self.target[e]) = (0.0, 0.0);
            if let Ok(f) = layout.free_angles.binary_search(&e) {
                let rate = mixed(self.from, x, own, first + f);
                self.resistance[e] = system.rod.spin_inertia[e] * (1.0 / (h * h) + alpha / h);
                self.target[e] = self.rate * rate - self.from[1] * r.spun_before;
            }
        }
        Ok(())
    }

    /// Measures the spins at the present shape of `system`.
    pub(crate) fn measure(&mut self, system: &System) -> Result<(), Error> {
        let mut frame = 0.0;
        for (e, (r, now)) in self.reference.iter().zip(&mut self.now).enumerate() {
            let edge = system.shape.edges[e];
            let turn = Turn::between(&r.edge.t, &edge.t, e).map_err(|_| Error::TurnedOver { edge: e })?;
            let carried = turn.transport(&edge.t, &r.d1);
            frame = angle_on_branch(&carried, &system.shape.d1[e], &edge.t, frame);
            *now = Spun { turn, edge, frame, spin: frame + system.theta[e] - self.before.theta[e] };
        }
        Ok(())
    }

    /// Spin from x_{k−1} to x_k, where the stage depends on it.
    pub(crate) fn spun_before(&self, e: usize) -> f64 {
        self.reference[e].spun_before
    }

    /// From t_k to the tangent at x_{k+1}, that of `next`.
    pub(crate) fn way(&self, e: usize) -> Turn {
        let (from, to) = (&self.before.shape.edges[e].t, &self.next.shape.edges[e].t);
        Turn::between(from, to, e).expect("the step was accepted before")
    }

    /// Adds what resists to the equations at the present shape of `system`. Returns its share of Φ.
    pub(crate) fn add(
        &mut self,
        system: &System,
        g: &mut [f64],
        mut jacobian: Option<&mut [f64]>,
    ) -> Result<f64, Error> {
        self.measure(system)?;
        let layout = &system.layout;
        let mut potential = 0.0;
        for (e, &a) in self.resistance.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            let Spun { turn, edge, spin, .. } = self.now[e];
            let off = spin - self.target[e];
            let moment = a * off;
            potential += 0.5 * moment * off;
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

    /// What a change of the inertia of sections, and α/η by `rate`, does to the equations at the spins last
    /// measured: δ(I ((1/η² + α/η)(s − s*))), s* = η ω*/(1 + α η) − the share of s_{k−1}.
    pub(crate) fn change(
        &self,
        system: &System,
        inertia: &[f64],
        [k, c]: [f64; 2],
        rate: f64,
        dg: &mut [f64],
    ) {
        let layout = &system.layout;
        for &e in &layout.free_angles {
            let Spun { turn, edge, spin, .. } = self.now[e];
            let more = inertia.get(e).copied().unwrap_or(0.0);
            let spun = spin + self.from[1] * self.reference[e].spun_before;
            let moment = more * (k + c) * (spin - self.target[e]) + system.rod.spin_inertia[e] * rate * spun;
            let v = turn.kb * (0.5 / edge.l);
            let slope = [-v.x, -v.y, -v.z, 1.0, v.x, v.y, v.z];
            let unknown = &layout.unknown[layout.vertex(e)..][..7];
            for i in (0..7).filter(|&i| unknown[i] != FIXED) {
                dg[unknown[i]] += moment * slope[i];
            }
        }
    }

    /// Takes over increments of x_k and x_{k−1}.
    pub(crate) fn set_increment(&mut self, system: &System, dx: &[f64]) {
        self.before.set_increment(system, dx);
        if self.with_past {
            self.earlier.set_increment(system, &dx[system.layout.state()..]);
        }
    }

    /// What these increments do to the spin of an edge, the shape now being kept.
    pub(crate) fn past(&self, e: usize) -> Past {
        let (r, kb) = (&self.reference[e], &self.now[e].turn.kb);
        let (k, turned) = (self.before.moved(e), self.before.turned[e]);
        if !self.with_past {
            return Past { spin: 0.5 * kb.dot(&k) - turned, before: 0.0, reference: k };
        }
        let past = self.earlier.moved(e);
        let l = [self.before.shape.edges[e].l, self.earlier.shape.edges[e].l];
        let reference = (k * (r.along[0] * l[0]) + past * (r.along[1] * l[1])) / r.edge.l;
        Past {
            spin: 0.5 * kb.dot(&reference) - turned + 0.5 * r.there.kb.dot(&(k + reference)),
            before: turned - self.earlier.turned[e] + 0.5 * r.back.kb.dot(&(past + k)),
            reference,
        }
    }

    /// The transpose of [`Spin::past`]: adds to the configurations.
    pub(crate) fn past_transpose_add(&mut self, e: usize, of: &Past) {
        let (r, kb) = (&self.reference[e], &self.now[e].turn.kb);
        let mut reference = kb * (0.5 * of.spin) + of.reference;
        self.before.turned[e] -= of.spin;
        if !self.with_past {
            self.before.pull(e, &reference);
            return;
        }
        let (there, back) = (r.there.kb * (0.5 * of.spin), r.back.kb * (0.5 * of.before));
        reference = (reference + there) / r.edge.l;
        self.before.turned[e] += of.before;
        self.earlier.turned[e] -= of.before;
        let l = [self.before.shape.edges[e].l, self.earlier.shape.edges[e].l];
        self.before.pull(e, &(there + back + reference * (r.along[0] * l[0])));
        self.earlier.pull(e, &(back + reference * (r.along[1] * l[1])));
    }

    /// Forgets what was added to the configurations.
    pub(crate) fn clear(&mut self) {
        self.before.clear();
        self.earlier.clear();
    }

    /// dx += what was added to the configurations.
    pub(crate) fn transpose_add(&mut self, system: &System, dx: &mut [f64]) {
        self.before.transpose_add(system, dx);
        if self.with_past {
            self.earlier.transpose_add(system, &mut dx[system.layout.state()..]);
        }
    }

    /// dg += ∂G/∂x_k dx, `system` having the shape of the stage.
    pub(crate) fn previous_add(&mut self, system: &System, dx: &[f64], dg: &mut [f64]) {
        let layout = &system.layout;
        self.measure(system).expect("u was assembled before");
        self.set_increment(system, dx);
        for (e, &a) in self.resistance.iter().enumerate().filter(|(_, a)| **a != 0.0) {
            let (Spun { turn, edge: now, spin, .. }, p) = (self.now[e], self.reference[e].edge.t);
            let past = self.past(e);
            let mut ds = past.spin;
            if layout.spins {
                let f = layout.free_angles.binary_search(&e).expect("a given angle does not resist");
                let rate = mixed(self.from, dx, layout.state(), layout.first_spin() + f);
                ds -= self.rate * rate - self.from[1] * past.before;
            }
            let dp = past.reference - p * p.dot(&past.reference);
            let dkb = (dp.cross(&now.t) * 2.0 - turn.kb * dp.dot(&now.t)) / turn.chi;
            let v = (turn.kb * ds + dkb * (spin - self.target[e])) * (0.5 * a / now.l);
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
        self.measure(system).expect("u was assembled before");
        self.clear();
        for e in 0..self.resistance.len() {
            let a = self.resistance[e];
            if a == 0.0 {
                continue;
            }
            let (Spun { turn, edge: now, spin, .. }, p) = (self.now[e], self.reference[e].edge.t);
            let first = layout.vertex(e);
            let mu = |i: usize| mu.get(layout.unknown[first + i]).copied().unwrap_or(0.0);
            let along = Vector3::new(mu(4) - mu(0), mu(5) - mu(1), mu(6) - mu(2));
            let c = a * (mu(3) + turn.kb.dot(&along) * (0.5 / now.l));
            if layout.spins {
                let f = layout.free_angles.binary_search(&e).expect("a given angle does not resist");
                mixed_add(self.from, dx, layout.state(), layout.first_spin() + f, [-self.rate * c]);
            }
            let bent = (now.t.cross(&along) * 2.0 - now.t * turn.kb.dot(&along))
                * (0.5 * a * (spin - self.target[e]) / (now.l * turn.chi));
            let reference = bent - p * p.dot(&bent);
            self.past_transpose_add(e, &Past { spin: c, before: self.from[1] * c, reference });
        }
        self.transpose_add(system, dx);
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
        spin.reference.resize(SEGMENTS, spin.reference[0]);
        spin.now.resize(SEGMENTS, spin.now[0]);
        spin.target.resize(SEGMENTS, 0.0);
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
            step.spin.as_mut().unwrap().add(&step.system, g, None).unwrap()
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
