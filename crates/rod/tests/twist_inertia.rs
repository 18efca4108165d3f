//! Rods whose sections have inertia against a spin about the tangent.

use std::f64::consts::PI;
use std::sync::Arc;

use varda_implicit::{ImplicitModel, Model, Scheme, check};
use varda_rod::{
    Clamp, ClampAt, Damping, Error, Loads, Modes, Rest, Rod, RodStep, Section, Supports, Vector3, modes,
};

const SCHEMES: [Scheme; 3] = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];
const SEGMENTS: usize = 7;
const SECTION: Section = Section { ea: 1e2, ei1: 1e-3, ei2: 2e-3, gj: 8e-4, mass_per_length: 0.1 };
/// ρ(I₁ + I₂) [kg m]: that of a radius of 2 cm, a slow twist.
const INERTIA: f64 = 2e-5;

/// Held at a point, by a clamp that moves and turns, or by two.
fn supports(clamps: usize) -> Supports {
    let mut supports = Supports::default();
    let moving = |t: f64| [0.1 * (3.0 * t).sin(), 0.05 * t, 0.02 * (5.0 * t).cos()];
    let tangent = |t: f64| Vector3::new(1.0, 0.5 * (4.0 * t).sin(), 0.3 * t);
    match clamps {
        0 => supports.prescribed = vec![(0, Arc::new([0.0; 3]))],
        _ => {
            let clamp = Clamp::new(ClampAt::Face, moving, tangent, Vector3::z());
            supports.start = Some(clamp.with_turns(|t: f64| 0.8 * t));
        }
    }
    if clamps == 2 {
        let clamp = Clamp::new(ClampAt::Face, [0.45, 0.1, 0.0], Vector3::new(1.0, 0.2, -0.3), Vector3::z());
        supports.end = Some(clamp.with_turns(|t: f64| -0.5 * t));
    }
    supports
}

fn step(clamps: usize, damping: Damping, scheme: Scheme) -> RodStep {
    let rod = Rod::uniform(0.5, SEGMENTS, &SECTION).unwrap().naturally([1.0, 0.5], 2.0);
    let rod = rod.with_rotary_inertia(INERTIA);
    RodStep::new(rod, supports(clamps), Loads::default(), damping).unwrap().with_scheme(scheme)
}

/// A bent start with velocities of some metres a second, and, where the control has them, angles and spins.
fn start(step: &RodStep) -> Vec<f64> {
    let (n, free) = (SEGMENTS as f64, step.free_vertices().len());
    let mut z = vec![0.0; step.control_len()];
    for (place, &v) in z.chunks_exact_mut(3).zip(step.free_vertices()) {
        let s = v as f64 / n;
        place.copy_from_slice(&[0.47 * s, 0.1 * s * s, 0.05 * (3.0 * s).sin()]);
    }
    let angles = (z.len() - 6 * free) / 2;
    for (i, v) in z[3 * free..6 * free].iter_mut().enumerate() {
        *v = 2.0 * (1.0 + 2.0 * i as f64).sin();
    }
    for (i, v) in z[6 * free..].iter_mut().enumerate() {
        *v = if i < angles { 0.3 } else { 10.0 } * (2.0 + 3.0 * i as f64).cos();
    }
    z
}

const DAMPED: Damping = Damping { stiffness: 0.01, mass: 0.7 };

/// Tangent by Taylor, adjoint by dot products, linearization from the stored states alone, the control's map:
/// everything that `check::model` looks at, over steps that begin with one of another scheme (BDF2) and have
/// a past.
#[test]
fn its_derivatives_are_exact() {
    for scheme in SCHEMES {
        for clamps in 0..3 {
            for (damping, given) in [(Damping::default(), true), (DAMPED, false)] {
                let step = step(clamps, damping, scheme);
                let step = if given { step.with_spins_in_control() } else { step };
                let (z, free) = (start(&step), step.free_vertices().len());
                let angles = step.free_angles().len();
                assert_eq!(z.len(), 6 * free + if given { 2 * angles } else { 0 });
                let own = 6 * free + 2 * angles + usize::from(clamps == 2);
                let mut scale = vec![0.01; 3 * free];
                scale.resize(6 * free, 1.0);
                scale.resize(6 * free + angles, 0.1);
                scale.resize(6 * free + 2 * angles, 5.0);
                scale.resize(own, 0.1);
                // unequal steps: the past has weights of its own
                let times = vec![0.0, 0.01, 0.018, 0.028, 0.041, 0.05];
                let mut model = ImplicitModel::on_times(step, times);
                let past = model.dim() - own;
                assert_eq!(past, if scheme == Scheme::BackwardEuler { 0 } else { own });
                scale.extend_from_within(..past);
                let report = check::model(&mut model, &z, 5, &scale, 3).unwrap();
                assert!(report.passed(), "{scheme:?}, {clamps} clamps, {damping:?}: {report}");
            }
        }
    }
}

/// Free at one end or clamped at both, straight, let go from its lowest mode of twist.
fn torsion(segments: usize, scheme: Scheme, ends: usize) -> (RodStep, Vec<f64>, f64) {
    let section = Section { ei2: SECTION.ei1, ..SECTION };
    let faces = [true, ends == 2];
    let rod = Rod::uniform_between(0.5, segments, &section, faces).unwrap().with_rotary_inertia(INERTIA);
    let clamp = |x: f64| Clamp::new(ClampAt::Face, [x, 0.0, 0.0], Vector3::x(), Vector3::z());
    let mut supports = Supports::clamped_start(clamp(0.0));
    supports.end = (ends == 2).then(|| clamp(0.5));
    let s = rod.arc_lengths();
    let step = RodStep::new(rod, supports, Loads::default(), Damping::default()).unwrap();
    let step = step.with_scheme(scheme).with_spins_in_control();
    let mut z = vec![0.0; step.control_len()];
    step.free_vertices().iter().enumerate().for_each(|(f, &v)| z[3 * f] = s[v]);
    let wave = PI * ends as f64; // over twice the length
    let cell = 0.5 / (segments as f64 - 0.5 * ends as f64);
    let first = 6 * step.free_vertices().len();
    for (f, &e) in step.free_angles().iter().enumerate() {
        z[first + f] = 0.1 * (wave * e as f64 * cell).sin();
    }
    (step, z, wave * (SECTION.gj / INERTIA).sqrt())
}

/// A straight rod without motion of its places is linear: the mode keeps its shape, and the midpoint rule its
/// energy to rounding; the phase is that of the discrete mode by the scheme.
#[test]
fn a_mode_of_twist_keeps_its_shape_and_energy_by_the_midpoint_rule() {
    for ends in [1, 2] {
        let (step, z, omega) = torsion(16, Scheme::Midpoint, ends);
        let (first, angles) = (6 * step.free_vertices().len(), step.free_angles().len());
        let spins = first + angles;
        let cell = 0.5 / (16.0 - 0.5 * ends as f64);
        let discrete = 2.0 * (SECTION.gj / INERTIA).sqrt() / cell
            * (0.5 * omega * cell * (INERTIA / SECTION.gj).sqrt()).sin();
        let h = 0.3 / omega;
        let mut model = ImplicitModel::new(step, 0, h);
        let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        model.initial_state(&z, &mut x).unwrap();
        for k in 0..200 {
            let phase = 2.0 * (0.5 * h * discrete).atan() * k as f64;
            for f in 0..angles {
                let (angle, spin) = (z[first + f] * phase.cos(), -z[first + f] * discrete * phase.sin());
                // rounding of the linear solves, 200 steps of it
                assert!((x[first + f] - angle).abs() <= 1e-11, "step {k}: {} {angle}", x[first + f]);
                assert!((x[spins + f] - spin).abs() <= 1e-11 * omega, "step {k}: {} {spin}", x[spins + f]);
            }
            model.step(k, &x, &mut next).unwrap();
            std::mem::swap(&mut x, &mut next);
        }
    }
}

/// The modes of K φ = ω² M φ with inertia of the angles: (2n−1)π/2L √(GJ/ρ(I₁+I₂)), nπ/L of
/// two clamps, at second order.
#[test]
fn modes_of_twist_are_among_the_natural_modes() {
    let lowest = |segments: usize, ends: usize| {
        let (step, _, omega) = torsion(segments, Scheme::Midpoint, ends);
        let s = step.rod().arc_lengths();
        let rest =
            Rest { vertices: s.iter().map(|s| Vector3::x() * *s).collect(), theta: vec![0.0; segments] };
        let count = if ends == 1 { 12 } else { 8 };
        let Modes { modes, .. } =
            modes(step.rod(), step.supports(), &Loads::default(), 0.0, &rest, count).unwrap();
        let twists = modes.iter().find(|m| m.turns.iter().any(|t| t.abs() > 1.0)).expect("one of twist");
        assert!(twists.displacements.iter().all(|d| d.norm() < 1e-6));
        twists.omega_squared.sqrt() / omega - 1.0
    };
    for ends in [1, 2] {
        let (coarse, fine) = (lowest(10, ends), lowest(20, ends));
        assert!(coarse.abs() < 0.01 && (coarse / fine - 4.0).abs() < 0.6, "{ends}: {coarse} {fine}");
    }
}

/// Left out by default; sections there are needed; inertia that is none is refused.
#[test]
fn it_is_left_out_unless_asked_for() {
    let rod = || Rod::uniform(0.5, SEGMENTS, &SECTION).unwrap();
    let make = |rod: Rod| RodStep::new(rod, supports(1), Loads::default(), Damping::default());
    let (without, with) = (make(rod()).unwrap(), make(rod().with_rotary_inertia(INERTIA)).unwrap());
    let dim = |step: RodStep| ImplicitModel::new(step, 0, 0.01).dim();
    assert!(without.left_out().iter().any(|what| what.contains("inertia of sections")));
    assert!(!with.left_out().iter().any(|what| what.contains("inertia of sections against twist: their")));
    assert_eq!(dim(with), dim(without) + SEGMENTS - 1);
    assert!(matches!(make(rod().with_rotary_inertia(0.0)), Err(Error::Value { .. })));
    let chain = Section { ei1: 0.0, ei2: 0.0, gj: 0.0, ..SECTION };
    let chain = Rod::uniform(0.5, SEGMENTS, &chain).unwrap().with_rotary_inertia(INERTIA);
    assert!(matches!(make(chain), Err(Error::NoSections)));
}
