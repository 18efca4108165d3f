//! Drag of the fluid around a rod.

use nalgebra::{Matrix3, Vector3};
use num_dual::Dual64;

use super::{EdgeLoad, EdgeMotion, Load};
use crate::geometry::outer;
use crate::material::not_negative;
use crate::scalar::{Real, square};
use crate::{Error, Rod};

/// Drag of a fluid, quadratic in the speed of the fluid past the rod, u = flow − V, across and along it
/// (Morison's equation without its inertia; Hoerner 1965): a force per length \[N/m\]
///
/// ```text
/// f = ½ ρ d (C_n |u_n| u_n + C_t |u_t| u_t),   u_t = (u·t) t,   u_n = u − u_t
/// ```
///
/// taken at both vertices of every edge over half its rest length. It is once differentiable where u
/// vanishes, and it does no work on a rod in a fluid at rest but to slow it. What the fluid carries
/// (buoyancy) and what moves with the rod (added mass) are not in it.
///
/// ```
/// use std::sync::Arc;
/// use varda_rod::{Drag, Loads, Vector3};
///
/// // A tether of 8 mm in water that flows along x at 0.4 m/s.
/// let drag = Drag { flow: Vector3::new(0.4, 0.0, 0.0), ..Drag::of(1000.0, 0.008) };
/// let loads = Loads { of_motion: vec![Arc::new(drag)], ..Loads::default() };
/// # assert_eq!(loads.of_motion.len(), 1);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drag {
    /// Density ρ of the fluid \[kg/m³\].
    pub fluid_density: f64,
    /// Diameter d across the flow \[m\].
    pub diameter: f64,
    /// Coefficient C_n across the rod \[–\].
    pub normal: f64,
    /// Coefficient C_t along it \[–\].
    pub tangential: f64,
    /// Velocity of the fluid \[m/s\].
    pub flow: Vector3<f64>,
}

impl Drag {
    /// In a fluid at rest, with the coefficients of a smooth cylinder below the drag crisis: C_n = 1.2,
    /// C_t = 0.01.
    pub fn of(fluid_density: f64, diameter: f64) -> Drag {
        Drag { fluid_density, diameter, normal: 1.2, tangential: 0.01, flow: Vector3::zeros() }
    }

    /// Force per length on a point of velocity v \[m/s\] where the rod has the unit tangent t; its
    /// derivatives in v and, for δt ⟂ t, in t.
    fn per_length<T: Real>(&self, v: &Vector3<T>, t: &Vector3<T>) -> (Vector3<T>, [Matrix3<T>; 2]) {
        let pressure = 0.5 * self.fluid_density * self.diameter;
        let (kn, kt) = (T::of(pressure * self.normal), T::of(pressure * self.tangential));
        let u = self.flow.map(T::of) - v;
        let along = u.dot(t);
        let across = u - t * along;
        // |u_n| + u_n u_nᵀ/|u_n|, zero where u_n is
        let moves = square(&across) > T::zero();
        let speed = if moves { square(&across).sqrt() } else { T::zero() };
        let direction = if moves { across / speed } else { across };
        let stretch = outer(&direction, &across);
        let tt = outer(t, t);
        let plane = Matrix3::identity() - tt;
        let by_speed = -((plane * speed + stretch) * kn + tt * (T::of(2.0) * kt * along.abs()));
        let by_tangent = outer(t, &across) * (T::of(2.0) * kt * along.abs() - kn * speed)
            + Matrix3::identity() * (kt * along.abs() * along - kn * along * speed)
            - stretch * (kn * along);
        (across * (kn * speed) + t * (kt * along.abs() * along), [by_speed, by_tangent])
    }

    fn acts<T: Real>(&self, motion: &EdgeMotion<T>) -> EdgeLoad<T> {
        let (t, l) = motion.tangent();
        let half = T::of(0.5 * motion.rest_length);
        let turn = (Matrix3::identity() - outer(&t, &t)) / l;
        let mut load = EdgeLoad::none();
        for (vertex, v) in motion.velocities.iter().enumerate() {
            let (force, [by_speed, by_tangent]) = self.per_length(v, &t);
            load.add_force(vertex, force * half, &(by_tangent * turn * half));
            let row = 3 * vertex;
            load.by_velocities.fixed_view_mut::<3, 3>(row, row).copy_from(&(by_speed * half));
        }
        load
    }
}

impl Load for Drag {
    fn has_potential(&self) -> bool {
        false
    }

    fn check(&self, _rod: &Rod) -> Result<(), Error> {
        not_negative("drag.fluid_density", self.fluid_density)?;
        not_negative("drag.diameter", self.diameter)?;
        not_negative("drag.normal", self.normal)?;
        not_negative("drag.tangential", self.tangential)?;
        match self.flow.iter().find(|v| !v.is_finite()) {
            Some(&value) => Err(Error::Value { field: "drag.flow", value, expected: "a finite number" }),
            None => Ok(()),
        }
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
