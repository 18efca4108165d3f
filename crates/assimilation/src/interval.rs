//! Intervals of one number under a posterior that is not Gaussian.

use crate::{Error, LeastSquares, Posterior};
use varda_linalg::dot;

/// The Gaussian's own J at three σ: further out lies what no interval of use depends on.
const FAR: f64 = 4.5;
/// Most σ that are gone on either side.
const FARTHEST: usize = 8;
/// Parts of a σ in which the density is summed.
const PARTS: usize = 64;
/// σ of a normal tail beyond the last point.
const TAIL: usize = 4;

/// J along a profile: less its minimum, and its slope.
#[derive(Clone, Copy)]
struct Node {
    rise: f64,
    slope: f64,
}

impl Posterior {
    /// The ends of the interval of aᵀ(w − v) that leaves `outside`/2 of its probability below and above,
    /// where J is not quadratic within the posterior's own spread; v is the minimum, and the point that
    /// the posterior is of.
    ///
    /// With σ² = aᵀ P a and d = P a/σ, J is minimized over all else at t = aᵀ(w − v)/σ = ± 1, …,
    /// by one Newton step from where the last one ended, with the Hessian of the posterior:
    ///
    /// ```text
    /// w ← w + d,   g = ∇J(w),   w ← w − (P − d dᵀ) g
    /// ΔJ(t) = J − ½ gᵀ(P − d dᵀ) g − J(v)
    /// ΔJ′(t) = gᵀ d
    /// ```
    ///
    /// until ΔJ is that of three σ. The density is exp(−ΔJ(t)), with cubics between the points (a
    /// profile likelihood: how much room the other unknowns leave is taken to be the same along it). For a
    /// quadratic J the ends are the Gaussian's, −1.96 σ and 1.96 σ for `outside` = 0.05. From where the
    /// model cannot be run the density is zero.
    ///
    /// When to use: constants of a model, whose effect is seldom linear within their σ. When not: many
    /// numbers, since each takes some six gradients. The cost's last gradient is that at v again.
    ///
    /// # Errors
    /// A cost that cannot be evaluated at v.
    ///
    /// # Panics
    /// If a length is not that of the control variable, a is zero, or `outside` is not between 0 and 1.
    ///
    /// ```
    /// # use std::ops::ControlFlow;
    /// use varda_assimilation::*;
    /// # use varda_covariance::Diagonal;
    /// # use varda_implicit::{Rk4, lorenz::Lorenz63};
    /// # let (mut model, b) = (Rk4::new(Lorenz63::default(), 0, 0.01), Diagonal::uniform(3, 1.0)?);
    /// # let seen = vec![Observation::new(20, vec![0, 2], vec![8.1, 14.9], 0.1)];
    /// # let all = Box::new(Selection::new(vec![0, 1, 2], 3)?);
    /// # let mut observations = ObservationSet::new(20, vec![all], seen)?;
    /// # let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
    /// # let mut cost = StrongConstraint::new(&mut model, transform.clone(), &mut observations)?;
    /// # let mut v = vec![0.0; 3];
    /// Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
    /// let posterior = Posterior::new(&mut cost)?;
    /// // the second component of v
    /// let [low, high] = posterior.interval(&mut cost, &v, &[0.0, 1.0, 0.0], 0.05)?;
    /// assert!(low < 0.0 && 0.0 < high);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn interval(
        &self,
        cost: &mut dyn LeastSquares,
        v: &[f64],
        a: &[f64],
        outside: f64,
    ) -> Result<[f64; 2], Error> {
        let n = self.spectrum().len();
        assert_eq!((v.len(), a.len()), (n, n), "length of the control variable");
        assert!(0.0 < outside && outside < 1.0, "a probability of {outside}");
        let mut d = self.variance_product(a);
        let sigma = dot(a, &d).sqrt();
        assert!(sigma > 0.0, "no number of the control variable");
        d.iter_mut().for_each(|d| *d /= sigma);
        let least = cost.evaluate(v, None)?;
        let up = self.profile(cost, v, &d, least);
        d.iter_mut().for_each(|d| *d = -*d);
        let down = self.profile(cost, v, &d, least);
        cost.evaluate(v, Some(&mut vec![0.0; n]))?;
        let ends = ends(&density(&down), &density(&up), outside);
        Ok(ends.map(|t| sigma * t))
    }

    /// The points along d, and whether the model could be run at the one after the last.
    fn profile(&self, cost: &mut dyn LeastSquares, v: &[f64], d: &[f64], least: f64) -> (Vec<Node>, bool) {
        let (mut w, mut g) = (v.to_vec(), vec![0.0; v.len()]);
        let mut nodes = vec![Node { rise: 0.0, slope: 0.0 }];
        for _ in 0..FARTHEST {
            w.iter_mut().zip(d).for_each(|(w, d)| *w += d);
            let value = match cost.evaluate(&w, Some(&mut g)) {
                Ok(value) if value.is_finite() => value,
                _ => return (nodes, false),
            };
            let slope = dot(&g, d);
            let mut step = self.variance_product(&g);
            step.iter_mut().zip(d).for_each(|(s, d)| *s -= slope * d);
            let (rise, gain) = (value - least, 0.5 * dot(&g, &step));
            // what the quadratic promises is believed up to half of the rise
            let is_near = gain <= 0.5 * rise;
            if is_near {
                w.iter_mut().zip(&step).for_each(|(w, s)| *w -= s);
            }
            let rise = if is_near { rise - gain } else { rise };
            nodes.push(Node { rise, slope });
            if rise >= FAR {
                break;
            }
        }
        (nodes, true)
    }

    /// P a.
    fn variance_product(&self, a: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; a.len()];
        for column in self.columns() {
            let along = dot(column, a);
            out.iter_mut().zip(column).for_each(|(out, c)| *out += along * c);
        }
        out
    }
}

/// exp(−ΔJ) at 0, 1/[`PARTS`], …: cubics between the points, and beyond the last one a normal tail.
fn density((nodes, goes_on): &(Vec<Node>, bool)) -> Vec<f64> {
    let mut out = Vec::new();
    for pair in nodes.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let rise = |part: usize| {
            let s = part as f64 / PARTS as f64;
            let r = 1.0 - s;
            r * r * ((1.0 + 2.0 * s) * from.rise + s * from.slope)
                + s * s * ((1.0 + 2.0 * r) * to.rise - r * to.slope)
        };
        out.extend((0..PARTS).map(|part| (-rise(part)).exp()));
    }
    let last = nodes[nodes.len() - 1];
    let beyond = |part: usize| {
        let s = part as f64 / PARTS as f64;
        (-(last.rise + s * (last.slope.max(0.0) + 0.5 * s))).exp()
    };
    out.extend((0..if *goes_on { TAIL * PARTS } else { 1 }).map(beyond));
    out
}

/// Where the sum from either end comes to half of what is left outside.
fn ends(down: &[f64], up: &[f64], outside: f64) -> [f64; 2] {
    let whole: Vec<f64> = down.iter().skip(1).rev().chain(up).copied().collect();
    let zero = down.len() as f64 - 1.0;
    let total: f64 = whole.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).sum();
    let wanted = 0.5 * outside * total;
    let from = |density: &mut dyn Iterator<Item = f64>| {
        let (mut sum, mut at, mut before) = (0.0, 0.0, density.next().unwrap_or(0.0));
        for next in density {
            let part = 0.5 * (before + next);
            if sum + part >= wanted {
                return at + (wanted - sum) / part;
            }
            (sum, at, before) = (sum + part, at + 1.0, next);
        }
        at
    };
    let low = from(&mut whole.iter().copied()) - zero;
    let high = whole.len() as f64 - 1.0 - from(&mut whole.iter().rev().copied()) - zero;
    [low / PARTS as f64, high / PARTS as f64]
}
