//! Strains of a shape with their gradients, and how both change along an increment.

use nalgebra::Vector3;
use num_dual::Dual64;

use crate::element::{self, LOCAL};
use crate::geometry::Turn;
use crate::second_order::{Increment, Moved, slope};
use crate::system::System;

/// Strains of a shape, and of the same moved by ε μ in coordinates that start where it is then (see
/// [`second_order`](crate::second_order)).
#[derive(Default)]
pub(crate) struct Along {
    pub(crate) edges: Vec<EdgeAlong>,
    pub(crate) vertices: Vec<VertexAlong>,
}

/// The length of an edge: its gradient is ∓t in the two ends.
pub(crate) struct EdgeAlong {
    pub(crate) l: f64,
    pub(crate) t: Vector3<f64>,
    /// μ·∇l, and the change of t.
    pub(crate) rate: f64,
    pub(crate) turned: Vector3<f64>,
}

/// κ₁, κ₂, τ of a vertex with frames; where there are none the first is its energy for a stiffness of
/// one, and its gradient stands in the first nine places.
pub(crate) struct VertexAlong {
    pub(crate) value: [f64; 3],
    pub(crate) gradient: [[f64; LOCAL]; 3],
    /// μ·∇ε, and the change of the gradients.
    pub(crate) rate: [f64; 3],
    pub(crate) turned: [[f64; LOCAL]; 3],
}

impl System {
    /// Those of the present shape.
    pub(crate) fn along(&self, mu: &Increment, out: &mut Along) {
        let layout = &self.layout;
        out.edges.clear();
        out.vertices.clear();
        let mut before: Option<Moved> = None;
        for e in 0..layout.segments {
            let now = self.moved(e, mu);
            let (l, t) = (self.shape.edges[e].l, self.shape.edges[e].t);
            out.edges.push(EdgeAlong { l, t, rate: now.edge.l.eps, turned: slope(&now.edge.t) });
            let Some(last) = before.replace(now).filter(|_| layout.bending) else { continue };
            let turn = Turn::between(&last.edge.t, &now.edge.t, e).expect("this shape was assembled before");
            let zero = [[0.0; LOCAL]; 3];
            let mut vertex = VertexAlong { value: [0.0; 3], gradient: zero, rate: [0.0; 3], turned: zero };
            if layout.twist {
                let (moved, _) = self.moved_strains(e, mu, [&last, &now], &turn);
                vertex.value = moved.value.map(|v| v.re);
                vertex.rate = moved.value.map(|v| v.eps);
                vertex.gradient = moved.gradient.map(|g| g.map(|g| g.re));
                vertex.turned = moved.gradient.map(|g| g.map(|g| g.eps));
            } else {
                let one = element::isotropic_bend(&last.edge, &now.edge, &turn, Dual64::from(1.0));
                (vertex.value[0], vertex.rate[0]) = (one.energy.re, one.energy.eps);
                for (i, g) in one.gradient.iter().enumerate() {
                    (vertex.gradient[0][i], vertex.turned[0][i]) = (g.re, g.eps);
                }
            }
            out.vertices.push(vertex);
        }
    }
}
