//! The equations of one step of a rod.

use std::sync::Arc;

use nalgebra::Vector3;
use varda_implicit::{Equations, Interval, NewtonOptions, NewtonWork, Refusal, StepEquations, solve};

use crate::Error;
use crate::dynamics::RodStep;
use crate::load::Load;
use crate::system::{StageStart, System};

/// The equations of one step of a rod: supports are placed, strains and places before the step are known.
pub struct RodEquations<'a> {
    pub(crate) step: &'a mut RodStep,
    pub(crate) at: Interval,
    pub(crate) x: &'a [f64],
}

impl Equations for RodEquations<'_> {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        mut jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let step = &mut *self.step;
        let h = step.scheme.stage(&self.at).length;
        let s = &mut step.system;
        let mut potential = s.assemble(u, step.end_angle, g, jacobian.as_deref_mut())?;
        if let Some(spin) = &mut step.spin {
            potential += spin.add(s, g, jacobian.as_deref_mut())?;
        }
        let (width, diagonal) = (s.row_length(), s.layout.half_bandwidth);
        let inertia = step.inertia(h);
        for (f, &v) in step.system.layout.free_vertices.iter().enumerate() {
            let [k, c] = inertia.map(|rate| rate * step.system.rod.masses[v]);
            let s = &step.system;
            let (x, force) = (s.x[v], s.forces[v]);
            let (d, e) = (x - step.target[f], x - step.start[f]);
            // Forces act through the displacement of the step: F·X itself would drown Φ's decrease in
            // rounding.
            potential += 0.5 * k * d.dot(&d) + 0.5 * c * e.dot(&e) - force.dot(&e);
            let i = s.layout.unknown[s.layout.vertex(v)];
            for a in 0..3 {
                g[i + a] += k * d[a] + c * e[a] - force[a];
                if let Some(values) = jacobian.as_deref_mut() {
                    values[(i + a) * width + diagonal] += k + c;
                }
            }
        }
        if !step.system.loads.of_motion.is_empty() {
            // nothing moves at rest
            let start = (!step.is_at_rest).then(|| step.stage_start(h));
            potential += step.system.add_loads(start, g, jacobian);
        }
        Ok(step.system.has_potential().then_some(potential))
    }

    fn retract(&mut self, u: &[f64], du: &[f64], alpha: f64, trial: &mut [f64]) {
        for ((t, u), d) in trial.iter_mut().zip(u).zip(du) {
            *t = u + alpha * d;
        }
        if self.step.system.layout.twist {
            // an increment of θ in the local gauge, plus the holonomy of the displacements, is one of stored
            // angles
            let step = &mut *self.step;
            step.set_edges_of(&self.at, u);
            step.system.add_holonomy(du, alpha, &mut step.displacement, &mut step.psi, trial);
        }
    }

    fn size(&self, du: &[f64]) -> f64 {
        let layout = &self.step.system.layout;
        let mut size: f64 = 0.0;
        let mut grow = |v: f64| size = if v.is_nan() || size.is_nan() { f64::NAN } else { size.max(v.abs()) };
        for &v in &layout.free_vertices {
            let i = layout.unknown[layout.vertex(v)];
            du[i..i + 3].iter().for_each(|d| grow(*d));
        }
        for &e in &layout.free_angles {
            grow(du[layout.unknown[layout.angle(e)]] * self.step.system.rod.rest_lengths[e]);
        }
        size
    }

    fn longest(&self, du: &[f64]) -> f64 {
        self.step.system.longest(du)
    }

    fn converged_below(&self) -> f64 {
        self.step.tolerance
    }

    fn trusted_below(&self) -> f64 {
        let shortest = self.step.system.rod.rest_lengths.iter().fold(f64::INFINITY, |m: f64, l| m.min(*l));
        (1e-6 * shortest).max(10.0 * self.step.tolerance)
    }
}

impl StepEquations for RodEquations<'_> {
    fn predict(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
        self.carry(u)?;
        if self.step.is_at_rest {
            return Ok(());
        }
        let carried = self.potential_of_guess();
        let step = &mut *self.step;
        if step.carry.coast(&mut step.system, &step.target) && self.potential_of_guess() <= carried {
            self.step.system.gather(u);
        }
        Ok(())
    }

    /// The shape that supports carried along, without its own motion. With loads that have no potential,
    /// the stage with these as they are at that guess: it has a minimum, which Newton's method finds past
    /// saddles, where for the root with the loads it may only fail.
    fn predict_again(&mut self, u: &mut [f64]) -> Result<Option<[usize; 2]>, Refusal> {
        self.carry(u)?;
        if self.step.system.has_potential() {
            return Ok(Some([0, 0]));
        }
        let stage = self.step.scheme.stage(&self.at);
        let start = self.step.start_of_all.clone();
        let moves = !self.step.is_at_rest;
        let start = moves.then_some(StageStart { places: &start, length: stage.length });
        let (system, end_angle) = (&mut self.step.system, self.step.end_angle);
        let loads = system.freeze_loads(u, end_angle, start)?;
        let mut work = NewtonWork::new(u.len(), &system.structure());
        let solved = solve(self, u, &mut work, &NewtonOptions::default());
        let system = &mut self.step.system;
        system.loads.of_motion = loads;
        system.place(stage.time)?;
        Ok(solved.ok().map(|report| [report.iterations, report.factorizations]))
    }

    fn accepted(&mut self, u: &[f64]) -> Result<Option<String>, Refusal> {
        let step = &mut *self.step;
        if step.system.layout.free_angles.is_empty() {
            return Ok(None);
        }
        if step.system.layout.ends_held() || step.system.layout.spins {
            let (from, to) = (self.at.start, self.at.end());
            let (_, turn) = step.system.clamps_turn(from, to)?;
            if !(turn.abs() <= std::f64::consts::FRAC_PI_2) {
                return Err(Error::ClampTurns { turn, from, to }.into());
            }
        }
        step.system.scatter(u);
        step.system.update_shape(true, step.end_angle)?;
        let resistance = |e: usize| step.spin.as_ref().map_or(0.0, |spin| spin.resistance(e));
        let (edge, pivot) = step.system.smallest_twist_pivot(resistance);
        if !(pivot > 1e-9) {
            return Err(Error::TwistFold { edge, pivot }.into());
        }
        // a common turn that nothing depends on is no fold
        let held = if step.system.layout.turns_freely() { step.system.rod.section_stiffness(1) } else { 0.0 };
        let (edge, pivot) = step.system.smallest_twist_pivot(|e| if e == 0 { held } else { resistance(e) });
        Ok((pivot < 1e-2).then(|| {
            format!(
                "the twist equilibrium is close to folding at edge {edge} \
                 (pivot {pivot:.1e} of its natural size)"
            )
        }))
    }
}

impl RodEquations<'_> {
    fn carry(&mut self, u: &mut [f64]) -> Result<(), Refusal> {
        let step = &mut *self.step;
        let to = step.scheme.stage(&self.at).time;
        step.carry.guess(&mut step.system, self.at.start, to, self.x)?;
        step.system.gather(u);
        Ok(())
    }

    /// Φ at the system's present vertices without stretching and loads of the motion, to compare guesses
    /// with the same lengths of edges; NaN where there is none.
    fn potential_of_guess(&mut self) -> f64 {
        let step = &mut *self.step;
        let [k, c] = step.inertia(step.scheme.stage(&self.at).length);
        let s = &mut step.system;
        if s.update_shape(s.layout.twist, step.end_angle).is_err() {
            return f64::NAN;
        }
        let of_vertex = |(f, &v): (usize, &usize)| {
            let (d, e) = (s.x[v] - step.target[f], s.x[v] - step.start[f]);
            0.5 * s.rod.masses[v] * (k * d.norm_squared() + c * e.norm_squared()) - s.forces[v].dot(&e)
        };
        s.bending_energy() + s.layout.free_vertices.iter().enumerate().map(of_vertex).sum::<f64>()
    }
}

impl System {
    /// Makes dead forces of the loads without a potential, as they are at the unknowns u; moments about the
    /// tangent are left out. Returns all loads, to be put back.
    pub(crate) fn freeze_loads(
        &mut self,
        u: &[f64],
        end_angle: f64,
        start: Option<StageStart>,
    ) -> Result<Vec<Arc<dyn Load>>, Error> {
        self.scatter(u);
        self.update_shape(true, end_angle)?;
        let all = std::mem::take(&mut self.loads.of_motion);
        let (kept, frozen) = all.iter().cloned().partition(|load| load.has_potential());
        self.loads.of_motion = frozen;
        let mut dead = vec![Vector3::zeros(); self.forces.len()];
        self.each_load(start, |acts, motion, _| {
            for (i, force) in acts.forces.iter().enumerate() {
                dead[motion.edge + i / 3][i % 3] += force;
            }
        });
        self.loads.of_motion = kept;
        self.forces.iter_mut().zip(dead).for_each(|(force, dead)| *force += dead);
        Ok(all)
    }
}
