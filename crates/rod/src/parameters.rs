//! Constants of a rod as parameters: what they change, and ∂G/∂p.

use nalgebra::Vector3;
use varda_implicit::{Interval, ParametricStep, Refusal, SolvedStep};
use varda_linalg::dot;

use crate::Error;
use crate::change::{Change, Parameter, Parameters, Second};
use crate::damping::KelvinVoigt;
use crate::dynamics::{RodStep, TwistUnknowns};
use crate::layout::FIXED;
use crate::moved::Moves;
use crate::moved_increment::{self, Increments};
use crate::moved_second::Acting;
use crate::rod::Rod;
use crate::second_order::Increment;
use crate::second_parameters::Strained;
use crate::shape::HOLONOMY;
use crate::stage::mixed_add;
use crate::support::{Damping, Loads, Supports};
use crate::system::{PastStrains, StageStart, System};

impl RodStep {
    /// The step of a rod that some constants of are parameters, each zero at the rod given: inside
    /// [`WithParameters`](varda_implicit::WithParameters) they are part of the state. By backward Euler;
    /// [`RodStep::with_scheme`] chooses another.
    ///
    /// Twist is among the unknowns where it would be with the constants that parameters lead to. A list of a
    /// change is that of the rod between the faces of its clamps ([`Rod::with_faces`]).
    ///
    /// ```
    /// use varda_implicit::{ImplicitModel, Model, WithParameters};
    /// use varda_rod::{
    ///     Change, Clamp, ClampAt, Damping, Law, Loads, Material, Parameter, Rod, RodStep, Section, Supports,
    ///     Vector3, straight_guess,
    /// };
    ///
    /// let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01);
    /// let rod = Rod::uniform(1.0, 20, &section)?;
    /// let stiffness = Change { ei: rod.ei.clone(), ..Change::default() };
    /// let unknown = vec![Parameter { change: stiffness, law: Law::Exponential }];
    /// let clamp = Clamp::new(ClampAt::Edge, [0.0; 3], Vector3::x(), Vector3::z());
    /// let supports = Supports::clamped_start(clamp);
    /// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    /// let step = RodStep::with_parameters(rod, supports, loads, Damping::default(), unknown)?;
    /// let guess = straight_guess(step.rod(), step.supports(), 0.0, Vector3::x())?;
    /// let mut control = step.control_at_rest(&guess);
    /// control.push(0.2); // 22 % stiffer
    ///
    /// let mut model = ImplicitModel::new(WithParameters::new(step, 0), 0, 0.01);
    /// let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    /// model.initial_state(&control, &mut x)?;
    /// model.step(0, &x, &mut next)?;
    /// assert_eq!(next[control.len() - 1], 0.2);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// As [`RodStep::new`]; a list of the wrong length; a change of what the rod does not have: bending of a
    /// chain, spin inertia of massless twist, damping that is zero.
    pub fn with_parameters(
        rod: Rod,
        supports: Supports,
        loads: Loads,
        damping: Damping,
        parameters: Vec<Parameter>,
    ) -> Result<RodStep, Error> {
        let twist = match parameters.iter().any(|p| p.change.needs_angles()) {
            true => TwistUnknowns::Always,
            false => TwistUnknowns::WhereNeeded,
        };
        let by_angle = parameters.iter().any(|p| p.change.bends_by_angle());
        let mut step = RodStep::build(rod, supports, loads, damping, twist, by_angle)?;
        let rod = step.rod().clone();
        for parameter in &parameters {
            check(&parameter.change, &rod, &damping, step.system.layout.bending)?;
            for moved in &parameter.change.supports {
                moved_increment::check(moved, &step.system)?;
            }
        }
        let gravity = step.system.loads.gravity;
        let (slopes, curvatures) = (vec![1.0; parameters.len()], vec![0.0; parameters.len()]);
        let none = PastStrains::default();
        let turn = Vector3::zeros();
        let moved = Increments::of(&step.system);
        step.take_moves(Moves::of(parameters.iter().map(|p| (p.law, &p.change.supports[..]))));
        let second = Second::default();
        let all = Parameters {
            list: parameters,
            rod,
            damping,
            gravity,
            slopes,
            curvatures,
            turn,
            none,
            moved,
            second,
        };
        step.parameters = Some(Box::new(all));
        Ok(step)
    }
}

/// # Errors
/// See [`RodStep::with_parameters`].
fn check(change: &Change, rod: &Rod, damping: &Damping, bending: bool) -> Result<(), Error> {
    let (n, inner) = (rod.segments(), rod.ei.len());
    let lists = [
        ("change of EA", change.ea.len(), n),
        ("change of EI", change.ei.len(), inner),
        ("change of GJ", change.gj.len(), inner),
        ("change of natural curvature", change.natural_curvature.len(), inner),
        ("change of natural twist", change.natural_twist.len(), inner),
        ("change of masses", change.masses.len(), n + 1),
        ("change of spin inertia", change.spin_inertia.len(), rod.spin_inertia.len()),
    ];
    for (field, found, expected) in lists {
        if found != 0 && found != expected {
            return Err(Error::Count { field, found, expected });
        }
    }
    if change.is_of_bending() && !bending {
        return Err(Error::Value { field: "EI of a parameter", value: 0.0, expected: "a rod that bends" });
    }
    let pairs = [
        ("damping.stiffness", change.damping.stiffness, damping.stiffness),
        ("damping.mass", change.damping.mass, damping.mass),
    ];
    for (field, change, value) in pairs {
        if change != 0.0 && !(value > 0.0) {
            let expected = "a positive number, the prior of its parameter";
            return Err(Error::Value { field, value, expected });
        }
    }
    Ok(())
}

impl ParametricStep for RodStep {
    fn parameters(&self) -> usize {
        self.parameters.as_ref().map_or(0, |p| p.list.len())
    }

    fn set_parameters(&mut self, p: &[f64]) -> Result<(), Refusal> {
        let Some(parameters) = &mut self.parameters else { return Ok(()) };
        let (damping, gravity) = parameters.constants(p, &mut self.system.rod);
        self.system.rod.check()?;
        crate::material::positive_or_none("damping.stiffness", self.damping.stiffness, damping.stiffness)?;
        crate::material::positive_or_none("damping.mass", self.damping.mass, damping.mass)?;
        self.damping = damping;
        self.system.loads.gravity = gravity;
        self.system.moves.take(p);
        self.system.set_stiffness(0.0, None);
        if let Some(twist) = &mut self.twist {
            twist.take_constants(&self.system, p);
        }
        Ok(())
    }

    fn parameter_jacobian(&mut self, of: &SolvedStep<'_>, columns: &mut [f64]) {
        self.set_edges_of(of.at, of.u);
        if let Some(spin) = &mut self.spin {
            spin.measure(&self.system).expect("the step was accepted before");
        }
        let Some(mut parameters) = self.parameters.take() else { return };
        let all = parameters.list.iter().zip(&parameters.slopes);
        columns.fill(0.0);
        for ((p, &slope), column) in all.zip(columns.chunks_exact_mut(of.u.len())) {
            if !p.change.is_of_constants() {
                continue;
            }
            let gravity = parameters.change_of_gravity(&p.change, &self.system.loads.gravity);
            self.change_of_equations(of, &p.change, gravity, &parameters.none, column);
            column.iter_mut().for_each(|g| *g *= slope);
        }
        for p in 0..parameters.len() {
            if !parameters.list[p].change.supports.is_empty() {
                let column = &mut columns[p * of.u.len()..(p + 1) * of.u.len()];
                self.moved_equations(of, p, &mut parameters.moved, column);
            }
        }
        self.parameters = Some(parameters);
    }

    fn initial_parameter_jacobian(&mut self, columns: &mut [f64]) {
        columns.fill(0.0);
        if self.is_at_rest {
            return self.rest_by_parameters(columns);
        }
        let (layout, given) = (&self.system.layout, self.control_len());
        let (Some(parameters), Some(twist)) = (&mut self.parameters, &mut self.twist) else { return };
        // angles that are part of the control do not follow
        let first = 6 * layout.free_vertices.len();
        if given > first {
            return;
        }
        let all = parameters.list.iter().zip(&parameters.slopes);
        for (p, ((of, slope), column)) in all.zip(columns.chunks_exact_mut(layout.state())).enumerate() {
            let angles = &mut column[first..first + layout.free_angles.len()];
            twist.change(&of.change, angles);
            angles.iter_mut().for_each(|a| *a *= slope);
            if !of.change.supports.is_empty() {
                twist.moved_add(p, &mut parameters.moved, &mut column[first..first + layout.following()]);
            }
        }
    }

    fn advance_parameters_tangent(&mut self, of: &SolvedStep<'_>, dp: &[f64], dx_next: &mut [f64]) {
        if let Some(end) = self.system.layout.end_angle() {
            for (dp, rate) in dp.iter().zip(self.end_angle_rates(of)) {
                dx_next[end] += rate * dp;
            }
        }
    }

    fn advance_parameters_adjoint(&mut self, of: &SolvedStep<'_>, lambda: &[f64], dp: &mut [f64]) {
        if let Some(end) = self.system.layout.end_angle().filter(|end| lambda[*end] != 0.0) {
            for (dp, rate) in dp.iter_mut().zip(self.end_angle_rates(of)) {
                *dp += rate * lambda[end];
            }
        }
    }

    fn has_second_parameters(&self) -> bool {
        true
    }

    fn keep_second_parameters(
        &mut self,
        of: &SolvedStep<'_>,
        lambda: &[f64],
        mu: &[f64],
        [by_x, by_u]: [&mut [f64]; 2],
        square: &mut [f64],
    ) {
        let Some(mut parameters) = self.parameters.take() else { return };
        let mut work = std::mem::take(&mut parameters.second);
        let acting = self.acting(of);
        let columns = [&mut *by_x, &mut *by_u];
        self.second_of_constants(of, mu, (&parameters, &mut work, &acting), columns, square);
        if !self.system.moves.is_empty() {
            self.second_of_moves(of, [lambda, mu], (&mut work, &acting), [by_x, by_u], square);
        }
        parameters.second = work;
        self.parameters = Some(parameters);
    }

    fn initial_second_parameters_add(
        &mut self,
        _t: f64,
        [dz, dp]: [&[f64]; 2],
        lambda: &[f64],
        [out_z, out_p]: [&mut [f64]; 2],
    ) {
        if self.is_at_rest {
            return self.second_of_rest(dp, lambda, out_p);
        }
        let parameters = self.parameters.take();
        self.second_of_initial(dz, lambda, out_z, parameters.as_deref().map(|p| (p, dp, out_p)));
        self.parameters = parameters;
    }
}

impl RodStep {
    /// Parameters move supports from now on.
    fn take_moves(&mut self, moves: Moves) {
        if let Some(twist) = &mut self.twist {
            twist.take_moves(&moves);
        }
        self.system.moves = moves;
    }

    /// What supports that a parameter moves add to ∂G/∂p at the present shape, that of a solved step:
    /// with w(t) the increment of held places and local angles at the time of a configuration,
    ///
    /// ```text
    /// ∂²Φ/∂u∂(x, α) w(t*) − (β/η) Σ_j w_j ∇ε k ∇ε(past j)ᵀ w(t_j)
    ///                     − ∂F/∂v (w(t*) − w*)/η
    /// ```
    fn moved_equations(&mut self, of: &SolvedStep<'_>, p: usize, work: &mut Increments, dg: &mut [f64]) {
        let stage = self.stage(of.at);
        let (s, Increments { places, start, one, angles, full }) = (&self.system, &mut *work);
        full.fill(0.0);
        let moved = s.moved_increment(&s.shape, p, stage.of.time, places, angles).is_some();
        if moved {
            s.elastic_second_add(places, angles, full);
            for (&g, &unknown) in full.iter().zip(&s.layout.unknown) {
                if unknown != FIXED {
                    dg[unknown] += g;
                }
            }
        }
        if !s.loads.of_motion.is_empty() {
            if !moved {
                places.fill(Vector3::zeros());
                angles.fill(0.0);
            }
            let from = StageStart { places: &self.start_of_all, length: stage.of.length };
            start.fill(Vector3::zeros());
            let times = [of.at.start, of.at.start - of.at.previous.unwrap_or(0.0)];
            for (share, time) in stage.of.from.into_iter().zip(times).filter(|(share, _)| *share != 0.0) {
                s.moved_places(p, time, one).expect("the step was accepted before");
                start.iter_mut().zip(&*one).for_each(|(start, one)| *start += one * share);
            }
            // nothing moves at rest
            let from = (!self.is_at_rest).then_some(from);
            s.moved_loads_add(from, [places, start], angles, dg);
        }
        let [holonomy, end, _] = self.kept_lengths();
        if let Some(viscous) = &mut self.viscous {
            viscous.moved_add(&self.system, (of.at, &stage), &of.kept[holonomy + end..], p, work, dg);
        }
    }

    /// How the end clamp's angle depends on parameters that move supports, in the present shape, that of
    /// x_{k+1}: a rate for each.
    pub(crate) fn end_angle_by_parameters(&mut self, at: &Interval, rates: &mut [f64]) {
        rates.fill(0.0);
        let Some(parameters) = self.parameters.as_mut().filter(|_| !rates.is_empty()) else { return };
        let Increments { places, angles, .. } = &mut parameters.moved;
        let s = &self.system;
        for (p, rate) in rates.iter_mut().enumerate() {
            if !parameters.list[p].change.supports.is_empty() {
                *rate = s.moved_increment(&s.shape, p, at.end(), places, angles).unwrap_or(0.0);
            }
        }
    }

    /// These rates, as they were kept.
    fn end_angle_rates<'a>(&self, of: &SolvedStep<'a>) -> &'a [f64] {
        let [stage, next, _] = self.kept_lengths();
        &of.kept[stage..stage + next][HOLONOMY * self.system.layout.segments..]
    }

    /// What a change of the constants does to G at the present shape, that of a solved step.
    fn change_of_equations(
        &mut self,
        of: &SolvedStep<'_>,
        change: &Change,
        more_gravity: Vector3<f64>,
        none: &PastStrains,
        dg: &mut [f64],
    ) {
        let h = self.scheme.stage(of.at).length;
        let past = self.viscous.as_ref().map_or(none, KelvinVoigt::past);
        let moves = if self.is_at_rest { 0.0 } else { 1.0 / h };
        let rates = [self.damping.stiffness, change.damping.stiffness].map(|beta| moves * beta);
        self.system.change_of_elastic(change, rates, past);
        for (full, &unknown) in self.system.layout.unknown.iter().enumerate() {
            if unknown != FIXED {
                dg[unknown] = self.system.gradient[full];
            }
        }
        let s = &self.system;
        let ([k, c], rate) = (self.inertia(h), moves * change.damping.mass);
        for (f, &v) in s.layout.free_vertices.iter().enumerate() {
            let (mass, more) = (s.rod.masses[v], change.masses.get(v).copied().unwrap_or(0.0));
            let (d, e) = (s.x[v] - self.target[f], s.x[v] - self.start[f]);
            let force = (d * k + e * c - s.loads.gravity) * more + (e * rate - more_gravity) * mass;
            let i = s.layout.unknown[s.layout.vertex(v)];
            (0..3).for_each(|a| dg[i + a] += force[a]);
        }
        if let Some(spin) = self.spin.as_ref().filter(|_| s.layout.spins) {
            spin.change(s, &change.spin_inertia, [k, c], rate, dg);
        }
    }
}

impl RodStep {
    /// Second derivatives of μᵀG with constants: see `keep_second_parameters`. Inertia and gravity give
    ///
    /// ```text
    /// μ·(d k + e c − g) m,   d = Y − X* − η V*,  e = Y − X*
    /// ```
    fn second_of_constants(
        &mut self,
        of: &SolvedStep<'_>,
        mu: &[f64],
        (parameters, work, acting): (&Parameters, &mut Second, &[Acting]),
        [by_x, by_u]: [&mut [f64]; 2],
        square: &mut [f64],
    ) {
        let stage = self.stage(of.at);
        let (h, from) = (stage.of.length, stage.of.from);
        let moves = if self.is_at_rest { 0.0 } else { 1.0 / h };
        let s = &self.system;
        let (own, nf) = (s.layout.state(), s.layout.free_vertices.len());
        let Second { along, mu: all, full, gravities, stresses, first, .. } = work;
        square.fill(0.0);
        all.resize(s.layout.full(), 0.0);
        full.resize(s.layout.full(), 0.0);
        s.layout.fill(mu, all);
        s.along(&Increment(all), along);
        let past = self.viscous.as_mut().map(KelvinVoigt::take_past);
        let strained = Strained {
            rate: self.damping.stiffness * moves,
            moves,
            past: past.as_ref().unwrap_or(&parameters.none),
            along,
        };
        let [k, c] = self.inertia(h);
        let kept_lengths = self.kept_lengths();
        let gravity = s.loads.gravity;
        gravities.clear();
        gravities.extend(parameters.list.iter().map(|p| parameters.change_of_gravity(&p.change, &gravity)));
        let moved = |s: &System, v: usize| {
            let first = s.layout.vertex(v);
            Vector3::from_column_slice(&all[first..first + 3])
        };
        by_x.fill(0.0);
        first.clear();
        let (states, unknowns) = (of.x.len(), of.u.len());
        for (p, (parameter, slope)) in parameters.list.iter().zip(&parameters.slopes).enumerate() {
            let change = &parameter.change;
            let by_x = &mut by_x[p * states..(p + 1) * states];
            let by_u = &mut by_u[p * unknowns..(p + 1) * unknowns];
            let mut sum = self.system.second_of_change(change, strained, full);
            self.system.layout.take(full, by_u);
            acting.iter().for_each(|a| a.with_constant(p, slope * dot(full, &a.now), square));
            let rate = change.damping.mass * moves;
            for (f, &v) in self.system.layout.free_vertices.iter().enumerate() {
                let s = &self.system;
                let (mass, more) = (s.rod.masses[v], change.masses.get(v).copied().unwrap_or(0.0));
                let (d, e, mu) = (s.x[v] - self.target[f], s.x[v] - self.start[f], moved(s, v));
                let force = (d * k + e * c - gravity) * more + (e * rate - gravities[p]) * mass;
                sum += force.dot(&mu);
                let i = s.layout.unknown[s.layout.vertex(v)];
                let on_place = mu * (more * (k + c) + mass * rate);
                (0..3).for_each(|a| by_u[i + a] += on_place[a]);
                mixed_add(from, by_x, own, 3 * f, (-on_place).into());
                mixed_add(from, by_x, own, 3 * (nf + f), (mu * (-more * k * h)).into());
            }
            if let Some(viscous) = &mut self.viscous
                && self.system.past_of_change(change, strained, stresses)
            {
                let kept = &of.kept[kept_lengths[0] + kept_lengths[1]..];
                let layout = &self.system.layout;
                viscous.past_transpose_add(layout, &stage, kept, stresses, by_x);
                for j in (0..stage.past().count()).filter(|_| !acting.is_empty()) {
                    let on = viscous.of_stresses(layout, j, stresses);
                    acting.iter().for_each(|a| a.with_constant(p, slope * dot(on, &a.past[j]), square));
                }
            }
            if let Some(spin) = self.spin.as_mut().filter(|_| self.system.layout.spins) {
                let of = (&change.spin_inertia[..], [k, c], rate);
                sum += spin.second_of_change(&self.system, of, [&mut *by_x, &mut *by_u]);
            }
            by_x.iter_mut().chain(by_u).for_each(|b| *b *= slope);
            first.push(sum);
        }
        parameters.square_add(&self.system, strained, first, square);
        self.second_of_masses(parameters, (all, gravities), moves, square);
        if let (Some(viscous), Some(past)) = (&mut self.viscous, past) {
            viscous.put_past(past);
        }
    }

    /// What inertia, mass-proportional damping and gravity add to ∂²(μᵀG)/∂p².
    fn second_of_masses(
        &self,
        parameters: &Parameters,
        (all, gravities): (&[f64], &[Vector3<f64>]),
        moves: f64,
        square: &mut [f64],
    ) {
        let s = &self.system;
        let moved = |v: usize| Vector3::from_column_slice(&all[s.layout.vertex(v)..s.layout.vertex(v) + 3]);
        let weighed: Vector3<f64> = s.layout.free_vertices.iter().map(|&v| moved(v) * s.rod.masses[v]).sum();
        for (i, a) in parameters.list.iter().enumerate() {
            for (j, b) in parameters.list.iter().enumerate().take(i + 1) {
                let [a, b] = [&a.change, &b.change];
                let mut sum = 0.0;
                if let Some(spin) = self.spin.as_ref().filter(|_| s.layout.spins) {
                    let rates = [a, b].map(|change| change.damping.mass * moves);
                    sum += spin.second_of_changes([&a.spin_inertia, &b.spin_inertia], rates);
                }
                if !(a.masses.is_empty() && b.masses.is_empty()) {
                    let rates = [a, b].map(|change| change.damping.mass * moves);
                    for (f, &v) in s.layout.free_vertices.iter().enumerate() {
                        let e = s.x[v] - self.start[f];
                        let [ma, mb] = [a, b].map(|change| change.masses.get(v).copied().unwrap_or(0.0));
                        let force = (e * rates[1] - gravities[j]) * ma + (e * rates[0] - gravities[i]) * mb;
                        sum += force.dot(&moved(v));
                    }
                }
                if a.gravity_turn != Vector3::zeros() || b.gravity_turn != Vector3::zeros() {
                    let changes = [&gravities[i], &gravities[j]];
                    sum -=
                        parameters.second_change_of_gravity([a, b], changes, &s.loads.gravity).dot(&weighed);
                }
                parameters.both_add(square, [i, j], sum);
            }
        }
    }
}
