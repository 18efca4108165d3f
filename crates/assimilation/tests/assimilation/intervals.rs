//! Intervals of one number of a posterior, against quadrature.

use std::ops::ControlFlow;

use varda_assimilation::{CostFunction, CostTerms, Counts, Error, LeastSquares, Minimizer, Posterior};

/// An amplitude eᵖ beside an offset q, both unknown with standard normal priors: y_i = exp(σ_b p) c_i + q.
struct Amplitude {
    sigma_b: f64,
    noise: f64,
    seen: Vec<(f64, f64)>,
    /// p may not be below it.
    wall: f64,
    at: [f64; 2],
    counts: Counts,
}

impl Amplitude {
    fn new(sigma_b: f64, noise: f64, wall: f64) -> Self {
        let seen = [(1.0, 1.1), (-0.5, -0.1), (0.7, 0.6)].to_vec();
        Self { sigma_b, noise, seen, wall, at: [0.0; 2], counts: Counts::default() }
    }

    fn value(&self, [p, q]: [f64; 2]) -> f64 {
        let misfit = |(c, y): &(f64, f64)| ((self.sigma_b * p).exp() * c + q - y) / self.noise;
        0.5 * (p * p + q * q + self.seen.iter().map(|seen| misfit(seen).powi(2)).sum::<f64>())
    }

    fn rows(&self) -> Vec<[f64; 2]> {
        let scale = self.sigma_b * (self.sigma_b * self.at[0]).exp();
        self.seen.iter().map(|(c, _)| [scale * c / self.noise, 1.0 / self.noise]).collect()
    }
}

impl CostFunction for Amplitude {
    fn dim(&self) -> usize {
        2
    }
    fn evaluate(&mut self, v: &[f64], gradient: Option<&mut [f64]>) -> Result<f64, Error> {
        self.counts.forward_runs += 1;
        if !(v[0] > self.wall) {
            return Err(Error::NonFinite { what: "the wall", step: 0 });
        }
        if let Some(g) = gradient {
            self.counts.gradients += 1;
            self.at = [v[0], v[1]];
            g.copy_from_slice(v);
            for (row, (c, y)) in self.rows().iter().zip(&self.seen) {
                let r = ((self.sigma_b * v[0]).exp() * c + v[1] - y) / self.noise;
                (0..2).for_each(|i| g[i] += row[i] * r);
            }
        }
        Ok(self.value([v[0], v[1]]))
    }
    fn terms(&self) -> CostTerms {
        CostTerms::default()
    }
    fn set_observation_scale(&mut self, _: f64) {}
    fn counts(&self) -> Counts {
        self.counts
    }
}

impl LeastSquares for Amplitude {
    fn background_dim(&self) -> usize {
        2
    }
    fn observation_dim(&self) -> usize {
        3
    }
    fn departures(&self, b: &mut [f64], d: &mut [f64]) {
        b.copy_from_slice(&self.at.map(|v| -v));
        for (d, (c, y)) in d.iter_mut().zip(&self.seen) {
            *d = (y - (self.sigma_b * self.at[0]).exp() * c - self.at[1]) / self.noise;
        }
    }
    fn jacobian(&mut self, p: &[f64], dy: &mut [f64]) -> Result<(), Error> {
        self.rows().iter().zip(dy).for_each(|(row, dy)| *dy = row[0] * p[0] + row[1] * p[1]);
        Ok(())
    }
    fn jacobian_transpose(&mut self, dy: &[f64], p: &mut [f64]) -> Result<(), Error> {
        p.fill(0.0);
        self.rows().iter().zip(dy).for_each(|(row, dy)| (0..2).for_each(|i| p[i] += row[i] * dy));
        Ok(())
    }
}

/// The 2.5 and 97.5 % points of p by sums over a grid.
fn by_quadrature(cost: &Amplitude) -> [f64; 2] {
    let h = 0.01;
    let of_p = |i: i32| -> f64 {
        let p = f64::from(i) * h;
        if !(p > cost.wall) {
            return 0.0;
        }
        (-600..=600).map(|j| (-cost.value([p, f64::from(j) * h])).exp()).sum()
    };
    let density: Vec<f64> = (-600..=600).map(of_p).collect();
    let total: f64 = density.iter().sum();
    [0.025, 0.975].map(|share| {
        let mut sum = 0.0;
        let end = density.iter().position(|d| {
            sum += d / total;
            sum >= share
        });
        h * (end.unwrap() as f64 - 600.0)
    })
}

/// The minimum in p, σ and the interval.
fn found(cost: &mut Amplitude) -> (f64, f64, [f64; 2]) {
    let mut v = vec![0.0; 2];
    Minimizer::default().minimize(cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
    let posterior = Posterior::new(cost).unwrap();
    let sigma = posterior.control_variable_variance()[0].sqrt();
    let [low, high] = posterior.interval(cost, &v, &[1.0, 0.0], 0.05).unwrap();
    (v[0], sigma, [v[0] + low, v[0] + high])
}

#[test]
fn skewed_intervals_are_those_of_quadrature() {
    for (sigma_b, noise) in [(0.3, 0.1), (0.5, 0.3), (0.8, 0.5)] {
        let mut cost = Amplitude::new(sigma_b, noise, f64::NEG_INFINITY);
        let (p, sigma, interval) = found(&mut cost);
        let expected = by_quadrature(&cost);
        for (end, (expected, normal)) in interval.iter().zip(expected.iter().zip([-1.96, 1.96])) {
            // a profile leaves out how the room for q changes along it: some per cent of σ here
            assert!((end - expected).abs() <= 0.06 * sigma, "{sigma_b} {noise}: {interval:?} for {expected}");
            let gaussian = (p + normal * sigma - expected).abs();
            assert!((end - expected).abs() <= 0.5 * gaussian + 0.02 * sigma, "{end} {expected} {gaussian}");
        }
    }
}

#[test]
fn beyond_a_wall_there_is_nothing() {
    let mut cost = Amplitude::new(0.5, 0.3, -0.8);
    let (_, _, [low, _]) = found(&mut cost);
    let [expected, _] = by_quadrature(&cost);
    // the points are a σ apart, and the last one before the wall is the end
    assert!(low > -0.8 && low - expected < 0.6, "{low} {expected}");
}

#[test]
fn a_linear_problem_has_the_gaussian_interval() {
    // an amplitude that hardly changes: J is quadratic to 1e-6
    let mut cost = Amplitude::new(1e-6, 0.3, f64::NEG_INFINITY);
    let mut v = vec![0.0; 2];
    Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(())).unwrap();
    let posterior = Posterior::new(&mut cost).unwrap();
    let variances = posterior.control_variable_variance();
    for (i, a) in [[1.0, 0.0], [0.0, 1.0]].iter().enumerate() {
        let gradients = cost.counts.gradients;
        let [low, high] = posterior.interval(&mut cost, &v, a, 0.05).unwrap();
        let expected = 1.959963984540054 * variances[i].sqrt();
        // sums over parts of 1/64 σ
        assert!(
            (high / expected - 1.0).abs() <= 1e-4 && (low / expected + 1.0).abs() <= 1e-4,
            "{low} {high}"
        );
        // three points on either side, and v again
        assert_eq!(cost.counts.gradients - gradients, 7);
        assert_eq!(cost.at, [v[0], v[1]]);
    }
}
