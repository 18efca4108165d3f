//! Linear advection, cycled with a propagated posterior: a Kalman filter, and what a shorter root drops.

use std::ops::ControlFlow;

use varda_assimilation::*;
use varda_covariance::{Covariance, Dense};
use varda_implicit::Model;
use varda_implicit::line::{Ends, Line, Transport};

use crate::models::{dot, normals};

const N: usize = 24;
const WINDOW: usize = 4;
const CYCLES: usize = 12;
const SIGMA: f64 = 0.2;

fn make(first: usize) -> Box<dyn Model + Send> {
    let line = Line { points: N, length: 1.0, ends: Ends::Periodic };
    Transport::advection_diffusion(line, 1.0, 0.0).rk4(first, 0.02)
}

/// Every third point seen at the end of each window.
fn seen() -> Vec<usize> {
    (0..N).step_by(3).collect()
}

fn values(c: usize) -> Vec<f64> {
    normals(70 + c as u64, N / 3)
}

/// A Gaussian kernel on the circle, and a little of every other error.
fn covariance() -> Vec<f64> {
    let of = |i: usize, j: usize| {
        let d = (i.abs_diff(j)).min(N - i.abs_diff(j)) as f64 / N as f64;
        (-(d / 0.08).powi(2) / 2.0).exp() + if i == j { 1e-4 } else { 0.0 }
    };
    (0..N * N).map(|e| of(e % N, e / N)).collect()
}

/// Q of an error at the end of every window: 0.3² of B, and more of every other error.
fn q() -> Vec<f64> {
    covariance().iter().enumerate().map(|(e, b)| 0.09 * b + if e / N == e % N { 1e-3 } else { 0.0 }).collect()
}

/// x_a and σ of the next background of every window, by x ← M x, P ← M P Mᵀ + Q and one value
/// after the other.
fn kalman(q: Option<&[f64]>) -> Vec<(Vec<f64>, Vec<f64>)> {
    let through = |x: &[f64]| -> Vec<f64> {
        let (mut model, mut x, mut next) = (make(0), x.to_vec(), vec![0.0; N]);
        for k in 0..WINDOW {
            model.step(k, &x, &mut next).unwrap();
            std::mem::swap(&mut x, &mut next);
        }
        x
    };
    // Columns of a symmetric P are its rows: M P Mᵀ = M (M P)ᵀ.
    let both_sides = |p: &[f64]| -> Vec<f64> {
        let half: Vec<Vec<f64>> = p.chunks(N).map(through).collect();
        let rows = |i: usize| half.iter().map(|column| column[i]).collect::<Vec<f64>>();
        (0..N).flat_map(|i| through(&rows(i))).collect()
    };
    let (mut x, mut p) = (normals(1, N), covariance());
    let mut windows = Vec::new();
    for c in 0..CYCLES {
        x = through(&x);
        p = both_sides(&p);
        p.iter_mut().zip(q.unwrap_or(&[])).for_each(|(p, q)| *p += q);
        for (&i, y) in seen().iter().zip(values(c)) {
            let gain: Vec<f64> = (0..N).map(|j| p[j + i * N] / (p[i + i * N] + SIGMA * SIGMA)).collect();
            let innovation = y - x[i];
            x.iter_mut().zip(&gain).for_each(|(x, g)| *x += g * innovation);
            let row: Vec<f64> = (0..N).map(|k| p[i + k * N]).collect();
            for (k, column) in p.chunks_mut(N).enumerate() {
                column.iter_mut().zip(&gain).for_each(|(p, g)| *p -= g * row[k]);
            }
        }
        windows.push((x.clone(), (0..N).map(|i| p[i + i * N].sqrt()).collect()));
    }
    windows
}

fn cycled(dropped: f64) -> Vec<Cycle> {
    let minimizer = Minimizer::TrustRegion(
        TrustRegionOptions::default().with_gradient_tolerance(1e-14).with_initial_radius(1e4),
    );
    cycled_by((&minimizer).into(), dropped, None)
}

/// With a model error by the given form, if there is one.
fn cycled_by(minimizer: CycledMinimizer, dropped: f64, over: Option<&str>) -> Vec<Cycle> {
    let (b, q) = (Dense::new(N, &covariance()).unwrap(), Dense::new(N, &q()).unwrap());
    assert_eq!(b.root_dim(), N);
    let observations = |first: usize| {
        let y = values(first / WINDOW);
        let rows: Vec<usize> = (0..y.len()).collect();
        let h = Selection::new(seen(), N)?;
        ObservationSet::new(WINDOW, vec![Box::new(h)], vec![Observation::new(WINDOW, rows, y, SIGMA)])
    };
    let forcing = Forcing { steps: WINDOW, ..Forcing::every_step(N) };
    let errors = over.map(|form| CycledErrors {
        q: &q,
        forcing: &forcing,
        estimated: match form {
            "forcing" => CycledEstimate::Forcing,
            _ => CycledEstimate::States { b: &b, q: &q },
        },
        normals: &|_| Box::new(|| f64::NAN),
    });
    let cycling = Cycling {
        first: 0,
        window: WINDOW,
        shift: WINDOW,
        cycles: CYCLES,
        make_model: &make,
        observations: &observations,
        truth: None,
        model_error: errors,
        posterior: false,
    };
    let covariance = CycledCovariance::Propagated { first: &b, inflation: 1.0, static_part: None, dropped };
    let mut state = CycleState::new(normals(1, N));
    let go_on = &mut |_: &Cycle, _: &CycleState| ControlFlow::Continue(());
    cycle(&cycling, &mut state, &covariance, minimizer, go_on).unwrap()
}

fn largest(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |m, (a, b)| f64::max(m, (a - b).abs()))
}

/// The requirement is 1e-12 of fields of size 1.
#[test]
fn linear_advection_with_a_propagated_posterior_is_the_kalman_filter() {
    for (c, (x, sigma)) in cycled(0.0).iter().zip(kalman(None)) {
        let off = largest(&c.end, &x);
        assert!(off <= 1e-12, "window {}: {off:e}", c.index);
        let off = largest(c.sigma.as_ref().unwrap(), &sigma);
        assert!(off <= 1e-12, "σ after window {}: {off:e}", c.index);
        assert_eq!((c.columns, c.dropped), (N, 0.0));
    }
}

/// Each window may lose its share of every variance, and says how much it did; the next loses it of what is
/// left, so that twelve windows lose twelve times as much and what observations make of it: a factor of ten.
#[test]
fn a_truncated_root_keeps_the_variance() {
    let (whole, share) = (cycled(0.0), 1e-3);
    let cut = cycled(share);
    for (a, b) in cut.iter().zip(&whole) {
        assert!(a.dropped <= share && a.columns < N, "{} {}", a.dropped, a.columns);
        let (sigma, right) = (a.sigma.as_ref().unwrap(), b.sigma.as_ref().unwrap());
        for (s, r) in sigma.iter().zip(right) {
            assert!((s * s / (r * r) - 1.0).abs() <= 10.0 * share * CYCLES as f64, "{s} {r}");
        }
    }
    assert!(cut.iter().any(|c| c.dropped > 0.0));
    // the least that is asked for does not move the analysis
    let fine = cycled(1e-12);
    let size = dot(&whole[CYCLES - 1].end, &whole[CYCLES - 1].end).sqrt();
    assert!(largest(&fine[CYCLES - 1].end, &whole[CYCLES - 1].end) <= 1e-5 * size);
}

/// Incremental, dual and both weak forms with Q: the same filter to 1e-12.
#[test]
fn linear_advection_by_every_method_is_the_kalman_filter() {
    let loops = |inner| {
        OuterLoopOptions::default()
            .with_inner(inner)
            .with_gradient_tolerance(1e-13)
            .with_inner_tolerance(1e-14)
            .with_max_inner(500)
    };
    let (primal, dual) = (loops(InnerSolver::Primal), loops(InnerSolver::Dual));
    let trust_region = Minimizer::TrustRegion(
        TrustRegionOptions::default().with_gradient_tolerance(1e-14).with_initial_radius(1e4),
    );
    let methods: [(&str, CycledMinimizer, Option<&str>); 6] = [
        ("incremental", (&primal).into(), None),
        ("dual", (&dual).into(), None),
        ("weak-forcing", (&trust_region).into(), Some("forcing")),
        ("weak-forcing, dual", (&dual).into(), Some("forcing")),
        ("weak-state", (&primal).into(), Some("states")),
        ("weak-state, dual", (&dual).into(), Some("states")),
    ];
    for (name, minimizer, over) in methods {
        let filter = kalman(over.map(|_| q()).as_deref());
        for (c, (x, sigma)) in cycled_by(minimizer, 0.0, over).iter().zip(filter) {
            let off = largest(&c.end, &x);
            assert!(off <= 1e-12, "{name}, window {}: {off:e}", c.index);
            let off = largest(c.sigma.as_ref().unwrap(), &sigma);
            assert!(off <= 1e-12, "{name}, σ after window {}: {off:e}", c.index);
            assert_eq!(c.columns, N);
        }
    }
}
