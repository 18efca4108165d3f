//! Loads of the motion: a follower force and a drag without potential, a weight with one.

mod common;

use std::ops::Range;
use std::sync::Arc;

use common::{Product, assert_close, noise, off};
use nalgebra::{Matrix3, Matrix6, Vector6};
use proptest::prelude::*;
use varda_implicit::{ImplicitModel, ImplicitStep, Model, Scheme, Structure};
use varda_rod::{
    Clamp, ClampAt, Damping, EdgeLoad, EdgeMotion, Load, Loads, Material, Rod, RodStep, Section, Supports,
    Vector3, equilibrium, straight_guess,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// A force f t on the second vertex of the last edge, along that edge whichever way it points.
struct Follower {
    force: f64,
    /// Factor of one entry of the Jacobian; 1 is right.
    mutation: f64,
}

impl Load for Follower {
    fn has_potential(&self) -> bool {
        false
    }

    fn edges(&self, segments: usize) -> Range<usize> {
        segments - 1..segments
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        let e = motion.places[1] - motion.places[0];
        let t = e.normalize();
        let by_edge = (Matrix3::identity() - t * t.transpose()) * (self.force / e.norm());
        let mut load = EdgeLoad::zero();
        load.forces.fixed_rows_mut::<3>(3).copy_from(&(t * self.force));
        load.by_places.fixed_view_mut::<3, 3>(3, 0).copy_from(&-by_edge);
        load.by_places.fixed_view_mut::<3, 3>(3, 3).copy_from(&by_edge);
        load.by_places[(3, 3)] *= self.mutation;
        load
    }
}

/// A drag −c l̄/2 V at both vertices of every edge.
struct Drag(f64);

impl Load for Drag {
    fn has_potential(&self) -> bool {
        false
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        let c = 0.5 * self.0 * motion.rest_length;
        let [a, b] = motion.velocities;
        EdgeLoad {
            forces: Vector6::new(a.x, a.y, a.z, b.x, b.y, b.z) * -c,
            by_velocities: Matrix6::identity() * -c,
            ..EdgeLoad::zero()
        }
    }
}

/// The weight of a uniform rod, by edges, as a load with a potential.
struct Weight {
    mass_per_length: f64,
}

impl Load for Weight {
    fn has_potential(&self) -> bool {
        true
    }

    fn on_edge(&self, motion: &EdgeMotion) -> EdgeLoad {
        let f = GRAVITY * (0.5 * self.mass_per_length * motion.rest_length);
        EdgeLoad {
            energy: -f.dot(&(motion.places[0] + motion.places[1])),
            forces: Vector6::new(f.x, f.y, f.z, f.x, f.y, f.z),
            ..EdgeLoad::zero()
        }
    }
}

fn section() -> Section {
    Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)
}

/// A rod of 8 segments that has twist unknowns where it is naturally curved.
fn rod(curved: bool) -> Rod {
    let rod = Rod::uniform(0.8, 8, &section()).unwrap();
    if curved { rod.naturally([0.5, -0.3], 0.8) } else { rod }
}

fn clamp() -> Clamp {
    Clamp::new(
        ClampAt::Edge,
        |t: f64| [0.05 * (8.0 * t).sin(), 0.02 * t, 0.0],
        |t: f64| [0.2 * (3.0 * t).sin(), 0.0, -1.0],
        [1.0, 0.0, 0.0],
    )
}

fn step(rod: Rod, of_motion: Vec<Arc<dyn Load>>, damping: Damping) -> RodStep {
    let loads = Loads { gravity: GRAVITY, of_motion, ..Loads::default() };
    RodStep::new(rod, Supports::clamped_start(clamp()), loads, damping).unwrap()
}

/// Hanging straight down with 4 mm and 0.2 m/s of noise.
fn start(step: &RodStep) -> Vec<f64> {
    let guess = straight_guess(step.rod(), step.supports(), 0.0, GRAVITY).unwrap();
    let mut z = step.control_at_rest(&guess);
    let n = z.len() / 2;
    z.iter_mut().zip(noise(1)).enumerate().for_each(|(i, (z, e))| *z += if i < n { 0.004 } else { 0.2 } * e);
    z
}

fn run(step: RodStep, dt: f64, steps: usize) -> Vec<f64> {
    let z = start(&step);
    let mut model = ImplicitModel::new(step, 0, dt);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x).unwrap();
    for k in 0..steps {
        let mut next = vec![0.0; x.len()];
        model.step(k, &x, &mut next).unwrap();
        x = next;
    }
    x
}

fn follower_and_drag(mutation: f64) -> Vec<Arc<dyn Load>> {
    vec![Arc::new(Follower { force: 0.4, mutation }), Arc::new(Drag(0.5))]
}

fn pushed(curved: bool, scheme: Scheme, damping: Damping, mutation: f64) -> ImplicitModel<RodStep> {
    let step = step(rod(curved), follower_and_drag(mutation), damping).with_scheme(scheme);
    assert!(matches!(step.structure(), Structure::Band { .. }));
    ImplicitModel::new(step, 0, 0.004)
}

/// The products of three steps.
fn products(mut model: ImplicitModel<RodStep>) -> Vec<Product> {
    let z = start(model.step_ref());
    common::products(&mut model, &z)
}

#[test]
fn steps_without_a_potential_have_exact_tangents_and_adjoints() {
    for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
        for (curved, stiffness) in [(false, 0.0), (true, 0.0), (true, 0.004)] {
            let name = format!("{scheme:?}, curved {curved}, damping {stiffness}");
            for Product { tangent, by_difference, gap, .. } in
                products(pushed(curved, scheme, Damping { stiffness, mass: 0.7 }, 1.0))
            {
                assert_close(&name, &tangent, &by_difference, 1e-6);
                assert!(gap <= 1e-12, "{name}: {gap:e}");
            }
        }
    }
}

/// One entry of ∂F/∂x off by half: the differences show it, the dot product cannot.
#[test]
fn a_wrong_entry_is_seen() {
    let all = products(pushed(true, Scheme::BackwardEuler, Damping::default(), 0.5));
    let errors = all.iter().map(|product| {
        let (error, size) = off(&product.tangent, &product.by_difference);
        error / size
    });
    assert!(!(errors.fold(0.0, f64::max) <= 1e-6), "the check is blind");
}

#[test]
fn a_weight_with_a_potential_is_gravity() {
    let hung = |gravity, of_motion| {
        let loads = Loads { gravity, of_motion, ..Loads::default() };
        RodStep::new(rod(true), Supports::clamped_start(clamp()), loads, Damping::default()).unwrap()
    };
    let mass_per_length = section().mass_per_length;
    let by_load = hung(Vector3::zeros(), vec![Arc::new(Weight { mass_per_length })]);
    assert!(matches!(by_load.structure(), Structure::SymmetricBand { .. }));
    let (a, b) = (run(by_load, 0.01, 20), run(hung(GRAVITY, Vec::new()), 0.01, 20));
    // places are solved to 1e-11 L a step, velocities are differences of them over Δt
    assert!(off(&a, &b).0 <= 1e-8, "{:e}", off(&a, &b).0);
}

/// EA (l̄ − l)/l̄ = f in every edge but the clamped one.
#[test]
fn a_follower_force_has_an_equilibrium() {
    let rod = rod(false);
    let supports =
        Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]));
    let force = -0.1;
    let loads = Loads { of_motion: vec![Arc::new(Follower { force, mutation: 1.0 })], ..Loads::default() };
    let guess = straight_guess(&rod, &supports, 0.0, GRAVITY).unwrap();
    let (rest, _) = equilibrium(&rod, &supports, &loads, 0.0, &guess).unwrap();
    let expected = -0.1 - 0.7 * (1.0 + force / rod.ea[0]);
    assert!((rest.vertices[8].z - expected).abs() <= 1e-12, "{}", rest.vertices[8].z - expected);
}

#[test]
fn edges_that_do_not_exist_are_refused() {
    struct Beyond;
    impl Load for Beyond {
        fn has_potential(&self) -> bool {
            true
        }
        fn edges(&self, segments: usize) -> Range<usize> {
            0..segments + 1
        }
        fn on_edge(&self, _: &EdgeMotion) -> EdgeLoad {
            EdgeLoad::zero()
        }
    }
    let loads = Loads { of_motion: vec![Arc::new(Beyond)], ..Loads::default() };
    let refused = RodStep::new(rod(false), Supports::clamped_start(clamp()), loads, Damping::default());
    assert!(refused.err().unwrap().to_string().contains("end of a load's edges"));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, ..ProptestConfig::default() })]

    /// A drag proportional to the masses is mass damping: half the mass of an edge goes to either of its
    /// vertices.
    #[test]
    fn drag_by_mass_is_mass_damping(alpha in 0.1..20.0f64, curved: bool, second_order: bool) {
        let scheme = if second_order { Scheme::Bdf2 } else { Scheme::BackwardEuler };
        let drag = Arc::new(Drag(alpha * section().mass_per_length));
        let by_load = step(rod(curved), vec![drag], Damping::default()).with_scheme(scheme);
        let damping = Damping { stiffness: 0.0, mass: alpha };
        let damped = step(rod(curved), Vec::new(), damping).with_scheme(scheme);
        let (a, b) = (run(by_load, 0.01, 10), run(damped, 0.01, 10));
        // places are solved to 1e-11 L a step, velocities are differences of them over Δt
        prop_assert!(off(&a, &b).0 <= 1e-8, "{:e}", off(&a, &b).0);
    }
}
