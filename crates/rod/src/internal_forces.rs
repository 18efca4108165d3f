//! Tension, shear, moments within a rod, and what its supports exert.

use nalgebra::Vector3;

use crate::Error;
use crate::dynamics::RodStep;
use crate::equilibrium::Rest;
use crate::rod::Rod;
use crate::statics::reactions::{Reaction, reactions};
use crate::support::{Damping, Loads, Supports};
use crate::system::{PastStrains, StageStart, System};

/// Forces and moments that one side of a rod exerts on the other.
///
/// ```text
/// F^e = −Σ_{v ≤ e} ∂E/∂x_v,   N = F·t,   Q₁ = F·m₁,   Q₂ = F·m₂         per edge
/// M_i = EI_i (κ_i − κ̄_i)/l̄_i,   T_i = GJ_i (τ_i − τ̄_i)/l̄_i    per interior vertex
/// ```
///
/// F^e is what the rod beyond edge e exerts on the rod before it: a tension is positive. An edge that a clamp
/// holds carries what the clamp takes. With strain-rate damping E holds its stress too; reactions count
/// inertia where the rod moves.
///
/// ```
/// use varda_rod::InternalForces;
///
/// // From `internal_forces`, or `RodStep::internal_forces` in motion.
/// let forces = InternalForces { tension: vec![2.0, 3.5, 1.0], ..InternalForces::default() };
/// let most = forces.tension.iter().fold(0.0, |most: f64, n| most.max(*n));
/// assert_eq!(most, 3.5); // N
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct InternalForces {
    /// N of every edge \[N\].
    pub tension: Vec<f64>,
    /// (Q₁, Q₂) of every edge \[N\], along m₁ and m₂.
    pub shear: Vec<[f64; 2]>,
    /// (M₁, M₂) of every interior vertex \[N m\], which bend it as κ₁ and κ₂; empty for a chain.
    pub bending: Vec<[f64; 2]>,
    /// T of every interior vertex \[N m\]; empty for a chain.
    pub twisting: Vec<f64>,
    /// What supports exert on the rod, by ascending vertices.
    pub reactions: Vec<Reaction>,
}

/// Forces and moments within a rod at rest, supports where they are at time t.
///
/// ```
/// use varda_rod::{Clamp, ClampAt, Loads, Material, Rod, Search, Section, Supports, Vector3};
/// use varda_rod::{internal_forces, rest};
///
/// // What hangs from a clamp pulls at it with its whole weight.
/// let section = Section::circle(&Material::new(1e7, 0.5, 1100.0), 0.005);
/// let rod = Rod::uniform(1.0, 20, &section)?;
/// let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], -Vector3::z(), Vector3::x()));
/// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
/// let found = rest(&rod, &supports, &loads, 0.0, &Search::default())?;
/// let forces = internal_forces(&rod, &supports, &loads, 0.0, &found.rest)?;
/// let weight = 9.81 * rod.masses.iter().sum::<f64>();
/// assert!((forces.reactions[0].force.z - weight).abs() < 1e-9 * weight);
/// assert!(forces.tension[1] > forces.tension[18] && forces.tension[18] > 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`Error`] where the rod, a support or the shape is not usable.
///
/// # Panics
/// If the shape has the wrong number of vertices or angles.
pub fn internal_forces(
    rod: &Rod,
    supports: &Supports,
    loads: &Loads,
    t: f64,
    rest: &Rest,
) -> Result<InternalForces, Error> {
    assert_eq!(rest.vertices.len(), rod.segments() + 1, "one place for every vertex");
    assert_eq!(rest.theta.len(), rod.segments(), "one angle for every edge");
    let (supports, loads) = (supports.clone(), loads.clone());
    let mut system = System::new(rod.clone(), supports, loads, &Damping::default(), false)?;
    system.x.copy_from_slice(&rest.vertices);
    system.theta.copy_from_slice(&rest.theta);
    system.place(t)?;
    system.update_shape(system.layout.bending, rest.theta.last().copied().unwrap_or(0.0))?;
    Ok(of_shape(&mut system, None))
}

impl RodStep {
    /// Forces and moments within the rod in a state at time t \[s\]. Strain rates and the accelerations of
    /// supports are differences over the time since `before`, an earlier time and its state.
    ///
    /// # Errors
    /// [`Error`] where a support's motion or a shape is not usable, or `before` is not earlier.
    ///
    /// # Panics
    /// If a state is shorter than the places, velocities and angles of the rod.
    pub fn internal_forces(
        &mut self,
        t: f64,
        state: &[f64],
        before: (f64, &[f64]),
    ) -> Result<InternalForces, Error> {
        let h = t - before.0;
        if !(h > 0.0 && h.is_finite()) {
            return Err(Error::Value { field: "time between two states", value: h, expected: "above zero" });
        }
        let (damping, scratch) = (self.damping, &mut self.system);
        let mut past = PastStrains::default();
        shape_of(scratch, before.0, before.1)?;
        let start = scratch.x.clone();
        if damping.stiffness > 0.0 {
            past.lengths.extend(scratch.shape.edges.iter().map(|edge| edge.l));
            if scratch.layout.bending {
                let strains = (1..scratch.rod.segments()).map(|v| scratch.shape.strains(v).value);
                past.bend.extend(strains);
            }
        }
        let held = |system: &mut System, time: f64| -> Result<Vec<Vector3<f64>>, Error> {
            system.place(time)?;
            Ok(system.x.clone())
        };
        let places = [held(scratch, t - h)?, held(scratch, t)?, held(scratch, t + h)?];
        shape_of(scratch, t, state)?;
        for v in
            (0..=scratch.rod.segments()).filter(|v| scratch.layout.free_vertices.binary_search(v).is_err())
        {
            let [a, b, c] = [0, 1, 2].map(|k: usize| places[k][v]);
            let (velocity, acceleration) = ((c - a) / (2.0 * h), (c - 2.0 * b + a) / (h * h));
            scratch.forces[v] -= (acceleration + velocity * damping.mass) * scratch.rod.masses[v];
        }
        let elastic = damping.stiffness == 0.0;
        if !elastic {
            // the rate (ε − ε*)/h: its stress is that of a spring of stiffness k β/h about ε*
            scratch.set_stiffness(damping.stiffness / h, Some(&past));
        }
        let forces = of_shape(scratch, Some(StageStart { places: &start, length: h }));
        if !elastic {
            scratch.set_stiffness(0.0, None);
        }
        Ok(forces)
    }
}

/// Supports, edges and frames of a state.
fn shape_of(system: &mut System, t: f64, state: &[f64]) -> Result<(), Error> {
    system.place(t)?;
    system.scatter_state(state);
    let guess = system.end_angle_guess();
    system.update_shape(system.layout.bending, guess)
}

fn of_shape(system: &mut System, start: Option<StageStart>) -> InternalForces {
    system.elastic(None);
    let mut out = InternalForces { reactions: reactions(system, start), ..InternalForces::default() };
    let (layout, shape, supports) = (&system.layout, &system.shape, &system.supports);
    let mut sum = Vector3::zeros();
    for (e, edge) in shape.edges.iter().enumerate() {
        let i = layout.vertex(e);
        sum -= Vector3::from_column_slice(&system.gradient[i..i + 3]);
        // an edge that a clamp holds carries what the clamp takes
        let force = match (&out.reactions[..], e) {
            ([first, ..], 0) if supports.start.is_some() => -first.force,
            ([.., last], e) if supports.end.is_some() && e + 1 == shape.edges.len() => last.force,
            _ => sum,
        };
        out.tension.push(force.dot(&edge.t));
        let across = if layout.bending { [shape.m1[e], shape.m2[e]] } else { [Vector3::zeros(); 2] };
        out.shear.push(across.map(|m| force.dot(&m)));
    }
    if layout.bending {
        for (i, k) in system.bend.iter().enumerate() {
            let strains = shape.strains(i + 1).value;
            let [a, b, twist] = std::array::from_fn(|c| strains[c] - k.rest[c]);
            out.bending.push([k.bend[0] * a + k.bend[1] * b, k.bend[1] * a + k.bend[2] * b]);
            out.twisting.push(k.twist * twist);
        }
    }
    out
}
