//! Static equilibrium of the whole rod, and of the twist alone, by the same Newton's method.

use nalgebra::Vector3;
use varda_implicit::{
    Equations, Interval, NewtonOptions, NewtonReport, NewtonWork, Refusal, Structure, solve,
};

use crate::Error;
use crate::layout::FIXED;
use crate::rod::Rod;
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
/// It is a local minimum of the total potential energy: Newton steps go downhill, past saddles. `guess` gives all vertices
/// (prescribed ones are overwritten) and angles; a straight rod hanging from its clamp is [`straight_guess`].
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
    assert_eq!(guess.vertices.len(), rod.segments() + 1, "one place for every vertex");
    assert_eq!(guess.theta.len(), rod.segments(), "one angle for every edge");
    let refuse = |e: Error| varda_implicit::Error::Refused { step: 0, reason: e.into() };
    let mut system = System::new(rod.clone(), supports.clone(), loads.clone(), &Damping::default(), false)
        .map_err(refuse)?;
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
    // a stiff column far beyond its buckling load folds and unfolds its way from the straight saddle to the first mode
    let options = NewtonOptions { max_iterations: 2000, ..NewtonOptions::default() };
    let report =
        solve(&mut statics, &mut u, &mut work, &options).map_err(|failure| failure.in_step(&at_rest(t)))?;
    let mut system = statics.system;
    system.scatter(&u);
    system.update_shape(system.layout.twist, end_angle).map_err(refuse)?;
    Ok((Rest { vertices: system.x, theta: system.theta }, report))
}

/// An edge of a chain at its rest length has no stiffness across itself, which leaves zero rows in the Hessian: where there is
/// one, the free vertices move away from the first held one by a thousandth.
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

/// The straight, unstretched rod that leaves the start clamp (or, without one, the first prescribed vertex or the end
/// clamp) at time t along the clamp's tangent, or along `direction` where there is no start clamp.
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

/// The moment t, for errors of an equilibrium at that time.
fn at_rest(t: f64) -> Interval {
    Interval { index: 0, start: t, length: 0.0, previous: None }
}

/// The total potential energy of a system as a function of its unknowns.
struct Statics {
    system: System,
    end_angle: f64,
    tolerance: f64,
    displacement: Vec<Vector3<f64>>,
    psi: Vec<f64>,
}

impl Statics {
    fn new(system: System, end_angle: f64, tolerance: f64) -> Statics {
        let n = system.rod.segments();
        Statics {
            end_angle,
            tolerance,
            displacement: vec![Vector3::zeros(); n + 1],
            psi: vec![0.0; n],
            system,
        }
    }

    fn work_space(&self) -> NewtonWork {
        let layout = &self.system.layout;
        NewtonWork::new(layout.unknowns, &Structure::SymmetricBand { half_bandwidth: layout.half_bandwidth })
    }
}

impl Equations for Statics {
    fn assemble(
        &mut self,
        u: &[f64],
        g: &mut [f64],
        mut jacobian: Option<&mut [f64]>,
    ) -> Result<Option<f64>, Refusal> {
        let s = &mut self.system;
        s.scatter(u);
        let twist = s.layout.twist;
        s.update_shape(twist, self.end_angle)?;
        if let Some(values) = jacobian.as_deref_mut() {
            values.fill(0.0);
        }
        let mut potential = s.elastic(jacobian);
        for (full, &unknown) in s.layout.unknown.iter().enumerate() {
            if unknown != FIXED {
                g[unknown] = s.gradient[full];
            }
        }
        for &v in &s.layout.free_vertices {
            potential -= s.forces[v].dot(&s.x[v]);
            let i = s.layout.unknown[s.layout.vertex(v)];
            for c in 0..3 {
                g[i + c] -= s.forces[v][c];
            }
        }
        Ok(Some(potential))
    }

    fn retract(&mut self, u: &[f64], du: &[f64], alpha: f64, trial: &mut [f64]) {
        for ((t, u), d) in trial.iter_mut().zip(u).zip(du) {
            *t = u + alpha * d;
        }
        let s = &mut self.system;
        if s.layout.free_angles.is_empty() || s.layout.free_vertices.is_empty() {
            return;
        }
        s.scatter(u);
        s.shape.set_edges(&s.x, true).expect("u was assembled before");
        s.add_holonomy(du, alpha, &mut self.displacement, &mut self.psi, trial);
    }

    fn converged_below(&self) -> f64 {
        self.tolerance
    }
}

/// θ₀ = θ(X₀): the angles that minimise E at given vertices, from θ = 0, with δθ₀ = −E_θθ⁻¹ E_θX δX₀ and its transpose.
pub(crate) struct TwistEquilibrium {
    statics: Statics,
    work: NewtonWork,
    /// The system with all its unknowns, for E_θX.
    full: System,
    /// The Hessian of the full system in its band, and the tridiagonal E_θθ: diagonal, below it.
    band: Vec<f64>,
    diagonal: Vec<f64>,
    below: Vec<f64>,
    u: Vec<f64>,
    rhs: Vec<f64>,
    psi: Vec<f64>,
    displacement: Vec<Vector3<f64>>,
}

impl TwistEquilibrium {
    pub(crate) fn new(system: &System) -> TwistEquilibrium {
        let mut held = system.clone();
        held.layout = system.layout.angles_only();
        let n = system.rod.segments();
        let angles = system.layout.free_angles.len();
        let statics = Statics::new(held, 0.0, 1e-12);
        TwistEquilibrium {
            work: statics.work_space(),
            statics,
            band: vec![0.0; system.layout.unknowns * (system.layout.half_bandwidth + 1)],
            diagonal: vec![0.0; angles],
            below: vec![0.0; angles],
            u: vec![0.0; angles],
            rhs: vec![0.0; angles],
            psi: vec![0.0; n],
            displacement: vec![Vector3::zeros(); n + 1],
            full: system.clone(),
        }
    }

    /// θ of the free angles for the free vertices X at time t.
    pub(crate) fn solve(&mut self, t: f64, positions: &[f64], theta: &mut [f64]) -> Result<(), Refusal> {
        let s = &mut self.statics.system;
        s.place(t)?;
        for (f, &v) in self.full.layout.free_vertices.iter().enumerate() {
            s.x[v] = Vector3::from_column_slice(&positions[3 * f..3 * f + 3]);
        }
        s.theta.fill(0.0);
        let end_angle = s.end_angle_guess();
        self.statics.end_angle = end_angle;
        self.u.fill(0.0);
        let options = NewtonOptions { max_iterations: 200, ..NewtonOptions::default() };
        solve(&mut self.statics, &mut self.u, &mut self.work, &options)
            .map_err(|failure| failure.in_step(&at_rest(t)))?;
        theta.copy_from_slice(&self.u);

        self.full.place(t)?;
        self.full.x.copy_from_slice(&self.statics.system.x);
        for (f, &e) in self.full.layout.free_angles.iter().enumerate() {
            self.full.theta[e] = self.u[f];
        }
        self.full.update_shape(true, end_angle)?;
        self.band.fill(0.0);
        self.full.elastic(Some(&mut self.band));
        self.factor()
    }

    /// E_θθ = L D Lᵀ of the free angles, from the band of the full system.
    fn factor(&mut self) -> Result<(), Refusal> {
        let layout = &self.full.layout;
        for f in 0..layout.free_angles.len() {
            let e = layout.free_angles[f];
            let mut d = self.entry(layout.angle(e), layout.angle(e));
            let before = f > 0 && layout.free_angles[f - 1] + 1 == e;
            self.below[f] = 0.0;
            if before {
                self.below[f] = self.entry(layout.angle(e), layout.angle(e - 1)) / self.diagonal[f - 1];
                d -= self.below[f] * self.below[f] * self.diagonal[f - 1];
            }
            if !(d > 0.0) {
                return Err(Error::TwistFold { edge: e, pivot: d }.into());
            }
            self.diagonal[f] = d;
        }
        Ok(())
    }

    fn entry(&self, row: usize, column: usize) -> f64 {
        let layout = &self.full.layout;
        let (i, j) = (layout.unknown[row], layout.unknown[column]);
        let (i, j) = (i.max(j), i.min(j));
        let w = layout.half_bandwidth;
        if i == FIXED || i - j > w { 0.0 } else { self.band[i * (w + 1) + w + j - i] }
    }

    fn solve_angles(&mut self) {
        let m = self.rhs.len();
        for f in 1..m {
            self.rhs[f] -= self.below[f] * self.rhs[f - 1];
        }
        for f in 0..m {
            self.rhs[f] /= self.diagonal[f];
        }
        for f in (1..m).rev() {
            self.rhs[f - 1] -= self.below[f] * self.rhs[f];
        }
    }

    /// Vertices whose places enter ∂E/∂θ^e: those of the two turns at its ends.
    fn neighbours(&self, e: usize) -> std::ops::RangeInclusive<usize> {
        e.saturating_sub(1)..=(e + 2).min(self.full.layout.segments)
    }

    pub(crate) fn tangent(&mut self, dx: &[f64], dtheta: &mut [f64]) {
        let mut displacement = std::mem::take(&mut self.displacement);
        self.full.displacements(dx, &mut displacement);
        for f in 0..self.rhs.len() {
            let e = self.full.layout.free_angles[f];
            let mut sum = 0.0;
            for v in self.neighbours(e) {
                for c in 0..3 {
                    sum -= self.entry(self.full.layout.angle(e), self.full.layout.vertex(v) + c)
                        * displacement[v][c];
                }
            }
            self.rhs[f] = sum;
        }
        self.solve_angles();
        self.full.shape.holonomy(&displacement, &mut self.psi);
        for (f, &e) in self.full.layout.free_angles.iter().enumerate() {
            dtheta[f] = self.rhs[f] + self.psi[e];
        }
        self.displacement = displacement;
    }

    pub(crate) fn adjoint_add(&mut self, lambda: &[f64], dx: &mut [f64]) {
        if lambda.iter().all(|l| *l == 0.0) {
            return;
        }
        self.rhs.copy_from_slice(lambda);
        self.solve_angles();
        let mut displacement = std::mem::take(&mut self.displacement);
        displacement.fill(Vector3::zeros());
        self.psi.fill(0.0);
        for (f, &e) in self.full.layout.free_angles.iter().enumerate() {
            self.psi[e] = lambda[f];
            for v in self.neighbours(e) {
                for c in 0..3 {
                    displacement[v][c] -=
                        self.entry(self.full.layout.angle(e), self.full.layout.vertex(v) + c) * self.rhs[f];
                }
            }
        }
        self.full.shape.holonomy_transpose_add(&self.psi, &mut displacement);
        for (f, &v) in self.full.layout.free_vertices.iter().enumerate() {
            for c in 0..3 {
                dx[3 * f + c] += displacement[v][c];
            }
        }
        self.displacement = displacement;
    }
}
