//! What every covariance must do, checked on random ones.

mod promises;

use promises::{EPS, columns, inverse_errors, out, worst_broken_promise};
use proptest::prelude::*;
use rand::SeedableRng;
use rand::rngs::ChaCha8Rng;
use varda_covariance::{
    BlockDiagonal, Covariance, CovarianceFunction, Dense, Diagonal, Interleaved, Kernel, Precision, Spectrum,
    Taper, Truncated, sample,
};

fn kernels() -> impl Strategy<Value = Kernel> {
    (0..4, 0.02..2.0).prop_map(|(which, length)| match which {
        0 => Kernel::Gaussian { length },
        1 => Kernel::Matern12 { length },
        2 => Kernel::Matern32 { length },
        _ => Kernel::Matern52 { length },
    })
}

fn functions() -> impl Strategy<Value = CovarianceFunction> {
    (0.01..100.0, kernels(), 0..3, 0.05..3.0).prop_map(|(sigma, kernel, which, support)| CovarianceFunction {
        sigma,
        kernel,
        taper: match which {
            0 => Taper::None,
            1 => Taper::Triangle { support },
            _ => Taper::GaspariCohn { support },
        },
    })
}

fn places(count: impl Into<prop::collection::SizeRange>) -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(0.0..1.0, count)
}

/// A full-rank n × n matrix of a rough kernel on an even grid: condition numbers from about 1 to 1e6.
fn full_rank(n: usize, sigma: f64, length: f64) -> Vec<f64> {
    let function = CovarianceFunction {
        sigma,
        kernel: Kernel::Matern32 { length },
        taper: Taper::GaspariCohn { support: 1.0 },
    };
    function.matrix(&(0..n).map(|i| i as f64 / n as f64).collect::<Vec<_>>()).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(64) })]

    #[test]
    fn full_rank_covariances_keep_their_promises(
        n in 1_usize..12, c in 1_usize..4, sigma in 0.01..100.0, length in 0.02..2.0, seed in 0_u64..1000,
    ) {
        let dense = Dense::new(n, &full_rank(n, sigma, length)).unwrap();
        let interleaved = Interleaved::new(dense.clone(), c);
        let diagonal = Diagonal::new((0..n).map(|i| sigma * (1.0 + i as f64)).collect()).unwrap();
        let parts: Vec<Box<dyn Precision>> = vec![Box::new(interleaved.clone()), Box::new(diagonal.clone())];
        let blocks = BlockDiagonal::new(parts);
        for b in [&dense as &dyn Precision, &interleaved, &diagonal, &blocks] {
            prop_assert!(worst_broken_promise(b, seed) <= 1.0);
            let (solve, whiten) = inverse_errors(b, seed);
            prop_assert!(solve <= 1.0 && whiten <= 1.0, "{solve} {whiten}");
        }
    }

    #[test]
    fn the_root_is_that_of_the_matrix_given(n in 1_usize..12, sigma in 0.01..100.0, length in 0.02..2.0) {
        let matrix = full_rank(n, sigma, length);
        let roots: [&dyn Covariance; 3] = [
            &Dense::new(n, &matrix).unwrap(),
            &Truncated::eigen(n, &matrix, 0.0).unwrap(),
            &Truncated::pivoted_cholesky(n, &matrix, 0.0).unwrap(),
        ];
        for b in roots {
            for (j, column) in columns(n, n, |x, y| b.apply(x, y)).iter().enumerate() {
                for (i, value) in column.iter().enumerate() {
                    // Backward error of the factorization: n ε |B|₂ ≤ n² ε σ².
                    let bound = 4.0 * (n * n) as f64 * EPS * sigma * sigma;
                    prop_assert!((value - matrix[i * n + j]).abs() <= bound);
                }
            }
        }
    }

    #[test]
    fn truncated_covariances_keep_their_promises(
        function in functions(), s in places(1..30), tolerance in 0.0..0.2, c in 1_usize..3,
        seed in 0_u64..1000,
    ) {
        let n = s.len();
        let matrix = function.matrix(&s).unwrap();
        let eigen = Truncated::eigen(n, &matrix, tolerance).unwrap();
        let pivoted = Truncated::pivoted_cholesky(n, &matrix, tolerance).unwrap();
        let interleaved = Interleaved::new(eigen.clone(), c);
        for b in [&eigen as &dyn Covariance, &pivoted, &interleaved] {
            prop_assert!(worst_broken_promise(b, seed) <= 1.0);
        }

        let (tolerance, variance) = (tolerance + n as f64 * EPS, function.sigma * function.sigma);
        let largest = eigen.spectrum().unwrap().eigenvalues[0];
        for j in 0..n {
            let mut unit = vec![0.0; n];
            unit[j] = 1.0;
            for (b, bound) in [(&eigen, tolerance * largest), (&pivoted, tolerance * variance)] {
                let column = out(n, |y| b.apply(&unit, y));
                for i in 0..n {
                    let rounding = 4.0 * n as f64 * EPS * largest;
                    prop_assert!((column[i] - matrix[i * n + j]).abs() <= bound + rounding);
                }
            }
        }
    }

    #[test]
    fn structured_spectra_are_those_of_the_whole(n in 1_usize..8, length in 0.02..2.0, s in places(1..8)) {
        let kernel = Kernel::Gaussian { length };
        let smooth = CovarianceFunction { sigma: 1.0, kernel, taper: Taper::None };
        let truncated = Truncated::eigen(s.len(), &smooth.matrix(&s).unwrap(), 0.05).unwrap();
        let dense = Dense::new(n, &full_rank(n, 1.0, length)).unwrap();
        let diagonal: Vec<f64> = (1..=n).map(|i| i as f64).collect();
        // Interleaving repeats eigenvalues, blocks put them together.
        let each =
            |values: Vec<f64>, times| values.into_iter().flat_map(move |v| std::iter::repeat_n(v, times));
        let mut structured: Vec<f64> = each(truncated.spectrum().unwrap().eigenvalues, 2).collect();
        structured.extend(each(Spectrum::of(&dense).unwrap().eigenvalues, 3));
        structured.extend(diagonal.iter().map(|sigma| sigma * sigma));
        let structured = Spectrum::new(structured).eigenvalues;
        let parts: Vec<Box<dyn Covariance>> = vec![
            Box::new(Interleaved::new(truncated, 2)),
            Box::new(Interleaved::new(dense, 3)),
            Box::new(Diagonal::new(diagonal).unwrap()),
        ];
        let b = BlockDiagonal::new(parts);
        let whole = Spectrum::of(&b).unwrap().eigenvalues;
        prop_assert_eq!(structured.len(), b.dim());
        for (a, w) in structured.iter().zip(&whole) {
            // Weyl: eigenvalues are as good as the matrix and the iteration, some n ε of the largest.
            prop_assert!((a - w).abs() <= 4.0 * b.dim() as f64 * EPS * whole[0], "{a} {w}");
        }
    }

    #[test]
    fn localized_kernels_are_positive_semidefinite(function in functions(), s in places(1..40)) {
        let n = s.len();
        let matrix = function.matrix(&s).unwrap();
        for i in 0..n {
            prop_assert_eq!(matrix[i * n + i], function.sigma * function.sigma);
            for j in 0..n {
                prop_assert_eq!(matrix[i * n + j].to_bits(), matrix[j * n + i].to_bits());
            }
        }
        // An eigenvalue below −10 n ε λ₁, ten times what rounding makes, would be an error.
        prop_assert!(Truncated::eigen(n, &matrix, 10.0 * n as f64 * EPS).is_ok());
    }

    #[test]
    fn conditioning_removes_variance(
        function in functions(), s in places(1..20), gap in 0.1..0.5, known in 1_usize..4,
    ) {
        let known: Vec<f64> = (0..known).map(|i| i as f64 * gap).collect();
        let mut free = known.clone();
        free.extend(&s);
        let n = free.len();
        let prior = function.matrix(&free).unwrap();
        let matrix = function.conditioned_matrix(&free, &known).unwrap();
        let variance = function.sigma * function.sigma;
        for i in 0..n {
            prop_assert!(matrix[i * n + i] <= prior[i * n + i]);
            prop_assert!(matrix[i * n + i] >= 0.0);
            if i < known.len() {
                // W Wᵀ reproduces k_cc up to the backward error of its factor and of the triangular solve.
                prop_assert!(matrix[i * n + i] <= 100.0 * EPS * variance, "{}", matrix[i * n + i]);
            }
        }
    }
}

#[test]
fn a_wrong_transpose_a_wrong_variance_and_a_wrong_product_are_caught() {
    #[derive(PartialEq)]
    enum Mutation {
        None,
        Transpose,
        Variance,
        Product,
    }
    struct Mutated(Dense, Mutation);
    impl Covariance for Mutated {
        fn dim(&self) -> usize {
            self.0.dim()
        }
        fn root_dim(&self) -> usize {
            self.0.root_dim()
        }
        fn apply(&self, x: &[f64], y: &mut [f64]) {
            self.0.apply(x, y);
            if self.1 == Mutation::Product {
                y[0] += 1e-12 * x[1];
            }
        }
        fn root(&self, v: &[f64], x: &mut [f64]) {
            self.0.root(v, x);
        }
        fn root_transpose(&self, x: &[f64], v: &mut [f64]) {
            if self.1 == Mutation::Transpose { self.0.root(x, v) } else { self.0.root_transpose(x, v) }
        }
        fn variance(&self, variance: &mut [f64]) {
            self.0.variance(variance);
            if self.1 == Mutation::Variance {
                variance[0] *= 1.0 + 1e-12;
            }
        }
    }
    let dense = Dense::new(5, &full_rank(5, 1.0, 0.3)).unwrap();
    assert!(worst_broken_promise(&Mutated(dense.clone(), Mutation::None), 1) <= 1.0);
    for mutation in [Mutation::Transpose, Mutation::Variance, Mutation::Product] {
        assert!(worst_broken_promise(&Mutated(dense.clone(), mutation), 1) > 10.0);
    }
}

#[test]
fn draws_have_the_mean_and_the_covariance() {
    let (n, draws) = (10, 4000);
    let matrix = full_rank(n, 2.0, 0.3);
    let roots: [&dyn Covariance; 2] =
        [&Dense::new(n, &matrix).unwrap(), &Truncated::eigen(n, &matrix, 0.0).unwrap()];
    for b in roots {
        let mut rng = ChaCha8Rng::seed_from_u64(20);
        let (mut mean, mut product) = (vec![0.0; n], vec![0.0; n * n]);
        for _ in 0..draws {
            let x = sample(b, &mut rng);
            for i in 0..n {
                mean[i] += x[i] / draws as f64;
                for j in 0..n {
                    product[i * n + j] += x[i] * x[j] / draws as f64;
                }
            }
        }
        // Standard errors of Gaussian moments: √(b_ii/N) and √((b_ii b_jj + b_ij²)/N) (Wishart). The
        // largest of 65 lies within 4.5 of them in all but 5 of 10 000 seeds.
        let worst = |scale: f64| {
            let mut worst: f64 = 0.0;
            for i in 0..n {
                worst = worst.max(mean[i].abs() / (scale * matrix[i * n + i] / draws as f64).sqrt());
                for j in 0..n {
                    let expected = scale * matrix[i * n + j];
                    let variances = scale * scale * matrix[i * n + i] * matrix[j * n + j];
                    let error = ((variances + expected * expected) / draws as f64).sqrt();
                    worst = worst.max((product[i * n + j] - expected).abs() / error);
                }
            }
            worst
        };
        assert!(worst(1.0) <= 4.5, "{}", worst(1.0));
        // Check the check: variances a quarter larger do not pass.
        assert!(worst(1.25) > 4.5, "{}", worst(1.25));
    }
}

#[test]
fn draws_depend_on_the_generator_alone() {
    let b = Interleaved::new(Dense::new(4, &full_rank(4, 1.0, 0.3)).unwrap(), 3);
    let draw = |seed| sample(&b, &mut ChaCha8Rng::seed_from_u64(seed));
    assert_eq!(draw(1), draw(1));
    assert_ne!(draw(1), draw(2));
}
