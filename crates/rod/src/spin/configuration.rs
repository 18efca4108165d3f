//! A configuration that spins are measured from or to, with increments of it.

use nalgebra::Vector3;

use crate::shape::Shape;
use crate::system::System;

/// A configuration, and increments of its places and angles, or what acts on them.
pub(crate) struct Configuration {
    pub(crate) shape: Shape,
    pub(crate) theta: Vec<f64>,
    pub(crate) displacement: Vec<Vector3<f64>>,
    /// Of angles in the local gauge; zero where an angle is given.
    pub(crate) turned: Vec<f64>,
}

impl Configuration {
    pub(crate) fn new(segments: usize) -> Configuration {
        Configuration {
            shape: Shape::new(segments),
            theta: vec![0.0; segments],
            displacement: vec![Vector3::zeros(); segments + 1],
            turned: vec![0.0; segments],
        }
    }

    /// Takes over the present shape of `system`.
    pub(crate) fn take(&mut self, system: &System) {
        self.shape.copy_from(&system.shape);
        self.theta.copy_from_slice(&system.theta);
    }

    /// Takes over an increment of the state.
    pub(crate) fn set_increment(&mut self, system: &System, dx: &[f64]) {
        let layout = &system.layout;
        system.displacements(dx, &mut self.displacement);
        self.shape.holonomy(&self.displacement, &mut self.turned);
        let angles = &dx[6 * layout.free_vertices.len()..];
        let mut free = 0;
        for (e, turned) in self.turned.iter_mut().enumerate() {
            let is_free = layout.free_angles.get(free) == Some(&e);
            *turned = if is_free { angles[free] - *turned } else { 0.0 };
            free += usize::from(is_free);
        }
    }

    /// δe/l of an edge.
    pub(crate) fn moved(&self, e: usize) -> Vector3<f64> {
        (self.displacement[e + 1] - self.displacement[e]) / self.shape.edges[e].l
    }

    pub(crate) fn clear(&mut self) {
        self.displacement.fill(Vector3::zeros());
        self.turned.fill(0.0);
    }

    /// The transpose of [`Configuration::moved`].
    pub(crate) fn pull(&mut self, e: usize, by: &Vector3<f64>) {
        let force = by / self.shape.edges[e].l;
        self.displacement[e] -= force;
        self.displacement[e + 1] += force;
    }

    /// The transpose of [`Configuration::set_increment`]: dx += what acts on places and angles.
    pub(crate) fn transpose_add(&mut self, system: &System, dx: &mut [f64]) {
        let layout = &system.layout;
        let nf = layout.free_vertices.len();
        let mut free = 0;
        for (e, turned) in self.turned.iter_mut().enumerate() {
            if layout.free_angles.get(free) == Some(&e) {
                dx[6 * nf + free] += *turned;
                *turned = -*turned;
                free += 1;
            } else {
                *turned = 0.0;
            }
        }
        self.shape.holonomy_transpose_add(&self.turned, &mut self.displacement);
        for (f, &v) in layout.free_vertices.iter().enumerate() {
            for c in 0..3 {
                dx[3 * f + c] += self.displacement[v][c];
            }
        }
    }
}
