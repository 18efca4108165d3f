//! One rod with its supports and loads: places the prescribed parts, sums the elements.

use nalgebra::Vector3;
use varda_implicit::Structure;

use crate::Error;
use crate::clamp_frame::ClampFrame;
use crate::element::{self, Stiffness};
use crate::geometry::{any_perpendicular, perpendicular, signed_angle};
use crate::layout::{Band, FIXED, Layout, mirror};
use crate::moved::{HeldAt, Moves};
use crate::rod::Rod;
use crate::rotation::exponential;
use crate::scalar::length;
use crate::shape::{FirstFrame, Shape};
use crate::support::{Damping, Loads, Supports};

/// Largest |δθ| of one Newton update \[rad\], where bending depends on angles: it does so with periods of
/// π and 2π.
const TURN: f64 = 0.5;

/// Everything that stays the same during a run, and the work buffers of one evaluation.
#[derive(Clone)]
pub(crate) struct System {
    pub(crate) rod: Rod,
    pub(crate) supports: Supports,
    pub(crate) loads: Loads,
    /// What parameters do to the supports.
    pub(crate) moves: Moves,
    pub(crate) layout: Layout,
    /// Prescribed vertices with their motion's origin resolved at the last `place`.
    pub(crate) x: Vec<Vector3<f64>>,
    pub(crate) theta: Vec<f64>,
    pub(crate) shape: Shape,
    pub(crate) first: FirstFrame,
    end_director: Option<Vector3<f64>>,
    /// Stiffness and rest strain of every edge (EA, l̄) and interior vertex, with the damping of the present
    /// step in it.
    pub(crate) stretch: Vec<(f64, f64)>,
    pub(crate) bend: Vec<Stiffness>,
    /// ∂E/∂(x, θ) in the full order.
    pub(crate) gradient: Vec<f64>,
    pub(crate) forces: Vec<Vector3<f64>>,
    /// Time of the last `place`.
    pub(crate) time: f64,
    /// Work space for the lower band, where ∂G/∂u is not symmetric.
    lower: Vec<f64>,
}

/// Places of all vertices at the start of a stage, and its length: velocities are (x − places)/length.
#[derive(Clone, Copy)]
pub(crate) struct StageStart<'a> {
    pub(crate) places: &'a [Vector3<f64>],
    pub(crate) length: f64,
}

impl System {
    pub(crate) fn new(
        rod: Rod,
        supports: Supports,
        loads: Loads,
        damping: &Damping,
        force_twist: bool,
    ) -> Result<System, Error> {
        rod.check()?;
        let rod = rod.with_faces(supports.faces());
        crate::material::not_negative("damping.stiffness", damping.stiffness)?;
        crate::material::not_negative("damping.mass", damping.mass)?;
        if let Some(&value) = loads.gravity.iter().find(|g| !g.is_finite()) {
            return Err(Error::Value { field: "gravity", value, expected: "a finite number" });
        }
        for (s, _) in &loads.point_forces {
            rod.place("point force", *s)?;
        }
        let by_angle = loads.need_angles();
        let layout = Layout::needed(&rod, &supports, damping, force_twist || by_angle)?;
        let n = rod.segments();
        if (by_angle || rod.spins()) && !layout.twist {
            return Err(Error::NoSections);
        }
        for load in &loads.of_motion {
            load.check(&rod)?;
            let end = load.edges(n).end;
            if end > n {
                let expected = "at most the number of segments";
                return Err(Error::Value { field: "end of a load's edges", value: end as f64, expected });
            }
        }
        let (tangent, director) = supports.free_frame;
        let size = length(&tangent);
        if !(size > 0.0 && size.is_finite()) {
            return Err(Error::Value { field: "free_frame tangent", value: size, expected: "a direction" });
        }
        let tangent = if supports.runs_against(&tangent) { -tangent } else { tangent } / size;
        let across = director - tangent * director.dot(&tangent);
        let director = if length(&across) > 1e-9 * length(&director) {
            perpendicular(&director, &tangent)
        } else {
            any_perpendicular(&tangent)
        };
        let mut system = System {
            x: vec![Vector3::zeros(); n + 1],
            theta: vec![0.0; n],
            shape: Shape::new(n),
            first: FirstFrame::Carried { tangent, director },
            end_director: None,
            stretch: Vec::with_capacity(n),
            bend: Vec::with_capacity(n),
            gradient: vec![0.0; layout.full()],
            forces: vec![Vector3::zeros(); n + 1],
            time: 0.0,
            lower: Vec::new(),
            moves: Moves::default(),
            rod,
            supports,
            loads,
            layout,
        };
        system.set_stiffness(0.0, None);
        system.place(0.0)?;
        Ok(system)
    }

    /// Elastic stiffness, with Kelvin–Voigt damping folded in: ½k(ε−ε̄)² + ½rk(ε−ε_k)² is, up
    /// to a constant, the energy of stiffness k(1+r) about (ε̄ + r ε_k)/(1+r), r = β/Δt. `past` gives
    /// the strains ε_k: (l, (κ₁, κ₂, τ)).
    pub(crate) fn set_stiffness(&mut self, r: f64, past: Option<&PastStrains>) {
        let mix = |rest: f64, before: f64| (rest + r * before) / (1.0 + r);
        self.stretch.clear();
        for (e, (&ea, &rest)) in self.rod.ea.iter().zip(&self.rod.rest_lengths).enumerate() {
            // EA stays EA/l̄ times l̄: the modulus of the spring does not change with its mixed rest
            // length.
            let k = ea / rest * (1.0 + r);
            let rest = past.map_or(rest, |p| mix(rest, p.lengths[e]));
            self.stretch.push((k * rest, rest));
        }
        self.bend.clear();
        for i in 0..self.rod.ei.len() {
            let over = (1.0 + r) / self.rod.voronoi_lengths[i];
            let (ei, natural) = (self.rod.ei[i], self.rod.natural_curvature[i]);
            let mut rest = [natural[0], natural[1], self.rod.natural_twist[i]];
            if let Some(p) = past {
                for a in 0..3 {
                    rest[a] = mix(rest[a], p.bend[i][a]);
                }
            }
            self.bend.push(Stiffness { bend: ei.map(|k| k * over), twist: self.rod.gj[i] * over, rest });
        }
    }

    /// Puts the prescribed vertices, directors and forces where they are at time t.
    pub(crate) fn place(&mut self, t: f64) -> Result<(), Error> {
        let n = self.rod.segments();
        self.time = t;
        for (vertex, motion) in &self.supports.prescribed {
            self.x[*vertex] = self.moves.place(*vertex, motion.as_ref(), t);
        }
        if let Some(f) = self.clamp_frame(false, t)? {
            self.x[0] = f.position;
            self.x[1] = f.position + f.tangent * self.rod.rest_lengths[0];
            self.first = FirstFrame::Clamped(f.director);
            self.theta[0] = 0.0;
        }
        if let Some(f) = self.clamp_frame(true, t)? {
            self.x[n] = f.position;
            self.x[n - 1] = f.position - f.tangent * self.rod.rest_lengths[n - 1];
            self.end_director = Some(f.director);
        }
        self.forces.fill(Vector3::zeros());
        for v in 0..=n {
            self.forces[v] = self.loads.gravity * self.rod.masses[v];
        }
        for (s, force) in &self.loads.point_forces {
            let place = self.rod.place("point force", *s)?;
            let f = force.at(t);
            self.forces[place.edge] += f * (1.0 - place.fraction);
            self.forces[place.edge + 1] += f * place.fraction;
        }
        Ok(())
    }

    /// The frame of the start clamp, or of the end clamp, at time t, where there is one.
    pub(crate) fn clamp_frame(&self, end: bool, t: f64) -> Result<Option<ClampFrame>, Error> {
        let (clamp, of) =
            if end { (&self.supports.end, HeldAt::End) } else { (&self.supports.start, HeldAt::Start) };
        let Some(clamp) = clamp else { return Ok(None) };
        if self.moves.is_empty() {
            return clamp.frame(t).map(Some);
        }
        let mut frame = clamp.frame_turned(t, &self.moves.turn(end, t))?;
        frame.position += self.moves.displaced(of, t);
        if let Some((turn, arm)) = self.moves.turned(end, t) {
            frame.position += frame.axes * (exponential(&turn) * arm - arm);
        }
        Ok(Some(frame))
    }

    /// How far the end clamp turns against the start clamp from one time to another, and the larger of their
    /// turns \[rad\].
    pub(crate) fn clamps_turn(&self, from: f64, to: f64) -> Result<(f64, f64), Error> {
        let turned = |end: bool| match (self.clamp_frame(end, from)?, self.clamp_frame(end, to)?) {
            (Some(a), Some(b)) => b.turned_since(&a, [from, to]),
            _ => Ok(0.0),
        };
        let (start, end) = (turned(false)?, turned(true)?);
        Ok((end - start, if start.abs() > end.abs() { start } else { end }))
    }

    /// Vertices and angles from unknowns.
    pub(crate) fn scatter(&mut self, u: &[f64]) {
        let layout = &self.layout;
        for &v in &layout.free_vertices {
            let i = layout.unknown[layout.vertex(v)];
            self.x[v] = Vector3::new(u[i], u[i + 1], u[i + 2]);
        }
        for &e in &layout.free_angles {
            self.theta[e] = u[layout.unknown[layout.angle(e)]];
        }
    }

    /// Unknowns from vertices and angles.
    pub(crate) fn gather(&self, u: &mut [f64]) {
        let layout = &self.layout;
        for &v in &layout.free_vertices {
            let i = layout.unknown[layout.vertex(v)];
            u[i..i + 3].copy_from_slice(self.x[v].as_slice());
        }
        for &e in &layout.free_angles {
            u[layout.unknown[layout.angle(e)]] = self.theta[e];
        }
    }

    /// Vertices and angles from a state [X, V, θ].
    pub(crate) fn scatter_state(&mut self, state: &[f64]) {
        let nf = self.layout.free_vertices.len();
        for (f, &v) in self.layout.free_vertices.iter().enumerate() {
            self.x[v] = Vector3::from_column_slice(&state[3 * f..3 * f + 3]);
        }
        for (f, &e) in self.layout.free_angles.iter().enumerate() {
            self.theta[e] = state[6 * nf + f];
        }
        if let Some(end) = self.layout.end_angle() {
            self.theta[self.layout.segments - 1] = state[end];
        }
    }

    /// An angle near the one the end clamp has in a state that was scattered: that of the state, where it is
    /// part of it.
    pub(crate) fn end_angle_guess(&self) -> f64 {
        let own = self.theta.last().filter(|_| self.layout.ends_held());
        own.copied().unwrap_or_else(|| self.end_angle_beside())
    }

    /// The branch on which the last twist is nearest its natural value.
    pub(crate) fn end_angle_beside(&self) -> f64 {
        let n = self.rod.segments();
        let before = if n > 1 { self.theta[n - 2] } else { 0.0 };
        before + self.rod.natural_twist.last().copied().unwrap_or(0.0)
    }

    /// Edges, turns and, where frames are needed, directors of the present vertices and angles. The angle of
    /// a clamped end is taken on the branch nearest to `end_angle`.
    pub(crate) fn update_shape(&mut self, frames: bool, end_angle: f64) -> Result<(), Error> {
        self.shape.set_edges(&self.x, self.layout.bending || frames)?;
        if frames {
            self.shape.set_bishop(&self.first)?;
            if let (Some(director), Some(last)) = (self.end_director, self.rod.segments().checked_sub(1)) {
                let t = self.shape.edges[last].t;
                let angle = signed_angle(&self.shape.d1[last], &perpendicular(&director, &t), &t);
                let turn = std::f64::consts::TAU;
                self.theta[last] = angle + turn * ((end_angle - angle) / turn).round();
                if !self.layout.twist {
                    let angle = self.theta[last];
                    self.theta.fill(angle);
                }
            }
            self.shape.set_angles(&self.theta, None);
        }
        Ok(())
    }

    /// Elastic energy of the present shape; overwrites `gradient` (full order), adds to the band where one is
    /// given.
    pub(crate) fn elastic(&mut self, mut jacobian: Option<&mut [f64]>) -> f64 {
        let System { layout, shape, gradient, stretch, bend, .. } = self;
        gradient.fill(0.0);
        let mut energy = 0.0;
        let mut stretch_of = |e: usize, gradient: &mut [f64]| {
            let (edge, (k, rest)) = (&shape.edges[e], stretch[e]);
            let (value, force, h) = element::stretch(edge, rest, k);
            energy += value;
            let (a, b) = (layout.vertex(e), layout.vertex(e + 1));
            for c in 0..3 {
                gradient[a + c] -= force * edge.t[c];
                gradient[b + c] += force * edge.t[c];
            }
            h
        };
        // with bending the Hessian of an edge goes with the element at the vertex before it
        for e in 0..if layout.bending { 1 } else { layout.segments } {
            let h = stretch_of(e, gradient);
            if let Some(values) = jacobian.as_deref_mut() {
                let mut band = Band { layout, values };
                if layout.twist {
                    band.add(layout.vertex(e), &element::edge_hessian::<7>(&h, 4))
                } else {
                    band.add(layout.vertex(e), &element::edge_hessian::<6>(&h, 3))
                }
            }
        }
        if !layout.bending {
            return energy;
        }
        let mut bending = 0.0;
        for i in 1..layout.segments {
            let (a, b, turn, k) = (&shape.edges[i - 1], &shape.edges[i], shape.turn(i), &bend[i - 1]);
            let first = layout.vertex(i - 1);
            let h = stretch_of(i, gradient);
            if layout.twist {
                let m = shape.directors(i);
                let strains = shape.strains(i);
                let mut el = element::bend_twist(a, b, turn, &m, &strains, k);
                bending += el.energy;
                add(&mut gradient[first..], &el.gradient);
                if let Some(values) = jacobian.as_deref_mut() {
                    element::add_edge_hessian(&mut el.hessian, [4, 8], &h);
                    Band { layout, values }.add(first, &el.hessian);
                }
            } else {
                let mut el = element::isotropic_bend(a, b, turn, k.bend[0]);
                bending += el.energy;
                add(&mut gradient[first..], &el.gradient);
                if let Some(values) = jacobian.as_deref_mut() {
                    element::add_edge_hessian(&mut el.hessian, [3, 6], &h);
                    Band { layout, values }.add(first, &el.hessian);
                }
            }
        }
        energy + bending
    }

    /// Elastic energy of bending and twisting of the present shape.
    pub(crate) fn bending_energy(&self) -> f64 {
        if !self.layout.bending {
            return 0.0;
        }
        let (shape, twist) = (&self.shape, self.layout.twist);
        let of = |(i, k): (usize, &Stiffness)| {
            if twist {
                let (bend, twist) = element::energies(&shape.strains(i), k);
                bend + twist
            } else {
                element::isotropic_energy(&shape.edges[i - 1], &shape.edges[i], shape.turn(i), k.bend[0])
            }
        };
        (1..).zip(&self.bend).map(of).sum()
    }

    /// Whether all loads have a potential: then ∂G/∂u is symmetric.
    pub(crate) fn has_potential(&self) -> bool {
        self.loads.of_motion.iter().all(|load| load.has_potential())
    }

    /// Layout of ∂G/∂u.
    pub(crate) fn structure(&self) -> Structure {
        let half_bandwidth = self.layout.half_bandwidth;
        if self.has_potential() {
            Structure::SymmetricBand { half_bandwidth }
        } else {
            Structure::Band { half_bandwidth }
        }
    }

    /// Length of a row of ∂G/∂u in its layout; its diagonal stands `half_bandwidth` from the start.
    pub(crate) fn row_length(&self) -> usize {
        self.layout.half_bandwidth * if self.has_potential() { 1 } else { 2 } + 1
    }

    /// The share of an update after which no angle has turned by more than [`TURN`]; all of it where bending
    /// does not depend on angles.
    pub(crate) fn longest(&self, du: &[f64]) -> f64 {
        if self.layout.free_angles.is_empty() || !self.rod.bends_by_angle() {
            return 1.0;
        }
        let turn = |e: &usize| du[self.layout.unknown[self.layout.angle(*e)]].abs();
        TURN / self.layout.free_angles.iter().map(turn).fold(TURN, f64::max)
    }

    /// Elastic energy at the unknowns u; overwrites g with its gradient and, where asked for, `jacobian` with
    /// its Hessian in the layout of `structure`.
    pub(crate) fn assemble(
        &mut self,
        u: &[f64],
        end_angle: f64,
        g: &mut [f64],
        jacobian: Option<&mut [f64]>,
    ) -> Result<f64, Error> {
        self.scatter(u);
        self.update_shape(self.layout.twist, end_angle)?;
        let energy = match jacobian {
            Some(values) => {
                values.fill(0.0);
                if self.has_potential() {
                    self.elastic(Some(values))
                } else {
                    let mut lower = std::mem::take(&mut self.lower);
                    lower.clear();
                    lower.resize(u.len() * (self.layout.half_bandwidth + 1), 0.0);
                    let energy = self.elastic(Some(&mut lower));
                    mirror(&lower, self.layout.half_bandwidth, values);
                    self.lower = lower;
                    energy
                }
            }
            None => self.elastic(None),
        };
        for (full, &unknown) in self.layout.unknown.iter().enumerate() {
            if let Some(g) = g.get_mut(unknown) {
                *g = self.gradient[full];
            }
        }
        Ok(energy)
    }

    /// Adds a symmetric block to ∂G/∂u in the layout of `structure`.
    pub(crate) fn add_entries(
        &self,
        values: &mut [f64],
        unknown: &[usize],
        entry: impl Fn(usize, usize) -> f64,
    ) {
        let (w, row_length, general) = (self.layout.half_bandwidth, self.row_length(), !self.has_potential());
        for (i, &row) in unknown.iter().enumerate().filter(|(_, row)| **row != FIXED) {
            let columns = unknown.iter().enumerate().filter(|(_, c)| **c != FIXED && (general || **c <= row));
            for (j, &column) in columns {
                values[row * row_length + column + w - row] += entry(i, j);
            }
        }
    }

    /// δθ of the edges of a rod without twist unknowns: all turn with the end clamp where only that holds a
    /// director.
    pub(crate) fn angle_that_all_follow(&self, psi: &[f64]) -> f64 {
        if !self.layout.twist && self.supports.end.is_some() {
            psi.last().copied().unwrap_or(0.0)
        } else {
            0.0
        }
    }

    /// Turns an increment α du of local angles, already added in `trial`, into one of stored angles: adds
    /// the holonomy of its displacements, with the edges and turns of the present shape. `displacement` and
    /// `psi` are work space.
    pub(crate) fn add_holonomy(
        &self,
        du: &[f64],
        alpha: f64,
        displacement: &mut [Vector3<f64>],
        psi: &mut [f64],
        trial: &mut [f64],
    ) {
        let layout = &self.layout;
        self.unknown_displacements(du, displacement);
        self.shape.holonomy(displacement, psi);
        for &e in &layout.free_angles {
            trial[layout.unknown[layout.angle(e)]] += alpha * psi[e];
        }
    }

    /// Displacements of all vertices from an increment of the unknowns.
    pub(crate) fn unknown_displacements(&self, du: &[f64], out: &mut [Vector3<f64>]) {
        out.fill(Vector3::zeros());
        for &v in &self.layout.free_vertices {
            let i = self.layout.unknown[self.layout.vertex(v)];
            out[v] = Vector3::new(du[i], du[i + 1], du[i + 2]);
        }
    }

    /// Displacements of all vertices from those of the free ones, taken from the first entries of a
    /// state-like vector.
    pub(crate) fn displacements(&self, dx: &[f64], out: &mut [Vector3<f64>]) {
        out.fill(Vector3::zeros());
        for (f, &v) in self.layout.free_vertices.iter().enumerate() {
            out[v] = Vector3::from_column_slice(&dx[3 * f..3 * f + 3]);
        }
    }
}

/// Strains of the step before: lengths of edges and (κ₁, κ₂, τ) of interior vertices.
#[derive(Debug, Clone, Default)]
pub(crate) struct PastStrains {
    pub(crate) lengths: Vec<f64>,
    pub(crate) bend: Vec<[f64; 3]>,
}

fn add(target: &mut [f64], values: &[f64]) {
    for (t, v) in target.iter_mut().zip(values) {
        *t += v;
    }
}
