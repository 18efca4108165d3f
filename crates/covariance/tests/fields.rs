//! Fields on grids against what is known in closed form, and covariances made of others.

mod promises;

use std::rc::Rc;
use std::sync::Arc;

use promises::{columns, inverse_errors, out, worst_broken_promise};
use proptest::prelude::*;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda_covariance::{
    Banded, Covariance, CovarianceFunction, Dense, Diagonal, Diffusion, Error, Grid, Interleaved, Kernel,
    Kronecker, Ordering, Precision, Scaled, SparsePrecision, Sum, Taper, sample,
};
use varda_linalg::Structure;

fn grids() -> impl Strategy<Value = Grid> {
    let line = (1..14_usize, 0.1..2.0).prop_map(|(n, h)| Grid::line(n, h).unwrap());
    let rectangle = (1..5_usize, 1..5_usize, 0.1..2.0, 0.1..2.0)
        .prop_map(|(nx, ny, hx, hy)| Grid::rectangle([nx, ny], [hx, hy]).unwrap());
    (prop_oneof![line, rectangle], any::<bool>())
        .prop_map(|(grid, periodic)| if periodic { grid.periodic() } else { grid })
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(96) })]

    #[test]
    fn fields_on_grids_keep_their_promises(
        grid in grids(), sigma in 0.01..100.0, length in 0.1..3.0, alpha in 2_usize..4, half in 1_usize..4,
        seed in 0_u64..1000,
    ) {
        let n = grid.dim();
        let varying: Vec<f64> = (0..n).map(|i| sigma * (1.0 + i as f64)).collect();
        let matern = SparsePrecision::matern(grid, sigma, length, alpha).unwrap();
        let diffusion = Diffusion::new(grid, &varying, length, 2 * half).unwrap();
        for b in [&matern as &dyn Precision, &diffusion] {
            // Their products are solves: rounding is that of the promise times the condition of one factor.
            let allowed = 1e3;
            prop_assert!(worst_broken_promise(b, seed) <= allowed);
            let (solve, whiten) = inverse_errors(b, seed);
            prop_assert!(solve <= 1.0 && whiten <= 1.0, "{solve} {whiten}");
        }
    }

    #[test]
    fn combined_covariances_keep_their_promises(
        n in 1_usize..6, m in 1_usize..5, sigma in 0.1..10.0, length in 0.05..1.0, seed in 0_u64..1000,
    ) {
        let matrix = |n: usize| {
            let kernel = Kernel::Matern12 { length };
            let function = CovarianceFunction { sigma, kernel, taper: Taper::None };
            function.matrix(&(0..n).map(|i| i as f64 / n as f64).collect::<Vec<_>>()).unwrap()
        };
        let a = Arc::new(Dense::new(n, &matrix(n)).unwrap());
        let c = Rc::new(Dense::new(m, &matrix(m)).unwrap());
        let scaled = Scaled::new(a.clone(), (0..n).map(|i| 0.5 + i as f64).collect()).unwrap();
        let kronecker = Kronecker::new(&scaled, c.clone());
        let full = matrix(m);
        let whole = columns(n * m, n * m, |x, y| kronecker.apply(x, y));
        let outer = columns(n, n, |x, y| scaled.apply(x, y));
        for (p, q) in (0..n * m).flat_map(|p| (0..n * m).map(move |q| (p, q))) {
            let expected = outer[q / m][p / m] * full[p % m * m + q % m];
            prop_assert!((whole[q][p] - expected).abs() <= 1e-13 * sigma.powi(4) * (n * n) as f64);
        }
        for b in [&scaled as &dyn Precision, &kronecker, &a, &c] {
            prop_assert!(worst_broken_promise(b, seed) <= 1.0);
            let (solve, whiten) = inverse_errors(b, seed);
            prop_assert!(solve <= 1.0 && whiten <= 1.0, "{solve} {whiten}");
        }
        let parts: Vec<Box<dyn Covariance + '_>> =
            vec![Box::new(&scaled), Box::new(a.clone()), Box::new(Diagonal::uniform(n, sigma).unwrap())];
        let sum = Sum::new(parts).unwrap();
        prop_assert!(worst_broken_promise(&sum, seed) <= 1.0);
        let (mut one, mut total) = (vec![0.0; n], vec![0.0; n]);
        for part in sum.parts() {
            part.variance(&mut one);
            varda_linalg::axpy(1.0, &one, &mut total);
        }
        prop_assert_eq!(out(n, |v| sum.variance(v)), total);
    }
}

/// K_ν(x) x^ν 2^{1−ν} / Γ(ν): the Matérn correlation, by K_ν(x) = ∫₀^∞ exp(−x cosh t) cosh
/// νt dt.
fn matern(nu: f64, gamma: f64, x: f64) -> f64 {
    if x == 0.0 {
        return 1.0;
    }
    let h = 1e-3;
    let bessel: f64 = (0..20_000)
        .map(|k| {
            let t = h * (k as f64 + 0.5);
            h * (-x * t.cosh()).exp() * (nu * t).cosh()
        })
        .sum();
    bessel * x.powf(nu) * 2.0_f64.powf(1.0 - nu) / gamma
}

#[test]
fn stencils_are_matern_fields_on_lines() {
    let (n, h, sigma, length) = (401, 0.05, 1.5, 1.0);
    let grid = Grid::line(n, h).unwrap();
    let middle = n / 2;
    let mut unit = vec![0.0; n];
    unit[middle] = 1.0;
    for (alpha, kernel) in
        [(1, Kernel::Matern12 { length }), (2, Kernel::Matern32 { length }), (3, Kernel::Matern52 { length })]
    {
        let b = SparsePrecision::matern(grid, sigma, length, alpha).unwrap();
        let column = out(n, |y| b.apply(&unit, y));
        for (i, value) in column.iter().enumerate() {
            let d = h * i.abs_diff(middle) as f64;
            let expected = sigma * sigma * kernel.at(d);
            // The stencil's error is of the order of h²/L² = 2.5e-3; mirror images are 20 L away. Found:
            // 3.1e-4, 9.3e-4, 5.2e-4.
            assert!((value - expected).abs() <= 2.5e-3 * sigma * sigma, "{alpha} {d}: {value} {expected}");
        }
    }
    // The mirrored end doubles the variance of a rough field, and leaves it alone a few lengths inside.
    let b = SparsePrecision::matern(grid, sigma, length, 1).unwrap();
    let variance = out(n, |v| b.variance(v));
    assert!((variance[0] / (2.0 * sigma * sigma) - 1.0).abs() < 0.05, "{}", variance[0]);
    assert!((variance[100] / (sigma * sigma) - 1.0).abs() < 1e-3);
    let ring = SparsePrecision::matern(grid.periodic(), sigma, length, 1).unwrap();
    let variance = out(n, |v| ring.variance(v));
    assert!(variance.iter().all(|v| (v - variance[0]).abs() <= 1e-12 * variance[0]));
}

#[test]
fn stencils_are_matern_fields_on_rectangles() {
    let ([nx, ny], h, sigma, length) = ([81, 61], 0.1, 0.5, 1.0);
    let grid = Grid::rectangle([nx, ny], [h, h]).unwrap().periodic();
    let mut unit = vec![0.0; nx * ny];
    unit[40 + nx * 30] = 1.0;
    for (alpha, nu, gamma) in [(2, 1.0, 1.0), (3, 2.0, 1.0)] {
        let b = SparsePrecision::matern(grid, sigma, length, alpha).unwrap();
        let column = out(nx * ny, |y| b.apply(&unit, y));
        let mut worst: f64 = 0.0;
        for (i, j) in [(40, 30), (41, 30), (40, 34), (46, 30), (45, 35), (50, 24), (40, 50)] {
            let d = h * ((i as f64 - 40.0).powi(2) + (j as f64 - 30.0).powi(2)).sqrt();
            let expected = sigma * sigma * matern(nu, gamma, (2.0 * nu).sqrt() * d / length);
            let found = column[i + nx * j];
            worst = worst.max((found - expected).abs() / (sigma * sigma));
        }
        // The stencil's error is largest at distance 0, some 1.5 h²/L² (found: 1.5e-2, 5.6e-3).
        assert!(worst <= 2e-2, "{alpha}: {worst}");
        let variance = out(nx * ny, |v| b.variance(v));
        assert!((variance[7] - column[40 + nx * 30]).abs() <= 1e-10 * variance[7]);
    }
}

#[test]
fn diffusion_is_nearly_the_kernel_it_stands_for() {
    let (n, h, length) = (301, 0.05, 1.0);
    let sigma: Vec<f64> = (0..n).map(|i| 1.0 + 0.01 * i as f64).collect();
    let grid = Grid::line(n, h).unwrap();
    let mut unit = vec![0.0; n];
    unit[150] = 1.0;
    for (steps, kernel, tolerance) in [
        (2, Kernel::Matern32 { length }, 2e-3),
        // ν = 49.5 stands for ∞
        (50, Kernel::Gaussian { length }, 1e-2),
    ] {
        let b = Diffusion::new(grid, &sigma, length, steps).unwrap();
        let column = out(n, |y| b.apply(&unit, y));
        for (i, value) in column.iter().enumerate() {
            let expected = sigma[i] * sigma[150] * kernel.at(h * i.abs_diff(150) as f64);
            assert!(
                (value - expected).abs() <= tolerance * sigma[i] * sigma[150],
                "{steps} {i}: {value} {expected}"
            );
        }
        // normalised at the ends too
        unit[150] = 0.0;
        unit[0] = 1.0;
        let column = out(n, |y| b.apply(&unit, y));
        assert!((column[0] - 1.0).abs() <= 1e-12, "{}", column[0]);
        unit[0] = 0.0;
        unit[150] = 1.0;
    }
}

/// 320 × 320 points: the sizes a dense root is far from.
#[test]
fn a_hundred_thousand_points() {
    let side = 320;
    let n = side * side;
    let grid = Grid::rectangle([side, side], [1.0, 1.0]).unwrap();
    let b = SparsePrecision::matern(grid, 2.0, 10.0, 2).unwrap();
    let diffusion = Diffusion::new(grid, &vec![2.0; n], 10.0, 4).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for (b, tolerance) in [(&b as &dyn Precision, 1e-9), (&diffusion, 1e-9)] {
        let x = sample(b, &mut rng);
        // xᵀ B⁻¹ x is χ² of n degrees: five standard deviations
        let v = out(n, |v| b.whiten(&x, v));
        let square = varda_linalg::dot(&v, &v);
        assert!((square - n as f64).abs() <= 5.0 * (2.0 * n as f64).sqrt(), "{square}");
        let (y, back) = (out(n, |y| b.solve(&x, y)), |y: &[f64]| out(n, |z| b.apply(y, z)));
        let z = back(&y);
        let worst = z.iter().zip(&x).fold(0.0, |m: f64, (z, x)| m.max((z - x).abs()));
        // condition of P some (1 + 8 / κ²)² = 1e5, σ = 2
        assert!(worst <= tolerance, "{worst:e}");
        let points = (40 * side..280 * side).step_by(7).map(|p| x[p] * x[p]);
        let (sum, count) = points.fold((0.0, 0.0), |(s, c), x2| (s + x2, c + 1.0));
        // some 24² independent patches of a correlation length: 6 % standard error, allow four
        assert!((sum / count / 4.0 - 1.0).abs() <= 0.25, "{}", sum / count);
    }
}

/// Draws of a Matérn field have its covariance: the lag products of many draws against the kernel.
#[test]
fn draws_have_the_analytic_covariance() {
    let (n, h, length, draws) = (64, 0.1, 0.5, 4000);
    let grid = Grid::line(n, h).unwrap().periodic();
    let b = SparsePrecision::matern(grid, 1.0, length, 2).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let lags = [0, 1, 3, 6, 12];
    let mut products = [0.0; 5];
    for _ in 0..draws {
        let x = sample(&b, &mut rng);
        for (product, lag) in products.iter_mut().zip(lags) {
            *product += (0..n).map(|i| x[i] * x[(i + lag) % n]).sum::<f64>() / (n * draws) as f64;
        }
    }
    for (product, lag) in products.iter().zip(lags) {
        let expected = Kernel::Matern32 { length }.at(h * lag as f64);
        // 4000 draws of some 6 independent patches: a standard error of 1 %; the stencil's own error is
        // h²κ²/12 = 1 %
        assert!((product - expected).abs() <= 0.04, "{lag}: {product} {expected}");
    }
}

#[test]
fn a_precision_matrix_is_the_inverse_of_its_covariance() {
    // An autoregressive chain: P tridiagonal, B_ij = ρ^|i−j| / (1 − ρ²).
    let (n, rho) = (30, 0.7);
    let structure = Structure::tridiagonal();
    let values = structure.values(n, |i, j| match (i, j) {
        _ if i != j => -rho,
        (0, 0) => 1.0,
        _ if i + 1 == n => 1.0,
        _ => 1.0 + rho * rho,
    });
    let b = SparsePrecision::new(n, structure, values, Ordering::Natural).unwrap();
    for (j, column) in columns(n, n, |x, y| b.apply(x, y)).iter().enumerate() {
        for (i, value) in column.iter().enumerate() {
            let expected = rho.powi(i.abs_diff(j) as i32) / (1.0 - rho * rho);
            assert!((value - expected).abs() <= 1e-13, "{value} {expected}");
        }
    }
}

#[test]
fn bad_fields_are_typed_errors() {
    assert!(matches!(Grid::line(0, 1.0), Err(Error::Size { .. })));
    assert!(matches!(Grid::rectangle([2, 2], [1.0, f64::NAN]), Err(Error::Parameter { .. })));
    let (line, plane) = (Grid::line(4, 1.0).unwrap(), Grid::rectangle([2, 2], [1.0, 1.0]).unwrap());
    for (grid, sigma, length, alpha) in [
        (plane, 1.0, 1.0, 1),
        (line, 1.0, 1.0, 0),
        (line, 1.0, 1.0, 5),
        (line, 0.0, 1.0, 1),
        (line, f64::NAN, 1.0, 1),
        (line, 1.0, -1.0, 1),
        (line, 1.0, f64::INFINITY, 1),
    ] {
        let made = SparsePrecision::matern(grid, sigma, length, alpha);
        assert!(matches!(made, Err(Error::Parameter { .. })), "{made:?}");
    }
    for (sigma, length, steps) in [(0.0, 1.0, 2), (1.0, 0.0, 2), (1.0, 1.0, 3), (1.0, 1.0, 0)] {
        assert!(matches!(Diffusion::new(line, &[sigma; 4], length, steps), Err(Error::Parameter { .. })));
    }
    assert!(matches!(
        Diffusion::new(line, &[1.0; 3], 1.0, 2),
        Err(Error::Size { expected: 4, found: 3, .. })
    ));
    let new = |values: &[f64]| SparsePrecision::new(2, Structure::Dense, values.to_vec(), Ordering::Natural);
    assert!(matches!(new(&[1.0, 0.5, 0.4, 1.0]), Err(Error::NotSymmetric { .. })));
    assert!(matches!(new(&[1.0, 2.0, 2.0, 1.0]), Err(Error::NotPositiveDefinite { pivot: 1, .. })));
    assert!(matches!(new(&[1.0, f64::NAN, f64::NAN, 1.0]), Err(Error::NonFinite { .. })));
    assert!(matches!(new(&[1.0]), Err(Error::Size { .. })));
    let one = || Diagonal::uniform(1, 1.0).unwrap();
    assert!(matches!(Sum::<Diagonal>::new(vec![]), Err(Error::Size { .. })));
    assert!(matches!(Sum::new(vec![one(), Diagonal::uniform(2, 1.0).unwrap()]), Err(Error::Size { .. })));
    assert!(matches!(Scaled::new(one(), vec![]), Err(Error::Size { .. })));
    assert!(matches!(Scaled::uniform(one(), f64::NAN), Err(Error::Parameter { .. })));
}

/// One field shared by several owners, without copies.
#[test]
fn a_shared_covariance_is_one() {
    let function = CovarianceFunction {
        sigma: 1.0,
        kernel: Kernel::Matern12 { length: 0.2 },
        taper: Taper::Triangle { support: 0.5 },
    };
    let places: Vec<f64> = (0..20).map(|i| 0.05 * i as f64).collect();
    let b = Banded::along(&function, &places).unwrap();
    let (arc, rc) = (Arc::new(b.clone()), Rc::new(b.clone()));
    let erased: Arc<dyn Precision> = arc.clone();
    let interleaved = Interleaved::new(erased.clone(), 1);
    let x: Vec<f64> = (0..20).map(|i| (i as f64).sin()).collect();
    let expected = out(20, |y| b.solve(&x, y));
    for shared in [&&b as &dyn Precision, &arc, &rc, &erased, &interleaved] {
        assert_eq!(out(20, |y| shared.solve(&x, y)), expected);
    }
}
