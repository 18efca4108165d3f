//! Moments on the rod: fixed in space, or about its tangent.

use std::ops::Range;
use std::sync::Arc;

use nalgebra::Vector3;
use num_dual::Dual64;

use super::{EdgeLoad, EdgeMotion, Load};
use crate::Error;
use crate::geometry::outer;
use crate::rod::Rod;
use crate::scalar::Real;
use crate::support::Motion;

/// An external moment T_ext \[N m\] (paper, section 3): it does the work M·δφ on the rotation
/// δφ = t × δt + δθ t of an edge,
///
/// ```text
/// F₂ = −F₁ = M × t / l        (the part that bends, on the two vertices)
/// m  = M·t                    (the part that twists, on θ)
/// ```
///
/// Edges turn at their middles: a moment between two middles is shared linearly by the two edges, one beyond
/// the first or last middle acts on the first or last edge. A moment has no potential unless its edge keeps
/// its direction (Bolotin 1963); its Jacobian is exact.
///
/// ```
/// use std::sync::Arc;
/// use varda_rod::{Loads, Material, Moment, Rod, Section};
///
/// let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01);
/// let rod = Rod::uniform(1.0, 20, &section)?;
/// // The tip bent about y by a growing moment, and twisted about itself.
/// let bend = Moment::new(&rod, 1.0, |t: f64| [0.0, 0.02 * t, 0.0])?;
/// let twist = Moment::about_tangent(&rod, 1.0, |_| 0.001)?;
/// let loads = Loads { of_motion: vec![Arc::new(bend), Arc::new(twist)], ..Loads::default() };
/// # assert_eq!(loads.of_motion.len(), 2);
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Clone)]
pub struct Moment {
    /// The first edge it acts on.
    first: usize,
    /// Shares of the edges from there on.
    shares: [f64; 2],
    /// M \[N m\]; its z component about the tangent where `along`.
    moment: Arc<dyn Motion>,
    along: bool,
}

impl Moment {
    /// A moment vector \[N m\] that keeps its direction in space, at arc length s \[m\].
    ///
    /// # Errors
    /// [`Error::OffRod`].
    pub fn new(rod: &Rod, s: f64, moment: impl Motion + 'static) -> Result<Moment, Error> {
        rod.place("moment", s)?;
        let middles: Vec<f64> = rod.arc_lengths().windows(2).map(|s| 0.5 * (s[0] + s[1])).collect();
        let first = middles.partition_point(|middle| *middle <= s).saturating_sub(1);
        let share = middles
            .get(first + 1)
            .map_or(0.0, |next| ((s - middles[first]) / (next - middles[first])).clamp(0.0, 1.0));
        Ok(Moment { first, shares: [1.0 - share, share], moment: Arc::new(moment), along: false })
    }

    /// A moment \[N m\] about the tangent, whichever way that points, at arc length s \[m\].
    ///
    /// # Errors
    /// [`Error::OffRod`].
    pub fn about_tangent(
        rod: &Rod,
        s: f64,
        moment: impl Fn(f64) -> f64 + Send + Sync + 'static,
    ) -> Result<Moment, Error> {
        let along = move |t: f64| [0.0, 0.0, moment(t)];
        Ok(Moment { along: true, ..Moment::new(rod, s, along)? })
    }
}

impl Moment {
    fn acts<T: Real>(&self, motion: &EdgeMotion<T>) -> EdgeLoad<T> {
        let m = (self.moment.at(motion.time) * self.shares[motion.edge - self.first]).map(T::of);
        let mut load = EdgeLoad::none();
        if self.along {
            load.moment = m.z;
            return load;
        }
        let (t, l) = motion.tangent();
        let force = m.cross(&t) / l;
        let by_edge = (m.cross_matrix() - outer(&m.cross(&t), &t) * T::of(2.0)) / (l * l);
        load.add_force(0, -force, &-by_edge);
        load.add_force(1, force, &by_edge);
        load.moment = m.dot(&t);
        let by_edge: Vector3<T> = (m - t * load.moment) / l;
        load.moment_by_places.fixed_rows_mut::<3>(0).copy_from(&-by_edge);
        load.moment_by_places.fixed_rows_mut::<3>(3).copy_from(&by_edge);
        load
    }
}

impl Load for Moment {
    fn has_potential(&self) -> bool {
        false
    }

    fn edges(&self, _segments: usize) -> Range<usize> {
        self.first..self.first + if self.shares[1] == 0.0 { 1 } else { 2 }
    }

    fn has_moment(&self) -> bool {
        true
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
