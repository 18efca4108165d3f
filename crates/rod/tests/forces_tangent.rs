//! The tangent of the forces within a rod against differences, for rods of every kind.

mod common;

use std::sync::Arc;

use common::{difference, noise, off};
use varda_implicit::{ImplicitModel, Model, Scheme};
use varda_rod::{
    Clamp, ClampAt, Damping, Drag, FollowerForce, InternalForces, Loads, Material, Moment, Rod, RodStep,
    Section, Supports, Vector3, straight_guess,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
const STEP: f64 = 0.004;

fn rod() -> Rod {
    Rod::uniform(0.8, 8, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)).unwrap()
}

fn clamp(x: f64, z: f64) -> Clamp {
    let place = move |t: f64| [x + 0.05 * (8.0 * t).sin(), 0.02 * t, z];
    Clamp::new(ClampAt::Face, place, |t: f64| [0.2 * (3.0 * t).sin(), 0.0, -1.0], [1.0, 0.0, 0.0])
}

fn between() -> Supports {
    Supports { end: Some(clamp(0.1, -0.76)), ..Supports::clamped_start(clamp(0.0, 0.0)) }
}

fn hooks() -> Supports {
    let at = |x: f64| Arc::new(move |t: f64| [x + 0.02 * t, 0.0, 0.0]);
    Supports { prescribed: vec![(0, at(0.0)), (5, at(0.4))], ..Supports::default() }
}

/// Rods by name: twist-free, twisting, damped, held at both ends, hung from points, a chain, in a flow,
/// turned by moments.
fn steps() -> Vec<(&'static str, RodStep)> {
    let gravity = || Loads { gravity: GRAVITY, ..Loads::default() };
    let damped = Damping { stiffness: 0.01, mass: 0.3 };
    let curved = || rod().naturally([0.5, -0.3], 0.8);
    let clamped = || Supports::clamped_start(clamp(0.0, 0.0));
    let ended = Supports { end: Some(clamp(0.0, -0.8)), ..Supports::default() };
    let chain =
        Section { ei1: 0.0, ei2: 0.0, gj: 0.0, ..Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01) };
    let chain = Rod::uniform(0.8, 8, &chain).unwrap();
    let drag = Drag { flow: Vector3::new(0.6, -0.2, 0.4), tangential: 0.3, ..Drag::of(1000.0, 0.02) };
    let follower = FollowerForce::new(&rod(), 0.0, |t: f64| [0.3 + t, -0.2, 0.25]).unwrap();
    let flow = Loads { of_motion: vec![Arc::new(drag), Arc::new(follower)], ..gravity() };
    let bend = Moment::new(&rod(), 0.45, |t: f64| [0.03, -0.05 - t, 0.04]).unwrap();
    let twist = Moment::about_tangent(&rod(), 0.75, |_| 0.03).unwrap();
    let turned = Loads { of_motion: vec![Arc::new(bend), Arc::new(twist)], ..gravity() };
    let of = |rod, supports, loads, damping| RodStep::new(rod, supports, loads, damping).unwrap();
    vec![
        ("twist-free", of(rod(), clamped(), gravity(), Damping::default())),
        ("twist-free, held at its end", of(rod(), ended, gravity(), Damping::default())),
        ("curved", of(curved(), clamped(), gravity(), Damping::default())),
        ("damped", of(curved(), clamped(), gravity(), damped).with_scheme(Scheme::Bdf2)),
        ("between two clamps", of(rod(), between(), gravity(), damped)),
        ("hung from points", of(curved(), hooks(), gravity(), damped)),
        ("a damped chain", of(chain, hooks(), gravity(), damped)),
        ("in a flow", of(curved(), clamped(), flow.clone(), Damping::default())),
        ("in a flow, hung from points", of(rod(), hooks(), flow, damped)),
        ("turned", of(curved(), clamped(), turned.clone(), Damping::default())),
        ("turned between two clamps", of(rod(), between(), turned, damped)),
    ]
}

fn numbers(mut forces: InternalForces) -> Vec<f64> {
    forces.numbers().map(|v| *v).collect()
}

/// Two states of a run from a shape with 20 mm and 0.5 m/s of noise.
fn states(step: RodStep) -> (RodStep, [Vec<f64>; 2]) {
    let guess = straight_guess(step.rod(), step.supports(), 0.0, GRAVITY).unwrap();
    let mut z = step.control_at_rest(&guess);
    let half = z.len() / 2;
    z.iter_mut()
        .zip(noise(1))
        .enumerate()
        .for_each(|(i, (z, e))| *z += if i < half { 0.02 } else { 0.5 } * e);
    let mut model = ImplicitModel::new(step, 0, STEP);
    let mut x = vec![0.0; model.dim()];
    model.initial_state(&z, &mut x).unwrap();
    let mut next = x.clone();
    for k in 0..3 {
        x.copy_from_slice(&next);
        model.step(k, &x, &mut next).unwrap();
    }
    (model.into_inner(), [x, next])
}

#[test]
fn it_is_the_derivative_of_the_forces_for_rods_of_every_kind() {
    for (name, step) in steps() {
        let (mut step, [before, now]) = states(step);
        let n = now.len();
        // of both states, and of each alone
        for seed in 0..3 {
            let mut dx: Vec<f64> = noise(5 + seed).take(2 * n).collect();
            match seed {
                1 => dx[..n].fill(0.0),
                2 => dx[n..].fill(0.0),
                _ => {}
            }
            let both: Vec<f64> = [before.clone(), now.clone()].concat();
            let (t, then) = (3.0 * STEP, 2.0 * STEP);
            let by_difference = difference(&both, &dx, 1e-5, |both| {
                numbers(step.internal_forces(t, &both[n..], (then, &both[..n])).unwrap())
            });
            let mut tangent = Vec::new();
            let columns = [&dx[n..], &dx[..n], &[]];
            step.internal_forces_tangent(t, &now, (then, &before), columns, &mut |f| {
                tangent.extend(f.numbers().map(|v| *v));
            })
            .unwrap();
            assert_eq!(tangent.len(), by_difference.len());
            let (error, size) = off(&tangent, &by_difference);
            // rounding of differences over 1e-5: 1e-16 EA/l of 3e3 N/m against some 1e3 N
            assert!(error <= 1e-7 * size, "{name}, {seed}: off by {error:e} of {size:e}");
            if size > 0.0 {
                let largest =
                    (0..tangent.len()).max_by(|a, b| tangent[*a].abs().total_cmp(&tangent[*b].abs()));
                tangent[largest.unwrap()] *= 1.001;
                let (error, size) = off(&tangent, &by_difference);
                assert!(error > 1e-4 * size, "{name}: a wrong entry is not seen");
            }
        }
    }
}
