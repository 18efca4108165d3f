//! Loads that depend on the motion of the rod.

use std::ops::Range;

use nalgebra::{Matrix6, Vector3, Vector6};

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
    /// Rest length of the edge \[m\].
    pub rest_length: f64,
}

/// What a load does to the two vertices of an edge: components 0 … 2 belong to the first, 3 … 5 to the
/// second.
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
}

impl EdgeLoad {
    /// No force.
    pub fn zero() -> EdgeLoad {
        EdgeLoad {
            energy: 0.0,
            forces: Vector6::zeros(),
            by_places: Matrix6::zeros(),
            by_velocities: Matrix6::zeros(),
        }
    }
}

/// A load on the edges of a rod that depends on their places and velocities, with its exact derivatives.
///
/// The Jacobian of a step stays a symmetric band, and Newton's method looks for a minimum, as long as every
/// load has a potential. One without makes it a general band, solved by LU, and Newton's method looks for a
/// root. [`check::load`](crate::check::load) tests derivatives and potential. Gravity and the point forces of
/// [`Loads`](crate::Loads) do not depend on the motion and need no such trait.
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

    /// Forces and derivatives at one edge.
    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad;
}
