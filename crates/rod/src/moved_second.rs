//! Second derivatives of a step with parameters that move its supports.
//!
//! Every configuration that L = λᵀS + μᵀG depends on, the stage, where it starts, those of the past and
//! x_{k+1}, is c(x_k, u, p): the unknowns, and the places and sections that supports give. With the
//! increment w_p of a configuration by p, stored angles and free vertices kept,
//!
//! ```text
//! ∂²L/∂u∂p = L_cc w_p,   ∂²L/∂p∂q = w_pᵀ L_cc w_q + L_cᵀ w_pq
//! ```
//!
//! L_cc is that of [`second_order`](crate::second_order) of a rod with nothing held. Its coordinates are
//! fixed at the present configuration, so that w_pq of a clamp's turn is as in
//! [`System::moved_twice`]. μ moves nothing that is held: K is zero there, and KᵀH w_p is left out with
//! the same of the equation of angles, (H (du + w_p dp) + G_x dx)_α = 0.

use varda_implicit::SolvedStep;
use varda_linalg::dot;

use crate::change::Second;
use crate::dynamics::RodStep;
use crate::element::STRAINS;
use crate::layout::{Layout, band_product_add};
use crate::moved_increment::{Increments, in_full_order};
use crate::second_order::Increment;
use crate::shape::Shape;
use crate::system::System;

/// What a parameter does to the configurations of a step by moving supports, in the full order.
pub(crate) struct Acting {
    pub(crate) parameter: usize,
    /// The stage, the places it starts from, and the configurations of the past.
    pub(crate) now: Vec<f64>,
    start: Vec<f64>,
    pub(crate) past: Vec<Vec<f64>>,
}

impl Acting {
    /// Adds a second derivative with parameter q of constants.
    pub(crate) fn with_constant(&self, q: usize, second: f64, square: &mut [f64]) {
        let m = square.len().isqrt();
        square[self.parameter * m + q] += second;
        square[q * m + self.parameter] += second;
    }
}

/// What acts on the same configurations.
struct On {
    now: Vec<f64>,
    start: Vec<f64>,
    past: Vec<Vec<f64>>,
}

impl On {
    fn none(full: usize, past: usize) -> On {
        On { now: vec![0.0; full], start: vec![0.0; full], past: vec![vec![0.0; full]; past] }
    }

    fn dot(&self, of: &Acting) -> f64 {
        let past = self.past.iter().zip(&of.past).map(|(a, b)| dot(a, b)).sum::<f64>();
        dot(&self.now, &of.now) + dot(&self.start, &of.start) + past
    }
}

impl System {
    /// The increment of a configuration by a parameter that moves supports, in the full order, and what that
    /// does to the end clamp's angle; `None` where nothing moves.
    pub(crate) fn moved_in_full(
        &self,
        shape: &Shape,
        parameter: usize,
        t: f64,
        work: &mut Increments,
    ) -> Option<(Vec<f64>, f64)> {
        let Increments { places, angles, .. } = work;
        let end = self.moved_increment(shape, parameter, t, places, angles)?;
        let mut full = vec![0.0; self.layout.full()];
        in_full_order(&self.layout, places, angles, &mut full);
        Some((full, end))
    }

    /// out += ∂²E/∂c² μ in the full order, at the present shape and stiffness.
    pub(crate) fn elastic_second_of(&self, mu: &Increment, out: &mut [f64]) {
        let n = self.layout.segments;
        let places: Vec<_> = (0..=n).map(|v| mu.place(&self.layout, v)).collect();
        let angles: Vec<f64> = (0..n).map(|e| mu.of_edge(&self.layout, e)[6]).collect();
        self.elastic_second_add(&places, &angles, out);
    }

    /// Calls `visit` with p, q ≤ p and w_pq of a configuration, in `work`, and what both do to the end
    /// clamp's angle.
    pub(crate) fn each_moved_twice(
        &self,
        shape: &Shape,
        t: f64,
        work: &mut Increments,
        mut visit: impl FnMut([usize; 2], &mut Increments, f64),
    ) {
        let acting = self.moves.acting(t);
        for (i, &p) in acting.iter().enumerate() {
            for &q in &acting[..=i] {
                let Increments { places, angles, .. } = &mut *work;
                if let Some(end) = self.moved_twice(shape, [p, q], t, places, angles) {
                    visit([p, q], work, end);
                }
            }
        }
    }

    /// Adds `on`ᵀ w_pq of a configuration, and so much of the end clamp's angle as `on_end`, to second
    /// derivatives by parameters.
    pub(crate) fn moved_twice_add(
        &self,
        shape: &Shape,
        t: f64,
        (on, on_end): (&[f64], f64),
        work: &mut Increments,
        square: &mut [f64],
    ) {
        let m = square.len().isqrt();
        self.each_moved_twice(shape, t, work, |[p, q], Increments { places, angles, full, .. }, end| {
            in_full_order(&self.layout, places, angles, full);
            let second = dot(on, full) + on_end * end;
            square[p * m + q] += second;
            if p != q {
                square[q * m + p] += second;
            }
        });
    }
}

impl RodStep {
    /// What parameters do to the configurations of a step by moving supports, right after it was prepared.
    pub(crate) fn acting(&self, of: &SolvedStep<'_>) -> Vec<Acting> {
        let s = &self.system;
        if s.moves.is_empty() {
            return Vec::new();
        }
        let (stage, full) = (self.stage(of.at), s.layout.full());
        let mut work = Increments::of(s);
        let mut moved = |shape: &Shape, p: usize, t: f64| {
            s.moved_in_full(shape, p, t, &mut work).map_or_else(|| vec![0.0; full], |(moved, _)| moved)
        };
        let before = of.at.previous.unwrap_or(0.0);
        let mut all = Vec::new();
        for parameter in s.moves.parameters() {
            let now = moved(&s.shape, parameter, stage.of.time);
            let mut start = vec![0.0; full];
            if !s.loads.of_motion.is_empty() {
                self.moved_start(of, parameter, &mut start);
            }
            let past = self.viscous.iter().flat_map(|viscous| viscous.past_shapes(&stage));
            let past: Vec<_> =
                past.map(|(age, shape)| moved(shape, parameter, of.at.start - age * before)).collect();
            if [&now, &start].into_iter().chain(&past).any(|moved| moved.iter().any(|x| *x != 0.0)) {
                all.push(Acting { parameter, now, start, past });
            }
        }
        all
    }

    /// `full` = that of the places where the stage starts.
    fn moved_start(&self, of: &SolvedStep<'_>, parameter: usize, full: &mut [f64]) {
        let (s, stage) = (&self.system, self.stage(of.at).of);
        let mut places = vec![nalgebra::Vector3::zeros(); s.x.len()];
        let times = [of.at.start, of.at.start - of.at.previous.unwrap_or(0.0)];
        for (share, time) in stage.from.into_iter().zip(times).filter(|(share, _)| *share != 0.0) {
            s.moved_places(parameter, time, &mut places).expect("the step was accepted before");
            for (v, place) in places.iter().enumerate() {
                let full = &mut full[s.layout.vertex(v)..][..3];
                full.iter_mut().zip(place.iter()).for_each(|(full, x)| *full += share * x);
            }
        }
    }

    /// Adds all that supports moved by parameters bring to the columns of ∂²L/∂x∂p and ∂²L/∂u∂p and
    /// to ∂²L/∂p², right after those of constants.
    pub(crate) fn second_of_moves(
        &mut self,
        of: &SolvedStep<'_>,
        [lambda, mu]: [&[f64]; 2],
        (work, acting): (&mut Second, &[Acting]),
        [by_x, by_u]: [&mut [f64]; 2],
        square: &mut [f64],
    ) {
        let all_free = work.all_free.take().unwrap_or_else(|| self.system.layout.all_free());
        let mut moved = Increments::of(&self.system);
        work.mu.resize(self.system.layout.full(), 0.0);
        self.system.layout.fill(mu, &mut work.mu);
        if !acting.is_empty() {
            self.angles_of(lambda, self.stage(of.at).angle[0]);
            self.second_of_moved_stage(of, (&work.mu, acting, &all_free), [&mut *by_x, &mut *by_u], square);
        }
        self.first_of_moved_stage(of, &work.mu, &mut moved, square);
        self.second_of_moved_next(of, (lambda, &all_free), &mut moved, [by_x, by_u], square);
        work.all_free = Some(all_free);
    }

    /// L_cc w_p of the stage, its start and the past; what acts on ψ is in `psi`.
    fn second_of_moved_stage(
        &mut self,
        of: &SolvedStep<'_>,
        (mu, acting, all_free): (&[f64], &[Acting], &Layout),
        [by_x, by_u]: [&mut [f64]; 2],
        square: &mut [f64],
    ) {
        let (stage, [holonomy, end, _]) = (self.stage(of.at), self.kept_lengths());
        let kept = &of.kept[holonomy + end..];
        let (states, unknowns, m) = (of.x.len(), of.u.len(), square.len().isqrt());
        let mut band = vec![0.0; all_free.band()];
        let past = self.viscous.as_ref().map_or(0, |_| stage.past().count());
        let mut strained = vec![0.0; STRAINS * self.system.layout.segments * past.min(1)];
        let mut bands = vec![0.0; all_free.band() * past];
        // bands of the rod with nothing held
        let held = std::mem::replace(&mut self.system.layout, all_free.clone());
        let mut started = vec![0.0; self.system.second_of_loads_kept()];
        let s = &self.system;
        s.third_add(&Increment(mu), &mut band, (past > 0).then_some(&mut strained[..]));
        if !s.loads.of_motion.is_empty() {
            let start = self.stage_start(stage.of.length);
            s.second_of_loads(Some(start), &Increment(mu), &mut band, &mut started);
            s.second_of_moments(start, &Increment(mu), &mut band);
        }
        s.holonomy_second_add(&s.shape, &mut self.psi, &mut band);
        if let Some(viscous) = &mut self.viscous {
            viscous.keep_second(&self.system, &held.free_angles, [kept, mu], &mut bands);
        }
        let w = all_free.half_bandwidth;
        let of_all = |a: &Acting| {
            let mut on = On::none(all_free.full(), past);
            band_product_add(w, &band, &a.now, &mut on.now);
            if !started.is_empty() {
                let moved = [&a.now[..], &a.start];
                self.system.second_of_start_add(&started, moved, &mut on.now, &mut on.start);
            }
            on
        };
        let mut on_all: Vec<On> = acting.iter().map(of_all).collect();
        self.system.layout = held;
        let layout = &self.system.layout;
        let mut taken = vec![0.0; unknowns];
        for (a, on) in acting.iter().zip(&mut on_all) {
            let p = a.parameter;
            let (by_x, by_u) = (&mut by_x[p * states..][..states], &mut by_u[p * unknowns..][..unknowns]);
            if let Some(viscous) = &mut self.viscous {
                for (j, band) in bands.chunks_exact(all_free.band()).enumerate() {
                    let (at, on) = ((layout, &stage, j), (&mut on.now[..], &mut on.past[j][..]));
                    let moved = [&a.now[..], &a.past[j]];
                    viscous.second_of_both_add(at, [kept, &strained], moved, [on.0, on.1]);
                    band_product_add(w, band, &a.past[j], on.1);
                    viscous.onto_past(at, kept, on.1, by_x);
                }
            }
            layout.take(&on.now, &mut taken);
            by_u.iter_mut().zip(&taken).for_each(|(by, t)| *by += t);
            layout.take(&on.start, &mut taken);
            self.star_transpose_add(stage.of.from, &taken, by_x);
            for b in acting {
                square[b.parameter * m + p] += on.dot(b);
            }
        }
    }

    /// L_cᵀ w_pq of the same.
    fn first_of_moved_stage(
        &self,
        of: &SolvedStep<'_>,
        mu: &[f64],
        work: &mut Increments,
        square: &mut [f64],
    ) {
        let (s, stage, [holonomy, end, _]) = (&self.system, self.stage(of.at), self.kept_lengths());
        let layout = &s.layout;
        let mut on = On::none(layout.full(), 0);
        s.elastic_second_of(&Increment(mu), &mut on.now);
        let before = of.at.previous.unwrap_or(0.0);
        if !s.loads.of_motion.is_empty() {
            let start = self.stage_start(stage.of.length);
            s.loads_transpose_add(Some(start), &Increment(mu), [&mut on.now, &mut on.start]);
            let times = [of.at.start, of.at.start - before];
            for (share, time) in stage.of.from.into_iter().zip(times).filter(|(share, _)| *share != 0.0) {
                let on: Vec<f64> = on.start.iter().map(|on| share * on).collect();
                s.moved_twice_add(&s.shape, time, (&on, 0.0), work, square);
            }
        }
        s.moved_twice_add(&s.shape, stage.of.time, (&on.now, 0.0), work, square);
        if let Some(viscous) = &self.viscous {
            let on = viscous.on_past(layout, &stage, &of.kept[holonomy + end..], mu);
            for ((age, shape), on) in viscous.past_shapes(&stage).zip(&on) {
                s.moved_twice_add(shape, of.at.start - age * before, (on, 0.0), work, square);
            }
        }
    }

    /// Those of the end clamp's angle at x_{k+1}: the shape of that is set.
    fn second_of_moved_next(
        &mut self,
        of: &SolvedStep<'_>,
        (lambda, all_free): (&[f64], &Layout),
        work: &mut Increments,
        [by_x, by_u]: [&mut [f64]; 2],
        square: &mut [f64],
    ) {
        let Some(end) = self.system.layout.end_angle().filter(|end| lambda[*end] != 0.0) else { return };
        self.set_edges_of_next(of.at, of.x, of.u);
        self.psi.fill(0.0);
        *self.psi.last_mut().expect("a rod has edges") = lambda[end];
        let mut band = vec![0.0; all_free.band()];
        let held = std::mem::replace(&mut self.system.layout, all_free.clone());
        self.system.holonomy_second_add(&self.system.shape, &mut self.psi, &mut band);
        self.system.layout = held;

        let (s, t) = (&self.system, of.at.end());
        let moved = |p: usize| Some((p, s.moved_in_full(&s.shape, p, t, work)?.0));
        let all: Vec<(usize, Vec<f64>)> = s.moves.acting(t).into_iter().filter_map(moved).collect();
        let none = vec![0.0; s.layout.full()];
        s.moved_twice_add(&s.shape, t, (&none, lambda[end]), work, square);
        let (states, unknowns, m) = (of.x.len(), of.u.len(), square.len().isqrt());
        let (mut back, mut next) = (vec![0.0; unknowns], vec![0.0; s.layout.state()]);
        for (p, moved) in &all {
            let mut on = none.clone();
            band_product_add(all_free.half_bandwidth, &band, moved, &mut on);
            for (q, other) in &all {
                square[q * m + p] += dot(other, &on);
            }
            let layout = &self.system.layout;
            for (next, &v) in next.chunks_exact_mut(3).zip(&layout.free_vertices) {
                next.copy_from_slice(&on[layout.vertex(v)..][..3]);
            }
            self.follow_transpose(of, &next, &mut by_x[p * states..][..states], &mut back);
            by_u[p * unknowns..][..unknowns].iter_mut().zip(&back).for_each(|(by, b)| *by += b);
        }
    }
}
