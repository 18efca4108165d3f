//! First guess of a step: the old shape carried along with the supports.

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
}

impl Carry {
    pub(crate) fn new(system: &System) -> Carry {
        Carry { anchors: Vec::with_capacity(system.supports.prescribed.len() + 2) }
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
}

fn between(vertex: usize, from: &ClampFrame, to: &ClampFrame) -> Anchor {
    let axes = |f: &ClampFrame| Matrix3::from_columns(&[f.tangent, f.director, f.tangent.cross(&f.director)]);
    Anchor { vertex, from: from.position, to: to.position, rotation: axes(to) * axes(from).transpose() }
}
