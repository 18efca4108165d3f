//! The equilibrium of the twist angles at given vertices, with its derivatives.

use nalgebra::{Vector3, Vector6};
use varda_implicit::{NewtonOptions, NewtonWork, Refusal, solve};
use varda_linalg::dot;

use crate::Error;
use crate::along::Along;
use crate::change::{Change, Parameters};
use crate::layout::{FIXED, Layout, band_product_add};
use crate::moved::Moves;
use crate::moved_increment::Increments;
use crate::moved_together::{Alone, Together};
use crate::second_order::Increment;
use crate::second_parameters::Strained;
use crate::statics::{Statics, at_rest};
use crate::system::{PastStrains, System};

/// Share of its stiffness by which the first angle of a rod that holds no director is held near where it
/// started, where bending depends on angles: it decides where a straight rod does not.
const SLIGHT: f64 = 1e-10;

/// θ₀ = θ(X₀): the angles that minimise E at given vertices, from θ = 0 or those of a rod at rest,
/// with δθ₀ = −E_θθ⁻¹ E_θX δX₀ and its transpose.
///
/// Of a rod that holds no director, E + ½ a (θ⁰ − θ̄⁰)² with θ̄⁰ the angle it starts from:
/// where nothing depends on the common turn of its angles, that with θ⁰ = θ̄⁰, whatever a.
pub(crate) struct TwistEquilibrium {
    statics: Statics,
    work: NewtonWork,
    /// The system with all its unknowns, for E_θX.
    full: System,
    /// The Hessian of the full system in its band, and the tridiagonal E_θθ: diagonal, below it.
    band: Vec<f64>,
    diagonal: Vec<f64>,
    below: Vec<f64>,
    /// ∂m/∂θ^e and ∂m/∂(places of edge e) of the moments m on free angles; empty without any.
    moments: Vec<(f64, Vector6<f64>)>,
    u: Vec<f64>,
    rhs: Vec<f64>,
    psi: Vec<f64>,
    displacement: Vec<Vector3<f64>>,
    /// a of the first angle; zero where an end holds a director.
    hold: f64,
    /// Angles of all edges to start from, in place of zero, and the turns of the clamps that are in them.
    pub(crate) first: Option<(Vec<f64>, f64)>,
    second: Second,
}

/// Work space of second derivatives: nothing until they are asked for.
#[derive(Default)]
struct Second {
    /// μ in the full order.
    mu: Vec<f64>,
    /// What acts on ψ.
    weights: Vec<f64>,
    band: Vec<f64>,
    /// An increment of the unknowns, and its product with the band.
    by: Vec<f64>,
    product: Vec<f64>,
    theta: Vec<f64>,
    /// Of parameters: strains along μ, a column in the full order, that of the unknowns, F_α of each, and
    /// first and second derivatives of μᵀE_α.
    along: Along,
    full: Vec<f64>,
    column: Vec<f64>,
    by_angles: Vec<f64>,
    first: Vec<f64>,
    square: Vec<f64>,
    /// The rod with nothing held, where parameters move supports: bands and products are then of that.
    all_free: Option<Layout>,
    together: Together,
    increments: Option<Increments>,
    none: Vec<f64>,
}

/// The parameters of a rod, an increment of them, and what a product adds to.
pub(crate) type ByParameters<'a> = (&'a Parameters, &'a [f64], &'a mut [f64]);

impl TwistEquilibrium {
    pub(crate) fn new(system: &System, by_angle: bool) -> TwistEquilibrium {
        let mut held = system.clone();
        held.layout = system.layout.angles_only();
        // forces act on vertices, and these are held
        held.loads.of_motion.retain(|load| load.has_moment());
        let n = system.rod.segments();
        let angles = system.layout.free_angles.len();
        let share = if by_angle || system.rod.bends_by_angle() { SLIGHT } else { 1.0 };
        let free = system.layout.turns_freely();
        let hold = if free { share * system.rod.section_stiffness(1) } else { 0.0 };
        let statics = Statics::new(held, 0.0, 1e-12);
        TwistEquilibrium {
            work: statics.work_space(),
            statics,
            band: vec![0.0; system.layout.unknowns * (system.layout.half_bandwidth + 1)],
            diagonal: vec![0.0; angles],
            below: vec![0.0; angles],
            moments: Vec::new(),
            u: vec![0.0; angles],
            rhs: vec![0.0; angles],
            psi: vec![0.0; n],
            displacement: vec![Vector3::zeros(); n + 1],
            full: system.clone(),
            hold,
            first: None,
            second: Second::default(),
        }
    }

    /// θ of the free angles for the free vertices X at time t.
    pub(crate) fn solve(&mut self, t: f64, positions: &[f64], theta: &mut [f64]) -> Result<(), Refusal> {
        let s = &mut self.statics.system;
        s.place(t)?;
        for (f, &v) in self.full.layout.free_vertices.iter().enumerate() {
            s.x[v] = Vector3::from_column_slice(&positions[3 * f..3 * f + 3]);
        }
        s.theta.fill(0.0);
        let mut end_angle = s.end_angle_beside();
        let mut turned = s.supports.turns_at(t);
        self.u.fill(0.0);
        if let Some((first, turns)) = &self.first {
            turned -= turns;
            end_angle = first[first.len() - 1];
            for (u, &e) in self.u.iter_mut().zip(&self.full.layout.free_angles) {
                *u = first[e];
            }
        }
        if turned != 0.0 {
            let (turned, n) = (std::f64::consts::TAU * turned, s.rod.segments() as f64);
            end_angle += turned;
            for (u, &e) in self.u.iter_mut().zip(&self.full.layout.free_angles) {
                *u += turned * (e as f64 + 0.5) / n;
            }
        }
        self.statics.end_angle = end_angle;
        self.statics.hold = (self.hold > 0.0).then(|| (self.hold, self.u[0]));
        let options = NewtonOptions::default().with_max_iterations(200);
        solve(&mut self.statics, &mut self.u, &mut self.work, &options)
            .map_err(|failure| failure.in_step(&at_rest(t)))?;
        let (free, end) = theta.split_at_mut(self.u.len());
        free.copy_from_slice(&self.u);

        self.full.place(t)?;
        self.full.x.copy_from_slice(&self.statics.system.x);
        for (f, &e) in self.full.layout.free_angles.iter().enumerate() {
            self.full.theta[e] = self.u[f];
        }
        self.full.update_shape(true, end_angle)?;
        end.fill(self.full.theta[self.full.theta.len() - 1]);
        self.band.fill(0.0);
        self.full.elastic(Some(&mut self.band));
        self.set_moments();
        self.factor()
    }

    /// What moments add to E_θθ and E_θX.
    fn set_moments(&mut self) {
        if self.statics.system.loads.of_motion.is_empty() {
            return;
        }
        let mut moments = std::mem::take(&mut self.moments);
        moments.clear();
        moments.resize(self.full.layout.free_angles.len(), (0.0, Vector6::zeros()));
        self.full.each_load(None, |acts, motion, _| {
            if let Ok(f) = self.full.layout.free_angles.binary_search(&motion.edge) {
                moments[f].0 += acts.moment_by_angle;
                moments[f].1 += acts.moment_by_places;
            }
        });
        self.moments = moments;
    }

    /// (E_θX − m_X) of a free angle and a coordinate of a vertex.
    fn by_place(&self, f: usize, v: usize, c: usize) -> f64 {
        let e = self.full.layout.free_angles[f];
        let of_edge = self.entry(self.full.layout.angle(e), self.full.layout.vertex(v) + c);
        match self.moments.get(f) {
            Some((_, by_places)) if v == e || v == e + 1 => of_edge - by_places[3 * (v - e) + c],
            _ => of_edge,
        }
    }

    /// E_θθ = L D Lᵀ of the free angles, from the band of the full system.
    fn factor(&mut self) -> Result<(), Refusal> {
        let layout = &self.full.layout;
        for f in 0..layout.free_angles.len() {
            let e = layout.free_angles[f];
            let moment = self.moments.get(f).map_or(0.0, |m| m.0);
            let mut d = self.entry(layout.angle(e), layout.angle(e)) - moment;
            if f == 0 {
                d += self.hold;
            }
            let before = f > 0 && layout.free_angles[f - 1] + 1 == e;
            self.below[f] = 0.0;
            if before {
                self.below[f] = self.entry(layout.angle(e), layout.angle(e - 1)) / self.diagonal[f - 1];
                d -= self.below[f] * self.below[f] * self.diagonal[f - 1];
            }
            if !(d > 0.0) {
                return Err(Error::TwistFold { edge: e, pivot: d }.into());
            }
            self.diagonal[f] = d;
        }
        Ok(())
    }

    fn entry(&self, row: usize, column: usize) -> f64 {
        let layout = &self.full.layout;
        let (i, j) = (layout.unknown[row], layout.unknown[column]);
        let (i, j) = (i.max(j), i.min(j));
        let w = layout.half_bandwidth;
        if i == FIXED || i - j > w { 0.0 } else { self.band[i * (w + 1) + w + j - i] }
    }

    fn solve_angles(&mut self) {
        let m = self.rhs.len();
        for f in 1..m {
            self.rhs[f] -= self.below[f] * self.rhs[f - 1];
        }
        for f in 0..m {
            self.rhs[f] /= self.diagonal[f];
        }
        for f in (1..m).rev() {
            self.rhs[f - 1] -= self.below[f] * self.rhs[f];
        }
    }

    /// Vertices whose places enter ∂E/∂θ^e: those of the two turns at its ends.
    fn neighbours(&self, e: usize) -> std::ops::RangeInclusive<usize> {
        e.saturating_sub(1)..=(e + 2).min(self.full.layout.segments)
    }

    /// Parameters move supports from now on.
    pub(crate) fn take_moves(&mut self, moves: &Moves) {
        for system in [&mut self.statics.system, &mut self.full] {
            system.moves = moves.clone();
        }
    }

    /// Takes the rod of another system, and the parameters that move its supports.
    pub(crate) fn take_constants(&mut self, from: &System, p: &[f64]) {
        for system in [&mut self.statics.system, &mut self.full] {
            system.rod.clone_from(&from.rod);
            system.moves.take(p);
            system.set_stiffness(0.0, None);
        }
    }

    /// δθ₀ = −E_θθ⁻¹ δE_θ for a change of the rod's constants, at the angles last found.
    pub(crate) fn change(&mut self, change: &Change, dtheta: &mut [f64]) {
        self.full.change_of_elastic(change, [0.0; 2], &PastStrains::default());
        for (rhs, &e) in self.rhs.iter_mut().zip(&self.full.layout.free_angles) {
            *rhs = -self.full.gradient[self.full.layout.angle(e)];
        }
        self.solve_angles();
        dtheta.copy_from_slice(&self.rhs);
    }

    /// dtheta, of the free angles and the end clamp's, += what a parameter does that moves supports, at the
    /// angles last found.
    pub(crate) fn moved_add(&mut self, parameter: usize, work: &mut Increments, dtheta: &mut [f64]) {
        let (s, Increments { places, angles, full, .. }) = (&self.full, work);
        let Some(end) = s.moved_increment(&s.shape, parameter, s.time, places, angles) else { return };
        let rhs = &mut self.rhs;
        moments_of_moved(s, &self.moments, (places, angles), full, |f, moment| rhs[f] = -moment);
        self.solve_angles();
        dtheta.iter_mut().zip(&self.rhs).for_each(|(d, more)| *d += more);
        dtheta[self.rhs.len()..].iter_mut().for_each(|d| *d += end);
    }

    pub(crate) fn tangent(&mut self, dx: &[f64], dtheta: &mut [f64]) {
        let mut displacement = std::mem::take(&mut self.displacement);
        self.full.displacements(dx, &mut displacement);
        for f in 0..self.rhs.len() {
            let e = self.full.layout.free_angles[f];
            let mut sum = 0.0;
            for v in self.neighbours(e) {
                for c in 0..3 {
                    sum -= self.by_place(f, v, c) * displacement[v][c];
                }
            }
            self.rhs[f] = sum;
        }
        self.full.shape.holonomy(&displacement, &mut self.psi);
        self.rhs[0] -= self.hold * self.psi[0];
        self.solve_angles();
        for (f, &e) in self.full.layout.free_angles.iter().enumerate() {
            dtheta[f] = self.rhs[f] + self.psi[e];
        }
        dtheta[self.rhs.len()..].fill(self.psi[self.psi.len() - 1]);
        self.displacement = displacement;
    }

    pub(crate) fn adjoint_add(&mut self, lambda: &[f64], dx: &mut [f64]) {
        if lambda.iter().all(|l| *l == 0.0) {
            return;
        }
        let (lambda, end) = lambda.split_at(self.rhs.len());
        self.rhs.copy_from_slice(lambda);
        self.solve_angles();
        let mut displacement = std::mem::take(&mut self.displacement);
        displacement.fill(Vector3::zeros());
        self.psi.fill(0.0);
        for (f, &e) in self.full.layout.free_angles.iter().enumerate() {
            self.psi[e] = lambda[f] - if f == 0 { self.hold * self.rhs[0] } else { 0.0 };
            for v in self.neighbours(e) {
                for c in 0..3 {
                    displacement[v][c] -= self.by_place(f, v, c) * self.rhs[f];
                }
            }
        }
        if let Some(end) = end.first() {
            *self.psi.last_mut().expect("a rod has edges") += end;
        }
        self.full.shape.holonomy_transpose_add(&self.psi, &mut displacement);
        for (f, &v) in self.full.layout.free_vertices.iter().enumerate() {
            for c in 0..3 {
                dx[3 * f + c] += displacement[v][c];
            }
        }
        self.displacement = displacement;
    }
}

impl TwistEquilibrium {
    /// out += Σ_i λ_i ∂²θ_i/∂X² dx, with L = λᵀ(α + ψ(x)) + μᵀ E_α, μ = −E_θθ⁻¹ λ;
    /// with parameters p of the constants where they are given, those of ∂(X, p)² times (dx, dp). The
    /// increment of α is that of both, and with F_i = ∂E/∂p_i
    ///
    /// ```text
    /// L_cp = ∂F/∂c∂α μ,   out_p += L_pc dc + L_pp dp − F_αᵀ E_θθ⁻¹ (L_αc dc + L_αp dp)
    /// ```
    ///
    /// K of μ is zero: μ moves no places. Moments on angles are in E_α, with their derivatives.
    pub(crate) fn second_add(
        &mut self,
        dx: &[f64],
        lambda: &[f64],
        out: &mut [f64],
        mut parameters: Option<ByParameters>,
    ) {
        if lambda.iter().all(|l| *l == 0.0) {
            return;
        }
        let mut second = std::mem::take(&mut self.second);
        let (own, end) = lambda.split_at(self.rhs.len());
        self.rhs.copy_from_slice(own);
        self.solve_angles();
        let layout = &self.full.layout;
        if second.all_free.is_none() && !self.full.moves.is_empty() {
            second.all_free = Some(layout.all_free());
        }
        let Second { mu, weights, band, by, product, theta, all_free, .. } = &mut second;
        let order = all_free.as_ref().unwrap_or(layout);
        mu.resize(layout.full(), 0.0);
        theta.resize(lambda.len(), 0.0);
        for (zeroed, length) in [(&mut *weights, layout.segments), (band, order.band())] {
            zeroed.clear();
            zeroed.resize(length, 0.0);
        }
        for zeroed in [&mut *by, product] {
            zeroed.clear();
            zeroed.resize(order.unknowns, 0.0);
        }
        for (f, &e) in layout.free_angles.iter().enumerate() {
            mu[layout.angle(e)] = -self.rhs[f];
            weights[e] = own[f];
        }
        if let (Some(weight), Some(end)) = (weights.last_mut(), end.first()) {
            *weight += end;
        }
        // the first angle is held by its stored value
        if let Some(&e) = layout.free_angles.first() {
            weights[e] += self.hold * mu[layout.angle(e)];
        }
        if let Some(all) = all_free {
            std::mem::swap(&mut self.full.layout, all);
        }
        self.full.third_add(&Increment(mu), band, None);
        self.full.second_of_loads(None, &Increment(mu), band, &mut []);
        self.full.holonomy_second_add(&self.full.shape, weights, band);
        if let Some(held) = all_free {
            std::mem::swap(&mut self.full.layout, held);
        }

        self.tangent(dx, theta);
        // dx and the local angles that follow
        let layout = &self.full.layout;
        let order = all_free.as_ref().unwrap_or(layout);
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            let i = order.unknown[layout.vertex(v)];
            by[i..i + 3].copy_from_slice(&dx[3 * f..3 * f + 3]);
        }
        for (f, &e) in layout.free_angles.iter().enumerate() {
            by[order.unknown[layout.angle(e)]] = self.rhs[f];
        }
        band_product_add(order.half_bandwidth, band, by, product);
        if let Some((parameters, dp, out)) = &mut parameters {
            let end = end.first().copied().unwrap_or(0.0);
            self.second_of_parameters(&mut second, end, (parameters, dp, out));
        }
        let (layout, Second { product, all_free, .. }) = (&self.full.layout, &second);
        let order = all_free.as_ref().unwrap_or(layout);
        for (rhs, &e) in self.rhs.iter_mut().zip(&layout.free_angles) {
            *rhs = product[order.unknown[layout.angle(e)]];
        }
        self.solve_angles();
        let layout = &self.full.layout;
        let order = all_free.as_ref().unwrap_or(layout);
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            let i = order.unknown[layout.vertex(v)];
            (0..3).for_each(|c| out[3 * f + c] += product[i + c]);
        }
        for f in 0..self.rhs.len() {
            for v in self.neighbours(layout.free_angles[f]) {
                let Ok(at) = layout.free_vertices.binary_search(&v) else { continue };
                for c in 0..3 {
                    out[3 * at + c] -= self.by_place(f, v, c) * self.rhs[f];
                }
            }
        }
        if self.hold != 0.0 {
            self.psi.fill(0.0);
            self.psi[layout.free_angles[0]] = -self.hold * self.rhs[0];
            self.displacement.fill(Vector3::zeros());
            self.full.shape.holonomy_transpose_add(&self.psi, &mut self.displacement);
            for (out, &v) in out.chunks_exact_mut(3).zip(&layout.free_vertices) {
                out.iter_mut().zip(self.displacement[v].iter()).for_each(|(out, d)| *out += d);
            }
        }
        if let Some((_, _, out)) = parameters {
            for (out, by_angles) in out.iter_mut().zip(second.by_angles.chunks_exact(self.rhs.len())) {
                *out -= dot(by_angles, &self.rhs);
            }
        }
        self.second = second;
    }

    /// Adds what parameters do to the increment of angles `by` and to its `product`, and the product of
    /// their own rows but for what comes back through the angles; `on_end` acts on the end clamp's angle.
    fn second_of_parameters(
        &mut self,
        second: &mut Second,
        on_end: f64,
        (parameters, dp, out): (&Parameters, &[f64], &mut [f64]),
    ) {
        let Second { mu, band, by, product, along, full, column, by_angles, first, square, .. } = second;
        let Second { all_free, together, increments, none: zeros, .. } = second;
        let (angles, none) = (self.rhs.len(), &parameters.none);
        by_angles.resize(parameters.len() * angles, 0.0);
        self.rhs.fill(0.0);
        together.set(&self.full, &self.full.shape, self.full.time);
        let all = parameters.list.iter().zip(&parameters.slopes);
        for (((p, slope), dp), to) in all.clone().zip(dp).zip(by_angles.chunks_exact_mut(angles)) {
            self.full.change_of_elastic(&p.change, [0.0; 2], none);
            for ((to, rhs), &e) in to.iter_mut().zip(&mut self.rhs).zip(&self.full.layout.free_angles) {
                *to = slope * self.full.gradient[self.full.layout.angle(e)];
                *rhs -= *to * dp;
            }
        }
        for Alone { parameter, places, angles: turned } in together.iter() {
            let to = &mut by_angles[parameter * angles..][..angles];
            let s = &self.full;
            let work = increments.get_or_insert_with(|| Increments::of(s));
            moments_of_moved(s, &self.moments, (places, turned), &mut work.full, |f, more| {
                to[f] += more;
                self.rhs[f] -= more * dp[*parameter];
            });
        }
        self.solve_angles();
        let s = &self.full;
        let order = all_free.as_ref().unwrap_or(&s.layout);
        column.clear();
        column.resize(order.unknowns, 0.0);
        for (rhs, &e) in self.rhs.iter().zip(&s.layout.free_angles) {
            let i = order.unknown[s.layout.angle(e)];
            column[i] = *rhs;
            by[i] += rhs;
        }
        for moved in together.iter() {
            moved.add_to(order, dp[moved.parameter], column);
            moved.add_to(order, dp[moved.parameter], by);
        }
        band_product_add(order.half_bandwidth, band, column, product);
        s.along(&Increment(mu), along);
        full.resize(s.layout.full(), 0.0);
        first.clear();
        let strained = Strained { rate: 0.0, moves: 0.0, past: none, along };
        for ((p, slope), (dp, out)) in all.zip(dp.iter().zip(out.iter_mut())) {
            first.push(s.second_of_change(&p.change, strained, full));
            order.take(full, column);
            product.iter_mut().zip(&*column).for_each(|(product, c)| *product += slope * dp * c);
            *out += slope * dot(column, by);
        }
        square.clear();
        square.resize(parameters.len() * parameters.len(), 0.0);
        parameters.square_add(s, strained, first, square);
        for moved in together.iter() {
            out[moved.parameter] += moved.dot(order, product);
        }
        if !s.moves.is_empty() {
            full.fill(0.0);
            zeros.clear();
            zeros.resize(full.len(), 0.0);
            let work = increments.get_or_insert_with(|| Increments::of(s));
            s.elastic_second_of(&Increment(mu), work, full);
            s.loads_transpose_add(None, &Increment(mu), [full, zeros]);
            together.pairs_add(s, (&s.shape, s.time), (full, on_end), square);
        }
        for (out, row) in out.iter_mut().zip(square.chunks_exact(parameters.len().max(1))) {
            *out += dot(row, dp);
        }
    }
}

/// What an increment of all places and local angles does to E_θ of free angles: calls `add` with the number
/// of each; `full` is work space.
fn moments_of_moved(
    s: &System,
    moments: &[(f64, Vector6<f64>)],
    (places, angles): (&[Vector3<f64>], &[f64]),
    full: &mut [f64],
    mut add: impl FnMut(usize, f64),
) {
    full.fill(0.0);
    s.elastic_second_add(places, angles, full);
    for (f, &e) in s.layout.free_angles.iter().enumerate() {
        let moment = moments.get(f).map_or(0.0, |(by_angle, by_places)| {
            let [a, b] = [places[e], places[e + 1]];
            by_angle * angles[e] + by_places.dot(&Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z))
        });
        add(f, full[s.layout.angle(e)] - moment);
    }
}

impl System {
    /// Edge and size of the smallest pivot of E_θθ (free angles, in order), in units of the stiffness of
    /// its neighbours. As it goes to zero the twist equilibrium folds: it stops being a smooth function of
    /// the vertices.
    /// `resistance` adds to the stiffness of every edge.
    pub(crate) fn smallest_twist_pivot(&self, resistance: impl Fn(usize) -> f64) -> (usize, f64) {
        let n = self.layout.segments;
        let vertex = |i: usize| {
            if i == 0 || i == n { [0.0; 3] } else { self.shape.strains(i).angle_hessian(&self.bend[i - 1]) }
        };
        let scale = |i: usize| {
            if i == 0 || i == n {
                0.0
            } else {
                self.bend[i - 1].twist + 1e-9 * (self.bend[i - 1].bend[0] + self.bend[i - 1].bend[2])
            }
        };
        let mut left = vertex(0);
        let (mut pivot_before, mut smallest) = (None::<f64>, (0, f64::INFINITY));
        for e in 0..n {
            let right = vertex(e + 1);
            if self.layout.free_angles.binary_search(&e).is_ok() {
                let pivot =
                    resistance(e) + left[2] + right[0] - pivot_before.map_or(0.0, |p| left[1] * left[1] / p);
                let relative = pivot / (scale(e) + scale(e + 1));
                if !(relative >= smallest.1) {
                    smallest = (e, relative);
                }
                pivot_before = Some(pivot);
            } else {
                pivot_before = None;
            }
            left = right;
        }
        smallest
    }
}
