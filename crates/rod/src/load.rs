//! Loads that depend on the motion of the rod.

pub(crate) mod drag;
pub(crate) mod follower;
pub(crate) mod moment;
pub(crate) mod scaled;

use std::ops::Range;

use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3, Vector6};
use num_dual::Dual64;

use crate::scalar::{Real, dual, length};
use crate::{Error, Rod};

/// The motion of an edge, as a load finds it at the time at which a step takes its forces. Over dual numbers
/// it is that of an edge which moves on, for second derivatives ([`Load::on_moved_edge`]).
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct EdgeMotion<T = f64> {
    /// Number of the edge, that of its first vertex.
    pub edge: usize,
    /// Time \[s\].
    pub time: f64,
    /// Places of its two vertices \[m\].
    pub places: [Vector3<T>; 2],
    /// Their velocities \[m/s\]; zero in an equilibrium.
    pub velocities: [Vector3<T>; 2],
    /// Directors m₁ and m₂ of its section, for a load with [`Load::uses_directors`]; else zero.
    pub directors: [Vector3<T>; 2],
    /// Rest length of the edge \[m\].
    pub rest_length: f64,
}

impl<T: Real> EdgeMotion<T> {
    /// Unit tangent of the edge, and its length \[m\].
    pub fn tangent(&self) -> (Vector3<T>, T) {
        let edge = self.places[1] - self.places[0];
        let length = length(&edge);
        (edge / length, length)
    }
}

impl EdgeMotion {
    /// The edge moved by ε times `by`: places, θ, velocities, one after the other. Directors turn with it.
    pub(crate) fn moved(&self, by: &[f64; 13]) -> EdgeMotion<Dual64> {
        let of = |i: usize| Vector3::new(by[i], by[i + 1], by[i + 2]);
        let (t, l) = self.tangent();
        let rate = (of(3) - of(0)) / l;
        let turned = rate - t * t.dot(&rate);
        let [m1, m2] = self.directors;
        let carried =
            |m: &Vector3<f64>, across: Vector3<f64>| dual(m, &(across * by[6] - t * m.dot(&turned)));
        EdgeMotion {
            edge: self.edge,
            time: self.time,
            places: [0, 1].map(|i| dual(&self.places[i], &of(3 * i))),
            velocities: [0, 1].map(|i| dual(&self.velocities[i], &of(7 + 3 * i))),
            directors: [carried(&m1, m2), carried(&m2, -m1)],
            rest_length: self.rest_length,
        }
    }
}

/// What a load does to an edge: forces on its two vertices (components 0 … 2 belong to the first, 3 … 5
/// to the second) and a moment about its tangent.
///
/// Where a vertex moves, the directors turn with the edge and not about it: δm₁ = −(m₁·δt) t for the
/// δt of the unit tangent. Derivatives in places are taken so; that in the angle θ turns them about t,
/// δm₁ = m₂ δθ.
#[derive(Debug, Clone, Copy)]
pub struct EdgeLoad<T = f64> {
    /// Potential energy W \[J\] of a load that has one, else zero.
    pub energy: T,
    /// Forces F \[N\].
    pub forces: Vector6<T>,
    /// ∂F/∂(places) \[N/m\].
    pub by_places: Matrix6<T>,
    /// ∂F/∂(velocities) \[N s/m\].
    pub by_velocities: Matrix6<T>,
    /// ∂F/∂θ \[N/rad\], of a load with [`Load::uses_directors`].
    pub by_angle: Vector6<T>,
    /// Moment m about the tangent \[N m\], of a load with [`Load::has_moment`]. It does the work m δθ, and
    /// must not depend on velocities.
    pub moment: T,
    /// ∂m/∂(places) \[N\].
    pub moment_by_places: Vector6<T>,
    /// ∂m/∂θ \[N m/rad\].
    pub moment_by_angle: T,
}

impl<T: Real> EdgeLoad<T> {
    /// No force, of any numbers.
    pub fn none() -> EdgeLoad<T> {
        EdgeLoad {
            energy: T::zero(),
            forces: Vector6::zeros(),
            by_places: Matrix6::zeros(),
            by_velocities: Matrix6::zeros(),
            by_angle: Vector6::zeros(),
            moment: T::zero(),
            moment_by_places: Vector6::zeros(),
            moment_by_angle: T::zero(),
        }
    }

    /// Adds a force \[N\] on the first (0) or second (1) vertex, with its derivative in the vector from the
    /// first to the second \[N/m\].
    pub fn add_force(&mut self, vertex: usize, force: Vector3<T>, by_edge: &Matrix3<T>) {
        let row = 3 * vertex;
        let mut forces = self.forces.fixed_rows_mut::<3>(row);
        forces += force;
        let mut first = self.by_places.fixed_view_mut::<3, 3>(row, 0);
        first -= by_edge;
        let mut second = self.by_places.fixed_view_mut::<3, 3>(row, 3);
        second += by_edge;
    }
}

impl EdgeLoad<Dual64> {
    /// The values of all its numbers, or what these change by.
    pub(crate) fn part(&self, of: fn(Dual64) -> f64) -> EdgeLoad {
        EdgeLoad {
            energy: of(self.energy),
            forces: self.forces.map(of),
            by_places: self.by_places.map(of),
            by_velocities: self.by_velocities.map(of),
            by_angle: self.by_angle.map(of),
            moment: of(self.moment),
            moment_by_places: self.moment_by_places.map(of),
            moment_by_angle: of(self.moment_by_angle),
        }
    }
}

impl EdgeLoad {
    /// No force.
    pub fn zero() -> EdgeLoad {
        EdgeLoad::none()
    }

    /// The same load times a factor.
    #[must_use]
    pub fn times(&self, factor: f64) -> EdgeLoad {
        EdgeLoad {
            energy: self.energy * factor,
            forces: self.forces * factor,
            by_places: self.by_places * factor,
            by_velocities: self.by_velocities * factor,
            by_angle: self.by_angle * factor,
            moment: self.moment * factor,
            moment_by_places: self.moment_by_places * factor,
            moment_by_angle: self.moment_by_angle * factor,
        }
    }

    /// ∂F/∂(places) as it enters the Jacobian of a rod. Directors that are carried round a small loop of
    /// tangents come back turned by its area, so that second derivatives of E along carried directors differ
    /// by ∂E/∂θ = m times that area with their order; half of it, m t×/2l² in the edge, is not in the
    /// symmetric Hessian of E.
    pub(crate) fn by_places_of_carried(&self, motion: &EdgeMotion) -> Matrix6<f64> {
        if self.moment == 0.0 {
            return self.by_places;
        }
        let (t, l) = motion.tangent();
        let skew = t.cross_matrix() * (0.5 * self.moment / (l * l));
        let mut by = self.by_places;
        for (row, column, sign) in [(0, 0, -1.0), (0, 3, 1.0), (3, 0, 1.0), (3, 3, -1.0)] {
            let mut block = by.fixed_view_mut::<3, 3>(row, column);
            block += skew * sign;
        }
        by
    }
}

/// A load on the edges of a rod that depends on their places, velocities or sections, with its exact
/// derivatives.
///
/// The Jacobian of a step stays a symmetric band, and Newton's method looks for a minimum, as long as every
/// load has a potential. One without makes it a general band, solved by LU, and Newton's method looks for a
/// root. [`check::load`](crate::check::load) tests derivatives and potential. Gravity and the point forces of
/// [`Loads`](crate::Loads) do not depend on the motion and need no such trait. A load that looks at directors
/// or turns a section makes the angles unknowns of a rod that could do without them.
///
/// [`Drag`](crate::Drag), [`FollowerForce`](crate::FollowerForce) and [`Moment`](crate::Moment) are loads
/// that are there.
///
/// # Examples
///
/// Linear drag, F = −c l̄/2 V at both vertices of every edge:
///
/// ```
/// use std::sync::Arc;
/// use nalgebra::{Matrix6, Vector6};
/// use varda_rod::{EdgeLoad, EdgeMotion, Load, Loads, Vector3};
///
/// /// Force per length and speed c [N s/m²].
/// struct Drag(f64);
///
/// impl Load for Drag {
///     fn has_potential(&self) -> bool {
///         false
///     }
///     fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
///         let c = 0.5 * self.0 * motion.rest_length;
///         let [a, b] = motion.velocities;
///         EdgeLoad {
///             forces: -c * Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z),
///             by_velocities: Matrix6::identity() * -c,
///             ..EdgeLoad::zero()
///         }
///     }
/// }
///
/// let loads = Loads {
///     gravity: Vector3::new(0.0, 0.0, -9.81),
///     of_motion: vec![Arc::new(Drag(0.2))],
///     ..Loads::default()
/// };
/// # assert_eq!(loads.of_motion.len(), 1);
/// ```
pub trait Load: Send + Sync {
    /// Whether F = −∂W/∂(places) with the energy W given, and F does not depend on velocities.
    fn has_potential(&self) -> bool;

    /// The edges that it acts on, of a rod with so many segments; all of them by default.
    fn edges(&self, segments: usize) -> Range<usize> {
        0..segments
    }

    /// Whether its forces depend on the directors m₁, m₂ of the edge.
    fn uses_directors(&self) -> bool {
        false
    }

    /// Whether it has a moment about the tangent of the edge.
    fn has_moment(&self) -> bool {
        false
    }

    /// Whether it can act on this rod; asked once.
    ///
    /// # Errors
    /// [`Error`] naming what is impossible.
    fn check(&self, _rod: &Rod) -> Result<(), Error> {
        Ok(())
    }

    /// Forces, moment and derivatives at one edge.
    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad;

    /// Whether `on_moved_edge` is given, for exact Hessians; false by default.
    fn has_second_derivatives(&self) -> bool {
        false
    }

    /// The same as `on_edge` at an edge that moves on, over dual numbers: how forces, moment and derivatives
    /// change is in their dual parts, those of the derivatives being second derivatives. Written over any
    /// [`Real`] number, one function does both. Called only where `has_second_derivatives` says so.
    fn on_moved_edge(&self, _motion: &EdgeMotion<Dual64>) -> EdgeLoad<Dual64> {
        EdgeLoad::none()
    }

    /// ∂²(μᵀF + μ_θ m)/∂c² at one edge: c its places, θ and velocities, μ by places and θ.
    ///
    /// By default the derivatives of `on_moved_edge` along each number of c, twelve or thirteen times the
    /// work of `on_edge`. A load that has a short closed form gives it here;
    /// [`check::load`](crate::check::load) compares the two.
    fn second_on_edge(&self, motion: &EdgeMotion, multipliers: &[f64; 7]) -> SMatrix<f64, 13, 13> {
        second_along_each(self, motion, multipliers)
    }
}

/// See [`Load::second_on_edge`].
pub(crate) fn second_along_each<L: Load + ?Sized>(
    load: &L,
    motion: &EdgeMotion,
    mu: &[f64; 7],
) -> SMatrix<f64, 13, 13> {
    let mut rows = SMatrix::<f64, 13, 13>::zeros();
    for k in 0..13 {
        let sees = match k {
            6 => load.uses_directors() || load.has_moment(),
            7.. => !load.has_potential(),
            _ => true,
        };
        if !sees {
            continue;
        }
        let mut by = [0.0; 13];
        by[k] = 1.0;
        let acts = load.on_moved_edge(&motion.moved(&by));
        for i in 0..6 {
            rows[(k, i)] += mu[6] * acts.moment_by_places[i].eps;
            rows[(k, 6)] += mu[i] * acts.by_angle[i].eps;
            for j in 0..6 {
                rows[(k, j)] += mu[i] * acts.by_places[(i, j)].eps;
                rows[(k, 7 + j)] += mu[i] * acts.by_velocities[(i, j)].eps;
            }
        }
        rows[(k, 6)] += mu[6] * acts.moment_by_angle.eps;
    }
    (rows + rows.transpose()) * 0.5
}
