//! Properties that hold for every configuration: invariance, symmetry, and the paper's three-block equations.

use std::sync::Arc;

use nalgebra::{Rotation3, SVector, Unit};
use num_dual::Dual2SVec64;
use proptest::prelude::*;
use varda_implicit::{Error as StepError, ImplicitModel, Model, Scheme};
use varda_rod::{
    Clamp, ClampAt, Damping, Error, Framed, Loads, Material, Motion, Rod, RodStep, Section, Supports,
    Vector3, derivatives, energy,
};

type V = Vector3<f64>;

fn rod() -> Rod {
    let material = Material::new(2e6, 0.4, 1000.0);
    Rod::uniform(0.6, 6, &Section::ellipse(&material, 0.02, 0.012)).unwrap().naturally([0.4, -0.7], 0.5)
}

/// A crooked rod from numbers in [−1, 1]: edges turn by up to about a radian.
fn crooked(segments: usize, noise: &[f64]) -> (Vec<V>, Vec<V>, Vec<f64>) {
    let mut x = vec![V::zeros()];
    for e in noise[..3 * segments].chunks(3) {
        x.push(x[x.len() - 1] + V::new(0.04 * e[0], 0.04 * e[1], -0.1 + 0.02 * e[2]));
    }
    let rest = &noise[3 * segments..];
    let directors = (0..segments).map(|i| (x[i + 1] - x[i]).cross(&V::new(rest[i], 1.0, 0.3)).normalize());
    (x.clone(), directors.collect(), rest[segments..2 * segments].to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// The analytic gradient and Hessian are those of the energy, differentiated by second-order dual
    /// numbers.
    #[test]
    fn derivatives_are_those_of_the_energy(
        noise in prop::collection::vec(-1.0..1.0f64, 10),
        turns in -2..3i32,
    ) {
        let lengths = [0.11, 0.09];
        let material = Material::new(2e6, 0.4, 1000.0);
        let mut rod = Rod::with_segments(&lengths, &Section::ellipse(&material, 0.02, 0.012)).unwrap();
        rod = rod.naturally([0.4, -0.7], 0.5);
        rod.ei[0][1] = 0.3 * rod.ei[0][2];
        let (x, d, theta) = crooked(2, &noise);
        let twist = [0.3 + f64::from(turns) * std::f64::consts::TAU];
        let at = Framed { vertices: &x, directors: &d, reference_twist: &twist, theta: &theta };
        let ours = derivatives(&rod, &at).unwrap();
        let q = SVector::<f64, 11>::from_iterator(x.iter().flatten().chain(&theta).copied());
        let (value, gradient, hessian) = num_dual::hessian(
            |q: SVector<Dual2SVec64<11>, 11>| {
                let x: [_; 3] = std::array::from_fn(|v| q.fixed_rows::<3>(3 * v).into_owned());
                energy(&rod, &at, &x, &[q[9], q[10]]).unwrap().total()
            },
            &q,
        );
        // a few hundred operations, of terms up to EA l̄ of strain and of EA/l̄: a thousand roundings
        let size = |v: &[f64]| v.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let off = |a: &[f64], b: &[f64]| a.iter().zip(b).fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
        prop_assert!((ours.energy.total() - value).abs() <= 1e-12 * value.abs());
        prop_assert!(off(&ours.gradient, gradient.as_slice()) <= 1e-12 * size(&ours.gradient));
        prop_assert!(off(&ours.hessian, hessian.as_slice()) <= 1e-12 * size(&ours.hessian));
        // it can fail: an entry off by a thousandth is seen
        let mut wrong = ours.hessian.clone();
        wrong[12] *= 1.001;
        prop_assert!(!(off(&wrong, hessian.as_slice()) <= 1e-12 * size(&ours.hessian)));
    }

    /// Energy does not change when the whole rod moves rigidly; forces turn with it; the Hessian is
    /// symmetric.
    #[test]
    fn rigid_motion(
        noise in prop::collection::vec(-1.0..1.0f64, 30),
        axis in prop::array::uniform3(-1.0..1.0f64),
        angle in -3.0..3.0f64,
    ) {
        let axis = V::from(axis);
        prop_assume!(axis.norm() > 0.1);
        let turn = Rotation3::from_axis_angle(&Unit::new_normalize(axis), angle);
        let (x, d, theta) = crooked(6, &noise);
        let twist = vec![0.3; 5];
        let at = Framed { vertices: &x, directors: &d, reference_twist: &twist, theta: &theta };
        let still = derivatives(&rod(), &at).unwrap();
        let xr: Vec<V> = x.iter().map(|v| turn * v + V::new(1.0, -2.0, 0.0)).collect();
        let dr: Vec<V> = d.iter().map(|v| turn * v).collect();
        let moved = derivatives(&rod(), &Framed { vertices: &xr, directors: &dr, ..at }).unwrap();
        // Coordinates of size 2 m carry 4e-16 m; the stiffest spring has EA/l̄ = 1.5e4 N/m.
        let scale = still.gradient.iter().fold(1.0, |m: f64, g| m.max(g.abs()));
        prop_assert!((still.energy.total() - moved.energy.total()).abs() <= 1e-12 * scale);
        for i in 0..=6 {
            let f = turn * V::from_column_slice(&still.gradient[3 * i..3 * i + 3]);
            for c in 0..3 {
                prop_assert!((f[c] - moved.gradient[3 * i + c]).abs() <= 1e-10 * scale);
            }
        }
        let n = still.gradient.len();
        for i in 0..n {
            for j in 0..i {
                prop_assert_eq!(still.hessian[i + j * n], still.hessian[j + i * n]);
            }
        }
        // No net force and no net moment: rigid motions are null vectors of the gradient.
        for c in 0..3 {
            let force: f64 = (0..=6).map(|i| still.gradient[3 * i + c]).sum();
            prop_assert!(force.abs() <= 1e-11 * scale);
        }
    }
}

fn hanging(segments: usize, position: impl Motion + 'static, damping: Damping) -> ImplicitModel<RodStep> {
    let material = Material::new(1e6, 0.5, 1100.0);
    let rod = Rod::uniform(1.0, segments, &Section::circle(&material, 0.01)).unwrap();
    let clamp = Clamp::new(ClampAt::Edge, position, [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]);
    let loads = Loads { gravity: [0.0, 0.0, -9.81].into(), ..Loads::default() };
    ImplicitModel::new(RodStep::new(rod, Supports::clamped_start(clamp), loads, damping).unwrap(), 0, 0.02)
}

fn at_rest(model: &ImplicitModel<RodStep>) -> Vec<f64> {
    let (n, step) = (model.step_ref().rod().segments(), model.step_ref());
    let mut z = vec![0.0; step.control_len()];
    for (i, &v) in step.free_vertices().iter().enumerate() {
        z[3 * i + 2] = -(v as f64) / n as f64;
    }
    z
}

/// ∂E/∂x of a hanging rod by the public energy. Any frames do for an isotropic straight rod: parallel
/// ones, untwisted.
fn elastic_gradient(rod: &Rod, vertices: &[V]) -> Vec<f64> {
    let n = rod.segments();
    let mut d = vec![V::x(); n];
    let tangent = |e: usize| (vertices[e + 1] - vertices[e]).normalize();
    for e in 1..n {
        let (p, t) = (tangent(e - 1), tangent(e));
        let share = d[e - 1].dot(&t) / (1.0 + p.dot(&t));
        d[e] = d[e - 1] - (p + t) * share;
    }
    let theta = vec![0.0; n];
    let at = Framed { vertices, directors: &d, reference_twist: &theta[1..], theta: &theta };
    let gradient = derivatives(rod, &at).unwrap().gradient;
    assert!(gradient[3 * (n + 1)..].iter().all(|t| t.abs() < 1e-12), "no twisting moment");
    gradient
}

/// The equations of every scheme (backward Euler: the paper's, section 3) as they are printed, with all their
/// blocks and the gradient taken from the public energy.
#[test]
fn the_step_solves_the_papers_equations() {
    let (n, h, alpha) = (10, 0.02, 0.8);
    let drive = |t: f64| [0.1 * (5.0 * t).sin(), 0.05 * t, 0.0];
    for scheme in [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2] {
        let step = hanging(n, drive, Damping { stiffness: 0.0, mass: alpha }).into_inner();
        let mut model = ImplicitModel::new(step.with_scheme(scheme), 0, h);
        let mut x = vec![0.0; model.dim()];
        model.initial_state(&at_rest(&model), &mut x).unwrap();
        let own = model.control_dim();
        let mut before = vec![f64::NAN; own];
        for k in 0..20 {
            let mut next = vec![0.0; x.len()];
            model.step(k, &x, &mut next).unwrap();
            // (rate of x, x and time at which forces are taken)
            let (rate, at, time): (Vec<f64>, Vec<f64>, f64) = match scheme {
                Scheme::Bdf2 if k > 0 => (
                    (0..own).map(|i| (3.0 * next[i] - 4.0 * x[i] + before[i]) / (2.0 * h)).collect(),
                    next[..own].to_vec(),
                    h * (k + 1) as f64,
                ),
                Scheme::BackwardEuler => (
                    (0..own).map(|i| (next[i] - x[i]) / h).collect(),
                    next[..own].to_vec(),
                    h * (k + 1) as f64,
                ),
                Scheme::Midpoint | Scheme::Bdf2 => (
                    (0..own).map(|i| (next[i] - x[i]) / h).collect(),
                    (0..own).map(|i| 0.5 * (next[i] + x[i])).collect(),
                    h * (k as f64 + 0.5),
                ),
            };
            let vertices = model.step_mut().vertices(time, &at).unwrap();
            let rod = model.step_ref().rod().clone();
            let gradient = elastic_gradient(&rod, &vertices);
            for (i, &v) in model.step_ref().free_vertices().iter().enumerate() {
                for c in 0..3 {
                    let (place, speed) = (3 * i + c, own / 2 + 3 * i + c);
                    let g1 = h * (rate[place] - at[speed]);
                    let weight = if c == 2 { -9.81 * rod.masses[v] } else { 0.0 };
                    let force = gradient[3 * v + c] + alpha * rod.masses[v] * at[speed] - weight;
                    let g2 = h * (rod.masses[v] * rate[speed] + force);
                    // Four places of 1 m are rounded to 1e-15. The last Newton update is below 1e-11 m;
                    // springs of EA/l̄ = 3e3 N/m over 0.02 s turn that into 1e-9 N s.
                    assert!(
                        g1.abs() <= 5e-15 && g2.abs() <= 1e-9,
                        "{scheme:?}, step {k}, vertex {v}: {g1:e}, {g2:e}"
                    );
                }
            }
            before.copy_from_slice(&x[..own]);
            x = next;
        }
    }
}

#[test]
fn a_clamp_that_jumps_several_segments_is_followed() {
    // 400 segments of 2.5 mm; the clamp moves by up to 6.3 mm, 2.5 segments, in a step of 0.02 s.
    let drive = |t: f64| {
        [0.1 * (1.0 - (std::f64::consts::PI * t).cos()), 0.05 * (2.0 * std::f64::consts::PI * t).sin(), 0.0]
    };
    let mut model = hanging(400, drive, Damping::default());
    let mut x = at_rest(&model);
    for k in 0..50 {
        let mut next = vec![0.0; x.len()];
        model.step(k, &x, &mut next).unwrap_or_else(|e| panic!("{e}"));
        x = next;
    }
    let half = x.len() / 2;
    let tip = [x[half - 3], x[half - 2], x[half - 1]];
    assert!(tip[2] < -0.8 && tip[0].abs() < 0.5, "{tip:?}");
}

#[test]
fn impossible_input_is_named() {
    let material = Material::new(1e6, 0.5, 1100.0);
    let section = Section::circle(&material, 0.01);
    assert!(matches!(Rod::uniform(-1.0, 5, &section), Err(Error::Value { field: "rod length", .. })));
    assert!(matches!(Rod::uniform(1.0, 0, &section), Err(Error::Value { field: "segments", .. })));
    assert!(matches!(Rod::uniform(1.0, 5, &Section::circle(&material, f64::NAN)), Err(Error::Value { .. })));
    let rod = Rod::uniform(1.0, 5, &section).unwrap();
    assert!(matches!(rod.place("marker", 1.2), Err(Error::OffRod { .. })));
    let twice = Supports {
        prescribed: vec![(1, Arc::new([0.0; 3]))],
        ..Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]))
    };
    assert!(matches!(
        RodStep::new(rod.clone(), twice, Loads::default(), Damping::default()),
        Err(Error::Support { vertex: 1, .. })
    ));
    let along =
        Supports::clamped_start(Clamp::new(ClampAt::Edge, [0.0; 3], [0.0, 0.0, -1.0], [0.0, 0.0, 2.0]));
    assert!(matches!(
        RodStep::new(rod, along, Loads::default(), Damping::default()),
        Err(Error::Value { field: "a clamp's director", .. })
    ));
}

#[test]
fn a_fold_or_a_nan_is_an_error_that_names_the_step() {
    let mut model = hanging(10, [0.0; 3], Damping::default());
    let mut x = at_rest(&model);
    let mut next = vec![0.0; x.len()];
    x[2] = f64::NAN;
    assert!(matches!(
        model.step(7, &x, &mut next),
        Err(StepError::Refused { step: 7, .. } | StepError::NonFinite { step: 7, .. })
    ));
}
