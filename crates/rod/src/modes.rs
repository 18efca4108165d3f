//! Natural modes of a rod about its shape at rest.

use nalgebra::{DMatrix, SymmetricEigen, Vector3};
use varda_implicit::Equations;
use varda_linalg::{BadPivot, Factor, LinearSolver, Structure, axpy};

use crate::Error;
use crate::equilibrium::Rest;
use crate::layout::mirror;
use crate::rod::Rod;
use crate::statics::Statics;
use crate::support::{Damping, Loads, Supports};
use crate::system::System;

/// The shift s, as a share of the greatest k_ii/m_i: a few times its rounding. A mode without stiffness
/// keeps a finite inverse, and a zero with its rounding is not counted as a negative ω².
const SHIFT: f64 = 1e-15;
/// A mode has converged when K⁻¹M leaves it, to this share of its length: ω² is then exact to its
/// square.
const CONVERGED: f64 = 1e-6;
/// After so many products what is left is the rounding of K⁻¹, and this much of it is bearable.
const SETTLED: (usize, f64) = (60, 1e-3);
/// Most products with K⁻¹M for each vector.
const MOST: usize = 500;

/// A natural mode: the rod moves as x + a φ cos(ωt) about its shape at rest, a small.
///
/// ```
/// use varda_rod::Mode;
///
/// let mode = Mode { omega_squared: 39.478, displacements: Vec::new(), turns: Vec::new() };
/// assert!((mode.frequency().unwrap() - 1.0).abs() < 1e-4); // Hz
/// let grows = Mode { omega_squared: -1.0, ..mode };
/// assert_eq!(grows.frequency(), None);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Mode {
    /// ω² [1/s²]; negative where the shape is not stable, and the mode grows as exp(√(−ω²) t); zero
    /// where it is less than [`Modes::resolution`], as that of a rod which moves freely.
    pub omega_squared: f64,
    /// φ of all vertices [kg^(−1/2)], zero where one is held: Σ m |φ|² = 1, with Σ I φ² of the turns
    /// where sections have inertia.
    pub displacements: Vec<Vector3<f64>>,
    /// Turn of the section of every edge about its tangent [rad m⁻¹ kg^(−1/2)], beside the turn that the
    /// bending of the rod carries it through; zero where twist is left out.
    pub turns: Vec<f64>,
}

impl Mode {
    /// f = ω/2π \[Hz\]; `None` for a mode that grows.
    pub fn frequency(&self) -> Option<f64> {
        (self.omega_squared >= 0.0).then(|| self.omega_squared.sqrt() / std::f64::consts::TAU)
    }
}

/// The lowest modes of a rod, and how many are not stable.
///
/// ```
/// use std::sync::Arc;
/// use varda_rod::{Loads, Material, Rest, Rod, Section, Supports, Vector3, modes};
///
/// // A straight column pressed together by 1 per cent has buckled, in two directions and more than once.
/// let rod = Rod::uniform(1.0, 20, &Section::circle(&Material::new(1e7, 0.5, 1100.0), 0.005))?;
/// let mut supports = Supports::default();
/// supports.prescribed.push((0, Arc::new([0.0; 3])));
/// supports.prescribed.push((20, Arc::new([0.99, 0.0, 0.0])));
/// let vertices = (0..=20).map(|i| Vector3::x() * (0.0495 * f64::from(i))).collect();
/// let straight = Rest { vertices, theta: vec![0.0; 20] };
/// let found = modes(&rod, &supports, &Loads::default(), 0.0, &straight, 4)?;
/// assert!(found.unstable >= 2);
/// # Ok::<(), varda_rod::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Modes {
    /// The modes nearest to ω² = 0, ascending in ω².
    pub modes: Vec<Mode>,
    /// Number of negative ω²: zero at a minimum of the potential energy, more at a saddle.
    pub unstable: usize,
    /// The least |ω²| [1/s²] that is told from zero: 1e-15 of the greatest k_ii/m_i, which stretching
    /// makes large; more where K is singular to rounding even so.
    pub resolution: f64,
}

/// The lowest `count` natural modes of an undamped rod about a shape at rest, supports where they are at time
/// t:
///
/// ```text
/// K φ = ω² M φ,   K = ∂²(E − F·X)/∂u² at rest,   M = diag(m, I) of the vertices and angles
/// ```
///
/// Without twist inertia angles have no mass: they follow in equilibrium. Forces are those of `loads`; the
/// shape is one that [`rest`](crate::rest) or [`equilibrium`](crate::equilibrium()) found for them. By
/// simultaneous iteration with (K + sM)⁻¹M (Bathe and Wilson 1973), O(n) a product, s a small shift that
/// is taken off again.
///
/// ```
/// use varda_rod::{Clamp, ClampAt, Loads, Material, Rod, Section, Supports, Vector3, modes, straight_guess};
///
/// // A cantilever without weight: ω = 3.516 √(EI/ρA)/L², in either plane.
/// let section = Section::circle(&Material::new(1e7, 0.5, 1100.0), 0.005);
/// let rod = Rod::uniform(0.5, 100, &section)?;
/// let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], Vector3::x(), Vector3::z()));
/// let straight = straight_guess(&rod, &supports, 0.0, Vector3::x())?;
/// let found = modes(&rod, &supports, &Loads::default(), 0.0, &straight, 2)?;
/// let omega = 3.516 * (section.ei1 / section.mass_per_length).sqrt() / 0.25;
/// for mode in &found.modes {
///     assert!((mode.omega_squared.sqrt() / omega - 1.0).abs() < 0.02);
/// }
/// assert_eq!(found.unstable, 0);
/// # Ok::<(), varda_rod::Error>(())
/// ```
///
/// # Errors
/// [`Error::NoPotential`] where a load has no potential, [`Error::Modes`] where they do not converge,
/// [`Error`] where the rod, a support or the shape is not usable.
///
/// # Panics
/// If the shape has the wrong number of vertices or angles.
pub fn modes(
    rod: &Rod,
    supports: &Supports,
    loads: &Loads,
    t: f64,
    rest: &Rest,
    count: usize,
) -> Result<Modes, Error> {
    assert_eq!(rest.vertices.len(), rod.segments() + 1, "one place for every vertex");
    assert_eq!(rest.theta.len(), rod.segments(), "one angle for every edge");
    let mut system = System::new(rod.clone(), supports.clone(), loads.clone(), &Damping::default(), false)?;
    if !system.has_potential() {
        return Err(Error::NoPotential);
    }
    system.x.copy_from_slice(&rest.vertices);
    system.theta.copy_from_slice(&rest.theta);
    system.place(t)?;
    let end_angle = rest.theta.last().copied().unwrap_or(0.0);
    // K + sM may be singular, and a mode whose zero, with its rounding, is at −s would drown all others:
    // then another s helps
    let mut share = SHIFT;
    let (pencil, (values, vectors)) = loop {
        let found = Pencil::new(system.clone(), end_angle, share, count)
            .and_then(|mut pencil| pencil.lowest(count).map(|lowest| (pencil, lowest)));
        match found {
            Ok(found) => break found,
            Err(Error::Modes { .. }) if share < 1000.0 * SHIFT => share *= 10.0,
            Err(error) => return Err(error),
        }
    };
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let modes = order.into_iter().map(|i| pencil.mode(values[i], &vectors[i])).collect();
    Ok(Modes { modes, unstable: pencil.unstable, resolution: pencil.shift })
}

/// K + sM factored, and M.
struct Pencil {
    system: System,
    solver: LinearSolver,
    factor: Factor,
    /// Mass of every unknown; for angles their inertia, or zero.
    mass: Vec<f64>,
    shift: f64,
    unstable: usize,
}

impl Pencil {
    fn new(system: System, end_angle: f64, share: f64, count: usize) -> Result<Pencil, Error> {
        let (n, w) = (system.layout.unknowns, system.layout.half_bandwidth);
        let mut statics = Statics::new(system, end_angle, 0.0);
        let (mut u, mut g) = (vec![0.0; n], vec![0.0; n]);
        statics.system.gather(&mut u);
        let mut k = vec![0.0; n * (w + 1)];
        statics.system.update_shape(true, end_angle)?;
        statics.assemble(&u, &mut g, Some(&mut k)).expect("its edges and turns were just found sound");
        let system = statics.system;

        let mut mass = vec![0.0; n];
        for &v in &system.layout.free_vertices {
            let i = system.layout.unknown[system.layout.vertex(v)];
            mass[i..i + 3].fill(system.rod.masses[v]);
        }
        for &e in system.layout.free_angles.iter().filter(|_| system.layout.spins) {
            mass[system.layout.unknown[system.layout.angle(e)]] = system.rod.spin_inertia[e];
        }
        let heavy = || mass.iter().enumerate().filter(|(_, m)| **m > 0.0);
        let greatest = heavy().map(|(i, m)| k[i * (w + 1) + w].abs() / m).fold(0.0, f64::max);
        let singular = |_: BadPivot| Error::Modes { converged: 0, count };
        // the symmetric factor counts negative eigenvalues, the one with pivoting solves
        let mut symmetric = LinearSolver::new(n, &Structure::SymmetricBand { half_bandwidth: w });
        let mut factor = symmetric.empty_factor();
        let shift = share * greatest;
        heavy().for_each(|(i, m)| k[i * (w + 1) + w] += shift * m);
        let unstable = symmetric.factor(&k, &mut factor).map_err(singular)?;
        let mut general = vec![0.0; n * (2 * w + 1)];
        mirror(&k, w, &mut general);
        let mut solver = LinearSolver::new(n, &Structure::Band { half_bandwidth: w });
        let mut factor = solver.empty_factor();
        solver.factor(&general, &mut factor).map_err(singular)?;
        Ok(Pencil { system, solver, factor, mass, shift, unstable })
    }

    /// ⟨a, b⟩ = aᵀ M b.
    fn inner(&self, a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).zip(&self.mass).map(|((a, b), m)| a * b * m).sum()
    }

    /// (K + sM)⁻¹ M v.
    fn inverse(&mut self, v: &[f64]) -> Vec<f64> {
        let mut y: Vec<f64> = v.iter().zip(&self.mass).map(|(v, m)| v * m).collect();
        self.solver.solve(&self.factor, &mut y);
        y
    }

    /// Makes the vectors orthonormal in M, in their order. Those that depend on the ones before are dropped.
    fn orthonormal(&self, vectors: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
        let mut basis: Vec<Vec<f64>> = Vec::with_capacity(vectors.len());
        for mut v in vectors {
            let before = self.inner(&v, &v).sqrt();
            for _ in 0..2 {
                for b in &basis {
                    let share = self.inner(b, &v);
                    axpy(-share, b, &mut v);
                }
            }
            let after = self.inner(&v, &v).sqrt();
            if after > 1e-12 * before {
                v.iter_mut().for_each(|v| *v /= after);
                basis.push(v);
            }
        }
        basis
    }

    /// ω² of the `count` modes nearest to −s, and their vectors.
    fn lowest(&mut self, count: usize) -> Result<(Vec<f64>, Vec<Vec<f64>>), Error> {
        let moving = self.mass.iter().filter(|m| **m > 0.0).count();
        let count = count.min(moving);
        let mut basis = self.orthonormal(starts(self.mass.len(), (count + 8.max(count)).min(moving)));
        let mut converged = 0;
        for round in 0..MOST {
            let bound = if round < SETTLED.0 { CONVERGED } else { SETTLED.1 };
            let image: Vec<Vec<f64>> = basis.iter().map(|v| self.inverse(v)).collect();
            // Rayleigh–Ritz: the inverse within the basis, its eigenvectors, greatest first
            let q = basis.len();
            let h = DMatrix::from_fn(q, q, |i, j| self.inner(&basis[i], &image[j]));
            let eigen = SymmetricEigen::new((&h + h.transpose()) * 0.5);
            let mut order: Vec<usize> = (0..q).collect();
            order.sort_by(|&i, &j| eigen.eigenvalues[j].abs().total_cmp(&eigen.eigenvalues[i].abs()));
            let mixed = |vectors: &[Vec<f64>], of: usize| {
                let mut sum = vec![0.0; vectors[0].len()];
                for (i, v) in vectors.iter().enumerate() {
                    axpy(eigen.eigenvectors[(i, of)], v, &mut sum);
                }
                sum
            };
            let images: Vec<Vec<f64>> = order.iter().map(|&i| mixed(&image, i)).collect();
            let left = |&(place, &of): &(usize, &usize)| {
                let (inverse, mut rest) = (eigen.eigenvalues[of], images[place].clone());
                axpy(-inverse, &mixed(&basis, of), &mut rest);
                self.inner(&rest, &rest).sqrt() <= bound * inverse.abs()
            };
            converged = order.iter().enumerate().take(count).take_while(left).count();
            if converged == count {
                let values = order.iter().take(count).map(|&i| 1.0 / eigen.eigenvalues[i] - self.shift);
                let values = values.collect();
                return Ok((values, self.orthonormal(images.into_iter().take(count).collect())));
            }
            basis = self.orthonormal(images);
        }
        Err(Error::Modes { converged, count })
    }

    fn mode(&self, omega_squared: f64, vector: &[f64]) -> Mode {
        let (layout, n) = (&self.system.layout, self.system.rod.segments());
        let omega_squared = if omega_squared.abs() <= self.shift { 0.0 } else { omega_squared };
        let mut mode =
            Mode { omega_squared, displacements: vec![Vector3::zeros(); n + 1], turns: vec![0.0; n] };
        for &v in &layout.free_vertices {
            let i = layout.unknown[layout.vertex(v)];
            mode.displacements[v] = Vector3::from_column_slice(&vector[i..i + 3]);
        }
        for &e in &layout.free_angles {
            mode.turns[e] = vector[layout.unknown[layout.angle(e)]];
        }
        mode
    }
}

/// `count` vectors of n numbers without a pattern: multiples of the golden ratio, modulo one.
fn starts(n: usize, count: usize) -> Vec<Vec<f64>> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let of = |j: usize| (0..n).map(move |i| (((i * (j + 1) + j * j) as f64 + 1.0) * GOLDEN).fract() - 0.5);
    (0..count).map(|j| of(j).collect()).collect()
}
