//! Taylor tests: remainders of first order against the size of the perturbation.

use super::vectors::norm_of;
use crate::{Error, Model};
use varda_linalg::dot;

/// A Taylor test: remainders of first order against the size of the perturbation.
#[derive(Debug, Clone, PartialEq)]
pub struct Taylor {
    /// Slope of log remainder over log step, fitted by least squares: 2 for a right derivative (more where
    /// the second derivative vanishes along the direction, infinite for a function that is linear to
    /// rounding), 1 for a wrong one.
    pub slope: f64,
    /// The slope must be at least this.
    pub bound: f64,
    /// The steps used, decreasing, and their remainders.
    pub points: Vec<(f64, f64)>,
    /// Whether `slope` ≥ `bound` (false for NaN).
    pub pass: bool,
}

/// Slope that a Taylor test asks for.
const SLOPE: f64 = 1.95;

/// Points a slope is fitted through, at most and at least.
const POINTS: (usize, usize) = (10, 5);

/// Below this step a remainder that grows as the step shrinks is rounding.
const SMALL: f64 = 1e-5;

/// A remainder counts where it is this many times the rounding seen.
const ABOVE_ROUNDING: f64 = 100.0;

/// Taylor test of a scalar function: |J(x + h d) − J(x) − h ⟨g, d⟩| must fall like h².
///
/// # Errors
/// What `function` returns; [`Error::EmptyTest`] where d or ⟨g, d⟩ and all differences are zero, or no
/// range of steps is left between truncation and rounding.
///
/// # Panics
/// If lengths differ.
pub fn taylor(
    function: &mut dyn FnMut(&[f64]) -> Result<f64, Error>,
    gradient: &[f64],
    x: &[f64],
    direction: &[f64],
) -> Result<Taylor, Error> {
    assert!(gradient.len() == x.len() && direction.len() == x.len(), "lengths differ");
    let value = function(x)?;
    let slope = dot(gradient, direction);
    let mut moved = vec![0.0; x.len()];
    fit(&mut |h| {
        for ((m, x), d) in moved.iter_mut().zip(x).zip(direction) {
            *m = x + h * d;
        }
        let difference = function(&moved)? - value;
        Ok((difference.abs(), (difference - h * slope).abs()))
    })
}

/// Taylor test of step k of a model at x: ‖M(x + h d) − M(x) − h M′ d‖ must fall like h².
/// Linearizes step k at x.
///
/// # Errors
/// Those of the model; [`Error::EmptyTest`] as for [`taylor`].
///
/// # Panics
/// If lengths differ.
pub fn taylor_step(
    model: &mut dyn Model,
    k: usize,
    x: &[f64],
    direction: &[f64],
    scale: &[f64],
) -> Result<Taylor, Error> {
    let n = model.dim();
    assert!(x.len() == n && direction.len() == n && scale.len() == n, "lengths differ");
    let (mut base, mut moved, mut next) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    model.step(k, x, &mut base)?;
    model.linearize(0, k, x, &base)?;
    let mut tangent = direction.to_vec();
    model.tangent(0, &mut tangent);
    fit(&mut |h| {
        for ((m, x), d) in moved.iter_mut().zip(x).zip(direction) {
            *m = x + h * d;
        }
        model.step(k, &moved, &mut next)?;
        next.iter_mut().zip(&base).for_each(|(n, b)| *n -= b);
        let difference = norm_of(&next, scale);
        next.iter_mut().zip(&tangent).for_each(|(n, t)| *n -= h * t);
        Ok((difference, norm_of(&next, scale)))
    })
}

/// Fits the slope of a remainder given as (size of the difference, size of the remainder) for a step h.
///
/// Steps fall from 1 by halves to 2⁻⁴⁶. What is left at the smallest steps is rounding; of the
/// remainders well above it, those at the smallest steps are used, where terms of higher order are least.
/// Steps at which the function fails are passed over while they are the largest.
pub(super) fn fit(remainder: &mut dyn FnMut(f64) -> Result<(f64, f64), Error>) -> Result<Taylor, Error> {
    let mut points = Vec::new();
    let mut failure = None;
    for halvings in 0..=46 {
        let h = 0.5_f64.powi(halvings);
        match remainder(h) {
            Ok((difference, rest)) => points.push((h, difference, rest)),
            Err(error) if points.is_empty() => failure = Some(error),
            Err(error) => return Err(error),
        }
    }
    let Some(&(_, largest, first)) = points.first() else {
        return Err(failure.unwrap_or(Error::EmptyTest { what: "no step could be taken" }));
    };
    if largest == 0.0 {
        return Err(Error::EmptyTest { what: "the function does not change along the direction" });
    }
    if first <= 1e-13 * largest {
        let points = points.iter().map(|p| (p.0, p.2)).collect();
        return Ok(Taylor { slope: f64::INFINITY, bound: SLOPE, points, pass: true });
    }
    // What is left at the smallest steps is rounding, and so is what grows as the step shrinks.
    let last = points[points.len() - 8..].iter().map(|p| p.2);
    let grown = points.windows(2).filter(|p| p[1].0 <= SMALL && p[1].2 > p[0].2).map(|p| p[1].2);
    let rounding = last.chain(grown).fold(0.0_f64, f64::max);
    let above: Vec<(f64, f64)> = points
        .iter()
        .map(|&(h, _, rest)| (h, rest))
        .take_while(|&(_, rest)| rest > ABOVE_ROUNDING * rounding && rest.is_finite())
        .collect();
    if above.len() < POINTS.1 {
        return Err(Error::EmptyTest { what: "no range of steps between truncation and rounding" });
    }
    let points = above[above.len().saturating_sub(POINTS.0)..].to_vec();
    let slope = log_slope(&points);
    Ok(Taylor { slope, bound: SLOPE, pass: slope >= SLOPE, points })
}

/// Least-squares slope of ln y over ln x.
fn log_slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let logs = points.iter().map(|(x, y)| (x.ln(), y.ln()));
    let (sx, sy) = logs.clone().fold((0.0, 0.0), |s, (x, y)| (s.0 + x, s.1 + y));
    let (mx, my) = (sx / count, sy / count);
    let (sxy, sxx) = logs.fold((0.0, 0.0), |s, (x, y)| (s.0 + (x - mx) * (y - my), s.1 + (x - mx).powi(2)));
    sxy / sxx
}
