//! Time steps of the rod for the generic layer.

use nalgebra::Vector3;
use varda_implicit::{
    Equations, ImplicitModel, ImplicitStep, Interval, Model, Refusal, Scheme, StepEquations, Structure,
    Substepped,
};

use crate::Error;
use crate::damping::KelvinVoigt;
use crate::equilibrium::{Rest, TwistEquilibrium};
use crate::predict::Carry;
use crate::rod::Rod;
use crate::stage::{RodStage, mixed, mixed_add};
use crate::support::{Damping, Loads, Supports};
use crate::system::System;

/// A step of a rod with massless twist (paper, section 3), by backward Euler or one of the second-order schemes.
///
/// ```text
/// X_{k+1} − X_k − Δt V_{k+1} = 0                                                              (backward Euler)
/// M (V_{k+1} − V_k) + Δt (∂E/∂X(X_{k+1}, θ_{k+1}) + α M V_{k+1} − F_ext(t_{k+1})) = 0
/// ∂E/∂θ(X_{k+1}, θ_{k+1}) = 0
/// ```
///
/// Every [`Scheme`] is one such step of length η from a point (X*, V*) between the last states to a stage (Y, θ_y) at time t*
/// where forces and supports are taken (midpoint: Y = ½(X_k + X_{k+1}), t* = t_{k+½}), so there is one step here and
/// [`Scheme::stage`] gives the weights. V is eliminated: the unknowns are u = (Y, θ_y), interleaved along the rod so that
/// ∂G/∂u is a symmetric band (half-bandwidth 10; 8 without twist; 5 for a chain), and G = ∂Φ/∂u is the gradient of
///
/// ```text
/// Φ(u) = |Y − X* − η V*|²_M / (2η²) + α |Y − X*|²_M / (2η) + E(Y, θ_y) + (β/2η) Σ k (ε − ε*)² − F_ext(t*)·Y
/// ```
///
/// State x = [X, V, θ] of the free vertices and angles (SI units: m, m/s, rad); under BDF2, and under midpoint with twist or
/// Kelvin–Voigt damping, followed by the same of the step before. Control z = [X₀, V₀], θ₀ being the twist equilibrium of
/// X₀ nearest to the untwisted frame. Use it inside [`ImplicitModel`]; [`RodStep::model`] does.
///
/// First guess of a step: X_k carried along rigidly with the supports, θ_k.
pub struct RodStep {
    pub(crate) system: System,
    scheme: Scheme,
    damping: Damping,
    viscous: Option<KelvinVoigt>,
    twist: Option<TwistEquilibrium>,
    carry: Carry,
    /// X* and X* + η V* of the free vertices in the step being worked on.
    start: Vec<Vector3<f64>>,
    target: Vec<Vector3<f64>>,
    end_angle: f64,
    tolerance: f64,
    state: Vec<f64>,
    displacement: Vec<Vector3<f64>>,
    psi: Vec<f64>,
}

impl RodStep {
    /// By backward Euler; [`RodStep::with_scheme`] chooses another.
    ///
    /// # Errors
    /// [`Error`] naming the field, vertex or place that is impossible.
    pub fn new(rod: Rod, supports: Supports, loads: Loads, damping: Damping) -> Result<Self, Error> {
        Self::with_twist(rod, supports, loads, damping, TwistUnknowns::WhereNeeded)
    }

    /// The same, with the choice to keep twist unknowns that are provably zero (to check that leaving them out is right).
    ///
    /// # Errors
    /// As [`RodStep::new`].
    pub fn with_twist(
        rod: Rod,
        supports: Supports,
        loads: Loads,
        damping: Damping,
        twist: TwistUnknowns,
    ) -> Result<Self, Error> {
        let system = System::new(rod, supports, loads, &damping, twist == TwistUnknowns::Always)?;
        let (n, free) = (system.rod.segments(), system.layout.free_vertices.len());
        Ok(RodStep {
            scheme: Scheme::BackwardEuler,
            viscous: (damping.stiffness > 0.0).then(|| KelvinVoigt::new(&system, 1)),
            twist: (!system.layout.free_angles.is_empty()).then(|| TwistEquilibrium::new(&system)),
            carry: Carry::new(&system),
            tolerance: 1e-11 * system.rod.length(),
            start: vec![Vector3::zeros(); free],
            target: vec![Vector3::zeros(); free],
            end_angle: 0.0,
            state: vec![0.0; system.layout.state()],
            displacement: vec![Vector3::zeros(); n + 1],
            psi: vec![0.0; n],
            damping,
            system,
        })
    }

    /// The same rod integrated by another scheme.
    pub fn with_scheme(mut self, scheme: Scheme) -> Self {
        self.scheme = scheme;
        // configurations that ε* is made of: see `RodStage`
        let past = [(Scheme::BackwardEuler, 1), (Scheme::Midpoint, 3), (Scheme::Bdf2, 2)];
        let count = past.iter().find(|p| p.0 == scheme).map_or(0, |p| p.1);
        self.viscous = self.viscous.map(|_| KelvinVoigt::new(&self.system, count));
        self
    }

    /// The model whose step k starts at (first_index + k) · length seconds, compiled in this crate.
    ///
    /// # Panics
    /// As [`ImplicitModel::new`].
    pub fn model(self, first_index: usize, length: f64) -> Box<dyn Model + Send> {
        Box::new(ImplicitModel::new(self, first_index, length))
    }

    /// The model whose step k is all steps between `times` (s) from the k-th to the next time of `through`, compiled in this crate.
    ///
    /// # Panics
    /// As [`ImplicitModel::on_times`] and [`Substepped::through`].
    pub fn model_on_times(self, times: &[f64], through: &[f64]) -> Box<dyn Model + Send> {
        Box::new(Substepped::through(ImplicitModel::on_times(self, times.to_vec()), times, through))
    }

    /// The scheme.
    pub fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// The rod itself.
    pub fn rod(&self) -> &Rod {
        &self.system.rod
    }

    /// What holds it.
    pub fn supports(&self) -> &Supports {
        &self.system.supports
    }

    /// Numbers of the vertices that are not prescribed, ascending: the order of X and V in the state.
    pub fn free_vertices(&self) -> &[usize] {
        &self.system.layout.free_vertices
    }

    /// Numbers of the edges whose angle θ is part of the state, ascending; empty where twist is left out.
    pub fn free_angles(&self) -> &[usize] {
        &self.system.layout.free_angles
    }

    /// Length of the control z = [X₀, V₀].
    pub fn control_len(&self) -> usize {
        6 * self.system.layout.free_vertices.len()
    }

    /// The control z = [X₀, 0] of the rod at rest in this shape.
    ///
    /// # Panics
    /// If the shape has fewer vertices than the rod.
    pub fn control_at_rest(&self, shape: &Rest) -> Vec<f64> {
        let mut z = vec![0.0; self.control_len()];
        for (x, &v) in z.chunks_exact_mut(3).zip(self.free_vertices()) {
            x.copy_from_slice(shape.vertices[v].as_slice());
        }
        z
    }

    /// Places of all vertices at time t in a state or control, prescribed ones included \[m\].
    ///
    /// # Errors
    /// [`Error`] where a support's motion is not usable at t.
    pub fn vertices(&mut self, t: f64, state: &[f64]) -> Result<Vec<Vector3<f64>>, Error> {
        self.system.place(t)?;
        let f = self.system.layout.free_vertices.len();
        assert!(state.len() >= 6 * f, "a state or control is at least {} long", 6 * f);
        for (i, &v) in self.system.layout.free_vertices.iter().enumerate() {
            self.system.x[v] = Vector3::from_column_slice(&state[3 * i..3 * i + 3]);
        }
        Ok(self.system.x.clone())
    }

    /// What this rod does not need and therefore does not have.
    pub fn left_out(&self) -> Vec<String> {
        let layout = &self.system.layout;
        let n = layout.segments;
        let mut out = Vec::new();
        if !layout.bending {
            out.push("bending and twisting: no stiffness against them (a chain)".to_string());
        } else if !layout.twist {
            out.push(format!("{n} twist angles, frames and the twist energy: an isotropic, naturally straight rod held by one director does not twist"));
        }
        let fixed = n + 1 - layout.free_vertices.len();
        if fixed > 0 {
            out.push(format!("{} unknowns and their Hessian blocks: {fixed} prescribed vertices", 3 * fixed));
        }
        if self.viscous.is_none() {
            out.push("strain-rate damping".to_string());
        }
        if self.damping.mass == 0.0 {
            out.push("mass-proportional damping".to_string());
        }
        out.push("velocities as unknowns of the step: they follow from the places".to_string());
        out
    }

    /// Half-bandwidth of ∂G/∂u.
    pub fn half_bandwidth(&self) -> usize {
        self.system.layout.half_bandwidth
    }

    fn stage(&self, at: &Interval) -> RodStage {
        RodStage::new(self.scheme, at, self.viscous.is_some(), self.history() > 0)
    }

    /// Sets everything that depends on the interval and x_k but not on u.
    fn prepare(&mut self, at: &Interval, x: &[f64]) -> Result<(), Refusal> {
        let stage = self.stage(at);
        let (h, from) = (stage.of.length, stage.of.from);
        let s = &mut self.system;
        let (own, nf) = (s.layout.state(), s.layout.free_vertices.len());
        if self.viscous.is_some() || s.layout.twist {
            s.place(at.start)?;
            s.scatter_state(x);
            let guess = s.end_angle_guess();
            s.update_shape(true, guess)?;
            self.end_angle = s.theta.last().copied().unwrap_or(0.0);
        }
        if let Some(viscous) = &mut self.viscous {
            viscous.clear(s);
            viscous.add(s, [1.0, 0.0], stage.strain[0]);
            let before = at.previous.unwrap_or(0.0);
            for (of, age, weight) in [([0.0, 1.0], 1.0, stage.strain[1]), ([0.5, 0.5], 0.5, stage.strain[2])]
            {
                if weight != 0.0 {
                    for (i, v) in self.state.iter_mut().enumerate() {
                        *v = mixed(of, x, own, i);
                    }
                    s.place(at.start - age * before)?;
                    s.scatter_state(&self.state);
                    s.update_shape(true, self.end_angle)?;
                    viscous.add(s, of, weight);
                }
            }
            viscous.fold_in(s, self.damping.stiffness / h);
        }
        s.place(stage.of.time)?;
        for f in 0..nf {
            let star = |i: usize| Vector3::from_fn(|c, _| mixed(from, x, own, 3 * i + c));
            self.start[f] = star(f);
            self.target[f] = self.start[f] + star(nf + f) * h;
        }
        Ok(())
    }

    /// What M is multiplied by in the stage's equations: 1/η² and α/η.
    fn inertia(&self, h: f64) -> [f64; 2] {
        [1.0 / (h * h), self.damping.mass / h]
    }
}

/// Whether twist angles are unknowns where they are provably zero.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwistUnknowns {
    /// Left out where they are provably zero (the default).
    WhereNeeded,
    /// Kept wherever the rod bends.
    Always,
}

/// The equations of one step of a rod: supports are placed, strains and places before the step are known.
pub struct RodEquations<'a> {
    step: &'a mut RodStep,
    at: Interval,
    x: &'a [f64],
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
        s.scatter(u);
        let twist = s.layout.twist;
        s.update_shape(twist, step.end_angle)?;
        if let Some(values) = jacobian.as_deref_mut() {
            values.fill(0.0);
        }
        let mut potential = s.elastic(jacobian.as_deref_mut());
        for (full, &unknown) in s.layout.unknown.iter().enumerate() {
            if let Some(g) = g.get_mut(unknown) {
                *g = s.gradient[full];
            }
        }
        let width = step.system.layout.half_bandwidth + 1;
        let inertia = step.inertia(h);
        for (f, &v) in step.system.layout.free_vertices.iter().enumerate() {
            let [k, c] = inertia.map(|rate| rate * step.system.rod.masses[v]);
            let s = &step.system;
            let (x, force) = (s.x[v], s.forces[v]);
            let (d, e) = (x - step.target[f], x - step.start[f]);
            // Forces act through the displacement of the step: F·X itself would drown Φ's decrease in rounding.
            potential += 0.5 * k * d.dot(&d) + 0.5 * c * e.dot(&e) - force.dot(&e);
            let i = s.layout.unknown[s.layout.vertex(v)];
            for a in 0..3 {
                g[i + a] += k * d[a] + c * e[a] - force[a];
                if let Some(values) = jacobian.as_deref_mut() {
                    values[(i + a) * width + width - 1] += k + c;
                }
            }
        }
        Ok(Some(potential))
    }

    fn retract(&mut self, u: &[f64], du: &[f64], alpha: f64, trial: &mut [f64]) {
        for ((t, u), d) in trial.iter_mut().zip(u).zip(du) {
            *t = u + alpha * d;
        }
        if self.step.system.layout.twist {
            self.step.angles_to_stored(&self.at, u, du, alpha, trial);
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
        let step = &mut *self.step;
        let to = step.scheme.stage(&self.at).time;
        step.carry.guess(&mut step.system, self.at.start, to, self.x)?;
        step.system.gather(u);
        Ok(())
    }

    fn accepted(&mut self, u: &[f64]) -> Result<Option<String>, Refusal> {
        let step = &mut *self.step;
        if step.system.layout.free_angles.is_empty() {
            return Ok(None);
        }
        step.system.scatter(u);
        step.system.update_shape(true, step.end_angle)?;
        let (edge, pivot) = step.system.smallest_twist_pivot();
        if !(pivot > 1e-9) {
            return Err(Error::TwistFold { edge, pivot }.into());
        }
        Ok((pivot < 1e-2).then(|| {
            format!(
                "the twist equilibrium is close to folding at edge {edge} (pivot {pivot:.1e} of its natural size)"
            )
        }))
    }
}

impl ImplicitStep for RodStep {
    type Equations<'a> = RodEquations<'a>;

    fn dim(&self) -> usize {
        self.system.layout.state() + self.history()
    }

    fn history(&self) -> usize {
        let layout = &self.system.layout;
        match self.scheme {
            Scheme::BackwardEuler => 0,
            Scheme::Midpoint if self.viscous.is_none() && layout.free_angles.is_empty() => 0,
            Scheme::Midpoint | Scheme::Bdf2 => layout.state(),
        }
    }

    fn unknowns(&self) -> usize {
        self.system.layout.unknowns
    }

    fn structure(&self) -> Structure {
        Structure::SymmetricBand { half_bandwidth: self.system.layout.half_bandwidth }
    }

    fn equations<'a>(&'a mut self, at: &Interval, x: &'a [f64]) -> Result<RodEquations<'a>, Refusal> {
        self.prepare(at, x)?;
        Ok(RodEquations { step: self, at: *at, x })
    }

    fn advance(&mut self, at: &Interval, x: &[f64], u: &[f64], x_next: &mut [f64]) {
        let RodStage { of, angle, .. } = self.stage(at);
        let ([b0, b1], layout) = (of.to, &self.system.layout);
        let (own, nf) = (layout.state(), layout.free_vertices.len());
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            let i = layout.unknown[layout.vertex(v)];
            for c in 0..3 {
                let (place, speed) = (3 * f + c, 3 * (nf + f) + c);
                x_next[place] = b0 * u[i + c] + b1 * x[place];
                let rate = (u[i + c] - mixed(of.from, x, own, place)) / of.length;
                x_next[speed] = b0 * rate + b1 * x[speed];
            }
        }
        for (f, &e) in layout.free_angles.iter().enumerate() {
            let past = mixed([angle[1], angle[2]], x, own, 6 * nf + f);
            x_next[6 * nf + f] = angle[0] * u[layout.unknown[layout.angle(e)]] + past;
        }
    }

    fn recover(&mut self, at: &Interval, x: &[f64], x_next: &[f64], u: &mut [f64]) {
        let RodStage { of, angle, .. } = self.stage(at);
        let own = x_next.len();
        let angles = 6 * self.system.layout.free_vertices.len();
        for (i, y) in self.state.iter_mut().enumerate() {
            let (share, past) =
                if i < angles { (of.to[0], [of.to[1], 0.0]) } else { (angle[0], [angle[1], angle[2]]) };
            *y = (x_next[i] - mixed(past, x, own, i)) / share;
        }
        self.system.scatter_state(&self.state);
        self.system.gather(u);
    }

    fn previous(&mut self, at: &Interval, x: &[f64], u: &[f64], dx: &[f64], dg: &mut [f64]) {
        dg.fill(0.0);
        let of = self.scheme.stage(at);
        let h = of.length;
        let (own, nf) = (self.system.layout.state(), self.system.layout.free_vertices.len());
        let inertia = self.inertia(of.length);
        for (f, &v) in self.system.layout.free_vertices.iter().enumerate() {
            let [k, c] = inertia.map(|rate| rate * self.system.rod.masses[v]);
            let i = self.system.layout.unknown[self.system.layout.vertex(v)];
            for a in 0..3 {
                let place = mixed(of.from, dx, own, 3 * f + a);
                let speed = mixed(of.from, dx, own, 3 * (nf + f) + a);
                dg[i + a] = -k * (place + h * speed) - c * place;
            }
        }
        if self.viscous.is_some() {
            self.prepare_and_shape(at, x, u);
            let viscous = self.viscous.as_mut().expect("checked above");
            viscous.previous_add(&self.system, dx, dg);
        }
    }

    fn previous_transpose_add(&mut self, at: &Interval, x: &[f64], u: &[f64], mu: &[f64], dx: &mut [f64]) {
        let of = self.scheme.stage(at);
        let (own, nf) = (self.system.layout.state(), self.system.layout.free_vertices.len());
        let inertia = self.inertia(of.length);
        for (f, &v) in self.system.layout.free_vertices.iter().enumerate() {
            let [k, c] = inertia.map(|rate| rate * self.system.rod.masses[v]);
            let i = self.system.layout.unknown[self.system.layout.vertex(v)];
            let mu = [mu[i], mu[i + 1], mu[i + 2]];
            mixed_add(of.from, dx, own, 3 * f, mu.map(|mu| -(k + c) * mu));
            mixed_add(of.from, dx, own, 3 * (nf + f), mu.map(|mu| -k * of.length * mu));
        }
        if self.viscous.is_some() {
            self.prepare_and_shape(at, x, u);
            let viscous = self.viscous.as_mut().expect("checked above");
            viscous.previous_transpose_add(&self.system, mu, dx);
        }
    }

    fn advance_tangent(
        &mut self,
        at: &Interval,
        _x: &[f64],
        u: &[f64],
        dx: &[f64],
        du: &[f64],
        dx_next: &mut [f64],
    ) {
        // ∂S is linear: du takes the place of u, dx that of x.
        self.advance(at, dx, du, dx_next);
        if self.system.layout.free_angles.is_empty() {
            return;
        }
        self.set_edges_of(at, u);
        self.system.unknown_displacements(du, &mut self.displacement);
        self.system.shape.holonomy(&self.displacement, &mut self.psi);
        let (layout, share) = (&self.system.layout, self.stage(at).angle[0]);
        let angles = &mut dx_next[6 * layout.free_vertices.len()..];
        for (angle, &e) in angles.iter_mut().zip(&layout.free_angles) {
            *angle += share * self.psi[e];
        }
    }

    fn advance_adjoint(
        &mut self,
        at: &Interval,
        _x: &[f64],
        u: &[f64],
        lambda: &[f64],
        dx: &mut [f64],
        du: &mut [f64],
    ) {
        dx.fill(0.0);
        let RodStage { of, angle, .. } = self.stage(at);
        let ([b0, b1], layout) = (of.to, &self.system.layout);
        let (own, nf) = (layout.state(), layout.free_vertices.len());
        let rate = b0 / of.length;
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            let i = layout.unknown[layout.vertex(v)];
            let (place, speed) = (3 * f, 3 * (nf + f));
            let at = |i: usize| [lambda[i], lambda[i + 1], lambda[i + 2]];
            let (places, speeds) = (at(place), at(speed));
            let back = speeds.map(|l| rate * l);
            for c in 0..3 {
                du[i + c] = b0 * places[c] + back[c];
            }
            if b1 != 0.0 {
                mixed_add([b1, 0.0], dx, own, place, places);
                mixed_add([b1, 0.0], dx, own, speed, speeds);
            }
            mixed_add(of.from, dx, own, place, back.map(|b| -b));
        }
        let angles = &lambda[6 * nf..];
        for (f, &e) in layout.free_angles.iter().enumerate() {
            du[layout.unknown[layout.angle(e)]] = angle[0] * angles[f];
            mixed_add([angle[1], angle[2]], dx, own, 6 * nf + f, [angles[f]]);
        }
        // θ_{k+1} is read by nobody in most windows: then nothing comes back through the holonomy.
        if angles.iter().all(|a| *a == 0.0) {
            return;
        }
        self.set_edges_of(at, u);
        self.psi.fill(0.0);
        for (f, &e) in self.system.layout.free_angles.iter().enumerate() {
            self.psi[e] = angle[0] * angles[f];
        }
        self.displacement.fill(Vector3::zeros());
        self.system.shape.holonomy_transpose_add(&self.psi, &mut self.displacement);
        let layout = &self.system.layout;
        for &v in &layout.free_vertices {
            let i = layout.unknown[layout.vertex(v)];
            for c in 0..3 {
                du[i + c] += self.displacement[v][c];
            }
        }
    }

    fn control_dim(&self) -> usize {
        self.control_len()
    }

    fn initial_state(&mut self, t: f64, z: &[f64], x: &mut [f64]) -> Result<(), Refusal> {
        let n = self.control_len();
        x[..n].copy_from_slice(z);
        if let Some(twist) = &mut self.twist {
            twist.solve(t, &z[..n / 2], &mut x[n..])?;
        }
        Ok(())
    }

    fn initial_tangent(&mut self, _t: f64, dz: &[f64], dx: &mut [f64]) {
        let n = self.control_len();
        dx[..n].copy_from_slice(dz);
        if let Some(twist) = &mut self.twist {
            twist.tangent(&dz[..n / 2], &mut dx[n..]);
        }
    }

    fn initial_adjoint(&mut self, _t: f64, lambda: &[f64], dz: &mut [f64]) {
        let n = self.control_len();
        dz.copy_from_slice(&lambda[..n]);
        if let Some(twist) = &mut self.twist {
            twist.adjoint_add(&lambda[n..], &mut dz[..n / 2]);
        }
    }
}

impl RodStep {
    /// The stored angles of u ⊕ α du: an increment of θ in the local gauge, plus the holonomy of the displacements.
    fn angles_to_stored(&mut self, at: &Interval, u: &[f64], du: &[f64], alpha: f64, trial: &mut [f64]) {
        self.set_edges_of(at, u);
        self.system.add_holonomy(du, alpha, &mut self.displacement, &mut self.psi, trial);
    }

    /// Edges and turns at u. The point was assembled before, so its geometry is sound.
    ///
    /// Places the supports first: products of other steps may have been asked for in between.
    fn set_edges_of(&mut self, at: &Interval, u: &[f64]) {
        self.system.place(self.scheme.stage(at).time).expect("the step was accepted before");
        self.system.scatter(u);
        self.system.update_shape(true, self.end_angle).expect("u was assembled before");
    }

    /// The present step's strains and shapes at x and u, for the products with ∂G/∂x_k.
    fn prepare_and_shape(&mut self, at: &Interval, x: &[f64], u: &[f64]) {
        self.prepare(at, x).expect("the step was accepted before");
        self.system.scatter(u);
        self.system.update_shape(true, self.end_angle).expect("the step was accepted before");
    }
}
