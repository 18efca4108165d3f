//! Roots of kernels, conditioned or not, and what is no covariance.

use varda_covariance::{Covariance, CovarianceFunction, Error, Kernel, Taper, Truncated, correlation};

/// The vertices of a rod of length 1 whose first edge is held.
fn places(segments: usize) -> (Vec<f64>, Vec<f64>) {
    let at = |i: usize| i as f64 / segments as f64;
    ((2..=segments).map(at).collect(), vec![at(0), at(1)])
}

/// A correlation length of the rod and far more: conditioning leaves 1e-4 of the variance, or next to none.
#[test]
fn long_correlations_have_a_root() {
    for segments in [12, 48] {
        let (free, known) = places(segments);
        let n = free.len();
        for length in [0.1, 0.5, 1.0, 3.0, 10.0, 30.0] {
            for sigma in [1e-4, 1.0, 50.0] {
                for kernel in
                    [Kernel::Gaussian { length }, Kernel::Matern52 { length }, Kernel::Matern32 { length }]
                {
                    for held in [&[][..], &known] {
                        let function = CovarianceFunction { sigma, kernel, taper: Taper::None };
                        let matrix = function.conditioned_matrix(&free, held).unwrap();
                        let case = format!("{segments} {length} {sigma} {kernel:?} {}", held.len());
                        let b = Truncated::of_kernel(n, &matrix, 1e-14, sigma * sigma);
                        let b = b.unwrap_or_else(|e| panic!("{case}: {e}"));
                        let mut unit = vec![0.0; n];
                        let mut column = vec![0.0; n];
                        for j in 0..n {
                            unit[j] = 1.0;
                            b.apply(&unit, &mut column);
                            unit[j] = 0.0;
                            for i in 0..n {
                                // Below zero is cut off, up to the rounding allowed.
                                let bound = 1e3 * n as f64 * f64::EPSILON * sigma * sigma;
                                let gap = (column[i] - matrix[i * n + j]).abs();
                                assert!(gap <= bound, "{case}: {gap:e} {bound:e}");
                            }
                        }
                    }
                }
            }
        }
    }
}

/// A Gaussian of the arc of a circle is no covariance, whatever part of the variance is to be kept.
#[test]
fn an_indefinite_kernel_is_refused_at_any_truncation() {
    let n = 100;
    let arc = |i: usize, j: usize| i.abs_diff(j).min(n - i.abs_diff(j)) as f64 / n as f64;
    let chord = |i: usize, j: usize| (std::f64::consts::PI * arc(i, j)).sin();
    let matrix = |kernel, distance: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
        (0..n * n).map(|ij| correlation(kernel, Taper::None, distance(ij / n, ij % n))).collect()
    };
    let rough = matrix(Kernel::Gaussian { length: 0.4 }, &arc);
    for tolerance in [0.0, 1e-3, 0.1, 0.5] {
        let refused = Truncated::of_kernel(n, &rough, tolerance, 1.0);
        let Err(Error::NotPositiveSemidefinite { value, largest }) = refused else {
            panic!("{tolerance}: accepted")
        };
        assert!(value < -1e-3 * largest, "a kernel that is indefinite only by rounding: {value} {largest}");
    }
    // On a circle the chord is a distance in the plane: without a taper every kernel here is one.
    let smooth = matrix(Kernel::Gaussian { length: 0.3 }, &chord);
    assert!(Truncated::of_kernel(n, &smooth, 1e-12, 1.0).is_ok());
}
