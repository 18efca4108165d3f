//! Every check of an observation operator.

use super::products::compare;
use super::taylor::fit;
use super::vectors::norm_of;
use crate::{At, Error, ObservationOperator};
use varda_linalg::check::{Finding, Random, Report, differing};

/// Sums that are rounded in another order may differ by this share of their size: some thousand roundings.
const ROUNDING: f64 = 1e-12;

/// Every check of an observation operator H at (k, t, x), with perturbations of the size of `scale`: it has
/// rows and a state; same input, same bits, whatever was observed before (a tangent belongs to the state it
/// is handed, not to the last one observed); all values are written and finite; a zero perturbation stays
/// zero; the tangent is linear and the derivative of H (Taylor); the transpose is added to what is there, and
/// is that of the tangent (dot product).
///
/// All maps are called with states of exactly `state_dim` values: an operator that reads beyond panics here,
/// not in the middle of a window. A term that vanishes at x shows nothing: take a state without zeros.
///
/// ```
/// use varda_implicit::{At, ObservationOperator, Refusal, check};
///
/// /// y = x₀², whose tangent lacks the factor 2.
/// struct Wrong;
///
/// impl ObservationOperator for Wrong {
///     fn dim(&self) -> usize {
///         1
///     }
///     fn state_dim(&self) -> usize {
///         2
///     }
///     fn observe(&mut self, _: At, x: &[f64], y: &mut [f64]) -> Result<(), Refusal> {
///         y[0] = x[0] * x[0];
///         Ok(())
///     }
///     fn tangent(&mut self, _: At, x: &[f64], dx: &[f64], dy: &mut [f64]) {
///         dy[0] = x[0] * dx[0];
///     }
///     fn adjoint_add(&mut self, _: At, x: &[f64], dy: &[f64], dx: &mut [f64]) {
///         dx[0] += x[0] * dy[0];
///     }
/// }
///
/// let report = check::operator(&mut Wrong, At { step: 0, time: 0.0 }, &[2.0, 1.0], &[0.1; 2], 1)?;
/// let failed: Vec<&str> = report.failed().map(|finding| finding.what.as_str()).collect();
/// assert_eq!(failed, ["tangent: 2 − Taylor slope"], "{report}");
/// # Ok::<(), varda_implicit::Error>(())
/// ```
///
/// # Errors
/// [`Error::Refused`] where the operator refuses x or states near it; [`Error::EmptyTest`] where a check
/// could not judge (a tangent that is zero along a random direction).
///
/// # Panics
/// If x or `scale` does not have `state_dim` values.
pub fn operator<H: ObservationOperator + ?Sized>(
    h: &mut H,
    at: At,
    x: &[f64],
    scale: &[f64],
    seed: u64,
) -> Result<Report, Error> {
    let (rows, n) = (h.dim(), h.state_dim());
    assert!(x.len() == n && scale.len() == n, "the operator reads a state of {n} values");
    let empty = (rows == 0) as u8 + (n == 0) as u8;
    let sizes = Finding::at_most("sizes: rows and state without a value", f64::from(empty), 0.0);
    if !sizes.pass {
        return Ok(Report { findings: vec![sizes] });
    }
    let mut findings = vec![sizes];
    let mut random = Random(seed);
    let [a, b] = [0; 2].map(|_| scale.iter().map(|s| s * random.draw()).collect::<Vec<f64>>());
    let moved = |h: f64| -> Vec<f64> { x.iter().zip(&a).map(|(x, a)| x + h * a).collect() };

    // What is not overwritten stays NaN.
    let observe = |h: &mut H, at: At, x: &[f64]| {
        let mut y = vec![f64::NAN; rows];
        let refused = |reason| Error::Refused { step: at.step, reason };
        h.observe(at, x, &mut y).map_err(refused).map(|()| y)
    };
    let tangent = |h: &mut H, dx: &[f64]| {
        let mut dy = vec![f64::NAN; rows];
        h.tangent(at, x, dx, &mut dy);
        dy
    };
    let adjoint = |h: &mut H, dy: &[f64], before: f64| {
        let mut dx = vec![before; n];
        h.adjoint_add(at, x, dy, &mut dx);
        dx
    };

    let y = observe(h, at, x)?;
    let (h_a, h_b) = (tangent(h, &a), tangent(h, &b));
    if h_a.iter().chain(&h_b).all(|value| *value == 0.0) {
        return Err(Error::EmptyTest { what: "the tangent of random perturbations is zero" });
    }
    let size = row_sizes(&[&h_a, &h_b]);
    let dy: Vec<f64> = size.iter().map(|s| random.draw() / s).collect();
    let back = adjoint(h, &dy, 0.0);
    let faults = [&y, &h_a, &h_b, &back].iter().flat_map(|v| v.iter()).filter(|v| !v.is_finite()).count();
    findings.push(Finding::at_most("values that are not written, or not finite", faults as f64, 0.0));
    if findings.iter().any(|finding| !finding.pass) {
        return Ok(Report { findings });
    }

    // Another state at another time in between: a refusal there is no fault.
    let _ = observe(h, At { step: at.step + 1, time: at.time + 1.0 }, &moved(1e-3));
    let (tangent_again, adjoint_again) = (tangent(h, &a), adjoint(h, &dy, 0.0));
    let _ = observe(h, at, &moved(1e-3));
    let again = differing(&h_a, &tangent_again).max(differing(&h_a, &tangent(h, &a)));
    let y_again = differing(&y, &observe(h, at, x)?);
    findings.push(Finding::at_most("observe: values that differ when run again", y_again, 0.0));
    findings.push(Finding::at_most("tangent: values that differ after another state", again, 0.0));
    let again = differing(&back, &adjoint_again);
    findings.push(Finding::at_most("adjoint: values that differ after another state", again, 0.0));

    let of_zero = tangent(h, &vec![0.0; n]).iter().filter(|v| **v != 0.0).count();
    findings.push(Finding::at_most("tangent: values of H′ 0 that are not zero", of_zero as f64, 0.0));
    let mixed: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.75 * a - 1.5 * b).collect();
    let sum: Vec<f64> = h_a.iter().zip(&h_b).map(|(a, b)| 0.75 * a - 1.5 * b).collect();
    let left: Vec<f64> = tangent(h, &mixed).iter().zip(&sum).map(|(m, s)| m - s).collect();
    let largest = norm_of(&h_a, &size).max(norm_of(&h_b, &size));
    let linear = norm_of(&left, &size) / largest;
    findings.push(Finding::at_most("tangent: departure from linearity", linear, ROUNDING));

    let slope = fit(&mut |step| {
        let mut difference = observe(h, at, &moved(step))?;
        difference.iter_mut().zip(&y).for_each(|(d, y)| *d -= y);
        let whole = norm_of(&difference, &size);
        difference.iter_mut().zip(&h_a).for_each(|(d, t)| *d -= step * t);
        Ok((whole, norm_of(&difference, &size)))
    })?;
    findings.push(Finding {
        what: "tangent: 2 − Taylor slope".to_string(),
        value: 2.0 - slope.slope,
        bound: 2.0 - slope.bound,
        pass: slope.pass,
    });

    let inverse: Vec<f64> = scale.iter().map(|s| 1.0 / s).collect();
    let mut added = adjoint(h, &dy, 1.0);
    added.iter_mut().zip(&back).for_each(|(a, b)| *a -= 1.0 + b);
    let before = norm_of(&back, &inverse) + norm_of(&vec![1.0; n], &inverse);
    let differ = norm_of(&added, &inverse) / before;
    findings.push(Finding::at_most("adjoint: difference where dx is not zero before", differ, ROUNDING));
    // ‖H′‖ from below, by power iterations with H′ᵀH′ in scaled variables
    let (mut v, mut norm) = (a.clone(), 0.0_f64);
    for _ in 0..6 {
        let length = norm_of(&v, scale);
        v.iter_mut().for_each(|v| *v /= length);
        let mut h_v = tangent(h, &v);
        norm = norm.max(norm_of(&h_v, &size));
        h_v.iter_mut().zip(&size).for_each(|(y, s)| *y /= s * s);
        v = adjoint(h, &h_v, 0.0);
        v.iter_mut().zip(scale).for_each(|(v, s)| *v *= s * s);
    }
    let dot = compare(&a, &h_a, &dy, &back, norm, [scale, &size])?;
    findings.push(Finding::at_most("adjoint: dot product", dot.value, dot.bound));
    Ok(Report { findings })
}

/// What a row is worth: |a_i| + |b_i| of two products; the largest where a row is zero.
fn row_sizes(products: &[&[f64]; 2]) -> Vec<f64> {
    let sizes: Vec<f64> = products[0].iter().zip(products[1]).map(|(a, b)| a.abs() + b.abs()).collect();
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    sizes.into_iter().map(|size| if size > 0.0 { size } else { largest }).collect()
}
