//! Loads of the motion on a rod: what they add to its equations and to their first and second derivatives.

use nalgebra::Vector3;

use crate::layout::{Band, FIXED};
use crate::load::{EdgeLoad, EdgeMotion, Load};
use crate::second_order::Increment;
use crate::system::{StageStart, System};

/// Its places and θ.
const OWN: usize = 7;
/// Numbers for every edge that [`System::second_of_loads`] writes: ∂²(−μᵀF) by places and θ with the
/// start of the stage, and by the start twice.
const STARTED: usize = 6 * OWN + 36;

impl System {
    /// Calls `visit` with every load of the motion on every edge, the motion of that edge, and the unknowns
    /// of its vertices and, last, of its angle.
    fn each_loaded_edge(
        &self,
        start: Option<StageStart>,
        mut visit: impl FnMut(&dyn Load, &EdgeMotion, [usize; OWN]),
    ) {
        for load in &self.loads.of_motion {
            for edge in load.edges(self.rod.segments()) {
                let ends = [edge, edge + 1];
                let velocity = |v: usize| match start {
                    Some(start) => (self.x[v] - start.places[v]) / start.length,
                    None => Vector3::zeros(),
                };
                let directors = match load.uses_directors() {
                    true => [self.shape.m1[edge], self.shape.m2[edge]],
                    false => [Vector3::zeros(); 2],
                };
                let motion = EdgeMotion {
                    edge,
                    time: self.time,
                    places: ends.map(|v| self.x[v]),
                    velocities: ends.map(velocity),
                    directors,
                    rest_length: self.rod.rest_lengths[edge],
                };
                visit(&**load, &motion, self.unknowns_of_edge(edge));
            }
        }
    }

    /// Unknowns of the vertices of an edge and, last, of its angle.
    fn unknowns_of_edge(&self, edge: usize) -> [usize; OWN] {
        let layout = &self.layout;
        std::array::from_fn(|i| match i {
            6 if layout.twist => layout.unknown[layout.angle(edge)],
            6 => FIXED,
            i => layout.unknown[layout.vertex(edge + i / 3) + i % 3],
        })
    }

    /// The same with what the load does there.
    pub(crate) fn each_load(
        &self,
        start: Option<StageStart>,
        mut visit: impl FnMut(&EdgeLoad, &EdgeMotion, [usize; OWN]),
    ) {
        self.each_loaded_edge(start, |load, motion, unknown| visit(&load.on_edge(motion), motion, unknown));
    }

    /// Loads of the motion at the present shape: subtracts their forces from g and ∂F/∂x + ∂F/∂v/η
    /// from the Jacobian, x and F with angles and moments. Returns their energy.
    pub(crate) fn add_loads(
        &self,
        start: Option<StageStart>,
        g: &mut [f64],
        mut jacobian: Option<&mut [f64]>,
    ) -> f64 {
        let (general, row_length) = (!self.has_potential(), self.row_length());
        let w = self.layout.half_bandwidth;
        let rate = start.map_or(0.0, |start| 1.0 / start.length);
        let mut energy = 0.0;
        self.each_load(start, |acts, motion, unknown| {
            energy += acts.energy;
            let by_places = acts.by_places_of_carried(motion);
            for a in (0..7).filter(|&a| unknown[a] != FIXED) {
                let row = unknown[a];
                g[row] -= if a < 6 { acts.forces[a] } else { acts.moment };
                let Some(values) = jacobian.as_deref_mut() else { continue };
                for b in (0..7).filter(|&b| unknown[b] != FIXED && (general || unknown[b] <= row)) {
                    values[row * row_length + unknown[b] + w - row] -= match (a < 6, b < 6) {
                        (true, true) => by_places[(a, b)] + rate * acts.by_velocities[(a, b)],
                        (true, false) => acts.by_angle[a],
                        (false, true) => acts.moment_by_places[b],
                        (false, false) => acts.moment_by_angle,
                    };
                }
            }
        });
        energy
    }

    /// (1/η) ∂F/∂v applied to one number a vertex coordinate, or its transpose: `input` of an unknown to
    /// `output` of another.
    pub(crate) fn couple_loads(
        &self,
        start: StageStart,
        transposed: bool,
        input: impl Fn(usize) -> f64,
        mut output: impl FnMut(usize, f64),
    ) {
        self.each_load(Some(start), |acts, _, unknown| {
            for a in (0..6).filter(|&a| unknown[a] != FIXED) {
                for b in (0..6).filter(|&b| unknown[b] != FIXED) {
                    let entry =
                        if transposed { acts.by_velocities[(b, a)] } else { acts.by_velocities[(a, b)] };
                    output(unknown[a], entry / start.length * input(unknown[b]));
                }
            }
        });
    }

    /// Whether all loads of the motion have second derivatives.
    pub(crate) fn loads_have_second_derivatives(&self) -> bool {
        self.loads.of_motion.iter().all(|load| load.has_second_derivatives())
    }

    /// The edges with loads that may depend on velocities.
    fn slowed_edges(&self) -> std::ops::Range<usize> {
        let slowing = self.loads.of_motion.iter().filter(|load| !load.has_potential());
        let edges = slowing.map(|load| load.edges(self.rod.segments()));
        edges.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0..0)
    }

    /// How many numbers [`second_of_loads`](Self::second_of_loads) keeps.
    pub(crate) fn second_of_loads_kept(&self) -> usize {
        STARTED * self.slowed_edges().len()
    }

    /// Adds ∂²(−μᵀF)/∂c² of the forces and moments of loads at the present shape to the lower
    /// band of ∂G/∂u, and writes what the start of the stage does, where there is one, to `started`.
    ///
    /// ∂F/∂c is as loads give it, in angles that start where the edge is; these are c fixed at the
    /// present shape but for a term that is antisymmetric in its two derivatives.
    pub(crate) fn second_of_loads(
        &self,
        start: Option<StageStart>,
        mu: &Increment,
        band: &mut [f64],
        started: &mut [f64],
    ) {
        let (layout, first) = (&self.layout, self.slowed_edges().start);
        started.fill(0.0);
        self.each_loaded_edge(start, |load, motion, _| {
            let e = motion.edge;
            let moved = mu.of_edge(layout, e);
            if moved == [0.0; OWN] {
                return;
            }
            let second = load.second_on_edge(motion, &moved);
            let rate = start.map_or(0.0, |start| 1.0 / start.length);
            // velocities are (x − start) rate
            let by_start = |i: usize, j: usize| {
                let own = second[(i, OWN + j)];
                rate * if i < 6 { own + rate * second[(OWN + i, OWN + j)] } else { own }
            };
            let by_own = |i: usize, j: usize| {
                let of_speed = |i: usize, j: usize| if j < 6 { rate * second[(i, OWN + j)] } else { 0.0 };
                let both = if i < 6 && j < 6 { rate * rate * second[(OWN + i, OWN + j)] } else { 0.0 };
                -(second[(i, j)] + of_speed(i, j) + of_speed(j, i) + both)
            };
            let mut band = Band { layout, values: &mut *band };
            if layout.twist {
                // the angle of an edge stands between its vertices
                let at = |i: usize| {
                    if i < 3 {
                        i
                    } else if i == 3 {
                        6
                    } else {
                        i - 1
                    }
                };
                band.add(layout.vertex(e), &square::<7>(|i, j| by_own(at(i), at(j))));
            } else {
                band.add(layout.vertex(e), &square::<6>(by_own));
            }
            if started.is_empty() || load.has_potential() {
                return;
            }
            let (mixed, twice) =
                started[STARTED * (e - first)..STARTED * (e - first + 1)].split_at_mut(6 * OWN);
            for (k, value) in mixed.iter_mut().enumerate() {
                *value += by_start(k / 6, k % 6);
            }
            for (k, value) in twice.iter_mut().enumerate() {
                *value -= rate * rate * second[(OWN + k / 6, OWN + k % 6)];
            }
        });
    }

    /// Adds what moments m bring to second derivatives of μᵀG beside those of loads and energy. They do
    /// the work m·dα' on the local angles α' of where the edge is. In coordinates (x, α) of the present
    /// shape dα' = dα + A(x)·dx, A = −t₀×t·de/(l + e·t₀) of its tangent, so that −μᵀF has
    ///
    /// ```text
    /// −∂²(m A·μ)/∂c² = m_c K + K m_c − (m/l³) ((μ_e × t) tᵀ + t (μ_e × t)ᵀ)
    /// ```
    ///
    /// with K as in `second_order`. The energy, whose ∂E/∂α is m, has half of the last again, and
    /// KᵀH + H K, of which the equation of the angles, (H du + G_x dx)_α = m_c du, leaves the first two.
    pub(crate) fn second_of_moments(&self, start: Option<StageStart>, mu: &Increment, band: &mut [f64]) {
        let layout = &self.layout;
        if !layout.twist {
            return;
        }
        self.each_load(start, |acts, motion, _| {
            let moved = mu.of_edge(layout, motion.edge);
            let nothing = acts.moment == 0.0 && acts.moment_by_places == nalgebra::Vector6::zeros();
            if nothing && acts.moment_by_angle == 0.0 {
                return;
            }
            let of = of_moment(acts, motion, &moved);
            let of = square::<OWN>(|i, j| of(between(i), between(j)));
            Band { layout, values: &mut *band }.add(layout.vertex(motion.edge), &of);
        });
    }

    /// Adds −μᵀ ∂F of the loads to what acts on the present configuration and on the start of the
    /// stage, all in the full order.
    pub(crate) fn loads_transpose_add(
        &self,
        start: Option<StageStart>,
        mu: &Increment,
        [on_now, on_start]: [&mut [f64]; 2],
    ) {
        let (layout, rate) = (&self.layout, start.map_or(0.0, |start| 1.0 / start.length));
        self.each_load(start, |acts, motion, _| {
            let e = motion.edge;
            let mu = mu.of_edge(layout, e);
            let by_places = acts.by_places_of_carried(motion);
            for b in 0..6 {
                let i = layout.vertex(e + b / 3) + b % 3;
                let by_speed: f64 = (0..6).map(|a| mu[a] * acts.by_velocities[(a, b)] * rate).sum();
                let by_place: f64 = (0..6).map(|a| mu[a] * by_places[(a, b)]).sum();
                on_now[i] -= by_place + by_speed + mu[6] * acts.moment_by_places[b];
                on_start[i] += by_speed;
            }
            if layout.twist {
                let by_angle: f64 = (0..6).map(|a| mu[a] * acts.by_angle[a]).sum();
                on_now[layout.angle(e)] -= by_angle + mu[6] * acts.moment_by_angle;
            }
        });
    }

    /// What was kept of the start of the stage: adds to `on_unknowns` what an increment of it does, `star` by
    /// unknowns, and to `on_star` what both do.
    pub(crate) fn second_of_start_add(
        &self,
        started: &[f64],
        [du, star]: [&[f64]; 2],
        on_unknowns: &mut [f64],
        on_star: &mut [f64],
    ) {
        let of = |x: &[f64], unknown: usize| if unknown == FIXED { 0.0 } else { x[unknown] };
        for (e, kept) in self.slowed_edges().zip(started.chunks_exact(STARTED)) {
            let unknown = self.unknowns_of_edge(e);
            let (mixed, twice) = kept.split_at(6 * OWN);
            let own: [f64; OWN] = unknown.map(|u| of(du, u));
            let moved: [f64; OWN] = unknown.map(|u| of(star, u));
            let mut back = [0.0; 6];
            for (row, (own, &unknown)) in mixed.chunks_exact(6).zip(own.iter().zip(&unknown)) {
                let sum: f64 = row.iter().zip(&moved).map(|(r, m)| r * m).sum();
                if unknown != FIXED {
                    on_unknowns[unknown] += sum;
                }
                back.iter_mut().zip(row).for_each(|(back, r)| *back += r * own);
            }
            for (row, moved) in twice.chunks_exact(6).zip(&moved) {
                back.iter_mut().zip(row).for_each(|(back, r)| *back += r * moved);
            }
            for (back, &unknown) in back.iter().zip(&unknown) {
                if unknown != FIXED {
                    on_star[unknown] += back;
                }
            }
        }
    }
}

fn square<const N: usize>(entry: impl Fn(usize, usize) -> f64) -> [[f64; N]; N] {
    std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)))
}

/// Where a number of an edge in the full order stands among places and θ: its angle is between its vertices.
fn between(i: usize) -> usize {
    match i {
        0..3 => i,
        3 => 6,
        _ => i - 1,
    }
}

/// See [`System::second_of_moments`].
fn of_moment(acts: &EdgeLoad, motion: &EdgeMotion, mu: &[f64; OWN]) -> impl Fn(usize, usize) -> f64 {
    let (t, l) = motion.tangent();
    let end = |i: usize| Vector3::new(mu[i], mu[i + 1], mu[i + 2]);
    let across = (end(3) - end(0)).cross(&t);
    // of an increment of the edge, by those of its ends
    let ends = |v: Vector3<f64>| -> [f64; OWN] {
        std::array::from_fn(|i| match i {
            0..3 => -v[i],
            3..6 => v[i - 3],
            _ => 0.0,
        })
    };
    let (area, along, across) = (ends(across / (2.0 * l * l)), ends(t), ends(across));
    let places = acts.moment_by_places;
    let by: [f64; OWN] = std::array::from_fn(|i| if i < 6 { places[i] } else { acts.moment_by_angle });
    let curved = -1.5 * acts.moment / (l * l * l);
    move |i, j| {
        let twice = by[i] * area[j] + area[i] * by[j];
        2.0 * twice + curved * (across[i] * along[j] + along[i] * across[j])
    }
}
