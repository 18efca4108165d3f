//! The posterior of a model that errs at every time of window and forecast.

use crate::cost::coupled;
use crate::family::ignore;
use crate::matrix::*;
use crate::models::*;
use varda_assimilation::*;
use varda_covariance::{Covariance, Diagonal};
use varda_implicit::Model;

const N: usize = 6;
const STEPS: usize = 20;
const SHOWN: usize = 37;

/// The columns around the minimum (or any other point, as the problem is linear), and the analysed states
/// with their forecast.
fn columns(q: &dyn Covariance, forcing: &Forcing, most: usize, seen: usize) -> (ErrorColumns, Vec<f64>) {
    let (mut model, background, mut set) = window(seen);
    let b = coupled(N, 0.8);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = WeakForcing::new(&mut model, transform.clone(), q, forcing.clone(), &mut set).unwrap();
    let v = normals(9, cost.dim());
    cost.linearize(&v, &mut vec![0.0; v.len()]).unwrap();
    let columns = WeakPosterior::new(&mut cost).unwrap().with_errors(&transform, q, most);
    let mut states: Vec<Vec<f64>> = (0..=STEPS).map(|k| cost.state(k).to_vec()).collect();
    drop(cost);
    states.extend(run(&mut model, &states[STEPS], SHOWN - STEPS).into_iter().skip(1));
    assert_eq!(states.len(), SHOWN + 1);
    (columns, states.concat())
}

/// Seen at four times, or every second step.
fn window(seen: usize) -> (Rk4<Linear>, Vec<f64>, ObservationSet) {
    let (model, background, set) = linear_window(N, STEPS);
    if seen == 4 {
        return (model, background, set);
    }
    let often = (0..seen).map(|j| observation(&[0, 2, 3], STEPS * j / (seen - 1), 0.0, &[0.1; 3], 0.3));
    (model, background, ObservationSet::new(STEPS, vec![all_of(N)], often.collect()).unwrap())
}

/// P_k, and cov(x_{k−1}, x_k), of every step.
fn carried(of: &ErrorColumns, forcing: &Forcing, q: &dyn Covariance, states: &[f64]) -> Vec<[Matrix; 2]> {
    let (mut out, mut model) = (Vec::new(), window(4).0);
    propagate_errors(&mut model, of, (forcing, q), states, &mut |at| {
        let product = |a: &[f64], b: &[f64]| {
            let columns = a.chunks(N).zip(b.chunks(N)).enumerate();
            let sign = |c: usize| if c < at.less { -1.0 } else { 1.0 };
            let columns: Vec<_> = columns.map(|(c, (a, b))| (sign(c), a, b)).collect();
            Matrix::new(N, N, |i, j| columns.iter().map(|(s, a, b)| s * a[i] * b[j]).sum())
        };
        let p = product(at.now, at.now);
        let (variance, now) = (at.variance(), p.clone());
        // differences of sums a thousand times as large, in another order
        (0..N).for_each(|i| assert!((variance[i] - now.at(i, i)).abs() <= 1e-11 * now.at(i, i).max(1.0)));
        let seen = at.of(&mut Selection::new(vec![4, 1], N).unwrap(), At { step: 0, time: 0.0 }, &[0.0; N]);
        assert_eq!(seen, [variance[4], variance[1]]);
        out.push([p, if at.step == 0 { Matrix::new(N, N, |_, _| 0.0) } else { product(at.before, at.now) }]);
        Ok(())
    })
    .unwrap();
    out
}

fn apart(a: &Matrix, b: &Matrix) -> f64 {
    let scale = b.by_columns().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
    a.minus(b).by_columns().iter().fold(0.0, |m: f64, x| m.max(x.abs())) / scale
}

/// An error in every step: the smoother of Rauch, Tung and Striebel, and the filter's forecast after it, by a
/// root of P and by the prior less what was learnt; with fewer values than unknowns and with more.
#[test]
fn it_is_the_kalman_smoothers_covariance_and_the_filters_forecast() {
    let (forcing, b, q) = (Forcing::every_step(N), coupled(N, 0.8), coupled(N, 0.3));
    for seen in [4, 11] {
        let (mut model, background, set) = window(seen);
        let step = step_matrix(&mut model, N);
        let (dense_b, dense_q) = (Matrix::of(&b), Matrix::of(&q));
        let (_, smoothed) = kalman(&step, &dense_b, Some(&dense_q), &background, &set, STEPS);
        let mut expected: Vec<Matrix> = smoothed.into_iter().map(|(_, p)| p).collect();
        for k in STEPS..SHOWN {
            expected.push(step.times(&expected[k]).times(&step.transpose()).plus(&dense_q));
        }
        for most in [0, 1000] {
            let (columns, states) = columns(&q, &forcing, most, seen);
            assert_eq!(columns.count()[0] > 0, most == 0);
            let found = carried(&columns, &forcing, &q, &states);
            assert_eq!(found.len(), SHOWN + 1);
            for (k, (found, expected)) in found.iter().zip(&expected).enumerate() {
                // measured 1.2e-12: rounding of the prior, which grows to a thousand times the smallest P
                let off = apart(&found[0], expected);
                assert!(off <= 1e-11, "{seen} times, root up to {most}, step {k}: {off:e}");
            }
        }
    }
}

/// Errors of half of the components, every third step or held over five: dense products with the states that
/// unit errors lead to.
#[test]
fn errors_that_enter_now_and_then_or_are_held_are_those_of_dense_products() {
    let b = coupled(N, 0.8);
    for (steps, held) in [(3, false), (5, true), (7, true)] {
        let forcing = Forcing { components: vec![0, 3, 5], steps, held };
        let q = coupled(3, 0.3);
        let (mut model, background, mut set) = window(4);
        let transform = ControlTransform::new(background, &b).unwrap();
        let mut cost =
            WeakForcing::new(&mut model, transform.clone(), &q, forcing.clone(), &mut set).unwrap();
        let r = cost.dim();
        let mut hessian = vec![0.0; r * r];
        cost.linearize(&vec![0.0; r], &mut vec![0.0; r]).unwrap();
        cost.hessian(&mut hessian).unwrap();
        drop(cost);
        // all errors up to the end of the forecast; those after the last observation are as Q says
        let last = (0..SHOWN).filter_map(|k| forcing.index(k)).max().unwrap();
        let all = N + 3 * (last + 1);
        let unit = Matrix::diagonal(&vec![1.0; all]);
        let a = Matrix::new(all, all, |i, j| if i < r && j < r { hessian[i + j * r] } else { unit.at(i, j) });
        let p = a.solve(&unit);
        // the states that a unit of each unknown leads to
        let mut paths = Vec::new();
        for c in 0..all {
            let mut whitened = vec![0.0; all];
            whitened[c] = 1.0;
            let mut x = vec![0.0; N];
            b.root(&whitened[..N], &mut x);
            let mut path = vec![x.clone()];
            for k in 0..SHOWN {
                let mut next = run(&mut model, &x, 1).pop().unwrap();
                if let Some(j) = forcing.index(k) {
                    let mut eta = vec![0.0; 3];
                    q.root(&whitened[N + 3 * j..][..3], &mut eta);
                    forcing.components.iter().zip(eta).for_each(|(&c, e)| next[c] += e);
                }
                x = next;
                path.push(x.clone());
            }
            paths.push(path);
        }
        for most in [0, 1000] {
            let (columns, states) = columns(&q, &forcing, most, 4);
            let found = carried(&columns, &forcing, &q, &states);
            for (k, [now, both]) in found.iter().enumerate() {
                let t = |k: usize| Matrix::new(N, all, |i, j| paths[j][k][i]);
                let off = apart(now, &t(k).times(&p).times(&t(k).transpose()));
                assert!(off <= 1e-12, "{steps} {held} {most} {k}: {off:e}");
                if k > 0 {
                    let off = apart(both, &t(k - 1).times(&p).times(&t(k).transpose()));
                    assert!(off <= 1e-12, "{steps} {held} {most} {k}, with the step before: {off:e}");
                }
            }
        }
    }
}

/// Lorenz 1963 whose steps err, analysed by both weak forms: the truth is within 1.96 σ as often as 95 %
/// says, at the start, the middle and the end of the window and in the forecast.
#[test]
fn intervals_along_a_window_of_lorenz_63_cover_the_truth() {
    const TWINS: usize = 100;
    let (b, q) = (Diagonal::uniform(3, 0.3).unwrap(), Diagonal::uniform(3, 0.1).unwrap());
    let forcing = Forcing { steps: 5, ..Forcing::every_step(3) };
    let times = [0, 20, 40, 60];
    for by_states in [false, true] {
        let mut inside = [0; 4];
        for seed in 0..TWINS as u64 {
            let mut model = Rk4::new(Lorenz63, 0.01);
            let background = [-4.3, -5.0, 20.0];
            let (start, errors) = (normals(seed, 3), normals(500 + seed, 3 * 12));
            let noise = normals(1000 + seed, 3 * 4);
            let mut truth =
                vec![background.iter().zip(&start).map(|(x, e)| x + 0.3 * e).collect::<Vec<f64>>()];
            let mut seen = Vec::new();
            for k in 0..60 {
                let mut x = run(&mut model, &truth[k], 1).pop().unwrap();
                if let Some(j) = forcing.index(k) {
                    x.iter_mut().zip(&errors[3 * j..]).for_each(|(x, e)| *x += 0.1 * e);
                }
                if (k + 1) % 10 == 0 && k < 40 {
                    let noise = &noise[3 * (k / 10)..];
                    let y: Vec<f64> = x.iter().zip(noise).map(|(x, e)| x + 0.2 * e).collect();
                    seen.push(observation(&[0, 1, 2], k + 1, 0.0, &y, 0.2));
                }
                truth.push(x);
            }
            let mut set = ObservationSet::new(40, vec![all_of(3)], seen).unwrap();
            let transform = ControlTransform::new(background.to_vec(), &b).unwrap();
            let options = OuterLoopOptions::default().with_inner(InnerSolver::Primal);
            let (columns, mut states);
            if by_states {
                let z = background.to_vec();
                let mut cost = WeakState::new(&mut model, z, &b, &q, forcing.clone(), &mut set).unwrap();
                let mut v = cost.background().unwrap();
                outer_loop(&mut cost, &mut v, &options, &mut ignore()).unwrap();
                cost.linearize(&v, &mut vec![0.0; v.len()]).unwrap();
                columns = WeakPosterior::new(&mut cost).unwrap().with_errors(&transform, &q, 1000);
                states = (0..=40).map(|k| cost.state(k).to_vec()).collect::<Vec<_>>();
            } else {
                let mut cost =
                    WeakForcing::new(&mut model, transform.clone(), &q, forcing.clone(), &mut set).unwrap();
                let mut v = vec![0.0; cost.dim()];
                outer_loop(&mut cost, &mut v, &options, &mut ignore()).unwrap();
                cost.linearize(&v, &mut vec![0.0; v.len()]).unwrap();
                columns = WeakPosterior::new(&mut cost).unwrap().with_errors(&transform, &q, 1000);
                states = (0..=40).map(|k| cost.state(k).to_vec()).collect::<Vec<_>>();
            }
            states.extend(run(&mut model, &states[40], 20).into_iter().skip(1));
            let model: &mut dyn Model = &mut model;
            propagate_errors(model, &columns, (&forcing, &q), &states.concat(), &mut |at| {
                if let Some(t) = times.iter().position(|t| *t == at.step) {
                    let variance = at.variance();
                    let within = |i: usize| {
                        (states[at.step][i] - truth[at.step][i]).abs() <= 1.96 * variance[i].sqrt()
                    };
                    inside[t] += (0..3).filter(|i| within(*i)).count();
                }
                Ok(())
            })
            .unwrap();
        }
        // Components go together at most: three binomial σ of 100 draws, 6.5 %.
        let shares = inside.map(|count| count as f64 / (3 * TWINS) as f64);
        assert!(shares.iter().all(|share| (share - 0.95).abs() <= 0.065), "{by_states}: {shares:?}");
    }
}
