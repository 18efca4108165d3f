//! Energy, gradient and Hessian of rods in given frames.

use super::fixture::{Fixture, expect_length, expect_size, largest, largest_difference, norm};
use crate::row::{Case, Outcome};
use nalgebra::{DMatrix, DVector};
use serde::Deserialize;
use std::path::Path;
use varda_rod::{Derivatives, Energy, Framed, Rod, derivatives};

#[derive(Deserialize)]
pub(super) struct Given {
    n_edges: usize,
    rest_lengths: Vec<f64>,
    voronoi_lengths: Vec<f64>,
    #[serde(rename = "EA")]
    ea: Vec<f64>,
    #[serde(rename = "EI")]
    ei: Vec<[[f64; 2]; 2]>,
    #[serde(rename = "GJ")]
    gj: Vec<f64>,
    kappa_bar: Vec<[f64; 2]>,
    tau_bar: Vec<f64>,
    vertices: Vec<[f64; 3]>,
    ref_d1: Vec<[f64; 3]>,
    ref_twist: Vec<f64>,
    theta: Vec<f64>,
    energy: Energies,
    gradient: Gradient,
    hessian_lower_coo: Coo,
    reduced: Option<Reduced>,
}

#[derive(Deserialize)]
struct Energies {
    stretch: f64,
    bend: f64,
    twist: f64,
    total: f64,
}

#[derive(Deserialize)]
struct Gradient {
    total: Vec<f64>,
}

#[derive(Deserialize)]
struct Coo {
    stretch: Vec<(usize, usize, f64)>,
    bend: Vec<(usize, usize, f64)>,
    twist: Vec<(usize, usize, f64)>,
}

#[derive(Deserialize)]
struct Reduced {
    theta_fixed: Vec<usize>,
    theta_star: Vec<f64>,
    gradient_x: Vec<f64>,
    hessian_x_lower: Vec<Vec<f64>>,
}

/// A turn this sharp (170° has 1.5e-2) is near a fold: coordinates given to 16 digits leave 1e-9 of the
/// derivatives.
const NEAR_FOLD: f64 = 0.1;

/// Most edges of a rod: its dense Hessian has (4n + 3)² entries.
const EDGES: usize = 500;

impl Fixture for Given {
    fn validate(&self) -> Result<(), String> {
        let n = self.n_edges;
        expect_size("n_edges", n, EDGES)?;
        for (what, found, expected) in [
            ("rest_lengths", self.rest_lengths.len(), n),
            ("voronoi_lengths", self.voronoi_lengths.len(), n - 1),
            ("EA", self.ea.len(), n),
            ("EI", self.ei.len(), n - 1),
            ("GJ", self.gj.len(), n - 1),
            ("kappa_bar", self.kappa_bar.len(), n - 1),
            ("tau_bar", self.tau_bar.len(), n - 1),
            ("vertices", self.vertices.len(), n + 1),
            ("ref_d1", self.ref_d1.len(), n),
            ("ref_twist", self.ref_twist.len(), n - 1),
            ("theta", self.theta.len(), n),
            ("gradient.total", self.gradient.total.len(), 4 * n + 3),
        ] {
            expect_length(what, found, expected)?;
        }
        let Coo { stretch, bend, twist } = &self.hessian_lower_coo;
        let full = 4 * n + 3;
        if let Some((i, j, _)) = stretch.iter().chain(bend).chain(twist).find(|(i, j, _)| *i.max(j) >= full) {
            return Err(format!("hessian_lower_coo names entry ({i}, {j}) of {full}"));
        }
        let Some(reduced) = &self.reduced else { return Ok(()) };
        let nx = 3 * (n + 1);
        expect_length("reduced.theta_star", reduced.theta_star.len(), n)?;
        expect_length("reduced.gradient_x", reduced.gradient_x.len(), nx)?;
        expect_length("reduced.hessian_x_lower", reduced.hessian_x_lower.len(), nx)?;
        for (i, row) in reduced.hessian_x_lower.iter().enumerate() {
            expect_length(&format!("reduced.hessian_x_lower[{i}]"), row.len(), i + 1)?;
        }
        match reduced.theta_fixed.iter().find(|e| **e >= n) {
            Some(e) => Err(format!("reduced.theta_fixed names edge {e} of {n}")),
            None => Ok(()),
        }
    }
}

impl Given {
    /// Whether it is compared in milliseconds.
    pub(super) fn is_small(&self) -> bool {
        self.n_edges <= 20
    }
}

pub(super) fn check(case: &mut Case, path: &Path) -> Outcome {
    compare(case, &Given::read(path)?)
}

pub(super) fn compare(case: &mut Case, f: &Given) -> Outcome {
    let n = f.n_edges;
    let full = 4 * n + 3;
    let rod = Rod {
        rest_lengths: f.rest_lengths.clone(),
        voronoi_lengths: f.voronoi_lengths.clone(),
        ea: f.ea.clone(),
        ei: f.ei.iter().map(|m| [m[0][0], m[0][1], m[1][1]]).collect(),
        gj: f.gj.clone(),
        natural_curvature: f.kappa_bar.clone(),
        natural_twist: f.tau_bar.clone(),
        masses: vec![1.0; n + 1],
        spin_inertia: Vec::new(),
    };
    let tolerance = if sharpest_turn(&f.vertices) < NEAR_FOLD { 1e-9 } else { 1e-10 };
    let ours = at(&rod, f, &f.theta)?;

    // Parts that are rounding of the inputs (a stretch energy of 1e-27) are left to the total.
    let scale: f64 = rod.ea.iter().zip(&rod.rest_lengths).map(|(a, l)| a * l).sum();
    let e = &f.energy;
    let Energy { stretch, bend, twist } = ours.energy;
    let mut error = (ours.energy.total() - e.total).abs();
    for (ours, theirs) in [(stretch, e.stretch), (bend, e.bend), (twist, e.twist)] {
        if theirs.abs() > 1e-12 * e.total.abs() {
            error = super::fixture::greater(error, (ours - theirs).abs());
        }
    }
    let relative = error / e.total.abs().max(1e-12 * scale);
    case.at_most("energy", relative, 1e-12, "-").computed(ours.energy.total());

    gradient_row(case, "gradient", &ours.gradient, &f.gradient.total, &rod, tolerance);

    let mut hessian = vec![0.0; full * full];
    let Coo { stretch, bend, twist } = &f.hessian_lower_coo;
    for &(i, j, value) in stretch.iter().chain(bend).chain(twist) {
        hessian[i + j * full] += value;
        if i != j {
            hessian[j + i * full] += value;
        }
    }
    hessian_row(case, "hessian", &ours.hessian, &hessian, tolerance);

    match &f.reduced {
        Some(reduced) => check_reduced(case, &rod, f, reduced, tolerance),
        None => Ok(()),
    }
}

/// E*(x) = min_θ E(x, θ): gradient E_x and Hessian H_xx − H_xθ H_θθ⁻¹ H_θx at the stationary θ.
fn check_reduced(case: &mut Case, rod: &Rod, f: &Given, reduced: &Reduced, tolerance: f64) -> Outcome {
    let n = f.n_edges;
    let (nx, full) = (3 * (n + 1), 4 * n + 3);
    let free: Vec<usize> = (0..n).filter(|e| !reduced.theta_fixed.contains(e)).collect();
    let mut theta = reduced.theta_star.clone();
    for &e in &reduced.theta_fixed {
        theta[e] = f.theta[e];
    }
    let block = |d: &Derivatives, rows: &[usize], columns: &[usize]| {
        DMatrix::from_fn(rows.len(), columns.len(), |i, j| d.hessian[rows[i] + columns[j] * full])
    };
    let x_dofs: Vec<usize> = (0..nx).collect();
    let theta_dofs: Vec<usize> = free.iter().map(|e| nx + e).collect();

    // The given θ* is a stationary point to the rounding of its digits: Newton has next to nothing to do.
    let mut d = at(rod, f, &theta)?;
    let mut first = 0.0;
    for iteration in 0..10 {
        let residual = DVector::from_fn(free.len(), |i, _| d.gradient[theta_dofs[i]]);
        let step = block(&d, &theta_dofs, &theta_dofs).lu().solve(&residual).ok_or("H_θθ is singular")?;
        let size = (0..free.len()).fold(0.0, |m, i| super::fixture::greater(m, step[i].abs()));
        if iteration == 0 {
            first = size;
        }
        if !(size < 1.0) {
            return Err(format!("theta_star is not near a stationary point: Newton step {size:e} rad").into());
        }
        // Below 1e-15 rad a step is rounding of θ itself.
        if size < 1e-15 {
            break;
        }
        for (i, &e) in free.iter().enumerate() {
            theta[e] -= step[i];
        }
        d = at(rod, f, &theta)?;
    }

    let note = format!("first Newton step from theta_star {first:.1e} rad");
    gradient_row(case, "reduced_gradient", &d.gradient[..nx], &reduced.gradient_x, rod, tolerance).note(note);
    let cross = block(&d, &theta_dofs, &x_dofs);
    let solved = block(&d, &theta_dofs, &theta_dofs).lu().solve(&cross).ok_or("H_θθ is singular")?;
    let schur = block(&d, &x_dofs, &x_dofs) - cross.transpose() * solved;
    let (mut ours, mut theirs) = (Vec::new(), Vec::new());
    for (i, row) in reduced.hessian_x_lower.iter().enumerate() {
        for (j, value) in row.iter().enumerate() {
            // both triangles are ours to get right
            ours.extend([schur[(i, j)], schur[(j, i)]]);
            theirs.extend([*value; 2]);
        }
    }
    hessian_row(case, "reduced_hessian", &ours, &theirs, tolerance);
    Ok(())
}

fn at(rod: &Rod, f: &Given, theta: &[f64]) -> Result<Derivatives, varda_rod::Error> {
    let vectors = |all: &[[f64; 3]]| all.iter().map(|v| (*v).into()).collect::<Vec<_>>();
    let (vertices, directors) = (&vectors(&f.vertices), &vectors(&f.ref_d1));
    derivatives(rod, &Framed { vertices, directors, reference_twist: &f.ref_twist, theta })
}

/// Errors count against the largest entry, or against the rounding of EA where that is larger (a straight rod
/// has no forces).
fn gradient_row<'a>(
    case: &'a mut Case,
    what: &str,
    ours: &[f64],
    theirs: &[f64],
    rod: &Rod,
    tolerance: f64,
) -> &'a mut crate::Row {
    let scale = largest(theirs).max(1e-13 * largest(&rod.ea) / tolerance);
    case.at_most(what, largest_difference(ours, theirs) / scale, tolerance, "-").computed(norm(ours))
}

fn hessian_row(case: &mut Case, what: &str, ours: &[f64], theirs: &[f64], tolerance: f64) {
    case.at_most(what, largest_difference(ours, theirs) / largest(theirs), tolerance, "-")
        .computed(norm(ours));
}

/// The smallest 1 + t·t' along the rod.
fn sharpest_turn(vertices: &[[f64; 3]]) -> f64 {
    let edges: Vec<[f64; 3]> =
        vertices.windows(2).map(|w| std::array::from_fn(|c| w[1][c] - w[0][c])).collect();
    let dot = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let turn = |w: &[[f64; 3]]| 1.0 + dot(&w[0], &w[1]) / (dot(&w[0], &w[0]) * dot(&w[1], &w[1])).sqrt();
    edges.windows(2).map(turn).fold(2.0, f64::min)
}
