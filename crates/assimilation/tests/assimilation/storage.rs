//! The strong-constraint cost under every storage policy: the same bits, bounded memory, the optimal number
//! of steps.

use crate::cost::coupled;
use crate::models::*;
use varda_assimilation::*;
use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{ImplicitModel, Model, OneLeg, Rk4, Storage};

const N: usize = 6;
const LAST: usize = 20;

fn observations(rows: &[usize], steps: &[usize]) -> ObservationSet {
    let values = normals(6, rows.len() * steps.len());
    let seen = steps.iter().zip(values.chunks_exact(rows.len())).enumerate();
    let list = seen.map(|(i, (&step, values))| {
        let weight = if step < LAST { [0.0, 0.4][i % 2] } else { 0.0 };
        observation(rows, step, weight, values, 0.7)
    });
    ObservationSet::new(LAST, vec![all_of(N)], list.collect()).unwrap()
}

/// Bits of J, gradient, a product, the dense Hessian and G and its transpose at two controls, with trials in
/// between.
fn bits(cost: &mut StrongConstraint) -> Vec<u64> {
    let (n, m) = (cost.dim(), cost.observation_dim());
    let mut bits = Vec::new();
    let mut keep = |values: &[f64]| bits.extend(values.iter().map(|v| v.to_bits()));
    for seed in [7, 8] {
        let (v, dv, w) = (normals(seed, n), normals(seed + 20, n), normals(seed + 30, m));
        let (mut g, mut dy, mut hessian) = (vec![0.0; n], vec![0.0; m], vec![0.0; n * n]);
        if seed == 8 {
            // as a line search has it: first the value, then the gradient there
            keep(&[cost.evaluate(&v, None).unwrap()]);
        }
        keep(&[cost.evaluate(&v, Some(&mut g)).unwrap()]);
        keep(&g);
        // a trial that is rejected
        keep(&[cost.evaluate(&dv, None).unwrap()]);
        cost.hessian_apply(&dv, &mut g).unwrap();
        keep(&g);
        cost.jacobian_transpose(&w, &mut g).unwrap();
        keep(&g);
        cost.jacobian(&dv, &mut dy).unwrap();
        keep(&dy);
        cost.hessian(&mut hessian).unwrap();
        keep(&hessian);
        keep(&[cost.evaluate(&v, Some(&mut g)).unwrap()]);
        keep(&g);
    }
    bits
}

#[test]
fn every_policy_gives_the_same_bits_within_its_bytes() {
    let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
    let b = coupled(N, 0.5);
    let make: [fn() -> Box<dyn Model>; 2] = [
        || Box::new(Rk4::new(Lorenz96::new(N, 8.0), 0, 0.03)),
        || Box::new(ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(N, 8.0), 1e-11), 0, 0.03)),
    ];
    for make in make {
        let mut reference = None;
        let mut held = Vec::new();
        for storage in [
            Storage::KeepAll,
            Storage::States,
            Storage::Checkpoints { states: 5 },
            Storage::Checkpoints { states: 1 },
        ] {
            let mut model = make();
            let mut set = observations(&[0, 3], &[0, 5, 12, LAST]);
            let transform = ControlTransform::new(background.clone(), &b).unwrap();
            let mut cost = StrongConstraint::new(&mut *model, transform, &mut set).unwrap();
            cost.set_storage(storage);
            assert_eq!(cost.storage(), storage);
            let found = bits(&mut cost);
            assert!(reference.get_or_insert_with(|| found.clone()) == &found, "{storage:?}");
            held.push(cost.bytes());
            // again at the first control, after everything: no trace
            assert!(bits(&mut cost) == found, "{storage:?}");
            assert_eq!(held.last(), Some(&cost.bytes()));
        }
        assert!(held.windows(2).all(|pair| pair[1] < pair[0]), "{held:?}");
    }
}

#[test]
fn a_gradient_runs_the_optimal_number_of_steps_whether_or_not_the_point_was_tried_before() {
    let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
    let b = coupled(N, 0.5);
    for states in [1, 2, 4, 30] {
        let storage = Storage::Checkpoints { states };
        let mut model = Rk4::new(Lorenz96::new(N, 8.0), 0, 0.03);
        let mut set = observations(&[0, 3], &[0, 5, 12, LAST]);
        let transform = ControlTransform::new(background.clone(), &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        cost.set_storage(storage);
        let mut g = vec![0.0; N];
        cost.evaluate(&normals(7, N), Some(&mut g)).unwrap();
        assert_eq!(cost.counts().model.model_steps, storage.executed_steps(LAST));
        cost.evaluate(&normals(8, N), None).unwrap();
        cost.evaluate(&normals(8, N), Some(&mut g)).unwrap();
        assert_eq!(cost.counts().model.model_steps, 2 * storage.executed_steps(LAST));
        cost.hessian_apply(&normals(9, N), &mut g).unwrap();
        assert_eq!(cost.counts().model.model_steps, 3 * storage.executed_steps(LAST));
        assert_eq!(cost.counts().model.linearizations, 4 * LAST);
    }
}

#[test]
fn a_budget_of_bytes_picks_the_policy_and_holds() {
    let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
    let b = coupled(N, 0.5);
    let mut model = Rk4::new(Lorenz96::new(N, 8.0), 0, 0.03);
    let mut set = observations(&[0, 3], &[0, 5, 12, LAST]);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let mut chosen = Vec::new();
    for bytes in [10_000, 3_000, 1_000] {
        chosen.push(cost.set_memory(bytes).unwrap());
        bits(&mut cost);
        assert!(cost.bytes() <= bytes, "{} of {bytes}", cost.bytes());
    }
    assert!(matches!(
        chosen[..],
        [Storage::KeepAll, Storage::States, Storage::Checkpoints { states: 2..=8 }]
    ));
    let error = cost.set_memory(100).unwrap_err();
    assert!(matches!(error, Error::Model(varda_implicit::Error::Memory { budget: 100, .. })), "{error}");
}

#[test]
fn the_dense_hessian_takes_rows_or_columns_whichever_are_fewer_and_is_that_of_the_products() {
    let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
    let b = coupled(N, 0.5);
    // steps of tangents for columns: N LAST = 120
    for (rows, steps, tangents, adjoints) in [
        (vec![0, 3], vec![0, 5, 12, LAST], 0, 2 * (6 + 12 + LAST)),
        (vec![0, 1, 2, 3, 4, 5], vec![4, 9, 15, LAST], N * LAST, 0),
    ] {
        let mut model = ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(N, 8.0), 1e-11), 0, 0.03);
        let mut set = observations(&rows, &steps);
        let transform = ControlTransform::new(background.clone(), &b).unwrap();
        let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
        let (mut g, mut hessian) = (vec![0.0; N], vec![0.0; N * N]);
        cost.evaluate(&normals(7, N), Some(&mut g)).unwrap();
        let before = cost.counts().model;
        cost.hessian(&mut hessian).unwrap();
        let after = cost.counts().model;
        assert_eq!(after.tangent_steps - before.tangent_steps, tangents);
        assert_eq!(after.adjoint_steps - before.adjoint_steps, adjoints);
        for (j, column) in hessian.chunks_exact(N).enumerate() {
            let mut unit = vec![0.0; N];
            unit[j] = 1.0;
            cost.hessian_apply(&unit, &mut g).unwrap();
            // two orders of the same sums of numbers of the size of the largest column
            let size = norm(&hessian);
            assert!(column.iter().zip(&g).all(|(a, b)| (a - b).abs() <= 1e-13 * size));
        }
    }
}
