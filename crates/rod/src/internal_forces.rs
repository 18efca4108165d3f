//! Tension, shear, moments within a rod, and what its supports exert.

use nalgebra::Vector3;

use crate::Error;
use crate::dynamics::RodStep;
use crate::equilibrium::Rest;
use crate::forces_of_motion::{edge_forces, with_forces_at};
use crate::rod::Rod;
use crate::statics::reactions::{Reaction, reactions};
use crate::support::{Damping, Loads, Supports};
use crate::system::{StageStart, System};

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

impl InternalForces {
    /// Every number, in the order of the fields; reactions force before moment.
    pub fn numbers(&mut self) -> impl Iterator<Item = &mut f64> {
        let across = self.tension.iter_mut().chain(self.shear.iter_mut().flatten());
        let moments = self.bending.iter_mut().flatten().chain(&mut self.twisting);
        let reactions = self.reactions.iter_mut().flat_map(|r| r.force.iter_mut().chain(&mut r.moment));
        across.chain(moments).chain(reactions)
    }
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
        let mut forces = InternalForces::default();
        with_forces_at(self, t, state, before, &mut |system, motion| {
            forces = of_shape(system, Some(motion.start))
        })?;
        Ok(forces)
    }
}

fn of_shape(system: &mut System, start: Option<StageStart>) -> InternalForces {
    system.elastic(None);
    let mut out = InternalForces { reactions: reactions(system, start), ..InternalForces::default() };
    let (layout, shape) = (&system.layout, &system.shape);
    let forces = edge_forces(system, &system.gradient, &out.reactions);
    for (e, (edge, force)) in shape.edges.iter().zip(forces).enumerate() {
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
