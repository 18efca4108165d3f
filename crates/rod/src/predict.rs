//! First guess of a step: the old shape carried along with the supports, and on with its own motion.

use nalgebra::{Matrix3, Vector3};

use crate::Error;
use crate::clamp_frame::ClampFrame;
use crate::system::System;

/// A support moves a part of the rod rigidly from one time to the next.
#[derive(Clone, Copy)]
struct Anchor {
    vertex: usize,
    from: Vector3<f64>,
    to: Vector3<f64>,
    rotation: Matrix3<f64>,
}

impl Anchor {
    fn carry(&self, x: Vector3<f64>) -> Vector3<f64> {
        self.to + self.rotation * (x - self.from)
    }
}

/// X_k carried rigidly with the supports: between two of them, a blend by vertex number of what either would
/// do. A clamp that moves several segments in one step then leaves a rod of the same shape, not one torn off
/// its support.
pub(crate) struct Carry {
    anchors: Vec<Anchor>,
    edges: Vec<Vector3<f64>>,
}

/// The guess goes on with the motion only where that turns no edge by more than this \[rad\] and moves no
/// vertex by more than this share of the rod's length, so that it does not choose between the solutions of a
/// violent step.
const LARGEST_TURN: f64 = 0.25;

impl Carry {
    pub(crate) fn new(system: &System) -> Carry {
        let edges = vec![Vector3::zeros(); system.rod.segments()];
        Carry { anchors: Vec::with_capacity(system.supports.prescribed.len() + 2), edges }
    }

    /// Sets the free vertices of `system` (whose supports stand where they are at time `to`) to the guess,
    /// `state` being that of time `from`; angles keep their old values.
    pub(crate) fn guess(
        &mut self,
        system: &mut System,
        from: f64,
        to: f64,
        state: &[f64],
    ) -> Result<(), Error> {
        let n = system.rod.segments();
        self.anchors.clear();
        if let (Some(a), Some(b)) = (system.clamp_frame(false, from)?, system.clamp_frame(false, to)?) {
            self.anchors.push(between(0, &a, &b));
        }
        for (vertex, motion) in &system.supports.prescribed {
            let [from, to] = [from, to].map(|t| system.moves.place(*vertex, motion.as_ref(), t));
            self.anchors.push(Anchor { vertex: *vertex, from, to, rotation: Matrix3::identity() });
        }
        if let (Some(a), Some(b)) = (system.clamp_frame(true, from)?, system.clamp_frame(true, to)?) {
            self.anchors.push(between(n, &a, &b));
        }
        self.anchors.sort_unstable_by_key(|a| a.vertex);
        system.scatter_state(state);
        for f in 0..system.layout.free_vertices.len() {
            let v = system.layout.free_vertices[f];
            let after = self.anchors.partition_point(|a| a.vertex < v);
            let x = system.x[v];
            system.x[v] = match (after.checked_sub(1).map(|i| self.anchors[i]), self.anchors.get(after)) {
                (None, None) => x,
                (Some(a), None) => a.carry(x),
                (None, Some(b)) => b.carry(x),
                (Some(a), Some(b)) => {
                    let w = (v - a.vertex) as f64 / (b.vertex - a.vertex) as f64;
                    a.carry(x) * (1.0 - w) + b.carry(x) * w
                }
            };
        }
        Ok(())
    }

    /// Turns the edges of the guess towards those of `target`, X* + η V* of the free vertices (where inertia
    /// alone takes them), and keeps their lengths: stretching is stiff, and a straight line would stretch
    /// what turns. Between two supports the gap that this leaves is spread over the vertices. Returns
    /// whether it did.
    pub(crate) fn coast(&mut self, system: &mut System, target: &[Vector3<f64>]) -> bool {
        let System { layout, x, rod, .. } = system;
        let (free, n) = (&layout.free_vertices, layout.segments);
        let (cosine, farthest) = (LARGEST_TURN.cos(), LARGEST_TURN * rod.length());
        let mut f = 0;
        let mut before = x[0];
        for v in 0..=n {
            let here = if free.get(f) == Some(&v) { target[f] } else { x[v] };
            f += usize::from(free.get(f) == Some(&v));
            if !((here - x[v]).norm_squared() <= farthest * farthest) {
                return false;
            }
            if v > 0 {
                let (old, new) = (x[v] - x[v - 1], here - before);
                let lengths = (old.norm_squared() * new.norm_squared()).sqrt();
                if !(lengths > 0.0 && old.dot(&new) >= cosine * lengths) {
                    return false;
                }
                self.edges[v - 1] = new * (old.norm_squared() / lengths);
            }
            before = here;
        }
        let mut first = 0;
        for run in free.chunk_by(|a, b| a + 1 == *b) {
            let (a, b) = (run[0], run[run.len() - 1]);
            let target = &target[first..first + run.len()];
            first += run.len();
            if a > 0 || b == n {
                x[a] = if a > 0 { x[a - 1] + self.edges[a - 1] } else { target[0] };
                for v in a + 1..=b {
                    x[v] = x[v - 1] + self.edges[v - 1];
                }
            } else {
                for v in (a..=b).rev() {
                    x[v] = x[v + 1] - self.edges[v];
                }
            }
            let last = b - a + 1;
            if a > 0 && b < n {
                let gap = x[b + 1] - x[b] - self.edges[b];
                (a..=b).for_each(|v| x[v] += gap * ((v + 1 - a) as f64 / (last + 1) as f64));
            } else if a == 0 && b == n {
                let off = (a..=b).map(|v| target[v] - x[v]).sum::<Vector3<f64>>() / last as f64;
                (a..=b).for_each(|v| x[v] += off);
            }
        }
        true
    }
}

fn between(vertex: usize, from: &ClampFrame, to: &ClampFrame) -> Anchor {
    let axes = |f: &ClampFrame| Matrix3::from_columns(&[f.tangent, f.director, f.tangent.cross(&f.director)]);
    Anchor { vertex, from: from.position, to: to.position, rotation: axes(to) * axes(from).transpose() }
}
