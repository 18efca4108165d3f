//! A rod between two states: the shape, stiffness and loads that the forces within it come from.

use nalgebra::Vector3;

use crate::Error;
use crate::dynamics::RodStep;
use crate::element::Strains;
use crate::geometry::Edge;
use crate::shape::Shape;
use crate::statics::reactions::Reaction;
use crate::support::Damping;
use crate::system::{PastStrains, StageStart, System};

/// The configuration that strain rates are differences to.
pub(crate) struct Past {
    pub(crate) shape: Shape,
    pub(crate) strains: Vec<Strains>,
    /// Lengths l* of its edges, and ∂l*/∂e by the edges of then and of now.
    pub(crate) lengths: Vec<f64>,
    pub(crate) by_edge: Vec<[Vector3<f64>; 2]>,
}

impl Past {
    pub(crate) fn strains(&self) -> PastStrains {
        let bend = self.strains.iter().map(|strains| strains.value).collect();
        PastStrains { lengths: self.lengths.clone(), bend }
    }

    /// Takes edges to have become longer by what lies along them: l* = l − t·(e − e*). One that turns by
    /// φ does not shorten by ½φ² then, as it does where e* is drawn back along velocities.
    fn along(&mut self, edges: &[Edge]) {
        for (e, (now, then)) in edges.iter().zip(&self.shape.edges).enumerate() {
            let change = now.t * now.l - then.t * then.l;
            let longer = now.t.dot(&change);
            self.lengths[e] = now.l - longer;
            self.by_edge[e] = [now.t, (now.t * longer - change) / now.l];
        }
    }
}

/// The motion of a rod since an earlier state.
pub(crate) struct Motion<'a> {
    pub(crate) start: StageStart<'a>,
    /// Where strain rates are.
    pub(crate) past: Option<&'a Past>,
    /// Velocity and acceleration of every vertex that is held; zero of the others.
    pub(crate) held: &'a [[Vector3<f64>; 2]],
    /// The time that these are differences over \[s\]; `None` of a rod at rest, which has none.
    pub(crate) interval: Option<f64>,
}

/// Calls `act` with the system in the shape of a state, its stiffness and loads those of the motion since an
/// earlier one, and the shape that strain rates are differences to.
pub(crate) fn with_forces_at(
    step: &mut RodStep,
    t: f64,
    state: &[f64],
    before: (f64, &[f64]),
    act: &mut dyn FnMut(&mut System, &Motion<'_>),
) -> Result<(), Error> {
    let h = t - before.0;
    if !(h > 0.0 && h.is_finite()) {
        return Err(Error::Value { field: "time between two states", value: h, expected: "above zero" });
    }
    with_forces(step, (t, state), (before, false), Some(h), act)
}

/// The same with rates over the time since `before`, where that may be drawn back along velocities, and
/// accelerations of supports as differences over `interval` on both sides; none of a rod at rest.
pub(crate) fn with_forces(
    step: &mut RodStep,
    (t, state): (f64, &[f64]),
    (before, along_velocities): ((f64, &[f64]), bool),
    interval: Option<f64>,
    act: &mut dyn FnMut(&mut System, &Motion<'_>),
) -> Result<(), Error> {
    let length = t - before.0;
    let damping = if interval.is_some() { step.damping } else { Damping::default() };
    let system = &mut step.system;
    shape_of(system, before.0, before.1)?;
    let start = system.x.clone();
    let mut past = (damping.stiffness > 0.0).then(|| {
        let (shape, bent) =
            (system.shape.clone(), if system.layout.bending { 1..system.rod.segments() } else { 0..0 });
        Past {
            strains: bent.map(|v| shape.strains(v)).collect(),
            lengths: shape.edges.iter().map(|edge| edge.l).collect(),
            by_edge: shape.edges.iter().map(|edge| [edge.t, Vector3::zeros()]).collect(),
            shape,
        }
    });
    let held = |system: &mut System, time: f64| -> Result<Vec<Vector3<f64>>, Error> {
        system.place(time)?;
        Ok(system.x.clone())
    };
    let mut moves = vec![[Vector3::zeros(); 2]; system.x.len()];
    if let Some(h) = interval {
        let places = [held(system, t - h)?, held(system, t)?, held(system, t + h)?];
        let is_held = |v: &usize| system.layout.free_vertices.binary_search(v).is_err();
        for v in (0..=system.rod.segments()).filter(is_held) {
            let [a, b, c] = [0, 1, 2].map(|k: usize| places[k][v]);
            moves[v] = [(c - a) / (2.0 * h), (c - 2.0 * b + a) / (h * h)];
        }
    }
    shape_of(system, t, state)?;
    for (v, [velocity, acceleration]) in moves.iter().enumerate() {
        system.forces[v] -= (acceleration + velocity * damping.mass) * system.rod.masses[v];
    }
    if let Some(past) = &mut past {
        if along_velocities {
            past.along(&system.shape.edges);
        }
        // the rate (ε − ε*)/length: its stress is that of a spring of stiffness k β/length about ε*
        let mut strains = past.strains();
        // a chain has no strains there
        strains.bend.resize(system.rod.ei.len(), [0.0; 3]);
        system.set_stiffness(damping.stiffness / length, Some(&strains));
    }
    let start = StageStart { places: &start, length };
    act(system, &Motion { start, past: past.as_ref(), held: &moves, interval });
    if past.is_some() {
        system.set_stiffness(0.0, None);
    }
    Ok(())
}

/// Supports, edges and frames of a state.
pub(crate) fn shape_of(system: &mut System, t: f64, state: &[f64]) -> Result<(), Error> {
    system.place(t)?;
    system.scatter_state(state);
    let guess = system.end_angle_guess();
    system.update_shape(system.layout.bending, guess)
}

/// F of every edge from ∂E/∂x (in the full order) and what supports exert, or changes of it from theirs.
pub(crate) fn edge_forces(system: &System, gradient: &[f64], reactions: &[Reaction]) -> Vec<Vector3<f64>> {
    let (supports, last_edge) = (&system.supports, system.rod.segments() - 1);
    let mut sum = Vector3::zeros();
    let force = |e: usize| {
        let i = system.layout.vertex(e);
        sum -= Vector3::from_column_slice(&gradient[i..i + 3]);
        // an edge that a clamp holds carries what the clamp takes
        match reactions {
            [first, ..] if supports.start.is_some() && e == 0 => -first.force,
            [.., last] if supports.end.is_some() && e == last_edge => last.force,
            _ => sum,
        }
    };
    (0..=last_edge).map(force).collect()
}
