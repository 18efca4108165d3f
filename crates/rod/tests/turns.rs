//! Whole turns of an end clamp are part of the state: they are neither lost nor found.

use std::f64::consts::TAU;

use varda_implicit::{ImplicitModel, Model, Scheme, check};
use varda_rod::{Clamp, ClampAt, Damping, Loads, Rod, RodStep, Search, Section, Supports, Vector3, rest};

const SCHEMES: [Scheme; 3] = [Scheme::BackwardEuler, Scheme::Midpoint, Scheme::Bdf2];
const GJ: f64 = 1e-5;

/// Straight between two clamps, the end clamp turned within a second; soft in twist, so that it does not
/// buckle.
fn twisted(segments: usize, turns: f64, softest: f64, damping: f64, scheme: Scheme) -> RodStep {
    let section = Section { ea: 1e3, ei1: 1e-3, ei2: 1e-3, gj: GJ, mass_per_length: 0.1 };
    let mut rod = Rod::uniform(1.0, segments, &section).unwrap();
    *rod.gj.last_mut().unwrap() *= softest;
    let end = Clamp::new(ClampAt::Edge, Vector3::x(), Vector3::x(), Vector3::z());
    let supports = Supports {
        start: Some(Clamp::new(ClampAt::Edge, Vector3::zeros(), Vector3::x(), Vector3::z())),
        end: Some(end.with_turns(move |t| turns * t.clamp(0.0, 1.0))),
        ..Supports::default()
    };
    let damping = Damping { stiffness: damping, mass: 0.0 };
    RodStep::new(rod, supports, Loads::default(), damping).unwrap().with_scheme(scheme)
}

fn straight(step: &RodStep) -> Vec<f64> {
    let mut z = vec![0.0; step.control_len()];
    let n = step.rod().segments() as f64;
    step.free_vertices().iter().enumerate().for_each(|(f, &v)| z[3 * f] = v as f64 / n);
    z
}

fn run(step: RodStep, first: usize, length: f64, steps: usize) -> Result<Vec<f64>, varda_implicit::Error> {
    let z = straight(&step);
    let mut model = ImplicitModel::new(step, first, length);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x)?;
    let mut next = x.clone();
    for k in 0..steps {
        model.step(k, &x, &mut next)?;
        std::mem::swap(&mut x, &mut next);
    }
    Ok(x)
}

/// Free angles, then that of the end clamp.
fn angles(x: &[f64], segments: usize) -> &[f64] {
    let free = segments - 3;
    &x[6 * free..6 * free + segments - 1]
}

#[test]
fn driven_turns_stay_and_have_their_moment() {
    for (segments, turns) in [(5, 3.0), (4, 8.0), (6, -2.25)] {
        for damping in [0.0, 0.01] {
            for scheme in SCHEMES {
                // driven for a second, held for another; then a window that begins after the drive
                let step = || twisted(segments, turns, 1.0, damping, scheme);
                let through = run(step(), 0, 0.01, 200).unwrap();
                let after = run(step(), 150, 0.01, 50).unwrap();
                for x in [through, after] {
                    let angles = angles(&x, segments);
                    for (e, angle) in angles.iter().enumerate() {
                        let expected = TAU * turns * (e + 1) as f64 / (segments - 1) as f64;
                        let bound = if e + 2 == segments { 1e-12 } else { 1e-3 };
                        let off = (angle - expected).abs();
                        assert!(off <= bound, "{segments} {turns} {damping} {scheme:?}: {angle}");
                    }
                    // GJ 2π turns / L, between the middles of the held edges
                    let l = 1.0 / segments as f64;
                    let moment = GJ * (angles[segments - 2] - angles[segments - 3]) / l;
                    let expected = GJ * TAU * turns / (1.0 - l);
                    assert!((moment / expected - 1.0).abs() <= 1e-4, "{moment} {expected}");
                }
            }
        }
    }
}

#[test]
fn a_soft_last_vertex_keeps_them() {
    for scheme in SCHEMES {
        let (n, turns, soft) = (5, 1.0, 1e-3);
        let x = run(twisted(n, turns, soft, 0.0, scheme), 0, 0.01, 150).unwrap();
        let angles = angles(&x, n);
        let expected = TAU * turns / (n as f64 - 2.0 + 1.0 / soft);
        assert!((angles[0] / expected - 1.0).abs() <= 1e-3, "{scheme:?}: {}", angles[0]);
        assert!((angles[n - 2] - TAU).abs() <= 1e-12);
    }
}

#[test]
fn a_rod_at_rest_has_the_turns_of_its_clamps() {
    let step = twisted(5, 3.0, 1.0, 0.0, Scheme::BackwardEuler);
    let found = rest(step.rod(), step.supports(), &Loads::default(), 2.0, &Search::default()).unwrap();
    assert!((found.rest.theta[4] - 3.0 * TAU).abs() <= 1e-12);
    // handed to a run that starts before the drive
    let step = step.starting_from(&found.rest, 2.0);
    let z = straight(&step);
    let mut model = ImplicitModel::new(step, 0, 0.01);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x).unwrap();
    assert!(angles(&x, 5).iter().all(|angle| angle.abs() <= 1e-12));
}

#[test]
fn a_clamp_that_turns_too_far_in_a_step_is_an_error() {
    let error = run(twisted(5, 3.0, 1.0, 0.0, Scheme::BackwardEuler), 0, 0.1, 1).unwrap_err();
    assert!(error.to_string().contains("a clamp turns by 1.885 rad in the step from t = 0 s"), "{error}");
    run(twisted(5, 3.0, 1.0, 0.0, Scheme::BackwardEuler), 0, 0.08, 1).unwrap();
}

#[test]
fn tangents_and_adjoints_are_exact() {
    for scheme in SCHEMES {
        for damping in [0.0, 0.01] {
            let step = twisted(7, 2.0, 1.0, damping, scheme);
            let mut z = straight(&step);
            let half = z.len() / 2;
            for (i, z) in z[..half].iter_mut().enumerate() {
                *z += 0.005 * (1.0 + 3.0 * i as f64).sin();
            }
            let mut model = ImplicitModel::new(step, 0, 0.01);
            let mut x = vec![0.0; model.dim()];
            model.initial_state(&z, &mut x).unwrap();
            let mut next = x.clone();
            for k in 0..3 {
                model.step(k, &x, &mut next).unwrap();
                std::mem::swap(&mut x, &mut next);
            }
            let mut scale = vec![0.001; half];
            scale.resize(2 * half, 0.1);
            scale.resize(2 * half + 6, 0.01);
            scale.extend_from_within(..x.len() - scale.len());
            for finding in check::conformance(&mut model, 3, &x, &scale, 3).unwrap() {
                assert!(finding.value <= finding.bound, "{scheme:?} {damping}: {finding:?}");
            }
            // the initial map, angles and the end clamp's included
            model.initial_state(&z, &mut x).unwrap();
            let (dz, lambda): (Vec<f64>, Vec<f64>) = (
                (0..z.len()).map(|i| (5.0 * i as f64).cos()).collect(),
                (0..x.len()).map(|i| (3.0 * i as f64).sin()).collect(),
            );
            let (mut dx, mut back) = (vec![0.0; x.len()], vec![0.0; z.len()]);
            model.initial_tangent(&dz, &mut dx);
            model.initial_adjoint(&lambda, &mut back);
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            assert!((dot(&lambda, &dx) - dot(&back, &dz)).abs() <= 1e-10 * dot(&dx, &dx).sqrt());
            let end = 2 * half + 5;
            let mut at = |h: f64| {
                let z: Vec<f64> = z.iter().zip(&dz).map(|(z, d)| z + h * d).collect();
                model.initial_state(&z, &mut x).unwrap();
                x[end]
            };
            let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!(
                (difference - dx[end]).abs() <= 1e-6 * dx[end].abs().max(1.0),
                "{difference} {}",
                dx[end]
            );
        }
    }
}

/// How the end clamp's angle after a step depends on the state before, against differences; and one entry of
/// that which is wrong.
#[test]
fn a_wrong_entry_for_the_end_clamps_angle_is_caught() {
    for scheme in SCHEMES {
        let step = twisted(7, 2.0, 1.0, 0.0, scheme);
        let mut z = straight(&step);
        let half = z.len() / 2;
        for (i, z) in z.iter_mut().enumerate() {
            *z += if i < half { 0.005 } else { 0.1 } * (1.0 + 3.0 * i as f64).sin();
        }
        let mut model = ImplicitModel::new(step, 0, 0.01);
        let (mut x, mut next) = (vec![0.0; model.dim()], vec![0.0; model.dim()]);
        model.initial_state(&z, &mut x).unwrap();
        for k in 0..3 {
            model.step(k, &x, &mut next).unwrap();
            std::mem::swap(&mut x, &mut next);
        }
        model.step(3, &x, &mut next).unwrap();
        model.linearize(0, 3, &x, &next).unwrap();
        let end = 2 * half + 5;
        let mut row = vec![0.0; x.len()];
        row[end] = 1.0;
        model.adjoint(0, &mut row);
        let dx: Vec<f64> =
            (0..x.len()).map(|i| if i < half { (5.0 * i as f64).cos() } else { 0.0 }).collect();
        let mut at = |h: f64| {
            let moved: Vec<f64> = x.iter().zip(&dx).map(|(x, d)| x + h * d).collect();
            model.step(3, &moved, &mut next).unwrap();
            next[end]
        };
        let difference = (at(1e-5) - at(-1e-5)) / 2e-5;
        let off = |row: &[f64]| {
            let slope: f64 = row.iter().zip(&dx).map(|(r, d)| r * d).sum();
            (slope / difference - 1.0).abs()
        };
        // central differences: h² of the bends, and a step's end of 1e-11 L over h
        assert!(off(&row) <= 1e-5, "{scheme:?}: {:e} of {difference}", off(&row));
        let largest = (0..half).max_by(|&i, &j| (row[i] * dx[i]).abs().total_cmp(&(row[j] * dx[j]).abs()));
        row[largest.unwrap()] *= 1.001;
        assert!(off(&row) > 5e-5, "{scheme:?}: a wrong entry is not seen: {:e}", off(&row));
    }
}

/// An angle that a state had leads a control to that state's angles again, whatever the clamps say.
#[test]
fn a_control_with_its_end_angle_is_the_state_it_was_taken_from() {
    let (n, turns) = (6, 3.0);
    let step = || twisted(n, turns, 1.0, 0.0, Scheme::BackwardEuler);
    let x = run(step(), 0, 0.01, 150).unwrap();
    let own = step().end_angle(&x).unwrap();
    assert!((own - TAU * turns).abs() < 0.1, "{own}");
    // a clamp that says nothing of its turns, started where the other one is
    let again = twisted(n, 0.0, 1.0, 0.0, Scheme::BackwardEuler).with_end_angle(own, 1.5);
    let mut started = vec![0.0; x.len()];
    let z = &x[..again.control_len()];
    let mut model = again.model(150, 0.01);
    model.initial_state(z, &mut started).unwrap();
    let off = started.iter().zip(&x).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // the angles of x are those of a motion that has come to rest
    assert!(off < 1e-6, "{off}: {started:?} {x:?}");
}
