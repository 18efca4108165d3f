//! The step of a rod in the generic layer: its maps, and its products with ∂G/∂x_k.

use std::ops::Range;

use nalgebra::Vector3;
use varda_implicit::{
    ImplicitModel, ImplicitStep, Interval, Model, Multipliers, Refusal, Scheme, SolvedStep, Structure,
    Substepped,
};

use crate::Error;
use crate::dynamics::RodStep;
use crate::element::STRAINS;
use crate::equations::RodEquations;
use crate::layout::band_product_add;
use crate::second_order::Increment;
use crate::shape::{HOLONOMY, holonomy, holonomy_transpose_add, kept_bend};
use crate::stage::{RodStage, mixed, mixed_add};

impl RodStep {
    /// The model whose step k starts at (first_index + k) · length seconds, compiled in this crate.
    ///
    /// # Panics
    /// As [`ImplicitModel::new`].
    pub fn model(self, first_index: usize, length: f64) -> Box<dyn Model + Send> {
        Box::new(ImplicitModel::new(self, first_index, length))
    }

    /// The model whose step k is all steps between `times` (s) from the k-th to the next time of `through`,
    /// compiled in this crate.
    ///
    /// # Panics
    /// As [`ImplicitModel::on_times`] and [`Substepped::through`].
    pub fn model_on_times(self, times: &[f64], through: &[f64]) -> Box<dyn Model + Send> {
        Box::new(Substepped::through(ImplicitModel::on_times(self, times.to_vec()), times, through))
    }

    /// Angles and spins of a first state in whose place of angles those in equilibrium are, the end clamp's
    /// last: `given` ones, or these and no spins.
    fn place_angles(&self, given: &[f64], x: &mut [f64]) {
        let layout = &self.system.layout;
        if !layout.spins {
            return;
        }
        let (first, angles) = (layout.first_spin(), layout.free_angles.len());
        if let Some(end) = layout.end_angle() {
            x[end] = x[first];
        }
        x[first..first + angles].fill(0.0);
        if !given.is_empty() {
            x[first - angles..first + angles].copy_from_slice(given);
        }
    }

    /// The part of x_{k+1} = S(x_k, u) that is linear: all of it but the end clamp's angle.
    pub(crate) fn follow(&mut self, at: &Interval, x: &[f64], u: &[f64], x_next: &mut [f64]) {
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

    /// The end clamp's angle at x_{k+1}, on the branch of `before`, that at x_k, and the turn of the clamps.
    fn next_end_angle(&mut self, at: &Interval, before: f64, x_next: &[f64]) -> Result<f64, Error> {
        let s = &mut self.system;
        let (turned, _) = s.clamps_turn(at.start, at.end())?;
        s.place(at.end())?;
        s.scatter_state(x_next);
        s.update_shape(true, before + turned)?;
        Ok(s.theta[s.layout.segments - 1])
    }

    /// Edges and turns of x_{k+1}, for the holonomy of the end clamp's angle.
    pub(crate) fn set_edges_of_next(&mut self, at: &Interval, x: &[f64], u: &[f64]) {
        let mut next = std::mem::take(&mut self.state);
        self.follow(at, x, u, &mut next);
        self.system.place(at.end()).expect("the step was accepted before");
        self.system.scatter_state(&next);
        self.system.shape.set_edges(&self.system.x, true).expect("the step was accepted before");
        self.state = next;
    }

    /// Adds to λ what its component of the end clamp's angle means for the places of x_{k+1}.
    fn end_angle_transpose(&mut self, next: &[f64], end: usize, lambda: &mut [f64]) {
        self.psi.fill(0.0);
        *self.psi.last_mut().expect("a rod has edges") = lambda[end];
        self.displacement.fill(Vector3::zeros());
        holonomy_transpose_add(kept_bend(next), &self.psi, &mut self.displacement);
        for (f, &v) in self.system.layout.free_vertices.iter().enumerate() {
            for c in 0..3 {
                lambda[3 * f + c] += self.displacement[v][c];
            }
        }
    }

    /// Whether ∂G/∂x_k depends on the shapes of x_k and u, beside inertia and damping.
    fn couples(&self) -> bool {
        !self.is_at_rest && (self.spin.is_some() || !self.system.loads.of_motion.is_empty())
    }

    /// Lengths of what a solved step keeps: the holonomies of the stage and of x_{k+1}, and damping's part.
    pub(crate) fn kept_lengths(&self) -> [usize; 3] {
        let layout = &self.system.layout;
        let holonomy = |needed: bool| if needed { HOLONOMY * layout.segments } else { 0 };
        let damping = self.viscous.as_ref().map_or(0, |viscous| viscous.kept(layout));
        // behind that of the next configuration what parameters do to its end angle
        let end = layout.end_angle().map_or(0, |_| holonomy(true) + self.system.moves.span());
        [holonomy(!layout.free_angles.is_empty()), end, damping]
    }

    /// The transpose of `follow`, and of the holonomy between the unknowns' angles and those stored.
    pub(crate) fn follow_transpose(
        &mut self,
        of: &SolvedStep<'_>,
        lambda: &[f64],
        dx: &mut [f64],
        du: &mut [f64],
    ) {
        let kept = &of.kept[..self.kept_lengths()[0]];
        let RodStage { of, angle, .. } = self.stage(of.at);
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
        let angles = &lambda[6 * nf..6 * nf + layout.free_angles.len()];
        for (f, &e) in layout.free_angles.iter().enumerate() {
            du[layout.unknown[layout.angle(e)]] = angle[0] * angles[f];
            mixed_add([angle[1], angle[2]], dx, own, 6 * nf + f, [angles[f]]);
        }
        // θ_{k+1} is read by nobody in most windows: then nothing comes back through the holonomy.
        if angles.iter().all(|a| *a == 0.0) {
            return;
        }
        self.psi.fill(0.0);
        for (f, &e) in self.system.layout.free_angles.iter().enumerate() {
            self.psi[e] = angle[0] * angles[f];
        }
        self.displacement.fill(Vector3::zeros());
        holonomy_transpose_add(kept_bend(kept), &self.psi, &mut self.displacement);
        let layout = &self.system.layout;
        for &v in &layout.free_vertices {
            let i = layout.unknown[layout.vertex(v)];
            for c in 0..3 {
                du[i + c] += self.displacement[v][c];
            }
        }
    }
}

impl ImplicitStep for RodStep {
    type Equations<'a> = RodEquations<'a>;

    fn dim(&self) -> usize {
        self.system.layout.state() + self.history()
    }

    fn history(&self) -> usize {
        self.repeated()
    }

    fn unknowns(&self) -> usize {
        self.system.layout.unknowns
    }

    fn structure(&self) -> Structure {
        self.system.structure()
    }

    /// Velocities are the rates of positions; not midpoint's, which ring in motions faster than a step, and
    /// not those of a rod at rest, which are differences.
    fn velocities(&self) -> Option<(Range<usize>, usize)> {
        let positions = 3 * self.system.layout.free_vertices.len();
        let rated = self.scheme != Scheme::Midpoint && !self.is_at_rest;
        rated.then_some((0..positions, positions))
    }

    fn equations<'a>(&'a mut self, at: &Interval, x: &'a [f64]) -> Result<RodEquations<'a>, Refusal> {
        self.prepare(at, x)?;
        Ok(RodEquations { step: self, at: *at, x })
    }

    fn advance(&mut self, at: &Interval, x: &[f64], u: &[f64], x_next: &mut [f64]) {
        self.follow(at, x, u, x_next);
        self.advance_spins(at, x, u, x_next);
        if let Some(end) = self.system.layout.end_angle() {
            // a motion that is unusable at the end of the step shows as a state that is not finite
            x_next[end] = self.next_end_angle(at, x[end], x_next).unwrap_or(f64::NAN);
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
        self.recover_angles(at, x, x_next, u);
    }

    fn kept(&self) -> usize {
        self.kept_lengths().iter().sum()
    }

    fn keep(&mut self, at: &Interval, x: &[f64], u: &[f64], kept: &mut [f64]) {
        if kept.is_empty() {
            return;
        }
        let [stage, next, _] = self.kept_lengths();
        let (stage, rest) = kept.split_at_mut(stage);
        let (next, damping) = rest.split_at_mut(next);
        self.set_edges_of(at, u);
        self.system.shape.keep_holonomy(stage);
        if let Some(viscous) = &self.viscous {
            viscous.keep(&self.system, damping);
        }
        if !next.is_empty() {
            self.set_edges_of_next(at, x, u);
            let (holonomy, rates) = next.split_at_mut(HOLONOMY * self.system.layout.segments);
            self.system.shape.keep_holonomy(holonomy);
            self.end_angle_by_parameters(at, rates);
        }
    }

    fn previous(&mut self, step: &SolvedStep<'_>, dx: &[f64], dg: &mut [f64]) {
        dg.fill(0.0);
        let stage = self.stage(step.at);
        let of = stage.of;
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
        let [angles, end, _] = self.kept_lengths();
        if let Some(viscous) = &mut self.viscous {
            viscous.previous_add(&self.system.layout, &stage, &step.kept[angles + end..], dx, dg);
        }
        if !self.couples() {
            return;
        }
        self.prepare_and_shape(step.at, step.x, step.u);
        if let Some(spin) = &mut self.spin {
            spin.previous_add(&self.system, dx, dg);
        }
        if !self.system.loads.of_motion.is_empty() {
            self.star(of.from, dx);
            let star = &self.star;
            self.system.couple_loads(self.stage_start(h), false, |i| star[i], |i, value| dg[i] += value);
        }
    }

    fn previous_transpose_add(&mut self, step: &SolvedStep<'_>, mu: &[f64], dx: &mut [f64]) {
        let stage = self.stage(step.at);
        let of = stage.of;
        let (own, nf) = (self.system.layout.state(), self.system.layout.free_vertices.len());
        let inertia = self.inertia(of.length);
        for (f, &v) in self.system.layout.free_vertices.iter().enumerate() {
            let [k, c] = inertia.map(|rate| rate * self.system.rod.masses[v]);
            let i = self.system.layout.unknown[self.system.layout.vertex(v)];
            let mu = [mu[i], mu[i + 1], mu[i + 2]];
            mixed_add(of.from, dx, own, 3 * f, mu.map(|mu| -(k + c) * mu));
            mixed_add(of.from, dx, own, 3 * (nf + f), mu.map(|mu| -k * of.length * mu));
        }
        let [angles, end, _] = self.kept_lengths();
        if let Some(viscous) = &mut self.viscous {
            let kept = &step.kept[angles + end..];
            viscous.previous_transpose_add(&self.system.layout, &stage, kept, mu, dx);
        }
        if !self.couples() {
            return;
        }
        self.prepare_and_shape(step.at, step.x, step.u);
        if let Some(spin) = &mut self.spin {
            spin.previous_transpose_add(&self.system, mu, dx);
        }
        if !self.system.loads.of_motion.is_empty() {
            let mut star = std::mem::take(&mut self.star);
            star.fill(0.0);
            self.system.couple_loads(
                self.stage_start(of.length),
                true,
                |i| mu[i],
                |i, value| star[i] += value,
            );
            self.star_transpose_add(of.from, &star, dx);
            self.star = star;
        }
    }

    fn advance_tangent(&mut self, step: &SolvedStep<'_>, dx: &[f64], du: &[f64], dx_next: &mut [f64]) {
        // du takes the place of u, dx that of x
        self.follow(step.at, dx, du, dx_next);
        let [stage, next, _] = self.kept_lengths();
        let (of_stage, kept) = step.kept.split_at(stage);
        if let Some(end) = self.system.layout.end_angle() {
            self.system.displacements(dx_next, &mut self.displacement);
            holonomy(kept_bend(&kept[..next]), &self.displacement, &mut self.psi);
            dx_next[end] = self.psi[self.psi.len() - 1];
        }
        if self.system.layout.free_angles.is_empty() {
            return;
        }
        self.system.unknown_displacements(du, &mut self.displacement);
        holonomy(kept_bend(of_stage), &self.displacement, &mut self.psi);
        let (layout, share) = (&self.system.layout, self.stage(step.at).angle[0]);
        let angles = &mut dx_next[6 * layout.free_vertices.len()..];
        for (angle, &e) in angles.iter_mut().zip(&layout.free_angles) {
            *angle += share * self.psi[e];
        }
        self.advance_spins_tangent(step, dx, du, dx_next);
    }

    fn advance_adjoint(&mut self, step: &SolvedStep<'_>, lambda: &[f64], dx: &mut [f64], du: &mut [f64]) {
        dx.fill(0.0);
        let end = self.system.layout.end_angle().filter(|end| lambda[*end] != 0.0);
        let spins = self.system.layout.spins;
        if end.is_none() && !spins {
            return self.follow_transpose(step, lambda, dx, du);
        }
        let mut to = std::mem::take(&mut self.lambda);
        to.clear();
        to.extend_from_slice(lambda);
        if let Some(end) = end {
            let [stage, next, _] = self.kept_lengths();
            self.end_angle_transpose(&step.kept[stage..stage + next], end, &mut to);
        }
        if spins {
            self.advance_spins_transpose(step, &mut to, dx);
        }
        self.follow_transpose(step, &to, dx, du);
        if spins {
            self.spins_onto_stage(du);
        }
        self.lambda = to;
    }

    /// Not with loads without second derivatives.
    fn second_kept(&self) -> Option<usize> {
        let (s, layout) = (&self.system, &self.system.layout);
        let given = s.loads_have_second_derivatives();
        let damping = self.viscous.as_ref().map_or(0, |viscous| viscous.second_kept(layout));
        given.then(|| {
            self.second_bands() * layout.band() + damping + self.second_of_motion().iter().sum::<usize>()
        })
    }

    fn keep_second(&mut self, step: &SolvedStep<'_>, lambda: &[f64], mu: &[f64], second: &mut [f64]) {
        let bands = self.second_bands() * self.system.layout.band();
        let (bands, rest) = second.split_at_mut(bands);
        let [started, turning] = self.second_of_motion();
        let (rest, turning) = rest.split_at_mut(rest.len() - turning);
        let (damping, started) = rest.split_at_mut(rest.len() - started);
        let (band, next) = bands.split_at_mut(self.system.layout.band());
        next.fill(0.0);
        let turns = self.turns_with_frames(step.at);
        if self.curves_next_by(step.at, lambda) {
            match turns {
                true => drop(self.set_next_of(step.at, step.x, step.u)),
                false => self.set_edges_of_next(step.at, step.x, step.u),
            }
            self.angles_of(lambda, if turns { 1.0 } else { 0.0 });
            if let Some(end) = self.system.layout.end_angle() {
                *self.psi.last_mut().expect("a rod has edges") += lambda[end];
            }
            self.system.holonomy_second_add(&self.system.shape, &mut self.psi, next);
        }
        self.prepare_and_shape(step.at, step.x, step.u);
        self.full.resize(self.system.layout.full(), 0.0);
        self.system.layout.fill(mu, &mut self.full);
        band.fill(0.0);
        let kept = self.kept_lengths();
        let Self { system, full, viscous, .. } = self;
        match viscous {
            Some(viscous) => {
                let (strained, bands) = damping.split_at_mut(STRAINS * system.layout.segments);
                system.third_add(&Increment(full), band, Some(strained));
                let of = [&step.kept[kept[0] + kept[1]..], full];
                viscous.keep_second(system, &system.layout.free_angles, of, bands);
            }
            None => system.third_add(&Increment(full), band, None),
        }
        if !self.system.loads.of_motion.is_empty() {
            let start = self.start_of_motion(self.stage(step.at).of.length);
            self.system.second_of_loads(start, &Increment(&self.full), band, started);
            self.system.second_of_moments(start, &Increment(&self.full), band);
        }
        let stage = self.stage(step.at);
        if let Some(spin) = &mut self.spin {
            spin.keep_second(&self.system, &stage, [lambda, &self.full], turning);
        }
        self.angles_of(lambda, if turns { 0.0 } else { stage.angle[0] });
        self.system.holonomy_second_add(&self.system.shape, &mut self.psi, band);
    }

    fn second_add(
        &mut self,
        step: &SolvedStep<'_>,
        at: &Multipliers<'_>,
        [dx, du]: [&[f64]; 2],
        [rx, ru]: [&mut [f64]; 2],
    ) {
        let layout = &self.system.layout;
        let (bands, rest) = at.kept.split_at(self.second_bands() * layout.band());
        let [started, turning] = self.second_of_motion();
        let (rest, turning) = rest.split_at(rest.len() - turning);
        let (damping, started) = rest.split_at(rest.len() - started);
        let (band, next) = bands.split_at(layout.band());
        band_product_add(layout.half_bandwidth, band, du, ru);
        let [angles, end, _] = self.kept_lengths();
        let stage = self.stage(step.at);
        if let Some(viscous) = &mut self.viscous {
            let kept = &step.kept[angles + end..];
            viscous.second_add(&self.system.layout, &stage, [kept, damping], [dx, du], [&mut *rx, &mut *ru]);
        }
        if !started.is_empty() {
            self.star(stage.of.from, dx);
            let [mut on_star, by] = std::mem::take(&mut self.of_unknowns);
            on_star.clear();
            on_star.resize(du.len(), 0.0);
            self.system.second_of_start_add(started, [du, &self.star], ru, &mut on_star);
            self.star_transpose_add(stage.of.from, &on_star, rx);
            self.of_unknowns = [on_star, by];
        }
        if self.spin.is_some() {
            self.prepare_and_shape(step.at, step.x, step.u);
        }
        if let Some(spin) = &mut self.spin {
            spin.second_add(&self.system, turning, [dx, du], [&mut *rx, &mut *ru]);
        }
        if self.curves_next_by(step.at, at.lambda) {
            self.second_of_next(step, next, [dx, du], [rx, ru]);
        }
    }

    fn initial_second_add(&mut self, _t: f64, dz: &[f64], lambda: &[f64], out: &mut [f64]) {
        if !self.is_at_rest {
            self.second_of_initial(dz, lambda, out, None);
        }
    }

    fn control_dim(&self) -> usize {
        self.control_len()
    }

    fn initial_state(&mut self, t: f64, z: &[f64], x: &mut [f64]) -> Result<(), Refusal> {
        let (n, own) = (6 * self.system.layout.free_vertices.len(), self.system.layout.state());
        x[..n].copy_from_slice(&z[..n]);
        if let Some(twist) = &mut self.twist {
            let following = self.system.layout.following();
            twist.solve(t, &z[..n / 2], &mut x[n..n + following])?;
        }
        self.place_angles(&z[n..], &mut x[..own]);
        self.come_to_rest(t, &mut x[..own])
    }

    fn initial_tangent(&mut self, _t: f64, dz: &[f64], dx: &mut [f64]) {
        if self.is_at_rest {
            return dx.fill(0.0);
        }
        let (n, own) = (6 * self.system.layout.free_vertices.len(), self.system.layout.state());
        dx[..n].copy_from_slice(&dz[..n]);
        if let Some(twist) = &mut self.twist {
            let following = self.system.layout.following();
            twist.tangent(&dz[..n / 2], &mut dx[n..n + following]);
        }
        self.place_angles(&dz[n..], &mut dx[..own]);
    }

    fn initial_adjoint(&mut self, _t: f64, lambda: &[f64], dz: &mut [f64]) {
        if self.is_at_rest {
            return dz.fill(0.0);
        }
        let layout = &self.system.layout;
        let (n, first) = (6 * layout.free_vertices.len(), layout.first_spin());
        let given = (dz.len() - n) / 2;
        dz[..n].copy_from_slice(&lambda[..n]);
        dz[n..n + given].copy_from_slice(&lambda[n..n + given]);
        dz[n + given..].copy_from_slice(&lambda[first..first + given]);
        let Some(twist) = &mut self.twist else { return };
        // angles that are given do not depend on the places
        let mut angles = std::mem::take(&mut self.lambda);
        angles.clear();
        angles.extend_from_slice(&lambda[n..first]);
        angles.extend(layout.end_angle().map(|end| lambda[end]));
        angles[..given].fill(0.0);
        twist.adjoint_add(&angles, &mut dz[..n / 2]);
        self.lambda = angles;
    }
}
