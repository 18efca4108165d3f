//! Loads that depend on the motion of the rod.

pub(crate) mod drag;
pub(crate) mod follower;
pub(crate) mod moment;
pub(crate) mod scaled;

use std::ops::Range;

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use crate::{Error, Rod};

/// The motion of an edge, as a load finds it at the time at which a step takes its forces.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub struct EdgeMotion {
    /// Number of the edge, that of its first vertex.
    pub edge: usize,
    /// Time \[s\].
    pub time: f64,
    /// Places of its two vertices \[m\].
    pub places: [Vector3<f64>; 2],
    /// Their velocities \[m/s\]; zero in an equilibrium.
    pub velocities: [Vector3<f64>; 2],
    /// Directors m₁ and m₂ of its section, for a load with [`Load::uses_directors`]; else zero.
    pub directors: [Vector3<f64>; 2],
    /// Rest length of the edge \[m\].
    pub rest_length: f64,
}

impl EdgeMotion {
    /// Unit tangent of the edge, and its length \[m\].
    pub fn tangent(&self) -> (Vector3<f64>, f64) {
        let edge = self.places[1] - self.places[0];
        let length = edge.norm();
        (edge / length, length)
    }
}

/// What a load does to an edge: forces on its two vertices (components 0 … 2 belong to the first, 3 … 5
/// to the second) and a moment about its tangent.
///
/// Where a vertex moves, the directors turn with the edge and not about it: δm₁ = −(m₁·δt) t for the
/// δt of the unit tangent. Derivatives in places are taken so; that in the angle θ turns them about t,
/// δm₁ = m₂ δθ.
#[derive(Debug, Clone, Copy)]
pub struct EdgeLoad {
    /// Potential energy W \[J\] of a load that has one, else zero.
    pub energy: f64,
    /// Forces F \[N\].
    pub forces: Vector6<f64>,
    /// ∂F/∂(places) \[N/m\].
    pub by_places: Matrix6<f64>,
    /// ∂F/∂(velocities) \[N s/m\].
    pub by_velocities: Matrix6<f64>,
    /// ∂F/∂θ \[N/rad\], of a load with [`Load::uses_directors`].
    pub by_angle: Vector6<f64>,
    /// Moment m about the tangent \[N m\], of a load with [`Load::has_moment`]. It does the work m δθ, and
    /// must not depend on velocities.
    pub moment: f64,
    /// ∂m/∂(places) \[N\].
    pub moment_by_places: Vector6<f64>,
    /// ∂m/∂θ \[N m/rad\].
    pub moment_by_angle: f64,
}

impl EdgeLoad {
    /// No force.
    pub fn zero() -> EdgeLoad {
        EdgeLoad {
            energy: 0.0,
            forces: Vector6::zeros(),
            by_places: Matrix6::zeros(),
            by_velocities: Matrix6::zeros(),
            by_angle: Vector6::zeros(),
            moment: 0.0,
            moment_by_places: Vector6::zeros(),
            moment_by_angle: 0.0,
        }
    }

    /// Adds a force \[N\] on the first (0) or second (1) vertex, with its derivative in the vector from the
    /// first to the second \[N/m\].
    pub fn add_force(&mut self, vertex: usize, force: Vector3<f64>, by_edge: &Matrix3<f64>) {
        let row = 3 * vertex;
        let mut forces = self.forces.fixed_rows_mut::<3>(row);
        forces += force;
        let mut first = self.by_places.fixed_view_mut::<3, 3>(row, 0);
        first -= by_edge;
        let mut second = self.by_places.fixed_view_mut::<3, 3>(row, 3);
        second += by_edge;
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
}
