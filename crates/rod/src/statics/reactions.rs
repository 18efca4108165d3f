//! What supports exert on a rod at rest.

use nalgebra::Vector3;

use crate::system::{StageStart, System};

/// What a support exerts on a rod at rest: R_v = ∂E/∂x_v − F_v at the vertices that it holds, and about
/// its tangent ∂E/∂θ where it holds a director.
///
/// ```
/// use std::sync::Arc;
/// use varda_rod::{Loads, Material, Rod, Search, Section, Supports, Vector3, rest};
///
/// // A cable slack between two hooks at one height: each carries half of it.
/// let rod = Rod::uniform(1.2, 20, &Section::circle(&Material::new(1e7, 0.5, 1100.0), 0.002))?;
/// let mut supports = Supports::default();
/// supports.prescribed.push((0, Arc::new([0.0; 3])));
/// supports.prescribed.push((20, Arc::new([1.0, 0.0, 0.0])));
/// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
/// let found = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
/// let half = 0.5 * 9.81 * rod.masses.iter().sum::<f64>();
/// for reaction in &found.reactions {
///     assert!((reaction.force.z - half).abs() < 1e-8 * half);
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reaction {
    /// The held vertex; for a clamp that at the end of the rod, its face or its vertex.
    pub vertex: usize,
    /// Force on the rod \[N\].
    pub force: Vector3<f64>,
    /// Moment on the rod about the place of that vertex \[N m\]; zero where only a place is held.
    pub moment: Vector3<f64>,
}

/// What loads do: forces on every vertex, and moments about the tangent of every edge.
pub(crate) struct EdgeSums {
    pub(crate) forces: Vec<Vector3<f64>>,
    pub(crate) moments: Vec<f64>,
}

/// All loads of the present shape, those of the motion with the velocities since `start`.
pub(crate) fn all_loads(system: &System, start: Option<StageStart>) -> EdgeSums {
    let mut sums = EdgeSums { forces: system.forces.clone(), moments: vec![0.0; system.rod.segments()] };
    system.each_load(start, |acts, motion, _| {
        for (i, force) in acts.forces.iter().enumerate() {
            sums.forces[motion.edge + i / 3][i % 3] += force;
        }
        sums.moments[motion.edge] += acts.moment;
    });
    sums
}

/// The reactions in a system whose gradient was just assembled, by ascending vertices; loads see the
/// velocities since `start`.
pub(crate) fn reactions(system: &System, start: Option<StageStart>) -> Vec<Reaction> {
    exerted(system, &system.gradient, &all_loads(system, start))
}

/// What supports exert against ∂E/∂(x, θ) (in the full order) and loads, or against changes of both: a
/// clamp's edge does not move.
pub(crate) fn exerted(system: &System, gradient: &[f64], loads: &EdgeSums) -> Vec<Reaction> {
    let n = system.rod.segments();
    let layout = &system.layout;
    let at = |v: usize| {
        let i = layout.vertex(v);
        Vector3::from_column_slice(&gradient[i..i + 3]) - loads.forces[v]
    };
    let clamped = |vertex: usize, beside: usize, edge: usize| {
        let arm = system.x[beside] - system.x[vertex];
        let tangent = (system.x[edge + 1] - system.x[edge]).normalize();
        let twist = if layout.twist { gradient[layout.angle(edge)] - loads.moments[edge] } else { 0.0 };
        let moment = arm.cross(&at(beside)) + tangent * twist;
        Reaction { vertex, force: at(vertex) + at(beside), moment }
    };
    let supports = &system.supports;
    let mut all: Vec<Reaction> = Vec::new();
    all.extend(supports.start.iter().map(|_| clamped(0, 1, 0)));
    all.extend(supports.prescribed.iter().map(|&(vertex, _)| Reaction {
        vertex,
        force: at(vertex),
        moment: Vector3::zeros(),
    }));
    all.extend(supports.end.iter().map(|_| clamped(n, n - 1, n - 1)));
    all.sort_by_key(|r| r.vertex);
    all
}
