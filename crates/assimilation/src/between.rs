//! The state between two steps.

use varda_implicit::Rate;

/// The state at fraction w of the way from x_k to x_{k+1}, as a sum of a share of each: of components whose
/// rate is known the cubic through both states with their rates (Hermite), of others a straight line.
///
/// ```text
///     x(w) = (1 + 2w)(1 − w)² x_k + w²(3 − 2w) x_{k+1}
///             + Δt w (1 − w) ((1 − w) ẋ_k − w ẋ_{k+1})
/// ```
pub(crate) struct Between {
    rate: Box<dyn Rate>,
    values: Vec<f64>,
}

/// What one of the two states gives: a line's share, and those of the cubic for state and rate.
struct Share {
    line: f64,
    state: f64,
    rate: f64,
}

impl Between {
    pub(crate) fn new(rate: Box<dyn Rate>) -> Self {
        Self { values: vec![0.0; rate.components().len()], rate }
    }

    /// The share of state `k`, which is the first of an interval or the one after.
    fn share(&self, interval: usize, k: usize, w: f64) -> Share {
        let (rest, length) = (1.0 - w, self.rate.length(interval));
        if k == interval {
            Share { line: rest, state: (1.0 + 2.0 * w) * rest * rest, rate: length * w * rest * rest }
        } else {
            Share { line: w, state: w * w * (3.0 - 2.0 * w), rate: -length * w * w * rest }
        }
    }

    /// `sum` += the share of x_k in x(w).
    pub(crate) fn add(&mut self, interval: usize, k: usize, w: f64, x: &[f64], sum: &mut [f64]) {
        self.rate.eval(k, x, &mut self.values);
        self.add_shares(interval, k, w, x, sum);
    }

    /// `dx_w` = the share of dx_k in dx(w), at the state x_k.
    pub(crate) fn tangent(
        &mut self,
        (interval, k, w): (usize, usize, f64),
        x: &[f64],
        dx: &[f64],
        dx_w: &mut [f64],
    ) {
        self.rate.tangent(k, x, dx, &mut self.values);
        dx_w.fill(0.0);
        self.add_shares(interval, k, w, dx, dx_w);
    }

    /// dx += the transpose of `tangent` of λ.
    pub(crate) fn adjoint_add(
        &mut self,
        (interval, k, w): (usize, usize, f64),
        x: &[f64],
        lambda: &[f64],
        dx: &mut [f64],
    ) {
        let (share, known) = (self.share(interval, k, w), self.rate.components());
        for (i, (dx, l)) in dx.iter_mut().zip(lambda).enumerate() {
            *dx += if known.contains(&i) { share.state } else { share.line } * l;
        }
        self.values.iter_mut().zip(&lambda[known]).for_each(|(v, l)| *v = share.rate * l);
        self.rate.adjoint_add(k, x, &self.values, dx);
    }

    /// out += the second derivative of x(w)·λ in x_k, times dx: that of the rate.
    pub(crate) fn second_adjoint_add(
        &mut self,
        (interval, k, w): (usize, usize, f64),
        [x, dx]: [&[f64]; 2],
        lambda: &[f64],
        out: &mut [f64],
    ) {
        let (share, known) = (self.share(interval, k, w), self.rate.components());
        self.values.iter_mut().zip(&lambda[known]).for_each(|(v, l)| *v = share.rate * l);
        self.rate.second_adjoint_add(k, x, dx, &self.values, out);
    }

    /// `sum` += the shares of x and of its rate in `values`.
    fn add_shares(&self, interval: usize, k: usize, w: f64, x: &[f64], sum: &mut [f64]) {
        let (share, known) = (self.share(interval, k, w), self.rate.components());
        let line = |sum: &mut [f64], x: &[f64]| {
            sum.iter_mut().zip(x).for_each(|(sum, x)| *sum += share.line * x);
        };
        line(&mut sum[..known.start], &x[..known.start]);
        line(&mut sum[known.end..], &x[known.end..]);
        for ((sum, x), v) in sum[known.clone()].iter_mut().zip(&x[known]).zip(&self.values) {
            *sum += share.state * x + share.rate * v;
        }
    }
}
