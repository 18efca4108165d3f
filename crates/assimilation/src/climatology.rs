//! Mean and covariance of the states that a model passes through.

use varda_implicit::{Error, Model};

/// Where a model is, and how far its states spread, over a long free run: the guess and the errors of someone
/// who knows nothing of today. A share of the covariance is the usual static B of a chaotic model.
///
/// ```
/// use varda_assimilation::Climatology;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.02);
/// let climate = Climatology::of_run(&mut model, &[1.5, -1.5, 25.0], 500, 20_000)?;
/// // x and y are as often negative as positive; z oscillates about 23.5.
/// assert!(climate.mean[0].abs() < 1.0 && (climate.mean[2] - 23.5).abs() < 0.5);
/// assert!((climate.covariance[0].sqrt() - 7.9).abs() < 0.2);
/// # Ok::<(), varda_implicit::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Climatology {
    /// x̄ = Σ_k x_k / (steps + 1).
    pub mean: Vec<f64>,
    /// C = Σ_k (x_k − x̄)(x_k − x̄)ᵀ / steps, n × n, row by row.
    pub covariance: Vec<f64>,
}

impl Climatology {
    /// Of `steps` + 1 states, k = spin_up … spin_up + steps, of a run from `start`, which is state 0. Sums
    /// go along with the run: no state is kept.
    ///
    /// The rank of the covariance is at most `steps`. Successive states are alike: what counts is how many
    /// times the run forgets where it was.
    ///
    /// # Errors
    /// That of a step that fails.
    ///
    /// # Panics
    /// If `steps` is zero or `start` has not the length of a state.
    pub fn of_run(
        model: &mut dyn Model,
        start: &[f64],
        spin_up: usize,
        steps: usize,
    ) -> Result<Climatology, Error> {
        let n = start.len();
        assert!(n == model.dim() && steps > 0, "a state has {} values, a spread two states", model.dim());
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
                model.step(k, &x, &mut next)?;
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
        let mean = sum.iter().zip(start).map(|(sum, start)| start + sum / count).collect();
        Ok(Climatology { mean, covariance: products })
    }
}

#[cfg(test)]
mod tests {
    use super::Climatology;
    use varda_implicit::{Keep, Rk4, Trajectory, lorenz::Lorenz63};

    #[test]
    fn it_is_the_sample_covariance_in_two_passes() {
        let start = [1.5, -1.5, 25.0];
        let made = || Rk4::new(Lorenz63::default(), 0, 0.02);
        let found = Climatology::of_run(&mut made(), &start, 30, 400).unwrap();
        let c = &found.covariance;
        let mut run = Trajectory::new();
        run.run(&mut made(), &start, 430, Keep::States).unwrap();
        let states: Vec<&[f64]> = (30..=430).map(|k| run.state(k)).collect();
        let mean: Vec<f64> = (0..3).map(|i| states.iter().map(|x| x[i]).sum::<f64>() / 401.0).collect();
        assert!((0..3).all(|i| (found.mean[i] - mean[i]).abs() < 1e-12), "{:?} {mean:?}", found.mean);
        for (i, j) in (0..9).map(|ij| (ij / 3, ij % 3)) {
            let two = states.iter().map(|x| (x[i] - mean[i]) * (x[j] - mean[j])).sum::<f64>() / 400.0;
            // Entries are about 70; one-pass sums of 401 terms lose a few digits of sixteen.
            assert!((c[3 * i + j] - two).abs() < 1e-10, "{i} {j}: {} {two}", c[3 * i + j]);
        }
    }
}
