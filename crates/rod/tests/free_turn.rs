//! Rods that hold no director: the common turn of their sections is neutral, or an unknown like others.

use std::sync::Arc;

use varda_implicit::{ImplicitModel, Model, Scheme, check};
use varda_rod::{Damping, Loads, Rod, RodStep, Search, Section, Supports, Vector3, rest};

const SCHEMES: [Scheme; 3] = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];

#[derive(Clone, Copy)]
struct Pinned {
    name: &'static str,
    ei: [f64; 2],
    curvature: f64,
    twist: f64,
    damping: f64,
    both: bool,
}

const STRAIGHT: Pinned =
    Pinned { name: "", ei: [1e-3, 1e-3], curvature: 0.0, twist: 0.0, damping: 0.01, both: false };

const RODS: [Pinned; 8] = [
    Pinned { name: "damped", ..STRAIGHT },
    Pinned { name: "damped between two pins", both: true, ..STRAIGHT },
    Pinned { name: "ellipse", ei: [1e-3, 3e-3], damping: 0.0, ..STRAIGHT },
    Pinned { name: "damped ellipse", ei: [1e-3, 3e-3], ..STRAIGHT },
    Pinned { name: "natural curvature", curvature: 2.0, damping: 0.0, ..STRAIGHT },
    Pinned { name: "natural twist", twist: 30.0, damping: 0.0, ..STRAIGHT },
    Pinned { name: "damped natural twist", twist: 30.0, ..STRAIGHT },
    Pinned { name: "ellipse between two pins", ei: [1e-3, 3e-3], damping: 0.0, both: true, ..STRAIGHT },
];

const SEGMENTS: usize = 12;

impl Pinned {
    fn supports(&self, frame: f64) -> Supports {
        let drive = |t: f64| [0.05 * (1.0 - (9.0 * t).cos()), 0.03 * (9.0 * t).sin(), 0.0];
        let mut supports = Supports {
            prescribed: vec![(0, Arc::new(drive))],
            free_frame: (-Vector3::z(), Vector3::new(frame.cos(), frame.sin(), 0.0)),
            ..Supports::default()
        };
        if self.both {
            supports.prescribed.push((SEGMENTS, Arc::new([0.0, 0.0, -0.5])));
        }
        supports
    }

    fn step(&self, scheme: Scheme, frame: f64) -> RodStep {
        let section = Section { ea: 1e3, ei1: self.ei[0], ei2: self.ei[1], gj: 8e-4, mass_per_length: 0.1 };
        let rod = Rod::uniform(0.5, SEGMENTS, &section).unwrap().naturally([self.curvature, 0.0], self.twist);
        let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
        let damping = Damping { stiffness: self.damping, mass: 0.0 };
        RodStep::new(rod, self.supports(frame), loads, damping).unwrap().with_scheme(scheme)
    }

    /// Straight down and at rest, or bowed and moving.
    fn control(&self, step: &RodStep, moved: f64) -> Vec<f64> {
        let mut z = vec![0.0; step.control_len()];
        let half = z.len() / 2;
        for (f, &v) in step.free_vertices().iter().enumerate() {
            let s = v as f64 / SEGMENTS as f64;
            z[3 * f + 2] = -0.5 * s;
            z[3 * f] += moved * 0.06 * (3.0 * s).sin();
            z[3 * f + 1] += moved * 0.03 * s * s;
        }
        for (i, z) in z[half..].iter_mut().enumerate() {
            *z += 0.3 * moved * (0.1 * i as f64).sin();
        }
        z
    }
}

fn run(name: &str, model: &mut dyn Model, z: &[f64], steps: usize) -> Vec<f64> {
    let mut x = vec![0.0; model.dim()];
    model.initial_state(z, &mut x).unwrap();
    let mut next = x.clone();
    for k in 0..steps {
        model.step(k, &x, &mut next).unwrap_or_else(|e| panic!("{name}: {e}"));
        std::mem::swap(&mut x, &mut next);
    }
    x
}

#[test]
fn they_run_and_do_not_see_the_director_of_the_frame() {
    for rod in RODS {
        for scheme in SCHEMES {
            for moved in [0.0, 1.0] {
                let mut ends = [0.0, 1.1].map(|frame| {
                    let step = rod.step(scheme, frame);
                    let z = rod.control(&step, moved);
                    let n = z.len() / 2;
                    let mut end = run(
                        &format!("{} {scheme:?} {moved} {frame}", rod.name),
                        &mut ImplicitModel::new(step, 0, 0.005),
                        &z,
                        15,
                    );
                    end.truncate(n);
                    end
                });
                let [a, b] = &mut ends;
                let off = a.iter().zip(b.iter()).fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
                // Where bending depends on angles their common turn is not neutral: it starts from the frame.
                let picks = rod.ei[0] != rod.ei[1] || rod.curvature != 0.0;
                assert!(picks || off <= 1e-9, "{} {scheme:?}: {off:e}", rod.name);
            }
        }
    }
}

#[test]
fn tangents_and_adjoints_are_exact() {
    for rod in RODS {
        for scheme in SCHEMES {
            let step = rod.step(scheme, 0.4);
            let z = rod.control(&step, 1.0);
            let n = z.len() / 2;
            let mut model = ImplicitModel::new(step, 0, 0.005);
            let x = run(rod.name, &mut model, &z, 3);
            let mut scale = vec![0.01; n];
            scale.resize(2 * n, 1.0);
            scale.resize(2 * n + SEGMENTS, 0.1);
            scale.resize(x.len(), 0.01);
            for finding in check::conformance(&mut model, 3, &x, &scale, 3).unwrap() {
                // the slightest resistance decides where the common turn ends: a solve loses some digits more
                let bound = if finding.what.contains("linearity") { 10.0 } else { 1.0 } * finding.bound;
                assert!(finding.value <= bound, "{} {scheme:?}: {finding:?}", rod.name);
            }
        }
    }
}

#[test]
fn statics_of_rods_without_a_director() {
    for rod in RODS {
        let step = rod.step(Scheme::BackwardEuler, 0.0);
        let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
        let found = rest(step.rod(), &rod.supports(0.0), &loads, 0.0, &Search::default());
        let found = found.unwrap_or_else(|e| panic!("{}: {e}", rod.name));
        let start = rod.step(Scheme::BackwardEuler, 0.0).starting_from(&found.rest, 0.0);
        let z = start.control_at_rest(&found.rest);
        run(rod.name, &mut ImplicitModel::new(start, 0, 0.005), &z, 20);
    }
}

#[test]
fn a_cable_along_the_frames_opposite_has_a_frame() {
    let section = Section { ea: 1e3, ei1: 1e-3, ei2: 1e-3, gj: 8e-4, mass_per_length: 0.1 };
    let rod = Rod::uniform(1.0, SEGMENTS, &section).unwrap();
    let held = |v: usize, x: f64| -> (usize, Arc<dyn varda_rod::Motion>) { (v, Arc::new([x, 0.0, 0.0])) };
    let prescribed = vec![held(0, 0.0), held(SEGMENTS, -1.0)];
    let supports = Supports { prescribed, ..Supports::default() };
    let loads = Loads { gravity: Vector3::new(0.0, 0.0, -9.81), ..Loads::default() };
    let damping = Damping { stiffness: 0.01, mass: 0.0 };
    let step = RodStep::new(rod, supports, loads, damping).unwrap();
    let mut z = vec![0.0; step.control_len()];
    for (f, &v) in step.free_vertices().iter().enumerate() {
        z[3 * f] = -(v as f64) / SEGMENTS as f64;
    }
    let x = run("straight along -x", &mut ImplicitModel::new(step, 0, 0.01), &z, 20);
    assert!(x[3 * (SEGMENTS / 2) - 1] < 0.0, "it sags");
}
