//! Cycling with errors of the model: against a Kalman filter with Q.

use crate::cost::coupled;
use crate::ensemble::linear;
use crate::matrix::{Matrix, kalman, step_matrix};
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Localization};
use varda_implicit::Model;

const N: usize = 4;
const STEPS: usize = 24;

/// Components 0 and 2 at every step from 1 on, σ = 0.5.
fn seen(window: usize) -> impl Fn(usize) -> Result<ObservationSet, Error> {
    move |first| {
        let of = |k: usize| normals(300 + (first + k) as u64, 2);
        let ks = (0..=window).filter(|k| first + k > 0);
        let seen = ks.map(|k| observation(&[0, 2], k, 0.0, &of(k), 0.5)).collect();
        ObservationSet::new(window, vec![all_of(N)], seen)
    }
}

fn make(_: usize) -> Box<dyn Model + Send> {
    Box::new(linear(N))
}

fn exact() -> Minimizer {
    let options = TrustRegionOptions::default().with_gradient_tolerance(1e-13).with_initial_radius(1e3);
    Minimizer::TrustRegion(options)
}

fn loops(inner: InnerSolver) -> OuterLoopOptions {
    OuterLoopOptions::default()
        .with_inner(inner)
        .with_gradient_tolerance(1e-12)
        .with_inner_tolerance(1e-13)
        .with_max_inner(200)
}

/// Analyses and covariances of the filter, step by step.
fn filter(b: &dyn Covariance, q: &dyn Covariance, background: &[f64]) -> Vec<(Vec<f64>, Matrix)> {
    let step = step_matrix(&mut linear(N), N);
    let set = seen(STEPS)(0).unwrap();
    kalman(&step, &Matrix::of(b), Some(&Matrix::of(q)), background, &set, STEPS).0
}

fn no_draws(_: usize) -> Normals {
    Box::new(|| f64::NAN)
}

/// Windows end to end, of one step, tiling, and of one instant: an error in every step.
#[test]
fn weak_cycles_and_strong_ones_with_q_are_a_kalman_filter() {
    let (b, q, background) = (coupled(N, 0.8), coupled(N, 0.3), normals(1, N));
    let filter = filter(&b, &q, &background);
    let truth = |k: usize| filter[k].0.clone();
    let forcing = Forcing::every_step(N);
    let (no, over_forcing) = (CycledEstimate::No, CycledEstimate::Forcing);
    let over_states = CycledEstimate::States { b: &b, q: &q };
    let [primal, dual] = [InnerSolver::Primal, InnerSolver::Dual].map(loops);
    let trust_region = &exact();
    for (window, shift, estimated, minimizer) in [
        (4, 4, over_forcing, CycledMinimizer::from(trust_region)),
        (1, 1, over_forcing, trust_region.into()),
        (2, 3, over_forcing, trust_region.into()),
        (0, 1, over_forcing, trust_region.into()),
        (0, 1, no, trust_region.into()),
        (0, 3, no, trust_region.into()),
        (4, 4, over_forcing, (&primal).into()),
        (4, 4, over_forcing, (&dual).into()),
        (0, 1, no, (&dual).into()),
        (4, 4, over_states, (&primal).into()),
        (4, 4, over_states, (&dual).into()),
        (1, 1, over_states, (&primal).into()),
        (2, 3, over_states, (&primal).into()),
        (0, 1, over_states, (&primal).into()),
    ] {
        let cycling = Cycling {
            first: 0,
            window,
            shift,
            cycles: (STEPS - window) / shift + 1,
            make_model: &make,
            observations: &|first| {
                // A window of one instant with steps between leaves out what lies there.
                seen(window)(first)
            },
            truth: Some(&truth),
            model_error: Some(CycledErrors { q: &q, forcing: &forcing, estimated, normals: &no_draws }),
            posterior: false,
        };
        let carried =
            CycledCovariance::Propagated { first: &b, inflation: 1.0, static_part: None, dropped: 0.0 };
        let mut state = CycleState::new(background.clone());
        let ended = cycle(&cycling, &mut state, &carried, minimizer, &mut |_, _| ControlFlow::Continue(()));
        let ended = ended.unwrap();
        let estimated = !matches!(estimated, CycledEstimate::No);
        if shift == 3 && window == 0 {
            // Against a filter that sees every third step alone.
            let step = step_matrix(&mut linear(N), N);
            let some = seen(STEPS)(0).unwrap().into_parts().1;
            let some = some.into_iter().filter(|o| o.step % 3 == 0).collect();
            let set = ObservationSet::new(STEPS, vec![all_of(N)], some).unwrap();
            let b = Matrix::of(&b);
            let sparse = kalman(&step, &b, Some(&Matrix::of(&q)), &background, &set, STEPS).0;
            for c in &ended {
                let gap = crate::cost::relative(&c.end, &sparse[c.first_step].0);
                assert!(gap <= 1e-9, "{} {gap:e}", c.index);
            }
            continue;
        }
        for c in &ended {
            let end = c.errors.unwrap().end;
            assert!(end <= 1e-9, "window {window}, shift {shift}, cycle {}: {end:e}", c.index);
            let errors = if estimated { window } else { 0 };
            assert_eq!(c.model_errors.len(), N * errors);
        }
        // What was handed on is the filter's forecast error, one step or none beyond the last analysis.
        let last = ended.last().unwrap().first_step + window;
        let ahead = state.next * shift - last;
        let (mut x, mut p) = filter[last].clone();
        let step = step_matrix(&mut linear(N), N);
        for _ in 0..ahead {
            x = step.apply(&x);
            p = step.times(&p).times(&step.transpose()).plus(&Matrix::of(&q));
        }
        assert!(crate::cost::relative(&state.background, &x) <= 1e-9);
        let w = Matrix::new(N, state.columns.len() / N, |i, j| state.columns[i + j * N]);
        let handed = w.times(&w.transpose());
        for (i, j) in (0..N * N).map(|ij| (ij / N, ij % N)) {
            assert!((handed.at(i, j) - p.at(i, j)).abs() <= 1e-9, "{window} {shift} {estimated}: {i} {j}");
        }
    }
}

/// A static B: the state a window hands on is that of its weak trajectory, which another window alone finds,
/// over the forcing or over states.
#[test]
fn a_weak_window_hands_on_the_end_of_its_own_trajectory() {
    let (b, q, background) = (coupled(N, 0.8), coupled(N, 0.3), normals(1, N));
    let (some, held) = (Forcing { steps: 2, ..Forcing::every_step(N) }, Forcing::every_step(N));
    let held = Forcing { steps: 3, held: true, ..held };
    let states = CycledEstimate::States { b: &b, q: &q };
    for (forcing, estimated) in
        [(&some, CycledEstimate::Forcing), (&held, CycledEstimate::Forcing), (&some, states)]
    {
        let cycling = Cycling {
            first: 0,
            window: 6,
            shift: 6,
            cycles: 1,
            make_model: &make,
            observations: &seen(6),
            truth: None,
            model_error: Some(CycledErrors { q: &q, forcing, estimated, normals: &no_draws }),
            posterior: false,
        };
        let mut state = CycleState::new(background.clone());
        let b_static = CycledCovariance::Static(&b);
        let options = loops(InnerSolver::Primal);
        let ended = cycle(&cycling, &mut state, &b_static, &options, &mut |_, _| ControlFlow::Continue(()));
        let (mut model, mut set) = (linear(N), seen(6)(0).unwrap());
        let transform = ControlTransform::new(background.clone(), &b).unwrap();
        let mut cost = WeakForcing::new(&mut model, transform, &q, forcing.clone(), &mut set).unwrap();
        let mut v = vec![0.0; cost.dim()];
        exact().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
        cost.linearize(&v, &mut vec![0.0; v.len()]).unwrap();
        assert!(crate::cost::relative(&state.background, cost.state(6)) <= 1e-10);
        let one = &ended.unwrap()[0];
        assert!(one.terms.model_error > 0.0 && one.sigma.is_none());
        let mut eta = vec![0.0; N];
        cost.forcing(&v, 1, &mut eta);
        assert!(crate::cost::relative(&one.model_errors[N..2 * N], &eta) <= 1e-10);
    }
}

/// An outer loop in either space ends where the minimizer does, window after window with a static B.
#[test]
fn incremental_and_dual_windows_are_those_of_4d_var() {
    let (b, background) = (coupled(N, 0.8), normals(1, N));
    let ended = |minimizer: CycledMinimizer| {
        let cycling = Cycling {
            first: 0,
            window: 6,
            shift: 6,
            cycles: 4,
            make_model: &make,
            observations: &seen(6),
            truth: None,
            model_error: None,
            posterior: false,
        };
        let mut state = CycleState::new(background.clone());
        let b = CycledCovariance::Static(&b);
        cycle(&cycling, &mut state, &b, minimizer, &mut |_, _| ControlFlow::Continue(())).unwrap();
        state.background
    };
    let full = ended((&exact()).into());
    for inner in [InnerSolver::Primal, InnerSolver::Dual] {
        let gap = crate::cost::relative(&ended((&loops(inner)).into()), &full);
        assert!(gap <= 1e-11, "{inner:?}: {gap:e}");
    }
}

/// Over states a carried covariance needs its inverse.
#[test]
fn states_with_a_covariance_that_lost_its_rank_are_refused() {
    let (b, q, background) = (coupled(N, 0.8), coupled(N, 0.3), normals(1, N));
    // nine tenths of every variance may be left out
    let forcing = Forcing::every_step(N);
    let estimated = CycledEstimate::States { b: &b, q: &q };
    let cycling = Cycling {
        first: 0,
        window: 4,
        shift: 4,
        cycles: 2,
        make_model: &make,
        observations: &seen(4),
        truth: None,
        model_error: Some(CycledErrors { q: &q, forcing: &forcing, estimated, normals: &no_draws }),
        posterior: false,
    };
    let mut state = CycleState::new(background);
    let carried = CycledCovariance::Propagated { first: &b, inflation: 1.0, static_part: None, dropped: 0.9 };
    let options = loops(InnerSolver::Primal);
    let ended = cycle(&cycling, &mut state, &carried, &options, &mut |_, _| ControlFlow::Continue(()));
    assert!(matches!(ended, Err(Error::Singular { rank: 1..N, dim: N })), "{ended:?}");
}

/// Members carry Q by draws: the spread of many is the filter's.
#[test]
fn members_are_spread_by_q() {
    let (b, q, background) = (coupled(N, 0.8), coupled(N, 0.3), normals(1, N));
    let filter = filter(&b, &q, &background);
    let truth = |k: usize| filter[k].0.clone();
    let forcing = Forcing::every_step(N);
    let count = 400;
    let draws = normals(7, count * N);
    let mut members: Vec<f64> = Vec::new();
    for xi in draws.chunks_exact(N) {
        let mut x = vec![0.0; N];
        b.root(xi, &mut x);
        members.extend(x.iter().zip(&background).map(|(x, m)| x + m));
    }
    let source = |window: usize| -> Normals {
        let mut next = normals(9000 + window as u64, count * N).into_iter();
        Box::new(move || next.next().unwrap())
    };
    let error = |q: Option<&dyn Covariance>| {
        let cycling = Cycling {
            first: 0,
            window: 0,
            shift: 1,
            cycles: STEPS + 1,
            make_model: &make,
            observations: &seen(0),
            truth: Some(&truth),
            model_error: q.map(|q| CycledErrors {
                q,
                forcing: &forcing,
                estimated: CycledEstimate::No,
                normals: &source,
            }),
            posterior: false,
        };
        let ensemble = CycledCovariance::Ensemble(CycledEnsemble {
            inflation: CycledInflation::Fixed(1.0),
            spread: 1.0,
            rotation: None,
            localization: Localization::none(N),
            anchors: &|_| Vec::new(),
            static_part: None,
            update: CycledUpdate::SquareRoot,
            options: EnVarOptions::default(),
        });
        let mut state = CycleState::from_members(members.clone(), N);
        let ended = cycle(&cycling, &mut state, &ensemble, &exact(), &mut |_, _| ControlFlow::Continue(()));
        let last = ended.unwrap().pop().unwrap();
        let p = &filter[STEPS].1;
        let expected = ((0..N).map(|i| p.at(i, i)).sum::<f64>() / N as f64).sqrt();
        last.spread().unwrap() / expected
    };
    // Standard deviations of 400 draws have a scatter of 4 %, less after what was observed.
    let with = error(Some(&q));
    assert!((with - 1.0).abs() <= 0.1, "{with}");
    let without = error(None);
    assert!(without < 0.8, "{without}");
}

#[test]
fn q_where_nothing_uses_it_is_refused() {
    let (b, q) = (coupled(N, 0.8), coupled(N, 0.3));
    let forcing = Forcing::every_step(N);
    let cycling = Cycling {
        first: 0,
        window: 2,
        shift: 2,
        cycles: 2,
        make_model: &make,
        observations: &seen(2),
        truth: None,
        model_error: Some(CycledErrors {
            q: &q,
            forcing: &forcing,
            estimated: CycledEstimate::No,
            normals: &no_draws,
        }),
        posterior: false,
    };
    let mut state = CycleState::new(vec![0.0; N]);
    let ended = cycle(&cycling, &mut state, &CycledCovariance::Static(&b), &exact(), &mut |_, _| {
        ControlFlow::Continue(())
    });
    assert!(ended.unwrap_err().to_string().contains("Q beside a static B"));
}
