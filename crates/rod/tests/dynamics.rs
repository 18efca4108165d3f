//! The step against known runs, against itself with more unknowns, and its derivatives.

use std::f64::consts::PI;
use std::sync::Arc;

use varda_implicit::{ImplicitModel, Model};
use varda_rod::{
    Clamp, ClampAt, Damping, Loads, Material, Rod, RodStep, Section, Supports, TwistUnknowns, Vector3,
    equilibrium, straight_guess,
};

const DOWN: Loads =
    Loads { gravity: Vector3::new(0.0, 0.0, -9.81), point_forces: Vec::new(), of_motion: Vec::new() };

/// Clamped at its start, hanging down, the clamp moving as given.
fn hanging(position: impl varda_rod::Motion + 'static) -> Supports {
    Supports::clamped_start(Clamp::new(ClampAt::Edge, position, [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]))
}

fn driven_25(twist: TwistUnknowns) -> ImplicitModel<RodStep> {
    let material = Material { youngs_modulus: 1e6, shear_modulus: 1e6 / 3.0, density: 1200.0 };
    let rod = Rod::uniform(1.0, 25, &Section::circle(&material, 0.005)).unwrap();
    let omega = 2.0 * PI;
    let drive = move |t: f64| [0.10 * (1.0 - (omega * t).cos()), 0.05 * (omega * t).sin(), 0.0];
    let step = RodStep::with_twist(rod, hanging(drive), DOWN, Damping::default(), twist).unwrap();
    ImplicitModel::new(step, 0, 0.02)
}

fn straight_down(step: &RodStep) -> Vec<f64> {
    let guess = straight_guess(step.rod(), step.supports(), 0.0, [0.0, 0.0, -1.0]).unwrap();
    step.control_at_rest(&guess)
}

fn run(model: &mut ImplicitModel<RodStep>, z: &[f64], steps: usize) -> Vec<f64> {
    let mut x = vec![0.0; model.dim()];
    model.initial_state(z, &mut x).unwrap();
    let mut next = x.clone();
    for k in 0..steps {
        model.step(k, &x, &mut next).unwrap();
        std::mem::swap(&mut x, &mut next);
    }
    x
}

#[test]
fn driven_rod_ends_where_an_independent_program_says() {
    let mut model = driven_25(TwistUnknowns::WhereNeeded);
    assert_eq!(model.dim(), 6 * 24, "a straight isotropic rod has no twist unknowns");
    let z = straight_down(model.step_ref());
    let x = run(&mut model, &z, 100);
    for (ours, theirs) in x[69..72].iter().zip([0.291641, 0.071304, -0.925106]) {
        assert!((ours - theirs).abs() <= 2e-6, "{:?}", &x[69..72]);
    }
}

#[test]
fn leaving_the_twist_out_changes_nothing() {
    let mut without = driven_25(TwistUnknowns::WhereNeeded);
    let mut with = driven_25(TwistUnknowns::Always);
    assert_eq!(with.dim(), 6 * 24 + 24);
    let z = straight_down(without.step_ref());
    let (a, b) = (run(&mut without, &z, 50), run(&mut with, &z, 50));
    // Newton leaves up to 1e-11 L a step in X; velocities are differences over 0.02 s.
    for (i, (a, b)) in a.iter().zip(&b).enumerate() {
        let bound = if i < 72 { 1e-9 } else { 1e-7 };
        assert!((a - b).abs() <= bound, "component {i}: {a} and {b}");
    }
    assert!(b[144..].iter().all(|theta| theta.abs() < 1e-9), "θ stays zero");
}

#[test]
fn hanging_equilibrium_is_the_closed_form() {
    let rod = driven_25(TwistUnknowns::WhereNeeded).into_inner();
    let mut section = Section::circle(&Material::new(1e6, 0.5, 1200.0), 0.005);
    (section.ei1, section.ei2, section.gj) = (0.0, 0.0, 0.0);
    // A chain, unstretched at first, has no stiffness across itself.
    let chain = Rod::uniform(1.0, 25, &section).unwrap();
    let chain = RodStep::new(chain, hanging([0.0; 3]), DOWN, Damping::default()).unwrap();
    hangs_as_its_weight_says(&rod);
    hangs_as_its_weight_says(&chain);
}

/// Edge e carries the weight below it, l = l̄ (1 + W/EA).
fn hangs_as_its_weight_says(step: &RodStep) {
    let guess = straight_guess(step.rod(), step.supports(), 0.0, [0.0, 0.0, -1.0]).unwrap();
    let (rest, _) = equilibrium(step.rod(), step.supports(), &DOWN, 0.0, &guess).unwrap();
    let rod = step.rod();
    let mut z = -rod.rest_lengths[0];
    for e in 1..25 {
        let weight: f64 = rod.masses[e + 1..].iter().sum::<f64>() * 9.81;
        z -= rod.rest_lengths[e] * (1.0 + weight / rod.ea[e]);
        assert!((rest.vertices[e + 1][2] - z).abs() < 1e-12, "vertex {}", e + 1);
    }
}

/// A chain without tension has no stiffness across: it is at rest as it lies, and Newton says that the
/// minimum is not isolated.
#[test]
fn an_unstretched_chain_is_at_rest() {
    let material = Material::new(1e6, 0.5, 1100.0);
    let section = Section { ei1: 0.0, ei2: 0.0, gj: 0.0, ..Section::circle(&material, 0.01) };
    let rod = Rod::uniform(1.0, 40, &section).unwrap();
    let vertices: Vec<Vector3<f64>> = rod.arc_lengths().iter().map(|s| Vector3::x() * *s).collect();
    let held = |v: usize| -> (usize, Arc<dyn varda_rod::Motion>) { (v, Arc::new(vertices[v])) };
    let supports = Supports { prescribed: vec![held(0), held(40)], ..Supports::default() };
    let guess = varda_rod::Rest { vertices: vertices.clone(), theta: vec![0.0; 40] };
    let (rest, report) = varda_rod::equilibrium(&rod, &supports, &Loads::default(), 0.0, &guess).unwrap();
    assert!(report.neutral, "{report:?}");
    for (a, b) in rest.vertices.iter().zip(&vertices) {
        // held across by rounding alone: moving by √ε L changes its lengths by ε L
        assert!((0..3).all(|c| (a[c] - b[c]).abs() < f64::EPSILON.sqrt()), "{a:?} {b:?}");
    }
}
