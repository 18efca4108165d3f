//! What a product with second derivatives costs beside one of Gauss and Newton, of rods in a fluid.

mod common;

use std::sync::Arc;
use std::time::{Duration, Instant};

use common::noise;
use varda_implicit::{ImplicitModel, Model, Scheme};
use varda_rod::{
    Clamp, ClampAt, Damping, Drag, Loads, Material, Rod, RodStep, Section, Supports, Vector3, straight_guess,
};

const STEPS: usize = 20;
/// On a machine that does other things too, the least of so many.
const SAMPLES: usize = 30;

fn model(curved: bool) -> (ImplicitModel<RodStep>, Vec<f64>) {
    let rod = Rod::uniform(1.0, 40, &Section::circle(&Material::new(1e6, 0.5, 1100.0), 0.01)).unwrap();
    let rod = if curved { rod.naturally([0.5, -0.3], 0.8) } else { rod };
    let clamp = Clamp::new(ClampAt::Edge, [0.0; 3], -Vector3::z(), Vector3::x());
    let drag = Drag { flow: Vector3::new(0.6, -0.2, 0.4), tangential: 0.3, ..Drag::of(1000.0, 0.02) };
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let loads = Loads { gravity, of_motion: vec![Arc::new(drag)], ..Loads::default() };
    let supports = Supports::clamped_start(clamp);
    let step = RodStep::new(rod, supports, loads, Damping::default()).unwrap().with_scheme(Scheme::Bdf2);
    let guess = straight_guess(step.rod(), step.supports(), 0.0, gravity).unwrap();
    let z = step.control_at_rest(&guess);
    (ImplicitModel::new(step, 0, 0.01), z)
}

fn least(mut run: impl FnMut()) -> Duration {
    let once = |_| {
        let start = Instant::now();
        run();
        start.elapsed()
    };
    (0..SAMPLES).map(once).min().unwrap()
}

/// At most 2.5 products of Gauss and Newton, once the matrices of a point are there.
#[test]
fn an_exact_product_costs_at_most_two_and_a_half_of_gauss_and_newton() {
    for curved in [false, true] {
        let (mut model, z) = model(curved);
        let n = Model::dim(&model);
        let mut states = vec![vec![0.0; n]; STEPS + 1];
        model.initial_state(&z, &mut states[0]).unwrap();
        for k in 0..STEPS {
            let (past, next) = states.split_at_mut(k + 1);
            model.step(k, &past[k], &mut next[0]).unwrap();
        }
        let linearized = least(|| {
            (0..STEPS).for_each(|k| drop(model.linearize(k, k, &states[k], &states[k + 1]).unwrap()));
        });
        let mut path = vec![noise(3).take(n).collect::<Vec<f64>>(); STEPS + 1];
        let lambdas: Vec<Vec<f64>> = (0..STEPS).map(|k| noise(10 + k).take(n).collect()).collect();
        let mut back = vec![0.0; n];
        let gauss_newton = least(|| {
            let mut dx = path[0].clone();
            (0..STEPS).for_each(|k| model.tangent(k, &mut dx));
            back.copy_from_slice(&lambdas[0]);
            (0..STEPS).rev().for_each(|k| model.adjoint(k, &mut back));
        });
        let second = model.second_order().unwrap();
        let mut product = || {
            for k in 0..STEPS {
                let (past, next) = path.split_at_mut(k + 1);
                next[0].copy_from_slice(&past[k]);
                second.tangent_kept(k, &mut next[0]);
            }
            back.fill(0.0);
            for k in (0..STEPS).rev() {
                second.adjoint_derivative(k, &path[k], &lambdas[k], &mut back).unwrap();
            }
        };
        let start = Instant::now();
        product();
        let first = start.elapsed();
        let exact = least(product);
        let ratio = exact.as_secs_f64() / gauss_newton.as_secs_f64();
        assert!(
            ratio <= 2.5,
            "curved {curved}: A p {gauss_newton:?}, exact {exact:?}, ratio {ratio:.2}; matrices {first:?}, \
             linearizations {linearized:?}"
        );
    }
}
