//! Cycling: against a Kalman filter written out, and what it refuses.

use crate::cost::coupled;
use crate::ensemble::{linear, spanning};
use crate::models::*;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Dense, Diagonal, Localization};
use varda_implicit::Model;

const N: usize = 4;
const STEPS: usize = 13;

/// Matrices by rows.
type Matrix = Vec<Vec<f64>>;

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    a.iter()
        .map(|row| (0..b[0].len()).map(|j| row.iter().zip(b).map(|(a, b)| a * b[j]).sum()).collect())
        .collect()
}

fn transpose(a: &Matrix) -> Matrix {
    (0..a[0].len()).map(|j| a.iter().map(|row| row[j]).collect()).collect()
}

/// Rows 0 and 2 seen with σ = 0.5 at every step from 1 on.
fn values(k: usize) -> Vec<f64> {
    normals(300 + k as u64, 2)
}

/// The analysis of a Kalman filter at every step, with x ← M x, P ← M P Mᵀ and one scalar observation
/// after the other.
fn kalman(b: &dyn Covariance, background: &[f64], inflation: f64) -> (Vec<Vec<f64>>, Vec<f64>) {
    let column = |j: usize| {
        let unit: Vec<f64> = (0..N).map(|i| f64::from(i == j)).collect();
        run(&mut linear(N), &unit, 1).pop().unwrap()
    };
    let m = transpose(&(0..N).map(column).collect());
    let mut p: Matrix = (0..N)
        .map(|i| {
            let (unit, mut row) = ((0..N).map(|j| f64::from(i == j)).collect::<Vec<_>>(), vec![0.0; N]);
            b.apply(&unit, &mut row);
            row
        })
        .collect();
    let mut x = background.to_vec();
    let (mut analyses, mut spread) = (vec![x.clone()], vec![0.0]);
    for k in 1..=STEPS {
        x = m.iter().map(|row| dot(row, &x)).collect();
        p = product(&product(&m, &p), &transpose(&m));
        p.iter_mut().flatten().for_each(|p| *p *= inflation * inflation);
        for (&i, y) in [0, 2].iter().zip(values(k)) {
            let gain: Vec<f64> = p.iter().map(|row| row[i] / (p[i][i] + 0.25)).collect();
            let innovation = y - x[i];
            x.iter_mut().zip(&gain).for_each(|(x, g)| *x += g * innovation);
            let seen = p[i].clone();
            for (row, g) in p.iter_mut().zip(&gain) {
                row.iter_mut().zip(&seen).for_each(|(p, s)| *p -= g * s);
            }
        }
        analyses.push(x.clone());
        spread.push(((0..N).map(|i| p[i][i]).sum::<f64>() / N as f64).sqrt());
    }
    (analyses, spread)
}

fn observations(window: usize) -> impl Fn(usize) -> Result<ObservationSet, Error> {
    move |first| {
        let seen = (0..=window)
            .filter(|k| first + k > 0)
            .map(|k| observation(&[0, 2], k, 0.0, &values(first + k), 0.5))
            .collect();
        ObservationSet::new(window, vec![all_of(N)], seen)
    }
}

fn make(_first: usize) -> Box<dyn Model + Send> {
    Box::new(linear(N))
}

fn go_on(_: &Cycle, _: &CycleState) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn exact() -> Minimizer {
    Minimizer::TrustRegion(
        TrustRegionOptions::default().with_gradient_tolerance(1e-13).with_initial_radius(1e3),
    )
}

fn ensemble<'a>(inflation: f64) -> CycledEnsemble<'a> {
    CycledEnsemble {
        inflation: CycledInflation::Fixed(inflation),
        spread: 1.0,
        rotation: None,
        localization: Localization::none(N),
        anchors: &|_| Vec::new(),
        static_part: None,
        update: CycledUpdate::SquareRoot,
        options: EnVarOptions::default(),
    }
}

/// (window, shift): end to end, overlapping, one step, tiling, and no window at all.
const WINDOWS: [(usize, usize); 5] = [(4, 4), (5, 2), (1, 1), (2, 3), (0, 1)];

#[test]
fn linear_cycles_are_a_kalman_filter_whatever_the_window_and_however_p_is_carried() {
    let b = coupled(N, 0.8);
    let background = normals(1, N);
    let (filter, spread) = kalman(&b, &background, 1.0);
    let truth = |k: usize| filter[k].clone();
    for (window, shift) in WINDOWS {
        for carried_by_members in [false, true] {
            // Tiling windows begin with an observed step, the first with step 1, from a background and a B
            // there.
            let first = usize::from(shift > window);
            let cycles = (STEPS - first - window) / shift + 1;
            let mut members = spanning(&b, &background);
            let (mut start, mut matrix) = (background.clone(), vec![0.0; N * N]);
            for x in members.chunks_exact_mut(N).chain([&mut start[..]]) {
                let moved = run(&mut linear(N), x, first).pop().unwrap();
                x.copy_from_slice(&moved);
            }
            for x in members.chunks_exact(N) {
                for (i, j) in (0..N * N).map(|ij| (ij / N, ij % N)) {
                    matrix[i * N + j] += (x[i] - start[i]) * (x[j] - start[j]) / N as f64;
                }
            }
            let first_b = Dense::new(N, &matrix).unwrap();
            let (mut state, covariance) = if carried_by_members {
                (CycleState::from_members(members, N), CycledCovariance::Ensemble(ensemble(1.0)))
            } else {
                let carried = CycledCovariance::Propagated {
                    first: &first_b,
                    inflation: 1.0,
                    static_part: None,
                    dropped: 0.0,
                };
                (CycleState::new(start), carried)
            };
            let cycling = Cycling {
                first,
                window,
                shift,
                cycles,
                make_model: &make,
                observations: &observations(window),
                truth: Some(&truth),
                model_error: None,
                posterior: false,
            };
            let ended = cycle(&cycling, &mut state, &covariance, &exact(), &mut go_on).unwrap();
            assert_eq!(ended.len(), cycles);
            for c in &ended {
                assert_eq!(c.first_step, first + c.index * shift);
                assert_eq!(c.status, Status::Converged, "{c:?}");
                // The "truth" is the filter's analysis: the error at the window's end is the difference
                // between the two.
                let end = c.errors.unwrap().end;
                assert!(end <= 1e-9, "window {window}, shift {shift}, cycle {}: {end:e}", c.index);
                // Two values a step, every step once.
                let new = if c.index == 0 { window + first } else { shift };
                assert_eq!(c.observations, 2 * new);
                if carried_by_members {
                    let expected = spread[c.first_step + window];
                    assert!((c.spread().unwrap() - expected).abs() <= 1e-9 * expected);
                    assert_eq!((c.counts.model.tangent_steps, c.counts.model.adjoint_steps), (0, 0));
                }
            }
        }
    }
}

#[test]
fn inflation_multiplies_standard_deviations_once_a_window() {
    // With windows of one step, inflating M P Mᵀ by α² in the filter is inflating what is carried.
    let b = coupled(N, 0.8);
    let background = normals(1, N);
    let (filter, _) = kalman(&b, &background, 1.3);
    let (plain, _) = kalman(&b, &background, 1.0);
    let truth = |k: usize| filter[k].clone();
    assert!(norm(&filter[5].iter().zip(&plain[5]).map(|(a, b)| a - b).collect::<Vec<_>>()) > 1e-2);
    let cycling = Cycling {
        first: 0,
        window: 1,
        shift: 1,
        cycles: 8,
        make_model: &make,
        observations: &observations(1),
        truth: Some(&truth),
        model_error: None,
        posterior: false,
    };
    let mut wide = vec![0.0; N * N];
    for j in 0..N {
        let (unit, mut column) = ((0..N).map(|i| f64::from(i == j)).collect::<Vec<_>>(), vec![0.0; N]);
        b.apply(&unit, &mut column);
        column.iter().enumerate().for_each(|(i, c)| wide[i * N + j] = 1.69 * c);
    }
    let wide = Dense::new(N, &wide).unwrap();
    for (mut state, covariance) in [
        (CycleState::from_members(spanning(&b, &background), N), CycledCovariance::Ensemble(ensemble(1.3))),
        (
            CycleState::new(background.clone()),
            CycledCovariance::Propagated { first: &wide, inflation: 1.3, static_part: None, dropped: 0.0 },
        ),
    ] {
        let ended = cycle(&cycling, &mut state, &covariance, &exact(), &mut go_on);
        for c in ended.unwrap() {
            assert!(c.errors.unwrap().end <= 1e-9, "{c:?}");
        }
    }
}

/// Lorenz-96, localized, hybrid, each with both updates; and static B: all do better than their background,
/// and the same bits again.
#[test]
fn every_way_to_carry_a_covariance_runs_on_a_nonlinear_model() {
    let n = 12;
    let b = coupled(n, 0.6);
    let start: Vec<f64> = normals(1, n).iter().map(|x| 2.0 + 3.0 * x).collect();
    let mut spin_up = run(&mut Rk4::new(Lorenz96(n), 0.05), &start, 280);
    let truth = spin_up.split_off(200);
    let see = |first: usize| {
        let seen = (1..=4)
            .map(|k| {
                let noise = normals(50 + (first + k) as u64, n);
                let y: Vec<f64> = truth[first + k].iter().zip(noise).map(|(x, e)| x + 0.5 * e).collect();
                observation(&(0..n).collect::<Vec<_>>(), k, 0.0, &y, 0.5)
            })
            .collect();
        ObservationSet::new(4, vec![all_of(n)], seen)
    };
    let make = |_: usize| -> Box<dyn Model + Send> { Box::new(Rk4::new(Lorenz96(n), 0.05)) };
    let true_state = |k: usize| truth[k].clone();
    let cycling = Cycling {
        first: 0,
        window: 4,
        shift: 4,
        cycles: 20,
        make_model: &make,
        observations: &see,
        truth: Some(&true_state),
        model_error: None,
        posterior: false,
    };
    let background: Vec<f64> = truth[0].iter().zip(normals(9, n)).map(|(x, e)| x + 0.6 * e).collect();
    let anchors = |set: &ObservationSet| -> Vec<usize> {
        set.observations().iter().flat_map(|o| o.rows.clone()).collect()
    };
    let noise = |c: usize| -> Normals {
        let (drawn, mut next) = (normals(77 + c as u64, 5000), 0);
        Box::new(move || {
            next += 1;
            drawn[next - 1]
        })
    };
    let mut means = Vec::new();
    for way in 0..6 {
        let members: Vec<f64> = (0..15)
            .flat_map(|i| {
                let e = normals(600 + i, n);
                background.iter().zip(e).map(|(x, e)| x + 0.6 * e).collect::<Vec<_>>()
            })
            .collect();
        let taper = varda_covariance::Taper::GaspariCohn { support: 6.0 };
        let ring = |i: usize, j: usize| i.abs_diff(j).min(n - i.abs_diff(j)) as f64;
        let ensemble = |update, static_part, localized| {
            let localization = if localized {
                Localization::by_distance(taper, n, ring, 0.01).unwrap()
            } else {
                Localization::none(n)
            };
            CycledCovariance::Ensemble(CycledEnsemble {
                inflation: CycledInflation::Fixed(1.05),
                spread: 1.0,
                rotation: None,
                localization,
                anchors: &anchors,
                static_part,
                update,
                options: EnVarOptions::default(),
            })
        };
        let covariance = match way {
            0 => CycledCovariance::Static(&b),
            1 => CycledCovariance::Propagated { first: &b, inflation: 1.05, static_part: None, dropped: 0.0 },
            2 => CycledCovariance::Propagated {
                first: &b,
                inflation: 1.0,
                static_part: Some((&b, 0.05)),
                dropped: 0.0,
            },
            3 => ensemble(CycledUpdate::SquareRoot, None, true),
            4 => ensemble(CycledUpdate::SquareRoot, Some((&b, 0.1, 1.0)), false),
            _ => ensemble(CycledUpdate::PerturbedObservations(&noise), None, true),
        };
        let start = match way {
            0..=2 => CycleState::new(background.clone()),
            _ => CycleState::from_members(members, n),
        };
        // Up to window `stop`, and from what that one handed on to the end.
        let run = |stop: usize| {
            let mut until = |c: &Cycle, _: &CycleState| match c.index == stop {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            };
            let mut state = start.clone();
            let minimizer = Minimizer::default();
            let mut cycles = cycle(&cycling, &mut state, &covariance, &minimizer, &mut until).unwrap();
            cycles.extend(cycle(&cycling, &mut state, &covariance, &minimizer, &mut go_on).unwrap());
            cycles
        };
        let cycles = run(19);
        assert_eq!(cycles.len(), 20);
        for stop in [0, 7] {
            assert_eq!(cycles, run(stop), "way {way}: taken up after window {stop}");
        }
        let mean = |f: &dyn Fn(&CycleErrors) -> f64| {
            cycles[5..].iter().map(|c| f(&c.errors.unwrap())).sum::<f64>() / 15.0
        };
        let (before, after) = (mean(&|e| e.background), mean(&|e| e.start));
        assert!(after < before && after < 0.35, "way {way}: {before} {after}");
        let chi2 = cycles[5..].iter().map(|c| c.chi2).sum::<f64>() / 15.0;
        assert!((0.6..1.5).contains(&chi2), "way {way}: {chi2}");
        assert_eq!(cycles[3].spread().is_some(), way > 0);
        means.push(mean(&|e| e.end));
    }
    // What flows with the model beats what does not.
    assert!(means[1..].iter().all(|m| *m < means[0]), "{means:?}");
}

#[test]
fn a_sequence_can_be_ended_and_what_makes_none_is_refused() {
    let b = Diagonal::uniform(N, 1.0).unwrap();
    let see = observations(4);
    let good = Cycling {
        first: 0,
        window: 4,
        shift: 2,
        cycles: 5,
        make_model: &make,
        observations: &see,
        truth: None,
        model_error: None,
        posterior: false,
    };
    let go = |cycling: &Cycling, mut state: CycleState, covariance: CycledCovariance, stop: usize| {
        cycle(cycling, &mut state, &covariance, &exact(), &mut |c, after| {
            assert_eq!(after.next, c.index + 1);
            if c.index == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })
    };
    let rest = || CycleState::new(vec![0.0; N]);
    let ended = go(&good, rest(), CycledCovariance::Static(&b), 1).unwrap();
    assert_eq!((ended.len(), ended[1].first_step, ended[1].errors, ended[1].spread()), (2, 2, None, None));
    for shift in [0, 6] {
        let bad = Cycling { shift, ..good };
        let refused = go(&bad, rest(), CycledCovariance::Static(&b), 9);
        assert!(matches!(refused, Err(Error::Setting { .. })));
    }
    let members = CycleState::from_members(spanning(&b, &[0.0; N]), N);
    for inflation in [0.0, -1.0, f64::NAN] {
        let propagated =
            CycledCovariance::Propagated { first: &b, inflation, static_part: None, dropped: 0.0 };
        assert!(matches!(go(&good, rest(), propagated, 9), Err(Error::Setting { .. })));
        let carried = CycledCovariance::Ensemble(ensemble(inflation));
        assert!(matches!(go(&good, members.clone(), carried, 9), Err(Error::Setting { .. })));
    }
    let one_member = CycleState::from_members(vec![0.0; N], N);
    let refused = go(&good, one_member, CycledCovariance::Ensemble(ensemble(1.0)), 9);
    assert!(matches!(refused, Err(Error::Covariance(_))));
}
