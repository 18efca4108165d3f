//! Curvature and rate of twist of a rod.

use nalgebra::Vector3;

use crate::Error;
use crate::dynamics::RodStep;
use crate::forces_of_motion::shape_of;
use crate::geometry::Turn;

/// How much a rod is bent and twisted at every interior vertex, per unit of length:
///
/// ```text
/// κ_i = |κb_i|/l̄_i = 2 tan(φ_i/2)/l̄_i,   φ_i the angle between the edges      (Bergou et al. 2008)
/// τ_i/l̄_i,   τ_i = θ^i − θ^{i−1} + reference twist
/// ```
///
/// These are the strains of the rod's energy; what is natural of them is not taken off.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Curvature {
    /// κ_i \[1/m\].
    pub curvature: Vec<f64>,
    /// τ_i/l̄_i \[rad/m\]; empty for a rod that does not twist.
    pub twist_rate: Vec<f64>,
}

impl RodStep {
    /// Curvature and rate of twist in a state at time t \[s\].
    ///
    /// ```
    /// use varda_rod::{Damping, Loads, Material, Rod, RodStep, Section, Supports, Vector3};
    ///
    /// // Vertices on a circle of radius 2 m, 0.1 rad apart: edges turn by 0.1 and are 2 R sin 0.05 long.
    /// let (radius, angle) = (2.0, 0.1_f64);
    /// let rod = Rod::uniform(10.0 * 2.0 * radius * (0.5 * angle).sin(), 10, &Section::circle(
    ///     &Material::new(1e6, 0.5, 1100.0),
    ///     0.01,
    /// ))?;
    /// let mut step = RodStep::new(rod, Supports::default(), Loads::default(), Damping::default())?;
    /// let at = |i: usize| Vector3::new((angle * i as f64).cos(), 0.0, (angle * i as f64).sin()) * radius;
    /// let mut state = vec![0.0; 6 * 11];
    /// (0..11).for_each(|i| state[3 * i..3 * i + 3].copy_from_slice(at(i).as_slice()));
    /// let bent = step.curvature(0.0, &state)?;
    /// assert_eq!((bent.curvature.len(), bent.twist_rate.len()), (9, 0));
    /// // 2 tan(φ/2)/(2 R sin(φ/2)) = 1/(R cos(φ/2))
    /// let expected = 1.0 / (radius * (0.5 * angle).cos());
    /// assert!(bent.curvature.iter().all(|k| (k / expected - 1.0).abs() < 1e-12));
    /// # Ok::<(), varda_rod::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error`] where a support's motion is not usable at t, or the rod is folded.
    ///
    /// # Panics
    /// If the state is shorter than the places, velocities and angles of the rod.
    pub fn curvature(&mut self, t: f64, state: &[f64]) -> Result<Curvature, Error> {
        let system = &mut self.system;
        shape_of(system, t, state)?;
        let (shape, lengths) = (&system.shape, &system.rod.voronoi_lengths);
        let bent = |(i, l): (usize, &f64)| -> Result<f64, Error> {
            let tangents: [Vector3<f64>; 2] = [shape.edges[i].t, shape.edges[i + 1].t];
            Ok(Turn::between(&tangents[0], &tangents[1], i + 1)?.kb.norm() / l)
        };
        let twisted = |(i, l): (usize, &f64)| shape.tau[i + 1] / l;
        Ok(Curvature {
            curvature: lengths.iter().enumerate().map(bent).collect::<Result<_, _>>()?,
            twist_rate: match system.layout.twist {
                true => lengths.iter().enumerate().map(twisted).collect(),
                false => Vec::new(),
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::{Clamp, ClampAt, Damping, Loads, Material, Rod, Section, Supports, straight_guess};

    /// A straight rod whose end is turned by a quarter of a turn: the same τ at every vertex between the
    /// edges that are held, and T = GJ τ/l̄.
    #[test]
    fn the_rate_of_twist_is_that_of_the_twisting_moment() {
        let (x, z, segments) = (Vector3::x(), Vector3::z(), 6);
        let rod =
            Rod::uniform(1.0, segments, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)).unwrap();
        let gj = rod.gj[0];
        let start = Clamp::new(ClampAt::Edge, [0.0; 3], x, z);
        let end = Clamp::new(ClampAt::Edge, [1.0, 0.0, 0.0], x, x.cross(&z));
        let supports = Supports { end: Some(end), ..Supports::clamped_start(start) };
        let make =
            || RodStep::new(rod.clone(), supports.clone(), Loads::default(), Damping::default()).unwrap();
        let guess = straight_guess(&rod, &supports, 0.0, x).unwrap();
        let mut step = make();
        let control = step.control_at_rest(&guess);
        let mut model = make().model(0, 0.01);
        let mut state = vec![0.0; model.dim()];
        model.initial_state(&control, &mut state).unwrap();

        let found = step.curvature(0.01, &state).unwrap();
        let expected = 0.5 * PI / (segments - 1) as f64 * segments as f64;
        assert!(found.twist_rate.iter().all(|rate| (rate / expected - 1.0).abs() < 1e-12), "{found:?}");
        assert!(found.curvature.iter().all(|k| *k < 1e-12), "{found:?}");
        let forces = step.internal_forces(0.01, &state, (0.0, &state)).unwrap();
        for (rate, moment) in found.twist_rate.iter().zip(&forces.twisting) {
            assert!((moment / (gj * rate) - 1.0).abs() < 1e-12, "{moment} and {rate}");
        }
    }

    #[test]
    fn a_fold_is_an_error() {
        let section = Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01);
        let rod = Rod::uniform(1.0, 2, &section).unwrap();
        let supports = Supports::default();
        let mut step = RodStep::new(rod, supports, Loads::default(), Damping::default()).unwrap();
        let mut state = vec![0.0; 18];
        state[3] = 0.5;
        assert!(step.curvature(0.0, &state).is_err(), "the second edge lies on the first");
    }
}
