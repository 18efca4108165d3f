//! Drag of the fluid around a rod.

use nalgebra::{Matrix3, SMatrix, Vector3};
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

    /// Second derivatives of μ·f by u and t, both free, and its first derivative by t: with a = u·t, w = u − a t,
    ///
    /// ```text
    /// μ·f = φ(w) + p(a, t·μ),   φ = ½ρd C_n |w| w·μ,   p = ½ρd C_t |a| a t·μ
    /// δw = (I − t tᵀ) δu − (t uᵀ + a I) δt,   δ²w = −δa δt' − δa' δt − t δ²a,   δ²a = δu·δt' + δu'·δt
    /// ```
    fn second_per_length(&self, v: &Vector3<f64>, t: &Vector3<f64>, mu: &Vector3<f64>) -> Second {
        let pressure = 0.5 * self.fluid_density * self.diameter;
        let (kn, kt) = (pressure * self.normal, pressure * self.tangential);
        let u = self.flow - v;
        let a = u.dot(t);
        let w = u - t * a;
        let speed = w.norm();
        // at w = 0 the force is differentiable once, as |a| a is at a = 0
        let direction = if speed > 0.0 { w / speed } else { w };
        let along = direction.dot(mu);
        let both = mu * direction.transpose();
        let identity = Matrix3::identity();
        let curved = (both + both.transpose() + (identity - outer(&direction, &direction)) * along) * kn;
        let slope = (mu * speed + direction * w.dot(mu)) * kn;
        let [by_a, by_a_twice, by_a_and_b] =
            [2.0 * a.abs() * t.dot(mu), 2.0 * a.signum() * t.dot(mu), 2.0 * a.abs()].map(|p| kt * p);

        let plane = identity - outer(t, t);
        let tilt = -(outer(t, &u) + identity * a);
        let of_a = by_a - slope.dot(t);
        let mixed = |x: &Vector3<f64>, y: &Vector3<f64>| outer(x, y) + outer(y, x);
        Second {
            speeds: plane * curved * plane + outer(t, t) * by_a_twice,
            both: plane * curved * tilt - outer(t, &slope)
                + outer(t, &u) * by_a_twice
                + outer(t, mu) * by_a_and_b
                + identity * of_a,
            tangents: tilt.transpose() * curved * tilt - mixed(&u, &slope)
                + outer(&u, &u) * by_a_twice
                + mixed(&u, mu) * by_a_and_b,
            by_tangent: tilt.transpose() * slope + u * by_a + mu * (kt * a.abs() * a),
        }
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

/// Second derivatives of μ·f by u and t, and ∂(μ·f)/∂t.
struct Second {
    speeds: Matrix3<f64>,
    /// Rows by u, columns by t.
    both: Matrix3<f64>,
    tangents: Matrix3<f64>,
    by_tangent: Vector3<f64>,
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

    fn second_on_edge(&self, motion: &EdgeMotion, multipliers: &[f64; 7]) -> SMatrix<f64, 13, 13> {
        let (t, l) = motion.tangent();
        let half = 0.5 * motion.rest_length;
        let plane = Matrix3::identity() - outer(&t, &t);
        let mut by_edge = Matrix3::zeros();
        let mut all = SMatrix::<f64, 13, 13>::zeros();
        for (vertex, v) in motion.velocities.iter().enumerate() {
            let mu = Vector3::from_column_slice(&multipliers[3 * vertex..3 * vertex + 3]) * half;
            let of = self.second_per_length(v, &t, &mu);
            // δt = P δe/l, δ²t = −((t·δe) P δe' + (t·δe') P δe + (δe·P δe') t)/l²
            let across = plane * of.by_tangent;
            let turned = outer(&t, &across) + outer(&across, &t) + plane * of.by_tangent.dot(&t);
            by_edge += (plane * of.tangents * plane - turned) / (l * l);
            // u = flow − v
            let speed_and_edge = -of.both * plane / l;
            let row = 7 + 3 * vertex;
            all.fixed_view_mut::<3, 3>(row, row).copy_from(&of.speeds);
            for (end, sign) in [(0, -1.0), (3, 1.0)] {
                all.fixed_view_mut::<3, 3>(row, end).copy_from(&(speed_and_edge * sign));
                all.fixed_view_mut::<3, 3>(end, row).copy_from(&(speed_and_edge.transpose() * sign));
            }
        }
        for (a, b, sign) in [(0, 0, 1.0), (0, 3, -1.0), (3, 0, -1.0), (3, 3, 1.0)] {
            all.fixed_view_mut::<3, 3>(a, b).copy_from(&(by_edge * sign));
        }
        all
    }
}
