//! Forces that turn with the section they act on.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::{Matrix3, Vector3};
use num_dual::Dual64;

use super::{EdgeLoad, EdgeMotion, Load};
use crate::rod::{Place, Rod};
use crate::scalar::Real;
use crate::support::Motion;
use crate::{Error, geometry::outer};

/// A force that turns with its edge: F = f₁ m₁ + f₂ m₂ + f₃ t \[N\], shared linearly by the two
/// vertices beside its point. At a vertex between two edges it follows the one before.
///
/// It has no potential: a load that follows does work round a closed path (Bolotin 1963).
///
/// ```
/// use std::sync::Arc;
/// use varda_rod::{FollowerForce, Loads, Material, Rod, Section};
///
/// let rod = Rod::uniform(1.0, 20, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01))?;
/// // A jet at the tip that pushes against the rod, and a puff across it at half its length.
/// let jet = FollowerForce::tangential(&rod, 1.0, |_| -0.3)?;
/// let puff = FollowerForce::new(&rod, 0.5, |t: f64| [0.1 * (-t).exp(), 0.0, 0.0])?;
/// let loads = Loads { of_motion: vec![Arc::new(jet), Arc::new(puff)], ..Loads::default() };
/// # assert_eq!(loads.of_motion.len(), 2);
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Clone)]
pub struct FollowerForce {
    place: Place,
    /// (f₁, f₂, f₃) \[N\].
    force: Arc<dyn Motion>,
    /// f₁ = f₂ = 0.
    tangential: bool,
}

impl FollowerForce {
    /// A force (f₁, f₂, f₃) \[N\] along (m₁, m₂, t) at arc length s \[m\].
    ///
    /// # Errors
    /// [`Error::OffRod`].
    pub fn new(rod: &Rod, s: f64, force: impl Motion + 'static) -> Result<FollowerForce, Error> {
        let place = rod.place("follower force", s)?;
        Ok(FollowerForce { place, force: Arc::new(force), tangential: false })
    }

    /// A force f₃ \[N\] along the tangent, compressive where it is negative at the tip: it looks at no
    /// director, and needs no angles.
    ///
    /// # Errors
    /// [`Error::OffRod`].
    pub fn tangential(
        rod: &Rod,
        s: f64,
        force: impl Fn(f64) -> f64 + Send + Sync + 'static,
    ) -> Result<FollowerForce, Error> {
        let along = move |t: f64| [0.0, 0.0, force(t)];
        Ok(FollowerForce { tangential: true, ..FollowerForce::new(rod, s, along)? })
    }
}

impl FollowerForce {
    fn acts<T: Real>(&self, motion: &EdgeMotion<T>) -> EdgeLoad<T> {
        let (t, l) = motion.tangent();
        let f = self.force.at(motion.time).map(T::of);
        let [m1, m2] = if self.tangential { [Vector3::zeros(); 2] } else { motion.directors };
        let across = m1 * f.x + m2 * f.y;
        // δm = −(m·δt) t with δt = (I − t tᵀ) δe/l
        let by_edge = ((Matrix3::identity() - outer(&t, &t)) * f.z - outer(&t, &across)) / l;
        let by_angle: Vector3<T> = m2 * f.x - m1 * f.y;
        let mut load = EdgeLoad::none();
        for (vertex, share) in [1.0 - self.place.fraction, self.place.fraction].into_iter().enumerate() {
            let share = T::of(share);
            load.add_force(vertex, (across + t * f.z) * share, &(by_edge * share));
            load.by_angle.fixed_rows_mut::<3>(3 * vertex).copy_from(&(by_angle * share));
        }
        load
    }
}

impl Load for FollowerForce {
    fn has_potential(&self) -> bool {
        false
    }

    fn edges(&self, _segments: usize) -> Range<usize> {
        self.place.edge..self.place.edge + 1
    }

    fn uses_directors(&self) -> bool {
        !self.tangential
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        self.acts(motion)
    }

    fn has_second_derivatives(&self) -> bool {
        true
    }

    fn on_moved_edge(&self, motion: &EdgeMotion<Dual64>) -> EdgeLoad<Dual64> {
        self.acts(motion)
    }
}
