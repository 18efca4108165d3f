//! Edges, turns and frames of one configuration, and the conversion between the two gauges of θ.
//!
//! Stored angles θ are measured from the **Bishop frame**: d₁ of the first edge carried along the rod by
//! parallel transport, so that the reference twist is zero and τ_i = θ^i − θ^{i−1} counts whole turns.
//! Derivatives of energies are taken in the **local gauge** (directors carried along in time). The two differ
//! by the holonomy ψ,
//!
//! ```text
//! dθ_stored = dθ_local + dψ,   dψ^i − dψ^{i−1} = ½ κb_i·(de^{i−1}/l^{i−1} + de^i/l^i)
//! ```
//!
//! with dψ⁰ = 0 where the first edge is clamped.

use nalgebra::Vector3;

use crate::Error;
use crate::element::{Directors, Strains};
use crate::geometry::{Edge, Turn, perpendicular};
use crate::scalar::Real;

/// How the first edge gets its director d₁.
#[derive(Debug, Clone, Copy)]
pub(crate) enum FirstFrame<T = f64> {
    /// Given: the edge is clamped in this director.
    Clamped(Vector3<T>),
    /// Carried by parallel transport from a fixed tangent and director: a function of the first tangent
    /// alone.
    Carried { tangent: Vector3<T>, director: Vector3<T> },
}

/// One configuration of the rod: everything energies and markers need. Buffers are reused.
#[derive(Debug, Clone)]
pub(crate) struct Shape<T = f64> {
    pub(crate) edges: Vec<Edge<T>>,
    /// Turn at vertex i, i = 1 … n−1; entry 0 is that between the reference tangent and the first edge
    /// where the first frame is carried.
    turns: Vec<Turn<T>>,
    carried: bool,
    pub(crate) d1: Vec<Vector3<T>>,
    pub(crate) m1: Vec<Vector3<T>>,
    pub(crate) m2: Vec<Vector3<T>>,
    /// τ_i at vertex i; entry 0 unused.
    pub(crate) tau: Vec<T>,
}

impl<T: Real> Shape<T> {
    pub(crate) fn new(segments: usize) -> Shape<T> {
        let (n, zero) = (segments, Vector3::zeros());
        Shape {
            edges: vec![Edge::none(); n],
            turns: vec![Turn::none(); n],
            carried: false,
            d1: vec![zero; n],
            m1: vec![zero; n],
            m2: vec![zero; n],
            tau: vec![T::zero(); n],
        }
    }

    pub(crate) fn turn(&self, vertex: usize) -> &Turn<T> {
        debug_assert!(vertex > 0);
        &self.turns[vertex]
    }

    /// The turn between the reference tangent and the first edge, where the first frame is carried.
    pub(crate) fn first_turn(&self) -> Option<&Turn<T>> {
        self.carried.then(|| &self.turns[0])
    }

    /// Takes over another shape of the same rod, without asking for memory.
    pub(crate) fn copy_from(&mut self, other: &Shape<T>) {
        let Shape { edges, turns, carried, d1, m1, m2, tau } = other;
        self.edges.copy_from_slice(edges);
        self.turns.copy_from_slice(turns);
        self.carried = *carried;
        self.d1.copy_from_slice(d1);
        self.m1.copy_from_slice(m1);
        self.m2.copy_from_slice(m2);
        self.tau.copy_from_slice(tau);
    }

    /// Edges and turns of the vertices x. `bent` = whether turns are needed.
    pub(crate) fn set_edges(&mut self, x: &[Vector3<T>], bent: bool) -> Result<(), Error> {
        for i in 0..self.edges.len() {
            self.edges[i] = Edge::between(&x[i], &x[i + 1], i)?;
            if bent && i > 0 {
                self.turns[i] = Turn::between(&self.edges[i - 1].t, &self.edges[i].t, i)?;
            }
        }
        Ok(())
    }

    /// Bishop directors d₁ of all edges; needs edges and turns.
    pub(crate) fn set_bishop(&mut self, first: &FirstFrame<T>) -> Result<(), Error> {
        let t0 = self.edges[0].t;
        self.carried = matches!(first, FirstFrame::Carried { .. });
        self.d1[0] = match first {
            FirstFrame::Clamped(director) => perpendicular(director, &t0),
            FirstFrame::Carried { tangent, director } => {
                self.turns[0] = Turn::between(tangent, &t0, 0).map_err(|_| Error::FrameUndefined)?;
                perpendicular(&self.turns[0].transport(&t0, director), &t0)
            }
        };
        for i in 1..self.edges.len() {
            let t = self.edges[i].t;
            self.d1[i] = perpendicular(&self.turns[i].transport(&t, &self.d1[i - 1]), &t);
        }
        Ok(())
    }

    /// Directors m₁, m₂ from d₁ and θ, and twists τ_i = θ^i − θ^{i−1} + reference twist.
    pub(crate) fn set_angles(&mut self, theta: &[T], reference_twist: Option<&[T]>) {
        for i in 0..self.edges.len() {
            let (d1, d2) = (self.d1[i], self.edges[i].t.cross(&self.d1[i]));
            let (sin, cos) = theta[i].sin_cos();
            self.m1[i] = d1 * cos + d2 * sin;
            self.m2[i] = d2 * cos - d1 * sin;
            if i > 0 {
                self.tau[i] = theta[i] - theta[i - 1] + reference_twist.map_or(T::zero(), |r| r[i - 1]);
            }
        }
    }

    /// Directors of the two edges at an interior vertex.
    pub(crate) fn directors(&self, vertex: usize) -> Directors<T> {
        Directors {
            m1e: self.m1[vertex - 1],
            m2e: self.m2[vertex - 1],
            m1f: self.m1[vertex],
            m2f: self.m2[vertex],
        }
    }

    /// Strains at an interior vertex, with gradients.
    pub(crate) fn strains(&self, vertex: usize) -> Strains<T> {
        let (a, b) = (&self.edges[vertex - 1], &self.edges[vertex]);
        Strains::of(a, b, self.turn(vertex), &self.directors(vertex), self.tau[vertex])
    }

    /// What [`holonomy`] needs of an edge: ½κb at its first vertex, and its length.
    fn bend_and_length(&self, i: usize) -> (Vector3<T>, T) {
        let bent = i > 0 || self.carried;
        let half = if bent { self.turns[i].kb * T::of(0.5) } else { Vector3::zeros() };
        (half, self.edges[i].l)
    }

    /// dψ of every edge for displacements dx of the vertices.
    pub(crate) fn holonomy(&self, dx: &[Vector3<T>], psi: &mut [T]) {
        holonomy(|i| self.bend_and_length(i), dx, psi);
    }

    /// The transpose: dx += (∂ψ/∂x)ᵀ μ, μ one number per edge.
    pub(crate) fn holonomy_transpose_add(&self, mu: &[T], dx: &mut [Vector3<T>]) {
        holonomy_transpose_add(|i| self.bend_and_length(i), mu, dx);
    }
}

impl Shape {
    /// Writes what [`holonomy`] needs, [`HOLONOMY`] numbers for every edge.
    pub(crate) fn keep_holonomy(&self, kept: &mut [f64]) {
        for (i, kept) in kept.chunks_exact_mut(HOLONOMY).enumerate() {
            let (half, l) = self.bend_and_length(i);
            kept.copy_from_slice(&[half.x, half.y, half.z, l]);
        }
    }
}

/// Numbers for every edge that [`Shape::keep_holonomy`] writes.
pub(crate) const HOLONOMY: usize = 4;

/// ½κb and length of edge i from these.
pub(crate) fn kept_bend(kept: &[f64]) -> impl Fn(usize) -> (Vector3<f64>, f64) + '_ {
    |i| {
        let k = &kept[HOLONOMY * i..HOLONOMY * (i + 1)];
        (Vector3::new(k[0], k[1], k[2]), k[3])
    }
}

/// dψ of every edge for displacements dx of the vertices; `edge` gives ½κb at the first vertex of an edge
/// (zero where the first edge is clamped), and its length.
pub(crate) fn holonomy<T: Real>(edge: impl Fn(usize) -> (Vector3<T>, T), dx: &[Vector3<T>], psi: &mut [T]) {
    let (mut sum, mut before) = (T::zero(), Vector3::zeros());
    for (i, psi) in psi.iter_mut().enumerate() {
        let (half, l) = edge(i);
        let rate = (dx[i + 1] - dx[i]) / l;
        sum += half.dot(&(before + rate));
        *psi = sum;
        before = rate;
    }
}

/// The transpose: dx += (∂ψ/∂x)ᵀ μ, μ one number per edge.
pub(crate) fn holonomy_transpose_add<T: Real>(
    edge: impl Fn(usize) -> (Vector3<T>, T),
    mu: &[T],
    dx: &mut [Vector3<T>],
) {
    let mut sum = T::zero();
    let mut after = Vector3::zeros();
    for i in (0..mu.len()).rev() {
        sum += mu[i];
        let (half, l) = edge(i);
        let at = half * sum;
        let v = (at + after) / l;
        dx[i + 1] += v;
        dx[i] -= v;
        after = at;
    }
}
