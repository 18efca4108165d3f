//! Static equilibrium of a rod, and a first guess of it.

use nalgebra::Vector3;
use varda_implicit::{Equations, NewtonOptions, NewtonReport, solve};

use crate::Error;
use crate::rod::Rod;
use crate::statics::reactions::{Reaction, reactions};
use crate::statics::{Statics, at_rest};
use crate::support::{Damping, Loads, Supports};
use crate::system::System;

/// A rod at rest: places of all vertices and angles of all edges (from the Bishop frame).
#[derive(Debug, Clone, PartialEq)]
pub struct Rest {
    /// x_0 … x_n \[m\].
    pub vertices: Vec<Vector3<f64>>,
    /// θ^0 … θ^{n−1} \[rad\]; zero where the rod has no twist unknowns.
    pub theta: Vec<f64>,
}

/// Static equilibrium ∂E/∂u = F_ext with the supports where they are at time t, from a first guess.
///
/// It is a local minimum of the total potential energy: Newton steps go downhill, past saddles. `guess` gives
/// all vertices (prescribed ones are overwritten) and angles; a straight rod hanging from its clamp is
/// [`straight_guess`].
///
/// ```
/// use varda_rod::{Clamp, ClampAt, Loads, Material, Rod, Section, Supports, Vector3};
/// use varda_rod::{equilibrium, straight_guess};
///
/// // A cantilever of 0.1 m, 40 segments: its tip sinks by w L⁴/(8 EI), w the weight per length.
/// let section = Section::circle(&Material::new(1e7, 0.5, 1100.0), 0.005);
/// let rod = Rod::uniform_between(0.1, 40, &section, [true, false])?;
/// let supports = Supports::clamped_start(Clamp::new(ClampAt::Face, [0.0; 3], Vector3::x(), Vector3::z()));
/// let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
/// let guess = straight_guess(&rod, &supports, 0.0, Vector3::x())?;
/// let (rest, _) = equilibrium(&rod, &supports, &loads, 0.0, &guess)?;
/// let sinks = 9.81 * section.mass_per_length * 0.1_f64.powi(4) / (8.0 * section.ei1);
/// assert!((-rest.vertices[40].z / sinks - 1.0).abs() < 0.015); // it is not quite linear any more
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`varda_implicit::Error`] where Newton's method does not converge, or wrapping an [`Error`] of the rod.
///
/// # Panics
/// If the guess has the wrong number of vertices or angles.
pub fn equilibrium(
    rod: &Rod,
    supports: &Supports,
    loads: &Loads,
    t: f64,
    guess: &Rest,
) -> Result<(Rest, NewtonReport), varda_implicit::Error> {
    let mut work = Work::default();
    // a stiff column far beyond its buckling load folds and unfolds its way from the straight saddle to the
    // first mode
    let rest = equilibrium_within(rod, supports, loads, t, guess, 2000, &mut work)?;
    Ok((rest, work.report))
}

/// What several searches for an equilibrium did together.
#[derive(Debug, Default)]
pub(crate) struct Work {
    pub(crate) solves: usize,
    pub(crate) iterations: usize,
    /// Of the last search that ended well.
    pub(crate) report: NewtonReport,
    /// Where the last search that failed stopped.
    pub(crate) stopped: Option<Rest>,
    /// Potential energy at its end.
    pub(crate) energy: f64,
    /// Reactions there.
    pub(crate) reactions: Vec<Reaction>,
}

/// [`equilibrium`] with a limit of iterations.
pub(crate) fn equilibrium_within(
    rod: &Rod,
    supports: &Supports,
    loads: &Loads,
    t: f64,
    guess: &Rest,
    max_iterations: usize,
    done: &mut Work,
) -> Result<Rest, varda_implicit::Error> {
    assert_eq!(guess.vertices.len(), rod.segments() + 1, "one place for every vertex");
    assert_eq!(guess.theta.len(), rod.segments(), "one angle for every edge");
    let refuse = |e: Error| varda_implicit::Error::Refused { step: 0, reason: e.into() };
    // nothing spins at rest
    let massless = Rod { spin_inertia: Vec::new(), ..rod.clone() };
    let mut system =
        System::new(massless, supports.clone(), loads.clone(), &Damping::default(), false).map_err(refuse)?;
    system.x.copy_from_slice(&guess.vertices);
    system.theta.copy_from_slice(&guess.theta);
    system.place(t).map_err(refuse)?;
    if !system.layout.bending {
        stretch_a_little(&mut system);
    }
    let end_angle = guess.theta.last().copied().unwrap_or(0.0);
    let mut u = vec![0.0; system.layout.unknowns];
    system.gather(&mut u);
    let mut statics = Statics::new(system, end_angle, 1e-11 * rod.length());
    let mut work = statics.work_space();
    let options = NewtonOptions::default().with_max_iterations(max_iterations);
    let solved = solve(&mut statics, &mut u, &mut work, &options);
    done.solves += 1;
    done.iterations += work.report().iterations;
    if solved.is_err() {
        let mut stopped = statics.system.clone();
        stopped.scatter(&u);
        stopped.theta[rod.segments() - 1] = match stopped.layout.free_angles.contains(&(rod.segments() - 1)) {
            true => stopped.theta[rod.segments() - 1],
            false => statics.end_angle,
        };
        done.stopped = Some(Rest { vertices: stopped.x, theta: stopped.theta });
    }
    done.report = solved.map_err(|failure| failure.in_step(&at_rest(t)))?;
    let mut g = vec![0.0; u.len()];
    let at_end = statics.assemble(&u, &mut g, None);
    done.energy = at_end
        .map_err(|reason| varda_implicit::NewtonFailure::Refused(reason).in_step(&at_rest(t)))?
        .unwrap_or(f64::NAN);
    done.reactions = reactions(&statics.system, None);
    let Statics { mut system, end_angle, .. } = statics;
    system.scatter(&u);
    system.update_shape(system.layout.twist, end_angle).map_err(refuse)?;
    Ok(Rest { vertices: system.x, theta: system.theta })
}

/// An edge of a chain at its rest length has no stiffness across itself, which leaves zero rows in the
/// Hessian: where there is one, the free vertices move away from the first held one by a thousandth.
fn stretch_a_little(system: &mut System) {
    let mut edges = system.x.windows(2).zip(&system.rod.rest_lengths);
    if edges.any(|(x, rest)| ((x[1] - x[0]).norm() - rest).abs() < 1e-9 * rest) {
        let free = &system.layout.free_vertices;
        let held = (0..system.x.len()).find(|v| !free.contains(v)).unwrap_or(0);
        let origin = system.x[held];
        for &v in free {
            system.x[v] = origin + (system.x[v] - origin) * 1.001;
        }
    }
}

/// The straight, unstretched rod that leaves the start clamp (or, without one, the first prescribed vertex or
/// the end clamp) at time t along the clamp's tangent, or along `direction` where there is no start clamp.
///
/// ```
/// use varda_rod::{Clamp, ClampAt, Material, Rod, Section, Supports, Vector3, straight_guess};
///
/// let rod = Rod::uniform(1.0, 4, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01))?;
/// let clamp = Clamp::new(ClampAt::Edge, [0.0, 0.0, 2.0], -Vector3::z(), Vector3::x());
/// let guess = straight_guess(&rod, &Supports::clamped_start(clamp), 0.0, Vector3::x())?;
/// assert_eq!(guess.vertices[4], Vector3::new(0.0, 0.0, 1.0)); // along the clamp
/// # Ok::<(), varda_rod::Error>(())
/// ```
///
/// # Errors
/// [`Error`] where the rod or a support is not usable, or `direction` is zero or too large to be normalized.
pub fn straight_guess(
    rod: &Rod,
    supports: &Supports,
    t: f64,
    direction: impl Into<Vector3<f64>>,
) -> Result<Rest, Error> {
    let direction = direction.into();
    rod.check()?;
    supports.prescribed_vertices(rod)?;
    let n = rod.segments();
    let s = rod.arc_lengths();
    let length = direction.norm();
    let (anchor, place, tangent) = if let Some(clamp) = &supports.start {
        let f = clamp.frame(t)?;
        (0, f.position, f.tangent)
    } else if let Some((vertex, motion)) = supports.prescribed.first() {
        (*vertex, motion.at(t), direction / length)
    } else if let Some(clamp) = &supports.end {
        let f = clamp.frame(t)?;
        (n, f.position, f.tangent)
    } else {
        (0, Vector3::zeros(), direction / length)
    };
    // a length of zero, or one that overflowed, leaves no unit vector
    if !(tangent.norm() > 0.5) {
        return Err(Error::Value { field: "direction", value: length, expected: "a direction" });
    }
    let vertices = s.iter().map(|si| place + tangent * (si - s[anchor])).collect();
    Ok(Rest { vertices, theta: vec![0.0; n] })
}
