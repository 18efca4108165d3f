//! Drag, follower forces and moments: exact derivatives in every scheme, and what they do to a rod.

mod common;

use std::ops::Range;
use std::sync::Arc;

use common::{assert_close, difference, noise, off};
use nalgebra::{SMatrix, Vector6};
use varda_implicit::{ImplicitModel, ImplicitStep, Model, Scheme};
use varda_rod::{
    Clamp, ClampAt, Damping, Drag, Dual64, EdgeLoad, EdgeMotion, FollowerForce, Load, Loads, Material,
    Moment, Rod, RodStep, Section, Supports, Vector3, check, equilibrium, straight_guess,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

fn section() -> Section {
    Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)
}

/// Eight segments; with natural curvature, bending depends on the angles.
fn rod(curved: bool) -> Rod {
    let rod = Rod::uniform(0.8, 8, &section()).unwrap();
    if curved { rod.naturally([0.5, -0.3], 0.8) } else { rod }
}

fn supports() -> Supports {
    Supports::clamped_start(Clamp::new(
        ClampAt::Edge,
        |t: f64| [0.05 * (8.0 * t).sin(), 0.02 * t, 0.0],
        |t: f64| [0.2 * (3.0 * t).sin(), 0.0, -1.0],
        [1.0, 0.0, 0.0],
    ))
}

/// The anchor of a moment about the tangent in one direction of the section: W = ½ k (m₁·a)².
struct Needle {
    stiffness: f64,
    to: Vector3<f64>,
}

impl Load for Needle {
    fn has_potential(&self) -> bool {
        true
    }

    fn edges(&self, segments: usize) -> Range<usize> {
        4..segments
    }

    fn uses_directors(&self) -> bool {
        true
    }

    fn has_moment(&self) -> bool {
        true
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        let (t, l) = motion.tangent();
        let [m1, m2] = motion.directors;
        let (k, a) = (self.stiffness, self.to);
        let (p, q, r) = (m1.dot(&a), m2.dot(&a), t.dot(&a));
        // ∂p/∂e = −r m₁/l, ∂p/∂θ = q; ∂r/∂e = (a − r t)/l; ∂m₁/∂e = −t m₁ᵀ/l;
        // ∂(1/l)/∂e = −t/l²
        let by_edge = (m1 * (a - t * r).transpose() - t * m1.transpose() * r - m1 * t.transpose() * r)
            * (p / (l * l))
            - m1 * m1.transpose() * (r * r / (l * l));
        let mut load = EdgeLoad { energy: 0.5 * k * p * p, ..EdgeLoad::zero() };
        let force = m1 * (k * p * r / l);
        load.add_force(0, -force, &(-by_edge * k));
        load.add_force(1, force, &(by_edge * k));
        let by_angle: Vector3<f64> = (m1 * (q * r) + m2 * (p * r)) * (k / l);
        load.by_angle = Vector6::from_iterator((-by_angle).iter().chain(by_angle.iter()).copied());
        load.moment = -k * p * q;
        load.moment_by_angle = -k * (q * q - p * p);
        // ∂q/∂e = −r m₂/l
        let by_place: Vector3<f64> = (m1 * q + m2 * p) * (k * r / l);
        load.moment_by_places = Vector6::from_iterator((-by_place).iter().chain(by_place.iter()).copied());
        load
    }
}

/// A load with one entry of a derivative off by a share of itself and a little.
struct Mutated {
    load: Arc<dyn Load>,
    entry: &'static str,
}

impl Load for Mutated {
    fn has_potential(&self) -> bool {
        self.load.has_potential()
    }

    fn edges(&self, segments: usize) -> Range<usize> {
        self.load.edges(segments)
    }

    fn uses_directors(&self) -> bool {
        self.load.uses_directors()
    }

    fn has_moment(&self) -> bool {
        self.load.has_moment()
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        let mut acts = self.load.on_edge(motion);
        let off = |entry: &mut f64| *entry += 0.05 * *entry + 1e-2;
        match self.entry {
            "by_places" => off(&mut acts.by_places[(4, 3)]),
            "by_velocities" => off(&mut acts.by_velocities[(3, 3)]),
            "by_angle" => off(&mut acts.by_angle[4]),
            "moment_by_places" => off(&mut acts.moment_by_places[4]),
            "moment_by_angle" => off(&mut acts.moment_by_angle),
            _ => {}
        }
        acts
    }

    fn has_second_derivatives(&self) -> bool {
        self.entry == "second" && self.load.has_second_derivatives()
    }

    fn on_moved_edge(&self, motion: &EdgeMotion<Dual64>) -> EdgeLoad<Dual64> {
        self.load.on_moved_edge(motion)
    }

    fn second_on_edge(&self, motion: &EdgeMotion, multipliers: &[f64; 7]) -> SMatrix<f64, 13, 13> {
        let mut second = self.load.second_on_edge(motion, multipliers);
        second[(7, 4)] *= 1.001;
        second
    }
}

/// The loads of this file by name, and the derivatives that they have.
fn loads() -> Vec<(&'static str, Arc<dyn Load>, Vec<&'static str>)> {
    let rod = rod(false);
    let jet = |t: f64| [0.3 + t, -0.2, 0.25 * (20.0 * t).cos()];
    let vector = |t: f64| [0.02, -0.03 * (9.0 * t).sin(), 0.04];
    let drag = Drag { flow: Vector3::new(0.6, -0.2, 0.4), tangential: 0.3, ..Drag::of(1000.0, 0.02) };
    vec![
        ("drag", Arc::new(drag), vec!["by_places", "by_velocities"]),
        ("follower", Arc::new(FollowerForce::new(&rod, 0.73, jet).unwrap()), vec!["by_places", "by_angle"]),
        (
            "tangential follower",
            Arc::new(FollowerForce::tangential(&rod, 0.8, |t| t - 0.4).unwrap()),
            vec!["by_places"],
        ),
        ("moment", Arc::new(Moment::new(&rod, 0.52, vector).unwrap()), vec!["by_places", "moment_by_places"]),
        ("twist", Arc::new(Moment::about_tangent(&rod, 0.8, |t| 0.04 + t).unwrap()), vec![]),
        (
            "needle",
            Arc::new(Needle { stiffness: 0.2, to: Vector3::new(0.5, -0.4, 0.7) }),
            vec!["by_places", "by_angle", "moment_by_places", "moment_by_angle"],
        ),
    ]
}

fn step(rod: Rod, load: Arc<dyn Load>, scheme: Scheme, damping: Damping) -> RodStep {
    let loads = Loads { gravity: GRAVITY, of_motion: vec![load], ..Loads::default() };
    RodStep::new(rod, supports(), loads, damping).unwrap().with_scheme(scheme)
}

/// Hanging straight down with 20 mm and 0.5 m/s of noise.
fn start(step: &RodStep) -> Vec<f64> {
    let guess = straight_guess(step.rod(), step.supports(), 0.0, GRAVITY).unwrap();
    let mut z = step.control_at_rest(&guess);
    let n = z.len() / 2;
    z.iter_mut().zip(noise(1)).enumerate().for_each(|(i, (z, e))| *z += if i < n { 0.02 } else { 0.5 } * e);
    z
}

/// Three steps: the largest relative error of the tangent of the initial map and of each step against
/// differences, and how far the dot products are off.
fn products(step: RodStep) -> (f64, f64) {
    let mut model = ImplicitModel::new(step, 0, 0.004);
    let (n, m) = (model.dim(), model.control_dim());
    let z = start(model.step_ref());
    let mut x = vec![0.0; n];
    let (mut error, mut gap): (f64, f64) = (0.0, 0.0);
    let mut compare = |tangent: &[f64], by_difference: &[f64]| {
        let (largest, size) = off(tangent, by_difference);
        error = error.max(if largest.is_nan() { f64::INFINITY } else { largest / size });
    };
    let dz: Vec<f64> = noise(3).take(m).collect();
    let by_difference = difference(&z, &dz, 1e-4, |z| {
        let mut x = vec![0.0; n];
        model.initial_state(z, &mut x).unwrap();
        x
    });
    model.initial_state(&z, &mut x).unwrap();
    let mut tangent = vec![0.0; n];
    model.initial_tangent(&dz, &mut tangent);
    compare(&tangent, &by_difference);
    for product in common::products(&mut model, &z) {
        compare(&product.tangent, &product.by_difference);
        gap = gap.max(product.gap);
    }
    (error, gap)
}

#[test]
fn tangents_and_adjoints_are_exact_in_every_scheme() {
    for (name, load, _) in loads() {
        for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
            for (curved, stiffness) in [(false, 0.0), (true, 0.0), (true, 0.004)] {
                let damping = Damping { stiffness, mass: 0.7 };
                let (error, gap) = products(step(rod(curved), load.clone(), scheme, damping));
                // differences of fourth order; products of about 50 numbers, each to its rounding
                assert!(error <= 2e-6, "{name}, {scheme:?}, curved {curved}, damping {stiffness}: {error:e}");
                assert!(gap <= 1e-12, "{name}, {scheme:?}, curved {curved}, damping {stiffness}: {gap:e}");
            }
        }
    }
}

#[test]
fn every_wrong_entry_is_seen() {
    for (name, load, entries) in loads() {
        for entry in entries {
            let mutated = Arc::new(Mutated { load: load.clone(), entry });
            let (error, _) = products(step(rod(true), mutated.clone(), Scheme::Bdf2, Damping::default()));
            assert!(!(error <= 2e-6), "{name}: {entry} is not seen in a step: {error:e}");
            let report = check::load(&*mutated, &rod(true), 0.1, 0.5, 3).unwrap();
            assert!(!report.passed(), "{name}: the check for users does not see {entry}:\n{report}");
        }
    }
}

#[test]
fn loads_on_sections_make_angles_unknown() {
    let kept = "no angle: a load turns sections or follows them";
    for (name, load, _) in loads() {
        let step = step(rod(false), load.clone(), Scheme::BackwardEuler, Damping::default());
        let acts = load.uses_directors() || load.has_moment();
        assert_eq!(step.free_angles().len(), if acts { 7 } else { 0 }, "{name}");
        assert_eq!(step.left_out().iter().any(|what| what == kept), acts, "{name}");
        let symmetric = matches!(step.structure(), varda_implicit::Structure::SymmetricBand { .. });
        assert_eq!(symmetric, name == "needle", "{name}");
    }
    // a chain has no sections
    let mut chain = rod(false);
    chain.ei.fill([0.0; 3]);
    chain.gj.fill(0.0);
    let twist = Moment::about_tangent(&chain, 0.8, |_| 0.1).unwrap();
    let loads = Loads { of_motion: vec![Arc::new(twist)], ..Loads::default() };
    let refused = RodStep::new(chain, supports(), loads, Damping::default()).err().unwrap();
    assert!(refused.to_string().contains("without sections"), "{refused}");
}

#[test]
fn impossible_values_are_named() {
    let rod = rod(false);
    assert!(Moment::new(&rod, 0.9, [0.0; 3]).err().unwrap().to_string().contains("moment at arc length 0.9"));
    let off = FollowerForce::tangential(&rod, -0.1, |_| 0.0).err().unwrap();
    assert!(off.to_string().contains("follower force at arc length -0.1"));
    let of = |drag: Drag| {
        let loads = Loads { of_motion: vec![Arc::new(drag)], ..Loads::default() };
        RodStep::new(rod.clone(), supports(), loads, Damping::default()).err().unwrap().to_string()
    };
    let water = Drag::of(1000.0, 0.01);
    assert!(of(Drag { normal: -1.0, ..water }).contains("drag.normal: -1"));
    assert!(of(Drag { fluid_density: f64::NAN, ..water }).contains("drag.fluid_density"));
    assert!(of(Drag { flow: Vector3::new(0.0, f64::INFINITY, 0.0), ..water }).contains("drag.flow"));
}

#[test]
fn the_check_for_users_passes_on_them() {
    for (name, load, _) in loads() {
        let report = check::load(&*load, &rod(true), 0.1, 0.5, 3).unwrap();
        assert!(report.passed(), "{name}:\n{report}");
    }
}

#[test]
fn a_wrong_closed_form_of_second_derivatives_is_seen() {
    let drag: Arc<dyn Load> = Arc::new(Drag { flow: Vector3::new(0.3, -0.1, 0.2), ..Drag::of(1000.0, 0.01) });
    for (entry, right) in [("none", true), ("second", false)] {
        let load = Mutated { load: drag.clone(), entry };
        let report = check::load(&load, &rod(true), 0.1, 0.5, 3).unwrap();
        assert_eq!(report.passed(), right, "{report}");
    }
}

/// θ_i = M s_i/GJ, s_i the rest length between the middles of the clamped edge and of edge i.
#[test]
fn a_moment_about_the_axis_twists_a_straight_rod() {
    let rod = rod(false);
    let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], -Vector3::z(), Vector3::x()));
    let moment = 0.01;
    let expected: Vec<f64> = (0..8).map(|e| moment * 0.1 * f64::from(e) / rod.gj[0]).collect();
    let along = Moment::about_tangent(&rod, 0.8, move |_| moment).unwrap();
    // the same, fixed in space along the rod
    let fixed = Moment::new(&rod, 0.8, [0.0, 0.0, -moment]).unwrap();
    for load in [along, fixed] {
        let loads = Loads { gravity: GRAVITY, of_motion: vec![Arc::new(load)], ..Loads::default() };
        let guess = straight_guess(&rod, &supports, 0.0, GRAVITY).unwrap();
        let (rest, _) = equilibrium(&rod, &supports, &loads, 0.0, &guess).unwrap();
        // the last update was below 1e-11 L, and quadratic convergence leaves less
        assert_close("θ", &rest.theta, &expected, 1e-10);
    }
}

/// A hanging rod that starts upwards is compressed and buckles, where its potential is not convex. Drag has
/// none, and Newton's method alone fails in a step: from the minimum with drag as it was, it does not.
#[test]
fn a_rod_in_drag_that_buckles_takes_its_steps_whole() {
    let section = Section { ea: 2e3, ei1: 2e-3, ei2: 2e-3, gj: 1.5e-3, mass_per_length: 0.06 };
    let mut rod = Rod::uniform(1.2, 30, &section).unwrap();
    rod.add_point_mass(1.2, 0.02).unwrap();
    let clamp = |t: f64| [0.18 * t, 0.15 * t, 0.05 * t];
    let supports = Supports::clamped_start(Clamp::new(ClampAt::Edge, clamp, -Vector3::z(), Vector3::x()));
    let loads = Loads {
        gravity: Vector3::new(0.0, 0.0, -9.81),
        of_motion: vec![Arc::new(Drag::of(1.2, 0.02))],
        ..Loads::default()
    };
    let guess = straight_guess(&rod, &supports, 0.0, Vector3::x()).unwrap();
    let damping = Damping { stiffness: 0.01, mass: 0.1 };
    let step = RodStep::new(rod, supports, loads, damping).unwrap().with_scheme(Scheme::Bdf2);
    let mut z = step.control_at_rest(&guess);
    let half = z.len() / 2;
    for (i, v) in z[half..].chunks_exact_mut(3).enumerate() {
        v.copy_from_slice(&[1e-3 * (i as f64).sin(), 0.0, 2.0]);
    }
    let mut model = step.model(0, 1.0 / 120.0);
    let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
    model.initial_state(&z, &mut x).unwrap();
    for k in 0..20 {
        let did = model.step(k, &x, &mut next).unwrap();
        assert_eq!(did.substeps, 0, "step {k}");
        std::mem::swap(&mut x, &mut next);
    }
}
