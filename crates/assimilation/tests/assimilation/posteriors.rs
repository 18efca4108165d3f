//! The posterior three ways, its draws, and whether B and R are what they should be.

use crate::cost::coupled;
use crate::fixtures::numbers;
use crate::models::*;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use serde_json::Value;
use std::ops::ControlFlow;
use varda_assimilation::*;
use varda_covariance::{Covariance, Dense};

fn quiet(_: &Iteration) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

const LORENZ96: &str = include_str!("../../../../tests/fixtures/twin/l96.json");
const LINEAR: &str = include_str!("../../../../tests/fixtures/twin/lin3dvar.json");

type Check<'a> = dyn FnMut(&mut dyn LeastSquares, &ControlTransform, &[f64], Minimum) + 'a;

/// One of the fixtures at its minimum, found by L-BFGS that keeps every pair. Lorenz-96: n = 40, all of them
/// seen; the linear one: n = 100, 25 seen.
fn at_the_minimum(text: &str, check: &mut Check) {
    let problem: Value = serde_json::from_str(text).unwrap();
    let n = problem["n"].as_u64().unwrap() as usize;
    let steps = problem["K"].as_u64().unwrap() as usize;
    let matrix: Vec<f64> = problem["B"].as_array().unwrap().iter().flat_map(numbers).collect();
    let b = Dense::new(n, &matrix).unwrap();
    let sigma = problem["R_diag"].as_f64().unwrap().sqrt();
    let rows: Vec<usize> = numbers(&problem["H_rows"]).iter().map(|&r| r as usize).collect();
    let every: Vec<usize> = (0..rows.len()).collect();
    let observations = problem["obs"].as_object().unwrap().iter();
    let observations =
        observations.map(|(k, y)| observation(&every, k.parse().unwrap(), 0.0, &numbers(y), sigma)).collect();
    let h = Selection::new(rows, n).unwrap();
    let mut set = ObservationSet::new(steps, vec![Box::new(h)], observations).unwrap();
    let transform = ControlTransform::new(numbers(&problem["xb"]), &b).unwrap();
    let mut model = Rk4::new(Lorenz96(40), 0.0125);
    let mut cost = if steps > 0 {
        StrongConstraint::new(&mut model, transform.clone(), &mut set).unwrap()
    } else {
        StrongConstraint::without_model(transform.clone(), &mut set).unwrap()
    };
    let mut v = vec![0.0; n];
    let options = LbfgsOptions::default().with_memory(200);
    let minimum = lbfgs(&mut cost, &mut v, &options, &mut quiet).unwrap();
    assert_eq!(minimum.status, Status::Converged);
    check(&mut cost, &transform, &v, minimum);
}

/// A⁻¹ by columns, from the inverse of its Cholesky factor through `Dense`: independent of the eigenpairs
/// under test.
fn inverse(cost: &mut dyn LeastSquares) -> Vec<f64> {
    use varda_covariance::Precision;
    let n = cost.dim();
    let mut hessian = vec![0.0; n * n];
    cost.hessian(&mut hessian).unwrap();
    let factor = Dense::new(n, &hessian).unwrap();
    let mut inverse = vec![0.0; n * n];
    for (j, column) in inverse.chunks_exact_mut(n).enumerate() {
        let mut unit = vec![0.0; n];
        unit[j] = 1.0;
        factor.solve(&unit, column);
    }
    inverse
}

/// ‖P_v − A⁻¹‖₂ by power iteration: a lower estimate, within a per cent after 300 products.
fn error(posterior: &LowRankPosterior, inverse: &[f64]) -> f64 {
    let n = posterior.control_variable_variance().len();
    let mut x = normals(3, n);
    let mut size = 0.0;
    for _ in 0..300 {
        let mut y = vec![0.0; n];
        posterior.apply(&x, &mut y);
        for (column, x) in inverse.chunks_exact(n).zip(&x) {
            y.iter_mut().zip(column).for_each(|(y, a)| *y -= a * x);
        }
        size = norm(&y);
        if size == 0.0 {
            break;
        }
        x = y.iter().map(|y| y / size).collect();
    }
    size
}

fn check_three_ways(text: &str, runs: &[(f64, usize)], most_products: usize) {
    at_the_minimum(text, &mut |cost, transform, _, minimum| {
        let n = cost.dim();
        let dense = Posterior::new(cost).unwrap();
        let inverse = inverse(cost);
        let mut prior = vec![0.0; n];
        transform.covariance().variance(&mut prior);
        for (i, d) in dense.control_variable_variance().iter().enumerate() {
            // Both are backward stable, with a condition number of at most 1e4.
            assert!((d - inverse[i + i * n]).abs() <= 1e-11);
        }

        let mut rng = ChaCha8Rng::seed_from_u64(11);
        for &(tolerance, max_products) in runs {
            let options = LanczosOptions::default().with_tolerance(tolerance).with_max_products(max_products);
            let lanczos = LowRankPosterior::lanczos(cost, &options, &mut rng).unwrap();
            let bound = lanczos.error_bound().unwrap();
            let found = error(&lanczos, &inverse);
            if max_products >= n {
                assert!(bound <= tolerance);
                assert!(lanczos.products() <= most_products);
            } else {
                assert_eq!(lanczos.products(), max_products + options.probes);
            }
            // 1e-11: the rounding of the two inverses compared.
            assert!(found <= bound + 1e-11, "{found:e} {bound:e}");
            for ((low, dense), b) in
                lanczos.variance(transform).iter().zip(dense.variance(transform)).zip(&prior)
            {
                assert!((low - dense).abs() <= bound * b + 1e-11);
            }
            let scale: f64 = prior.iter().sum();
            assert!((lanczos.trace(transform) - dense.trace(transform)).abs() <= bound * scale + 1e-9);
            let dof = lanczos.degrees_of_freedom() - dense.degrees_of_freedom();
            assert!(dof.abs() <= n as f64 * bound + 1e-9);
        }

        let known = minimum.inverse_hessian.unwrap();
        let by_lbfgs = LowRankPosterior::from_inverse_hessian(&known).unwrap();
        assert_eq!(by_lbfgs.error_bound(), None);
        let found = error(&by_lbfgs, &inverse);
        let estimate = by_lbfgs.error_estimate(cost, 20, &mut rng).unwrap();
        let scale: f64 = prior.iter().sum();
        let apart = |p: &LowRankPosterior| (p.trace(transform) - dense.trace(transform)).abs() / scale;
        // The mean of 20 squares is three standard deviations low at worst; 1 is as far as two matrices
        // between 0 and I can be apart.
        let bound = (estimate / (1.0 - 3.0 * (2.0 / 20.0f64).sqrt()).sqrt()).min(1.0);
        assert!(found <= bound && apart(&by_lbfgs) <= bound, "{found} {} {bound}", apart(&by_lbfgs));

        let from_lbfgs = |max_products, tolerance, rng: &mut ChaCha8Rng, cost: &mut dyn LeastSquares| {
            let options = LanczosOptions::default().with_tolerance(tolerance).with_max_products(max_products);
            let refined = LowRankPosterior::refined(&known, cost, &options, rng).unwrap();
            let (found, bound) = (error(&refined, &inverse), refined.error_bound().unwrap());
            // All 40 and 6 probes; of 100 the 25 that were seen, found twice at worst.
            assert!(refined.products() <= max_products.min(46) + options.probes);
            assert!(found <= bound + 1e-11 && apart(&refined) <= bound + 1e-11, "{found:e} {bound:e}");
            bound
        };
        for tolerance in [0.1, 1e-3, 1e-6] {
            assert!(from_lbfgs(200, tolerance, &mut rng, cost) <= tolerance);
        }
        for few in [1, 8, 20] {
            from_lbfgs(few, 1e-6, &mut rng, cost);
        }
    });
}

#[test]
fn three_ways_to_the_posterior_agree_to_their_bounds() {
    // 25 observations: 26 Lanczos iterations find all there is, at checks a few iterations apart, beside 6
    // probes.
    check_three_ways(LINEAR, &[(0.5, 200), (1e-2, 200), (1e-6, 200), (1e-6, 8), (1e-6, 20)], 36);
}

/// Every direction is seen: there is no low rank, and the bound says so until all 40 are found.
#[test]
fn where_everything_is_observed_the_bound_asks_for_the_whole_spectrum() {
    check_three_ways(LORENZ96, &[(1e-2, 200), (1e-9, 200), (1e-6, 8), (1e-6, 25)], 46);
}

#[test]
fn draws_have_the_posterior_s_mean_and_variance() {
    at_the_minimum(LORENZ96, &mut |cost, transform, v, _| {
        let dense = Posterior::new(cost).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        let low = LowRankPosterior::lanczos(cost, &LanczosOptions::default(), &mut rng).unwrap();
        let variance = dense.variance(transform);
        let mut mean = vec![0.0; 40];
        transform.control(v, &mut mean);
        let count = 4000;
        for way in 0..2 {
            let mut sums = vec![(0.0, 0.0); 40];
            for _ in 0..count {
                let z = if way == 0 {
                    dense.draw(transform, v, &mut rng)
                } else {
                    low.draw(transform, v, &mut rng)
                };
                for (s, (z, m)) in sums.iter_mut().zip(z.iter().zip(&mean)) {
                    s.0 += z - m;
                    s.1 += (z - m) * (z - m);
                }
            }
            for (s, variance) in sums.iter().zip(&variance) {
                // Five standard deviations of a mean and of a variance from that many normal draws.
                assert!((s.0 / count as f64).abs() <= 5.0 * (variance / count as f64).sqrt());
                assert!((s.1 / count as f64 / variance - 1.0).abs() <= 5.0 * (2.0 / count as f64).sqrt());
            }
        }
    });
}

/// 200 linear twins with 12 observations in two groups: every ratio is 1 in the mean; with σ_o of the second
/// group given as twice what it is, that group's falls, and χ² with it.
#[test]
fn ratios_are_one_where_b_and_r_are_right_and_not_where_they_are_wrong() {
    let n = 8;
    let b = coupled(n, 1.3);
    let groups: Vec<usize> = (0..12).map(|i| i / 6).collect();
    let truth_sigma = |group: usize| [0.4, 0.9][group];
    let run = |wrong: f64| {
        let mut sums = [[0.0; 3]; 2];
        let mut chi2 = 0.0;
        for twin in 0..200 {
            let mut error = vec![0.0; n];
            b.root(&normals(5000 + twin, n), &mut error);
            let noise = normals(9000 + twin, 12);
            let mut seen = Vec::new();
            for group in 0..2 {
                // x_b = 0, so that the truth is minus the background's error.
                let y: Vec<f64> =
                    (0..6).map(|i| -error[i + group] + truth_sigma(group) * noise[6 * group + i]).collect();
                let rows: Vec<usize> = (group..6 + group).collect();
                let sigma = truth_sigma(group) * if group == 1 { wrong } else { 1.0 };
                seen.push(observation(&rows, 0, 0.0, &y, sigma));
            }
            let mut set = ObservationSet::new(0, vec![all_of(n)], seen).unwrap();
            let (values, sigma) = (set.values().to_vec(), set.sigma().to_vec());
            let errors = set.errors().clone();
            let transform = ControlTransform::new(vec![0.0; n], &b).unwrap();
            let mut cost = StrongConstraint::without_model(transform, &mut set).unwrap();
            let mut v = vec![0.0; n];
            cost.evaluate(&v, Some(&mut vec![0.0; n])).unwrap();
            let at_background = cost.predicted().to_vec();
            let spread = predicted_variance(&mut cost, &errors).unwrap();
            let minimum = Minimizer::default().minimize(&mut cost, &mut v, &mut quiet).unwrap();
            let found = consistency(&values, &sigma, &at_background, cost.predicted(), &spread, &groups);
            chi2 += 2.0 * minimum.value / 12.0 / 200.0;
            for (sums, found) in sums.iter_mut().zip(&found) {
                assert_eq!(found.count, 6);
                sums[0] += found.observation_ratio / 200.0;
                sums[1] += found.background_ratio / 200.0;
                sums[2] += found.innovation_ratio / 200.0;
            }
        }
        (sums, chi2)
    };
    let (right, chi2) = run(1.0);
    // χ² has variance 2/12 in each of 200 twins; the ratios up to 2 (one strong direction). Four standard
    // deviations.
    assert!((chi2 - 1.0).abs() <= 4.0 * (2.0 / 12.0 / 200.0f64).sqrt(), "{chi2}");
    for ratio in right.iter().flatten() {
        assert!((ratio - 1.0).abs() <= 4.0 * (2.0 / 200.0f64).sqrt(), "{right:?}");
    }
    let (wrong, chi2) = run(2.0);
    assert!(wrong[1][0] < 0.6, "{wrong:?}");
    assert!(chi2 < 0.8, "{chi2}");
    assert!(consistency(&[1.0], &[1.0], &[0.0], &[0.5], &[1.0], &[1])[0].observation_ratio.is_nan());
}

/// A chaotic model at a point where second derivatives matter; so many times and components seen with
/// σ = 1/scale.
fn lorenz96_away_from_the_minimum(
    (times, components, scale): (usize, usize, f64),
    check: &mut dyn FnMut(&mut dyn LeastSquares),
) {
    let n = 40;
    let background: Vec<f64> = (0..n).map(|i| 8.0 + 4.0 * (0.9 * i as f64).sin()).collect();
    let seen = (1..=times).map(|i| {
        let y = (0..components).map(|j| 8.0 + 4.0 * (0.8 * (j + i) as f64).cos()).collect();
        Observation::new(4 * i, (0..components).collect(), y, 1.0 / scale)
    });
    let even = Selection::new((0..n / 2).map(|j| 2 * j).collect(), n).unwrap();
    let mut set = ObservationSet::new(20, vec![Box::new(even)], seen.collect()).unwrap();
    let b = varda_covariance::Diagonal::uniform(n, 0.5).unwrap();
    let mut model = varda_implicit::Rk4::new(varda_implicit::lorenz::Lorenz96::new(n, 8.0), 0, 0.01);
    let transform = ControlTransform::new(background, &b).unwrap();
    let mut cost = StrongConstraint::new(&mut model, transform, &mut set).unwrap();
    let v: Vec<f64> = (0..n).map(|i| 0.2 * (i as f64).sin()).collect();
    cost.evaluate(&v, Some(&mut vec![0.0; n])).unwrap();
    check(&mut cost);
}

#[test]
fn the_exact_hessian_has_a_posterior_of_low_rank_with_a_bound() {
    lorenz96_away_from_the_minimum((5, 20, 0.2), &mut |cost| {
        let n = cost.dim();
        let (dense, inverse) = dense_exact(cost);
        // on both sides of what Gauss and Newton have
        assert!(dense.spectrum()[0] < 0.999 && dense.spectrum()[n - 1] > 1.2, "{:?}", dense.spectrum());
        for (tolerance, most) in [(1e-9, 200), (1e-6, 12), (1e-6, 25)] {
            let low = low_rank(cost, tolerance, most);
            assert!(most < n || low.error_bound().is_some_and(|bound| bound <= tolerance));
            let found = error(&low, &inverse);
            // 1e-11: the rounding of the inverse compared
            assert!(low.error_bound().is_none_or(|bound| found <= bound + 1e-11), "{found:e}");
        }
        // Gauss–Newton's is another one
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let other = LowRankPosterior::lanczos(cost, &LanczosOptions::default(), &mut rng).unwrap();
        assert!(error(&other, &inverse) > 1e-3);
    });
    // few values: few directions
    lorenz96_away_from_the_minimum((1, 2, 1.0), &mut |cost| {
        let (dense, inverse) = dense_exact(cost);
        assert!(dense.spectrum()[0] < 0.999, "{:?}", dense.spectrum());
        let low = low_rank(cost, 1e-5, 200);
        let (bound, found) = (low.error_bound().unwrap(), error(&low, &inverse));
        assert!(found <= bound + 1e-11 && bound <= 1e-5, "{found:e} {bound:e}");
        assert!(low.products() < cost.dim() && low.spectrum()[0] < 0.999, "{}", low.products());
    });
    lorenz96_away_from_the_minimum((5, 20, 3.0), &mut |cost| {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let indefinite = LowRankPosterior::lanczos_exact(cost, &LanczosOptions::default(), &mut rng);
        let Err(Error::NotPositiveDefinite { smallest }) = indefinite else { panic!("{indefinite:?}") };
        let dense = Posterior::exact(cost);
        let Err(Error::NotPositiveDefinite { smallest: least }) = dense else { panic!("definite") };
        assert!(smallest <= 0.0 && smallest >= least * (1.0 + 1e-9), "{smallest} {least}");
    });
}

fn low_rank(cost: &mut dyn LeastSquares, tolerance: f64, most: usize) -> LowRankPosterior {
    let options = LanczosOptions::default().with_tolerance(tolerance).with_max_products(most);
    LowRankPosterior::lanczos_exact(cost, &options, &mut ChaCha8Rng::seed_from_u64(5)).unwrap()
}

/// The posterior of the dense exact Hessian, and the Hessian's inverse.
fn dense_exact(cost: &mut dyn LeastSquares) -> (Posterior, Vec<f64>) {
    let n = cost.dim();
    let dense = Posterior::exact(cost).unwrap();
    let identity = varda_covariance::Diagonal::uniform(n, 1.0).unwrap();
    let root = dense.control_root(&ControlTransform::new(vec![0.0; n], &identity).unwrap());
    let mut inverse = vec![0.0; n * n];
    for column in root.chunks_exact(n) {
        for (out, c) in inverse.chunks_exact_mut(n).zip(column) {
            out.iter_mut().zip(column).for_each(|(out, d)| *out += c * d);
        }
    }
    (dense, inverse)
}
