//! The equations of a rod at rest, and the ways to a shape that solves them.

pub(crate) mod continuation;
mod guess;
pub(crate) mod reactions;
mod shape_input;

use nalgebra::Vector3;
use varda_implicit::{Equations, Interval, NewtonWork, Refusal};

use crate::system::System;

/// The moment t, for errors of an equilibrium at that time.
pub(crate) fn at_rest(t: f64) -> Interval {
    Interval { index: 0, start: t, length: 0.0, previous: None }
}

/// The total potential energy of a system as a function of its unknowns.
pub(crate) struct Statics {
    pub(crate) system: System,
    pub(crate) end_angle: f64,
    /// ½ a (θ⁰ − θ̄)² \[N m, rad\]: holds the first angle of a rod without a director.
    pub(crate) hold: Option<(f64, f64)>,
    tolerance: f64,
    displacement: Vec<Vector3<f64>>,
    psi: Vec<f64>,
}

impl Statics {
    pub(crate) fn new(system: System, end_angle: f64, tolerance: f64) -> Statics {
        let n = system.rod.segments();
        Statics {
            end_angle,
            hold: None,
            tolerance,
            displacement: vec![Vector3::zeros(); n + 1],
            psi: vec![0.0; n],
            system,
        }
    }

    pub(crate) fn work_space(&self) -> NewtonWork {
        NewtonWork::new(self.system.layout.unknowns, &self.system.structure())
    }
}

impl Equations for Statics {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        mut jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let s = &mut self.system;
        let mut potential = s.assemble(u, self.end_angle, g, jacobian.as_deref_mut())?;
        for &v in &s.layout.free_vertices {
            potential -= s.forces[v].dot(&s.x[v]);
            let i = s.layout.unknown[s.layout.vertex(v)];
            for c in 0..3 {
                g[i + c] -= s.forces[v][c];
            }
        }
        if let Some((stiffness, angle)) = self.hold {
            let i = s.layout.unknown[s.layout.angle(0)];
            let off = s.theta[0] - angle;
            potential += 0.5 * stiffness * off * off;
            g[i] += stiffness * off;
            if let Some(values) = jacobian.as_deref_mut() {
                values[i * s.row_length() + s.layout.half_bandwidth] += stiffness;
            }
        }
        potential += s.add_loads(None, g, jacobian);
        Ok(s.has_potential().then_some(potential))
    }

    fn retract(&mut self, u: &[f64], du: &[f64], alpha: f64, trial: &mut [f64]) {
        for ((t, u), d) in trial.iter_mut().zip(u).zip(du) {
            *t = u + alpha * d;
        }
        let s = &mut self.system;
        if s.layout.free_angles.is_empty() || s.layout.free_vertices.is_empty() {
            return;
        }
        s.scatter(u);
        if s.layout.free_angles.len() + 1 < s.rod.segments() {
            // both ends hold a director: u is accepted, and its end angle counts whole turns from the one
            // before
            s.update_shape(true, self.end_angle).expect("u was assembled before");
            self.end_angle = s.theta[s.rod.segments() - 1];
        } else {
            s.shape.set_edges(&s.x, true).expect("u was assembled before");
        }
        s.add_holonomy(du, alpha, &mut self.displacement, &mut self.psi, trial);
    }

    fn longest(&self, du: &[f64]) -> f64 {
        // angles that start from zero are far from those of a rod with natural twist
        if self.system.rod.natural_twist.iter().any(|t| *t != 0.0) { 1.0 } else { self.system.longest(du) }
    }

    fn converged_below(&self) -> f64 {
        self.tolerance
    }
}
