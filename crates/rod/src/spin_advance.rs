//! Angles and spins of x_{k+1}, where sections have inertia.
//!
//! ```text
//! ω_{k+1} = b₀ (s + a₁ s_{k−1})/η + b₁ ω_k
//! θ_{k+1} = θ_y                                        backward Euler, BDF2
//! θ_{k+1} = θ_k + b₀ s − ∠(P(t_k → t_{k+1}) d₁(x_k), d₁(x_{k+1}))      midpoint
//! ```
//!
//! The midpoint rule's section turns by b₀ s = 2s from x_k to x_{k+1}: 2θ_y − θ_k would not do, since
//! the frames that stored angles are measured from spin, too.

use varda_implicit::{Interval, SolvedStep};

use crate::Error;
use crate::dynamics::RodStep;
use crate::geometry::Turn;
use crate::layout::FIXED;
use crate::spin::{Past, Spin, angle_on_branch};
use crate::stage::mixed_add;

impl RodStep {
    /// The spins at u, measured, and the stage's weights.
    fn spins_at(&mut self, at: &Interval, x: &[f64], u: &[f64]) -> &mut Spin {
        self.prepare_and_shape(at, x, u);
        let spin = self.spin.as_mut().expect("sections have inertia");
        spin.measure(&self.system).expect("u was assembled before");
        spin
    }

    /// Takes over the shape of x_{k+1}.
    fn set_next(&mut self, at: &Interval, x_next: &[f64]) -> Result<&mut Spin, Error> {
        let s = &mut self.system;
        s.place(at.end())?;
        s.scatter_state(x_next);
        s.update_shape(true, s.end_angle_guess())?;
        let spin = self.spin.as_mut().expect("sections have inertia");
        spin.next.take(s);
        Ok(spin)
    }

    /// The same, from x_k and u.
    pub(crate) fn set_next_of(&mut self, at: &Interval, x: &[f64], u: &[f64]) -> &mut Spin {
        let mut next = std::mem::take(&mut self.state);
        self.follow(at, x, u, &mut next);
        self.set_next(at, &next).expect("the step was accepted before");
        self.state = next;
        self.spin.as_mut().expect("sections have inertia")
    }

    /// Completes `x_next`, whose places are known.
    pub(crate) fn advance_spins(&mut self, at: &Interval, x: &[f64], u: &[f64], x_next: &mut [f64]) {
        if !self.system.layout.spins {
            return;
        }
        let of = self.stage(at).of;
        let [b0, b1] = of.to;
        self.spins_at(at, x, u);
        let (layout, spin) = (&self.system.layout, self.spin.as_ref().expect("sections have inertia"));
        let (first, angles) = (layout.first_spin(), 6 * layout.free_vertices.len());
        for (f, &e) in layout.free_angles.iter().enumerate() {
            let rate = (spin.now[e].spin + of.from[1] * spin.spun_before(e)) / of.length;
            x_next[first + f] = b0 * rate + b1 * x[first + f];
            if b1 != 0.0 {
                x_next[angles + f] = spin.before.theta[e] + b0 * spin.now[e].spin;
            }
        }
        if b1 != 0.0 && self.turn_with_frames(at, x_next).is_err() {
            // a fold half a step after the stage shows as a state that is not finite
            x_next[first..].fill(f64::NAN);
        }
    }

    /// Takes from the angles in `x_next` what the frames spin from x_k to x_{k+1}.
    fn turn_with_frames(&mut self, at: &Interval, x_next: &mut [f64]) -> Result<(), Error> {
        self.set_next(at, x_next)?;
        let (layout, spin) = (&self.system.layout, self.spin.as_ref().expect("sections have inertia"));
        let angles = 6 * layout.free_vertices.len();
        let (mut frame, mut free) = (0.0, 0);
        for (e, d1) in spin.next.shape.d1.iter().enumerate() {
            let (from, to) = (&spin.before.shape, &spin.next.shape.edges[e].t);
            let turn = Turn::between(&from.edges[e].t, to, e)?;
            frame = angle_on_branch(&turn.transport(to, &from.d1[e]), d1, to, frame);
            if layout.free_angles.get(free) == Some(&e) {
                x_next[angles + free] -= frame;
                free += 1;
            }
        }
        Ok(())
    }

    /// Angles of u from the spins of x_{k+1}, where they do not follow from its angles.
    pub(crate) fn recover_angles(&mut self, at: &Interval, x: &[f64], x_next: &[f64], u: &mut [f64]) {
        let of = self.stage(at).of;
        let [b0, b1] = of.to;
        if !self.system.layout.spins || b1 == 0.0 {
            return;
        }
        self.spins_at(at, x, u);
        let (layout, spin) = (&self.system.layout, self.spin.as_ref().expect("sections have inertia"));
        let first = layout.first_spin();
        for (f, &e) in layout.free_angles.iter().enumerate() {
            let rate = (x_next[first + f] - b1 * x[first + f]) / b0;
            let spun = of.length * rate - of.from[1] * spin.spun_before(e);
            u[layout.unknown[layout.angle(e)]] = spin.before.theta[e] + spun - spin.now[e].frame;
        }
    }

    /// Completes `dx_next`, whose places are known.
    pub(crate) fn advance_spins_tangent(
        &mut self,
        step: &SolvedStep<'_>,
        dx: &[f64],
        du: &[f64],
        dx_next: &mut [f64],
    ) {
        let SolvedStep { at, x, u, .. } = *step;
        if !self.system.layout.spins {
            return;
        }
        let of = self.stage(at).of;
        let [b0, b1] = of.to;
        self.spins_at(at, x, u);
        self.system.unknown_displacements(du, &mut self.displacement);
        let (system, spin) = (&self.system, self.spin.as_mut().expect("sections have inertia"));
        spin.set_increment(system, dx);
        let first = system.layout.first_spin();
        for (f, &e) in system.layout.free_angles.iter().enumerate() {
            let (now, past) = (spin.now[e], spin.past(e));
            let moved = (self.displacement[e + 1] - self.displacement[e]) / now.edge.l;
            let turned = du[system.layout.unknown[system.layout.angle(e)]];
            spin.varied[e] = turned + 0.5 * now.turn.kb.dot(&moved) + past.spin;
            let rate = (spin.varied[e] + of.from[1] * past.before) / of.length;
            dx_next[first + f] = b0 * rate + b1 * dx[first + f];
        }
        if b1 == 0.0 {
            return;
        }
        self.set_next_of(at, x, u);
        let (system, spin) = (&self.system, self.spin.as_mut().expect("sections have inertia"));
        let next = &mut spin.next;
        system.displacements(dx_next, &mut next.displacement);
        next.shape.holonomy(&next.displacement, &mut next.turned);
        let angles = 6 * system.layout.free_vertices.len();
        for (f, &e) in system.layout.free_angles.iter().enumerate() {
            let turn = spin.way(e);
            let frame = 0.5 * turn.kb.dot(&(spin.before.moved(e) + spin.next.moved(e)));
            dx_next[angles + f] = spin.before.turned[e] + b0 * spin.varied[e] + spin.next.turned[e] - frame;
        }
    }

    /// What acts on angles and spins of x_{k+1} (in `to`) as what acts on x_k, on the places of x_{k+1} and
    /// on the spins of the stage, which [`RodStep::spins_onto_stage`] hands on.
    pub(crate) fn advance_spins_transpose(&mut self, step: &SolvedStep<'_>, to: &mut [f64], dx: &mut [f64]) {
        let SolvedStep { at, x, u, .. } = *step;
        let of = self.stage(at).of;
        let [b0, b1] = of.to;
        let spin = self.spins_at(at, x, u);
        spin.clear();
        if b1 != 0.0 {
            self.set_next_of(at, x, u).next.clear();
        }
        let (system, spin) = (&self.system, self.spin.as_mut().expect("sections have inertia"));
        let layout = &system.layout;
        let (own, first, angles) = (layout.state(), layout.first_spin(), 6 * layout.free_vertices.len());
        for (f, &e) in layout.free_angles.iter().enumerate() {
            let rate = to[first + f];
            mixed_add([b1, 0.0], dx, own, first + f, [rate]);
            let mut past = Past { spin: b0 * rate / of.length, ..Past::NONE };
            past.before = of.from[1] * past.spin;
            if b1 != 0.0 {
                let angle = std::mem::replace(&mut to[angles + f], 0.0);
                past.spin += b0 * angle;
                let frame = spin.way(e).kb * (-0.5 * angle);
                spin.before.turned[e] += angle;
                spin.before.pull(e, &frame);
                spin.next.turned[e] = angle;
                spin.next.pull(e, &frame);
            }
            spin.varied[e] = past.spin;
            spin.past_transpose_add(e, &past);
        }
        spin.transpose_add(system, dx);
        if b1 != 0.0 {
            let next = &mut spin.next;
            next.shape.holonomy_transpose_add(&next.turned, &mut next.displacement);
            for (f, &v) in layout.free_vertices.iter().enumerate() {
                for c in 0..3 {
                    to[3 * f + c] += next.displacement[v][c];
                }
            }
        }
    }

    /// du += what acts on the spins of the stage.
    pub(crate) fn spins_onto_stage(&self, du: &mut [f64]) {
        let (layout, spin) = (&self.system.layout, self.spin.as_ref().expect("sections have inertia"));
        for &e in &layout.free_angles {
            let (c, now) = (spin.varied[e], &spin.now[e]);
            let v = now.turn.kb * (0.5 * c / now.edge.l);
            let first = layout.vertex(e);
            let entries = [-v.x, -v.y, -v.z, c, v.x, v.y, v.z];
            for (&unknown, value) in layout.unknown[first..first + 7].iter().zip(entries) {
                if unknown != FIXED {
                    du[unknown] += value;
                }
            }
        }
    }
}
