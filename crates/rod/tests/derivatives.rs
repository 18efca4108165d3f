//! Tangent and adjoint of steps, of θ₀(X₀) and of markers, against central differences and each other.

mod common;

use std::sync::Arc;

use common::{assert_close, difference, dot, noise, norm};
use nalgebra::Rotation3;
use varda_implicit::{At, ImplicitModel, Model, ObservationOperator, Scheme};
use varda_rod::{
    Clamp, ClampAt, Damping, EllipseDrive, Loads, Marker, Markers, Material, Motion, Rod, RodStep, Section,
    Supports, Vector3, equilibrium, straight_guess,
};

const MATERIAL: Material = Material { youngs_modulus: 1e6, shear_modulus: 1e6 / 3.0, density: 1100.0 };

fn loads() -> Loads {
    Loads {
        gravity: [0.0, 0.0, -9.81].into(),
        point_forces: vec![(0.61, Arc::new(|t: f64| [0.02 * t.cos(), 0.01, 0.0]))],
        ..Loads::default()
    }
}

fn clamp(
    position: impl Motion + 'static,
    tangent: impl Motion + 'static,
    director: impl Motion + 'static,
) -> Clamp {
    Clamp::new(ClampAt::Edge, position, tangent, director)
}

fn drive() -> EllipseDrive {
    EllipseDrive { centre: [0.0; 3].into(), radii: [0.06, 0.03], omega: 10.0, phase: 0.0, ramp: 0.1 }
}

/// A rod with everything: anisotropic, naturally curved and twisted, unequal segments, a point mass.
fn curved() -> Rod {
    let lengths: Vec<f64> = (0..9).map(|i| 0.1 + 0.02 * (i as f64).sin()).collect();
    let section = Section::ellipse(&MATERIAL, 0.012, 0.009);
    let mut rod = Rod::with_segments(&lengths, &section).unwrap().naturally([0.5, -0.3], 0.8);
    rod.add_point_mass(0.5, 0.05).unwrap();
    rod
}

fn straight(segments: usize) -> Rod {
    Rod::uniform(0.9, segments, &Section::circle(&MATERIAL, 0.01)).unwrap()
}

/// A clamp that moves, swings and turns about itself.
fn swinging() -> Clamp {
    clamp(
        drive(),
        |t: f64| [0.3 * (3.0 * t).sin(), 0.1, -1.0],
        |t: f64| [(4.0 * t).cos(), (4.0 * t).sin(), 0.0],
    )
}

fn both_ends() -> Supports {
    let end = clamp(
        |t: f64| [0.35 + 0.05 * t, 0.1, -0.4],
        [0.8, 0.2, 0.6],
        |t: f64| [(2.0 * t).sin(), (2.0 * t).cos(), 0.3],
    );
    Supports { start: Some(swinging()), end: Some(end), ..Supports::default() }
}

fn pinned() -> Supports {
    Supports {
        prescribed: vec![(0, Arc::new(drive())), (5, Arc::new([0.1, 0.0, -0.45]))],
        free_frame: ([0.0, 0.0, -1.0].into(), [1.0, 0.0, 0.0].into()),
        ..Supports::default()
    }
}

fn end_clamp() -> Supports {
    Supports {
        end: Some(clamp([0.0, 0.0, -0.9], |t: f64| [0.2 * t.sin(), 0.0, -1.0], [0.0, 1.0, 0.2])),
        free_frame: ([0.0, 0.0, -1.0].into(), [1.0, 0.0, 0.0].into()),
        ..Supports::default()
    }
}

fn chain() -> Rod {
    let mut section = Section::circle(&MATERIAL, 0.01);
    (section.ei1, section.ei2, section.gj) = (0.0, 0.0, 0.0);
    Rod::uniform(0.9, 8, &section).unwrap()
}

fn cases() -> Vec<(&'static str, Rod, Supports, Damping)> {
    let none = Damping::default();
    let both = Damping { stiffness: 0.004, mass: 0.7 };
    vec![
        ("straight, clamped", straight(8), Supports::clamped_start(swinging()), none),
        (
            "straight, mass damping",
            straight(8),
            Supports::clamped_start(swinging()),
            Damping { stiffness: 0.0, mass: 1.5 },
        ),
        ("straight, both dampings", straight(8), Supports::clamped_start(swinging()), both),
        ("straight, both ends", straight(8), both_ends(), none),
        ("straight, end clamp", straight(8), end_clamp(), none),
        ("curved, clamped", curved(), Supports::clamped_start(swinging()), none),
        ("curved, both dampings", curved(), Supports::clamped_start(swinging()), both),
        ("curved, both ends, damped", curved(), both_ends(), both),
        ("curved, pinned", curved(), pinned(), none),
        ("curved, pinned, damped", curved(), pinned(), both),
        ("curved, end clamp, damped", curved(), end_clamp(), both),
        (
            "curved, free, damped",
            curved(),
            Supports { free_frame: ([0.0, 0.0, -1.0].into(), [1.0, 0.0, 0.0].into()), ..Supports::default() },
            both,
        ),
        ("chain, damped", chain(), Supports::clamped_start(swinging()), both),
    ]
}

fn model(rod: Rod, supports: Supports, damping: Damping) -> ImplicitModel<RodStep> {
    ImplicitModel::new(RodStep::new(rod, supports, loads(), damping).unwrap(), 3, 0.01)
}

/// Every case by every scheme, named; all start at 0.03 s. Steps that damp nothing are short enough to follow
/// the stretching of a wild start: else a rod that is free to spin snaps from one angle to another, where
/// there is no derivative.
fn cases_by_scheme() -> Vec<(String, ImplicitModel<RodStep>)> {
    let schemes =
        [(Scheme::BackwardEuler, 3, 0.01), (Scheme::Midpoint, 15, 0.002), (Scheme::Bdf2, 15, 0.002)];
    let by = |(scheme, first, length)| {
        cases().into_iter().map(move |(name, rod, supports, damping)| {
            let step = RodStep::new(rod, supports, loads(), damping).unwrap().with_scheme(scheme);
            (format!("{name}, {scheme:?}"), ImplicitModel::new(step, first, length))
        })
    };
    schemes.into_iter().flat_map(by).collect()
}

fn control(step: &RodStep) -> Vec<f64> {
    let mut guess = straight_guess(step.rod(), step.supports(), 0.03, [0.0, 0.0, -1.0]).unwrap();
    let held_twice = step.supports().start.is_some() && step.supports().end.is_some();
    if held_twice {
        guess = equilibrium(step.rod(), step.supports(), &loads(), 0.03, &guess).unwrap().0;
    }
    let mut z = step.control_at_rest(&guess);
    // Bowed, so that a rod whose ends are free to spin has one stable angle: its own curve looks for the bow.
    let n = z.len() / 2;
    for i in (0..n / 3).filter(|_| step.supports().start.is_none() && step.supports().end.is_none()) {
        let s = z[3 * i + 2];
        z[3 * i] += 0.4 * s * s;
    }
    for (i, (z, e)) in z.iter_mut().zip(noise(1)).enumerate() {
        *z += if i < n { 0.004 } else { 0.2 } * e;
    }
    z
}

#[test]
fn initial_angles() {
    for (name, rod, supports, damping) in cases() {
        let mut model = model(rod, supports, damping);
        let z = control(model.step_ref());
        let (m, n) = (z.len(), model.dim());
        let dz: Vec<f64> = noise(2).take(m).collect();
        let by_difference = difference(&z, &dz, 1e-4, |z| {
            let mut x = vec![0.0; n];
            model.initial_state(z, &mut x).unwrap();
            x
        });
        let mut x = vec![0.0; n];
        model.initial_state(&z, &mut x).unwrap();
        let mut dx = vec![0.0; n];
        model.initial_tangent(&dz, &mut dx);
        assert_close(name, &dx, &by_difference, 1e-7);
        let lambda: Vec<f64> = noise(3).take(n).collect();
        let mut back = vec![0.0; m];
        model.initial_adjoint(&lambda, &mut back);
        let (a, b) = (dot(&dx, &lambda), dot(&dz, &back));
        assert!((a - b).abs() <= 1e-13 * norm(&dx) * norm(&lambda), "{name}: {a} and {b}");
    }
}

#[test]
fn steps() {
    for (name, mut model) in cases_by_scheme() {
        let z = control(model.step_ref());
        for product in common::products(&mut model, &z) {
            assert_eq!(product.substeps, 0, "{name}");
            assert_close(&name, &product.tangent, &product.by_difference, 1e-6);
            assert!(product.tangent.iter().all(|v| v.abs() > 1e-12), "{name}: an empty test");
            assert!(product.gap <= 1e-12, "{name}: {:e}", product.gap);
        }
    }
}

#[test]
fn markers() {
    for (name, rod, supports, damping) in cases() {
        let mut model = model(rod, supports, damping);
        let n = model.dim();
        let mut x = vec![0.0; n];
        model.initial_state(&control(model.step_ref()), &mut x).unwrap();
        let length = model.step_ref().rod().length();
        let places = [0.0, 0.33, 0.5, length].map(|s| Marker { s, offset: [0.02, -0.015, 0.01].into() });
        let points = [0.2, length].map(|s| Marker { s, offset: [0.0; 3].into() });
        for (what, list) in [("off", places.to_vec()), ("on", points.to_vec())] {
            let axes = Rotation3::from_euler_angles(0.3, -0.8, 2.0).into_inner();
            let markers = Markers::new(model.step_ref(), &list).unwrap();
            let mut markers = markers.in_axes(axes, Vector3::new(0.2, -1.0, 0.5)).unwrap();
            let (m, now) = (markers.dim(), At { step: 2, time: 0.05 });
            let dx: Vec<f64> = noise(5).take(n).collect();
            let by_difference = difference(&x, &dx, 1e-4, |x| {
                let mut y = vec![0.0; m];
                markers.observe(now, x, &mut y).unwrap();
                y
            });
            let mut dy = vec![0.0; m];
            markers.tangent(now, &x, &dx, &mut dy);
            assert_close(&format!("{name}, {what}"), &dy, &by_difference, 1e-7);
            let dp: Vec<f64> = noise(6).take(m).collect();
            let mut back = vec![0.0; n];
            markers.adjoint_add(now, &x, &dp, &mut back);
            let (a, b) = (dot(&dy, &dp), dot(&dx, &back));
            assert!((a - b).abs() <= 1e-13 * norm(&dy) * norm(&dp), "{name}, {what}: {a} and {b}");
        }
    }
}

#[test]
fn products_do_not_depend_on_what_was_asked_before() {
    for (name, mut model) in cases_by_scheme() {
        let z = control(model.step_ref());
        let n = model.dim();
        let mut x = vec![0.0; n];
        model.initial_state(&z, &mut x).unwrap();
        let mut next = x.clone();
        for k in 0..3 {
            let work = model.step(k, &x, &mut next).unwrap();
            assert_eq!(work.substeps, 0, "{name}");
            model.linearize(k, k, &x, &next).unwrap();
            x.copy_from_slice(&next);
        }
        let v: Vec<f64> = noise(7).take(n).collect();
        let products = |model: &mut ImplicitModel<RodStep>, before: usize| {
            let (mut forward, mut backward, mut other) = (v.clone(), v.clone(), v.clone());
            model.adjoint(before, &mut other);
            model.tangent(1, &mut forward);
            model.tangent(before, &mut other);
            model.adjoint(1, &mut backward);
            (forward, backward)
        };
        let (early, late) = (products(&mut model, 0), products(&mut model, 2));
        assert!(early == late, "{name}: the products of step 1 remember another step");
    }
}
