//! The dense Hessian shared with workers: the same bits, all work counted, failures named.

use crate::cost::coupled;
use crate::models::*;
use varda_assimilation::*;
use varda_implicit::lorenz::Lorenz96;
use varda_implicit::{Counts, ImplicitModel, Model, OneLeg, Rk4, Storage};

const N: usize = 40;
const LAST: usize = 12;

type Make = fn() -> Box<dyn Model + Send>;

/// Few rows, most of them late: G by rows, their number growing on the way down. Many: G by columns.
const FEW: (&[usize], &[usize]) = (&[0, 1, 2, 7, 13, 20, 21, 22, 30], &[5, 9, LAST]);
const MANY: (&[usize], &[usize]) = (&[0, 1, 2, 3, 5, 7, 8, 9, 13, 20, 21, 22, 30, 39], &[2, 6, 9, 10, LAST]);

fn midpoint() -> Box<dyn Model + Send> {
    Box::new(ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(N, 8.0), 1e-11), 0, 0.03))
}

fn explicit() -> Box<dyn Model + Send> {
    Box::new(Rk4::new(Lorenz96::new(N, 8.0), 0, 0.03))
}

/// A as bits with so many workers, and the work it took.
fn hessian(
    make: Make,
    (rows, steps): (&[usize], &[usize]),
    storage: Storage,
    workers: (Make, usize),
) -> Result<(Vec<u64>, Counts), Error> {
    let background: Vec<f64> = normals(5, N).iter().map(|x| 2.0 + 2.0 * x).collect();
    let b = coupled(N, 0.5);
    let values = normals(6, rows.len());
    let seen = steps.iter().map(|&step| observation(rows, step, 0.0, &values, 0.7)).collect();
    let mut set = ObservationSet::new(LAST, vec![all_of(N)], seen).unwrap();
    let mut model = make();
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut *model, transform, &mut set).unwrap();
    cost.set_storage(storage);
    cost.set_workers(&workers.0, workers.1)?;
    cost.evaluate(&normals(7, N), Some(&mut vec![0.0; N])).unwrap();
    let before = cost.counts().model;
    let mut out = vec![0.0; N * N];
    cost.hessian(&mut out)?;
    let work = cost.counts().model - before;
    // workers that go leave their work behind
    cost.set_workers(&workers.0, 0).unwrap();
    assert_eq!(cost.counts().model - before, work);
    Ok((out.iter().map(|a| a.to_bits()).collect(), work))
}

#[test]
fn the_same_bits_for_any_number_of_workers_and_threads() {
    for make in [midpoint as Make, explicit] {
        for seen in [FEW, MANY] {
            for storage in [Storage::KeepAll, Storage::States, Storage::Checkpoints { states: 3 }] {
                let (alone, of_one) = hessian(make, seen, storage, (make, 0)).unwrap();
                for threads in [1, 2, 3, 5] {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    for count in [1, 2, 4] {
                        let shared = pool.install(|| hessian(make, seen, storage, (make, count)));
                        let (bits, work) = shared.unwrap();
                        assert!(bits == alone, "{threads} threads, {count} workers, {storage:?}");
                        assert_eq!(work.tangent_steps, of_one.tangent_steps);
                        assert_eq!(work.adjoint_steps, of_one.adjoint_steps);
                    }
                }
            }
        }
    }
}

/// 40 columns are three blocks of sixteen or less: a second and a third model have work, a fourth has none.
#[cfg(feature = "rayon")]
#[test]
fn every_worker_linearizes_for_itself_and_its_work_is_counted() {
    for (count, busy) in [(1, 1), (2, 2), (3, 2)] {
        let (_, work) = hessian(midpoint, MANY, Storage::KeepAll, (midpoint, count)).unwrap();
        assert_eq!((work.tangent_steps, work.adjoint_steps), (N * LAST, 0));
        assert_eq!((work.linearizations, work.factorizations), (busy * LAST, busy * LAST));
    }
}

#[cfg(feature = "rayon")]
#[test]
fn what_fails_in_a_worker_is_an_error_that_names_the_step() {
    // Other steps than the model's: no state of the window is one of theirs.
    let other: Make =
        || Box::new(ImplicitModel::new(OneLeg::implicit_midpoint(Lorenz96::new(N, 8.0), 1e-11), 0, 0.05));
    for (seen, step) in [(FEW, 8), (MANY, 0)] {
        let error = hessian(midpoint, seen, Storage::KeepAll, (other, 2)).unwrap_err();
        assert!(
            matches!(error, Error::Model(varda_implicit::Error::NotAStep { step: k }) if k == step),
            "{error}"
        );
    }
    let small: Make = || Box::new(Rk4::new(Lorenz96::new(6, 8.0), 0, 0.03));
    let error = hessian(midpoint, FEW, Storage::KeepAll, (small, 1)).unwrap_err();
    assert!(matches!(error, Error::Length { expected: N, found: 6, .. }), "{error}");
}
