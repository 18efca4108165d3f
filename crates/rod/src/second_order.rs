//! Third derivatives of the energy, and second ones of the holonomy: what the exact Hessian of a window needs
//! of a rod's step.
//!
//! Increments of unknowns are (δx, α): the director of an edge is carried from its present tangent t₀ to
//! the tangent t along the shortest arc, and turned by α. In these coordinates, fixed at one configuration,
//! the energy of a vertex depends on its own places and angles only, to every order, so that all derivatives
//! are bands. The stored angle is θ = θ₀ + α + ψ(x), with ψ the angle between the director so carried
//! and Bishop's: a sum along the rod of functions of three vertices.
//!
//! Hessians of elements are those at their own configuration. Moved by ε μ they are in coordinates that
//! start at the moved configuration, whose angles differ by the area of the triangle of tangents
//! (t₀, t₀ + ε δt, t),
//!
//! ```text
//! α' = α + ε K δx,   K δx = (δt × t₀)·δe/2l    ⇒    ∂³E[μ] = d/dε H + KᵀH + H K
//! ```
//!
//! with d/dε that of dual numbers. In a step KᵀH and H K are left out: both are rows of angles, and the
//! angles solve ∂G/∂u δu + ∂G/∂x_k δx_k = 0 with the places, so that the two come to nothing in
//! every product. What is seen of an angle itself, a marker off the centreline, needs K. The term with
//! ∂E/∂α vanishes where the angles are in equilibrium, as they are in a solved step.

use nalgebra::Vector3;
use num_dual::Dual64;

use crate::element::{self, Directors, LOCAL, STRAINS, Stiffness, Strains};
use crate::geometry::{Edge, Turn};
use crate::layout::{Band, Layout};
use crate::scalar::dual;
use crate::shape::{FirstFrame, Shape};
use crate::system::System;

/// An edge moved by ε μ.
#[derive(Clone, Copy)]
pub(crate) struct Moved {
    pub(crate) edge: Edge<Dual64>,
    m1: Vector3<Dual64>,
    m2: Vector3<Dual64>,
    /// (δt × t₀)/2l, which is K.
    area: Vector3<f64>,
}

pub(crate) fn slope(v: &Vector3<Dual64>) -> Vector3<f64> {
    v.map(|v| v.eps)
}

/// An increment of all vertices and angles in the full order.
pub(crate) struct Increment<'a>(pub(crate) &'a [f64]);

impl Increment<'_> {
    pub(crate) fn place(&self, layout: &Layout, v: usize) -> Vector3<f64> {
        Vector3::from_column_slice(&self.0[layout.vertex(v)..layout.vertex(v) + 3])
    }

    /// Of the places and, last, of the angle of an edge.
    pub(crate) fn of_edge(&self, layout: &Layout, e: usize) -> [f64; 7] {
        let [a, b] = [e, e + 1].map(|v| self.place(layout, v));
        let turn = if layout.twist { self.0[layout.angle(e)] } else { 0.0 };
        [a.x, a.y, a.z, b.x, b.y, b.z, turn]
    }
}

impl System {
    /// Edge e moved by ε μ.
    pub(crate) fn moved(&self, e: usize, mu: &Increment) -> Moved {
        let layout = &self.layout;
        let turn = if layout.twist { mu.0[layout.angle(e)] } else { 0.0 };
        self.moved_by(e, [e, e + 1].map(|v| mu.place(layout, v)), turn)
    }

    /// Edge e where its ends are moved by ε `places` and its sections turned by ε `turn`.
    fn moved_by(&self, e: usize, places: [Vector3<f64>; 2], turn: f64) -> Moved {
        let shape = &self.shape;
        let [a, b] = [0, 1].map(|i| dual(&self.x[e + i], &places[i]));
        let edge = Edge::between(&a, &b, e).expect("this shape was assembled before");
        let (t, dt) = (shape.edges[e].t, slope(&edge.t));
        let area = dt.cross(&t) / (2.0 * shape.edges[e].l);
        let (m1, m2) = (shape.m1[e], shape.m2[e]);
        let carried = |m: &Vector3<f64>, across: Vector3<f64>| dual(m, &(across * turn - t * m.dot(&dt)));
        Moved { edge, m1: carried(&m1, m2), m2: carried(&m2, -m1), area }
    }

    /// Adds ∂³E/∂c³[μ] at the present shape, with the stiffness of the present step, to the lower band
    /// of ∂G/∂u; where asked for writes k ∂²ε[μ] of all strains to `strains` (see
    /// `KelvinVoigt::keep`).
    pub(crate) fn third_add(&self, mu: &Increment, band: &mut [f64], mut strains: Option<&mut [f64]>) {
        let layout = &self.layout;
        let real = |x: f64| Dual64::from(x);
        let mut before: Option<Moved> = None;
        for e in 0..layout.segments {
            let now = self.moved(e, mu);
            let (k, rest) = self.stretch[e];
            let (_, _, h) = element::stretch(&now.edge, real(rest), real(k));
            let h = h.map(|h| h.eps);
            let first = layout.vertex(e);
            if layout.twist {
                Band { layout, values: band }.add(first, &element::edge_hessian::<7>(&h, 4));
            } else {
                Band { layout, values: band }.add(first, &element::edge_hessian::<6>(&h, 3));
            }
            let kept = strains.as_deref_mut().map(|all| &mut all[STRAINS * e..STRAINS * (e + 1)]);
            let mut kept = kept;
            if let Some(kept) = kept.as_deref_mut() {
                kept[..3].copy_from_slice((slope(&now.edge.t) * (k / rest)).as_slice());
            }
            let Some(last) = before.replace(now).filter(|_| layout.bending) else { continue };
            let turn = Turn::between(&last.edge.t, &now.edge.t, e).expect("this shape was assembled before");
            let first = layout.vertex(e - 1);
            if layout.twist {
                self.third_of_vertex(e, mu, [&last, &now], &turn, band, kept);
            } else {
                let k = real(self.bend[e - 1].bend[0]);
                let element = element::isotropic_bend(&last.edge, &now.edge, &turn, k);
                Band { layout, values: band }.add(first, &element.hessian.map(|row| row.map(|h| h.eps)));
            }
        }
    }

    /// Strains of a vertex with frames moved by ε μ, and the directors of its edges.
    pub(crate) fn moved_strains(
        &self,
        vertex: usize,
        mu: &Increment,
        [a, b]: [&Moved; 2],
        turn: &Turn<Dual64>,
    ) -> (Strains<Dual64>, Directors<Dual64>) {
        let first = self.layout.vertex(vertex - 1);
        let here = self.shape.strains(vertex);
        let local = &mu.0[first..first + LOCAL];
        let untwist: f64 = here.gradient[2].iter().zip(local).map(|(g, mu)| g * mu).sum();
        let directors = Directors { m1e: a.m1, m2e: a.m2, m1f: b.m1, m2f: b.m2 };
        let tau = Dual64::new(here.value[2], untwist);
        (Strains::of(&a.edge, &b.edge, turn, &directors, tau), directors)
    }

    fn third_of_vertex(
        &self,
        vertex: usize,
        mu: &Increment,
        [a, b]: [&Moved; 2],
        turn: &Turn<Dual64>,
        band: &mut [f64],
        kept: Option<&mut [f64]>,
    ) {
        let (layout, k) = (&self.layout, &self.bend[vertex - 1]);
        let first = layout.vertex(vertex - 1);
        let (moved, directors) = self.moved_strains(vertex, mu, [a, b], turn);
        let real = |x: f64| Dual64::from(x);
        let stiffness = Stiffness { bend: k.bend.map(real), twist: real(k.twist), rest: k.rest.map(real) };
        let element = element::bend_twist(&a.edge, &b.edge, turn, &directors, &moved, &stiffness);
        let third = element.hessian.map(|row| row.map(|h| h.eps));
        Band { layout, values: band }.add(first, &third);
        let Some(kept) = kept else { return };
        for i in 0..LOCAL {
            let by = moved.gradient.each_ref().map(|gradient| gradient[i].eps);
            let stress = k.times(&by);
            (0..3).for_each(|s| kept[3 + LOCAL * s + i] = stress[s]);
        }
    }

    /// Adds Σ_e w_e ∂²ψ^e/∂x² at a shape of this rod to a lower band. `weights` is overwritten.
    pub(crate) fn holonomy_second_add(&self, shape: &Shape, weights: &mut [f64], band: &mut [f64]) {
        let layout = &self.layout;
        // ψ^e is the sum of the twists up to e
        for e in (1..weights.len()).rev() {
            weights[e - 1] += weights[e];
        }
        let twist = |a: &Edge, b: &Edge, turn: &Turn, weight: f64| {
            let zero = Vector3::zeros();
            let none = Directors { m1e: zero, m2e: zero, m1f: zero, m2f: zero };
            let strains = Strains::of(a, b, turn, &none, 0.0);
            let mut h = [[0.0; LOCAL]; LOCAL];
            element::strain_hessian_add(a, b, turn, &none, &strains, &[0.0, 0.0, weight], &mut h);
            h
        };
        for (e, &weight) in weights.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
            if e > 0 {
                let h = twist(&shape.edges[e - 1], &shape.edges[e], shape.turn(e), weight);
                let mut band = Band { layout, values: band };
                if layout.twist {
                    band.add(layout.vertex(e - 1), &h);
                } else {
                    band.add(layout.vertex(e - 1), &without_angles::<11, 9>(&h, [3, 7]));
                }
            } else if let (FirstFrame::Carried { tangent, .. }, Some(turn)) =
                (&self.first, shape.first_turn())
            {
                // from a direction that does not move: an edge of no end
                let h = twist(&Edge { t: *tangent, l: 1e100 }, &shape.edges[0], turn, weight);
                let own: [[f64; 7]; 7] = std::array::from_fn(|i| std::array::from_fn(|j| h[4 + i][4 + j]));
                let mut band = Band { layout, values: band };
                if layout.twist {
                    band.add(layout.vertex(0), &own);
                } else {
                    band.add(layout.vertex(0), &without_angles::<7, 6>(&own, [3, 7]));
                }
            }
        }
    }

    /// Adds the second derivatives of f·p, p = o₁ m₁ + o₂ m₂ + o₃ t of edge e, times an increment
    /// of its ends and angle, to forces on these. Returns ∂(f·p)/∂α.
    pub(crate) fn offset_second_add(
        &self,
        e: usize,
        [force, offset]: [&Vector3<f64>; 2],
        (places, turn): ([Vector3<f64>; 2], f64),
        on_places: &mut [Vector3<f64>],
        on_angle: &mut f64,
    ) -> f64 {
        let Moved { edge, m1, m2, area } = self.moved_by(e, places, turn);
        let [f, o] = [force, offset].map(|v| dual(v, &Vector3::zeros()));
        let by_angle = (m2 * o[0] - m1 * o[1]).dot(&f);
        let by_tangent = f * o[2] - (m1 * o[0] + m2 * o[1]) * edge.t.dot(&f);
        let rate = (by_tangent - edge.t * by_tangent.dot(&edge.t)) / edge.l;
        let second = slope(&rate) + area * by_angle.re;
        on_places[0] -= second;
        on_places[1] += second;
        *on_angle += by_angle.eps;
        by_angle.re
    }

    /// Adds `share` Σ s ∂²ε of the strains of another shape, one stress for each (see
    /// `KelvinVoigt::keep`), to a lower band.
    pub(crate) fn strains_second_add(
        &self,
        shape: &Shape,
        stress: &[[f64; 4]],
        share: f64,
        band: &mut [f64],
    ) {
        let layout = &self.layout;
        for (e, stress) in stress.iter().enumerate() {
            let [along, bend @ ..] = stress.map(|s| share * s);
            let edge = &shape.edges[e];
            let h =
                (nalgebra::Matrix3::identity() - crate::geometry::outer(&edge.t, &edge.t)) * (along / edge.l);
            if layout.twist {
                Band { layout, values: band }.add(layout.vertex(e), &element::edge_hessian::<7>(&h, 4));
            } else {
                Band { layout, values: band }.add(layout.vertex(e), &element::edge_hessian::<6>(&h, 3));
            }
            if !layout.bending || e == 0 {
                continue;
            }
            let mut h = [[0.0; LOCAL]; LOCAL];
            let (a, turn, m) = (&shape.edges[e - 1], shape.turn(e), shape.directors(e));
            element::strain_hessian_add(a, edge, turn, &m, &shape.strains(e), &bend, &mut h);
            Band { layout, values: band }.add(layout.vertex(e - 1), &h);
        }
    }
}

/// A matrix without two rows and columns.
fn without_angles<const N: usize, const M: usize>(h: &[[f64; N]; N], angles: [usize; 2]) -> [[f64; M]; M] {
    let at = |i: usize| i + usize::from(i >= angles[0]) + usize::from(i + 1 >= angles[1]);
    std::array::from_fn(|i| std::array::from_fn(|j| h[at(i)][at(j)]))
}
