//! The covariance of the states that a model passes through.

use varda_implicit::Model;

use crate::Error;

/// The covariance of the states of a run, row by row: of `steps` + 1 states, the first of them `spin_up`
/// steps after `start`.
///
/// ```text
///     C = Σ_k (x_k − x̄)(x_k − x̄)ᵀ / steps,    k = spin_up … spin_up + steps
/// ```
///
/// # Errors
/// [`Error::Preparation`] naming the step at which the model stopped.
pub fn covariance(
    model: &mut dyn Model,
    start: &[f64],
    spin_up: usize,
    steps: usize,
) -> Result<Vec<f64>, Error> {
    let n = start.len();
    // Sums about the start: they lose (distance of the start from the mean / σ)² ε by cancellation.
    let (mut sum, mut products) = (vec![0.0; n], vec![0.0; n * n]);
    let (mut x, mut next, mut d) = (start.to_vec(), vec![0.0; n], vec![0.0; n]);
    for k in 0..=spin_up + steps {
        if k >= spin_up {
            for i in 0..n {
                d[i] = x[i] - start[i];
                sum[i] += d[i];
                for j in 0..=i {
                    products[i * n + j] += d[i] * d[j];
                }
            }
        }
        if k < spin_up + steps {
            model
                .step(k, &x, &mut next)
                .map_err(|reason| Error::Preparation { stage: "climatology", reason })?;
            std::mem::swap(&mut x, &mut next);
        }
    }
    let count = (steps + 1) as f64;
    for i in 0..n {
        for j in 0..=i {
            let c = (products[i * n + j] - sum[i] * sum[j] / count) / steps as f64;
            products[i * n + j] = c;
            products[j * n + i] = c;
        }
    }
    Ok(products)
}

#[cfg(test)]
mod tests {
    use super::covariance;
    use crate::setup::runs::run_states;
    use varda_implicit::{Rk4, lorenz::Lorenz63};

    #[test]
    fn it_is_the_sample_covariance_in_two_passes() {
        let start = [1.5, -1.5, 25.0];
        let made = || Rk4::new(Lorenz63::default(), 0, 0.02);
        let c = covariance(&mut made(), &start, 30, 400).unwrap();
        let states = run_states(&mut made(), &start, 430).unwrap();
        let states: Vec<&[f64]> = states.chunks_exact(3).skip(30).collect();
        assert_eq!(states.len(), 401);
        let mean: Vec<f64> = (0..3).map(|i| states.iter().map(|x| x[i]).sum::<f64>() / 401.0).collect();
        for (i, j) in (0..9).map(|ij| (ij / 3, ij % 3)) {
            let two = states.iter().map(|x| (x[i] - mean[i]) * (x[j] - mean[j])).sum::<f64>() / 400.0;
            // Entries are about 70; one-pass sums of 401 terms lose a few digits of sixteen.
            assert!((c[3 * i + j] - two).abs() < 1e-10, "{i} {j}: {} {two}", c[3 * i + j]);
        }
    }
}
