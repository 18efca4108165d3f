//! How large the error of a model is, from innovations.

use crate::Error;
use crate::cost::dot;
use varda_linalg::Svd;
use varda_linalg::dense::{View, product};

/// The factor on σ of the model error under which what was observed is most likely, with its 95 % interval.
///
/// The innovations d of a linear problem in units of R^{1/2} are drawn from N(0, S), and a Q that is wrong by
/// a factor alone makes
///
/// ```text
///     S(a) = I + G_b G_bᵀ + a² G_q G_qᵀ
///     −2 ln L(a) = ln det S(a) + dᵀ S(a)⁻¹ d + const                (Dee 1995)
/// ```
///
/// Where L is largest J_q is its expectation, 2 J_q = tr(I − P)_qq with a²Q in the place of Q: the
/// condition of Desroziers and Ivanov 2001. The interval holds all a with −2 ln L within 3.84 of the
/// least. B and R are taken to be right: an error of theirs that looks like one of the model counts as
/// one. About the analysis of a nonlinear problem it is right to first order.
///
/// ```
/// use std::ops::ControlFlow;
/// use varda_assimilation::*;
/// use varda_covariance::Diagonal;
/// use varda_implicit::{Rk4, lorenz::Lorenz63};
///
/// // Three components seen as 5 σ_b away from the run: an error of the model of σ = 0.01 cannot be all.
/// let mut model = Rk4::new(Lorenz63::default(), 0, 0.01);
/// let seen = vec![Observation::new(1, vec![0, 1, 2], vec![2.1, 2.3, 20.6], 0.01)];
/// let mut observations = ObservationSet::new(1, vec![Box::new(Selection::new(vec![0, 1, 2], 3)?)], seen)?;
/// let (b, q) = (Diagonal::uniform(3, 0.1)?, Diagonal::uniform(3, 0.01)?);
/// let transform = ControlTransform::new(vec![1.5, 1.7, 20.0], &b)?;
/// let forcing = Forcing::every_step(3);
/// let mut cost = WeakForcing::new(&mut model, transform, &q, forcing, &mut observations)?;
/// let mut v = vec![0.0; cost.dim()];
/// Minimizer::default().minimize(&mut cost, &mut v, &mut |_| ControlFlow::Continue(()))?;
/// cost.linearize(&v, &mut vec![0.0; v.len()])?;
/// let scale = WeakPosterior::new(&mut cost)?.scale().expect("three values were seen");
/// assert!(scale.low > 1.0 && scale.low < scale.factor && scale.factor < scale.high);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorScale {
    /// a; 0 where the innovations show no error of the model.
    pub factor: f64,
    /// Lower end of the interval; 0 where no error of the model explains them nearly as well.
    pub low: f64,
    /// Upper end; infinite where they set no bound.
    pub high: f64,
}

/// −2 ln L rises by this to the ends of the interval: the 95 % point of χ² with one degree of freedom.
const RISE: f64 = 3.841459;
/// Factors from e^{-LONGEST} to e^{LONGEST} are looked at, in steps of e^{STEP}.
const LONGEST: f64 = 10.0;
const STEP: f64 = 0.05;

impl ErrorScale {
    /// `n` unknowns of the background come first in every one of `rows`, those of G; `innovations` are d.
    pub(crate) fn most_likely(n: usize, rows: &[f64], innovations: &[f64]) -> Result<Option<Self>, Error> {
        let m = innovations.len();
        if m == 0 {
            return Ok(None);
        }
        Ok(Some(Likelihood::new(n, rows, innovations)?.scale()))
    }
}

/// −2 ln L in the basis in which both parts of S are diagonal: Σ ln(1 + a² λ) + e² / (1 + a² λ).
struct Likelihood {
    lambda: Vec<f64>,
    squares: Vec<f64>,
}

impl Likelihood {
    /// Both by singular values: S(0) has the vectors w and the roots √(1 + s²) of those of G_bᵀ, and
    /// with X = S(0)^{-1/2} G_q, λ are the squares of those of X. Never I + G Gᵀ, which a window that
    /// amplifies would round to nothing.
    fn new(n: usize, rows: &[f64], d: &[f64]) -> Result<Self, Error> {
        let m = d.len();
        let r = rows.len() / m;
        let [head, tail] = [0..n, n..r].map(|part| {
            rows.chunks_exact(r).flat_map(|row| &row[part.clone()]).copied().collect::<Vec<f64>>()
        });
        let Svd { values, right, .. } = Svd::new(n, m, &head)?;
        let whiten = |i: usize, x: f64| x / values.get(i).map_or(1.0, |s| s.hypot(1.0));
        let (errors, basis) = (View::new(&tail, r - n, m), View::new(&right, m, m));
        let mut x = vec![0.0; (r - n) * m];
        product(errors, basis, &mut x);
        for (i, column) in x.chunks_exact_mut(r - n).enumerate() {
            column.iter_mut().for_each(|x| *x = whiten(i, *x));
        }
        let e: Vec<f64> = right.chunks_exact(m).enumerate().map(|(i, w)| whiten(i, dot(w, d))).collect();
        // Of Xᵀ, whose right vectors are those of the observations.
        let Svd { values, right, .. } = Svd::thin(r - n, m, &x)?;
        let squares = right.chunks_exact(m).map(|w| dot(w, &e).powi(2)).collect();
        Ok(Self { lambda: values.iter().map(|s| s * s).collect(), squares })
    }

    /// At a = e^u.
    fn at(&self, u: f64) -> f64 {
        let a2 = (2.0 * u).exp();
        let terms = self.lambda.iter().zip(&self.squares);
        terms.map(|(l, e2)| (a2 * l).ln_1p() + e2 / (1.0 + a2 * l)).sum()
    }

    fn scale(&self) -> ErrorScale {
        let steps = (2.0 * LONGEST / STEP).round() as usize;
        let at = |i: usize| -LONGEST + STEP * i as f64;
        let values: Vec<f64> = (0..=steps).map(|i| self.at(at(i))).collect();
        let none: f64 = self.squares.iter().sum();
        let best = (0..=steps).fold(0, |best, i| if values[i] < values[best] { i } else { best });
        let (u, least) = self.lowest(at(best));
        let inside = least + RISE;
        let below = (0..best).rev().find(|&i| values[i] > inside);
        let above = (best + 1..=steps).find(|&i| values[i] > inside);
        let cross = |i: usize, j: usize| {
            let share = (inside - values[i]) / (values[j] - values[i]);
            (at(i) + share * (at(j) - at(i))).exp()
        };
        let high = above.map_or(f64::INFINITY, |i| cross(i - 1, i));
        if best == 0 || none <= least {
            return ErrorScale { factor: 0.0, low: 0.0, high };
        }
        let low = match below {
            Some(i) if none > inside => cross(i + 1, i),
            _ => 0.0,
        };
        ErrorScale { factor: u.exp(), low, high }
    }

    /// The minimum within a step of u, by golden sections.
    fn lowest(&self, u: f64) -> (f64, f64) {
        let golden = 0.5 * (5f64.sqrt() - 1.0);
        let (mut low, mut high) = (u - STEP, u + STEP);
        while high - low > 1e-9 {
            let (left, right) = (high - golden * (high - low), low + golden * (high - low));
            if self.at(left) <= self.at(right) { high = right } else { low = left }
        }
        let u = 0.5 * (low + high);
        (u, self.at(u))
    }
}
